"""The export parquet, opened by Hugging Face's datasets."""

import json

import datasets
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.dataset.dataset_scene import sample, stored
from twinlens.dataset import Dataset, Manifest, write_manifest, write_sample
from twinlens.dataset.dataset import row_of
from twinlens.dataset.export import export

MAPS = ["im0", "im1", "disp0", "disp1", "mask0_nonocc", "mask1_nonocc"]
NUMBERS = {
    **dict.fromkeys(("width", "height", "ndisp"), "int32"),
    **dict.fromkeys(("fx", "fy", "cx0", "cx1", "cy", "baseline", "doffs"), "float64"),
    **dict.fromkeys(("name", "record"), "string"),
}
NAMES = ("train/a", "test/b", "held-out/c", "train/d")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Four samples of three splits."""
    folder = tmp_path_factory.mktemp("made")
    for i, name in enumerate(NAMES):
        write_sample(folder / name, sample(baseline=0.3 + 0.05 * i))
    rows = [row_of(folder, name, {"split": name.partition("/")[0]}) for name in NAMES]
    write_manifest(folder, Manifest(tuple(rows)))
    return Dataset(folder)


def check(expected, row):
    assert row["name"] == expected.name
    calibration = expected.calibration
    assert (row["baseline"], row["doffs"]) == (calibration.baseline, calibration.doffs)
    assert (row["width"], row["height"], row["ndisp"]) == (64, 48, expected.ndisp)
    assert (row["fx"], row["fy"], row["cx0"], row["cy"]) == calibration.cam0
    assert json.loads(row["record"]) == expected.record
    for name in MAPS:
        assert_array_equal(np.asarray(row[name]), expected[name])


def test_load_dataset_has_typed_columns_images_and_splits(data, tmp_path):
    folder, cache = str(tmp_path / "out"), str(tmp_path / "cache")
    export(data, folder, "parquet")
    loaded = datasets.load_dataset(folder, cache_dir=cache)
    assert set(loaded) == {"train", "test", "held_out"}
    features = loaded["train"].features
    assert {name: features[name].dtype for name in NUMBERS} == NUMBERS
    assert {name: type(features[name]) for name in MAPS} == dict.fromkeys(
        MAPS, datasets.Image
    )
    assert features.keys() == {*NUMBERS, *MAPS}
    rows = [*loaded["train"], *loaded["test"], *loaded["held_out"]]
    assert len(rows) == len(data)
    for row in rows:
        check(data[row["name"]], row)


def test_samples_without_splits_are_those_of_train(tmp_path):
    folder, cache = str(tmp_path / "out"), str(tmp_path / "cache")
    plain = [stored(tmp_path / name) for name in ("a", "b")]
    export(plain, folder, "parquet")
    assert not (tmp_path / "out" / "README.md").exists()
    loaded = datasets.load_dataset(folder, cache_dir=cache)
    assert list(loaded) == ["train"]
    for sample_of_row, row in zip(plain, loaded["train"], strict=True):
        check(sample_of_row, row)
