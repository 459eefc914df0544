"""The rectified camera of OpenCV."""

import cv2
import numpy as np
import pytest

import twinlens as tl
from twinlens import geometry
from twinlens.camera import BrownConrady, Camera, Rig

TURN = cv2.Rodrigues(np.radians([0.6, -2.5, 1.1]))[0]
SHIFT = np.array([-0.12, 0.003, 0.001])


# OpenCV inverts a distortion in five steps, which suffice for these to 0.02 px.
@pytest.mark.parametrize(
    ("k1", "k2", "tolerance"),
    [(0.0, 0.0, 1e-4), (-0.28, 0.07, 0.02), (0.05, 0.0, 0.02)],
)
@pytest.mark.parametrize("zero_doffs", [True, False])
def test_focal_length_and_centres_are_opencvs(k1, k2, tolerance, zero_doffs):
    distortion = BrownConrady(k1, k2)
    left = Camera(640, 480, 700.0, 704.0, 321.0, 238.0, distortion)
    right = Camera(640, 480, 712.0, 709.0, 317.0, 241.0, distortion)
    second_from_first = geometry.rigid(TURN, SHIFT)
    rig = Rig([left, right], [np.eye(4), geometry.inverse(second_from_first)])
    r0, r1, p0, p1, *_ = cv2.stereoRectify(
        left.K, distortion.coefficients, right.K, distortion.coefficients, (640, 480), TURN, SHIFT[:, None],
        flags=cv2.CALIB_ZERO_DISPARITY if zero_doffs else 0, alpha=-1,
    )  # fmt: skip
    result = tl.rectify(rig, fit="opencv", zero_doffs=zero_doffs)
    cameras = result.rectified_rig.cameras
    for camera, projection in zip(cameras, (p0, p1), strict=True):
        assert np.abs(camera.K - projection[:, :3]).max() < tolerance
    for side, rotation in enumerate((r0, r1)):
        assert np.abs(result.rotation(side) - rotation).max() < 1e-9
