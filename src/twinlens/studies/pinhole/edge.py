"""The slanted edge of the study `pinhole`, its camera, and the sharpness that wave optics predicts."""

import math
from functools import lru_cache

import numpy as np
from scipy import optimize

from twinlens.camera import Camera
from twinlens.scenes import Scene
from twinlens.studies.pinhole.fresnel import transfer
from twinlens.studies.pinhole.slanted_edge import crossing
from twinlens.studies.targets import GLOW, glowing

FILM, PITCH, WAVELENGTH, DEPTH = 0.05, 25e-6, 550e-9, 10.0
"""Film distance, pixel pitch, wavelength and distance of the edge, metres."""
SLANT = math.radians(5.0)
"""Angle between the edge and the vertical."""


@lru_cache
def predicted_frequency(millimetres: float, contrast: float) -> float:
    """The frequency (cycles/mm on the film) at which Hopkins's transfer function times the pixel's is `contrast`."""
    frequency = np.linspace(0.0, 0.5 / PITCH, 2001)
    contrasts = transfer(frequency, 1e-3 * millimetres, FILM, DEPTH, WAVELENGTH) * np.sinc(frequency * PITCH)
    return crossing(frequency, contrasts, contrast) / 1e3


@lru_cache
def predicted_best(contrast: float) -> float:
    """The hole diameter (mm) with the highest `predicted_frequency`."""
    found = optimize.minimize_scalar(lambda d: -predicted_frequency(d, contrast), bounds=(0.12, 0.45), method="bounded")
    return float(found.x)


def edge_camera(finer: int = 1) -> Camera:
    """The camera with film distance FILM and pixel pitch PITCH, or a pitch smaller by an integer factor."""
    fx, width, height = finer * FILM / PITCH, finer * 420, finer * 90
    return Camera(width, height, fx, fx, 0.5 * (width - 1), 0.5 * (height - 1))


def edge_scene() -> Scene:
    """A luminous half plane at DEPTH, its edge near the axis."""
    size = 4.0
    pose = np.eye(4)
    sine, cosine = math.sin(SLANT), math.cos(SLANT)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    pose[:3, :3] = turn @ np.diag([size, -size, -1.0])
    pose[:3, 3] = turn @ np.array([-size, 0.0, 0.0]) + np.array([0.0, 0.0, DEPTH])
    return glowing("edge", [("half", {"type": "rectangle"}, pose, GLOW)], DEPTH)
