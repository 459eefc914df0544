"""Light on the film behind a lens or a bare aperture, relative to the radiance, and how it falls off to the corners.

    E/L = pi/4 (A/v)^2 T            a lens, paraxial; T the area fraction of the aperture; steradians
    E/L = pi R^2 / (R^2 + v^2)      a bare aperture of radius R = A/2, exact on the axis in a uniform field

The two agree within (A/2v)^2.

Sources: Born and Wolf, Principles of Optics, 7th ed., section 4.8.3; Howell, A Catalog of Radiation Heat Transfer
Configuration Factors, B-12 (disk to element); Asada, Amano and Baba, Photometric calibration of zoom lens systems, ICPR
1996 (vignetting by two circles).
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

_OPEN = 1.4  # f-number of the widest beam on the axis that passes the barrel
_RIM = 0.5  # distance of the barrel's rim from the stop, in film distances: a double Gauss lens is about as long as v


def lens_irradiance(f_number: float, area_fraction: float = 1.0) -> float:
    """E/L in steradians on the axis, behind a lens of the working f-number v/A.

    >>> round(lens_irradiance(2.0) / math.pi, 12)
    0.0625
    """
    return 0.25 * math.pi * area_fraction / f_number**2


def disk_irradiance(radius: float, film_distance: float) -> float:
    """E/L in steradians on the axis, behind a round hole: at most pi.

    >>> round(disk_irradiance(0.05, 0.05) / math.pi, 12)
    0.5
    """
    ratio2 = (radius / film_distance) ** 2
    return math.pi * ratio2 / (1.0 + ratio2)


def hole_irradiance(
    x: ArrayLike,
    y: ArrayLike,
    radius: float,
    film_distance: float,
    area_fraction: float,
) -> float:
    """E/L in steradians on the axis, behind a hole of any shape: at most pi.

    x, y : points that are spread evenly over the open area, in units of `radius`.
    """
    ratio2 = (radius / film_distance) ** 2
    # The integral of v^2/(v^2 + r^2)^2 over the open area, as a mean over its points.
    distance2 = np.square(x) + np.square(y)
    mean = float(np.mean(1.0 / (1.0 + ratio2 * distance2) ** 2))
    return min(math.pi * ratio2 * area_fraction * mean, math.pi)


def natural_vignetting(x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Light at film points (x, y) relative to the axis: cos^4 of the angle of the ray (x, y, 1) with the axis."""
    return np.asarray(1.0 / (1.0 + np.square(x) + np.square(y)) ** 2)


def barrel_vignetting(
    natural: NDArray[np.float64], radius: float, film_distance: float
) -> NDArray[np.float64]:
    """The share of the light of a stop of `radius` that passes the rim of the barrel, by the natural vignetting.

    The rim is a circle as wide as the f/1.4 beam, or as the stop if that is wider, half a film distance before it.
    Light at an angle passes where the two circles overlap. Stopping down removes this.
    """
    rim = max(0.5 * film_distance / _OPEN, radius)
    tangent = np.sqrt(natural**-0.5 - 1)  # as natural^-1/2 = 1 + tan^2 of the angle
    return _overlap(_RIM * film_distance * tangent, radius, rim)


def _overlap(
    distance: NDArray[np.float64], small: float, large: float
) -> NDArray[np.float64]:
    """The share of a circle of radius `small` in one of radius `large`, by the distance of their centres."""
    # The chord of the two intersections cuts off the angle 2 cut of the small circle and 2 arc of the large one, by the
    # law of cosines in the triangle of both centres and an intersection, with sides d, small and large.
    # Circles inside each other, or apart, have the share of circles that touch.
    d = np.clip(distance, max(large - small, 1e-9 * large), large + small)
    cut = np.arccos(np.clip((d**2 + small**2 - large**2) / (2 * d * small), -1, 1))
    arc = np.arccos(np.clip((d**2 + large**2 - small**2) / (2 * d * large), -1, 1))
    # The lens between two circles: two sectors less the kite of their corners.
    kite = d * small * np.sin(cut)
    return np.asarray((small**2 * cut + large**2 * arc - kite) / (math.pi * small**2))
