"""Diffraction at a circular aperture: the Airy pattern, integrated over pixels, and a picture blurred by it.

The light of a point falls on the film as ``I(r) = (2 J1(x)/x)^2`` with x = pi r / (lambda N) and the working f-number
N = v/A: film distance over aperture diameter. Its first dark ring has the radius 1.22 lambda N. Film lengths in metres,
`_px` in pixels.

Sources: Airy, On the diffraction of an object-glass with circular aperture, 1835; Rayleigh, On images formed without
reflection or refraction, 1881, for the energy within a radius; Born and Wolf, Principles of Optics, 7th ed., section
8.5.2, and 8.8 for the Fresnel number.
"""

import math
import warnings
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.special import j0, j1

from twinlens.camera import BareAperture, Camera, Lens, film_distance
from twinlens.camera.lens import check_lens
from twinlens.camera.radiance import checked_radiance
from twinlens.errors import InputError, check_number, check_triple, format_value
from twinlens.optics import AIRY_FIRST_ZERO, LONGEST, SHORTEST, check_diameter, check_length

Float = NDArray[np.float64]

CHANNEL_WAVELENGTHS = (611e-9, 549e-9, 464e-9)
"""Metres, for red, green and blue: the dominant wavelengths of the primaries of sRGB (Rec. ITU-R BT.709) under D65.

The renderer's colours are amounts of these three primaries, so each is treated as light of its dominant wavelength.
"""

TAIL = 0.005
"""The share of the light outside the kernel, at most, unless the image is smaller: the pattern has no end."""

FRESNEL_LOW, FRESNEL_HIGH = 0.2, 50.0
"""Between these Fresnel numbers a bare hole's pattern is another one: over a tenth of the light lands elsewhere."""

_MOST_NODES = 64
_LARGEST_RADIUS = 16384
_SHORTEST_WAVE, _LONGEST_WAVE = 1e-9, 1e-3


class FresnelWarning(UserWarning):
    """A bare hole is neither wide nor narrow enough for its blur and its diffraction to be taken in turn."""


def airy_radius(wavelength: float, working_f_number: float) -> float:
    """Radius of the first dark ring on the film, 1.22 lambda N, in metres.

    >>> round(airy_radius(550e-9, 8.0) * 1e6, 3)
    5.367
    """
    _check_light(wavelength, working_f_number)
    return AIRY_FIRST_ZERO * wavelength * working_f_number


def encircled_energy(radius: ArrayLike, wavelength: float, working_f_number: float) -> Float:
    """The share of a point's light within `radius` metres on the film: E = 1 - J0(x)^2 - J1(x)^2.

    >>> round(float(encircled_energy(airy_radius(550e-9, 8.0), 550e-9, 8.0)), 4)
    0.8378
    """
    _check_light(wavelength, working_f_number)
    return _within(np.asarray(radius, dtype=np.float64) / (wavelength * working_f_number))


def _within(radius: Float) -> Float:
    """The encircled energy of a radius in units of lambda N."""
    x = math.pi * radius
    energy: Float = 1.0 - j0(x) ** 2 - j1(x) ** 2
    return energy


def fresnel_number(aperture_diameter: float, wavelength: float, distance: float) -> float:
    """a^2 / (lambda v), a = A/2: large where light travels in rays, small where the Airy pattern is all there is.

    >>> round(fresnel_number(0.35e-3, 550e-9, 0.05), 3)
    1.114
    """
    check_diameter("aperture_diameter", aperture_diameter)
    _check_light(wavelength, 1.0)
    check_length("distance", distance)
    return (0.5 * aperture_diameter) ** 2 / (wavelength * distance)


def airy_kernel(pixel_pitch: tuple[float, float], wavelength: float, working_f_number: float, radius_px: int) -> Float:
    """A point's light on the pixels around the one it is centred on, (2 R + 1, 2 R + 1), sum 1.

    Each value is the integral of the Airy pattern over one pixel's square of `pixel_pitch` (x, y) metres. By the
    divergence theorem it is the flux of the radial field E(r) / (2 pi r) through the pixel's four edges, which
    neighbours share: exact up to the quadrature along an edge. What falls outside the kernel is given back to its
    pixels in proportion, so that no light is lost.
    """
    _check_light(wavelength, working_f_number)
    _check_pitch(pixel_pitch)
    whole = isinstance(radius_px, (int, np.integer)) and not isinstance(radius_px, bool)
    if not whole or not 0 <= radius_px <= _LARGEST_RADIUS:
        raise InputError(
            f"radius_px must be a whole number of pixels >= 0, at most {_LARGEST_RADIUS}, got {format_value(radius_px)}"
        )
    return _airy_kernel(pixel_pitch, wavelength, working_f_number, radius_px).copy()


@lru_cache(maxsize=16)
def _airy_kernel(pixel_pitch: tuple[float, float], wavelength: float, working_f_number: float, radius_px: int) -> Float:
    px, py = (pitch / (wavelength * working_f_number) for pitch in pixel_pitch)
    right = _edge_flux(px, py, radius_px).T  # [y, x]: through the right-hand edge of the pixels of one quadrant
    below = _edge_flux(py, px, radius_px)
    quadrant = right + below
    quadrant[:, 1:] -= right[:, :-1]
    quadrant[:, 0] += right[:, 0]
    quadrant[1:] -= below[:-1]
    quadrant[0] += below[0]
    quadrant = np.maximum(quadrant, 0.0)
    half = np.concatenate([quadrant[:, :0:-1], quadrant], axis=1)
    kernel: Float = np.concatenate([half[:0:-1], half], axis=0)
    kernel /= kernel.sum()
    return kernel


def _edge_flux(across: float, along: float, radius_px: int) -> Float:
    """Flux [i, j] through the edge at (i + 1/2) across, from (j - 1/2) to (j + 1/2) along; lengths in lambda N."""
    nodes, weights = np.polynomial.legendre.leggauss(min(_MOST_NODES, 8 + math.ceil(math.pi * along)))
    steps = np.arange(radius_px + 1)
    y = (steps[:, None] + 0.5 * nodes) * along
    flux = np.empty((len(steps), len(steps)))
    for i in steps:
        x = (i + 0.5) * across
        r2 = x * x + y * y
        flux[i] = x * 0.5 * along / (2 * math.pi) * (_within(np.sqrt(r2)) / r2) @ weights
    return flux


def kernel_radius_px(
    pixel_pitch: tuple[float, float], wavelength: float, working_f_number: float, tail: float = TAIL
) -> int:
    """The radius beyond which less than `tail` of the light falls, pixels: 1 - E = 2 / (pi x) far out."""
    _check_light(wavelength, working_f_number)
    _check_pitch(pixel_pitch)
    check_number("tail", tail, "a positive share of the light, 1e-9 to 1", least=1e-9, most=1)
    return math.ceil(2.0 * wavelength * working_f_number / (math.pi**2 * tail * min(pixel_pitch)))


def diffract(
    image: ArrayLike,
    camera: Camera,
    lens: Lens,
    wavelengths: tuple[float, float, float] = CHANNEL_WAVELENGTHS,
) -> NDArray[np.float32]:
    """`image`, linear radiance (H, W, 3), as diffraction at the lens's circular aperture blurs it; float32.

    Each channel is convolved with the Airy kernel of its wavelength (metres, in the image's order). Outside its borders
    the image is continued by reflection. The pattern falls off as 1/r^3 and has no end: it is cut where no more than
    `TAIL` of the light lies beyond, or at the size of the image, and the rest is raised to sum to 1.

    The kernel is integrated over the pixel, and so is a rendered image before it: the pixel's square is in the result
    twice. The second one is a blur of 1/sqrt(12) = 0.29 pixels standard deviation in x and y, sinc(f) in contrast at f
    cycles a pixel: 0.99 at 0.08, 0.90 at 0.25, 0.64 at 0.5, the finest detail. To be rid of it, render and diffract
    several times finer, and take means of the pixels.

    What it leaves out. The picture was made by rays: a point out of focus is a geometric disk, and this convolves it
    with the far-field pattern of the aperture. In focus that is right. Out of focus, and behind a bare hole always, the
    true pattern is Fresnel's, and with n = a^2 / (lambda v) for the hole (a its radius) the share of the light that
    this puts in the wrong place is 1% at n = 0.05, 3% at 0.1, 9% at 0.2, 28% at 0.5 to 0.7, 24% at 1, 19% at 5, 10% at
    50, falling as 1/sqrt(n): worst for the sharpest pinhole there is, whose true peak at n = 1 is 4.4 times as high. So
    a `FresnelWarning` is given for a bare hole with 0.2 < n < 50. For wider holes the true pattern is the geometric
    disk with fringes of a width of sqrt(lambda v), for narrower ones the Airy pattern.

    Raises InputError for a pinhole of no width, an aperture that is no disk, an image of the wrong shape or with NaN,
    and for wavelengths that are not three positive numbers.
    """
    radiance = checked_radiance("image to diffract", image, camera)
    wavelengths = check_wavelengths("wavelengths", wavelengths)
    _check_aperture(lens)
    distance = film_distance(camera, lens)
    if isinstance(lens, BareAperture):
        _warn_fresnel(lens.aperture_diameter, distance, wavelengths)
    pitch = (distance / camera.fx, distance / camera.fy)
    working_f_number = distance / lens.aperture_diameter
    blurred = [
        _convolve(radiance[..., c], pitch, wavelength, working_f_number) for c, wavelength in enumerate(wavelengths)
    ]
    return np.stack(blurred, axis=-1).astype(np.float32)


def _convolve(channel: Float, pitch: tuple[float, float], wavelength: float, working_f_number: float) -> Float:
    radius = min(kernel_radius_px(pitch, wavelength, working_f_number), max(channel.shape))
    kernel = airy_kernel(pitch, wavelength, working_f_number, radius)
    padded = np.pad(channel, radius, mode="symmetric")
    size = [next_fast_len(n, real=True) for n in padded.shape]
    blurred: Float = irfft2(rfft2(padded, size) * rfft2(kernel, size), size)
    inner = blurred[2 * radius : padded.shape[0], 2 * radius : padded.shape[1]]  # what has not wrapped around
    return np.maximum(inner, 0.0)  # the transform's rounding may leave a black pixel below zero


def check_wavelengths(name: str, values: Any) -> tuple[float, float, float]:
    """`values` as three wavelengths in metres, or InputError; nanometres are told by their size."""
    three = check_triple(name, values, "three positive numbers of metres (red, green, blue)")
    if not all(_SHORTEST_WAVE <= value <= _LONGEST_WAVE for value in three):
        raise InputError(f"{name} must be metres from {_SHORTEST_WAVE:g} to {_LONGEST_WAVE:g}, as 550e-9, got {three}")
    return three


def _check_light(wavelength: float, working_f_number: float) -> None:
    allowed = f"a positive number of metres, from {_SHORTEST_WAVE:g} to {_LONGEST_WAVE:g}"
    check_number("wavelength", wavelength, allowed, least=_SHORTEST_WAVE, most=_LONGEST_WAVE)
    check_number("working_f_number", working_f_number, "a positive number", least=1e-24, most=1e24)


def _check_pitch(pixel_pitch: tuple[float, float]) -> None:
    allowed = "two positive numbers of metres"
    if not isinstance(pixel_pitch, (tuple, list)) or len(pixel_pitch) != 2:
        raise InputError(f"pixel_pitch must be {allowed}, got {format_value(pixel_pitch)}")
    for pitch in pixel_pitch:
        check_number("pixel_pitch", pitch, allowed, least=SHORTEST, most=LONGEST)


def _check_aperture(lens: Lens) -> None:
    check_lens(lens)
    if lens.aperture_diameter == 0:
        raise InputError("a pinhole of no width has no diffraction pattern; give the aperture a diameter")
    if lens.aperture.name != "disk":
        raise InputError(f"diffraction is known for a disk only, got a {lens.aperture.name} aperture")


def _warn_fresnel(diameter: float, distance: float, wavelengths: tuple[float, ...]) -> None:
    numbers = [fresnel_number(diameter, wavelength, distance) for wavelength in wavelengths]
    if max(numbers) > FRESNEL_LOW and min(numbers) < FRESNEL_HIGH:
        warnings.warn(
            f"bare hole of Fresnel number {numbers[len(numbers) // 2]:.3g}: between {FRESNEL_LOW:g} and "
            f"{FRESNEL_HIGH:g} its blur and its diffraction do not separate; over a tenth of the light is misplaced",
            FresnelWarning,
            stacklevel=3,
        )
