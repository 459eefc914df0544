"""The slanted edge that `pinhole` looks at, its camera, and what wave optics says of the hole before it."""

import math
from functools import lru_cache

import numpy as np
from scipy import optimize

from twinlens.camera import Camera
from twinlens.scenes import Scene, SceneObject
from twinlens.studies.fresnel import transfer
from twinlens.studies.slanted_edge import crossing

FILM = 0.05
PITCH = 25e-6
WAVELENGTH = 550e-9
DEPTH = 10.0
SLANT = math.radians(5.0)
"""Metres, and the edge's angle off the vertical."""


@lru_cache
def theory(millimetres: float, contrast: float) -> float:
    """The frequency (cycles/mm on the film) at which Hopkins's transfer function times the pixel's reads so."""
    frequency = np.linspace(0.0, 0.5 / PITCH, 2001)
    contrasts = transfer(frequency, 1e-3 * millimetres, FILM, DEPTH, WAVELENGTH) * np.sinc(frequency * PITCH)
    return crossing(frequency, contrasts, contrast) / 1e3


@lru_cache
def theoretical_best(contrast: float) -> float:
    """The diameter (mm) at which `theory` is largest."""
    found = optimize.minimize_scalar(lambda d: -theory(d, contrast), bounds=(0.12, 0.45), method="bounded")
    return float(found.x)


def edge_camera(finer: int = 1) -> Camera:
    """That looks at the edge: its film is at `FILM`, its pixels are `PITCH` wide; or so many times finer."""
    fx, width, height = finer * FILM / PITCH, finer * 420, finer * 90
    return Camera(width, height, fx, fx, 0.5 * (width - 1), 0.5 * (height - 1))


def edge_scene() -> Scene:
    """A shining half plane at `DEPTH`, its edge near the axis, `SLANT` off the vertical."""
    size = 4.0
    pose = np.eye(4)
    sine, cosine = math.sin(SLANT), math.cos(SLANT)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    pose[:3, :3] = turn @ np.diag([size, -size, -1.0])
    pose[:3, 3] = turn @ np.array([-size, 0.0, 0.0]) + np.array([0.0, 0.0, DEPTH])
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    half = SceneObject("half", {"type": "rectangle"}, "black", pose, glow)
    black = {"black": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}}
    return Scene("edge", (half,), black, np.eye(4), (5.0, 20.0), integrator={"type": "path", "max_depth": 2})
