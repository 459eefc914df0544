"""Reads a Mitsuba .xml as a `Scene`, after checking that nothing in it can run code or open a file outside its folder.

Mitsuba opens a shared library for a plugin type that it does not know, follows ``include`` and ``path``, reads any file
that a string names, and substitutes ``$`` parameters in every attribute. So every element, plugin type and file name
must be a known one, and document types and entities are rejected. Mitsuba loads the checked file itself; only the first
sensor is interpreted here, as the default view.
"""

import math
import re
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from twinlens.errors import FileError, InputError, check_known, located, unknown
from twinlens.geometry import Float, check_rigid, look_at
from twinlens.scenes.assets import (
    SceneContext,
    decode_picture,
    find_asset,
    read_limited,
    read_sky,
)
from twinlens.scenes.objects import ANALYTIC_SHAPES
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.plugins import (
    AREA_LIGHTS,
    CONDUCTORS,
    INTEGRATORS,
    LIGHTS,
    MATERIALS,
)
from twinlens.scenes.scene import Scene

PLUGINS: dict[str, set[str]] = {
    "bsdf": {*MATERIALS, "pplastic", "measured"},
    "emitter": {*LIGHTS, *AREA_LIGHTS, "projector"},
    "shape": {
        *ANALYTIC_SHAPES,
        "obj",
        "ply",
        "serialized",
        "shapegroup",
        "instance",
        "bsplinecurve",
        "linearcurve",
    },
    "sensor": {"perspective", "thinlens"},
    "film": {"hdrfilm"},
    "sampler": {"independent", "stratified", "multijitter", "orthogonal", "ldsampler"},
    "rfilter": {"box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos"},
    "integrator": {*INTEGRATORS, "volpath", "volpathmis"},
    "texture": {"bitmap", "checkerboard", "mesh_attribute"},
    "spectrum": {
        "uniform",
        "regular",
        "irregular",
        "srgb",
        "d65",
        "blackbody",
        "rawconstant",
    },
    "medium": {"homogeneous", "heterogeneous"},
    "volume": {"constvolume", "gridvolume"},
    "phase": {"isotropic", "hg", "rayleigh"},
}
VALUES = {
    "boolean",
    "integer",
    "float",
    "string",
    "rgb",
    "vector",
    "point",
    "ref",
    "alias",
    "default",
}
TRANSFORMS = {"transform", "translate", "rotate", "scale", "lookat", "matrix"}
_NUMERIC_TAGS = {"boolean", "integer", "float", "rgb", "vector", "point", *TRANSFORMS}
_NUMERIC_ATTRIBUTES = {"value", "x", "y", "z", "angle", "origin", "target", "up"}
_MAX_DEPTH = 200  # of nested elements
_FILE_PARAMETER = re.compile(r"file|path", re.IGNORECASE)
_NUMBERS = re.compile(r"[\d.eE+\-,:\s]*")
_LOOKS_LIKE_PATH = re.compile(r"[/\\]|^\.|\.[A-Za-z]\w{1,7}$")

_PICTURES: dict[tuple[str, str | None], Any] = {
    ("emitter", "envmap"): read_sky,
    ("texture", "bitmap"): decode_picture,
}
_MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])
_FRAME_35MM = (36.0, 24.0)


def read_scene_xml(path: Path) -> Scene:
    """The scene of a Mitsuba file. Raises InputError if the file is rejected or has no supported sensor.

    `depth_range` is the sensor's near_clip and far_clip. If one of them is missing, Mitsuba's default (0.01 or 10000 m)
    is used and `depth_range_known` is false.
    """
    root, assets = checked_xml(path)
    sensor = root.find("sensor")
    if sensor is None:
        raise InputError(
            f"{path}: has no <sensor>; add one (perspective or thinlens) for the pose of the left camera"
        )
    with located(f"{path}: sensor"):
        transforms = (
            each
            for each in sensor.findall("transform")
            if each.get("name") in ("to_world", "toWorld")
        )
        to_world = np.eye(4)
        for step in next(transforms, ()):
            to_world = _matrix(step) @ to_world
        if not np.linalg.det(to_world[:3, :3]) > 0:
            raise InputError(
                "to_world is mirrored or singular; a camera needs a rotation"
            )
        pose, fov = (
            check_rigid(to_world @ _MITSUBA_FROM_OPENCV, "to_world"),
            _fov_x_deg(sensor),
        )
        clips = [
            (_value(sensor, name), default)
            for name, default in (("near_clip", 1e-2), ("far_clip", 1e4))
        ]
        near, far = (
            default if text is None else _floats(text, 1)[0] for text, default in clips
        )
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


def checked_xml(path: Path) -> tuple[Element, list[Path]]:
    """The root element of a harmless Mitsuba file, and the files it names; InputError for anything else."""
    context = SceneContext(
        path.resolve().parent
    )  # Mitsuba resolves names from the file's folder, not a link's
    builder = TreeBuilder()
    parser = expat.ParserCreate()

    def reject(*_: Any) -> None:
        raise FileError(
            f"{path}: line {parser.CurrentLineNumber}: a scene needs no <!DOCTYPE> or <!ENTITY>; remove it"
        )

    parser.StartDoctypeDeclHandler = reject
    parser.EntityDeclHandler = reject
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(read_limited(path, 64 << 20), True)
    except expat.ExpatError as error:
        raise FileError(f"{path}: not well-formed XML: {error}") from error
    root = builder.close()
    if root.tag != "scene":
        raise InputError(
            f"{path}: a Mitsuba file starts with <scene>, got <{root.tag}>"
        )
    elements = [("scene", root, 0)]
    while elements:
        where, element, depth = elements.pop()
        if depth > _MAX_DEPTH:
            raise InputError(
                f"{path}: scene: elements are nested more than {_MAX_DEPTH} deep"
            )
        with located(f"{path}: {where}"):
            _check_element(element, context)
        elements += [
            (f"{where}.{child.tag}", child, depth + 1) for child in reversed(element)
        ]
    return root, list(dict.fromkeys(context.files))


def _check_element(element: Element, context: SceneContext) -> None:
    tag, kind = element.tag, element.get("type")
    if tag not in PLUGINS.keys() | VALUES | TRANSFORMS | {"scene"}:
        raise unknown("element", tag, PLUGINS.keys() | VALUES | TRANSFORMS)
    for key, text in element.attrib.items():
        if "$" in text and not (tag in _NUMERIC_TAGS and key in _NUMERIC_ATTRIBUTES):
            raise InputError(
                f"{key}={text!r}: write the {key} itself; $ parameters may replace numbers only"
            )
    if tag in PLUGINS and not (tag == "spectrum" and kind is None):
        check_known(f"{tag} type", kind, PLUGINS[tag])
    elif kind is not None:
        raise InputError(f"<{tag}> takes no type")
    if check_picture := _PICTURES.get((tag, kind)):
        for file in element.iterfind("string[@name='filename']"):
            check_picture(find_asset(file.get("value", ""), context))
    value = element.get("value", "")
    if tag == "default":
        _check_no_path(value, context)
    if tag == "spectrum" and "filename" in element.attrib:
        find_asset(element.attrib["filename"], context)
    if tag == "spectrum" and not _NUMBERS.fullmatch(value):
        raise InputError(
            f"{value!r}: write the spectrum's numbers, as 400:1.0, 700:1.5"
        )
    name = element.get("name", "")
    if tag == "string" and _FILE_PARAMETER.search(name):
        find_asset(value, context)
    elif tag == "string" and name == "material":
        check_known("conductor", value, CONDUCTORS)
    elif tag == "string":
        _check_no_path(value, context)


def _check_no_path(value: str, context: SceneContext) -> None:
    if _LOOKS_LIKE_PATH.search(value):
        raise InputError(f"{value!r} looks like a file name, which is not allowed here")
    if 0 < len(value.encode()) < 256 and (context.folder / value).is_symlink():
        find_asset(
            value, context
        )  # a plugin may still read it as a file, so it must be in the folder


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
    return next(
        (child.get("value") for child in parent if child.get("name") in names), None
    )


def _fov_x_deg(sensor: Element) -> float:
    """The horizontal field of view from `fov` and `fov_axis`, or from `focal_length` as on 35 mm film."""
    film = sensor.find("film")
    sizes = [
        None if film is None else _value(film, name) for name in ("width", "height")
    ]
    (width,), (height,) = _floats(sizes[0] or "768", 1), _floats(sizes[1] or "576", 1)
    if not (width >= 1 and height >= 1):
        raise InputError(f"film must be at least 1x1 pixels, got {width:g}x{height:g}")
    fov, axis = _value(sensor, "fov"), _value(sensor, "fov_axis") or "x"
    if fov is not None:
        angle = math.radians(_floats(fov, 1)[0])
    else:
        (focal_mm,) = _floats(
            (_value(sensor, "focal_length") or "50mm").strip().removesuffix("mm"), 1
        )
        axis, angle = "diagonal", 2 * math.atan2(math.hypot(*_FRAME_35MM) / 2, focal_mm)
    sides = {"x": width, "y": height, "diagonal": math.hypot(width, height)}
    sides |= {"smaller": min(width, height), "larger": max(width, height)}
    if axis not in sides or not 0 < angle < math.pi:
        got = f"{math.degrees(angle):g} along {axis}"
        raise InputError(
            f"fov must lie between 0 and 180 degrees along {', '.join(sides)}, got {got}"
        )
    return math.degrees(2 * math.atan(math.tan(angle / 2) * width / sides[axis]))


def _matrix(step: Element) -> Float:
    """The 4x4 matrix of one element of a <transform>."""
    if step.tag == "matrix":
        return np.array(_floats(step.get("value", ""), 16)).reshape(4, 4)
    if step.tag == "lookat":
        origin, target = (
            np.array(_floats(step.get(key, ""), 3)) for key in ("origin", "target")
        )
        up = np.array(_floats(step.get("up", "0 0 0"), 3))
        try:
            return (
                look_at(
                    origin, target, up if up.any() else _default_up(target - origin)
                )
                @ _MITSUBA_FROM_OPENCV
            )
        except InputError as error:
            raise InputError(
                "lookat needs different origin and target, and up not along the line of sight"
            ) from error
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


def _default_up(forward: Float) -> Float:
    """The up vector (3,) that Mitsuba uses for a lookat without one: axis s of its `coordinate_system(forward)`.

    Source: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6(1), 2017.
    """
    x, y, z = forward / (np.linalg.norm(forward) or 1.0)
    return np.array(
        [
            1.0 - x * x / (1.0 + abs(z)),
            -x * y / (1.0 + abs(z)),
            -math.copysign(1.0, z) * x,
        ]
    )


def _xyz(step: Element, default: str) -> list[float]:
    value = step.get("value")
    if value is None:
        return [_floats(step.get(key, default), 1)[0] for key in "xyz"]
    one = len(value.replace(",", " ").split()) == 1
    return _floats(value, 1) * 3 if one else _floats(value, 3)
