"""A point's light behind a bare round hole, by Fresnel's integral: between the shadow of the hole and its Airy pattern.

    U(r) = integral over rho from 0 to a of  J0(2 pi r rho / (lambda v)) exp(i pi rho^2 (1/v + 1/z) / lambda) rho d rho

with the hole's radius a, the film at v, the point at z; I = |U|^2 (Born and Wolf, Principles of Optics, section 8.8,
the paraxial integral; Young, Pinhole optics, Applied Optics 10(12), 1971, of the pinhole camera).
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import signal, special

Float = NDArray[np.float64]

_SUB = 3
_RINGS_OUT = 40


def intensity(radius: Float, diameter: float, film: float, depth: float, wavelength: float) -> Float:
    """|U(r)|^2 at each radius (metres, on the film), U as above.

    >>> i = intensity(np.array([0.0, 1e-2]), 0.2e-3, 0.05, np.inf, 550e-9)
    >>> bool(i[0] > 1000 * i[1])
    True
    """
    edge = 0.5 * diameter
    bend = math.pi * (1.0 / film + 1.0 / depth) / wavelength
    turns = bend * edge**2 + 2.0 * math.pi * float(radius.max()) * edge / (wavelength * film)
    nodes, weights = np.polynomial.legendre.leggauss(64 + math.ceil(turns))
    rho = 0.5 * edge * (nodes + 1.0)
    waves = special.j0(2.0 * math.pi / (wavelength * film) * radius[:, None] * rho)
    amplitude = waves @ (0.5 * edge * weights * rho * np.exp(1j * bend * rho**2))
    return np.asarray(np.abs(amplitude) ** 2)


def fresnel_kernel(
    diameter: float, film: float, depth: float, wavelength: float, pitch: float, *, sub: int = _SUB,
    most_px: int | None = None,
) -> Float:  # fmt: skip
    """A point's light on the pixels around it, (2R + 1, 2R + 1), sum 1.

    R takes in the hole's shadow and forty Airy rings beyond, or is `most_px`, if that is less. Outside forty rings
    lies 2 / (40 pi^2) = 0.5 % of a narrow hole's light (Rayleigh, 1881); it is given back to the rest in proportion.
    Each value is the mean of `sub` x `sub` points of a pixel: of 3 it is near the pixel's integral, for the image of a
    point; 1 samples the pattern, for a picture that has been through its pixels already.
    """
    reach = 0.5 * diameter * (1.0 + film / depth) + _RINGS_OUT * wavelength * film / diameter
    size = min(math.ceil(reach / pitch), most_px or math.inf)
    radii = np.linspace(0.0, math.sqrt(2.0) * (size + 1) * pitch, 8 * int(size) + 64)
    profile = intensity(radii, diameter, film, depth, wavelength)
    side = 2 * int(size) + 1
    steps = (np.arange(side * sub) - (side * sub - 1) / 2) * pitch / sub
    fine = np.interp(np.hypot(steps[:, None], steps[None, :]), radii, profile)
    kernel = fine.reshape(side, sub, side, sub).sum(axis=(1, 3))
    whole: Float = kernel / kernel.sum()
    return whole


def transfer(frequency: Float, diameter: float, film: float, depth: float, wavelength: float) -> Float:
    """The hole's optical transfer function, in closed form but for one integral: no pattern, pixel or picture in it.

    OTF(nu) = 1/(pi a^2) integral over |x| < a - s/2 of 2 sqrt(a^2 - (|x| + s/2)^2) cos(2 pi kappa s x / lambda) dx with
    the pupil's shift s = lambda v nu and kappa = 1/v + 1/z; frequency in cycles a metre on the film (Hopkins, The
    frequency response of a defocused optical system, Proc. Roy. Soc. A 231, 1955).

    >>> transfer(np.array([0.0, 1e6]), 0.2e-3, 0.05, np.inf, 550e-9).round(6).tolist()
    [1.0, 0.0]
    """
    edge = 0.5 * diameter
    shift = wavelength * film * np.asarray(frequency, np.float64)[:, None]
    nodes, weights = np.polynomial.legendre.leggauss(240)
    half = np.maximum(edge - 0.5 * shift, 0.0)
    x = 0.5 * half * (nodes + 1.0)
    chord = 2.0 * np.sqrt(np.maximum(edge**2 - (x + 0.5 * shift) ** 2, 0.0))
    waves = np.cos(2.0 * math.pi * (1.0 / film + 1.0 / depth) * shift * x / wavelength)
    total: Float = (half * weights * chord * waves).sum(axis=1) / (math.pi * edge**2)
    return total


def through_hole(sharp: Float, kernel: Float) -> Float:
    """A sharp grey picture (H, W) as the kernel blurs it; continued by its edge pixels."""
    reach = kernel.shape[0] // 2
    blurred: Float = signal.fftconvolve(np.pad(sharp, reach, mode="edge"), kernel, mode="valid")
    return blurred
