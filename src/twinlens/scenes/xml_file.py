"""Reads a Mitsuba .xml as a `Scene` whose default view is that of the file's first sensor.

Only the sensor is interpreted here; Mitsuba loads the checked file itself. `depth_range` is the sensor's near_clip and
far_clip. If one of them is missing, Mitsuba's default (0.01 or 10000 m) is used and `depth_range_known` is false.
"""

import math
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from twinlens.errors import InputError
from twinlens.geometry import Float, check_rigid, look_at
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Scene
from twinlens.scenes.xml_check import checked_xml

_MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])
_FRAME_35MM = (36.0, 24.0)


def read_scene_xml(path: Path) -> Scene:
    """The scene of a Mitsuba file. Raises InputError if the file is rejected or has no supported sensor."""
    root, assets = checked_xml(path)
    sensor = root.find("sensor")
    if sensor is None:
        raise InputError(f"{path}: has no <sensor>; add one (perspective or thinlens) for the pose of the left camera")
    try:
        pose, fov = _pose(sensor), _fov_x_deg(sensor)
        clips = [(_value(sensor, name), default) for name, default in (("near_clip", 1e-2), ("far_clip", 1e4))]
        near, far = (default if text is None else _floats(text, 1)[0] for text, default in clips)
    except InputError as error:
        raise InputError(f"{path}: the sensor's {error}") from error
    return Scene(
        name=path.stem,
        objects=(),
        materials={},
        world_from_left=pose,
        fov_x_deg=fov,
        depth_range=(near, far),
        depth_range_known=all(text is not None for text, _ in clips),
        description=f"the Mitsuba scene {path.name}",
        xml=path.resolve(),
        files=(path, *assets),
    )


def _floats(text: str, count: int) -> list[float]:
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        number = "a finite number" if count == 1 else f"{count} finite numbers"
        raise InputError(f"value {text!r} must be {number}, without $ parameters")
    return values


def _value(parent: Element, name: str) -> str | None:
    """The value of a parameter by its name, which older files write in camel case."""
    first, *rest = name.split("_")
    names = (name, first + "".join(map(str.capitalize, rest)))
    return next((child.get("value") for child in parent if child.get("name") in names), None)


def _fov_x_deg(sensor: Element) -> float:
    """The horizontal field of view from `fov` and `fov_axis`, or from `focal_length` as on 35 mm film."""
    film = sensor.find("film")
    sizes = [None if film is None else _value(film, name) for name in ("width", "height")]
    (width,), (height,) = _floats(sizes[0] or "768", 1), _floats(sizes[1] or "576", 1)
    if not (width >= 1 and height >= 1):
        raise InputError(f"film must be at least 1x1 pixels, got {width:g}x{height:g}")
    fov, axis = _value(sensor, "fov"), _value(sensor, "fov_axis") or "x"
    if fov is not None:
        angle = math.radians(_floats(fov, 1)[0])
    else:
        (focal_mm,) = _floats((_value(sensor, "focal_length") or "50mm").strip().removesuffix("mm"), 1)
        axis, angle = "diagonal", 2 * math.atan2(math.hypot(*_FRAME_35MM) / 2, focal_mm)
    sides = {"x": width, "y": height, "diagonal": math.hypot(width, height)}
    sides |= {"smaller": min(width, height), "larger": max(width, height)}
    if axis not in sides or not 0 < angle < math.pi:
        raise InputError(f"fov must lie between 0 and 180 degrees along {', '.join(sides)}, got {fov} {axis}")
    return math.degrees(2 * math.atan(math.tan(angle / 2) * width / sides[axis]))


def _pose(sensor: Element) -> Float:
    """world_from_left from the sensor's to_world, whose steps are applied in order."""
    transform = next((t for t in sensor.findall("transform") if t.get("name") in ("to_world", "toWorld")), None)
    to_world = np.eye(4)
    for step in transform if transform is not None else ():
        to_world = _step(step) @ to_world
    if not np.linalg.det(to_world[:3, :3]) > 0:
        raise InputError("to_world is mirrored or singular; a camera needs a rotation")
    return check_rigid(to_world @ _MITSUBA_FROM_OPENCV, "to_world")


def _step(step: Element) -> Float:
    if step.tag == "matrix":
        return np.array(_floats(step.get("value", ""), 16)).reshape(4, 4)
    if step.tag == "lookat":
        origin, target = (_floats(step.get(key, ""), 3) for key in ("origin", "target"))
        try:
            return look_at(origin, target, _floats(step.get("up", "0 1 0"), 3)) @ _MITSUBA_FROM_OPENCV
        except InputError as error:
            raise InputError("lookat needs different origin and target, and up not along the line of sight") from error
    if step.tag == "scale":
        return np.diag([*_xyz(step, "1"), 1.0])
    if step.tag == "translate":
        return translation(_xyz(step, "0"))
    if step.tag == "rotate":
        axis = _xyz(step, "0")
        if not any(axis):
            raise InputError("rotate needs an axis that is not zero")
        return rotation(axis, _floats(step.get("angle", ""), 1)[0])
    raise InputError(f"to_world has <{step.tag}>, which is not a transform")


def _xyz(step: Element, default: str) -> list[float]:
    value = step.get("value")
    if value is None:
        return [_floats(step.get(key, default), 1)[0] for key in "xyz"]
    one = len(value.replace(",", " ").split()) == 1
    return _floats(value, 1) * 3 if one else _floats(value, 3)
