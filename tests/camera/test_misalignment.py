"""Misalignment of cameras against their calibration."""

import cv2
import numpy as np

from twinlens.camera import ALIGNED, Camera, Misalignment, Rig, misaligned

CAMERA = Camera(64, 48, 70.0, 69.0, 31.0, 24.1)


def test_rotations_are_about_the_calibrated_axes():
    """Large angles, against a sequence of OpenCV's axis rotations."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = (
        cv2.Rodrigues(np.array([0.3, -0.2, 1.1]))[0],
        [3.0, 2.0, 1.0],
    )
    rig = Rig.stereo(CAMERA, 0.2, pose)
    off = misaligned(
        rig, (ALIGNED, Misalignment(pitch_deg=30, yaw_deg=40, roll_deg=50))
    )
    axes = np.eye(3)
    for axis, degrees in zip(np.eye(3), (30, 40, 50), strict=True):
        axes = cv2.Rodrigues(axis * np.radians(degrees))[0] @ axes
    calibrated_from_true = (
        np.linalg.inv(off.calibrated.world_from_cams[1]) @ off.world_from_cams[1]
    )
    np.testing.assert_allclose(calibrated_from_true[:3, :3], axes, atol=1e-12)
    np.testing.assert_allclose(calibrated_from_true[:3, 3], 0, atol=1e-12)
    np.testing.assert_array_equal(off.world_from_cams[0], rig.world_from_cams[0])


def test_a_pair_of_a_misaligned_rig_keeps_its_calibrated_pair():
    three = Rig([CAMERA] * 3, [np.eye(4)] * 3)
    off = misaligned(
        three, (ALIGNED, Misalignment(vertical_px=1.5), Misalignment(roll_deg=1))
    )
    pair = off.pair(2, 1)
    assert pair.cameras[1].cy == CAMERA.cy + 1.5
    assert pair.nominal.cameras[1].cy == CAMERA.cy
    np.testing.assert_array_equal(pair.nominal.world_from_cams[0], np.eye(4))
    assert three.pair(0, 1).calibrated is None
