"""A Mitsuba file in a frame (`rendering.frames`): its shapes, and its lights at points, before Mitsuba loads them."""

from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.frames import WORLD, SceneFrame
from twinlens.scenes.xml_file import numbers_of, to_world_of

_OF_ONE_SIZE = ("bsplinecurve", "linearcurve")  # their radii are not those of to_world
_AT_A_POINT = ("point", "spot", "projector")
_NAMES = ("to_world", "toWorld")
_INTENSITIES = ("intensity.value", "intensity.data", "scale")
"""The parameters of lights at points that scale their light; `scale` is that of a projector."""


def place(root: Element, frame: SceneFrame) -> SceneFrame:
    """Write poses in `frame` into the elements of a checked file. Returns the frame that they have.

    It has metres as units where the file has a medium, curves, or a black body at a point, whose units are not those of
    poses. It is the world where a pose cannot be read; Mitsuba will say so.
    """
    if not _is_scalable(root):
        frame = SceneFrame(frame.origin)
    placed = [*_shapes(root), *_lights_at_points(root)]
    try:
        poses = [_pose(element, frame) for element in placed]
        bumps = [_bump_scale(element) * frame.scale for element in _bumps(root)]
    except InputError:
        return WORLD
    for element, pose in zip(placed, poses, strict=True):
        _remove(element, (*_NAMES, "center", "position"))
        transform = SubElement(element, "transform", name="to_world")
        values = " ".join(map(repr, pose.ravel().tolist()))
        SubElement(transform, "matrix", value=values)
    for element, scale in zip(_bumps(root), bumps, strict=True):
        _remove(element, ("scale",))
        SubElement(element, "float", name="scale", value=repr(scale))
    return frame


def scale_lights(mi_scene: Any, scale: float) -> None:
    """Multiply the intensity of the lights at points of a file by scale^2."""
    for emitter in mi_scene.emitters():
        parameters = mitsuba().traverse(emitter)
        if not _is_at_a_point(emitter):
            continue
        for name in _INTENSITIES:
            if name in parameters:
                parameters[name] = parameters[name] * scale**2
        parameters.update()


def _is_at_a_point(emitter: Any) -> bool:
    return bool(int(emitter.flags()) & int(mitsuba().EmitterFlags.DeltaPosition))


def _is_scalable(root: Element) -> bool:
    """Whether all lengths of a file are those of poses, or can be converted."""
    has_media = next(root.iter("medium"), None) is not None
    curves = [
        shape for shape in root.iter("shape") if shape.get("type") in _OF_ONE_SIZE
    ]
    spectra: list[str | None] = []
    for light in _lights_at_points(root):
        spectra += [spectrum.get("type") for spectrum in light.iter("spectrum")]
    return not (has_media or curves or "blackbody" in spectra)


def _shapes(root: Element) -> Iterator[Element]:
    """The shapes of the scene, and instances, but not the shapes of a group."""
    for shape in root.findall("shape"):
        if shape.get("type") != "shapegroup":
            yield shape


def _lights_at_points(root: Element) -> Iterator[Element]:
    for light in root.findall("emitter"):
        if light.get("type") in _AT_A_POINT:
            yield light


def _bumps(root: Element) -> list[Element]:
    return [bsdf for bsdf in root.iter("bsdf") if bsdf.get("type") == "bumpmap"]


def _bump_scale(element: Element) -> float:
    for child in element:
        if child.get("name") == "scale":
            return numbers_of(child.get("value", ""), 1)[0]
    return 1.0


def _pose(element: Element, frame: SceneFrame) -> Float:
    """frame_from_shape, with the place of a sphere or a point; of a light without a scale."""
    pose = to_world_of(element)
    for name in ("center", "position"):
        for child in element.findall("point"):
            if child.get("name") == name:
                offset = np.eye(4)
                offset[:3, 3] = _point(child)
                pose = pose @ offset
    return frame.affine(pose) if element.tag == "shape" else frame.rigid(pose)


def _point(element: Element) -> list[float]:
    value = element.get("value")
    if value is not None:
        return numbers_of(value, 3)
    return [numbers_of(element.get(axis, "0"), 1)[0] for axis in "xyz"]


def _remove(element: Element, names: tuple[str, ...]) -> None:
    """Remove the children of these names."""
    element[:] = [child for child in element if child.get("name") not in names]
