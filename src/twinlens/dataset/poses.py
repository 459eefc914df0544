"""Rigs written for other programs: COLMAP, NeRF programs and OpenCV. `twinlens.calibrations` reads them.

`twinlens.calibrations.rig_files` states the conventions of the files and their sources.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from twinlens.calibrations import read_rig as read_rig, rig_table
from twinlens.calibrations.rig_files import (
    COLMAP_MODELS as COLMAP_MODELS,
    CORNER,
    OPENGL,
    FilePath,
    NamedRig as NamedRig,
    read_colmap as read_colmap,
    read_kalibr as read_kalibr,
    read_opencv as read_opencv,
    read_ros as read_ros,
    read_transforms as read_transforms,
)
from twinlens.camera import Camera, KannalaBrandt, Rig
from twinlens.dataset.channels import IMAGE
from twinlens.dataset.files import write_file
from twinlens.errors import InputError, counted
from twinlens.geometry import Float, inverse


def write_colmap(
    folder: FilePath, rig: Rig, names: Sequence[str] | None = None
) -> None:
    """Write the model of `rig`, without points, into `folder`; image names are im0.png ... by default.

    Raises InputError for invalid names, and OutputError.
    """
    cameras = [
        f"{i} {colmap_camera(camera)}" for i, camera in enumerate(rig.cameras, 1)
    ]
    named = enumerate(
        zip(rig.world_from_cams, _image_names(rig, names), strict=True), 1
    )
    images = [f"{i} {colmap_pose(pose)} {i} {name}\n" for i, (pose, name) in named]
    for file, lines in (("cameras", cameras), ("images", images), ("points3D", [])):
        write_file(
            Path(folder) / f"{file}.txt",
            "".join(f"{line}\n" for line in lines).encode(),
        )


def write_transforms(
    path: FilePath, rig: Rig, names: Sequence[str] | None = None
) -> None:
    """Write `rig` as transforms.json; file_path is im0.png ... by default.

    Raises InputError for invalid names and for rational distortion (k4, k5, k6), which the format cannot hold, and
    OutputError.
    """
    frames = []
    for name, camera, pose in zip(
        _image_names(rig, names), rig.cameras, rig.world_from_cams, strict=True
    ):
        matrix = (pose @ OPENGL).tolist()
        frame = {"file_path": name, **_intrinsics(camera), "transform_matrix": matrix}
        frames.append(frame)
    table = {"camera_model": frames[0]["camera_model"], "frames": frames}
    write_file(path, (json.dumps(table, indent=1) + "\n").encode())


def _intrinsics(camera: Camera) -> dict[str, Any]:
    """The keys of a frame of transforms.json that describe its camera. Raises InputError."""
    is_fisheye = isinstance(camera.distortion, KannalaBrandt)
    coefficients = asdict(camera.distortion) if camera.distortion is not None else {}
    if not is_fisheye:
        rational = [coefficients.pop(name, 0.0) for name in ("k4", "k5", "k6")]
        if any(rational):
            raise InputError(
                "transforms.json cannot hold k4, k5, k6 (rational distortion): use COLMAP or OpenCV files"
            )
    return {
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + CORNER,
        "cy": camera.cy + CORNER,
        "camera_model": "OPENCV_FISHEYE" if is_fisheye else "OPENCV",
        **dict(sorted(coefficients.items())),
    }


def write_opencv(path: FilePath, rig: Rig) -> None:
    """Write a pair for `cv2.FileStorage`. Raises InputError unless the rig has two cameras, and OutputError."""
    if len(rig) != 2:
        raise InputError(
            f"OpenCV's stereo files describe a pair, got {counted(len(rig), 'camera')}: write COLMAP's text instead"
        )
    text = ["%YAML:1.0", "---"]
    for i, camera in enumerate(rig.cameras, 1):
        coefficients = (
            (0.0,) * 5 if camera.distortion is None else camera.distortion.coefficients
        )
        fisheye = int(isinstance(camera.distortion, KannalaBrandt))
        text += [
            f"size{i}: [ {camera.width}, {camera.height} ]",
            f"fisheye{i}: {fisheye}",
        ]
        text += [_yaml_matrix(f"M{i}", camera.K), _yaml_matrix(f"D{i}", [coefficients])]
    second_from_first = rig.b_from_a(0, 1)
    text += [
        _yaml_matrix("R", second_from_first[:3, :3]),
        _yaml_matrix("T", second_from_first[:3, 3:]),
    ]
    text += [_yaml_matrix("world_from_1", rig.world_from_cams[0])]
    write_file(path, ("\n".join(text) + "\n").encode())


def colmap_camera(camera: Camera) -> str:
    """``MODEL WIDTH HEIGHT PARAMS``."""
    values = {
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx + CORNER,
        "cy": camera.cy + CORNER,
    }
    model = "PINHOLE"
    if camera.distortion is not None:
        values |= asdict(camera.distortion)
        model = (
            "OPENCV_FISHEYE"
            if isinstance(camera.distortion, KannalaBrandt)
            else "FULL_OPENCV"
        )
    numbers = " ".join(
        repr(float(values[name])) for name in COLMAP_MODELS[model].split()
    )
    return f"{model} {camera.width} {camera.height} {numbers}"


def colmap_pose(world_from_cam: Float) -> str:
    """``QW QX QY QZ TX TY TZ`` of cam_from_world."""
    cam_from_world = inverse(world_from_cam)
    x, y, z, w = Rotation.from_matrix(cam_from_world[:3, :3]).as_quat()
    return " ".join(
        repr(float(number)) for number in (w, x, y, z, *cam_from_world[:3, 3])
    )


def _image_names(rig: Rig, names: Sequence[str] | None) -> tuple[str, ...]:
    chosen = tuple(map(IMAGE.name, range(len(rig)))) if names is None else tuple(names)
    if len(chosen) != len(rig) or len(set(chosen)) != len(chosen):
        raise InputError(
            f"a rig of {counted(len(rig), 'camera')} needs as many different image names, got {list(chosen)}"
        )
    for name in chosen:
        if not name or name != name.strip() or not name.isprintable():
            raise InputError(
                f"an image name must be one printable line without spaces around it, got {name!r}"
            )
    return chosen


def _yaml_matrix(name: str, values: ArrayLike) -> str:
    matrix = np.atleast_2d(np.asarray(values, dtype=np.float64))
    rows, cols = matrix.shape
    row_texts = [", ".join(map(repr, row)) for row in matrix.tolist()]
    lines = ",\n       ".join(row_texts)
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {lines} ]"


def write_rig(path: FilePath, rig: Rig, names: Sequence[str] | None = None) -> None:
    """Write `rig` as a calibration file of the kind that the ending of the name selects.

    path : .yml or .yaml for OpenCV's stereo file of a pair; .json for transforms.json; .toml for our own; a name
        without an ending is a folder for COLMAP's text model.
    names : of the images, for transforms.json and COLMAP; im0.png ... by default.

    `read_rig`, `twinlens render --rig` and recipes read them all. Raises InputError for another ending and for what the
    kind cannot hold, and OutputError.
    """
    kind = Path(path).suffix.lower()
    if kind in (".yml", ".yaml"):
        write_opencv(path, rig)
    elif kind == ".json":
        write_transforms(path, rig, names)
    elif kind == ".toml":
        write_file(path, _rig_toml(rig).encode())
    elif not kind:
        write_colmap(path, rig, names)
    else:
        raise InputError(
            f"{path}: a rig is written as .yml, .json or .toml, or as COLMAP's model into a folder, got {kind!r}"
        )


def _rig_toml(rig: Rig) -> str:
    """The rig as a file of layout "cameras", with poses in the world."""
    lines = ['layout = "cameras"']
    for table in rig_table(rig, "world")["cameras"]:
        lines += ["", "[[cameras]]"]
        for key, value in table.items():
            lines.append(f"{key} = {_toml_value(value)}")
    return "\n".join(lines) + "\n"


def _toml_value(value: Any) -> str:
    """A value of `rig_table` in TOML, in which numbers, texts and lists are as in JSON."""
    if isinstance(value, dict):
        pairs = [f"{key} = {_toml_value(item)}" for key, item in value.items()]
        return "{ " + ", ".join(pairs) + " }"
    return json.dumps(value)
