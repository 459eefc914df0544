"""KITTI's and ETH3D's downloads as pairs: our exports of these layouts, read back, and folders made by hand."""

import shutil

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from tests.dataset import dataset_scene
from twinlens.dataset import Dataset, downloaded_pairs, write_png, write_sample
from twinlens.dataset.export import export
from twinlens.dataset.real_pairs import open_pair
from twinlens.errors import FileError
from twinlens.scoring import load_pair, open_pairs


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    for i in range(2):
        write_sample(folder / f"s{i}", dataset_scene.sample(baseline=0.3 + 0.1 * i))
    return Dataset(folder)


@pytest.mark.parametrize(
    ("layout", "folder"),
    [("kitti2015", "Kitti2015/training"), ("eth3d", "ETH3D/two_view_training")],
)
def test_an_export_is_read_back(data, tmp_path, layout, folder):
    export(data, tmp_path / "made", layout)
    inner = tmp_path / "made" / folder
    for root in (inner, inner.parent, tmp_path / "made"):
        for pair, sample in zip(downloaded_pairs(root), data, strict=True):
            assert_array_equal(pair.im0, sample.im0)
            assert_array_equal(pair.im1, sample.im1)
            assert_array_equal(pair.mask0_nonocc, sample.mask0_nonocc)
            assert_allclose(
                pair.disp0, sample.disp0, atol=0 if layout == "eth3d" else 0.5 / 256
            )
    names = [pair.name for pair in open_pairs([str(inner)])]
    assert names == (["s0", "s1"] if layout == "eth3d" else ["000000_10", "000001_10"])


def test_the_folder_of_a_scene_of_eth3d_has_its_truth(data, tmp_path, monkeypatch):
    export(data, tmp_path / "made", "eth3d")
    scenes = tmp_path / "made" / "ETH3D" / "two_view_training"
    monkeypatch.chdir(scenes / "s1")
    for path in (scenes / "s1", str(scenes / "s1"), "."):
        for pair in (open_pair(path), *open_pairs([str(path)])):
            assert pair.name == "s1"
            assert_array_equal(pair.disp0, data[1].disp0)
            assert_array_equal(pair.mask0_nonocc, data[1].mask0_nonocc)
    (scenes.parent / "two_view_training_gt" / "s1" / "disp0GT.pfm").unlink()
    with pytest.raises(FileError, match=r"disp0GT\.pfm: no such file"):
        open_pair(scenes / "s1")
    assert open_pair(scenes / "s0").name == "s0"
    shutil.rmtree(scenes.parent / "two_view_training_gt")
    assert load_pair(open_pair(scenes / "s1")).disp0 is None


def test_kitti_2012_has_grey_images_of_its_own(tmp_path):
    """disp_occ holds all measured pixels, disp_noc those visible in both views; 256 d in 16 bits, 0 unknown."""
    occluded = np.array([[0, 512, 1280], [256, 0, 2560]], np.uint16)
    visible = np.array([[0, 512, 0], [256, 0, 2560]], np.uint16)
    grey = np.arange(6, dtype=np.uint8).reshape(2, 3)
    images = {"image_0": grey, "image_1": grey}
    maps = {"disp_occ": occluded, "disp_noc": visible}
    for name, values in (images | maps).items():
        (tmp_path / "training" / name).mkdir(parents=True)
        Image.fromarray(values).save(tmp_path / "training" / name / "000007_10.png")
    Image.fromarray(grey).save(tmp_path / "training" / "image_0" / "000007_11.png")
    (pair,) = downloaded_pairs(tmp_path)
    assert pair.disp0.tolist() == [[np.inf, 2.0, 5.0], [1.0, np.inf, 10.0]]
    assert pair.mask0_nonocc.tolist() == [[0, 255, 128], [255, 0, 255]]
    assert (pair.name, pair.ndisp) == ("000007_10", 11)
    assert load_pair(pair).calibration is None


def test_other_folders_are_not_downloads(data, tmp_path):
    assert downloaded_pairs(data.path) is None
    assert downloaded_pairs(tmp_path / "missing") is None


@pytest.mark.parametrize("missing", ["disp_noc_0", "image_3/000001_10.png"])
def test_a_missing_part_is_named(data, tmp_path, missing):
    export(data, tmp_path / "made", "kitti2015")
    part = tmp_path / "made/Kitti2015/training" / missing
    part.rename(tmp_path / "moved")
    with pytest.raises(FileError, match=part.name):
        downloaded_pairs(tmp_path / "made/Kitti2015")


@pytest.mark.parametrize(
    ("layout", "file", "message"),
    [
        ("eth3d", "ETH3D/two_view_training_gt/s0/mask0nocc.png", "8-bit grey PNG"),
        ("kitti2015", "Kitti2015/training/disp_noc_0/000000_10.png", "another size"),
    ],
)
def test_a_wrong_mask_is_refused(data, tmp_path, layout, file, message):
    export(data, tmp_path / "made", layout)
    write_png(tmp_path / "made" / file, np.full((3, 4), 256, np.uint16))
    pair = downloaded_pairs(tmp_path / "made" / file.partition("/")[0])[0]
    with pytest.raises(FileError, match=message):
        _ = pair.mask0_nonocc


def blind_kitti(folder, calib):
    """A frame in KITTI's folders without truth, and the sequence's calibration."""
    grey = np.arange(64 * 48, dtype=np.uint32).reshape(48, 64).astype(np.uint8)
    for name in ("image_0", "image_1"):
        (folder / name).mkdir(parents=True)
        Image.fromarray(grey).save(folder / name / "000003.png")
    (folder / "calib.txt").write_text(calib)
    (pair,) = downloaded_pairs(folder)
    return pair


def projection(shift):
    """A line's values: K with fx = 50, the other camera `shift` / 50 metres to the right."""
    return f"50 0 31.5 {shift} 0 50 23.5 0 0 0 1 0"


def test_a_sequence_of_kitti_has_its_calibration_and_no_truth(tmp_path):
    pair = blind_kitti(tmp_path, f"P0: {projection(0)}\nP1: {projection(-27)}\n")
    assert (pair.name, pair.has_disparity(0)) == ("000003", False)
    calibration = pair.calibration
    assert calibration.baseline == pytest.approx(0.54)
    assert calibration.cam0 == (50, 50, 31.5, 23.5)
    assert (calibration.width, calibration.height, calibration.doffs) == (64, 48, 0)
    assert load_pair(pair).disp0 is None


@pytest.mark.parametrize(
    ("calib", "message"),
    [
        (f"P0: {projection(0)}\n", "has no line P_rect_01: or P1:"),
        (f"P0: {projection(0)}\nP1: 1 2 x\n", "P1 must be 12 numbers"),
        (f"P0: {projection(0)}\nP1: {projection(4)}\n", "no left and right camera"),
        (f"P0: {projection(0)}\nP1: {'nan ' * 12}\n", "P1 must be 12 numbers"),
    ],
)
def test_a_wrong_calibration_of_kitti_is_named(tmp_path, calib, message):
    pair = blind_kitti(tmp_path, calib)
    with pytest.raises(FileError, match=message):
        _ = pair.calibration
