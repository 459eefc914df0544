"""Self-luminous test targets: only the camera adds noise to their images.

Sizes follow from pixels of the camera: a plane at twice the distance has a print of twice the size and the same image.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.camera import Rig
from twinlens.scenes import Bitmap, Plugin, Scene, SceneObject
from twinlens.studies.stage import stream

Float = NDArray[np.float64]

TEXELS_PER_PIXEL = 2.0
GLOW: Plugin = {"type": "rgb", "value": 1.0}
"""A radiance of 1."""
_SPARE = 1.15
_MARGIN_PX = 16
_BLACK: Plugin = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
_FACING = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns a rectangle, whose normal is +z and whose v axis points up, towards a camera with y down."""


def glowing(name: str, parts: Sequence[tuple[str, Plugin, Float, Any]], depth: float) -> Scene:
    """A scene of black area lights, seen from the origin; parts: (name, shape, world_from_object, radiance)."""
    objects = tuple(
        SceneObject(part, shape, "black", pose, {"type": "area", "radiance": radiance})
        for part, shape, pose, radiance in parts
    )
    span = (0.5 * depth, 2.0 * depth)
    return Scene(name, objects, {"black": _BLACK}, np.eye(4), span, integrator={"type": "path", "max_depth": 2})


def noise_texture(width: int, height: int, scale: float, contrast: float, seed: int) -> Float:
    """Smooth noise (height, width) of mean 0.5 and standard deviation 0.5 `contrast`, clipped to [0, 1].

    scale: standard deviation in texels of the Gaussian that smooths white noise.
    """
    white = np.random.default_rng(seed).standard_normal((height, width))
    smooth = ndimage.gaussian_filter(white, scale, mode="wrap")
    return np.asarray(np.clip(0.5 + 0.5 * contrast * (smooth - smooth.mean()) / smooth.std(), 0.0, 1.0))


def plane_size(rig: Rig, depth: float) -> tuple[float, float]:
    """Width and height in metres of a plane at `depth` (m) that fills both views."""
    camera = rig.cameras[0]
    across = _SPARE * ((camera.width + 2 * _MARGIN_PX) * depth / camera.fx) + 2 * rig.baseline(0, 1)
    return across, _SPARE * (camera.height + 2 * _MARGIN_PX) * depth / camera.fy


def texels(rig: Rig, depth: float) -> tuple[int, int]:
    """Width and height of a texture with `TEXELS_PER_PIXEL` on a plane that fills both views."""
    pixel = depth / rig.cameras[0].fx / TEXELS_PER_PIXEL
    width, height = plane_size(rig, depth)
    return math.ceil(width / pixel), math.ceil(height / pixel)


def noise_plane(rig: Rig, depth: float, seed: int, *, scale_px: float = 0.8, contrast: float = 0.5) -> Scene:
    """A plane of smooth noise at `depth` (m), parallel to the images of a rig at the world's origin.

    scale_px: standard deviation of the smoothing, left pixels.
    """
    texture = noise_texture(*texels(rig, depth), scale_px * TEXELS_PER_PIXEL, contrast, stream(seed, 100))
    width, height = plane_size(rig, depth)
    pose = _FACING @ np.diag([0.5 * width, 0.5 * height, 1.0, 1.0])
    pose[:3, 3] += np.array([0.5 * rig.baseline(0, 1), 0.0, depth])
    return glowing("plane", [("plane", {"type": "rectangle"}, pose, Bitmap(texture.astype(np.float32)))], depth)
