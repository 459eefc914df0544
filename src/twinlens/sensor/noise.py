"""The EMVA 1288 linear camera model: shot noise, dark current, fixed patterns, saturation, read noise, quantisation.

A pixel with mu expected electrons counts a Poisson number of them and a Poisson number of dark electrons, saturates at
the full well, and is read with normal noise. K converts electrons to digital numbers (DN) above the black level::

    y = round(K (min(Poisson(mu (1 + PRNU)) + Poisson(dark), full well) + DSNU + read noise) + black)

Each cause of noise has its own random stream (`twinlens.seeds`), by seed, cause and camera. PRNU and DSNU are seeded
by the sensor's serial number, the others by the exposure's seed.
"""

import numpy as np
from numpy.typing import NDArray

from twinlens.seeds import generator

Float = NDArray[np.float64]

_WELLS = 4.0  # expectations are limited to four full wells, which are saturated anyway


def pattern(serial: int, name: str, eye: int, shape: tuple[int, ...]) -> Float:
    """A fixed pattern of the sensor: standard normal, equal in all exposures."""
    return generator(serial, name, eye).standard_normal(shape)


def collect(light: Float, dark: float, full_well: float, seed: int | None, eye: int) -> Float:
    """Electrons in the wells for expected `light` (an array) and `dark` electrons; no shot noise if seed is None."""
    light = np.clip(light, 0.0, _WELLS * full_well)
    if seed is None:
        return np.minimum(light + dark, full_well)
    electrons = generator(seed, "shot", eye).poisson(light).astype(np.float64)
    if dark > 0:
        electrons += generator(seed, "dark current", eye).poisson(min(dark, _WELLS * full_well), light.shape)
    return np.minimum(electrons, full_well)


def read_noise(sigma: float, shape: tuple[int, ...], seed: int, eye: int) -> Float:
    """Normal noise of `sigma` electrons rms."""
    return sigma * generator(seed, "read", eye).standard_normal(shape)


def quantise(electrons: Float, gain: float, black_level: float, bits: int) -> NDArray[np.uint16]:
    """The converter's numbers, 0 to 2^bits - 1, of electrons times `gain` (DN per electron) above the black level."""
    return np.clip(np.rint(gain * electrons + black_level), 0, 2**bits - 1).astype(np.uint16)
