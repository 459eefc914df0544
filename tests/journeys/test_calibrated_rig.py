"""From the calibration file of a rig that is not rectified to a dataset that a matcher can use.

By the commands of docs/rigs.md alone; also a pair that is rectified already, and fisheyes. The same rig in the files of
other programs is in tests/calibrations.
"""

import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.calibrations.calibration_files import opencv_file
from tests.docs.pages import blocks

PAGE = Path(__file__).parents[2] / "docs" / "rigs.md"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="docs/ is not next to tests/")
SIZE = (128, 96)
TURN = cv2.Rodrigues(np.radians([0.4, -3.0, 0.5]))[0]
SHIFT = np.array([[-0.11], [0.002], [0.004]])
K = (
    np.array([[110.0, 0, 63.0], [0, 111.0, 48.5], [0, 0, 1]]),
    np.array([[112.0, 0, 64.5], [0, 112.5, 47.0], [0, 0, 1]]),
)
D = np.array([[-0.12, 0.02, 1e-3, -5e-4, 0.0]])
SMALL = "spp = 2\ndenoise = false\n[gates]\nattempts = 5\n"
FEW = ["--spp", "2", "--no-denoise"]


def write_opencv(folder):
    """stereo.yml, which the page names."""
    cameras = {"M1": K[0], "D1": D, "M2": K[1], "D2": D}
    size = {"image_width": SIZE[0], "image_height": SIZE[1]}
    opencv_file(folder / "stereo.yml", **cameras, R=TURN, T=SHIFT, **size)


def commands():
    """The commands of the page."""
    (text,) = (text for _, text in blocks(PAGE, "sh") if "stereo.yml" in text)
    for line in text.splitlines():
        _, *words = shlex.split(line, comments=True)
        yield words


def write_recipe(folder, file="stereo.yml", more=SMALL, count=1):
    """The recipe of the page, smaller: every random scene compiles kernels of its own."""
    recipe = next(text for _, text in blocks(PAGE, "toml") if "seed = " in text)
    assert 'file = "stereo.yml"' in recipe
    recipe = recipe.replace("count = 2", f"count = {count}")
    recipe = recipe.replace("stereo.yml", file)
    size = f"width = {SIZE[0]}\nheight = {SIZE[1]}\n"
    recipe = recipe.replace("[rig]", f"{size}{more}[rig]")
    (folder / "calibrated.toml").write_text(recipe)


def test_from_a_calibration_to_rectified_pairs(twinlens, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_opencv(tmp_path)
    write_recipe(tmp_path)
    said = {}
    for words in commands():
        few = FEW if words[0] == "render" else []
        code, out, err = twinlens(*words, *few)
        assert code == 0, out + err
        said[words[0]] = out + err
    assert "128x96 pixels" in said["cameras"]
    assert "0.11009" in said["cameras"]  # |T|, metres
    assert "Not a rectified pair" in said["cameras"]
    # The file does not name the model of its distortion.
    assert "cv2.fisheye" in said["cameras"]
    assert "twinlens rectify shown" in said["render"]
    assert "twinlens rectify made" in said["generate"]
    assert "sgm" in said["benchmark"]
    _check_disparities(tl.Dataset("rectified"))


CALIB = """cam0=[110.0 0 63.0; 0 110.0 48.5; 0 0 1]
cam1=[110.0 0 66.5; 0 110.0 48.5; 0 0 1]
doffs=3.5
baseline=110
width=128
height=96
ndisp=40
"""
FISHEYE = """cam0:
  camera_model: pinhole
  distortion_model: equidistant
  distortion_coeffs: [-0.013, 0.021, -0.016, 0.004]
  intrinsics: [60.7, 60.7, 63.6, 64.1]
  resolution: [128, 128]
cam1:
  T_cn_cnm1: [[1, 0, 0, -0.11], [0, 1, 0, 0.001], [0, 0, 1, -0.001], [0, 0, 0, 1]]
  camera_model: pinhole
  distortion_model: equidistant
  distortion_coeffs: [-0.013, 0.021, -0.016, 0.004]
  intrinsics: [60.6, 60.6, 63.1, 63.8]
  resolution: [128, 128]
"""


@pytest.mark.slow
def test_a_calib_txt_needs_no_rectification(twinlens, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("calib.txt").write_text(CALIB)
    write_recipe(tmp_path, "calib.txt")
    code, out, err = twinlens("generate", "calibrated.toml", "-o", "made")
    assert code == 0, err
    assert "rectify" not in out + err
    for line in ("verify made", "benchmark made --methods sgm -o board"):
        code, out, err = twinlens(*line.split())
        assert code == 0, err
    (sample,) = tl.Dataset("made")
    known = np.isfinite(sample.disp0)
    # Middlebury: Z = baseline f / (d + doffs), the baseline in millimetres.
    depth_mm = 110.0 * 110.0 / (sample.disp0[known].astype(np.float64) + 3.5)
    assert depth_mm == pytest.approx(1e3 * sample.depth0[known], rel=1e-5)


@pytest.mark.slow
def test_fisheyes_become_a_pair(twinlens, tmp_path, monkeypatch):
    """Of 121 degrees along the row and 171 along the diagonal, a crop of wider ones, which are no samples' cameras."""
    monkeypatch.chdir(tmp_path)
    Path("camchain.yaml").write_text(FISHEYE.replace("60.", "47."))
    write_recipe(tmp_path, "camchain.yaml")
    assert "Crop their images" in twinlens("cameras", "--read", "camchain.yaml")[1]
    code, _, err = twinlens("generate", "calibrated.toml", "-o", "made")
    assert code == 2
    assert "crop a fisheye's images" in err
    Path("camchain.yaml").write_text(FISHEYE)
    write_recipe(tmp_path, "camchain.yaml")
    assert twinlens("generate", "calibrated.toml", "-o", "made")[0] == 0
    code, _, err = twinlens("rectify", "made", "-o", "rectified", "--fit", "opencv")
    assert code == 2
    assert "'focal' and 'valid' show the part around the middle" in err
    for line in (
        "rectify made -o rectified",
        "verify rectified",
        "benchmark rectified --methods sgm -o board",
    ):
        code, out, err = twinlens(*line.split())
        assert code == 0, out + err
    (sample,) = tl.Dataset("rectified")
    known = np.isfinite(sample.disp0)
    assert known.any()
    assert (known == np.isfinite(sample.depth0)).all(), "the sky has neither"
    baseline = np.linalg.norm([0.11, 0.001, 0.001])
    depth = sample.depth0[known].astype(np.float64)
    expected = sample.rig.cameras[0].fx * baseline / depth
    assert np.abs(sample.disp0[known] - expected).max() < 1e-4


def _check_disparities(dataset):
    """The calibration is OpenCV's, and disparity the closed form f B / z of it, to 1e-4 px."""
    *_, p1, p2, _, _, _ = cv2.stereoRectify(
        K[0], D, K[1], D, SIZE, TURN, SHIFT, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1
    )  # fmt: skip
    baseline = np.linalg.norm(SHIFT)
    assert -p2[0, 3] / p2[0, 0] == pytest.approx(baseline)
    for sample in dataset:
        camera = sample.rig.cameras[0]
        assert (camera.fx, camera.fy) == pytest.approx((p1[0, 0], p1[1, 1]))
        # OpenCV inverts a distortion in five steps.
        assert (camera.cx, camera.cy) == pytest.approx((p1[0, 2], p1[1, 2]), abs=0.02)
        known = np.isfinite(sample.disp0)
        disparity = camera.fx * baseline / sample.depth0[known].astype(np.float64)
        assert np.abs(sample.disp0[known] - disparity).max() < 1e-4
        assert sample.valid0.shape == sample.disp0.shape
        outside = sample.valid0 == 0
        assert not sample.im0[outside].any()
        assert not (sample.mask0_nonocc[outside] == 255).any()


@pytest.mark.slow
def test_semi_global_matching_of_rectified_pairs_has_no_bias(
    twinlens, tmp_path, monkeypatch
):
    """Of a pair without mismatch, where an error of the truth or of the warp would be one of all disparities."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(f"{__name__}.SIZE", (320, 240))
    scaled = tuple(np.diag([2.5, 2.5, 1]) @ matrix for matrix in K)
    monkeypatch.setattr(f"{__name__}.K", scaled)
    write_opencv(tmp_path)
    more = 'spp = 16\nsensor = { mismatch = "none" }\n'
    write_recipe(tmp_path, more=more, count=2)
    for words in list(commands())[2:4]:
        code, out, err = twinlens(*words)
        assert code == 0, out + err
    errors = []
    for sample in tl.Dataset("rectified"):
        found = tl.match(sample.im0, sample.im1, method="sgm", num_disparities=sample.ndisp)  # fmt: skip
        compared = (sample.mask0_nonocc == 255) & np.isfinite(found)
        error = (found - sample.disp0)[compared]
        errors.append(error[np.abs(error) < 1])
        assert errors[-1].size > 0.3 * found.size
    assert abs(np.median(np.concatenate(errors))) < 0.05
