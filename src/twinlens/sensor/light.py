"""From radiance to electrons a second: the light on the film, the photons in it, and those that a pixel catches.

    E = pi/4 (A/v)^2 T L  (cos^4)         irradiance of the film, W/m^2, T the aperture's area fraction
    rate = QE * E * pixel area / (h c / lambda)        electrons a second in a pixel

Sources: Born and Wolf, Principles of Optics, 7th ed., section 4.8.3; EMVA Standard 1288, release 4.0 linear, section 2.
"""

import math

import numpy as np
from numpy.typing import NDArray

from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import Lens
from twinlens.diffraction import film_distance

Float = NDArray[np.float64]

_PLANCK = 6.62607015e-34  # J s, exact in the SI
_LIGHT = 299792458.0  # m/s, exact in the SI


def f_number(camera: Camera, lens: Lens, pinhole_f_number: float) -> float:
    """N = v/A, the working f-number; `pinhole_f_number` stands in for an aperture of no width."""
    diameter = lens.aperture_diameter
    return film_distance(camera, lens) / diameter if diameter > 0 else pinhole_f_number


def irradiance_factor(camera: Camera, lens: Lens, pinhole_f_number: float) -> float:
    """E/L in steradians: pi/4 (A/v)^2 times the aperture's area fraction.

    >>> from twinlens.camera import Camera, ThinLens
    >>> camera = Camera.from_fov(640, 480, fov_x_deg=50)
    >>> lens = ThinLens(camera.film_distance / 2, focus_distance=1.0)
    >>> round(irradiance_factor(camera, lens, 8.0) / math.pi, 12)
    0.0625
    """
    open_fraction = lens.aperture.area_fraction if lens.aperture_diameter > 0 else 1.0
    return 0.25 * math.pi * open_fraction / f_number(camera, lens, pinhole_f_number) ** 2


def cos4(camera: Camera) -> Float:
    """Natural vignetting (H, W): cos^4 of the angle between the axis and the line from the aperture to the pixel."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return 1.0 / (1.0 + x[None, :] ** 2 + y[:, None] ** 2) ** 2


def pixel_area(camera: Camera, lens: Lens) -> float:
    """Of one pixel, m^2: (v/fx)(v/fy)."""
    distance = film_distance(camera, lens)
    return distance / camera.fx * distance / camera.fy


def photons_per_joule(wavelength: float) -> float:
    """lambda / (h c).

    >>> round(photons_per_joule(550e-9) / 1e18, 3)
    2.769
    """
    return wavelength / (_PLANCK * _LIGHT)
