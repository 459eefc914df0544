"""Test targets that studies photograph: textured planes that shine by themselves, so that only the camera adds noise.

Sizes are chosen in pixels of the camera that looks: a plane twice as far is printed twice as large, and differs in
nothing but its distance.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.camera import Rig
from twinlens.scenes import Bitmap, Plugin, Scene, SceneObject
from twinlens.studies.stage import stream

Float = NDArray[np.float64]

TEXELS_PER_PIXEL = 2.0
_SPARE = 1.15
_MARGIN_PX = 16
_BLACK: Plugin = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
_FACING = np.diag([1.0, -1.0, -1.0, 1.0])
"""A rectangle's normal is +z and its v runs up: turned to face a camera whose y runs down."""


def noise_texture(width: int, height: int, scale: float, contrast: float, seed: int) -> Float:
    """Smooth noise (height, width) of mean 0.5 and standard deviation 0.5 `contrast`, clipped to [0, 1].

    scale: standard deviation of the Gaussian that smooths white noise, in texels: details are about 4 scales wide.
    """
    white = np.random.default_rng(seed).standard_normal((height, width))
    smooth = ndimage.gaussian_filter(white, scale, mode="wrap")
    grey: Float = np.clip(0.5 + 0.5 * contrast * (smooth - smooth.mean()) / smooth.std(), 0.0, 1.0)
    return grey


def plane(rig: Rig, depth: float, texture: Float, tilt: float = 0.0) -> Scene:
    """A shining plane of `texture` (H, W) at `depth` (m) on the left axis, filling both views of a parallel rig.

    tilt: radians about the vertical; left comes nearer. The rig stands at the world's origin.
    """
    width, height = plane_size(rig, depth, tilt)
    turn = np.eye(4)
    sine, cosine = math.sin(tilt), math.cos(tilt)
    turn[:3, :3] = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    pose = turn @ _FACING @ np.diag([0.5 * width, 0.5 * height, 1.0, 1.0])
    pose[:3, 3] += np.array([0.5 * rig.baseline(0, 1), 0.0, depth])
    return shining("plane", [("plane", {"type": "rectangle"}, pose, Bitmap(texture.astype(np.float32)))], depth)


def plane_size(rig: Rig, depth: float, tilt: float = 0.0) -> tuple[float, float]:
    """Width and height in metres of a plane that fills both views with some to spare."""
    camera = rig.cameras[0]
    far = depth / max(math.cos(tilt) - 0.5 * camera.width / camera.fx * abs(math.sin(tilt)), 0.2)
    across = _SPARE * ((camera.width + 2 * _MARGIN_PX) * far / camera.fx) / math.cos(tilt) + 2 * rig.baseline(0, 1)
    return across, _SPARE * (camera.height + 2 * _MARGIN_PX) * far / camera.fy


def texels(rig: Rig, depth: float, tilt: float = 0.0) -> tuple[int, int]:
    """Texture size (width, height) with `TEXELS_PER_PIXEL` at the plane's middle."""
    pixel = depth / rig.cameras[0].fx / TEXELS_PER_PIXEL
    width, height = plane_size(rig, depth, tilt)
    return math.ceil(width / pixel), math.ceil(height / pixel)


def noise_plane(
    rig: Rig, depth: float, seed: int, *, scale_px: float = 0.8, contrast: float = 0.5, tilt: float = 0.0
) -> Scene:
    """A plane of smooth noise whose grain is `scale_px` (standard deviation of the smoothing, left pixels)."""
    width, height = texels(rig, depth, tilt)
    grain = noise_texture(width, height, scale_px * TEXELS_PER_PIXEL, contrast, stream(seed, 100))
    return plane(rig, depth, grain, tilt)


def shining(name: str, parts: list[tuple[str, Plugin, Float, Bitmap]], depth: float) -> Scene:
    """A scene of black things that shine with a picture, seen from the origin."""
    objects = tuple(
        SceneObject(part, shape, "black", pose, {"type": "area", "radiance": picture})
        for part, shape, pose, picture in parts
    )
    span = (0.5 * depth, 2.0 * depth)
    return Scene(name, objects, {"black": _BLACK}, np.eye(4), span, integrator={"type": "path", "max_depth": 2})
