"""Costs of a pixel on a board's page: in Chromium, curves equal Python's, and reasons those of a known scene."""

import html
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

import twinlens as tl
from tests.report.test_page import Elements, browse, needs_chromium
from twinlens.matching import StereoMatcher
from twinlens.matching.costs import COSTS
from twinlens.matching.methods import matcher_of_spec, parse_method, parse_methods
from twinlens.report.page import page_html
from twinlens.scoring import Pair, run_benchmark, with_disagreements

RADIUS, NDISP = 4, 20
METHODS = [  # the first are quick to compute
    *(f"{name}:block_size=5,census_window=3" for name in COSTS),
    "sad:block_size=7,prefilter=xsobel",
    "mine=zncc:block_size=9",
    "sad9=sad:block_size=9",
    "sgm",
    "sgm4:cost=sad,block_size=3",
    "zncc:block_size=5,optimisation=sgm8,p1=0.05",
    "shiftable:block_size=5",
    "adaptive:block_size=9",
    "sad:support=adaptive,block_size=11,noise=9",
    "cross:block_size=9",
    "sad:support=cross,block_size=7,contrast=60",
    "weighted:block_size=5",
    "guided:block_size=5",
    "sgm:support=cross,block_size=5",
]
QUICK = METHODS.index("sgm") + 1


class Listed:
    """A method of the board that is not run: it returns the disparity of `textured_pair`."""

    def __init__(self, text):
        parsed = parse_method(text)
        self.name, self.spec = parsed.name, parsed.spec

    def match(self, left, right, **search):
        return np.full(left.shape[:2], 4, np.float32)


def textured_pair(name, dtype, low=0, seed=0):
    rng = np.random.default_rng(seed)
    top = np.iinfo(dtype).max
    right = rng.integers(0, top, (26, 40), dtype=dtype)
    right[8:14, 10:30] = top  # also flat and saturated windows
    right[16:20, 10:24] = 0
    left = np.roll(right, 4, axis=1)
    return Pair(
        name, left, right, np.full((26, 40), 4, np.float32), None, 12, min_disparity=low
    )


def scene():
    """A pair with one cause of errors per region, and the map of causes: names, "" elsewhere."""
    rng = np.random.default_rng(7)
    height, width = 132, 200

    def texture(*shape):
        return np.clip(
            128 + 60 * ndimage.gaussian_filter(rng.normal(size=shape), 0.9) / 0.3,
            0,
            240,
        )

    left, truth, cause = (
        texture(height, width),
        np.full((height, width), 6),
        np.full((height, width), "", object),
    )
    columns = np.arange(width)

    def region(kind, rows, cols):
        inner = np.s_[
            rows.start + RADIUS : rows.stop - RADIUS,
            cols.start + RADIUS : cols.stop - RADIUS,
        ]
        cause[inner] = kind
        return rows, cols

    left[region("texture", slice(4, 34), slice(30, 80))] = 120
    stripes = 128 + 70 * np.sin(2 * np.pi * columns / 5)
    repeated = region("repetition", slice(4, 34), slice(100, 170))
    left[repeated] = np.broadcast_to(stripes, left.shape)[repeated]
    left[region("saturation", slice(96, 128), slice(30, 80))] = 255
    blurred = region("blur", slice(96, 128), slice(100, 170))
    truth[region("range", slice(64, 92), slice(150, 190))] = 34
    front = np.s_[44:88, 60:110]
    left[front], truth[front] = texture(44, 50), 15
    right, nearest = texture(height, width), np.full((height, width), -1)
    for y, x in np.ndindex(height, width):
        u = x - truth[y, x]
        if u >= 0 and truth[y, x] > nearest[y, u]:
            right[y, u], nearest[y, u] = left[y, x], truth[y, x]
    partner = columns - truth
    visible = (partner >= 0) & (
        np.take_along_axis(nearest, np.clip(partner, 0, width - 1), axis=1) == truth
    )
    shifted = blurred[0], slice(blurred[1].start - 6, blurred[1].stop - 6)
    right[shifted] = ndimage.gaussian_filter(right, 2.5)[shifted]
    cause[~visible] = "occluded"
    edge = (
        ndimage.binary_dilation(truth == 15, np.ones((7, 7))) & (truth == 6) & visible
    )
    cause[edge] = "discontinuity"
    noisy = [
        np.clip(np.rint(image + rng.normal(0, 1.2, image.shape)), 0, 255).astype(
            np.uint8
        )
        for image in (left, right)
    ]
    mask = np.where(visible, 255, 128).astype(np.uint8)
    return Pair("scene", *noisy, truth.astype(np.float32), mask, NDISP), cause


@pytest.fixture(scope="module")
def listed():
    """(board, samples, maps) of two textured pairs and all methods."""
    samples = [
        textured_pair("eight", np.uint8, -3),
        textured_pair("sixteen", np.uint16, 0, 1),
    ]
    return matched(samples, [Listed(text) for text in METHODS])


def matched(samples, methods):
    maps = {}
    board = run_benchmark(
        samples, methods, warm_up=False, on_map=lambda m, s, d: maps.update({(m, s): d})
    )
    return board, samples, maps


def wrong_pixels(pair, maps, cause, per_class=4):
    """[(method, column, row, cause)]: pixels of known cause that a method matches wrongly."""
    rng, chosen = np.random.default_rng(11), []
    for (name, _), disparity in maps.items():
        wrong = np.abs(disparity - pair.disp0) > 2.5
        for kind in sorted(set(cause.ravel()) - {""}):
            pixels = np.argwhere(wrong & (cause == kind))
            for row, column in pixels[rng.permutation(len(pixels))[:per_class]]:
                chosen.append((name, int(column), int(row), kind))
    return chosen


DRIVER = """
<script>
window.addEventListener("error", (e) => { document.title = "error: " + e.message; });
const asked = ASKED, results = { curves: [], reasons: [] };
const later = (ms) => new Promise((done) => setTimeout(done, ms));
function finish() {
  const out = document.createElement("pre");
  out.id = "results";
  out.textContent = JSON.stringify(results);
  document.body.append(out);
}
(async () => {
  while (!document.documentElement.dataset.ready) await later(20);
  for (const [sample, x, y] of asked.curves) {
    const s = byName(data.samples, sample), pair = await greyOf(s.pictures);
    const curve = (m) => [...costCurve(m.curve, ...imagesFor(m.curve, pair), x, y, s.low, s.ndisp)];
    const methods = asked.methods.map((name) => byName(data.methods, name));
    results.curves.push(methods.map((m) => curve(m).map((c) => (c === Infinity ? null : c))));
  }
  for (const [name, x, y] of asked.reasons) {
    look("scene", name);
    await pickPixel(x, y);
    const row = [...document.querySelectorAll("#why .why-row")].find((r) => r.querySelector("b").textContent === name);
    results.reasons.push([row.dataset.kind, row.querySelector("p").textContent]);
  }
  if (!asked.reasons.length) return finish();
  const view = document.querySelectorAll("#panels .view")[3], box = view.getBoundingClientRect();
  const at = { clientX: box.left + box.width * 84.5 / 200, clientY: box.top + box.height * 60.5 / 132 };
  view.dispatchEvent(new MouseEvent("click", at));
  await later(300);
  results.clicked = [document.getElementById("at-u").value, document.getElementById("at-v").value];
  results.rows = document.querySelectorAll("#why .why-row").length;
  results.marks = document.querySelector("#why .why-row").querySelectorAll("line.mark").length;
  results.names = [...document.querySelectorAll("#why .why-row:first-child .window")].map((w) => w.className);
  results.windows = document.querySelector("#why .why-row").querySelectorAll(".window canvas").length;
  finish();
})().catch((e) => { document.title = "error: " + e.stack; });
</script>
"""


def asked_page(board, samples, maps, folder, right_maps=None, **asked):
    """The answers of the page's script to `asked`."""
    page = page_html(board, samples, maps, right_maps=right_maps)
    text = re.sub(r"<meta http-equiv=[^>]+>", "", page)
    driver = DRIVER.replace(
        "ASKED", json.dumps({"methods": [], "curves": [], "reasons": [], **asked})
    )
    dom = browse(folder / "page.html", text.replace("</body>", driver + "</body>"))
    shown = re.search(r'<pre id="results">(.*?)</pre>', dom, re.S)
    assert shown, re.search(r"<title>(.*?)</title>", dom, re.S)[1]
    return json.loads(html.unescape(shown[1]))


@needs_chromium
@pytest.mark.parametrize(
    ("sample", "texts"),
    [
        pytest.param(0, METHODS[:QUICK], id="costs"),
        pytest.param(0, METHODS[QUICK:], id="supports", marks=pytest.mark.slow),
        pytest.param(1, METHODS, id="16-bit", marks=pytest.mark.slow),
    ],
)
def test_curves_equal_pythons(listed, tmp_path, sample, texts):
    pair, places = listed[1][sample], ((20, 10), (0, 0), (39, 25), (17, 17), (30, 5))
    names = [parse_method(text).name for text in texts]
    results = asked_page(
        *listed,
        tmp_path,
        methods=names,
        curves=[(pair.name, *place) for place in places],
    )
    for (u, v), curves in zip(places, results["curves"], strict=True):
        expected = tl.cost_curve(pair.im0, pair.im1, u, v, texts, **pair.search)
        for name, curve in zip(names, curves, strict=True):
            costs = np.array(
                [np.inf if cost is None else cost for cost in curve], float
            )
            np.testing.assert_allclose(
                costs,
                expected[name].costs,
                rtol=1e-4,
                atol=1e-4,
                err_msg=f"{name} {u} {v}",
            )


def pythons_reason(pair, maps, name, u, v):
    """Of the estimate as the page stores it, in steps of 1/16 px."""
    text = {"mine": "zncc:block_size=9", "sad9": "sad:block_size=9"}[name]
    (curve,) = tl.cost_curve(pair.im0, pair.im1, u, v, [text], **pair.search).values()
    return tl.scoring.reason_of(
        pair, curve, float(np.rint(maps[name, pair.name][v, u] * 16) / 16)
    )


def assert_same_reason(page, python, where):
    """One kind, and one sentence but for the last digit of its numbers."""
    number = r"[0-9]+(?:\.[0-9]+)?(?:e[+-]?[0-9]+)?"
    assert page[0] == python.kind, where
    assert re.sub(number, "#", page[1]) == re.sub(number, "#", python.text), where
    pairs = zip(
        re.findall(number, page[1]), re.findall(number, python.text), strict=True
    )
    for a, b in pairs:
        assert float(a) == pytest.approx(
            float(b), rel=0.01, abs=0.11 if "." in a else 1
        ), (where, *page)


@needs_chromium
def test_reasons_are_the_known_causes(tmp_path):
    pair, cause = scene()
    page = matched([pair], ["mine=zncc:block_size=9", "sad9=sad:block_size=9"])
    labelled = wrong_pixels(pair, page[2], cause)
    assert {cause for *_, cause in labelled} == {
        "occluded", "texture", "repetition", "discontinuity", "saturation", "range", "blur",
    }  # fmt: skip
    rng = np.random.default_rng(2)
    others = [
        ("mine", int(rng.integers(200)), int(rng.integers(132))) for _ in range(24)
    ]
    asked = [pixel[:3] for pixel in labelled] + others
    results = asked_page(*page, tmp_path, reasons=asked)
    for pixel, answer in zip(asked, results["reasons"], strict=True):
        assert_same_reason(answer, pythons_reason(pair, page[2], *pixel), pixel)
    assert {"right", "other"} < {kind for kind, _ in results["reasons"]}
    shown = results["reasons"][: len(labelled)]
    answers = [(pixel, *reason) for pixel, reason in zip(labelled, shown, strict=True)]
    misses = [answer for answer in answers if answer[0][3] != answer[1]]
    assert len(misses) <= 0.1 * len(answers), misses
    assert results["clicked"] == ["84", "60"]
    assert (results["rows"], results["windows"]) == (2, 4)
    assert results["marks"] >= 2
    assert results["names"] == [
        "window left",
        "window true",
        "window estimate",
        "window rival",
    ]


@needs_chromium
def test_doubts_without_truth_are_pythons(tmp_path):
    """The same scene, whose truth nothing knows: the page names the causes of `reason_of`, and clicks work."""
    scored, cause = scene()
    pair = replace(scored, disp0=None, mask0_nonocc=None)
    maps, right_maps = {}, {}
    board = run_benchmark(
        [pair],
        parse_methods(["mine=zncc:block_size=9", "sad9=sad:block_size=9"]),
        warm_up=False,
        on_map=lambda m, s, d: maps.update({(m, s): d}),
        on_right_map=lambda m, s, d: right_maps.update({(m, s): d}),
    )
    board = with_disagreements(board, maps)
    labelled = wrong_pixels(scored, maps, cause, per_class=2)
    rng = np.random.default_rng(5)
    others = [
        ("sad9", int(rng.integers(200)), int(rng.integers(132))) for _ in range(16)
    ]
    asked = [pixel[:3] for pixel in labelled] + others
    results = asked_page(
        board, [pair], maps, tmp_path, right_maps=right_maps, reasons=asked
    )
    for pixel, answer in zip(asked, results["reasons"], strict=True):
        assert_same_reason(answer, pythons_reason(pair, maps, *pixel), pixel)
    kinds = {kind for kind, _ in results["reasons"]}
    assert {"none", "texture", "range", "repetition", "occluded"} <= kinds
    # Wrong for want of texture, or beyond the right image, or in a repetition: seldom without a sign.
    shown = dict(zip(labelled, results["reasons"], strict=False))
    of_texture = [shown[pixel][0] for pixel in labelled if pixel[3] == "texture"]
    assert of_texture.count("texture") >= 0.7 * len(of_texture)
    assert results["names"] == ["window left", "window estimate", "window rival"]
    assert (results["rows"], results["windows"]) == (2, 3)


def test_a_page_without_room_has_no_full_images(listed):
    board, samples, maps = listed

    def grey(**options):
        document = json.loads(Elements(page_html(board, samples, maps, **options)).data)
        return [
            sample["pictures"]["grey"] is not None for sample in document["samples"]
        ]

    assert grey() == [True, True]
    assert grey(budget_bytes=2000) == [True, False]
    assert grey(budget_bytes=100) == [False, False]


def test_the_matcher_of_a_specification_on_a_board():
    spec = parse_method("mine=census:block_size=3,census_window=5,p1=none").spec
    expected = StereoMatcher("census", block_size=3, census_window=5, p1=None)
    assert matcher_of_spec(spec) == expected
    unknown = parse_method("opencv_bm").spec, "constant 3", "twinlens 9 zncc:unheard=3"
    assert [matcher_of_spec(spec) for spec in unknown] == [None] * 3
