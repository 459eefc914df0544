"""The page is self-contained and safe for all names; in Chromium its controls work."""

import base64
import hashlib
import json
import os
import re
import shutil
import subprocess
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from twinlens.errors import OutputError
from twinlens.report import write_page
from twinlens.report.page import page_html
from twinlens.scoring import (
    PROTOCOLS,
    Board,
    Pair,
    board_csv,
    board_latex,
    board_to_json,
    run_benchmark,
)

EVIL = "</script><img src=x onerror=\"document.title='pwned'\"><!--<script>&lt;'`${1}{{data}}\u2028"


class Flat:
    """Returns a constant, or raises."""

    def __init__(self, name, value):
        self.name, self.value = name, value

    def match(self, left, right, *, num_disparities, min_disparity):
        if self.value is None:
            raise RuntimeError(self.name)
        disp = np.full(left.shape[:2], self.value, np.float32)
        disp[:, :3] = np.inf
        return disp


def pair(name="street"):
    rng = np.random.default_rng(2)
    image = rng.integers(0, 255, (24, 40, 3), np.uint8)
    gt = np.full((24, 40), 5, np.float32)
    gt[:12] = 9
    gt[0] = np.inf
    return Pair(name, image, image[:, ::-1].copy(), gt, np.isfinite(gt), 16)


def made(names=("low", "high"), sample="street", title="board"):
    """A board, its samples and maps: the first method returns 5 px, the second 9 px, the third raises."""
    maps, values = {}, (5, 9, None)
    methods = [Flat(name, value) for name, value in zip(names, values, strict=False)]
    samples = [pair(sample), pair(f"{sample} again")]
    board = run_benchmark(
        samples,
        methods,
        protocol=["middlebury-v3", "eth3d", "kitti2015"],
        regions=["all", "nonocc", "near"],
        on_map=lambda m, s, d: maps.update({(m, s): d}),
        title=title,
        warm_up=False,
    )
    return board, samples, maps


class Elements(HTMLParser):
    """Tags of a page as a browser parses them, with attributes, and the text of its JSON block."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.data, self._inside = [], "", False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, tuple(attributes)))
        self._inside = ("id", "data") in attributes

    def handle_data(self, data):
        if self._inside:
            self.data += data
            self._inside = False


def test_names_cannot_inject_markup():
    plain = Elements(page_html(*made(("a", "b", "c"))))
    evil = page_html(
        *made((EVIL, "b" + EVIL, "c" + EVIL), sample="s" + EVIL, title="t" + EVIL)
    )
    assert Elements(evil).tags == [
        (tag, tuple((k, v) for k, v in attributes)) for tag, attributes in plain.tags
    ], "a name added or changed an element"
    assert "<img src=x" not in evil
    document = json.loads(Elements(evil).data)
    assert [m["name"] for m in document["methods"]] == [EVIL, "b" + EVIL, "c" + EVIL]
    assert document["samples"][0]["name"] == "s" + EVIL
    assert document["entries"][-1]["failure"][1].startswith("RuntimeError: c</script>")


@given(name=st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=30))
@settings(max_examples=60, deadline=None)
def test_any_name_arrives_as_it_is(name):
    board = run_benchmark([pair(name)], [Flat(name, 5)], warm_up=False, title=name)
    found = Elements(page_html(board))
    assert [(m["name"], m["spec"]) for m in json.loads(found.data)["methods"]] == [
        (name, name)
    ]
    assert len(found.tags) == len(Elements(page_html(Board())).tags)


def test_scripts_never_write_markup():
    for file in resources.files("twinlens.report").joinpath("page").iterdir():
        if file.name.endswith(".js"):
            text = file.read_text()
            for word in (
                "innerHTML",
                "outerHTML",
                "insertAdjacentHTML",
                "document.write",
                "eval(",
                "Function(",
                "fetch(",
            ):
                assert word not in text, (file.name, word)


def test_the_page_needs_nothing_from_elsewhere():
    text = page_html(*made())
    assert [
        a
        for _, attributes in Elements(text).tags
        for k, a in attributes
        if k in ("src", "href") and a[0] != "#"
    ] == []
    assert set(re.findall(r"https?://[^\s\"'`)]+", text)) <= {
        "http://www.w3.org/2000/svg"
    }
    assert "@import" not in text
    assert "url(" not in text


def test_the_policy_allows_the_pages_own_script_alone():
    text = page_html(*made())
    script = re.search(r"<script>(.*)</script>", text, re.S)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text)[1]
    assert f"script-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'")


def test_the_page_says_what_the_board_says():
    board, samples, maps = made(("low", "high", "none"))
    document = json.loads(Elements(page_html(board, samples, maps)).data)
    mean = board.mean("low", "middlebury-v3", "near").metrics
    assert document["means"]["middlebury-v3"]["near"]["low"]["v"][
        "totbad2.0"
    ] == pytest.approx(mean["totbad2.0"], rel=1e-5)
    assert inflated(document["downloads"]["csv"]) == board_csv(board)
    assert inflated(document["downloads"]["json"]) == board_to_json(board)
    assert inflated(document["downloads"]["latex"]["eth3d"]["near"]) == board_latex(
        board, "eth3d", "near"
    )
    entry, place = (
        document["entries"][0],
        PROTOCOLS["middlebury-v3"].metrics.index("avgerr"),
    )
    assert entry["regions"]["all"]["v"][place] == pytest.approx(
        board.entries[0].value("all", "avgerr"), rel=1e-5
    )
    assert document["means"]["eth3d"]["all"]["none"]["v"]["bad1.0"] is None
    assert set(document["samples"][0]["pictures"]["maps"]) == {"low", "high"}
    assert [p["name"] for p in document["protocols"]] == [
        "middlebury-v3",
        "eth3d",
        "kitti2015",
    ]


def inflated(packed):
    return zlib.decompress(base64.b64decode(packed)).decode()


class Ranked(Flat):
    """Returns a constant with a confidence that falls from left to right."""

    def match(self, left, right, *, num_disparities, min_disparity):
        disp = super().match(
            left, right, num_disparities=num_disparities, min_disparity=min_disparity
        )
        return disp, np.broadcast_to(
            -np.arange(disp.shape[1], dtype=np.float32), disp.shape
        )


def ranked_board():
    return run_benchmark(
        [pair(), pair("lane")], [Ranked("ranked", 5), Flat("plain", 5)], warm_up=False
    )


def test_a_page_has_the_sparsification_of_methods_with_a_confidence():
    board = ranked_board()
    document = json.loads(Elements(page_html(board)).data)
    regions = {
        e["method"]: e["regions"]["all"]
        for e in document["entries"]
        if e["sample"] == "lane"
    }
    scores = board.find("ranked", "lane", "middlebury-v3").regions["all"]
    assert regions["ranked"]["s"] == pytest.approx(scores.sparsification, rel=1e-5)
    assert regions["ranked"]["v"][-2:] == pytest.approx(
        [scores["auc2.0"], scores["auc2.0_opt"]], rel=1e-5
    )
    assert "s" not in regions["plain"]
    assert document["protocols"][0]["columns"][-2:] == ["auc2.0", "auc2.0_opt"]
    without = json.loads(Elements(page_html(made()[0])).data)["protocols"][0]
    assert not [
        name
        for name in without["metrics"] + without["columns"]
        if name.startswith("auc")
    ]


def test_the_page_lists_samples_a_method_was_not_run_on():
    """A method run on one of two samples has no mean, and the page names the other sample."""
    board, samples, _ = made()
    both = run_benchmark(
        samples[:1],
        [Flat("late", 5)],
        protocol=board.protocols,
        regions=board.regions,
        board=board,
    )
    mean = json.loads(Elements(page_html(both)).data)["means"]["eth3d"]["all"]["late"]
    assert (mean["n"], mean["failed"], mean["missing"]) == (1, [], ["street again"])
    assert mean["v"]["bad1.0"] is None


def test_samples_and_maps_are_optional_and_unknown_samples_ignored():
    board, samples, _ = made()
    assert json.loads(Elements(page_html(board)).data)["samples"][0]["pictures"] is None
    assert len(page_html(board, [pair("unknown")])) == len(page_html(board))
    pictures = json.loads(Elements(page_html(board, samples)).data)["samples"][0][
        "pictures"
    ]
    assert (pictures["maps"], pictures["noise"]) == ({}, "")


def test_the_page_gives_the_noise_of_the_renderer():
    board, samples, _ = made()
    noisy = [replace(samples[0], renderer_noise=0.234)]
    assert json.loads(Elements(page_html(board, noisy)).data)["samples"][0]["pictures"][
        "noise"
    ] == ("light paths 0.23 × sensor noise")


def test_large_maps_are_subsampled():
    board, samples, maps = made()
    for options in ({"max_width": 20}, {"budget_bytes": 2000}):
        truth = json.loads(Elements(page_html(board, samples, maps, **options)).data)[
            "samples"
        ][0]["pictures"]["truth"]
        assert (truth["w"], truth["h"], truth["stride"]) == (20, 12, 2)


@pytest.mark.parametrize(
    ("max_width", "stride"), [(40, 1), (39, 2), (14, 3), (13, 4), (1, 40)]
)
def test_a_map_is_at_most_as_wide_as_asked(max_width, stride):
    board, samples, maps = made()
    document = json.loads(
        Elements(page_html(board, samples, maps, max_width=max_width)).data
    )
    for packed in (
        document["samples"][0]["pictures"]["truth"],
        document["samples"][0]["pictures"]["maps"]["low"],
    ):
        assert packed["stride"] == stride
        assert packed["w"] <= max_width


def test_a_page_is_written_atomically(tmp_path):
    board, samples, maps = made()
    path = write_page(tmp_path / "board.html", board, samples, maps)
    assert path.read_text() == page_html(board, samples, maps)
    with pytest.raises(OutputError):
        write_page(path / "board.html", board)
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError):
        write_page(tmp_path / "folder", board)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["board.html", "folder"]


def luminance(colour):
    """Relative luminance of #rrggbb (WCAG 2.2)."""
    values = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [
        v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("theme", [":root {", ':root[data-theme="dark"] {'])
def test_text_has_enough_contrast(theme):
    """At least 4.5 to 1, as WCAG 2.2 requires for small text (level AA)."""
    css = resources.files("twinlens.report").joinpath("page", "page.css").read_text()
    colours = dict(
        re.findall(
            r"--([a-z-]+): (#[0-9a-f]{6})", css.partition(theme)[2].partition("}")[0]
        )
    )
    pairs = [
        (text, ground)
        for text in ("ink", "soft", "faint", "accent", "best", "bad")
        for ground in ("bg", "card")
    ]
    for text, ground in [
        *pairs,
        ("ink", "hover"),
        ("ink", "bar"),
        ("accent", "accent-soft"),
        ("bad", "bad-soft"),
    ]:
        low, high = sorted(luminance(colours[name]) for name in (text, ground))
        assert (high + 0.05) / (low + 0.05) >= 4.5, (text, ground)


LOST = "0 of 2 samples, 2 failed"
CHROMIUM = (
    shutil.which("chromium")
    or shutil.which("chromium-browser")
    or shutil.which("google-chrome")
)
DRIVER = """
<script>
window.addEventListener("error", (e) => { document.title = "error: " + e.message; });
const results = {}, later = (ms) => new Promise((done) => setTimeout(done, ms));
const names = () => [...document.querySelectorAll("#board tbody .name")].map((c) => c.lastChild.textContent);
const pick = (id, value) => {
  const select = document.getElementById(id);
  select.value = value;
  select.dispatchEvent(new Event("change"));
};
const pixel = (canvas, x, y) => [...canvas.getContext("2d").getImageData(x, y, 1, 1).data].slice(0, 3);
(async () => {
  while (!document.documentElement.dataset.ready) await later(20);
  results.first = names();
  [...document.querySelectorAll("#board th button")].find((b) => b.textContent.includes("totbad2.0")).click();
  results.flipped = names();
  pick("region", "near");
  results.near = names();
  [...document.querySelectorAll("#protocols button")].find((b) => b.textContent.includes("KITTI")).click();
  await later(50);
  results.head = [...document.querySelectorAll("#board th button")].map((b) => b.firstChild.textContent).slice(-3);
  pick("region", "all");
  document.querySelectorAll("#board tbody tr")[0].click();
  await later(100);
  results.panels = [...document.querySelectorAll("#panels figcaption")].map((c) => c.firstChild.textContent);
  const canvas = [...document.querySelectorAll("#panels .view canvas")];
  results.unknown = pixel(canvas[0], 20, 0);
  results.hole = pixel(canvas[1], 1, 20);
  results.zero = pixel(canvas[3], 20, 20);
  results.off = pixel(canvas[3], 20, 5);
  const box = canvas[0].getBoundingClientRect();
  const at = { clientX: box.left + box.width * 20.5 / 40, clientY: box.top + box.height * 5.5 / 24 };
  canvas[0].parentElement.dispatchEvent(new PointerEvent("pointermove", at));
  results.readout = document.getElementById("readout").textContent;
  const links = [];
  HTMLAnchorElement.prototype.click = function () {
    links.push([this.download, fetch(this.href).then((r) => r.text())]);
  };
  for (const kind of ["csv", "latex", "json"]) document.getElementById("get-" + kind).click();
  while (links.length < 3) await later(20);
  links.sort((a, b) => (a[0] < b[0] ? -1 : 1));
  results.files = await Promise.all(links.map(async ([name, text]) => [name, (await text).slice(0, 14)]));
  results.versus = document.querySelectorAll("#versus canvas").length;
  const key = (element, name) => element.dispatchEvent(new KeyboardEvent("keydown", { key: name, bubbles: true }));
  document.querySelector("#matrix td.cell").focus();
  for (const name of ["ArrowDown", "ArrowRight", "ArrowRight", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"])
    key(document.activeElement, name);
  const all = (place, selector) => [...place.querySelectorAll(selector)];
  const cell = (c) => [c.textContent, getComputedStyle(c).backgroundColor];
  results.scales = all(document, "#matrix td.limits").map((c) => all(c, ".ends span").map((s) => s.textContent));
  results.cells = all(document, "#matrix tbody tr").map((row) => all(row, "td.cell").map(cell));
  const grounds = all(document, "#matrix .scale").map((s) => getComputedStyle(s).backgroundImage);
  results.ends = grounds.map((ground, k) => results.cells.filter((row) => ground.includes(row[k][1])).length);
  results.stops = document.querySelectorAll('#matrix td[tabindex="0"]').length;
  key(document.activeElement, "Enter");
  await later(50);
  results.walked = [document.getElementById("sample").value, document.getElementById("method").value];
  key(document.querySelectorAll("#board tbody tr")[0], " ");
  results.row = document.getElementById("method").value;
  await later(50);
  document.querySelector("#panels .enlarge").click();
  results.wide = document.querySelectorAll("#panels .wide").length;
  pick("over", "street again");
  await later(50);
  results.over = [document.getElementById("sample").value, names()[2]];
  document.getElementById("theme").click();
  results.theme = document.documentElement.dataset.theme;
  const out = document.createElement("pre");
  out.id = "results";
  out.textContent = JSON.stringify(results);
  document.body.append(out);
})().catch((e) => { document.title = "error: " + e.message; });
</script>
"""


def browse(path, html):
    """The page's elements after its script has run, from Chromium's DOM dump."""
    path.write_text(html)
    command = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--virtual-time-budget=20000",
        "--dump-dom",
    ]
    answer = subprocess.run(
        [*command, f"{path.as_uri()}#theme=light"],
        capture_output=True,
        timeout=120,
        check=True,
    )
    return answer.stdout.decode()


needs_chromium = pytest.mark.skipif(
    CHROMIUM is None and not os.environ.get("TWINLENS_REQUIRE_CHROMIUM"),
    reason="no Chromium on this machine",
)
"""Where a browser is required, as in continuous integration, its absence is a failure instead of a skip."""


@needs_chromium
def test_sorting_selecting_inspecting_and_downloading(tmp_path):
    html = page_html(*made(("low", "high", "none")))
    # The page's own policy would stop this test's script; the next test runs under it.
    html = re.sub(r"<meta http-equiv=[^>]+>", "", html).replace(
        "</body>", DRIVER + "</body>"
    )
    dom = browse(tmp_path / "page.html", html)
    results = json.loads(
        re.search(r'<pre id="results">(.*?)</pre>', dom, re.S)[1]
        .replace("&lt;", "<")
        .replace("&gt;", ">")
    )
    # Of the 23 known rows 11 are at 9 px and 12 at 5 px: "low" is right more often, and wrong wherever it is near.
    assert results["first"] == ["low", "high", LOST]
    assert results["flipped"] == ["high", "low", LOST]
    assert results["near"] == ["low", "high", LOST], (
        "worst first, as the reader had asked"
    )
    assert results["head"][-1] == "time/MP"
    assert results["panels"] == [
        "Left image",
        "Right image",
        "True disparity",
        "Disparity",
        "|Error|",
        "Signed error",
    ]
    assert results["unknown"] == [196, 200, 206]
    assert results["hole"] == [102, 112, 127]
    assert max(results["zero"]) < 30
    assert results["off"][2] > 200 > results["off"][0]
    assert results["readout"] == "x 20  y 5:  truth 9.00 px, 5.00 px, error −4.00"
    assert results["files"][0] == ["board.csv", "method,sample,"]
    assert [name for name, _ in results["files"]] == [
        "board.csv",
        "board.json",
        "board.tex",
    ]
    assert results["versus"] == 6
    for k, (best, worst) in enumerate(results["scales"]):
        numbers = [
            float(row[k][0]) for row in results["cells"] if not row[k][0].isalpha()
        ]
        assert (float(best), float(worst)) == (min(numbers), max(numbers)), (
            "the scale ends where its column does"
        )
    assert results["ends"] == [2, 2], "in the colours of the best cell and the worst"
    assert results["stops"] == 1
    assert results["walked"] == ["street again", "high"], (
        "by arrows to the second row and column"
    )
    assert results["row"] == "low"
    assert results["wide"] == 1
    assert results["over"] == ["street again", "crash"]
    assert results["theme"] == "dark"


@needs_chromium
def test_a_method_that_was_not_run_everywhere_says_so(tmp_path):
    board, samples, _ = made()
    both = run_benchmark(
        samples[:1],
        [Flat("late", 5)],
        protocol=board.protocols,
        regions=board.regions,
        board=board,
    )
    dom = browse(tmp_path / "page.html", page_html(both))
    assert "1 of 2 samples<" in dom
    assert "street again: not run" in dom


@needs_chromium
def test_sparsification_is_drawn_for_methods_with_a_confidence(tmp_path):
    dom = browse(tmp_path / "page.html", page_html(ranked_board()))
    card = re.search(
        r'<figure class="card chart whole" id="sparse-card">.*?</figure>', dom, re.S
    )[0]
    assert "errors above 2 px" in card
    assert re.findall(r'<polyline class="curve ([a-z]*)"', card) == ["ideal", "on"]
    best, curve = (
        [tuple(map(float, point.split(","))) for point in points.split()]
        for points in re.findall(r'points="([^"]+)"', card)
    )
    assert len(curve) == 20
    assert curve[-1] == best[-1], "both end at the error rate of all pixels"
    assert all(a[1] <= b[1] + 0.1 for a, b in zip(curve, best, strict=True)), (
        "no curve is below the lowest possible"
    )
    assert 'id="sparse-card" hidden' in browse(
        tmp_path / "plain.html", page_html(made()[0])
    )


@needs_chromium
def test_a_board_on_which_everything_failed_lists_every_failure(tmp_path):
    board = run_benchmark(
        [pair(), pair("lane")],
        [Flat("first", None), Flat("second", None)],
        warm_up=False,
    )
    dom = browse(tmp_path / "page.html", page_html(board))
    assert 'data-ready="1"' in dom
    listed = re.search(r'<div id="failed">(.*?)</div>', dom, re.S)[1]
    assert re.sub(r"<[^>]+>", "", listed) == (
        "crash first on every sample: RuntimeError: firstcrash second on every sample: RuntimeError: second"
    )
    assert "0 of 2 samples, 2 failed" in dom
    assert "Nothing was scored." in dom


@needs_chromium
def test_names_with_markup_are_shown_as_text(tmp_path):
    board, samples, maps = made(
        (EVIL, "b" + EVIL, "c" + EVIL), sample="s" + EVIL, title="t" + EVIL
    )
    dom = browse(tmp_path / "page.html", page_html(board, samples, maps))
    assert 'data-ready="1"' in dom
    assert "<title>pwned</title>" not in dom
    assert not [
        tag
        for tag, attributes in Elements(dom).tags
        if tag == "img" and ("src", "x") in attributes
    ]
    assert dom.count("&lt;/script&gt;&lt;img src=x") > 10
