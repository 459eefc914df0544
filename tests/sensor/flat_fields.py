"""A camera, a lens of f/4 and flat fields, which the tests of sensors expose."""

import numpy as np

from twinlens.camera import Camera, Rig, ThinLens
from twinlens.sensor import Exposure, Photo, Sensor

CAMERA = Camera(96, 64, 100.0, 100.0, 47.5, 31.5)
LENS = ThinLens(CAMERA.film_distance / 4, focus_distance=2.0)
RIG = Rig.stereo(CAMERA, baseline=0.1)
WHITE = np.ones((64, 96, 3))
QUIET = Sensor.preset("ideal", shot_noise=False, output="linear", bits=16)
"""Its images, over 65535, are the share of white."""


def colours() -> np.ndarray:
    """An image of three channels that differ, (64, 96, 3)."""
    v, u = np.mgrid[:64, :96]
    return np.stack([1 + np.sin(u / 7), 1 + np.cos(v / 5), 0.2 + u / 96], axis=-1)


def shot(sensor: Sensor, image=WHITE, lens=LENS, camera=CAMERA, **how) -> Photo:
    return sensor.expose(image, camera=camera, lens=lens, **how)


def exposure_to(level: float, sensor: Sensor, image=WHITE, lens=LENS) -> Exposure:
    """The exposure for which the brightest channel of an image is `level` of white."""
    rate = sensor.level_rate(image, camera=CAMERA, lens=lens)
    return Exposure(level / rate.max())


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])
