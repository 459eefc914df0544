"""Whether a Mitsuba .xml is only a scene: nothing in it may run code or open a file outside its folder.

Mitsuba opens a shared library for a plugin type it does not know, follows ``include`` and ``path``, and reads whatever
file a string names; and it puts a ``$`` parameter into any attribute, so that what is read here would not be what it
sees. So the file is read here first, by a parser that refuses document types and entities, and every
element, every plugin type and every file name must be one of those known here.
"""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

from twinlens.errors import FileError
from twinlens.scenes.assets import asset, sky_picture, texture_picture
from twinlens.scenes.plugins import AREA_EMITTERS, BSDFS, CONDUCTORS, EMITTERS, INTEGRATORS, SHAPES
from twinlens.scenes.table import At, Source

PLUGINS: dict[str, set[str]] = {
    "bsdf": {*BSDFS, "pplastic", "measured"},
    "emitter": {*EMITTERS, *AREA_EMITTERS, "projector"},
    "shape": {*SHAPES, "obj", "ply", "serialized", "shapegroup", "instance", "bsplinecurve", "linearcurve"},
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
_LARGEST_FILE = 64 << 20
_DEEPEST = 200
_FILE_PARAMETER = re.compile(r"file|path", re.IGNORECASE)
_NUMBERS = re.compile(r"[\d.eE+\-,:\s]*")
_LOOKS_LIKE_PATH = re.compile(r"[/\\]|^\.|\.[A-Za-z]\w{1,7}$")


def checked_xml(path: Path) -> tuple[ElementTree.Element, list[Path]]:
    """The root element of a harmless Mitsuba file, and the files it names; InputError naming what is refused."""
    at = At(Source(path.resolve()))  # Mitsuba looks for files beside the file itself, not beside a link to it
    root = _parse(path)
    if root.tag != "scene":
        raise at.wrong(f"a Mitsuba file begins with <scene>, got <{root.tag}>")
    _check_parameters(at / "scene", root)
    _check_children(at / "scene", root, 0)
    return root, list(dict.fromkeys(at.source.assets))


def _parse(path: Path) -> ElementTree.Element:
    """The file as a tree; document types, and with them every entity, are refused while it is read."""
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise FileError(f"{path}: a scene file is text of at most {_LARGEST_FILE >> 20} MiB")
        data = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from error
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


def _check_children(at: At, parent: ElementTree.Element, depth: int) -> None:
    if depth > _DEEPEST:
        raise at.wrong(f"elements are nested more than {_DEEPEST} deep")
    for child in parent:
        here = at / child.tag
        _check_element(here, child)
        _check_children(here, child, depth + 1)


def _check_element(at: At, element: ElementTree.Element) -> None:
    tag = element.tag
    if tag not in PLUGINS.keys() | VALUES | TRANSFORMS:
        raise at.unknown("element", tag, PLUGINS.keys() | VALUES | TRANSFORMS)
    _check_parameters(at, element)
    kind = element.get("type")
    if tag in PLUGINS and not (tag == "spectrum" and kind is None):
        if kind not in PLUGINS[tag]:
            raise at.unknown(f"{tag} type", str(kind), PLUGINS[tag])
    elif kind is not None:
        raise at.wrong(f"<{tag}> takes no type")
    if tag == "emitter" and kind == "envmap":
        for file in element.iterfind("string[@name='filename']"):
            sky_picture(at / "string", file.get("value", ""))
    if tag == "texture" and kind == "bitmap":
        for file in element.iterfind("string[@name='filename']"):
            texture_picture(at / "string", file.get("value", ""))
    if tag == "default":
        _no_path(at, element.get("value", ""))
    if tag == "spectrum":
        _check_file(at, element.get("filename"))
        if not _NUMBERS.fullmatch(element.get("value", "")):
            raise at.wrong(f"{element.get('value')!r}: write the spectrum's numbers, as 400:1.0, 700:1.5")
    if tag == "string":
        _check_string(at, element.get("name", ""), element.get("value", ""))


def _check_parameters(at: At, element: ElementTree.Element) -> None:
    """``$`` may stand for numbers alone: in a name, a type or a string it would hide what Mitsuba makes of it."""
    for name, value in element.attrib.items():
        if "$" in value and not (element.tag in _NUMERIC_TAGS and name in _NUMERIC_ATTRIBUTES):
            raise at.wrong(f"{name}={value!r}: write the {name} itself; only numbers may come from $ parameters")


def _check_string(at: At, name: str, value: str) -> None:
    if _FILE_PARAMETER.search(name):
        _check_file(at, value)
    elif name == "material" and value not in CONDUCTORS:
        raise at.unknown("conductor", value, CONDUCTORS)
    else:
        _no_path(at, value)


def _check_file(at: At, value: str | None) -> None:
    if value is None:
        return
    asset(at, value)


def _no_path(at: At, value: str) -> None:
    if _LOOKS_LIKE_PATH.search(value):
        raise at.wrong(f"{value!r} looks like a file's name where none belongs")
    if 0 < len(value.encode()) < 256 and (at.source.folder / value).is_symlink():
        asset(at, value)  # whatever reads it after all must find it below the folder
