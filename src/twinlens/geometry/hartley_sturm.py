"""Optimal correction of a match: the smallest move of two pixels that satisfies the epipolar constraint.

Each pair of corresponding epipolar lines has one parameter t. The squared distance of the two pixels from their lines
is a rational function of t. Its stationary points are the real roots of a polynomial g(t) of degree six; the best of
them, or the line at t = infinity, is the global minimum.

Source: Hartley and Sturm, Triangulation, CVIU 68(2), 1997; Hartley and Zisserman 2004, algorithm 12.1.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError
from twinlens.geometry.transforms import Float, homogeneous

_LEADING = 1e-10  # relative to the largest coefficient: a smaller leading one adds roots far outside the images
_ZERO = 1e-12  # relative: distance of a pixel from the epipole, and of a matrix from rank 1

Lines = tuple[Float, ...]
"""a, b, c, d of F in the canonical frames, and the inverse distances f_a, f_b of the epipoles, (N, 1) each."""


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
    line_a, line_b = _epipolar(lines, *_best(lines))
    given = (on_a | on_b)[:, None]
    return (
        np.where(given, seen_a, scale * _to_pixels(px_from_a, _foot(*line_a))),
        np.where(given, seen_b, scale * _to_pixels(px_from_b, _foot(*line_b))),
    )


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


def _to_pixels(px_from_canonical: Float, points: Float) -> Float:
    moved: Float = np.einsum("nij,nj->ni", px_from_canonical, homogeneous(points[:, 0]))[:, :2]
    return moved


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
