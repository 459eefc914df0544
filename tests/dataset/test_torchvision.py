"""Exports opened by torchvision and webdataset, if they are installed."""

import io

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from tests.dataset.dataset_scene import sample
from twinlens.dataset import Dataset, write_sample
from twinlens.dataset.export import export

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    for i, name in enumerate(("a", "b", "long-name.x")):
        write_sample(folder / name, sample(num_lenses=2, baseline=0.3 + 0.1 * i))
    return Dataset(folder)


def visible(stored):
    return stored.mask0_nonocc == 255


def has_truth(stored):
    """Middlebury's class takes every known disparity as valid, ETH3D's every pixel of the mask but 0."""
    return np.isfinite(stored.disp0)


# torchvision's class and its options, its largest error in pixels, and what it takes as valid.
# The class of Sintel decodes in float32.
CLASSES = {
    "carla": ("CarlaStereo", {}, 0, None),
    "eth3d": ("ETH3DStereo", {}, 0, has_truth),
    "kitti2015": ("Kitti2015Stereo", {}, 0.5 / 256, None),
    "middlebury": ("Middlebury2014Stereo", {"split": "train"}, 0, has_truth),
    "sceneflow": ("SceneFlowStereo", {}, 0, None),
    "sintel": ("SintelStereo", {"pass_name": "final"}, 1 / 16384, visible),
}


@pytest.mark.parametrize("to", CLASSES)
def test_torchvision_reads_the_layout(data, tmp_path, to):
    datasets = pytest.importorskip("torchvision.datasets")
    name, options, error, valid = CLASSES[to]
    export(data, tmp_path / to, to)
    items = getattr(datasets, name)(str(tmp_path / to), **options)
    assert len(items) == len(data)
    for stored, item in zip(data, items, strict=True):
        assert_array_equal(np.asarray(item[0]), stored.im0)
        assert_array_equal(np.asarray(item[1]), stored.im1)
        known = has_truth(stored)
        assert_allclose(item[2][0][known], stored.disp0[known], rtol=0, atol=error)
        if valid is not None:
            assert_array_equal(item[3], valid(stored))
        elif to == "kitti2015":
            assert_array_equal(item[2][0] > 0, known)


def test_middlebury_has_no_pairs_with_an_imperfect_calibration(data, tmp_path):
    datasets = pytest.importorskip("torchvision.datasets")
    export(data, tmp_path / "out", "middlebury")
    options = {"split": "train", "calibration": "both"}
    with pytest.raises(FileNotFoundError):
        datasets.Middlebury2014Stereo(str(tmp_path / "out"), **options)


@pytest.mark.filterwarnings(
    "ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"
)
def test_webdataset(data, tmp_path):
    webdataset = pytest.importorskip("webdataset")
    export(data, tmp_path / "out", "webdataset", lens=1)
    path = str(tmp_path / "out" / "shard-000000.tar")
    items = webdataset.WebDataset(path, shardshuffle=False).decode("pil")
    for stored, item in zip(data, items, strict=True):
        assert item["__key__"] == stored.name.replace(".", "%2E")
        assert_array_equal(np.asarray(item["im0.png"]), stored.lens(1).im0)
        mask = np.asarray(item["mask1nocc.png"].convert("L"))
        assert_array_equal(mask, stored.mask1_nonocc)
        disparity = np.asarray(Image.open(io.BytesIO(item["disp1.pfm"])))
        assert_array_equal(disparity, stored.disp1)
        assert item["json"]["shots"][1]["folder"] == "lens-1/"
