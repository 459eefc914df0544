"""Thin-lens formulas: vergence, blur circle, depth of field, hyperfocal distance.

`diffraction` has the Airy pattern, `planning` the choice of a rig.

A point a = (ax, ay, 0) of the aperture sends the ray o = a, d = (x - k ax, y - k ay, 1) with the vergence k in 1/m.
Lengths are in metres, vergences in 1/m, and `_px` are pixels on the film.

Sources: Born and Wolf, Principles of Optics, 7th ed., 1999; Ray, Applied Photographic Optics, 3rd ed., 2002.
"""

import math
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError, check_number, format_value

SHORTEST, LONGEST = 1e-12, 1e9
"""Accepted lengths in metres, without overflow of squares and ratios."""


def vergence(power: float, film_distance: float) -> float:
    """k = P - 1/v: 1/focus_distance for a lens, -1/v for a bare aperture (P = 0). InputError unless v > 0.

    >>> round(1 / vergence(1 / 0.05, 0.0512820512820513), 6)
    2.0
    """
    check_number("power", power, "a finite number of 1/m")
    check_length("film_distance", film_distance)
    return power - 1.0 / film_distance


def focal_length(focus_distance: float, film_distance: float) -> float:
    """f = 1/(k + 1/v) of the thin-lens equation; focus_distance may be inf. InputError unless both are positive.

    >>> focal_length(math.inf, 0.05)
    0.05
    """
    check_focus(focus_distance)
    check_length("film_distance", film_distance)
    return 1.0 / (1.0 / focus_distance + 1.0 / film_distance)


def fx_from_fov(width: int, fov_x_deg: float) -> float:
    """fx in pixels of a horizontal field of view, edge to edge of a centred image: W / (2 tan(fov / 2)).

    >>> round(fx_from_fov(640, 90), 9)
    320.0
    """
    return 0.5 * width / math.tan(0.5 * math.radians(fov_x_deg))


def fov_x_deg(width: float, fx: float) -> float:
    """The horizontal field of view in degrees of a centred image, the inverse of `fx_from_fov`."""
    return math.degrees(2 * math.atan(0.5 * width / fx))


def middle_focus(near: float, far: float) -> float:
    """The depth at the middle of the disparities of depths `near` to `far`: their harmonic mean, metres.

    >>> middle_focus(1.0, 3.0), middle_focus(1.0, math.inf)
    (1.5, 2.0)
    """
    inverse = 0.5 / near + 0.5 / far
    return 1.0 / inverse if inverse else math.inf


def check_length(name: str, value: float) -> None:
    """Raise InputError unless `value` is a positive number of metres, from `SHORTEST` to `LONGEST`."""
    allowed = f"a positive number of metres, from {SHORTEST:g} to {LONGEST:g}"
    check_number(name, value, allowed, least=SHORTEST, most=LONGEST)


def check_diameter(name: str, value: float) -> None:
    """Raise InputError unless `value` is 0 or a number of metres from `SHORTEST` to `LONGEST`."""
    allowed = f"a number of metres >= 0 (0, or from {SHORTEST:g} to {LONGEST:g})"
    check_number(name, value, allowed, least=0, most=LONGEST)
    if value != 0:
        check_number(name, value, allowed, least=SHORTEST)


def check_focus(value: float) -> None:
    """Raise InputError unless `value` is a focus distance: a positive number of metres, or inf."""
    if not (isinstance(value, Real) and value == math.inf):
        check_number(
            "focus_distance",
            value,
            f"a positive number of metres from {SHORTEST:g} (or inf)",
            least=SHORTEST,
        )


def circle_of_confusion_px(
    depth: ArrayLike, aperture_diameter: float, fx: float, k: float
) -> NDArray[np.float64]:
    """Signed diameter of the blur circle on the film, in pixels: c = A fx (1/z - k), the shape of `depth` (metres).

    It is positive in front of the plane of focus, where the image of a point light is the aperture rotated by 180
    degrees, and negative behind it, where the image is upright. At depth +inf c = -A fx k. Raises InputError unless
    depth > 0, A >= 0, fx > 0 and k is finite.

    >>> circle_of_confusion_px([1.0, 2.0, np.inf], aperture_diameter=0.01, fx=700, k=0.5).tolist()
    [3.5, 0.0, -3.5]
    """
    _check_aperture(aperture_diameter, fx, k)
    try:
        z = np.asarray(depth, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"depth must be a number or an array of metres, got {format_value(depth)}"
        ) from error
    if not (z > 0).all():
        raise InputError(
            "depth must be positive (+inf where nothing was hit), got NaN or values <= 0"
        )
    with np.errstate(over="ignore"):
        circle: NDArray[np.float64] = aperture_diameter * fx * (1.0 / z - k)
    return circle


def in_focus(
    depth: ArrayLike,
    aperture_diameter: float,
    fx: float,
    k: float,
    circle_px: float = 1.0,
) -> NDArray[np.bool_]:
    """Whether |c| <= circle_px, bool, the shape of `depth`; see `circle_of_confusion_px` and `depth_of_field`.

    >>> in_focus([1.0, 1.8, 2.0, 2.4, np.inf], aperture_diameter=0.01, fx=700, k=0.5, circle_px=0.7).tolist()
    [False, True, True, True, False]
    """
    _check_circle(circle_px)
    return np.asarray(
        np.abs(circle_of_confusion_px(depth, aperture_diameter, fx, k)) <= circle_px
    )


def depth_of_field(
    aperture_diameter: float, fx: float, k: float, circle_px: float = 1.0
) -> tuple[float, float]:
    """(near, far) depths in metres between which the blur circle is at most `circle_px` pixels wide.

    1/z = k +- c / (A fx). A pinhole gives (0, inf). Far is inf for a focus beyond the hyperfocal distance. Both are inf
    if all depths are too blurred, as behind a wide bare aperture. Raises InputError unless A >= 0, fx > 0,
    circle_px > 0 and k is finite.

    >>> depth_of_field(0.01, fx=700, k=0.5, circle_px=0.7)
    (1.6666666666666667, 2.5)
    """
    _check_circle(circle_px)
    _check_aperture(aperture_diameter, fx, k)
    if aperture_diameter == 0:
        return 0.0, math.inf
    margin = circle_px / (aperture_diameter * fx)
    near, far = k + margin, k - margin
    return (1.0 / near if near > 0 else math.inf), (1.0 / far if far > 0 else math.inf)


def hyperfocal_distance(
    aperture_diameter: float, fx: float, circle_px: float = 1.0
) -> float:
    """The nearest focus distance at which infinity is within `circle_px`: H = A fx / c, in metres.

    It equals the textbook's f^2/(N c) + f, c in metres, for a fixed lens that focuses H on a film at v = f H/(H - f).
    Raises InputError unless A >= 0, fx > 0 and circle_px > 0.
    """
    _check_circle(circle_px)
    _check_aperture(aperture_diameter, fx, 0.0)
    return aperture_diameter * fx / circle_px


def _check_circle(circle_px: float) -> None:
    check_number("circle_px", circle_px, "a positive number of pixels", above=0)


def _check_aperture(aperture_diameter: float, fx: float, k: float) -> None:
    check_number(
        "aperture_diameter", aperture_diameter, "a number of metres >= 0", least=0
    )
    check_number("fx", fx, "a positive number of pixels", above=0)
    check_number("k", k, "a finite vergence in 1/m")
