"""Rigid transforms, projection, epipolar geometry and triangulation of matrices and arrays.

This module has the transforms, the projection, and the relation of disparity and depth. Nothing in the package depends
on a camera class: `twinlens.camera` applies these functions to cameras and rigs.

Coordinates, units and unknown values follow docs/conventions.md: the camera frame is OpenCV's, pixel centres are at
integer coordinates, `world_from_cam` maps camera to world coordinates, and unknown disparity or depth is +inf.

Source: Hartley and Zisserman, Multiple View Geometry in Computer Vision, 2nd ed., 2004.
"""

import math
from decimal import Decimal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError

Float = NDArray[np.float64]

_ROTATION_TOLERANCE = 1e-6  # a matrix written with seven digits is accepted
_FEWEST_DIGITS = 3  # of a matrix that may be taken for a rounded rotation
_ROUNDING = 1e-13  # products of exact rotations deviate by less
_BORDER_POINTS = 33  # per side of an image
_BLOCK = (
    1 << 14
)  # points: OpenBLAS multiplies larger arrays in threads, which takes ten times the processor time


def rigid(rotation: ArrayLike, translation: ArrayLike) -> Float:
    """The 4x4 rigid transform x_b = R x_a + t, from R (3, 3) and t (3,).

    >>> rigid(np.eye(3), [1, 2, 3])[:3, 3].tolist()
    [1.0, 2.0, 3.0]
    """
    r, t = (
        float_array("rigid transform", values) for values in (rotation, translation)
    )
    if r.shape != (3, 3) or t.shape != (3,):
        raise InputError(
            f"rigid transform needs a 3x3 rotation and 3 numbers, got shapes {r.shape}, {t.shape}"
        )
    b_from_a = np.eye(4)
    b_from_a[:3, :3], b_from_a[:3, 3] = r, t
    return check_rigid(b_from_a, "rigid transform")


def check_rigid(matrix: ArrayLike, name: str) -> Float:
    """A float64 (4, 4) copy of `matrix`. Raises InputError if it is not a rotation and a translation.

    A rotation written with few digits is replaced by the nearest orthonormal matrix, if rounding to its digits explains
    the deviation. An orthonormal one is unchanged.

    >>> few_digits = [[0.87, -0.5, 0, 0], [0.5, 0.87, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    >>> check_rigid(few_digits, "pose")
    Traceback (most recent call last):
    twinlens.errors.InputError: pose must hold a right-handed rotation: rows differ from orthonormal ones by 0.0069, \
more than the 1e-06 that rounding explains
    """
    pose = float_array(name, matrix)
    if (
        pose.shape != (4, 4)
        or not np.isfinite(pose).all()
        or not np.array_equal(pose[3], [0, 0, 0, 1])
    ):
        raise InputError(
            f"{name} must be a finite 4x4 matrix with last row 0 0 0 1, got shape {pose.shape}"
        )
    rotation = pose[:3, :3]
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    allowed = _ROTATION_TOLERANCE
    if error > allowed:
        allowed = max(allowed, _explained_by_digits(rotation))
    if error > allowed:
        raise InputError(
            f"{name} must hold a right-handed rotation: rows differ from orthonormal ones by {error:.2g}, "
            f"more than the {allowed:.1g} that rounding explains"
        )
    if np.linalg.det(rotation) < 0:
        raise InputError(
            f"{name} must hold a right-handed rotation, got a mirror image"
        )
    if error > _ROUNDING:
        u, _, vt = np.linalg.svd(rotation)
        pose[:3, :3] = u @ vt
    return pose


def _explained_by_digits(rotation: Float) -> float:
    """The largest entry of R R^T - I that rounding a rotation to its digits can cause; 0 for two digits or fewer.

    Programs round to a number of decimals, or of significant digits, in which small entries have more decimals. Which
    of the two a file has is not known: the larger result counts.
    """
    by_entry = [_digits(value) for value in rotation.ravel().tolist()]
    decimals = max(decimals for decimals, _ in by_entry)
    significant = max(significant for _, significant in by_entry)
    explained = 0.0
    if decimals >= _FEWEST_DIGITS:
        h = 0.5 * 10.0**-decimals
        explained = 2 * h * math.sqrt(3) + 3 * h**2
    if significant >= _FEWEST_DIGITS:
        # 0.05 is 5e-2: its step with three significant digits is 1e-4. An entry of 1 may have been 0.9996.
        size = np.clip(np.abs(rotation), np.finfo(float).tiny, 0.99)
        steps = 10.0 ** (np.floor(np.log10(size)) + 1 - significant)
        steps[rotation == 0] = 0.0
        explained = max(explained, _deviation(rotation, 0.5 * steps))
    return explained


def _digits(value: float) -> tuple[int, int]:
    """The decimals and the significant digits of a number as it is written.

    >>> _digits(-0.0125), _digits(1.0), _digits(0.0)
    ((4, 3), (0, 1), (0, 1))
    """
    written = Decimal(repr(value)).normalize().as_tuple()
    return -int(written.exponent), len(written.digits)


def _deviation(rotation: Float, errors: Float) -> float:
    """The largest entry of R R^T - I where each entry of R is wrong by up to `errors`, all (3, 3)."""
    size = np.abs(rotation)
    # (R + E)(R + E)^T = I + R E^T + E R^T + E E^T
    one_sided = size @ errors.T
    return float((one_sided + one_sided.T + errors @ errors.T).max())


def inverse(b_from_a: ArrayLike) -> Float:
    """a_from_b (4, 4) of a rigid transform: [R^T, -R^T t]."""
    pose = np.asarray(b_from_a, dtype=np.float64)
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = pose[:3, :3].T
    a_from_b[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return a_from_b


def look_at(
    eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)
) -> Float:
    """world_from_cam (4, 4) of a camera at `eye` whose z axis points at `target` and whose -y axis points along `up`.

    Raises InputError when eye and target coincide, or `up` is parallel to the viewing direction.

    >>> look_at([0, 0, 0], [0, 5, 0])[:3, 2].tolist()
    [0.0, 1.0, 0.0]
    """
    eye, target, up = (float_array("look_at", v) for v in (eye, target, up))
    if not all(v.shape == (3,) and np.isfinite(v).all() for v in (eye, target, up)):
        raise InputError(
            "look_at needs three finite numbers each for eye, target and up"
        )
    forward = target - eye
    right = np.cross(forward, up)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up):
        got = f"eye {eye.tolist()} and target {target.tolist()}"
        raise InputError(
            f"look_at needs {got} to differ, and up not parallel to the viewing direction"
        )
    z = forward / np.linalg.norm(forward)
    x = right / np.linalg.norm(right)
    return rigid(np.stack([x, np.cross(z, x), z], axis=1), eye)


def homogeneous(points: ArrayLike) -> Float:
    """Append a 1: (..., n) -> (..., n + 1)."""
    points = np.asarray(points, dtype=np.float64)
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def dehomogeneous(points: ArrayLike) -> Float:
    """Divide by the last coordinate and drop it: (..., n + 1) -> (..., n). A point at infinity becomes inf."""
    points = np.asarray(points, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(points[..., :-1] / points[..., -1:])


def transform_points(b_from_a: ArrayLike, points_a: ArrayLike) -> Float:
    """x_b = R x_a + t for points (..., 3)."""
    pose = np.asarray(b_from_a, dtype=np.float64)
    return rotate(pose, points_a) + pose[:3, 3]


def rotate(b_from_a: ArrayLike, directions_a: ArrayLike) -> Float:
    """R x_a for directions (..., 3); the translation is ignored."""
    rotation = np.asarray(b_from_a, dtype=np.float64)[:3, :3]
    directions = np.asarray(directions_a, dtype=np.float64)
    rows = directions.reshape(-1, 3)
    if len(rows) <= _BLOCK:
        return np.asarray(directions @ rotation.T)
    parts = [
        rows[start : start + _BLOCK] @ rotation.T
        for start in range(0, len(rows), _BLOCK)
    ]
    return np.concatenate(parts).reshape(directions.shape)


def skew(vector: ArrayLike) -> Float:
    """The matrix [t]x (3, 3) of the cross product t x v.

    >>> (skew([1, 2, 3]) @ [4, 5, 6]).tolist()
    [-3.0, 6.0, -3.0]
    """
    x, y, z = np.asarray(vector, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def float_array(name: str, values: ArrayLike) -> Float:
    """A float64 copy of `values`. Raises InputError, naming `name`, if they are not real numbers."""
    try:
        if not np.iscomplexobj(values):
            return np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be an array of numbers: {error}") from error
    raise InputError(f"{name} must be an array of real numbers, got complex ones")


def depth_from_disparity(
    disparity: ArrayLike, fx: float, baseline: float, doffs: float = 0.0
) -> Float:
    """z = fx B / (d + doffs), in metres. +inf (unknown) gives +inf, and so does d + doffs = 0, a point at infinity.

    Raises InputError for NaN, -inf, or d + doffs < 0, a point behind the camera, and unless fx and B are positive.

    >>> depth_from_disparity([35.0, np.inf], fx=700, baseline=0.1).tolist()
    [2.0, inf]
    """
    shifted = np.asarray(disparity, dtype=np.float64) + doffs
    if not (fx > 0 and baseline > 0 and np.isfinite([fx, baseline]).all()):
        raise InputError(
            f"fx and baseline must be positive and finite, got fx={fx}, baseline={baseline}"
        )
    if np.isnan(shifted).any() or (shifted < 0).any():
        raise InputError(
            "disparity + doffs must be >= 0 (or +inf for unknown); NaN and negative values have no depth"
        )
    with np.errstate(divide="ignore"):
        return np.where(np.isposinf(shifted), np.inf, fx * baseline / shifted)


def depth_error(
    depth: ArrayLike, fx: float, baseline: float, disparity_error_px: float
) -> Float:
    """sigma_z = z^2 sigma_d / (fx B), in metres: the depth error, to first order, of an error of the disparity.

    Source: Gallup, Frahm, Mordohai and Pollefeys, Variable Baseline/Resolution Stereo, CVPR 2008, equation 3.

    >>> depth_error([1.0, 2.0], fx=500, baseline=0.2, disparity_error_px=0.1).tolist()
    [0.001, 0.004]
    """
    return np.asarray(
        np.square(np.asarray(depth, dtype=np.float64))
        * disparity_error_px
        / (fx * baseline)
    )


def image_border(width: int, height: int, margin: float = 0.0) -> Float:
    """Points (N, 2) along the outermost pixel centres of an image, or `margin` pixels outside them.

    >>> image_border(640, 480, margin=0.5).min(axis=0).tolist()
    [-0.5, -0.5]
    """
    left, right, top, bottom = -margin, width - 1 + margin, -margin, height - 1 + margin
    u = np.linspace(left, right, _BORDER_POINTS)
    v = np.linspace(top, bottom, _BORDER_POINTS)
    sides = [(u, np.full_like(u, y)) for y in (top, bottom)] + [
        (np.full_like(v, x), v) for x in (left, right)
    ]
    return np.concatenate([np.stack(side, axis=1) for side in sides])
