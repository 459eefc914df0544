"""What a calibration file has and twinlens does not use is named in one line."""

import json
import warnings

import numpy as np
import pytest

from twinlens.calibrations import read_rig

OPENCV = """%YAML:1.0
---
image_width: 64
image_height: 48
M1: [[50., 0., 31.5], [0., 50., 23.5], [0., 0., 1.]]
M2: [[50., 0., 31.5], [0., 50., 23.5], [0., 0., 1.]]
D1: [0., 0., 0., 0., 0.]
D2: [0., 0., 0., 0., 0.]
R: [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]
T: [-0.1, 0., 0.]
"""
ROS = """image_width: 64
image_height: 48
camera_name: left
camera_matrix: {{rows: 3, cols: 3, data: [50, 0, 31.5, 0, 50, 23.5, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
projection_matrix: {{rows: 3, cols: 4, data: [50, 0, 31.5, {shift}, 0, 50, 23.5, 0, 0, 0, 1, 0]}}
"""
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [50, 50, 31.5, 23.5]
  distortion_model: none
  resolution: [64, 48]
  cam_overlaps: [1]
cam1:
  camera_model: pinhole
  intrinsics: [50, 50, 31.5, 23.5]
  distortion_model: none
  resolution: [64, 48]
  T_cn_cnm1: [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
FRAME = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
TRANSFORMS = {"w": 64, "h": 48, "fl_x": 50.0, "frames": [FRAME]}


def text(name, more):
    match name:
        case "opencv.yml":
            return OPENCV + more
        case "kalibr.yaml":
            return KALIBR + more
        case "left.yaml":
            return ROS.format(shift=0) + more
        case _:
            return json.dumps({**TRANSFORMS, **json.loads(more or "{}")})


@pytest.mark.parametrize(
    ("name", "more", "named"),
    [
        ("opencv.yml", "", ""),
        ("opencv.yml", "Q: [[1., 0.], [0., 1.]]\ncalibration_time: monday\n", ""),
        ("opencv.yml", "skew1: 0.5\nroi1: [0, 0, 4, 4]\n", "roi1, skew1"),
        ("kalibr.yaml", "", ""),
        ("kalibr.yaml", "  timeshift_cam_imu: 0.01\n", "cam1.timeshift_cam_imu"),
        ("kalibr.yaml", "imu0: {rate: 200}\n", "imu0"),
        ("left.yaml", "binning_x: 1\nroi: {x_offset: 0, do_rectify: false}\n", ""),
        ("left.yaml", "binning_x: 2\n", "binning_x (the whole image)"),
        ("left.yaml", "roi: {x_offset: 8}\n", "roi (the whole image)"),
        ("transforms.json", "", ""),
        ("transforms.json", '{"aabb_scale": 4, "applied_scale": 2}', "aabb_scale, applied_scale"),
    ],
)  # fmt: skip
def test_one_line_names_it(tmp_path, name, more, named):
    path = tmp_path / name
    path.write_text(text(name, more))
    paths = [path]
    if name == "left.yaml":
        paths.append(tmp_path / "right.yaml")
        paths[1].write_text(ROS.format(shift=-5))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_rig(*paths)
    assert [str(warning.message) for warning in caught] == (
        [f"{path}: not used: {named}"] if named else []
    )
