"""Loading for training: quantities by name, and torch's DataLoader."""

import copy
import pickle
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.dataset import dataset_scene
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    write_manifest,
    write_png,
    write_sample,
)  # fmt: skip
from twinlens.dataset.stored import parse_quantity
from twinlens.errors import FileError, InputError

SAMPLE = dataset_scene.sample(num_lenses=2)
DEFAULT = ["name", "im0", "im1", "disp0", "mask0_nonocc"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    sums = [write_sample(folder / f"s{i}", SAMPLE) for i in range(5)]
    splits = ("train", "test", "train", "train", "test")
    rows = (
        Row(f"s{i}", s, {"split": split})
        for i, (s, split) in enumerate(zip(sums, splits, strict=True))
    )
    write_manifest(folder, Manifest(tuple(rows)))
    return folder


def test_a_sample_is_a_mapping_of_default_quantities(folder):
    sample = Dataset(folder)[0]
    assert isinstance(sample, Mapping)
    assert list(sample) == DEFAULT
    assert "disp1" not in sample
    for name in DEFAULT:
        assert_array_equal(sample[name], getattr(sample, name))
    assert dict(sample)["name"] == "s0"
    assert {sample, copy.copy(sample), pickle.loads(pickle.dumps(sample))} == {sample}


def test_every_name_reads_its_quantity(folder):
    sample = Dataset(folder)[1]
    expected = {
        "lens1.im1": sample.lens(1).im1,
        "lens0.im0": sample.im0,
        "lens1.blur_circle_px0": sample.lens(1).blur_circle_px(0),
        "blur_circle_px1": sample.lens(0).blur_circle_px(1),
        "mask1_nonocc": sample.mask1_nonocc,
        "K1": sample.rig.cameras[1].K,
        "world_from_cam1": sample.rig.world_from_cams[1],
        "baseline": 0.4,
        "doffs": 1.25,
        "ndisp": sample.ndisp,
    }
    selected = Dataset(folder).select(*expected)[1]
    assert list(selected) == list(expected)
    # Blur is in the file, and computed for other lenses.
    for name, value in expected.items():
        assert_allclose(selected[name], value, rtol=1e-6)
        assert_array_equal(sample[name], selected[name])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("dept0", "did you mean 'depth0'"),
        ("lens1.disp0", "unknown quantity"),
        ("im", "unknown quantity"),
        ("im0\n", "unknown quantity"),
    ],
)
def test_unknown_names_are_rejected_immediately(folder, name, message):
    with pytest.raises(InputError, match=message):
        Dataset(folder).select("im0", name)


def test_an_unknown_attribute_names_the_nearest(folder):
    with pytest.raises(AttributeError, match="'dept0'; did you mean 'depth0'"):
        _ = Dataset(folder)[0].dept0
    assert not hasattr(Dataset(folder)[0], "__array_interface__")


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("im7", FileError, r"im7\.png: no such file"),
        ("lens5.im0", InputError, "no lens 5"),
        ("K2", InputError, "no camera 2"),
        ("radiance0", FileError, r"radiance0\.exr: no such file"),
    ],
)
def test_missing_quantities_are_reported(folder, name, error, message):
    with pytest.raises(error, match=message):
        _ = Dataset(folder)[0][name]


def test_the_table_of_the_page_has_every_quantity_with_its_dtype_and_shape(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "loading.md").read_text()
    table = page[page.index("| name | dtype |") :].partition("\n\n")[0]
    write_sample(tmp_path / "s", dataset_scene.full_sample())
    sample = Dataset(tmp_path)[0]
    listed = set()
    for row in table.splitlines()[2:]:
        names, dtypes, shapes, _ = (cell.strip() for cell in row.strip("|").split("|"))
        for name in re.findall(r"`([^`]+)`", names):
            listed.add(name)
            value = sample[name]
            if shapes:
                assert str(value.dtype) in dtypes.split(" or "), name
                assert (
                    str(value.shape).replace("48, 64", "H, W").replace("(1", "(P")
                    in shapes
                ), name
            else:
                assert type(value).__name__ == dtypes, name
    with pytest.raises(InputError) as error:
        parse_quantity("anything")
    offered = set(re.search(r"known: (.*)\)", str(error.value))[1].split(", "))
    assert offered - {f"{name}0" for name in dataset_scene.extra_channels()} <= listed


def test_names_and_splits(folder):
    data = Dataset(folder)
    assert data.names == ("s0", "s1", "s2", "s3", "s4")
    assert "s3" in data
    assert "s9" not in data
    assert data[2] in data
    assert data.split("train").names == ("s0", "s2", "s3")
    assert data[1:].split("test").names == ("s1", "s4")
    for view in (data, data.select("name")):
        with pytest.raises(InputError, match="has 5 samples, no sample -6"):
            view[-6]
    with pytest.raises(InputError, match="unknown split 'tran'; did you mean 'train'"):
        data.split("tran")
    with pytest.raises(InputError, match="has no splits"):
        Dataset(folder / "s0").split("train")


def test_a_sample_of_images_only(tmp_path):
    for i in range(3):
        write_png(tmp_path / "s" / f"im{i}.png", np.zeros((4, 5), np.uint8))
    assert list(Dataset(tmp_path)[0]) == ["name", "im0", "im1", "im2"]


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch")


@pytest.mark.slow
@pytest.mark.parametrize(("workers", "start"), [(0, None), (2, "fork"), (2, "spawn")])
def test_a_data_loader_accepts_the_dataset(torch, folder, workers, start):
    data = Dataset(folder)
    loader = torch.utils.data.DataLoader(
        data, batch_size=2, num_workers=workers, multiprocessing_context=start
    )
    batches = list(loader)
    assert [batch["name"] for batch in batches] == [["s0", "s1"], ["s2", "s3"], ["s4"]]
    for batch, first in zip(batches, (0, 2, 4), strict=True):
        assert list(batch) == DEFAULT
        for name in DEFAULT[1:]:
            assert_array_equal(batch[name][0], data[first][name])
            assert batch[name].shape == (len(batch["name"]), *data[first][name].shape)
    assert batches[0]["im0"].dtype == torch.uint8
