"""The page of a dataset: its pictures show the channels, it resumes, and in Chromium its filters and dialog work."""

import html
import io
import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image

from tests.dataset.dataset_scene import list_samples, sample
from tests.report.test_page import EVIL, Elements, browse, needs_chromium
from twinlens.dataset import Dataset, write_sample
from twinlens.report.dataset_page import write_dataset_page

NAMES = [f"{number:07d}" for number in range(6)]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Six samples of scenes a and b; the drawn baseline of sample n is n / 10."""
    home = tmp_path_factory.mktemp("shown") / "set"
    made = sample(num_lenses=2)
    write_sample(home / NAMES[0], made)
    for name in NAMES[1:]:
        shutil.copytree(home / NAMES[0], home / name)
    for number, name in enumerate(NAMES):
        path = home / name / "sample.json"
        record = json.loads(path.read_text())
        record["record"]["scene"] = "ab"[number % 2]
        record["record"]["spec"] = {"drawn": {"rig": {"baseline": number / 10}}}
        path.write_text(json.dumps(record))
    list_samples(home, *NAMES)
    return Dataset(home)


def document(folder):
    return json.loads(Elements((folder / "index.html").read_text()).data)


def test_the_page_has_values_and_pictures_of_every_sample(dataset, tmp_path):
    write_dataset_page(dataset, tmp_path)
    shown = document(tmp_path)
    assert shown["names"] == NAMES
    columns = {column["name"]: column for column in shown["columns"]}
    assert columns["scene"]["values"] == ["a", "b"] * 3
    assert columns["rig.baseline"] == {
        "name": "rig.baseline", "number": True, "values": [0.0, 0.1, 0.2, 0.3, 0.4, 0.5],
    }  # fmt: skip
    assert shown["problems"] == {}
    titles = [title for title, _ in shown["tiles"]["kinds"][0]]
    assert titles[:2] == ["left", "right"]
    assert titles[2].startswith("left, ")
    assert titles[3:] == [
        "disparity",
        "visible in both",
        "depth",
        "normals",
        "objects",
        "blur circle",
    ]


def test_tiles_show_the_channels(dataset, tmp_path):
    """Compared with the files of the sample: WebP is lossy, so by means over halves of the image."""
    write_dataset_page(dataset, tmp_path)
    data = (tmp_path / "channels" / f"{NAMES[1]}.webp").read_bytes()
    strip = np.asarray(Image.open(io.BytesIO(data)), float)
    assert strip.shape == (240, 9 * 320, 3)
    tiles = np.split(strip, 9, axis=1)
    for number, image in ((0, dataset[1].im0), (1, dataset[1].im1)):
        np.testing.assert_allclose(
            tiles[number].mean(axis=(0, 1)), image.mean(axis=(0, 1)), atol=2
        )
    mask = np.kron(dataset[1].mask0_nonocc, np.ones((5, 5)))
    assert np.abs(tiles[4][..., 0] - mask).mean() < 6
    ids = np.kron(dataset[1].object_id0, np.ones((5, 5)))
    for number in (1, 2):
        # One colour an object, black where nothing was hit.
        colours = tiles[7][ids == number]
        assert np.abs(colours - np.median(colours, axis=0)).mean() < 12
    assert tiles[7][ids == 0].mean() < 12
    apart = tiles[7][ids == 1].mean(axis=0) - tiles[7][ids == 2].mean(axis=0)
    assert np.abs(apart).max() > 100
    with Image.open(tmp_path / "thumbnails" / f"{NAMES[1]}.webp") as thumbnail:
        assert thumbnail.size == (160, 120)


def test_a_second_run_keeps_pictures_and_removes_those_of_lost_samples(
    dataset, tmp_path
):
    write_dataset_page(dataset, tmp_path)
    kept = tmp_path / "channels" / f"{NAMES[1]}.webp"
    kept.write_bytes(b"mine")
    changed = tmp_path / "channels" / f"{NAMES[2]}.webp"
    changed.unlink()
    write_dataset_page(dataset[:3], tmp_path)
    assert kept.read_bytes() == b"mine"
    assert changed.stat().st_size > 1000
    assert sorted(path.stem for path in (tmp_path / "channels").iterdir()) == NAMES[:3]
    assert document(tmp_path)["names"] == NAMES[:3]


def test_an_unreadable_sample_is_named_and_the_others_shown(dataset, tmp_path):
    home = tmp_path / "set"
    shutil.copytree(dataset.path, home)
    (home / NAMES[0] / "im0.png").write_bytes(b"damaged")
    write_dataset_page(Dataset(home), tmp_path / "page")
    problems = document(tmp_path / "page")["problems"]
    assert list(problems) == [NAMES[0]]
    assert "im0.png: not a PNG" in problems[NAMES[0]]
    assert (tmp_path / "page/thumbnails" / f"{NAMES[1]}.webp").exists()


def test_names_cannot_inject_markup(dataset, tmp_path):
    home = tmp_path / "set"
    shutil.copytree(dataset.path, home)
    path = home / NAMES[0] / "sample.json"
    record = json.loads(path.read_text())
    record["record"]["scene"] = EVIL
    path.write_text(json.dumps(record))
    write_dataset_page(Dataset(home), tmp_path / "page")
    tags = Elements((tmp_path / "page/index.html").read_text()).tags
    assert not [tag for tag in tags if tag[0] == "img"]
    assert EVIL in document(tmp_path / "page")["columns"][0]["values"]


DRIVE = """<!doctype html><body>
<iframe id="page" width="{width}" height="800" srcdoc="{page}"></iframe>
<script>
const later = (ms) => new Promise((done) => setTimeout(done, ms));
const results = {{}};
(async () => {{
  const page = () => document.getElementById("page").contentDocument;
  while (!page() || !page().documentElement || !page().documentElement.dataset.ready) await later(20);
  const find = (selector) => page().querySelector(selector), all = (selector) => [...page().querySelectorAll(selector)];
  const names = async () => {{
    find("#grid").scrollIntoView({{ behavior: "instant" }});
    // Without a screen, events of scrolling may not come.
    page().defaultView.dispatchEvent(new Event("scroll"));
    await later(100);
    return all(".cell").map((cell) => cell.title).sort();
  }};
  results.wider = page().documentElement.scrollWidth - page().documentElement.clientWidth;
  find("#values").open = true;
  await later(50);
  results.count = find("#count").textContent;
  results.histograms = all(".histogram h3").map((title) => title.textContent);
  results.constants = all("#constants dt").map((name) => name.textContent);
  results.all = await names();
  all(".bar").find((bar) => bar.firstChild.textContent === "b").click();
  results.b = await names();
  results.filtered = find("#count").textContent;
  const area = all(".histogram").find((box) => box.firstChild.textContent === "rig.baseline").querySelector("svg");
  const box = area.getBoundingClientRect();
  area.setPointerCapture = () => {{}};
  const {{ PointerEvent }} = document.getElementById("page").contentWindow;
  const at = (share) => ({{ clientX: box.left + share * box.width }});
  const point = (kind, share) => area.dispatchEvent(new PointerEvent(kind, at(share)));
  point("pointerdown", 0.45); point("pointerup", 0.99);
  results.both = await names();
  all("#filters button").forEach((button) => button.click());
  find("#filters button")?.click();
  results.cleared = await names();
  find("#sort").value = "rig.baseline"; find("#turn").value = "-1";
  find("#turn").dispatchEvent(new Event("change"));
  await names();
  results.caption = all(".cell").find((cell) => cell.style.transform.includes("(0px, 0px)")).textContent;
  all(".cell").find((cell) => cell.title === "{name}").click();
  results.open = [find("#sample").open, find("#sample-title").textContent, all("#tiles figure").length];
  results.picture = getComputedStyle(find(".picture")).backgroundImage;
  results.file = find("#tiles a").href.endsWith("/set/{name}/im0.png");
  find("#next").click();
  results.next = find("#sample-title").textContent;
}})().catch((error) => {{ results.error = String(error.stack); }}).then(() => {{
  const out = document.createElement("pre");
  out.id = "results";
  out.textContent = JSON.stringify(results);
  document.body.append(out);
}});
</script></body>"""


@needs_chromium
@pytest.mark.parametrize("width", [390, 1280])
def test_filters_order_and_dialog_work(dataset, tmp_path, width):
    shutil.copytree(dataset.path, tmp_path / "set")
    folder = tmp_path / "set/browse"
    write_dataset_page(Dataset(tmp_path / "set"), folder)
    page = html.escape((folder / "index.html").read_text())
    driver = DRIVE.format(width=width, name=NAMES[4], page=page)
    # Beside the page, so that its pictures are found from within the frame.
    dom = browse(folder / "drive.html", driver)
    text = re.search(r'<pre id="results">(.*?)</pre>', dom, re.S)[1]
    results = json.loads(html.unescape(text))
    assert results.get("error", "") == ""
    assert results["wider"] <= 0
    assert (results["count"], results["filtered"]) == ("6 samples", "3 of 6 samples")
    assert results["histograms"] == ["scene", "rig.baseline"]
    assert "disparity_max" in results["constants"]
    assert results["all"] == results["cleared"] == NAMES
    assert results["b"] == NAMES[1::2]
    assert results["both"] == [NAMES[3], NAMES[5]]
    assert results["caption"] == f"0.5 · {NAMES[5]}"
    assert results["open"] == [True, NAMES[4], 9]
    strip = folder / "channels" / f"{NAMES[4]}.webp"
    assert strip.is_file()
    assert results["picture"] == f'url("{strip.as_uri()}")'
    assert results["file"]
    assert results["next"] == NAMES[3]
