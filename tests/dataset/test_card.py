"""The card, its pictures, and the Croissant metadata: each read back by the library that reads it."""

import io

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
    write_sample,
)
from twinlens.dataset.pictures import contact_sheet, statistics_figure, tile
from twinlens.dataset.statistics import statistics
from twinlens.errors import FileError, InputError

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
    root = made(tmp_path / "set", rejections={"too dark": 3})
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
        "| samples | 2 |",
        "| image size | 64 x 48 |",
        "| lenses of a sample | 1 (1), 2 (1) |",
        "| splits | train: 2 |",
        "Rejected draws - too dark: 3.",
        "Seed: 5.",
    ):
        assert line in body
    least = min(sample.record["statistics"]["depth"][0] for sample in Dataset(root))
    assert f"| depth | {least:.4g} to " in body


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
    describe(tmp_path / "set", About(license="https://example.org/terms"))
    describe(tmp_path / "set")
    head, body = front_matter((tmp_path / "set" / "README.md").read_text())
    assert (head["pretty_name"], head["license"]) == (odd, "other")
    assert head["license_link"] == "https://example.org/terms"
    assert "Made by Ada." in body
    assert read_manifest(tmp_path / "set").info["about"]["creator"] == "Ada"


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
    for name in "bc":
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
    data = statistics_figure([sample, same, {}][:count])
    picture = Image.open(io.BytesIO(data))
    assert picture.size[0] > 500
    assert np.ptp(np.asarray(picture)[..., 0]) > 100
    assert not {"Software", "Creation Time", "date"} & set(picture.info)


@rdflib_warns
def test_mlcroissant_reads_the_metadata(tmp_path):
    mlc = pytest.importorskip("mlcroissant")
    data = Dataset(made(tmp_path / "set"))
    texts = {"name": "set", "description": "Pairs.", "creator": "Ada"}
    texts |= {"url": "https://example.org", "license": "CC-BY-4.0"}
    describe(data, About(**texts, published="2026-01-31", cite_as="@misc{ada}"))
    read = mlc.Dataset(jsonld=str(tmp_path / "set" / "croissant.json"))
    assert not read.metadata.ctx.issues.errors
    assert not read.metadata.ctx.issues.warnings
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
    described = {record_set.name for record_set in read.metadata.record_sets} - {
        "samples"
    }
    assert described == {
        name.rpartition("/")[2].replace(".", "-")
        for s in data
        for name in s.row["files"]
    }
