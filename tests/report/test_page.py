"""The page is self-contained and safe for all names; in Chromium its controls work."""

import base64
import hashlib
import json
import os
import re
import shutil
import subprocess
import zlib
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest

from twinlens.errors import OutputError
from twinlens.report import write_page
from twinlens.report.page import page_html
from twinlens.scoring import (
    PROTOCOLS,
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


def document_of(*contents, **options):
    """The JSON document in a page."""
    return json.loads(Elements(page_html(*contents, **options)).data)


def made_with_evil_names():
    return made((EVIL, "b" + EVIL, "c" + EVIL), sample="s" + EVIL, title="t" + EVIL)


def test_names_cannot_inject_markup():
    """The page has the elements of one with harmless names, and the names arrive as they are."""
    plain = Elements(page_html(*made(("a", "b", "c"))))
    evil = Elements(page_html(*made_with_evil_names()))
    assert evil.tags == plain.tags
    document = json.loads(evil.data)
    assert [m["name"] for m in document["methods"]] == [EVIL, "b" + EVIL, "c" + EVIL]
    assert document["samples"][0]["name"] == "s" + EVIL
    assert document["entries"][-1]["failure"][1].startswith("RuntimeError: c</script>")


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


def test_the_page_needs_nothing_from_elsewhere_and_allows_its_own_script_alone():
    text = page_html(*made())
    for _, attributes in Elements(text).tags:
        for name, value in attributes:
            assert name not in ("src", "href") or value.startswith("#")
    addresses = set(re.findall(r"https?://[^\s\"'`)]+", text))
    assert addresses <= {"http://www.w3.org/2000/svg"}
    assert "@import" not in text
    assert "url(" not in text
    script = re.search(r"<script>(.*)</script>", text, re.S)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text)[1]
    assert f"script-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'")


def test_the_page_says_what_the_board_says():
    board, samples, maps = made(("low", "high", "none"))
    document = document_of(board, samples, maps)
    of_page = document["means"]["middlebury-v3"]["near"]["low"]["v"]
    mean = board.mean("low", "middlebury-v3", "near").metrics
    assert of_page["totbad2.0"] == pytest.approx(mean["totbad2.0"], rel=1e-5)
    assert document["means"]["eth3d"]["all"]["none"]["v"]["bad1.0"] is None
    downloads = document["downloads"]
    assert inflated(downloads["csv"]) == board_csv(board)
    assert inflated(downloads["json"]) == board_to_json(board)
    latex = board_latex(board, "eth3d", "near")
    assert inflated(downloads["latex"]["eth3d"]["near"]) == latex
    place = PROTOCOLS["middlebury-v3"].metrics.index("avgerr")
    error = document["entries"][0]["regions"]["all"]["v"][place]
    assert error == pytest.approx(board.entries[0].value("all", "avgerr"), rel=1e-5)
    assert set(document["samples"][0]["pictures"]["maps"]) == {"low", "high"}


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
    mean = document_of(both)["means"]["eth3d"]["all"]["late"]
    assert (mean["n"], mean["failed"], mean["missing"]) == (1, [], ["street again"])
    assert mean["v"]["bad1.0"] is None


def test_samples_and_maps_are_optional_and_unknown_samples_ignored():
    board, samples, _ = made()
    assert document_of(board)["samples"][0]["pictures"] is None
    assert len(page_html(board, [pair("unknown")])) == len(page_html(board))
    pictures = document_of(board, samples)["samples"][0]["pictures"]
    assert (pictures["maps"], pictures["noise"]) == ({}, "")


@pytest.mark.parametrize(
    ("max_width", "stride"), [(40, 1), (39, 2), (14, 3), (13, 4), (1, 40)]
)
def test_a_map_is_at_most_as_wide_as_asked(max_width, stride):
    pictures = document_of(*made(), max_width=max_width)["samples"][0]["pictures"]
    for packed in (pictures["truth"], pictures["maps"]["low"]):
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
    for name in ("first", "second"):
        assert f"RuntimeError: {name}" in listed
    assert "0 of 2 samples, 2 failed" in dom
    assert "Nothing was scored." in dom


@needs_chromium
def test_names_with_markup_are_shown_as_text(tmp_path):
    dom = browse(tmp_path / "page.html", page_html(*made_with_evil_names()))
    assert 'data-ready="1"' in dom
    assert "<title>pwned</title>" not in dom
    assert not [
        tag
        for tag, attributes in Elements(dom).tags
        if tag == "img" and ("src", "x") in attributes
    ]
    assert dom.count("&lt;/script&gt;&lt;img src=x") > 10
