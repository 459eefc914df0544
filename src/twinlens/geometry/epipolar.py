"""Epipolar geometry of two views: essential and fundamental matrix, epipolar lines, epipoles and planes.

Pixels are ideal, without lens distortion. `twinlens.camera.multiview` applies these functions to the cameras of a rig.

Source: Hartley and Zisserman, Multiple View Geometry in Computer Vision, 2nd ed., 2004, chapter 9.
"""

import numpy as np
from numpy.typing import ArrayLike

from twinlens.errors import InputError
from twinlens.geometry import Float, homogeneous, rotate, skew

_COINCIDENT = 1e-12  # relative to the distance from the origin: a smaller distance is lost in float64 poses
_ZERO = 1e-14  # relative: smaller values are rounding errors of zero


def check_baseline(world_from_a: Float, world_from_b: Float) -> None:
    """Raise InputError if the two camera centres coincide."""
    centre_a, centre_b = world_from_a[:3, 3], world_from_b[:3, 3]
    extent = np.linalg.norm(centre_a) + np.linalg.norm(centre_b)
    if not np.linalg.norm(centre_b - centre_a) > _COINCIDENT * extent:
        raise InputError(
            "the camera centres coincide: without a baseline there is no epipolar geometry"
        )


def essential_matrix(world_from_a: Float, world_from_b: Float) -> Float:
    """E = [t]x R with x_b = R x_a + t, (3, 3) in metres: d_b^T E d_a = 0 for directions d of one point.

    Its singular values are (B, B, 0), with the baseline B. Raises InputError where the centres coincide.
    """
    check_baseline(world_from_a, world_from_b)
    b_from_world = world_from_b[:3, :3].T
    # The difference of the centres comes first: a rig far from the world's origin loses no digits.
    return (
        skew(b_from_world @ (world_from_a[:3, 3] - world_from_b[:3, 3]))
        @ b_from_world
        @ world_from_a[:3, :3]
    )


def fundamental_matrix(essential: Float, K_a: Float, K_b: Float) -> Float:
    """F = K_b^-T E K_a^-1, (3, 3), scaled to unit Frobenius norm: p_b^T F p_a = 0 for ideal pixels p = (u, v, 1)."""
    matrix = np.linalg.inv(K_b).T @ essential @ np.linalg.inv(K_a)
    return np.asarray(matrix / np.linalg.norm(matrix))


def epipolar_lines(F: Float, pixels: ArrayLike) -> Float:
    """Lines (l, m, n), l u + m v + n = 0, in view b of the ideal pixels (..., 2) of view a.

    (..., 3) with l^2 + m^2 = 1, so that the dot product with (u, v, 1) is a distance in pixels. A line at infinity is
    (0, 0, 1). The epipole has no line: (0, 0, 0). Give F transposed for the lines in view a.
    """
    points = homogeneous(pixels)
    lines = points @ F.T
    lines[np.abs(lines) <= _ZERO * (np.abs(points) @ np.abs(F).T)] = 0.0
    slope = np.hypot(lines[..., 0], lines[..., 1])[..., None]
    at_infinity = np.where(lines != 0, 1.0, 0.0)
    return np.divide(lines, slope, out=at_infinity, where=slope > 0)


def sampson_distance(F: Float, pixels_a: ArrayLike, pixels_b: ArrayLike) -> Float:
    """First-order distance (...,) in pixels, >= 0, of two ideal pixels (..., 2) from the nearest match.

    |p_b^T F p_a| / sqrt((F p_a)_1^2 + (F p_a)_2^2 + (F^T p_b)_1^2 + (F^T p_b)_2^2), and 0 for the two epipoles.
    Source: Hartley and Zisserman 2004, section 11.4.3.
    """
    first, second = homogeneous(pixels_a), homogeneous(pixels_b)
    lines_b, lines_a = first @ F.T, second @ F
    slope = np.linalg.norm(
        np.concatenate([lines_b[..., :2], lines_a[..., :2]], axis=-1), axis=-1
    )
    residual = np.abs(np.einsum("...i,...i->...", second, lines_b))
    return np.asarray(
        np.divide(residual, slope, out=np.zeros_like(residual), where=slope > 0)
    )


def centre_direction(world_from_a: Float, world_from_b: Float) -> Float:
    """The unit direction (3,), in the frame of camera a, of the centre of camera b."""
    between = world_from_b[:3, 3] - world_from_a[:3, 3]
    direction = rotate(world_from_a.T, between / np.linalg.norm(between))
    direction[np.abs(direction) <= _ZERO] = 0.0
    return direction


def epipolar_planes(centre_a: Float, centre_b: Float, points_world: ArrayLike) -> Float:
    """Planes (n, d), n . X + d = 0 with |n| = 1, in world coordinates, through both centres and each point (..., 3).

    (..., 4). A point on the line through the centres determines no plane: (0, 0, 0, 0).
    Raises InputError for points that are not finite.
    """
    to_point = np.asarray(points_world, dtype=np.float64) - centre_a
    to_b = centre_b - centre_a
    if not np.isfinite(to_point).all():
        raise InputError(
            "epipolar planes need finite points: leave out those at infinity"
        )
    across: Float = np.cross(to_b, to_point)
    size = np.linalg.norm(across, axis=-1, keepdims=True)
    distinct = size > _COINCIDENT * np.linalg.norm(
        to_point, axis=-1, keepdims=True
    ) * np.linalg.norm(to_b)
    normal = np.divide(across, size, out=np.zeros_like(across), where=distinct)
    return np.concatenate([normal, -(normal @ centre_a)[..., None]], axis=-1)
