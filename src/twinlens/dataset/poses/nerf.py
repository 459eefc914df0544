"""transforms.json of instant-ngp and Nerfstudio: intrinsics, and one ``transform_matrix`` per frame.

The matrix is world_from_cam with OpenGL's camera axes (x right, y up, z backward): ours times diag(1, -1, -1, 1). World
axes are unchanged. Pixels are counted from the image's corner: cx and cy are larger by 0.5. Intrinsics are given at the
top level for all frames, or per frame; camera_angle_x replaces a missing fl_x.

Source: Nerfstudio, "Data conventions"; instant-ngp, docs/nerf_dataset_tips.md.
"""

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Rig
from twinlens.dataset.files import write_file
from twinlens.dataset.poses.named import HALF_PIXEL, NamedRig, image_names, read_text
from twinlens.errors import FileError, InputError

_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_MODELS = ("OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE")


def write_transforms(path: str | os.PathLike[str], rig: Rig, names: Sequence[str] | None = None) -> None:
    """Write `rig` as transforms.json; file_path is im0.png ... by default.

    Raises InputError for invalid names and for rational distortion (k4, k5, k6), which the format cannot hold, and
    OutputError.
    """
    frames = [
        {"file_path": name, **_intrinsics(camera), "transform_matrix": (pose @ _OPENGL).tolist()}
        for name, camera, pose in zip(image_names(rig, names), rig.cameras, rig.world_from_cams, strict=True)
    ]
    write_file(
        path, (json.dumps({"camera_model": frames[0]["camera_model"], "frames": frames}, indent=1) + "\n").encode()
    )


def read_transforms(path: str | os.PathLike[str]) -> NamedRig:
    """The rig of a transforms.json, in the order of its frames. Raises FileError."""
    try:
        table = json.loads(read_text(path))
        frames = table["frames"]
        cameras = [_camera({**table, **frame}) for frame in frames]
        poses = [np.array(frame["transform_matrix"], dtype=np.float64) @ _OPENGL for frame in frames]
        return NamedRig(Rig(cameras, poses), tuple(str(frame["file_path"]) for frame in frames))
    except KeyError as error:
        raise FileError(f"{path}: has no {error.args[0]}") from None
    except (ValueError, TypeError, RecursionError) as error:
        raise FileError(f"{path}: not a valid transforms.json: {error}") from None


def _intrinsics(camera: Camera) -> dict[str, Any]:
    values: dict[str, Any] = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
    values |= {"cx": camera.cx + HALF_PIXEL, "cy": camera.cy + HALF_PIXEL, "camera_model": "OPENCV"}
    model = camera.distortion
    if isinstance(model, KannalaBrandt):
        return values | {"camera_model": "OPENCV_FISHEYE"} | asdict(model)
    if model is None:
        return values
    if any((model.k4, model.k5, model.k6)):
        raise InputError(
            "transforms.json cannot hold k4, k5, k6 (rational distortion): write COLMAP's or OpenCV's format"
        )
    return values | {"k1": model.k1, "k2": model.k2, "k3": model.k3, "p1": model.p1, "p2": model.p2}


def _camera(values: Mapping[str, Any]) -> Camera:
    width, height = int(values["w"]), int(values["h"])
    fx = _focal(values, "x", width)
    fy = _focal(values, "y", height) if "fl_y" in values or "camera_angle_y" in values else fx
    cx, cy = (float(values.get(name, size / 2)) - HALF_PIXEL for name, size in (("cx", width), ("cy", height)))
    return Camera(width, height, fx, fy, cx, cy, _distortion(values))


def _focal(values: Mapping[str, Any], axis: str, size: int) -> float:
    if f"fl_{axis}" in values or f"camera_angle_{axis}" not in values:
        return float(values[f"fl_{axis}"])
    return 0.5 * size / math.tan(0.5 * float(values[f"camera_angle_{axis}"]))


def _distortion(values: Mapping[str, Any]) -> BrownConrady | KannalaBrandt | None:
    model = values.get("camera_model", "OPENCV")
    if model not in _MODELS:
        raise InputError(f"camera_model must be one of {', '.join(_MODELS)}, got {model!r}")
    k1, k2, k3, k4, p1, p2 = (float(values.get(name, 0.0)) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if model == "OPENCV_FISHEYE":
        return KannalaBrandt(k1, k2, k3, k4)
    if k4:
        raise InputError("k4 of a perspective camera is not supported")
    return BrownConrady(k1, k2, p1, p2, k3) if any((k1, k2, k3, p1, p2)) else None
