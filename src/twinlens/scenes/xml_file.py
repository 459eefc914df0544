"""Reads a Mitsuba .xml as a `Scene` whose default view is that of the file's first sensor.

Only the sensor is interpreted here; Mitsuba loads the checked file itself. `depth_range` is the sensor's near_clip and
far_clip. If one of them is missing, Mitsuba's default (0.01 or 10000 m) is used and `depth_range_known` is false.
"""

import math
from pathlib import Path
from typing import NoReturn
from xml.etree.ElementTree import Element

import numpy as np

from twinlens.errors import InputError
from twinlens.geometry import Float, check_rigid
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Scene
from twinlens.scenes.xml_check import checked_xml

_MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])
_DEFAULT_FOCAL_LENGTH_MM = 50.0
_FRAME_35MM = (36.0, 24.0)
_AXIS_KEYS = ("x", "y", "z")


def read_scene_xml(path: Path) -> Scene:
    """The scene of a Mitsuba file. Raises InputError if the file is rejected or has no supported sensor."""
    root, assets = checked_xml(path)
    sensor = root.find("sensor")
    if sensor is None:
        _wrong(path, "has no <sensor>; add one (perspective or thinlens) for the pose of the left camera")
    return Scene(
        name=path.stem,
        objects=(),
        materials={},
        world_from_left=_pose(path, sensor),
        fov_x_deg=_fov_x_deg(path, sensor),
        depth_range=(_number(path, sensor, "near_clip", 1e-2), _number(path, sensor, "far_clip", 1e4)),
        depth_range_known=all(_parameter(sensor, name) is not None for name in ("near_clip", "far_clip")),
        description=f"the Mitsuba scene {path.name}",
        xml=path.resolve(),
        files=(path, *assets),
    )


def _wrong(path: Path, what: str) -> NoReturn:
    raise InputError(f"{path}: {what}")


def _floats(path: Path, text: str, count: int) -> list[float]:
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        _wrong(path, f"the sensor has {text!r} where {count} finite numbers belong (and no $ parameters)")
    return values


def _value(sensor: Element, *names: str) -> str | None:
    """The value of a parameter with one of the names."""
    for child in sensor:
        if child.get("name") in names:
            return child.get("value")
    return None


def _parameter(sensor: Element, name: str) -> str | None:
    first, *rest = name.split("_")
    return _value(sensor, name, first + "".join(map(str.capitalize, rest)))


def _number(path: Path, sensor: Element, name: str, default: float) -> float:
    text = _parameter(sensor, name)
    return default if text is None else _floats(path, text, 1)[0]


def _fov_x_deg(path: Path, sensor: Element) -> float:
    """The horizontal field of view from `fov` and `fov_axis`, or from `focal_length` as on 35 mm film."""
    width, height = _film_size(path, sensor)
    fov = _value(sensor, "fov")
    if fov is not None:
        axis = _value(sensor, "fov_axis", "fovAxis") or "x"
        angle = math.radians(_floats(path, fov, 1)[0])
    else:
        axis, angle = "diagonal", _diagonal_angle(path, _value(sensor, "focal_length", "focalLength"))
    sides = {
        "x": width,
        "y": height,
        "diagonal": math.hypot(width, height),
        "smaller": min(width, height),
        "larger": max(width, height),
    }
    if axis not in sides or not 0 < angle < math.pi:
        _wrong(path, f"the sensor's fov must lie between 0 and 180 degrees along {', '.join(sides)}, got {fov} {axis}")
    return math.degrees(2 * math.atan(math.tan(angle / 2) * width / sides[axis]))


def _film_size(path: Path, sensor: Element) -> tuple[float, float]:
    film = sensor.find("film")
    if film is None:
        return 768.0, 576.0
    width, height = _number(path, film, "width", 768.0), _number(path, film, "height", 576.0)
    if not (width >= 1 and height >= 1):
        _wrong(path, f"the sensor's film must be at least 1x1 pixels, got {width:g}x{height:g}")
    return width, height


def _diagonal_angle(path: Path, focal_length: str | None) -> float:
    millimetres = _DEFAULT_FOCAL_LENGTH_MM
    if focal_length is not None:
        millimetres = _floats(path, focal_length.strip().removesuffix("mm"), 1)[0]
    return 2 * math.atan(math.hypot(*_FRAME_35MM) / 2 / millimetres) if millimetres > 0 else 0.0


def _pose(path: Path, sensor: Element) -> Float:
    """world_from_left from the sensor's to_world, whose steps are applied in order."""
    transform = next((t for t in sensor.findall("transform") if t.get("name") in ("to_world", "toWorld")), None)
    to_world = np.eye(4)
    for step in transform if transform is not None else ():
        to_world = _step(path, step) @ to_world
    if not np.linalg.det(to_world[:3, :3]) > 0:
        _wrong(path, "the sensor's to_world is mirrored or singular; a camera needs a rotation")
    try:
        return check_rigid(to_world @ _MITSUBA_FROM_OPENCV, "to_world")
    except InputError as error:
        raise InputError(f"{path}: the sensor's {error}") from error


def _step(path: Path, step: Element) -> Float:
    """The 4x4 of one element of a <transform>."""
    if step.tag == "matrix":
        words = step.get("value", "").replace(",", " ").split()
        return np.array(_floats(path, " ".join(words), 16)).reshape(4, 4)
    if step.tag == "lookat":
        return _lookat(path, step)
    if step.tag == "scale":
        return np.diag([*_xyz(path, step, 1.0), 1.0])
    if step.tag == "translate":
        return translation(_xyz(path, step, 0.0))
    if step.tag == "rotate":
        axis = _xyz(path, step, 0.0)
        if not axis.any():
            _wrong(path, "the sensor's rotate needs an axis that is not zero")
        return rotation(axis, _floats(path, step.get("angle", ""), 1)[0])
    _wrong(path, f"the sensor's to_world has <{step.tag}>, which is not a transform")


def _xyz(path: Path, step: Element, default: float) -> Float:
    """x, y, z of a step: a `value` of three numbers or one, or the attributes x, y, z."""
    value = step.get("value")
    if value is not None:
        words = value.replace(",", " ").split()
        return np.array(_floats(path, value, 3 if len(words) != 1 else 1) * (3 if len(words) == 1 else 1))
    return np.array([_floats(path, step.get(key, str(default)), 1)[0] for key in _AXIS_KEYS])


def _lookat(path: Path, step: Element) -> Float:
    """Mitsuba's look-at: +z forward, +y up, +x left."""
    origin, target = (np.array(_floats(path, step.get(key, ""), 3)) for key in ("origin", "target"))
    up = np.array(_floats(path, step.get("up", "0 1 0"), 3))
    forward = target - origin
    left = np.cross(up, forward)
    if not np.linalg.norm(left) > 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up):
        _wrong(path, "the sensor's lookat needs different origin and target, and up not along the line of sight")
    z, x = forward / np.linalg.norm(forward), left / np.linalg.norm(left)
    pose = np.eye(4)
    pose[:3] = np.stack([x, np.cross(z, x), z, origin], axis=1)
    return pose
