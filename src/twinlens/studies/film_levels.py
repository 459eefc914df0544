"""The level and the noise of an evenly lit film behind a bare hole, as the radiometry of `Sensor` has them."""

import math

import numpy as np

from twinlens.camera import BareAperture, Camera
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.edge_target import FILM, WAVELENGTH
from twinlens.studies.stage import stream

SENSOR = Sensor.preset(
    "machine_vision", filters="mono", output="linear", bits=16, wavelengths=(WAVELENGTH,) * 3, prnu=0.0, dsnu=0.0
)


def white_rate(camera: Camera, millimetres: float) -> float:
    """Shares of white a second that a radiance of 1 gives through this hole."""
    white = np.ones((camera.height, camera.width, 3), np.float32)
    return float(SENSOR.level_rate(white, camera=camera, lens=BareAperture(1e-3 * millimetres, FILM)).mean())


def light_of(camera: Camera, hole: BareAperture, seed: int, k: int) -> float:
    """Mean level of an evenly lit film over the exposure time, which brings any hole to about a half of white."""
    time = 0.5 / white_rate(camera, 1e3 * hole.diameter)
    white = np.ones((camera.height, camera.width, 3), np.float32)
    photo = SENSOR.expose(white, camera=camera, lens=hole, seed=stream(seed, 3, k), exposure=Exposure(time))
    return float(photo.image.mean()) / time


def signal_to_noise(camera: Camera, hole: BareAperture, exposure: Exposure, seed: int) -> float:
    """Mean over standard deviation of an evenly lit film at this exposure; NaN where it burns out."""
    white = np.ones((camera.height, camera.width, 3), np.float32)
    image = SENSOR.expose(white, camera=camera, lens=hole, seed=seed, exposure=exposure).image.astype(np.float64)
    return math.nan if image.max() >= 65535 else float(image.mean() / image.std())
