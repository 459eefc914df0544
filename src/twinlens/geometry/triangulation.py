"""Points from pixels of two or more views, by three methods.

Each method takes calibration matrices, poses and ideal (undistorted) pixels. `twinlens.triangulate` takes a rig.
The optimal method makes the smallest move of two pixels that satisfies the epipolar constraint, which is quadratic in
the four coordinates: o + g . d + sum b d^2 / 2 = 0, in axes in which it has no mixed terms. With a Lagrange multiplier
m the move is d = -m g / (1 + m b). It is the global minimum where 1 + m b > 0 for every b; there the residual of the
constraint falls monotonically with m, so that bisection finds its zero.

Sources: Hartley and Sturm, Triangulation, CVIU 68(2), 1997; Hartley and Zisserman 2004, chapter 12; More,
Generalizations of the trust region problem, Optimization Methods and Software 2, 1993 (the global minimum).
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError
from twinlens.geometry import (
    Float,
    dehomogeneous,
    homogeneous,
    inverse,
    rotate,
    transform_points,
)
from twinlens.geometry.epipolar import essential_matrix, fundamental_matrix

_PARALLEL = 1e-12  # sine of the angle between rays that do not intersect
_ZERO = 1e-12  # relative: distance of a matrix from rank 1
_INSIDE = 1.0 - 1e-15  # of the interval of multipliers, at whose end a move is infinite
_HALVINGS = 64

Method = Callable[[Sequence[Float], Sequence[Float], Sequence[Float]], Float]
"""K (3, 3), world_from_cam (4, 4) and ideal pixels (N, 2) of each view -> world points (N, 3); inf where rays are
parallel."""


def triangulate_dlt(px_from_worlds: Sequence[Float], pixels: Sequence[Float]) -> Float:
    """World points (N, 3) seen at `pixels`, one (N, 2) per view, by projection matrices `px_from_worlds`, (3, 4) each.

    The homogeneous direct linear transform, each row scaled to unit norm; a point at infinity gives inf.
    Source: Hartley and Zisserman 2004, section 12.2.
    """
    rows = []
    for p, uv in zip(px_from_worlds, pixels, strict=True):
        # u = p_0 . X / p_2 . X, multiplied out: (u p_2 - p_0) . X = 0, and likewise for v.
        u, v = uv[:, :1], uv[:, 1:]
        rows += [u * p[2] - p[0], v * p[2] - p[1]]
    system = np.stack(rows, axis=1)
    system /= np.linalg.norm(system, axis=2, keepdims=True)
    # The unit vector that minimises |A X| is the right singular vector of the smallest singular value.
    right_vectors = np.linalg.svd(system)[2]
    return dehomogeneous(right_vectors[:, -1])


def midpoint(
    Ks: Sequence[Float], world_from_cams: Sequence[Float], pixels: Sequence[Float]
) -> Float:
    """The point with the smallest sum of squared distances from the rays.

    The projections I - d d^T orthogonal to each ray are stacked and solved by their singular values. The normal
    equations would square the small angle between distant rays.
    """
    centres, rays = _rays(Ks, world_from_cams, pixels)
    # World axes, from the first centre and in units of the largest baseline: no digits are lost far from the origin.
    origin, scale = centres[0], np.abs(centres - centres[0]).max()
    count, equations = rays.shape[1], 3 * len(rays)
    # Each view k asks (I - d d^T) (X - c_k) = 0: three equations, of which two are independent.
    orthogonal = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    offsets = np.einsum("knij,kxj->nki", orthogonal, (centres - origin) / scale)
    offsets = offsets.reshape(count, equations)
    stacked = orthogonal.swapaxes(0, 1).reshape(count, equations, 3)
    left, size, axes = np.linalg.svd(stacked, full_matrices=False)
    # Parallel rays leave the position along them undetermined: the smallest singular value is 0.
    intersecting = size[:, 2:] > _PARALLEL
    along = np.einsum("nki,nk->ni", left, offsets) / np.where(intersecting, size, 1.0)
    points = origin + scale * np.einsum("nki,nk->ni", axes, along)
    return np.where(intersecting, points, np.inf)


def dlt(
    Ks: Sequence[Float], world_from_cams: Sequence[Float], pixels: Sequence[Float]
) -> Float:
    """`triangulate_dlt` in the frame of the first camera and in units of the largest baseline, for its conditioning."""
    first = world_from_cams[0]
    moves = [pose[:3, 3] - first[:3, 3] for pose in world_from_cams[1:]]
    scale = max(float(np.linalg.norm(move)) for move in moves)
    # In units of `scale` the translation, the last column, is divided by it.
    matrices = [
        (inverse(pose) @ first)[:3] / [1.0, 1.0, 1.0, scale] for pose in world_from_cams
    ]
    film_points = [_directions(K, uv)[:, :2] for K, uv in zip(Ks, pixels, strict=True)]
    points = triangulate_dlt(matrices, film_points)
    _, rays = _rays(Ks, world_from_cams, pixels)
    sines = np.linalg.norm(np.cross(rays[0], rays[1:]), axis=-1)
    intersecting = (sines > _PARALLEL).any(axis=0)
    solved = (intersecting & np.isfinite(points).all(axis=1))[:, None]
    scaled = scale * np.where(solved, points, 0.0)
    return np.where(solved, transform_points(first, scaled), np.inf)


def optimal(
    Ks: Sequence[Float], world_from_cams: Sequence[Float], pixels: Sequence[Float]
) -> Float:
    """The point of the two rays after the smallest move of the pixels that makes the rays intersect."""
    if len(Ks) != 2:
        raise InputError(
            f"the optimal method takes two cameras, got {len(Ks)}: use 'midpoint' or 'dlt' for more"
        )
    matrix = fundamental_matrix(essential_matrix(*world_from_cams), *Ks)
    return midpoint(Ks, world_from_cams, correct_matches(matrix, *pixels))


METHODS: dict[str, Method] = {"optimal": optimal, "midpoint": midpoint, "dlt": dlt}
"""The triangulation methods, by name."""


def in_front(world_from_cams: Sequence[Float], points: Float) -> NDArray[np.bool_]:
    """Whether points (N, 3) are finite and have positive depth in every camera, (N,)."""
    finite = np.asarray(np.isfinite(points).all(axis=1))
    safe = np.where(finite[:, None], points, 0.0)
    depths = np.stack([(safe - pose[:3, 3]) @ pose[:3, 2] for pose in world_from_cams])
    return np.asarray(finite & (depths > 0).all(axis=0))


def _directions(K: Float, pixels: Float) -> Float:
    return homogeneous((pixels - K[:2, 2]) / (K[0, 0], K[1, 1]))


def _rays(
    Ks: Sequence[Float], poses: Sequence[Float], pixels: Sequence[Float]
) -> tuple[Float, Float]:
    """Centres (V, 1, 3) and unit directions (V, N, 3) in world axes."""
    centres = np.stack([pose[:3, 3] for pose in poses])[:, None]
    rays = np.stack(
        [
            rotate(pose, _directions(K, uv))
            for K, pose, uv in zip(Ks, poses, pixels, strict=True)
        ]
    )
    return centres, rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def correct_matches(
    F: ArrayLike, pixels_a: ArrayLike, pixels_b: ArrayLike
) -> tuple[Float, Float]:
    """The pixels (N, 2), (N, 2) that satisfy p_b^T F p_a = 0 with the smallest sum of squared moves.

    F (3, 3) has any scale. Pixels are ideal (undistorted). A pixel on the epipole matches every pixel: its pair is
    returned unchanged. Raises InputError for shapes that do not fit, numbers that are not finite, or F of rank 1.
    """
    matrix, seen_a, seen_b = (
        np.array(values, dtype=np.float64) for values in (F, pixels_a, pixels_b)
    )
    _check(matrix, seen_a, seen_b)
    # The quadratic part of the constraint is d_b^T F_2 d_a, with the upper left block F_2 = L diag(s) R of F. In the
    # axes (R d_a + L^T d_b) / sqrt(2) and (R d_a - L^T d_b) / sqrt(2) it has no mixed terms, and the bends b = s, -s.
    left, size, right = np.linalg.svd(matrix[:2, :2])
    bend = np.concatenate([size, -size])
    # The constraint at the seen pixels, o, and its gradient g in these axes, from both epipolar lines.
    lines_b, lines_a = homogeneous(seen_a) @ matrix.T, homogeneous(seen_b) @ matrix
    offset = np.einsum("ni,ni->n", homogeneous(seen_b), lines_b)[:, None]
    along_a, along_b = lines_a[:, :2] @ right.T, lines_b[:, :2] @ left
    slope = math.sqrt(0.5) * np.hstack([along_a + along_b, along_a - along_b])
    m = _multiplier(offset, slope, bend)
    # The move d = -m g / (1 + m b), turned back to the pixels of each image.
    moves = -math.sqrt(0.5) * m * slope / (1.0 + m * bend)
    sums, differences = moves[:, :2], moves[:, 2:]
    return seen_a + (sums + differences) @ right, seen_b + (sums - differences) @ left.T


def _multiplier(offset: Float, slope: Float, bend: Float) -> Float:
    """The Lagrange multiplier m (N, 1) of the smallest move, by bisection from 0 to the end of the valid interval.

    offset, slope, bend : o (N, 1), g (N, 4) and b (4,) of the constraint o + g . d + sum b d^2 / 2 = 0.
    """
    steepness = np.square(slope).sum(axis=1, keepdims=True)
    # 1 + m b > 0 bounds m, and the residual's derivative is at least steepness / 8 there, which bounds its zero.
    bound = 8.0 * offset
    least = np.maximum(steepness, 8.0 * bend[0] * np.abs(offset))
    end = np.divide(bound, least, out=np.zeros_like(offset), where=least > 0)
    near, far = np.zeros_like(offset), _INSIDE * end
    for _ in range(_HALVINGS):
        m = 0.5 * (near + far)
        # The constraint after the move of m; it starts with the sign of o.
        falls = m * slope**2 * (1.0 + 0.5 * m * bend) / (1.0 + m * bend) ** 2
        residual = offset - falls.sum(axis=1, keepdims=True)
        beyond = residual * offset < 0
        near, far = np.where(beyond, near, m), np.where(beyond, m, far)
    return near


def _check(matrix: Float, seen_a: Float, seen_b: Float) -> None:
    if (
        matrix.shape != (3, 3)
        or seen_a.ndim != 2
        or seen_a.shape[1:] != (2,)
        or seen_a.shape != seen_b.shape
    ):
        shapes = f"{matrix.shape}, {seen_a.shape}, {seen_b.shape}"
        raise InputError(
            f"correct_matches needs F (3, 3) and equally many pixels (N, 2) twice, got shapes {shapes}"
        )
    if not all(np.isfinite(values).all() for values in (matrix, seen_a, seen_b)):
        raise InputError(
            "correct_matches needs finite numbers: leave out points that a camera does not see"
        )
    size = np.linalg.svd(matrix, compute_uv=False)
    if not size[1] > _ZERO * size[0]:
        raise InputError(
            "correct_matches needs F of rank 2, that of two cameras with a baseline"
        )
