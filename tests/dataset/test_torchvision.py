"""Exports opened by torchvision, webdataset and datasets, if they are installed."""

import io

import numpy as np
import pytest
from PIL import Image

from tests.dataset import dataset_scene
from twinlens.dataset import Dataset, write_sample
from twinlens.dataset.export import export

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    for i, name in enumerate(("a", "b", "long-name.x")):
        write_sample(
            folder / name, dataset_scene.sample(num_lenses=2, baseline=0.3 + 0.1 * i)
        )
    return Dataset(folder)


@pytest.fixture
def opened(data, tmp_path):
    """The items of an export, as torchvision's class reads them."""
    datasets = pytest.importorskip("torchvision.datasets")

    def run(to, name, **options):
        export(data, tmp_path / to, to)
        items = getattr(datasets, name)(str(tmp_path / to), **options)
        assert len(items) == len(data)
        return items

    return run


def same_images(sample, item):
    np.testing.assert_array_equal(np.asarray(item[0]), sample.im0)
    np.testing.assert_array_equal(np.asarray(item[1]), sample.im1)


@pytest.mark.parametrize(
    ("to", "name"), [("carla", "CarlaStereo"), ("sceneflow", "SceneFlowStereo")]
)
def test_pfm_layouts(data, opened, to, name):
    for sample, item in zip(data, opened(to, name), strict=True):
        same_images(sample, item)
        np.testing.assert_array_equal(item[2], sample.disp0[None])


@pytest.mark.parametrize("calibration", ["perfect", "both"])
def test_middlebury(data, opened, tmp_path, calibration):
    if calibration == "both":
        pytest.importorskip("torchvision")
        with pytest.raises(FileNotFoundError):
            opened(
                "middlebury", "Middlebury2014Stereo", split="train", calibration="both"
            )
        return
    items = opened(
        "middlebury", "Middlebury2014Stereo", split="train", calibration=calibration
    )
    for sample, (*images, disparity, valid) in zip(data, items, strict=True):
        same_images(sample, images)
        known = np.isfinite(sample.disp0)
        np.testing.assert_array_equal(valid, known)
        np.testing.assert_array_equal(disparity[0][known], sample.disp0[known])


def test_eth3d(data, opened):
    for sample, (*images, disparity, valid) in zip(
        data, opened("eth3d", "ETH3DStereo"), strict=True
    ):
        same_images(sample, images)
        np.testing.assert_array_equal(disparity, sample.disp0[None])
        np.testing.assert_array_equal(valid, sample.mask0_nonocc > 0)


def test_kitti(data, opened):
    for sample, item in zip(data, opened("kitti2015", "Kitti2015Stereo"), strict=True):
        same_images(sample, item)
        known = np.isfinite(sample.disp0)
        np.testing.assert_array_equal(item[2][0] > 0, known)
        assert np.abs(item[2][0][known] - sample.disp0[known]).max() <= 0.5 / 256


@pytest.mark.parametrize("pass_name", ["clean", "final"])
def test_sintel(data, opened, pass_name):
    for sample, (*images, disparity, valid) in zip(
        data, opened("sintel", "SintelStereo", pass_name=pass_name), strict=True
    ):
        same_images(sample, images)
        np.testing.assert_array_equal(valid, sample.mask0_nonocc == 255)
        known = np.isfinite(sample.disp0)
        # The class decodes in float32.
        assert np.abs(disparity[0][known] - sample.disp0[known]).max() <= 1 / 16384


@pytest.mark.filterwarnings(
    "ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"
)
def test_webdataset(data, tmp_path):
    webdataset = pytest.importorskip("webdataset")
    export(data, tmp_path / "out", "webdataset", lens=1)
    items = webdataset.WebDataset(
        str(tmp_path / "out" / "shard-000000.tar"), shardshuffle=False
    ).decode("pil")
    for sample, item in zip(data, items, strict=True):
        assert item["__key__"] == sample.name.replace(".", "%2E")
        np.testing.assert_array_equal(np.asarray(item["im0.png"]), sample.lens(1).im0)
        np.testing.assert_array_equal(
            np.asarray(item["mask1nocc.png"].convert("L")), sample.mask1_nonocc
        )
        np.testing.assert_array_equal(
            np.asarray(Image.open(io.BytesIO(item["disp1.pfm"]))), sample.disp1
        )
        assert item["json"]["shots"][1]["folder"] == "lens-1/"


def test_hugging_face(data, tmp_path):
    datasets = pytest.importorskip("datasets")
    export(data, tmp_path / "out", "parquet")
    for given in (
        {"path": str(tmp_path / "out")},
        {"path": "parquet", "data_dir": str(tmp_path / "out")},
    ):
        rows = datasets.load_dataset(
            **given, split="train", cache_dir=str(tmp_path / "cache")
        )
        for sample, row in zip(data, rows, strict=True):
            assert (row["name"], row["baseline"]) == (
                sample.name,
                sample.calibration.baseline,
            )
            for name in (
                "im0",
                "im1",
                "disp0",
                "disp1",
                "mask0_nonocc",
                "mask1_nonocc",
            ):
                np.testing.assert_array_equal(
                    np.asarray(row[name]), getattr(sample, name)
                )
