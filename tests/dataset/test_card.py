"""The card, its pictures, and the Croissant metadata: each read back by the library that reads it."""

import io
import json

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from tests.dataset import dataset_scene
from twinlens.dataset import (
    About,
    Dataset,
    Manifest,
    Row,
    describe,
    read_manifest,
    write_manifest,
    write_png,
    write_sample,
)
from twinlens.dataset.pictures import contact_sheet, panels, statistics_figure, tile
from twinlens.dataset.statistics import statistics
from twinlens.errors import FileError, InputError
from twinlens.scoring import motorcycle

rdflib_warns = pytest.mark.filterwarnings("ignore::DeprecationWarning:rdflib")


def made(root, names=("a", "train/0"), split="train", **info):
    rows = []
    for i, name in enumerate(names):
        sample = dataset_scene.sample(num_lenses=1 + i % 2, baseline=0.3 + 0.1 * i)
        sums = write_sample(root / name, sample)
        rows.append(Row(name, sums, {"split": split}))
    write_manifest(
        root, Manifest(tuple(rows), recipe={"count": len(names)}, seed=5, info=info)
    )
    return root


def front_matter(text):
    _, head, body = text.split("---\n", 2)
    return yaml.safe_load(head), body


def test_the_card_tells_what_there_is(tmp_path):
    root = made(
        tmp_path / "set", rejections={"too dark": 3}, versions={"mitsuba": "3.9"}
    )
    assert describe(root) == [
        "README.md",
        "samples.jpg",
        "statistics.png",
        "croissant.json",
    ]
    head, body = front_matter((root / "README.md").read_text())
    assert head["license"] == "unknown"
    assert head["size_categories"] == ["n<1K"]
    for line in (
        "# stereo dataset",
        "| samples | 2 |",
        "| image size | 64 x 48 |",
        "| lenses of a sample | 1 (1), 2 (1) |",
        "| splits | train: 2 |",
        "Rejected draws - too dark: 3.",
        "mitsuba 3.9",
        "Seed: 5.",
        '      "count": 2',
        "Not stated by the maker",
    ):
        assert line in body
    least = min(sample.record["statistics"]["depth"][0] for sample in Dataset(root))
    assert f"| depth | {least:.4g} to " in body


def test_the_card_has_the_noise_of_the_renderer(tmp_path):
    root = made(tmp_path / "set")
    for name, ratio in (("a", 0.2), ("train/0", 0.4)):
        with dataset_scene.edited(root / name) as record:
            record["shots"][0]["record"]["light_paths_over_sensor"] = [0.1, ratio]
    describe(root)
    assert (
        "| renderer noise | 0.2 to 0.4 x sensor noise, median 0.3"
        in (root / "README.md").read_text()
    )


def test_the_same_dataset_gives_the_same_files(tmp_path):
    files = ("README.md", "samples.jpg", "statistics.png", "croissant.json")
    first, second = (made(tmp_path / kind) for kind in "ab")
    assert describe(first) == list(files)
    describe(second)
    for name in files:
        assert (first / name).read_bytes() == (second / name).read_bytes()


def test_a_readme_of_someone_elses_is_left_alone(tmp_path):
    made(tmp_path)
    (tmp_path / "README.md").write_text("# my thesis\n")
    assert describe(tmp_path)[0] == "CARD.md"
    assert (tmp_path / "README.md").read_text() == "# my thesis\n"
    (tmp_path / "README.md").unlink()
    assert describe(tmp_path)[0] == describe(tmp_path)[0] == "README.md"


def test_texts_of_the_maker_are_kept(tmp_path):
    made(tmp_path / "set")
    odd = 'Blur: "a" [b]\n--- # c'
    describe(tmp_path / "set", About(name=odd, license="CC-BY-4.0", creator="Ada"))
    describe(tmp_path / "set", About(url="https://example.org/set", license="MIT"))
    describe(tmp_path / "set")
    head, body = front_matter((tmp_path / "set" / "README.md").read_text())
    assert (head["pretty_name"], head["license"]) == (odd, "mit")
    assert "Made by Ada." in body
    record = json.loads((tmp_path / "set" / "croissant.json").read_text())
    assert (record["url"], record["license"]) == ("https://example.org/set", "MIT")
    assert read_manifest(tmp_path / "set").info["about"]["creator"] == "Ada"


def test_a_licence_may_be_an_address(tmp_path):
    describe(made(tmp_path), About(license="https://example.org/terms"))
    head, _ = front_matter((tmp_path / "README.md").read_text())
    assert (head["license"], head["license_link"]) == (
        "other",
        "https://example.org/terms",
    )


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ({"licence": "MIT"}, "about: unknown key 'licence'; did you mean 'license'"),
        ({"url": 7}, "about.url: must be a string"),
    ],
)
def test_invalid_texts_are_rejected(tmp_path, texts, message):
    made(tmp_path, about=texts)
    with pytest.raises(FileError, match=message):
        describe(tmp_path)
    with pytest.raises(InputError):
        About.of("MIT")


def test_plain_folders_have_a_card(tmp_path):
    pair = motorcycle()
    write_png(tmp_path / "m" / "im0.png", pair.im0)
    write_png(tmp_path / "m" / "im1.png", pair.im1)
    describe(tmp_path)
    assert "| disparity | - |" in (tmp_path / "README.md").read_text()
    with pytest.raises(FileError, match=r"dataset\.json: no such file"):
        describe(tmp_path, About(license="MIT"))


def test_unreadable_samples_are_listed_and_not_counted(tmp_path):
    made(tmp_path, names=("a", "b", "c"))
    (tmp_path / "a" / "sample.json").write_text("{")
    (tmp_path / "b" / "im0.png").unlink()
    describe(tmp_path)
    text = (tmp_path / "README.md").read_text()
    assert "| samples | 2 |" in text
    assert "Unreadable, and not counted: a." in text
    with Image.open(tmp_path / "samples.jpg") as sheet:
        assert sheet.size[0] == 160 + 8
    for name in ("b", "c"):
        (tmp_path / name / "sample.json").write_text("{")
    with pytest.raises(FileError, match="no sample can be read"):
        describe(tmp_path)


def test_the_contact_sheet_shows_each_image():
    colors = [(250, 0, 0), (0, 250, 0), (0, 0, 250)]
    images = [np.full((60, 80, 3), color, np.uint8) for color in colors]
    images += [np.full((90, 60), 200 * 257, np.uint16)]
    sheet = contact_sheet(list(map(tile, images)), columns=3)
    assert sheet.size == (3 * 164 + 4, 2 * 124 + 4)
    for i, color in enumerate([*colors, (200, 200, 200), (255, 255, 255)]):
        pixel = sheet.getpixel((84 + i % 3 * 164, 64 + i // 3 * 124))
        assert_allclose(pixel, color, atol=6)
    with pytest.raises(InputError, match="one or more images"):
        contact_sheet([])


@pytest.mark.parametrize("count", [0, 3])
def test_the_figure_of_any_statistics(count):
    sample = statistics(dataset_scene.sample())
    same = sample | {"disparity": [0.0] * 33, "blur_px": []}
    data, again = (statistics_figure([sample, same, {}][:count]) for _ in range(2))
    assert data == again
    picture = Image.open(io.BytesIO(data))
    assert picture.size[0] > 500
    assert np.ptp(np.asarray(picture)[..., 0]) > 100
    assert not {"Software", "Creation Time", "date"} & set(picture.info)


def drawn(*many):
    return [panel.xlabel.partition(" ")[0] for panel in panels(many)]


def test_the_figure_omits_quantities_that_no_sample_has():
    through_lenses = statistics(dataset_scene.sample(num_lenses=2))
    # A pinhole: all blur circles have diameter 0.
    sharp = through_lenses | {"blur_px": [[0.0] * 33]}
    single = sharp | {"cameras": 1, "disparity": [], "occluded": 0.0}
    assert (
        drawn(through_lenses)
        == drawn(sharp, through_lenses)
        == ["disparity", "depth", "blur", "pixels"]
    )
    assert drawn(sharp, sharp) == ["disparity", "depth", "pixels"]
    assert drawn(single) == ["depth"]
    assert drawn({}) == drawn() == []
    heights = [
        Image.open(io.BytesIO(statistics_figure(many))).height
        for many in ([sharp], [through_lenses])
    ]
    assert heights[1] == 2 * heights[0], "one row of three panels, two rows of two"


@rdflib_warns
def test_mlcroissant_reads_the_metadata(tmp_path):
    mlc = pytest.importorskip("mlcroissant")
    data = Dataset(made(tmp_path / "set"))
    describe(data)
    read = mlc.Dataset(jsonld=str(tmp_path / "set" / "croissant.json"))
    assert not read.metadata.ctx.issues.errors
    names = [
        {key: value.decode() for key, value in row.items()}
        for row in read.records("samples")
    ]
    assert names == [
        {"samples/name": name, "samples/split": "train"} for name in ("a", "train/0")
    ]
    images = {
        row["im0-png/folder"].decode(): row["im0-png/content"]
        for row in read.records("im0-png")
    }
    assert set(images) == {"a", "train/0", "train/0/lens-1"}
    assert_array_equal(np.asarray(images["train/0/lens-1"]), data[1].lens(1).im0)
    for row in read.records("disp1-pfm"):
        assert_array_equal(
            row["disp1-pfm/content"], data[row["disp1-pfm/folder"].decode()].disp1
        )
    for row in read.records("truth0-exr"):
        path = data[row["truth0-exr/folder"].decode()].folder / "truth0.exr"
        assert row["truth0-exr/content"] == path.read_bytes()
    described = {record_set.name for record_set in read.metadata.record_sets} - {
        "samples"
    }
    assert described == {
        name.rpartition("/")[2].replace(".", "-")
        for s in data
        for name in s.row["files"]
    }


@rdflib_warns
def test_croissant_with_all_texts_has_no_warnings(tmp_path):
    mlc = pytest.importorskip("mlcroissant")
    texts = About(
        name="set",
        description="Pairs.",
        license="CC-BY-4.0",
        creator="Ada",
        url="https://example.org",
        published="2026-01-31",
        cite_as="@misc{ada}",
    )
    describe(made(tmp_path), texts)
    issues = mlc.Dataset(jsonld=str(tmp_path / "croissant.json")).metadata.ctx.issues
    assert not issues.errors
    assert not issues.warnings
