"""Diffraction by a bare round hole, from its shadow to its Airy pattern: image of a point and transfer function.

    U(r) = integral over rho from 0 to a of  J0(2 pi r rho / (lambda v)) exp(i pi rho^2 (1/v + 1/z) / lambda) rho d rho

with the radius a of the hole, the film at v, the point at z; I = |U|^2. Born and Wolf, Principles of Optics, section
8.8 (the paraxial integral); Young, Pinhole optics, Applied Optics 10(12), 1971 (the pinhole camera). All lengths in
metres.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, signal, special

from twinlens.studies.pinhole.edge import DEPTH, FILM, PITCH, WAVELENGTH, crossing

Float = NDArray[np.float64]

_RINGS = 40


def intensity(radius: Float, diameter: float, film: float, depth: float, wavelength: float) -> Float:
    """|U(r)|^2 at each radius on the film.

    >>> i = intensity(np.array([0.0, 1e-2]), 0.2e-3, 0.05, np.inf, 550e-9)
    >>> bool(i[0] > 1000 * i[1])
    True
    """
    edge = 0.5 * diameter
    bend = math.pi * (1.0 / film + 1.0 / depth) / wavelength
    turns = bend * edge**2 + 2.0 * math.pi * float(radius.max()) * edge / (wavelength * film)
    nodes, weights = special.roots_legendre(64 + math.ceil(turns))
    rho = 0.5 * edge * (nodes + 1.0)
    waves = special.j0(2.0 * math.pi / (wavelength * film) * radius[:, None] * rho)
    amplitude = waves @ (0.5 * edge * weights * rho * np.exp(1j * bend * rho**2))
    return np.asarray(np.abs(amplitude) ** 2)


def fresnel_kernel(
    diameter: float, film: float, depth: float, wavelength: float, pitch: float, *, sub: int = 3,
    most_px: int | None = None,
) -> Float:  # fmt: skip
    """The image of a point on pixels of this pitch, (2R + 1, 2R + 1), sum 1.

    R covers the hole's shadow and forty Airy rings, at most `most_px`. The light outside forty rings, 2 / (40 pi^2) =
    0.5 % for a narrow hole (Rayleigh, 1881), is distributed in proportion. Each value is the mean of `sub` x `sub`
    points: 3 approximates the integral over the pixel; 1 samples the pattern, for images that are already sampled.
    """
    reach = 0.5 * diameter * (1.0 + film / depth) + _RINGS * wavelength * film / diameter
    size = int(min(math.ceil(reach / pitch), most_px or math.inf))
    radii = np.linspace(0.0, math.sqrt(2.0) * (size + 1) * pitch, 8 * size + 64)
    profile = intensity(radii, diameter, film, depth, wavelength)
    side = 2 * size + 1
    steps = (np.arange(side * sub) - (side * sub - 1) / 2) * pitch / sub
    fine = np.interp(np.hypot(steps[:, None], steps[None, :]), radii, profile)
    kernel = fine.reshape(side, sub, side, sub).sum(axis=(1, 3))
    return np.asarray(kernel / kernel.sum())


def transfer(frequency: Float, diameter: float, film: float, depth: float, wavelength: float) -> Float:
    """The optical transfer function of the hole at frequencies in cycles/m on the film.

    OTF(nu) = 1/(pi a^2) integral over |x| < a - s/2 of 2 sqrt(a^2 - (|x| + s/2)^2) cos(2 pi kappa s x / lambda) dx with
    the shift s = lambda v nu of the pupil and kappa = 1/v + 1/z (Hopkins, The frequency response of a defocused optical
    system, Proc. Roy. Soc. A 231, 1955).

    >>> transfer(np.array([0.0, 1e6]), 0.2e-3, 0.05, np.inf, 550e-9).round(6).tolist()
    [1.0, 0.0]
    """
    edge = 0.5 * diameter
    shift = wavelength * film * np.asarray(frequency, np.float64)[:, None]
    nodes, weights = special.roots_legendre(240)
    half = np.maximum(edge - 0.5 * shift, 0.0)
    x = 0.5 * half * (nodes + 1.0)
    chord = 2.0 * np.sqrt(np.maximum(edge**2 - (x + 0.5 * shift) ** 2, 0.0))
    waves = np.cos(2.0 * math.pi * (1.0 / film + 1.0 / depth) * shift * x / wavelength)
    return np.asarray((half * weights * chord * waves).sum(axis=1) / (math.pi * edge**2))


def convolved(sharp: Float, kernel: Float) -> Float:
    """A sharp grey image (H, W), extended by its edge pixels, convolved with the kernel."""
    reach = kernel.shape[0] // 2
    return np.asarray(signal.fftconvolve(np.pad(sharp, reach, mode="edge"), kernel, mode="valid"))


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
