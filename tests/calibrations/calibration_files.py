"""Files of other programs that hold a rig, and the comparison of two rigs."""

import cv2
import numpy as np
import pytest

KALIBR = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.7e-05]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.99999, -0.0017, -0.0040, -0.11]
  - [0.0017, 0.99999, 0.0010, 0.0004]
  - [0.0040, -0.0010, 0.99999, -0.0008]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.003, 0.001]
  distortion_model: equidistant
  intrinsics: [457.587, 456.134, 379.999, 255.238]
  resolution: [752, 480]
"""


def same(a, b):
    for mine, its in zip(a.cameras, b.cameras, strict=True):
        assert (mine.width, mine.height) == (its.width, its.height)
        assert mine.distortion == its.distortion
        assert pytest.approx(its.K, abs=1e-12) == mine.K
    assert np.allclose(a.world_from_cams, b.world_from_cams, rtol=0, atol=1e-12)


def opencv_file(path, **values):
    """A file of cv2.FileStorage, whose form its suffix says."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()
    return path


def write_ros(path, camera, rectification, projection):
    """A file of ROS's camera_calibration, as that program writes it."""
    coefficients = [*camera.distortion.coefficients][:5]

    def rows(name, array):
        array = np.asarray(array)
        data = ", ".join(map(repr, array.ravel().tolist()))
        return f"{name}:\n  rows: {array.shape[0]}\n  cols: {array.shape[1]}\n  data: [{data}]\n"

    path.write_text(
        f"image_width: {camera.width}\nimage_height: {camera.height}\ncamera_name: narrow_stereo\n"
        + rows("camera_matrix", camera.K)
        + "distortion_model: plumb_bob\n"
        + rows("distortion_coefficients", [coefficients])
        + rows("rectification_matrix", rectification)
        + rows("projection_matrix", projection)
    )
