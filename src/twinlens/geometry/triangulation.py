"""Points from pixels of two or more views, by three methods.

Each method takes calibration matrices, poses and ideal (undistorted) pixels. `twinlens.camera.triangulate` takes a rig.
The optimal method makes the smallest move of two pixels that satisfies the epipolar constraint. Each pair of
corresponding epipolar lines has one parameter t, and the squared distance of the two pixels from their lines is a
rational function of t. Its stationary points are the real roots of a polynomial g(t) of degree six; the best of them,
or the line at t = infinity, is the global minimum.

Sources: Hartley and Sturm, Triangulation, CVIU 68(2), 1997; Hartley and Zisserman 2004, chapter 12.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError
from twinlens.geometry import Float, dehomogeneous, float_array, homogeneous, inverse, rotate, transform_points
from twinlens.geometry.epipolar import essential_matrix, fundamental_matrix

_PARALLEL = 1e-12  # sine of the angle between rays that do not intersect
_LEADING = 1e-10  # relative to the largest coefficient: a smaller leading one adds roots far outside the images
_ZERO = 1e-12  # relative: distance of a pixel from the epipole, and of a matrix from rank 1

Method = Callable[[Sequence[Float], Sequence[Float], Sequence[Float]], Float]
"""K (3, 3), world_from_cam (4, 4) and ideal pixels (N, 2) of each view -> world points (N, 3); inf where rays are
parallel."""
Lines = tuple[Float, ...]
"""a, b, c, d of F in the canonical frames, and the inverse distances f_a, f_b of the epipoles, (N, 1) each."""


def triangulate_dlt(px_from_worlds: Sequence[ArrayLike], pixels: Sequence[ArrayLike]) -> Float:
    """World points (N, 3) seen at `pixels`, one (N, 2) per view, by projection matrices `px_from_worlds`, (3, 4) each.

    The homogeneous direct linear transform, each row scaled to unit norm; a point at infinity gives inf.
    Raises InputError when counts or shapes do not fit, or a number is not finite.
    Source: Hartley and Zisserman 2004, section 12.2.
    """
    if not len(px_from_worlds) == len(pixels) >= 2:
        counts = f"{len(px_from_worlds)} and {len(pixels)}"
        raise InputError(f"triangulate_dlt needs two or more views with pixels each, got {counts}")
    matrices = [float_array("triangulate_dlt", matrix) for matrix in px_from_worlds]
    seen = [float_array("triangulate_dlt", uv) for uv in pixels]
    if any(p.shape != (3, 4) for p in matrices) or any(uv.shape != (len(seen[0]), 2) for uv in seen):
        raise InputError("triangulate_dlt needs 3x4 matrices and the same number of pixels (N, 2) in every view")
    if not all(np.isfinite(values).all() for values in matrices + seen):
        raise InputError("triangulate_dlt needs finite matrices and pixels: leave out points that a view does not see")
    rows = []
    for p, uv in zip(matrices, seen, strict=True):
        rows += [uv[:, :1] * p[2] - p[0], uv[:, 1:] * p[2] - p[1]]
    system = np.stack(rows, axis=1)
    system /= np.linalg.norm(system, axis=2, keepdims=True)
    return dehomogeneous(np.linalg.svd(system)[2][:, -1])


def midpoint(Ks: Sequence[Float], world_from_cams: Sequence[Float], pixels: Sequence[Float]) -> Float:
    """The point with the smallest sum of squared distances from the rays.

    The projections I - d d^T orthogonal to each ray are stacked and solved by their singular values. The normal
    equations would square the small angle between distant rays.
    """
    centres, rays = _rays(Ks, world_from_cams, pixels)
    origin, scale = centres[0], np.abs(centres - centres[0]).max()
    count, equations = rays.shape[1], 3 * len(rays)
    orthogonal = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    offsets = np.einsum("knij,kxj->nki", orthogonal, (centres - origin) / scale).reshape(count, equations)
    left, size, axes = np.linalg.svd(orthogonal.swapaxes(0, 1).reshape(count, equations, 3), full_matrices=False)
    intersecting = size[:, 2:] > _PARALLEL
    along = np.einsum("nki,nk->ni", left, offsets) / np.where(intersecting, size, 1.0)
    return np.where(intersecting, origin + scale * np.einsum("nki,nk->ni", axes, along), np.inf)


def dlt(Ks: Sequence[Float], world_from_cams: Sequence[Float], pixels: Sequence[Float]) -> Float:
    """`triangulate_dlt` in the frame of the first camera and in units of the largest baseline, for its conditioning."""
    first = world_from_cams[0]
    scale = max(float(np.linalg.norm(pose[:3, 3] - first[:3, 3])) for pose in world_from_cams[1:])
    matrices = [(inverse(pose) @ first)[:3] / [1.0, 1.0, 1.0, scale] for pose in world_from_cams]
    points = triangulate_dlt(matrices, [_directions(*view)[:, :2] for view in zip(Ks, pixels, strict=True)])
    _, rays = _rays(Ks, world_from_cams, pixels)
    intersecting = (np.linalg.norm(np.cross(rays[0], rays[1:]), axis=-1) > _PARALLEL).any(axis=0)
    known = (intersecting & np.isfinite(points).all(axis=1))[:, None]
    return np.where(known, transform_points(first, scale * np.where(known, points, 0.0)), np.inf)


def optimal(Ks: Sequence[Float], world_from_cams: Sequence[Float], pixels: Sequence[Float]) -> Float:
    """The point of the two rays after the smallest move of the pixels that makes the rays intersect."""
    if len(Ks) != 2:
        raise InputError(f"the optimal method takes two cameras, got {len(Ks)}: use 'midpoint' or 'dlt' for more")
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


def _rays(Ks: Sequence[Float], poses: Sequence[Float], pixels: Sequence[Float]) -> tuple[Float, Float]:
    """Centres (V, 1, 3) and unit directions (V, N, 3) in world axes."""
    centres = np.stack([pose[:3, 3] for pose in poses])[:, None]
    rays = np.stack([rotate(pose, _directions(K, uv)) for K, pose, uv in zip(Ks, poses, pixels, strict=True)])
    return centres, rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def correct_matches(F: ArrayLike, pixels_a: ArrayLike, pixels_b: ArrayLike) -> tuple[Float, Float]:
    """The pixels (N, 2), (N, 2) that satisfy p_b^T F p_a = 0 with the smallest sum of squared moves.

    F (3, 3) has any scale. Pixels are ideal (undistorted). A pixel on the epipole matches every pixel: its pair is
    returned unchanged. Raises InputError for shapes that do not fit, numbers that are not finite, or F of rank 1.
    """
    matrix, seen_a, seen_b = (np.array(values, dtype=np.float64) for values in (F, pixels_a, pixels_b))
    _check(matrix, seen_a, seen_b)
    scale = max(float(np.abs(seen).max(initial=0.0)) for seen in (seen_a, seen_b)) or 1.0
    matrix = np.diag([scale, scale, 1.0]) @ matrix @ np.diag([scale, scale, 1.0])
    left, _, right = np.linalg.svd(matrix / np.linalg.norm(matrix))
    px_from_a, f_a, on_a = _canonical(right[2], seen_a / scale)
    px_from_b, f_b, on_b = _canonical(left[:, 2], seen_b / scale)
    canonical = px_from_b.swapaxes(1, 2) @ (matrix / np.linalg.norm(matrix)) @ px_from_a
    lines = (*(canonical[:, i, j, None] for i in (1, 2) for j in (1, 2)), f_a, f_b)
    feet = (homogeneous(_foot(*line)[:, 0]) for line in _epipolar(lines, *_best(lines)))
    moved = [np.einsum("nij,nj->ni", *view)[:, :2] for view in zip((px_from_a, px_from_b), feet, strict=True)]
    given = (on_a | on_b)[:, None]
    return np.where(given, seen_a, scale * moved[0]), np.where(given, seen_b, scale * moved[1])


def _check(matrix: Float, seen_a: Float, seen_b: Float) -> None:
    if matrix.shape != (3, 3) or seen_a.ndim != 2 or seen_a.shape[1:] != (2,) or seen_a.shape != seen_b.shape:
        shapes = f"{matrix.shape}, {seen_a.shape}, {seen_b.shape}"
        raise InputError(f"correct_matches needs F (3, 3) and equally many pixels (N, 2) twice, got shapes {shapes}")
    if not all(np.isfinite(values).all() for values in (matrix, seen_a, seen_b)):
        raise InputError("correct_matches needs finite numbers: leave out points that a camera does not see")
    size = np.linalg.svd(matrix, compute_uv=False)
    if not size[1] > _ZERO * size[0]:
        raise InputError("correct_matches needs F of rank 2, that of two cameras with a baseline")


def _canonical(epipole: Float, seen: Float) -> tuple[Float, Float, NDArray[np.bool_]]:
    """px_from_canonical, f and on_epipole for frames with the pixel at the origin and the epipole at (1, 0, f)."""
    away = epipole[:2] - seen * epipole[2]
    size = np.hypot(away[:, 0], away[:, 1])
    on_epipole = size <= _ZERO * np.abs(epipole[2])
    size = np.where(on_epipole, 1.0, size)
    cosine, sine = (away / size[:, None]).T
    frames = np.zeros((len(seen), 3, 3))
    frames[:, 0, 0], frames[:, 0, 1], frames[:, 1, 0], frames[:, 1, 1] = cosine, -sine, sine, cosine
    frames[:, :2, 2], frames[:, 2, 2] = seen, 1.0
    return frames, (epipole[2] / size)[:, None], on_epipole


def _best(lines: Lines) -> tuple[Float, Float]:
    """The lines with the smallest cost: their parameter t / w, (N, 1) each; w = 0 is the parameter at infinity."""
    roots = _real_parts_of_roots(_stationary(lines))
    t = np.concatenate([roots, np.ones((len(roots), 1))], axis=1)
    w = np.concatenate([np.ones_like(roots), np.zeros((len(roots), 1))], axis=1)
    line_a, line_b = _epipolar(lines, t, w)
    best = np.argmin(_square_distance(*line_a) + _square_distance(*line_b), axis=1)[:, None]
    return np.take_along_axis(t, best, axis=1), np.take_along_axis(w, best, axis=1)


def _epipolar(lines: Lines, t: Float, w: Float) -> tuple[tuple[Float, Float, Float], tuple[Float, Float, Float]]:
    """The lines (f_a t, w, -t) and (-f_b C, A, C) in the canonical frames, with A = a t + b w and C = c t + d w."""
    a, b, c, d, f_a, f_b = lines
    over, under = a * t + b * w, c * t + d * w
    return (f_a * t, w, -t), (-f_b * under, over, under)


def _square_distance(l: Float, m: Float, n: Float) -> Float:  # noqa: E741
    """Squared distance n^2 / (l^2 + m^2) of a line from the origin; inf for the line at infinity."""
    square = l * l + m * m
    return np.divide(n * n, square, out=np.full_like(square, np.inf), where=square > 0)


def _foot(l: Float, m: Float, n: Float) -> Float:  # noqa: E741
    """The point of a line nearest to the origin, (-l n, -m n) / (l^2 + m^2), (N, M, 2)."""
    square = l * l + m * m
    return np.stack([-l * n, -m * n], axis=-1) / np.where(square > 0, square, 1.0)[..., None]


def _stationary(lines: Lines) -> Float:
    """Coefficients (N, 7), rising powers, of g(t) = t (A^2 + f_b^2 C^2)^2 - (ad - bc) (1 + f_a^2 t^2)^2 A C."""
    a, b, c, d, f_a, f_b = lines
    over, under = np.concatenate([b, a], axis=1), np.concatenate([d, c], axis=1)
    spread = _times(over, over) + f_b**2 * _times(under, under)
    zero = np.zeros_like(a)
    narrow = np.concatenate([zero + 1.0, zero, 2 * f_a**2, zero, f_a**4], axis=1)
    rising = np.concatenate([zero, _times(spread, spread), zero], axis=1)
    return rising - (a * d - b * c) * _times(narrow, _times(over, under))


def _times(p: Float, q: Float) -> Float:
    """Row-wise product of polynomials: (N, m), (N, n) -> (N, m + n - 1)."""
    product = np.zeros((len(p), p.shape[1] + q.shape[1] - 1))
    for power in range(p.shape[1]):
        product[:, power : power + q.shape[1]] += p[:, power, None] * q
    return product


def _real_parts_of_roots(coefficients: Float) -> Float:
    """Real parts (N, 6) of the roots, by eigenvalues of companion matrices; 0 fills rows of lower degree.

    The real part of a complex root is not a stationary point. It is one more candidate, never below the minimum.
    """
    size = np.abs(coefficients)
    large = size > _LEADING * size.max(axis=1, keepdims=True)
    degrees = np.where(large.any(axis=1), coefficients.shape[1] - 1 - np.argmax(large[:, ::-1], axis=1), 0)
    roots = np.zeros((len(coefficients), coefficients.shape[1] - 1))
    for degree in np.unique(degrees[degrees > 0]):
        rows = np.flatnonzero(degrees == degree)
        companion = np.zeros((len(rows), degree, degree))
        companion[:, np.arange(1, degree), np.arange(degree - 1)] = 1.0
        companion[:, :, -1] = -coefficients[rows, :degree] / coefficients[rows, degree, None]
        roots[rows, :degree] = np.linalg.eigvals(companion).real
    return roots
