"""Costs of a pixel on a board's page: in Chromium, curves equal Python's, and reasons those of a known scene."""

import html
import json
import re

import numpy as np
import pytest
from scipy import ndimage

import twinlens as tl
from tests.report.test_page import Elements, browse, needs_chromium
from twinlens.matching.costs import COSTS
from twinlens.matching.methods import matcher_of_spec, parse_method
from twinlens.report.page import page_html
from twinlens.scoring import Pair, run_benchmark

RADIUS, NDISP, RUN = 4, 20, ("mine", "sad9")
METHODS = [
    *(f"{name}:block_size=5,census_window=3" for name in COSTS),
    "sad:block_size=7,prefilter=xsobel",
    "mine=zncc:block_size=9",
    "sad9=sad:block_size=9",
]


class Listed:
    """A method of the board. It matches the scene, if it is one of the methods run, and nothing else."""

    def __init__(self, text):
        self.given = parse_method(text)
        self.name, self.spec = self.given.name, self.given.spec

    def match(self, left, right, **search):
        if left.shape == (132, 200) and self.name in RUN:
            return self.given.match(left, right, **search)
        return np.full(left.shape[:2], 4, np.float32)


def textured_pair(name, dtype, low=0, seed=0):
    rng = np.random.default_rng(seed)
    top = np.iinfo(dtype).max
    right = rng.integers(0, top, (26, 40), dtype=dtype)
    right[8:14, 10:30] = top  # also flat and saturated windows
    right[16:20, 10:24] = 0
    left = np.roll(right, 4, axis=1)
    return Pair(name, left, right, np.full((26, 40), 4, np.float32), None, 12, min_disparity=low)


def scene():
    """A pair with one cause of errors per region, and the map of causes: names, "" elsewhere."""
    rng = np.random.default_rng(7)
    height, width = 132, 200

    def texture(*shape):
        return np.clip(128 + 60 * ndimage.gaussian_filter(rng.normal(size=shape), 0.9) / 0.3, 0, 240)

    left, truth, cause = texture(height, width), np.full((height, width), 6), np.full((height, width), "", object)
    columns = np.arange(width)

    def region(kind, rows, cols):
        inner = np.s_[rows.start + RADIUS : rows.stop - RADIUS, cols.start + RADIUS : cols.stop - RADIUS]
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
    visible = (partner >= 0) & (np.take_along_axis(nearest, np.clip(partner, 0, width - 1), axis=1) == truth)
    shifted = blurred[0], slice(blurred[1].start - 6, blurred[1].stop - 6)
    right[shifted] = ndimage.gaussian_filter(right, 2.5)[shifted]
    cause[~visible] = "occluded"
    edge = ndimage.binary_dilation(truth == 15, np.ones((7, 7))) & (truth == 6) & visible
    cause[edge] = "discontinuity"
    noisy = [
        np.clip(np.rint(image + rng.normal(0, 1.2, image.shape)), 0, 255).astype(np.uint8) for image in (left, right)
    ]
    mask = np.where(visible, 255, 128).astype(np.uint8)
    return Pair("scene", *noisy, truth.astype(np.float32), mask, NDISP), cause


@pytest.fixture(scope="module")
def board_and_samples():
    labelled, cause = scene()
    samples = [textured_pair("eight", np.uint8, -3), textured_pair("sixteen", np.uint16, 0, 1), labelled]
    maps = {}
    methods = [Listed(text) for text in METHODS]
    board = run_benchmark(samples, methods, warm_up=False, on_map=lambda m, s, d: maps.update({(m, s): d}))
    return board, samples, maps, cause


def wrong_pixels(board_and_samples, per_class=6):
    """[(method, column, row, cause)]: pixels of known cause that two methods match wrongly."""
    _, samples, maps, cause = board_and_samples
    rng, chosen = np.random.default_rng(11), []
    for name in RUN:
        wrong = np.abs(maps[name, "scene"] - samples[2].disp0) > 2.5
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
(async () => {
  while (!document.documentElement.dataset.ready) await later(20);
  for (const [sample, x, y] of asked.curves) {
    const s = byName(data.samples, sample), pair = await greyOf(s.pictures);
    const curve = (m) => [...costCurve(m.curve, ...imagesFor(m.curve, pair), x, y, s.low, s.ndisp)];
    results.curves.push(data.methods.map((m) => curve(m).map((c) => (c === Infinity ? null : c))));
  }
  for (const [name, x, y] of asked.reasons) {
    look("scene", name);
    await pickPixel(x, y);
    const row = [...document.querySelectorAll("#why .why-row")].find((r) => r.querySelector("b").textContent === name);
    results.reasons.push([row.dataset.kind, row.querySelector("p").textContent]);
  }
  const view = document.querySelectorAll("#panels .view")[3], box = view.getBoundingClientRect();
  const at = { clientX: box.left + box.width * 84.5 / 200, clientY: box.top + box.height * 60.5 / 132 };
  view.dispatchEvent(new MouseEvent("click", at));
  await later(300);
  results.clicked = [document.getElementById("at-u").value, document.getElementById("at-v").value];
  results.rows = document.querySelectorAll("#why .why-row").length;
  results.marks = document.querySelector("#why .why-row").querySelectorAll("line.mark").length;
  results.windows = document.querySelector("#why .why-row").querySelectorAll(".window canvas").length;
  const out = document.createElement("pre");
  out.id = "results";
  out.textContent = JSON.stringify(results);
  document.body.append(out);
})().catch((e) => { document.title = "error: " + e.stack; });
</script>
"""


@needs_chromium
def test_curves_and_reasons(board_and_samples, tmp_path):
    board, samples, maps, _ = board_and_samples
    places = [(s.name, x, y) for s in samples[:2] for x, y in ((20, 10), (0, 0), (39, 25), (17, 17), (30, 5))]
    labelled = wrong_pixels(board_and_samples)
    text = re.sub(r"<meta http-equiv=[^>]+>", "", page_html(board, samples, maps))
    asked = json.dumps({"curves": places, "reasons": [pixel[:3] for pixel in labelled]})
    dom = browse(tmp_path / "page.html", text.replace("</body>", DRIVER.replace("ASKED", asked) + "</body>"))
    found = re.search(r'<pre id="results">(.*?)</pre>', dom, re.S)
    assert found, re.search(r"<title>(.*?)</title>", dom, re.S)[1]
    results = json.loads(html.unescape(found[1]))
    by_name = {sample.name: sample for sample in samples}
    for (name, u, v), curves in zip(places, results["curves"], strict=True):
        sample = by_name[name]
        methods = METHODS if name == "eight" else [text for text in METHODS if "sad" in text or "zncc" in text]
        expected = tl.cost_curve(sample.im0, sample.im1, u, v, methods, **sample.search)
        for method, curve in zip(board.methods, curves, strict=True):
            if method not in expected:
                continue
            costs = np.array([np.inf if cost is None else cost for cost in curve], float)
            np.testing.assert_allclose(costs, expected[method].costs, rtol=1e-4, atol=1e-4, err_msg=f"{method} {name}")
    causes = {kind for *_, kind in labelled}
    assert causes == {"occluded", "texture", "repetition", "discontinuity", "saturation", "range", "blur"}
    answers = [(pixel, *reason) for pixel, reason in zip(labelled, results["reasons"], strict=True)]
    misses = [answer for answer in answers if answer[0][3] != answer[1]]
    assert len(misses) <= 0.1 * len(answers), misses
    assert results["clicked"] == ["84", "60"]
    assert (results["rows"], results["windows"]) == (len(METHODS), 4)
    assert results["marks"] >= 2


def test_a_page_without_room_has_no_full_images(board_and_samples):
    board, samples, maps, _ = board_and_samples

    def grey(**options):
        document = json.loads(Elements(page_html(board, samples, maps, **options)).data)
        return [sample["pictures"]["grey"] is not None for sample in document["samples"]]

    assert grey() == [True, True, True]
    assert grey(budget_bytes=8000) == [True, True, False]
    assert grey(budget_bytes=100) == [False, False, False]


def test_the_page_knows_the_cost_of_a_method():
    matcher = matcher_of_spec(parse_method("mine=census:block_size=3,census_window=5,p1=none").spec)
    assert (matcher.cost, matcher.block_size, matcher.census_window, matcher.p1) == ("census", 3, 5, None)
    assert matcher_of_spec(parse_method("opencv_bm").spec) is None
    assert matcher_of_spec("constant 3") is None
    assert matcher_of_spec("twinlens 9.9 zncc:unheard_of=3") is None
