"""Rigs written for other programs: COLMAP, NeRF programs and OpenCV. `twinlens.calibrations` reads them.

`twinlens.calibrations.rig_files` states the conventions of the files and their sources.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twinlens.calibrations import read_rig as read_rig, rig_table
from twinlens.calibrations.rig_files import (
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
from twinlens.dataset.codecs.colmap import encode_colmap_text
from twinlens.dataset.files import write_file
from twinlens.dataset.tracks import NO_TRACKS, Tracks
from twinlens.errors import InputError, counted


def write_colmap(
    folder: FilePath,
    rig: Rig,
    names: Sequence[str] | None = None,
    tracks: Tracks = NO_TRACKS,
) -> None:
    """Write the model of `rig` into `folder` as text; image names are im0.png ... by default.

    tracks : its points and where the views see them (`tracks.find_tracks`); none by default.

    Raises InputError for invalid names, and OutputError.
    """
    files = encode_colmap_text(rig, _image_names(rig, names), tracks)
    for file, content in files.items():
        write_file(Path(folder) / file, content)


def write_transforms(
    path: FilePath, rig: Rig, names: Sequence[str] | None = None
) -> None:
    """Write `rig` as transforms.json; file_path is im0.png ... by default.

    Raises InputError for invalid names and for rational distortion (k4, k5, k6), which the format cannot hold, and
    OutputError.
    """
    table = transforms_table(rig, names)
    write_file(path, (json.dumps(table, indent=1) + "\n").encode())


def transforms_table(rig: Rig, names: Sequence[str] | None = None) -> dict[str, Any]:
    """The content of transforms.json, in which each frame has its intrinsics. Raises InputError."""
    frames = []
    for name, camera, pose in zip(
        _image_names(rig, names), rig.cameras, rig.world_from_cams, strict=True
    ):
        matrix = (pose @ OPENGL).tolist()
        frame = {"file_path": name, **_intrinsics(camera), "transform_matrix": matrix}
        frames.append(frame)
    return {"camera_model": frames[0]["camera_model"], "frames": frames}


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
        "camera_angle_x": 2 * math.atan(0.5 * camera.width / camera.fx),
        "camera_angle_y": 2 * math.atan(0.5 * camera.height / camera.fy),
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

    `read_rig`, `twinlens render --rig` and recipes read them all. Raises InputError for another ending, for what the
    kind cannot hold, and for a rig that moves, and OutputError.
    """
    if rig.motion is not None:
        raise InputError(f"{path}: a file has a still rig: write rig.at(seconds)")
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
