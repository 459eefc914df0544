"""Light on the film and electrons per second.

    E = pi/4 (A/v)^2 T L                   a lens, paraxial; T the area fraction of the aperture; W/m^2
    E = pi L R^2 / (R^2 + v^2)             a bare aperture of radius R = A/2, exact on the axis in a uniform field
    rate = QE * E * pixel area / (h c / lambda)        electrons per second in a pixel

The two agree within (A/2v)^2. A rendered image is the mean radiance over the open aperture, weighted evenly: natural
vignetting is the cos^4 of the aperture's centre, also for wide apertures. Mechanical vignetting darkens the image; the
blur circles keep their shape.

Sources: Born and Wolf, Principles of Optics, 7th ed., section 4.8.3; Howell, A Catalog of Radiation Heat Transfer
Configuration Factors, B-12 (disk to element); EMVA Standard 1288, release 4.0 linear, section 2; Asada, Amano and Baba,
Photometric calibration of zoom lens systems, ICPR 1996 (vignetting by two circles).
"""

import math
import warnings

import numpy as np

from twinlens.camera import (
    BareAperture,
    Camera,
    Disk,
    Paraxial,
    ThinLens,
    film_distance,
)
from twinlens.geometry import Float

PLANCK = 6.62607015e-34  # J s, exact in the SI
SPEED = 299792458.0  # m/s, of light, exact in the SI
_OPEN = 1.4  # f-number of the widest beam on the axis that passes the barrel
_RIM = 0.5  # distance of the barrel's rim from the stop, in film distances: a double Gauss lens is about as long as v
_STRATA = 256  # per side, over a bare aperture that is not a disk


class ParaxialWarning(UserWarning):
    """The working f-number of a lens is below 1, where the paraxial formula gives too much light."""


def warn_below_f1(camera: Camera, lens: Paraxial, stacklevel: int) -> None:
    """Give a `ParaxialWarning` for a lens of v/A < 1; for given exposures, as automatic ones compensate."""
    number = (
        math.inf
        if isinstance(lens, BareAperture)
        else working_f_number(camera, lens, math.inf)
    )
    if number < 1:
        warnings.warn(
            f"working f-number v/A = {number:.3g} is below 1, where the paraxial formula pi/4 (A/v)^2 L gives too much "
            "light: use a smaller aperture, or give the camera a larger pixel_pitch_um",
            ParaxialWarning,
            stacklevel=stacklevel,
        )


def working_f_number(camera: Camera, lens: Paraxial, pinhole_f_number: float) -> float:
    """N = v/A; `pinhole_f_number` for an aperture of zero width.

    Not f/A, the number engraved on a lens (`ThinLens.from_f_number`); they are equal for a focus at infinity.
    """
    diameter = lens.aperture_diameter
    return film_distance(camera, lens) / diameter if diameter > 0 else pinhole_f_number


def irradiance_factor(camera: Camera, lens: Paraxial, pinhole_f_number: float) -> float:
    """E/L in steradians, on the axis; for a bare aperture at most pi.

    >>> from twinlens.camera import ThinLens
    >>> camera = Camera.from_fov(640, 480, fov_x_deg=50)
    >>> lens = ThinLens(camera.film_distance / 2, focus_distance=1.0)
    >>> round(irradiance_factor(camera, lens, 8.0) / math.pi, 12)
    0.0625
    >>> round(irradiance_factor(camera, BareAperture(diameter=0.1, film_distance=0.05), 8.0) / math.pi, 12)
    0.5
    """
    if isinstance(lens, BareAperture) and lens.diameter > 0:
        ratio2 = (0.5 * lens.diameter / lens.film_distance) ** 2
        if isinstance(lens.aperture, Disk):
            return math.pi * ratio2 / (1.0 + ratio2)
        # The integral of v^2/(v^2 + r^2)^2 over the open area, accurate to 0.1% up to A/v = 100.
        middles = (np.arange(_STRATA) + 0.5) / _STRATA
        x, y = lens.aperture.sample(*np.meshgrid(middles, middles))
        mean = float(np.mean(1.0 / (1.0 + ratio2 * (x**2 + y**2)) ** 2))
        return min(math.pi * ratio2 * lens.aperture.area_fraction * mean, math.pi)
    number = working_f_number(camera, lens, pinhole_f_number)
    open_fraction = lens.aperture.area_fraction if lens.aperture_diameter > 0 else 1.0
    return 0.25 * math.pi * open_fraction / number**2


def vignetting(camera: Camera, lens: Paraxial) -> Float:
    """The light of the pixels relative to the axis, (H, W): natural, and for a lens of some width also mechanical.

    Natural is cos^4 of the angle between the axis and the line from the aperture to the pixel.
    The rim of the barrel is a circle as wide as the f/1.4 beam, or as the lens if that is wider, half a film distance
    before the stop. Light at an angle passes where the two circles overlap. Stopping down removes this.
    """
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    natural, radius = (
        1.0 / (1.0 + x[None, :] ** 2 + y[:, None] ** 2) ** 2,
        0.5 * lens.aperture_diameter,
    )
    if not isinstance(lens, ThinLens) or radius == 0:
        return natural
    rim = max(0.5 * camera.film_distance / _OPEN, radius)
    shift = (
        _RIM * camera.film_distance * np.sqrt(natural**-0.5 - 1)
    )  # natural^-1/2 = 1 + tan^2
    return natural * _overlap(shift, radius, rim)


def _overlap(distance: Float, small: float, large: float) -> Float:
    """The share of a circle of radius `small` in one of radius `large`, by the distance of their centres."""
    d = np.clip(distance, max(large - small, 1e-9 * large), large + small)
    cut = np.arccos(np.clip((d**2 + small**2 - large**2) / (2 * d * small), -1, 1))
    arc = np.arccos(np.clip((d**2 + large**2 - small**2) / (2 * d * large), -1, 1))
    kite = d * small * np.sin(cut)
    return np.asarray((small**2 * cut + large**2 * arc - kite) / (math.pi * small**2))
