"""The page of a board on a phone: navigation, uncut texts, maps that open large; wording of counts."""

import html
import json
import re
from dataclasses import replace

import pytest

from tests.report.test_page import Flat, browse, needs_chromium, pair
from twinlens.report.page import page_html
from twinlens.scoring import run_benchmark

METHOD = "sgm:cost=zncc,block_size=15,support=guided,optimisation=sgm8,p1=3,p2=40"
FRAME = """<!doctype html><body>
<iframe id="phone" width="{width}" height="800" srcdoc="{page}"></iframe>
<script>
const later = (ms) => new Promise((done) => setTimeout(done, ms));
(async () => {{
  const phone = document.getElementById("phone"), page = () => phone.contentDocument;
  while (!page() || !page().documentElement || !page().documentElement.dataset.ready) await later(20);
  const all = (selector) => [...page().querySelectorAll(selector)], results = {{}};
  const placed = (a, box) => [a.textContent, box.left, box.right, box.height];
  results.links = all("nav a").map((a) => placed(a, a.getBoundingClientRect()));
  const cut = (span) => [span.textContent, span.scrollWidth - span.clientWidth];
  results.captions = all(".panel figcaption span").map(cut);
  results.names = all(".name").map(cut);
  results.width = page().documentElement.clientWidth; // without the scroll bar
  results.wider = page().documentElement.scrollWidth - phone.clientWidth;
  results.counts = page().getElementById("counts").textContent;
  results.summary = page().getElementById("summary").textContent;
  results.over = all("#over option").map((option) => option.textContent);
  results.before = page().querySelector("#panels .view").getBoundingClientRect().width;
  page().querySelector("#panels .enlarge").click();
  await later(50);
  const figure = page().querySelector("#panels .wide").getBoundingClientRect();
  results.figure = [figure.left, figure.top, figure.width, figure.height];
  results.after = page().querySelector("#panels .view").getBoundingClientRect().width;
  page().querySelector("#panels .enlarge").click();
  await later(50);
  results.again = page().querySelector("#panels .view").getBoundingClientRect().width;
  const out = document.createElement("pre");
  out.id = "results";
  out.textContent = JSON.stringify(results);
  document.body.append(out);
}})();
</script></body>"""


def measured_on(tmp_path, width, samples):
    maps = {}
    board = run_benchmark(
        samples,
        [Flat(METHOD, 5)],
        regions=["nonocc"],
        on_map=lambda method, sample, map_: maps.update({(method, sample): map_}),
        warm_up=False,
    )
    page = html.escape(page_html(board, samples, maps))
    dom = browse(tmp_path / "phone.html", FRAME.format(width=width, page=page))
    return json.loads(
        html.unescape(re.search(r'<pre id="results">(.*?)</pre>', dom, re.S)[1])
    )


def noisy(name="street"):
    return replace(pair(name), renderer_noise=0.31)


@needs_chromium
@pytest.mark.parametrize("width", [360, 430])
def test_a_phone_has_the_navigation_whole_texts_and_large_maps(tmp_path, width):
    results = measured_on(tmp_path, width, [noisy()])
    assert [link[0] for link in results["links"]] == ["Leaderboard", "Samples", "Compare"]  # fmt: skip
    for _, left, right, height in results["links"]:
        assert 0 <= left < right <= results["width"]
        assert height >= 20
    texts = [text for text, _ in results["captions"]]
    assert "40 × 24, light paths 0.31 × sensor noise" in texts
    assert all(hidden <= 0 for _, hidden in results["captions"])
    assert any(METHOD in text for text, _ in results["names"])
    assert all(hidden <= 0 for _, hidden in results["names"])
    assert results["wider"] <= 0
    assert results["figure"] == [0, 0, results["width"], 800]
    assert results["after"] > 2 * width > 2 * results["before"]
    assert results["again"] == results["before"]


@needs_chromium
@pytest.mark.parametrize(
    ("names", "counts", "summary", "over"),
    [
        (["street"], "1 of 1 sample has pixels", "1 method on 1 stereo pair,", "mean of 1 sample"),
        (["a", "b"], "2 of 2 samples have pixels", "1 method on 2 stereo pairs,", "mean of 2 samples"),
    ],
)  # fmt: skip
def test_counts_agree_with_their_nouns(tmp_path, names, counts, summary, over):
    results = measured_on(tmp_path, 1280, [noisy(name) for name in names])
    assert results["counts"].startswith(counts)
    assert results["summary"].startswith(summary)
    assert results["over"][0] == over
