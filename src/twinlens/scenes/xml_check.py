"""Checks that a Mitsuba .xml is only a scene: nothing in it may run code or open a file outside its folder.

Mitsuba opens a shared library for a plugin type that it does not know, follows ``include`` and ``path``, and reads any
file that a string names. It also substitutes ``$`` parameters in every attribute. So the file is read here first, by a
parser that rejects document types and entities, and every element, plugin type and file name must be a known one.
"""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

from twinlens.errors import FileError, InputError, unknown
from twinlens.scenes.assets import SceneContext, decode_picture, find_asset, read_limited, read_sky
from twinlens.scenes.objects import ANALYTIC_SHAPES
from twinlens.scenes.plugins import AREA_LIGHTS, CONDUCTORS, INTEGRATORS, LIGHTS, MATERIALS

PLUGINS: dict[str, set[str]] = {
    "bsdf": {*MATERIALS, "pplastic", "measured"},
    "emitter": {*LIGHTS, *AREA_LIGHTS, "projector"},
    "shape": {*ANALYTIC_SHAPES, "obj", "ply", "serialized", "shapegroup", "instance", "bsplinecurve", "linearcurve"},
    "sensor": {"perspective", "thinlens"},
    "film": {"hdrfilm"},
    "sampler": {"independent", "stratified", "multijitter", "orthogonal", "ldsampler"},
    "rfilter": {"box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos"},
    "integrator": {*INTEGRATORS, "volpath", "volpathmis"},
    "texture": {"bitmap", "checkerboard", "mesh_attribute"},
    "spectrum": {"uniform", "regular", "irregular", "srgb", "d65", "blackbody", "rawconstant"},
    "medium": {"homogeneous", "heterogeneous"},
    "volume": {"constvolume", "gridvolume"},
    "phase": {"isotropic", "hg", "rayleigh"},
}
VALUES = {"boolean", "integer", "float", "string", "rgb", "vector", "point", "ref", "alias", "default"}
TRANSFORMS = {"transform", "translate", "rotate", "scale", "lookat", "matrix"}
_NUMERIC_TAGS = {"boolean", "integer", "float", "rgb", "vector", "point", *TRANSFORMS}
_NUMERIC_ATTRIBUTES = {"value", "x", "y", "z", "angle", "origin", "target", "up"}
_DEEPEST = 200
_FILE_PARAMETER = re.compile(r"file|path", re.IGNORECASE)
_NUMBERS = re.compile(r"[\d.eE+\-,:\s]*")
_LOOKS_LIKE_PATH = re.compile(r"[/\\]|^\.|\.[A-Za-z]\w{1,7}$")


def checked_xml(path: Path) -> tuple[ElementTree.Element, list[Path]]:
    """The root element of a harmless Mitsuba file, and the files it names; InputError for anything else."""
    context = SceneContext(path.resolve().parent)  # Mitsuba resolves names from the file's folder, not a link's
    root = _parse(path)
    if root.tag != "scene":
        raise InputError(f"{path}: a Mitsuba file starts with <scene>, got <{root.tag}>")
    elements = [("scene", root, 0)]
    while elements:
        where, element, depth = elements.pop()
        try:
            if depth > _DEEPEST:
                raise InputError(f"elements are nested more than {_DEEPEST} deep")
            _check_element(element, context)
        except InputError as error:
            place = "scene" if depth > _DEEPEST else where
            raise InputError(f"{path}: {place}: {error}") from error
        elements += [(f"{where}.{child.tag}", child, depth + 1) for child in reversed(element)]
    return root, list(dict.fromkeys(context.files))


def _parse(path: Path) -> ElementTree.Element:
    """The file as a tree; document types and entities are rejected while it is read."""
    data = read_limited(path, 64 << 20)
    builder = ElementTree.TreeBuilder()
    parser = expat.ParserCreate()

    def refuse(*_: Any) -> None:
        raise FileError(f"{path}: line {parser.CurrentLineNumber}: a scene needs no <!DOCTYPE> or <!ENTITY>; remove it")

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise FileError(f"{path}: not well-formed XML: {error}") from error
    return builder.close()


def _check_element(element: ElementTree.Element, context: SceneContext) -> None:
    tag, kind = element.tag, element.get("type")
    if tag not in PLUGINS.keys() | VALUES | TRANSFORMS | {"scene"}:
        raise unknown("element", tag, PLUGINS.keys() | VALUES | TRANSFORMS)
    for key, text in element.attrib.items():
        if "$" in text and not (tag in _NUMERIC_TAGS and key in _NUMERIC_ATTRIBUTES):
            raise InputError(f"{key}={text!r}: write the {key} itself; $ parameters may replace numbers only")
    if tag in PLUGINS and not (tag == "spectrum" and kind is None):
        if kind not in PLUGINS[tag]:
            raise unknown(f"{tag} type", str(kind), PLUGINS[tag])
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
        raise InputError(f"{value!r}: write the spectrum's numbers, as 400:1.0, 700:1.5")
    name = element.get("name", "")
    if tag == "string" and _FILE_PARAMETER.search(name):
        find_asset(value, context)
    elif tag == "string" and name == "material":
        if value not in CONDUCTORS:
            raise unknown("conductor", value, CONDUCTORS)
    elif tag == "string":
        _check_no_path(value, context)


_PICTURES: dict[tuple[str, str | None], Any] = {("emitter", "envmap"): read_sky, ("texture", "bitmap"): decode_picture}


def _check_no_path(value: str, context: SceneContext) -> None:
    if _LOOKS_LIKE_PATH.search(value):
        raise InputError(f"{value!r} looks like a file name, which is not allowed here")
    if 0 < len(value.encode()) < 256 and (context.folder / value).is_symlink():
        find_asset(value, context)  # if a plugin reads it nevertheless, it must be below the folder
