"""Diffraction at a circular aperture: the Airy pattern integrated over pixels, and its convolution with an image.

A point of light forms ``I(r) = (2 J1(x)/x)^2`` on the film, x = pi r / (lambda N), with the working f-number N = v/A:
film distance over aperture diameter. The first dark ring has the radius 1.22 lambda N. Film lengths are in metres,
`_px` in pixels. `twinlens.diffract` applies it to an image taken by a camera through a lens.

Sources: Airy, On the diffraction of an object-glass with circular aperture, 1835; Rayleigh, On images formed without
reflection or refraction, 1881, for the encircled energy; Born and Wolf, Principles of Optics, 7th ed., section 8.5.2,
and 8.8 for the Fresnel number.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twinlens.errors import (
    InputError,
    check_int,
    check_number,
    check_triple,
    format_value,
)
from twinlens.geometry import Float
from twinlens.optics import LONGEST, SHORTEST, check_diameter, check_length

Pitch = tuple[float, float]  # width and height of a pixel, metres
CHANNEL_WAVELENGTHS = (611e-9, 549e-9, 464e-9)
"""Metres: the dominant wavelengths under D65 of sRGB's primaries (Rec. ITU-R BT.709), the renderer's colours."""
TAIL = 0.005  # largest share of the light outside the kernel, unless the image is smaller than the kernel
FRESNEL_LOW, FRESNEL_HIGH = 0.2, 50.0
"""Between these Fresnel numbers the model misplaces more than a tenth of the light behind a bare aperture."""
_FIRST_ZERO = 1.2196698912665045  # of J1(pi x), x > 0
_MOST_NODES = 64
_LARGEST_RADIUS = 16384
SHORTEST_WAVE, LONGEST_WAVE = 1e-9, 1e-3


class FresnelWarning(UserWarning):
    """The Fresnel number of a bare aperture is in the range where blur and diffraction are not separable."""


def encircled_energy(radius: ArrayLike) -> Float:
    """The share of a point's light within a radius on the film, in units of lambda N: E = 1 - J0(pi r)^2 - J1(pi r)^2.

    >>> round(float(encircled_energy(1.22)), 4)
    0.8378
    """
    from scipy.special import (
        j0,
        j1,
    )  # slow to import, and the sensor needs this module's wavelengths only

    x = math.pi * np.asarray(radius, dtype=np.float64)
    return np.asarray(1.0 - j0(x) ** 2 - j1(x) ** 2)


def airy_diameter(wavelength: float, working_f_number: float) -> float:
    """2.44 lambda N in metres: the diameter of the first dark ring, at the first zero of J1.

    >>> round(1e6 * airy_diameter(550e-9, 8.0), 2)
    10.73
    """
    _check(wavelength, working_f_number)
    return 2 * _FIRST_ZERO * wavelength * working_f_number


def fresnel_number(
    aperture_diameter: float, wavelength: float, distance: float
) -> float:
    """a^2 / (lambda v) with a = A/2: large in the limit of geometric optics, small in that of the Airy pattern.

    >>> round(fresnel_number(0.35e-3, 550e-9, 0.05), 3)
    1.114
    """
    check_diameter("aperture_diameter", aperture_diameter)
    _check(wavelength, 1.0)
    check_length("distance", distance)
    return (0.5 * aperture_diameter) ** 2 / (wavelength * distance)


def airy_kernel(
    pixel_pitch: Pitch, wavelength: float, working_f_number: float, radius_px: int
) -> Float:
    """The Airy pattern of a point at the centre of a pixel, integrated over the pixels: (2 R + 1, 2 R + 1), sum 1.

    By the divergence theorem the integral over a pixel is the flux of the radial field E(r) / (2 pi r) through its four
    edges, which neighbours share; each edge is integrated by Gauss-Legendre quadrature. The light outside the kernel is
    distributed over its pixels in proportion.
    """
    _check(wavelength, working_f_number, pixel_pitch)
    check_int("radius_px", radius_px, 0, _LARGEST_RADIUS)
    return _airy_kernel(pixel_pitch, wavelength, working_f_number, radius_px).copy()


def kernel_radius_px(
    pixel_pitch: Pitch, wavelength: float, working_f_number: float, tail: float = TAIL
) -> int:
    """The radius in pixels beyond which less than `tail` of the light falls, from 1 - E = 2 / (pi x) at large x."""
    _check(wavelength, working_f_number, pixel_pitch)
    check_number(
        "tail", tail, "a positive share of the light, 1e-9 to 1", least=1e-9, most=1
    )
    return math.ceil(
        2.0 * wavelength * working_f_number / (math.pi**2 * tail * min(pixel_pitch))
    )


def convolve_airy(
    channel: Float, pixel_pitch: Pitch, wavelength: float, working_f_number: float
) -> Float:
    """`channel` (H, W) convolved with the Airy kernel, continued by reflection at its borders; float64 (H, W), >= 0."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    radius = min(
        kernel_radius_px(pixel_pitch, wavelength, working_f_number), max(channel.shape)
    )
    kernel = airy_kernel(pixel_pitch, wavelength, working_f_number, radius)
    padded = np.pad(channel, radius, mode="symmetric")
    size = [next_fast_len(n, real=True) for n in padded.shape]
    blurred: Float = irfft2(rfft2(padded, size) * rfft2(kernel, size), size)
    # Without the border that the transform wraps around. Its rounding may give small negative values.
    inner = blurred[2 * radius : padded.shape[0], 2 * radius : padded.shape[1]]
    return np.maximum(inner, 0.0)


def check_wavelengths(name: str, values: Any) -> tuple[float, float, float]:
    """`values` as three wavelengths in metres. Raises InputError otherwise, also for nanometres."""
    three = check_triple(
        name, values, "three positive numbers of metres (red, green, blue)"
    )
    if not all(SHORTEST_WAVE <= value <= LONGEST_WAVE for value in three):
        raise InputError(
            f"{name} must be metres from {SHORTEST_WAVE:g} to {LONGEST_WAVE:g}, as 550e-9, got {three}"
        )
    return three


@lru_cache(maxsize=16)
def _airy_kernel(
    pixel_pitch: Pitch, wavelength: float, working_f_number: float, radius_px: int
) -> Float:
    px, py = (pitch / (wavelength * working_f_number) for pitch in pixel_pitch)
    # Fluxes [y, x] out of the right and the lower edges of the pixels of one quadrant; the others follow by symmetry.
    right = _edge_flux(px, py, radius_px).T
    below = _edge_flux(py, px, radius_px)
    quadrant = right + below
    # What leaves a pixel through its right or lower edge enters its neighbour, whose left or upper edge that is. The
    # pixels on the axes have their own edge on the other side, with the same flux outwards.
    quadrant[:, 1:] -= right[:, :-1]
    quadrant[:, 0] += right[:, 0]
    quadrant[1:] -= below[:-1]
    quadrant[0] += below[0]
    light = np.maximum(quadrant, 0.0)
    kernel = np.pad(light, ((radius_px, 0), (radius_px, 0)), mode="reflect")
    return np.asarray(kernel / kernel.sum())


def _edge_flux(across: float, along: float, radius_px: int) -> Float:
    """Flux [i, j] through the edge at (i + 1/2) across, from (j - 1/2) to (j + 1/2) along; lengths in lambda N."""
    nodes, weights = np.polynomial.legendre.leggauss(
        min(_MOST_NODES, 8 + math.ceil(math.pi * along))
    )
    steps = np.arange(radius_px + 1)
    y = (steps[:, None] + 0.5 * nodes) * along
    flux = np.empty((len(steps), len(steps)))
    for i in steps:
        x = (i + 0.5) * across
        r2 = x * x + y * y
        # The component across the edge of the field E(r) / (2 pi r), which is x / r of it; 0.5 along scales the nodes.
        normal = encircled_energy(np.sqrt(r2)) / r2
        flux[i] = x * 0.5 * along / (2 * math.pi) * normal @ weights
    return flux


def _check(
    wavelength: float, working_f_number: float, pixel_pitch: Pitch = (1.0, 1.0)
) -> None:
    allowed = f"a positive number of metres, from {SHORTEST_WAVE:g} to {LONGEST_WAVE:g}"
    check_number(
        "wavelength", wavelength, allowed, least=SHORTEST_WAVE, most=LONGEST_WAVE
    )
    check_number(
        "working_f_number",
        working_f_number,
        "a positive number",
        least=1e-24,
        most=1e24,
    )
    if not isinstance(pixel_pitch, (tuple, list)) or len(pixel_pitch) != 2:
        raise InputError(
            f"pixel_pitch must be two positive numbers of metres, got {format_value(pixel_pitch)}"
        )
    for pitch in pixel_pitch:
        check_number(
            "pixel_pitch",
            pitch,
            "two positive numbers of metres",
            least=SHORTEST,
            most=LONGEST,
        )
