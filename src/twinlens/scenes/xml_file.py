"""Reads a Mitsuba .xml as a `Scene`, after checking that nothing in it can run code or open a file outside its folder.

Mitsuba opens a shared library for a plugin type that it does not know, follows ``include`` and ``path``, reads any file
that a string names, and substitutes ``$`` parameters in every attribute. So every element, plugin type and file name
must be a known one, and document types and entities are rejected. Parameters and included files are put in their place
here, and Mitsuba loads the text that results; only the first sensor is interpreted, as the default view.
"""

import math
import os
import re
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from twinlens.errors import (
    FileError,
    InputError,
    check_known,
    counted,
    located,
    unknown,
    warn_not_used,
)
from twinlens.geometry import Float, check_rigid, look_at
from twinlens.scenes.assets import (
    SceneContext,
    check_mitsuba_opens,
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
from twinlens.scenes.scene import Scene, SceneWarning

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
    "texture": {"bitmap", "checkerboard", "mesh_attribute", "rawconstant"},
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
}
TRANSFORMS = {"transform", "translate", "rotate", "scale", "lookat", "matrix"}
_MAX_DEPTH = 100  # of nested elements in a file
_MOST_INCLUDED = 5  # files in each other
_MOST_ELEMENTS = 1_000_000
_LONGEST_VALUE = 10_000  # characters of a parameter
_MOST_UP = 3
_RECORDING = {"aov", "moment"}
_FILE_PARAMETER = re.compile(r"file|path", re.IGNORECASE)
_NO_FILES = {"file_format", "fileFormat"}
_UPWARDS = re.compile(r"(\.\./)+")
_PARAMETER_NAME = re.compile(r"[A-Za-z_]\w*")
_PARAMETER = re.compile(r"\$([A-Za-z_]\w*)")
_NUMBERS = re.compile(r"[\d.eE+\-,:\s]*")
_LOOKS_LIKE_PATH = re.compile(r"[/\\]|^\.|\.[A-Za-z]\w{1,7}$")

_PICTURES: dict[tuple[str, str | None], Any] = {
    ("emitter", "envmap"): read_sky,
    ("texture", "bitmap"): decode_picture,
}
_MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])
_OF_SENSOR = {
    "principal_point_offset_x": "a centred principal point",
    "principal_point_offset_y": "a centred principal point",
    "aperture_radius": "the lens of the command or recipe",
    "focus_distance": "the lens of the command or recipe",
    "shutter_open": "no motion",
    "shutter_close": "no motion",
    "medium": "no medium around the camera",
}
"""Parameters of a sensor that are not used, and what is done instead."""
_OF_FILM = dict.fromkeys(
    ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height"), "the whole film"
)
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
    _name_ignored(path, root, sensor)
    with located(f"{path}: sensor"):
        to_world = to_world_of(sensor)
        if not np.linalg.det(to_world[:3, :3]) > 0:
            raise InputError(
                "to_world is mirrored or singular; a camera needs a rotation"
            )
        pose = check_rigid(to_world @ _MITSUBA_FROM_OPENCV, "to_world")
        fov = _fov_x_deg(sensor)
        near_text, far_text = _value(sensor, "near_clip"), _value(sensor, "far_clip")
        near = 1e-2 if near_text is None else numbers_of(near_text, 1)[0]
        far = 1e4 if far_text is None else numbers_of(far_text, 1)[0]
    return Scene(
        name=path.stem,
        objects=(),
        materials={},
        world_from_left=pose,
        fov_x_deg=fov,
        depth_range=(near, far),
        depth_range_known=near_text is not None and far_text is not None,
        description=f"the Mitsuba scene {path.name}",
        xml=path.resolve(),
        files=(path, *assets),
    )


def _name_ignored(path: Path, root: Element, sensor: Element) -> None:
    """Warn of what the file says about cameras beyond the pose and the field of view of the first one."""
    film = sensor.find("film")
    parts = []
    for owner, ignored in ((sensor, _OF_SENSOR), (film, _OF_FILM)):
        if owner is not None:
            present = [name for name in ignored if _value(owner, name) is not None]
            parts += [f"{name} ({ignored[name]})" for name in present]
    others = len(root.findall("sensor")) - 1
    if others:
        parts.append(f"{counted(others, 'more sensor')} (the first one)")
    warn_not_used(f"{path}: sensor", parts, SceneWarning)


def checked_xml(path: Path) -> tuple[Element, list[Path]]:
    """The elements of a harmless Mitsuba file, and the files that it names. Raises InputError for anything else.

    Files of `include` are in their place, parameters have their values, and file names are absolute, so that neither
    `default`, `include` nor `path` is left for Mitsuba to follow.
    """
    resolver = _Resolver(path)
    root = _parsed(path)
    with located(f"{path}: scene"):
        _substitute(root, resolver)
    resolver.expand(root, path, "scene")
    return root, list(dict.fromkeys(resolver.files))


def resolved_xml(path: Path) -> str:
    """The text of a harmless Mitsuba file for `mitsuba.load_string`, read and checked again. Raises InputError."""
    return ElementTree.tostring(checked_xml(path)[0], encoding="unicode")


class _Resolver:
    """What the elements of a file and of the files it includes share: parameters, and folders to look for files.

    `path` elements may name folders up to `_MOST_UP` levels above the scene file, and names of files may start with as
    many "..". Files must lie in these folders, or below that of the scene. Source of the order: Mitsuba 3,
    `src/core/xml.cpp`, which looks in the folder named last first.
    """

    def __init__(self, path: Path) -> None:
        # Mitsuba resolves names from the file's folder, not a link's.
        self.home = path.resolve().parent
        self.folders = [self.home]
        self.parameters: dict[str, str] = {}
        self.files: list[Path] = []
        self._open = [path.resolve()]
        self._elements = 0

    def expand(self, parent: Element, file: Path, where: str) -> None:
        """Replace the children of an element of a file by what they stand for, and check each of them."""
        children: list[Element] = []
        for written in parent:
            self._elements += 1
            if self._elements > _MOST_ELEMENTS:
                raise InputError(
                    f"{file}: {where}: more than {_MOST_ELEMENTS} elements, included files counted"
                )
            child = _radiance_integrator(written)
            place = f"{where}.{child.tag}"
            with located(f"{file}: {place}"):
                _substitute(child, self)
                if child.tag == "default":
                    self._add_parameter(child)
                    continue
                if child.tag == "path":
                    self._add_folder(child.get("value", ""), file)
                    continue
                if child.tag != "include":
                    _check_element(child, self)
                    children.append(child)
            if child.tag == "include":
                children += self._included(child, file, place)
            else:
                self.expand(child, file, place)
                with located(f"{file}: {place}"):
                    _check_picture(child)
        parent[:] = children

    def find(self, name: str) -> Path:
        """The file of a name in one of the folders. Raises InputError."""
        is_short = len(os.fsencode(name)) < 256
        names_a_place = is_short and not PurePosixPath(name).is_absolute()
        if not names_a_place or "\0" in name:
            return find_asset(name, SceneContext(self.home, files=self.files))
        holders = (place for place in self.folders if (place / name).exists())
        folder = next(holders, self.home)
        above = _UPWARDS.match(name)
        if above is not None:
            folder = (folder / above[0]).resolve()
            self._check_not_far_up(folder, name)
            name = name[above.end() :]
        return find_asset(name, SceneContext(folder, files=self.files))

    def _check_not_far_up(self, folder: Path, name: str) -> None:
        """Raise InputError for a folder that shares too little of its path with the scene's."""
        shared = os.path.commonpath([folder, self.home])
        if len(self.home.relative_to(shared).parts) > _MOST_UP:
            raise InputError(
                f"{name!r} leads more than {_MOST_UP} levels above the scene file; copy it beside the scene"
            )

    def has_link(self, name: str) -> bool:
        """Whether a text is the name of a link in one of the folders."""
        if not 0 < len(name.encode()) < 256 or "\0" in name:
            return False
        return any((folder / name).is_symlink() for folder in self.folders)

    def _add_parameter(self, element: Element) -> None:
        name = element.get("name", "")
        if not _PARAMETER_NAME.fullmatch(name):
            raise InputError(f"{name!r} is not the name of a parameter")
        value = element.get("value", "")
        if len(value) > _LONGEST_VALUE:
            raise InputError(
                f"the parameter {name!r} has more than {_LONGEST_VALUE} characters"
            )
        self.parameters.setdefault(name, value)

    def _add_folder(self, name: str, file: Path) -> None:
        if PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive:
            raise InputError(
                f"{name!r}: write the folder relative to the file that names it"
            )
        # Beside the file that names it, or else in one of the folders named before.
        candidates = [
            (base / name).resolve() for base in (file.resolve().parent, *self.folders)
        ]
        folder = next((place for place in candidates if place.is_dir()), None)
        if folder is None:
            raise InputError(f"no folder {name!r} beside {file.name}")
        self._check_not_far_up(folder, name)
        self.folders.insert(0, folder)

    def _included(self, element: Element, file: Path, where: str) -> list[Element]:
        """The elements of the file that an `include` names."""
        with located(f"{file}: {where}"):
            target = self.find(element.get("filename", ""))
            if target in self._open:
                raise InputError(f"{target.name} includes itself")
            if len(self._open) > _MOST_INCLUDED:
                raise InputError(f"files are included more than {_MOST_INCLUDED} deep")
            root = _parsed(target)
            _substitute(root, self)
        self._open.append(target)
        self.expand(root, target, "scene")
        self._open.pop()
        return list(root)


def _parsed(path: Path) -> Element:
    """The root element of a file, <scene>. Raises InputError for other files, and for document types and entities."""
    builder = TreeBuilder()
    parser = expat.ParserCreate()
    depth = 0

    def reject(*_: Any) -> None:
        raise FileError(
            f"{path}: line {parser.CurrentLineNumber}: a scene needs no <!DOCTYPE> or <!ENTITY>; remove it"
        )

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _MAX_DEPTH:
            raise FileError(
                f"{path}: line {parser.CurrentLineNumber}: elements are nested more than {_MAX_DEPTH} deep"
            )
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartDoctypeDeclHandler = reject
    parser.EntityDeclHandler = reject
    parser.StartElementHandler = start
    parser.EndElementHandler = end
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
    return root


def _substitute(element: Element, resolver: _Resolver) -> None:
    """Replace $NAME in the attributes of an element by the parameters defined so far. Raises InputError."""
    for key, text in element.attrib.items():
        for name in _PARAMETER.findall(text):
            if name not in resolver.parameters:
                raise InputError(
                    f"{key}={text!r}: no parameter {name!r}; add <default name={name!r} value=.../> before"
                )
        element.set(
            key, _PARAMETER.sub(lambda match: resolver.parameters[match[1]], text)
        )


def _radiance_integrator(element: Element) -> Element:
    """The radiance integrator of an `aov` or `moment` integrator; other elements unchanged."""
    while element.tag == "integrator" and element.get("type") in _RECORDING:
        nested = element.find("integrator")
        if nested is None:
            return element
        element = nested
    return element


def _check_element(element: Element, resolver: _Resolver) -> None:
    """Raise InputError for an element that Mitsuba should not see; make the file names of others absolute."""
    tag, kind = element.tag, element.get("type")
    if tag not in PLUGINS.keys() | VALUES | TRANSFORMS:
        raise unknown("element", tag, PLUGINS.keys() | VALUES | TRANSFORMS)
    for key, text in element.attrib.items():
        if "$" in text:
            raise InputError(f"{key}={text!r} must not have a $")
    if tag in PLUGINS and not (tag == "spectrum" and kind is None):
        check_known(f"{tag} type", kind, PLUGINS[tag])
    elif kind is not None:
        raise InputError(f"<{tag}> takes no type")
    value = element.get("value", "")
    if tag == "spectrum" and "filename" in element.attrib:
        element.set("filename", str(resolver.find(element.attrib["filename"])))
    if tag == "spectrum" and not _NUMBERS.fullmatch(value):
        raise InputError(
            f"{value!r}: write the spectrum's numbers, as 400:1.0, 700:1.5"
        )
    name = element.get("name", "")
    if tag == "string" and _FILE_PARAMETER.search(name) and name not in _NO_FILES:
        element.set("value", str(resolver.find(value)))
    elif tag == "string" and name == "material":
        check_known("conductor", value, CONDUCTORS)
    elif tag == "string":
        _check_no_path(value, resolver)


def _check_picture(element: Element) -> None:
    """Raise InputError for a picture of an expanded element that Mitsuba should not decode."""
    check = _PICTURES.get((element.tag, element.get("type")))
    if check is None:
        return
    for file in element.iterfind("string[@name='filename']"):
        path = Path(file.get("value", ""))
        check_mitsuba_opens(path)
        check(path)


def _check_no_path(value: str, resolver: _Resolver) -> None:
    if _LOOKS_LIKE_PATH.search(value):
        raise InputError(f"{value!r} looks like a file name, which is not allowed here")
    if resolver.has_link(value):
        # A plugin may still read it as a file, so it must be in the folder.
        resolver.find(value)


def numbers_of(text: str, count: int) -> list[float]:
    """The finite numbers of a parameter. Raises InputError for another count of them."""
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        number = "a finite number" if count == 1 else f"{count} finite numbers"
        raise InputError(f"value {text!r} must be {number}")
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
    (width,), (height,) = (
        numbers_of(sizes[0] or "768", 1),
        numbers_of(sizes[1] or "576", 1),
    )
    if not (width >= 1 and height >= 1):
        raise InputError(f"film must be at least 1x1 pixels, got {width:g}x{height:g}")
    fov, axis = _value(sensor, "fov"), _value(sensor, "fov_axis") or "x"
    if fov is not None:
        angle = math.radians(numbers_of(fov, 1)[0])
    else:
        (focal_mm,) = numbers_of(
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


def to_world_of(parent: Element) -> Float:
    """The steps of an element's `to_world` multiplied, (4, 4); the identity where it has none. Raises InputError."""
    to_world = np.eye(4)
    for transform in parent.findall("transform"):
        if transform.get("name") in ("to_world", "toWorld"):
            for step in transform:
                to_world = _matrix(step) @ to_world
            break
    return to_world


def _matrix(step: Element) -> Float:
    """The 4x4 matrix of one element of a <transform>."""
    if step.tag == "matrix":
        values = step.get("value", "")
        matrix = np.eye(4)
        if len(values.replace(",", " ").split()) == 9:
            matrix[:3, :3] = np.array(numbers_of(values, 9)).reshape(3, 3)
            return matrix
        return np.array(numbers_of(values, 16)).reshape(4, 4)
    if step.tag == "lookat":
        origin, target = (
            np.array(numbers_of(step.get(key, ""), 3)) for key in ("origin", "target")
        )
        up = np.array(numbers_of(step.get("up", "0 0 0"), 3))
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
        return rotation(axis, numbers_of(step.get("angle", ""), 1)[0])
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
        return [numbers_of(step.get(key, default), 1)[0] for key in "xyz"]
    one = len(value.replace(",", " ").split()) == 1
    return numbers_of(value, 1) * 3 if one else numbers_of(value, 3)
