"""Electrons and their numbers: shot noise, dark current, the pattern of unlike pixels, the well, the converter.

EMVA 1288's linear camera: a pixel that expects mu electrons of light counts a Poisson number of them, gathers a Poisson
number of dark ones, holds no more than a full well, and is read with normal noise; K turns electrons into digital
numbers (DN) above the black level::

    y = round(K (min(Poisson(mu (1 + PRNU)) + Poisson(dark), full well) + DSNU + read noise) + black)

Every draw comes from a named stream of its seed, in one thread: same seed, same bytes. PRNU and DSNU belong to the
sensor (its serial number and the eye it sits in), the rest to the exposure.
"""

import zlib

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

_WELLS = 4.0  # an expectation of more than four full wells is four: full all the same, and Poisson numbers stay small


def stream(seed: int, name: str, eye: int) -> np.random.Generator:
    """The random numbers of one cause of noise: independent between seeds, names and eyes."""
    key = (zlib.crc32(name.encode()), eye)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def pattern(serial: int, name: str, eye: int, shape: tuple[int, ...]) -> Float:
    """A sensor's fixed pattern: standard normal, the same in every exposure."""
    return stream(serial, name, eye).standard_normal(shape)


def collect(light: Float, dark: float, full_well: float, seed: int | None, eye: int) -> Float:
    """Electrons in the wells, of expected `light` (an array) and `dark` electrons; no shot noise if seed is None."""
    light = np.clip(light, 0.0, _WELLS * full_well)
    if seed is None:
        return np.minimum(light + dark, full_well)
    electrons = stream(seed, "shot", eye).poisson(light).astype(np.float64)
    if dark > 0:
        electrons += stream(seed, "dark current", eye).poisson(min(dark, _WELLS * full_well), light.shape)
    return np.minimum(electrons, full_well)


def read_noise(sigma: float, shape: tuple[int, ...], seed: int, eye: int) -> Float:
    """Normal electrons of standard deviation `sigma`."""
    return sigma * stream(seed, "read", eye).standard_normal(shape)


def quantise(electrons: Float, gain: float, black_level: float, bits: int) -> NDArray[np.uint16]:
    """The converter's numbers, 0 to 2^bits - 1, of electrons times `gain` (DN per electron) above the black level."""
    return np.clip(np.rint(gain * electrons + black_level), 0, 2**bits - 1).astype(np.uint16)
