"""From the calibration file of a rig that is not rectified to a dataset that a matcher can use, by commands alone."""

import cv2
import numpy as np
import pytest

import twinlens as tl

TURN = cv2.Rodrigues(np.radians([0.4, -3.0, 0.5]))[0]
SHIFT = np.array([[-0.11], [0.002], [0.004]])
K = (
    np.array([[110.0, 0, 63.0], [0, 111.0, 48.5], [0, 0, 1]]),
    np.array([[112.0, 0, 64.5], [0, 112.5, 47.0], [0, 0, 1]]),
)
D = np.array([[-0.12, 0.02, 1e-3, -5e-4, 0.0]])

RECIPE = """
seed = 3
count = 2
families = ["tabletop"]
width = 128
height = 96
spp = 2
denoise = false
[rig]
file = "stereo.yml"
[gates]
attempts = 5
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrated")
    storage = cv2.FileStorage(str(folder / "stereo.yml"), cv2.FILE_STORAGE_WRITE)
    for name, value in {"M1": K[0], "D1": D, "M2": K[1], "D2": D}.items():
        storage.write(name, value)
    storage.write("R", TURN)
    storage.write("T", SHIFT)
    storage.write("image_width", 128)
    storage.write("image_height", 96)
    storage.release()
    (folder / "recipe.toml").write_text(RECIPE)
    return folder


def test_from_a_calibration_to_rectified_pairs(twinlens, folder):
    calibration = folder / "stereo.yml"
    code, out, _ = twinlens("cameras", "--read", calibration)
    assert code == 0
    assert "128x96 pixels" in out
    assert "0.11009" in out  # |T|, metres
    assert "Not a rectified pair" in out

    few = ("--spp", 2, "--no-denoise")
    shown = folder / "shown"
    code, _, err = twinlens("render", "cards", "--rig", calibration, *few, "-o", shown)
    assert code == 0
    assert f"twinlens rectify {shown}" in err

    made, rectified = folder / "made", folder / "rectified"
    code, _, err = twinlens("generate", folder / "recipe.toml", "-o", made)
    assert code == 0
    assert f"twinlens rectify {made}" in err
    assert twinlens("rectify", made, "-o", rectified, "--fit", "opencv")[0] == 0
    assert twinlens("verify", rectified)[0] == 0
    _check_disparities(tl.Dataset(rectified))
    code, out, _ = twinlens(
        "benchmark", rectified, "--methods", "sgm", "-o", folder / "b"
    )
    assert code == 0
    assert "sgm" in out


def _check_disparities(dataset):
    """The calibration is OpenCV's, and disparity the closed form f B / z of it, to 1e-4 px."""
    *_, p1, p2, _, _, _ = cv2.stereoRectify(
        K[0], D, K[1], D, (128, 96), TURN, SHIFT, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1
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
