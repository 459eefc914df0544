"""The page of a large board, 2 lenses x 6 scenes x 8 methods of which two fail, from commands to a clicked pixel."""

import html
import json
import re

import pytest

from tests.report.test_page import browse, needs_chromium

MATCHERS = """
import numpy as np

def crash(left, right, *, num_disparities, min_disparity):
    raise ValueError(f"cannot normalise {left.shape}")

def wrong_shape(left, right, *, num_disparities, min_disparity):
    return np.zeros((3, 4), np.float32)
"""
SCENES = ("cards", "fence", "room", "spheres", "staircase", "tabletop")
GOOD = ["sad", "ssd", "zncc", "census", "sgm", "zncc:block_size=15"]
BAD = ["mine=function:matchers.py:crash", "other=function:matchers.py:wrong_shape"]
PIXEL = (40, 30)
SIZE = (160, 120)
FRAME = """<!doctype html><body>
<iframe id="page" width="{width}" height="900" srcdoc="{page}"></iframe>
<script>
const later = (ms) => new Promise((done) => setTimeout(done, ms));
(async () => {{
  const frame = document.getElementById("page"), page = () => frame.contentDocument;
  while (!page() || !page().documentElement || !page().documentElement.dataset.ready) await later(20);
  const all = (selector) => [...page().querySelectorAll(selector)], results = {{}};
  const texts = (selector) => all(selector).map((element) => element.textContent);
  results.wider = page().documentElement.scrollWidth - frame.clientWidth;
  results.rows = texts("#board tbody tr .name");
  results.columns = texts("#matrix thead th").slice(1);
  results.groups = texts("#groups thead th").slice(1);
  results.failures = texts("#failed p");
  results.cut = all(".name").map((name) => name.scrollWidth - name.clientWidth);
  const scrolled = page().querySelector("#groups").parentElement;
  results.hidden = scrolled.scrollWidth - scrolled.clientWidth;
  const view = page().querySelectorAll("#panels .view")[3], box = view.getBoundingClientRect();
  const at = {{ clientX: box.left + box.width * {u} / {columns}, clientY: box.top + box.height * {v} / {rows} }};
  view.dispatchEvent(new frame.contentWindow.MouseEvent("click", at));
  for (let i = 0; i < 600 && !all("#why .why-row").length; i++) await later(20);
  results.pixel = [page().getElementById("at-u").value, page().getElementById("at-v").value];
  const text = (row, part) => row.querySelector(part).textContent;
  results.why = all("#why .why-row").map((row) => [text(row, "b"), text(row, "p")]);
  const out = document.createElement("pre");
  out.id = "results";
  out.textContent = JSON.stringify(results);
  document.body.append(out);
}})();
</script></body>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("board")


@pytest.fixture(scope="module")
def page(folder):
    """The page of the board, made by three commands."""
    from twinlens.cli import run

    (folder / "matchers.py").write_text(MATCHERS)
    lenses = ["--lens", "f/1.4", "--lens", "f/8", "--sensor-width-mm", "36"]
    size = ["--size", "x".join(map(str, SIZE)), "--spp", "2", "--no-denoise"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run(["render", *SCENES, *lenses, *size, "-o", "data"]) == 0
        methods = ",".join([*GOOD, *BAD])
        arguments = ["--methods", methods, "--by", "lens", "-o", "board"]
        assert run(["benchmark", "data", *arguments]) == 0
    return (folder / "board/index.html").read_text()


@pytest.mark.slow
@needs_chromium
@pytest.mark.parametrize("width", [1280, 390])
def test_the_page_is_whole_and_a_clicked_pixel_is_explained(page, folder, width):
    frame = FRAME.format(
        width=width,
        page=html.escape(page),
        u=PIXEL[0] + 0.5,
        v=PIXEL[1] + 0.5,
        columns=SIZE[0],
        rows=SIZE[1],
    )
    dom = browse(folder / f"frame{width}.html", frame)
    text = re.search(r'<pre id="results">(.*?)</pre>', dom, re.S)[1]
    results = json.loads(html.unescape(text))
    assert results["wider"] <= 0
    assert results["hidden"] <= 0, "the differences of the lenses can be read at once"
    assert max(results["cut"]) <= 0
    assert len(results["rows"]) == 8
    failed = [row for row in results["rows"] if "0 of 12 samples, 12 failed" in row]
    assert len(failed) == 2
    assert results["rows"][-2:] == failed
    assert len(results["columns"]) == 12
    assert all("ndisp" in column for column in results["columns"])
    assert results["groups"][0].startswith("f/1.4")
    assert results["groups"][2].startswith("f/8 − f/1.4")
    crash, shape = results["failures"]
    assert "mine on every sample: ValueError: cannot normalise (120, 160, 3)" in crash
    assert "other on every sample" in shape
    assert results["pixel"] == [str(number) for number in PIXEL]
    explained = dict(results["why"])
    assert set(explained) == set(GOOD)
    assert all(re.match(r"Right|Wrong", reason) for reason in explained.values())
