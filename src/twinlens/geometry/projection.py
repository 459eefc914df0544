"""Film and pixel coordinates, and the relation of disparity and depth. Conventions: see `twinlens.geometry`."""

import numpy as np
from numpy.typing import ArrayLike

from twinlens.errors import InputError
from twinlens.geometry.transforms import Float

_BORDER_POINTS = 33  # per side


def film_from_cam(points_cam: ArrayLike, film_distance: float) -> Float:
    """Film coordinates (..., 2), metres, of points (..., 3): X = v x / z, Y = v y / z on an upright film.

    The real film is behind the aperture and its image is rotated by 180 degrees; the upright film is in front.
    Points with z <= 0 have no image and give NaN.
    """
    points_cam = np.asarray(points_cam, dtype=np.float64)
    z = points_cam[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(z > 0, film_distance * points_cam[..., :2] / z, np.nan)


def px_from_film(film: ArrayLike, pixel_density: ArrayLike, principal_point: ArrayLike) -> Float:
    """Pixels (..., 2) of film points (..., 2) in metres: u = m_x X + cx, with pixel density m in pixels per metre."""
    film, density = np.asarray(film, dtype=np.float64), np.asarray(pixel_density, dtype=np.float64)
    return film * density + np.asarray(principal_point, dtype=np.float64)


def disparity_from_depth(depth: ArrayLike, fx: float, baseline: float, doffs: float = 0.0) -> Float:
    """d = fx B / z - doffs, in pixels. Depth +inf (nothing hit) gives +inf: unknown, not the disparity at infinity.

    Raises InputError for depth <= 0, NaN, or a baseline that is not positive.

    >>> disparity_from_depth([2.0, np.inf], fx=700, baseline=0.1).tolist()
    [35.0, inf]
    """
    _check_stereo(fx, baseline)
    z = np.asarray(depth, dtype=np.float64)
    if not (z > 0).all():
        raise InputError("depth must be positive (+inf where nothing was hit), got NaN or values <= 0")
    return np.where(np.isposinf(z), np.inf, fx * baseline / z - doffs)


def depth_from_disparity(disparity: ArrayLike, fx: float, baseline: float, doffs: float = 0.0) -> Float:
    """z = fx B / (d + doffs), in metres. +inf (unknown) gives +inf, and so does d + doffs = 0, a point at infinity.

    Raises InputError for NaN, -inf, or d + doffs < 0, a point behind the camera.
    """
    shifted = np.asarray(disparity, dtype=np.float64) + doffs
    _check_stereo(fx, baseline)
    if np.isnan(shifted).any() or (shifted < 0).any():
        raise InputError("disparity + doffs must be >= 0 (or +inf for unknown); NaN and negative values have no depth")
    with np.errstate(divide="ignore"):
        return np.where(np.isposinf(shifted), np.inf, fx * baseline / shifted)


def image_border(width: int, height: int, margin: float = 0.0) -> Float:
    """Points (N, 2) along the outermost pixel centres of an image, or `margin` pixels outside them.

    >>> image_border(640, 480, margin=0.5).min(axis=0).tolist()
    [-0.5, -0.5]
    """
    left, right, top, bottom = -margin, width - 1 + margin, -margin, height - 1 + margin
    u, v = np.linspace(left, right, _BORDER_POINTS), np.linspace(top, bottom, _BORDER_POINTS)
    sides = [(u, np.full_like(u, y)) for y in (top, bottom)] + [(np.full_like(v, x), v) for x in (left, right)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def _check_stereo(fx: float, baseline: float) -> None:
    if not (fx > 0 and baseline > 0 and np.isfinite([fx, baseline]).all()):
        raise InputError(f"fx and baseline must be positive and finite, got fx={fx}, baseline={baseline}")
