"""The smallest move of two pixels that makes them a match, exactly: Hartley and Sturm's polynomial of degree six.

Each pair of corresponding epipolar lines is one value of a parameter t. The squared distance of the two pixels from
their lines is a fraction in t, whose stationary points are the roots of a polynomial g(t); the best of them, or the
line at t = infinity, is the global minimum.

Source: Hartley and Sturm, Triangulation, CVIU 68(2), 1997; Hartley and Zisserman 2004, algorithm 12.1.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError
from twinlens.geometry import Float, homogeneous

_LEADING = 1e-10  # of the largest coefficient: a leading one below it only makes roots far outside the images
_NOTHING = 1e-12  # relative: a pixel this near the epipole is on it, a matrix this near rank 1 has it

Lines = tuple[Float, ...]
"""a, b, c, d of F in the canonical frames and the inverse distances f_a, f_b of the epipoles there, (N, 1) each."""


def correct_matches(F: ArrayLike, pixels_a: ArrayLike, pixels_b: ArrayLike) -> tuple[Float, Float]:
    """Pixels (N, 2), (N, 2) nearest to the given ones, in sum of squares, that satisfy p_b^T F p_a = 0.

    F (3, 3) is of any scale; pixels are ideal, in the units of F. A pixel on the epipole matches everything: its pair
    is returned as it came. Raises InputError for shapes that do not fit, numbers that are not finite, or F of rank 1.
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
        np.where(given, seen_a, scale * _moved(px_from_a, _foot(*line_a))),
        np.where(given, seen_b, scale * _moved(px_from_b, _foot(*line_b))),
    )


def _check(matrix: Float, seen_a: Float, seen_b: Float) -> None:
    if matrix.shape != (3, 3) or seen_a.ndim != 2 or seen_a.shape[1:] != (2,) or seen_a.shape != seen_b.shape:
        shapes = f"{matrix.shape}, {seen_a.shape}, {seen_b.shape}"
        raise InputError(f"correct_matches needs F (3, 3) and as many pixels (N, 2) twice, got shapes {shapes}")
    if not all(np.isfinite(values).all() for values in (matrix, seen_a, seen_b)):
        raise InputError("correct_matches needs finite numbers: leave out points that a camera does not see")
    size = np.linalg.svd(matrix, compute_uv=False)
    if not size[1] > _NOTHING * size[0]:
        raise InputError("correct_matches needs F of rank 2, as two cameras standing apart have")


def _canonical(epipole: Float, seen: Float) -> tuple[Float, Float, NDArray[np.bool_]]:
    """Frames with each pixel at the origin and the epipole at (1, 0, f): px_from_canonical, f, and who is on it."""
    away = epipole[:2] - seen * epipole[2]
    size = np.hypot(away[:, 0], away[:, 1])
    on_epipole = size <= _NOTHING * np.abs(epipole[2])
    size = np.where(on_epipole, 1.0, size)
    cosine, sine = (away / size[:, None]).T
    frames = np.zeros((len(seen), 3, 3))
    frames[:, 0, 0], frames[:, 0, 1], frames[:, 1, 0], frames[:, 1, 1] = cosine, -sine, sine, cosine
    frames[:, :2, 2], frames[:, 2, 2] = seen, 1.0
    return frames, (epipole[2] / size)[:, None], on_epipole


def _moved(px_from_canonical: Float, points: Float) -> Float:
    moved: Float = np.einsum("nij,nj->ni", px_from_canonical, homogeneous(points[:, 0]))[:, :2]
    return moved


def _best(lines: Lines) -> tuple[Float, Float]:
    """(t, w), (N, 1) each, of the lines with the smallest cost: t over w is the parameter, w = 0 its infinity."""
    roots = _real_parts_of_roots(_stationary(lines))
    t = np.concatenate([roots, np.ones((len(roots), 1))], axis=1)
    w = np.concatenate([np.ones_like(roots), np.zeros((len(roots), 1))], axis=1)
    line_a, line_b = _epipolar(lines, t, w)
    best = np.argmin(_square_distance(*line_a) + _square_distance(*line_b), axis=1)[:, None]
    return np.take_along_axis(t, best, axis=1), np.take_along_axis(w, best, axis=1)


def _epipolar(lines: Lines, t: Float, w: Float) -> tuple[tuple[Float, Float, Float], tuple[Float, Float, Float]]:
    """The two lines of t and w (N, M) in the canonical frames: (f_a t, w, -t) and (-f_b C, A, C).

    A = a t + b w and C = c t + d w.
    """
    a, b, c, d, f_a, f_b = lines
    over, under = a * t + b * w, c * t + d * w
    return (f_a * t, w, -t), (-f_b * under, over, under)


def _square_distance(l: Float, m: Float, n: Float) -> Float:  # noqa: E741
    """n^2 / (l^2 + m^2), of a line from the origin; inf for the line at infinity."""
    square = l * l + m * m
    return np.divide(n * n, square, out=np.full_like(square, np.inf), where=square > 0)


def _foot(l: Float, m: Float, n: Float) -> Float:  # noqa: E741
    """The point (-l n, -m n) / (l^2 + m^2), (N, M, 2), of a line nearest to the origin."""
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
    """The product of polynomials, row by row: (N, m), (N, n) -> (N, m + n - 1)."""
    product = np.zeros((len(p), p.shape[1] + q.shape[1] - 1))
    for power in range(p.shape[1]):
        product[:, power : power + q.shape[1]] += p[:, power, None] * q
    return product


def _real_parts_of_roots(coefficients: Float) -> Float:
    """Real parts (N, 6) of the roots, eigenvalues of companion matrices; 0 in the place of those a row does not have.

    A complex root's real part is no stationary point, but a line like any other: it can only be outdone.
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
