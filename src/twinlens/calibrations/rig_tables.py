"""A rig as the table of a rig's file of ours, and back where the table is complete without a scene."""

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from twinlens.calibrations.storages import read_text
from twinlens.camera import BrownConrady, Camera, Distortion, KannalaBrandt, Rig
from twinlens.errors import FileError, InputError, check_known, located, warn_not_used
from twinlens.geometry import Float

LENGTH_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres of each unit of length. Calibrations do not name theirs."""

_CAMERA = ("width", "height", "fx", "fy", "cx", "cy")
_MODELS: dict[str, Any] = {model.name: model for model in (BrownConrady, KannalaBrandt)}
_POSES = ("world_from_cam", "rig_from_cam")
_NEEDED = (
    'only a file that names a calibration (file = ...), or that has the layout "cameras" with '
    f"{', '.join(_CAMERA)} and world_from_cam of each, is a rig without a scene; `twinlens render SCENE --rig` reads "
    "the others"
)


def rig_table(rig: Rig, poses: Literal["rig", "world"] = "rig") -> dict[str, Any]:
    """The table of `rig` as a rig's file has it, with layout "cameras".

    poses : "rig" gives poses relative to the first camera, which then stands where the rig's pose is; "world" gives
        `world_from_cams` as they are.
    """
    placed = list(rig.world_from_cams)
    if poses == "rig":
        # b_from_a(0, 0) would differ from the identity by rounding.
        placed = [np.eye(4), *(rig.b_from_a(i, 0) for i in range(1, len(rig)))]
    key = f"{poses}_from_cam"
    cameras = [
        _camera_table(camera) | {key: pose.tolist()}
        for camera, pose in zip(rig.cameras, placed, strict=True)
    ]
    return {"layout": "cameras", "cameras": cameras}


def _camera_table(camera: Camera) -> dict[str, Any]:
    table: dict[str, Any] = {name: getattr(camera, name) for name in _CAMERA}
    if camera.distortion is not None:
        coefficients = {
            name: value for name, value in asdict(camera.distortion).items() if value
        }
        table["distortion"] = {"model": camera.distortion.name, **coefficients}
    return table


def rig_of_table(table: Mapping[str, Any]) -> Rig:
    """The rig of a table as `rig_table` makes it. Raises InputError for one that leaves values to a scene."""
    cameras = table.get("cameras")
    if table.get("layout") != "cameras" or not isinstance(cameras, list):
        raise InputError(_NEEDED)
    if others := sorted(table.keys() - {"layout", "cameras"}):
        raise InputError(f"has {others[0]!r}; {_NEEDED}")
    made, poses = [], []
    for i, camera in enumerate(cameras):
        with located(f"cameras[{i}]"):
            made.append(_camera_of(camera))
            poses.append(_pose_of(camera))
    return Rig(made, poses)


def _camera_of(table: Any) -> Camera:
    if not isinstance(table, Mapping):
        raise InputError("must be a table")
    if missing := [key for key in _CAMERA if key not in table]:
        raise InputError(f"has no {missing[0]}; {_NEEDED}")
    allowed = {*(field.name for field in fields(Camera)), *_POSES}
    if others := sorted(table.keys() - allowed):
        raise InputError(f"has {others[0]!r}; {_NEEDED}")
    values = {key: value for key, value in table.items() if key not in _POSES}
    if "distortion" in values:
        with located("distortion"):
            values["distortion"] = _distortion_of(values["distortion"])
    return Camera(**values)


def _distortion_of(table: Any) -> Distortion:
    if not isinstance(table, Mapping):
        raise InputError("must be a table")
    name = table.get("model", BrownConrady.name)
    check_known("model", name, _MODELS)
    coefficients = {key: value for key, value in table.items() if key != "model"}
    for key in coefficients:
        check_known("coefficient", key, [field.name for field in fields(_MODELS[name])])
    distortion: Distortion = _MODELS[name](**coefficients)
    return distortion


def _pose_of(table: Mapping[str, Any]) -> Float:
    stated = [key for key in _POSES if key in table]
    if len(stated) != 1:
        raise InputError(f"needs one of {' and '.join(_POSES)}; {_NEEDED}")
    try:
        return np.array(table[stated[0]], dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{stated[0]} must be four rows of four numbers") from None


def read_own(path: Path) -> tuple[Rig, tuple[str, ...]]:
    """The rig in a .toml file, and a name for each camera. Raises FileError."""
    table = _read_table(path)
    try:
        rig = rig_of_table(table)
    except InputError as error:
        raise FileError(f"{path}: {error}") from None
    return rig, tuple(f"cameras[{i}]" for i in range(len(rig)))


def _read_table(path: Path) -> dict[str, Any]:
    """The table of a rig's .toml file, which may be below [rig] there. Raises FileError."""
    try:
        values = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"{path}: not valid TOML: {error}") from None
    inner = values.get("rig")
    if not isinstance(inner, dict):
        return values
    size: dict[str, Any] = {
        key: values[key] for key in ("width", "height") if key in values
    }
    return size | inner if "file" in inner else inner


def named_files(path: Path) -> tuple[list[Path], dict[str, Any]] | None:
    """The calibration files that a rig's .toml file names, and how to read them; None if it names none.

    Raises FileError.
    """
    table = _read_table(path)
    if "file" not in table:
        return None
    names = table["file"]
    names = [names] if isinstance(names, str) else names
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise FileError(f"{path}: file must be the name of a file, or two names")
    if any(name.lower().endswith(".toml") for name in names):
        raise FileError(f"{path}: file must be a calibration of another program")
    settings: dict[str, Any] = {}
    for key in ("length_unit", "fisheye"):
        if key in table:
            settings[key] = table[key]
    try:
        if "length_unit" in settings:
            check_known("length_unit", settings["length_unit"], LENGTH_UNITS)
        if not isinstance(settings.get("fisheye", False), bool):
            raise InputError("fisheye must be true or false")
    except InputError as error:
        raise FileError(f"{path}: {error}") from None
    if {"width", "height"} <= table.keys():
        settings["size"] = (table["width"], table["height"])
    used = {"file", "layout", "poses", "width", "height", *settings}
    others = table.keys() - used
    warn_not_used(path, [f"{key} (the cameras alone)" for key in sorted(others)])
    return [path.parent / name for name in names], settings
