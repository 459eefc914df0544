"""Small lamps at known depths: what their images measure of a lens, with no texture, matcher or truth map in between.

A lamp's image through a wide lens is the aperture itself, a disk: its diameter is read off its variance, and the
distance between its two images is its disparity.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens, Rig
from twinlens.rendering import render
from twinlens.scenes import Scene, SceneObject

Float = NDArray[np.float64]

_BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
_LAMP_PX = 3.0
"""Diameter of a lamp's own image, pixels; its variance is taken out of what is measured."""


def lamp(camera: Camera, depth: float, across: float = 0.0) -> Scene:
    """One shining ball on black at `depth` (m), `across` metres right of the axis."""
    pose = np.diag([1.0, 1.0, 1.0, 1.0])
    pose[:3, :3] *= 0.5 * _LAMP_PX * depth / camera.fx
    pose[:3, 3] = (across, 0.0, depth)
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    ball = SceneObject("lamp", {"type": "sphere"}, "black", pose, glow)
    span = (0.5 * depth, 2.0 * depth)
    return Scene("lamp", (ball,), {"black": _BLACK}, np.eye(4), span, integrator={"type": "path", "max_depth": 2})


def blur_and_disparity(rig: Rig, lens: Lens, depth: float, spp: int, seed: int) -> tuple[float, float]:
    """(blur diameter, disparity) in pixels, measured on the images of a lamp at `depth` between the two eyes."""
    scene = lamp(rig.cameras[0], depth, 0.5 * rig.baseline(0, 1))
    images = [image.mean(axis=-1).astype(np.float64) for image in render(scene, rig, lens, spp, seed)]
    disparity = _centre(images[0])[0] - _centre(images[1])[0]
    return float(np.mean([disk_diameter(image) for image in images])), disparity


def disk_diameter(image: Float, own: float = _LAMP_PX) -> float:
    """Diameter in pixels of a uniform disk: its variance along each axis is D^2/16.

    Taken from the light's second moments, less those of the pixel (1/12) and of the lamp's own image.
    """
    u, v = _centre(image)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    both = float((((columns - u) ** 2 + (rows - v) ** 2) * image).sum() / image.sum())
    return math.sqrt(max(8.0 * (both - 2.0 / 12.0) - own**2, 0.0))


def _centre(image: Float) -> tuple[float, float]:
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    total = float(image.sum())
    return float((columns * image).sum() / total), float((rows * image).sum() / total)


def straight_line(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Slope and intercept of the least-squares line."""
    slope, intercept = np.polyfit(np.asarray(x, np.float64), np.asarray(y, np.float64), 1)
    return float(slope), float(intercept)
