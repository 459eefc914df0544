"""Points, poses and pixels: rigid transforms, homogeneous coordinates, projection, disparity and depth, triangulation.

The conventions of twinlens, written once:

- Camera frame as OpenCV: x right, y down, z forward, metres. `world_from_cam` is a 4x4 rigid transform that takes a
  point's camera coordinates to its world coordinates, so that names cancel when transforms compose:
  ``px_from_world = px_from_cam @ cam_from_world``.
- Pixel centres lie at integer coordinates (u, v): an image spans [-0.5, W-0.5] x [-0.5, H-0.5], and a centred
  principal point is ((W-1)/2, (H-1)/2). Arrays are indexed [y, x]; sizes are given as width, height.
- Depth is z along the optical axis (never the distance along the ray, which is called `ray_distance`); a ray that hits
  nothing has depth +inf.
- Disparity is u_left - u_right in pixels, float32 at rest, and ``z = fx * B / (d + doffs)`` with
  ``doffs = cx_right - cx_left``. Unknown or invalid is +inf; NaN and -inf are errors.
- Metres, radians and seconds; a name that means anything else carries its unit (`pixel_pitch_um`, `fov_x_deg`).

Source: Hartley and Zisserman, Multiple View Geometry in Computer Vision, 2nd ed., 2004.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError

Float = NDArray[np.float64]

_ROTATION_TOLERANCE = 1e-6  # a pose typed with seven digits is still a rotation
_ROUNDING = 1e-13  # what products of exact rotations are off by


def rigid(rotation: ArrayLike, translation: ArrayLike) -> Float:
    """The 4x4 rigid transform x_b = R x_a + t, from R (3, 3) and t (3,).

    >>> rigid(np.eye(3), [1, 2, 3])[:3, 3].tolist()
    [1.0, 2.0, 3.0]
    """
    turn, shift = _numbers("rigid transform", rotation), _numbers("rigid transform", translation)
    if turn.shape != (3, 3) or shift.shape != (3,):
        raise InputError(f"rigid transform needs a 3x3 rotation and 3 numbers, got shapes {turn.shape}, {shift.shape}")
    b_from_a = np.eye(4)
    b_from_a[:3, :3] = turn
    b_from_a[:3, 3] = shift
    return check_rigid(b_from_a, "rigid transform")


def check_rigid(matrix: ArrayLike, name: str) -> Float:
    """`matrix` as a float64 (4, 4) array of its own, or InputError if it is no rotation and translation.

    A rotation typed with few digits becomes the nearest true one, whose transpose is its inverse; what is one already
    keeps every bit.
    """
    pose = _numbers(name, matrix)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not np.array_equal(pose[3], [0, 0, 0, 1]):
        raise InputError(f"{name} must be a finite 4x4 matrix with last row 0 0 0 1, got shape {pose.shape}")
    rotation = pose[:3, :3]
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise InputError(f"{name} must hold a right-handed rotation (orthonormal, determinant +1)")
    if off > _ROUNDING:
        u, _, vt = np.linalg.svd(rotation)
        pose[:3, :3] = u @ vt
    return pose


def inverse(b_from_a: ArrayLike) -> Float:
    """a_from_b of a rigid transform, (4, 4): [R^T, -R^T t]."""
    pose = np.asarray(b_from_a, dtype=np.float64)
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = pose[:3, :3].T
    a_from_b[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return a_from_b


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Float:
    """world_from_cam (4, 4) of a camera at `eye` whose z axis meets `target` and whose -y axis leans towards `up`.

    Raises InputError when eye and target coincide, or `up` lies along the line of sight.

    >>> look_at([0, 0, 0], [0, 5, 0])[:3, 2].tolist()
    [0.0, 1.0, 0.0]
    """
    eye, target, up = (_numbers("look_at", v) for v in (eye, target, up))
    if not all(v.shape == (3,) and np.isfinite(v).all() for v in (eye, target, up)):
        raise InputError("look_at needs three finite numbers each for eye, target and up")
    forward = target - eye
    right = np.cross(forward, up)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up):
        raise InputError(
            f"look_at needs eye {eye.tolist()} and target {target.tolist()} apart, and up not along the line of sight"
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
        inhomogeneous: Float = points[..., :-1] / points[..., -1:]
    return inhomogeneous


def transform_points(b_from_a: ArrayLike, points_a: ArrayLike) -> Float:
    """x_b = R x_a + t for points (..., 3)."""
    pose = np.asarray(b_from_a, dtype=np.float64)
    return np.asarray(points_a, dtype=np.float64) @ pose[:3, :3].T + pose[:3, 3]


def rotate(b_from_a: ArrayLike, directions_a: ArrayLike) -> Float:
    """R x_a for directions (..., 3): the translation does not touch them."""
    directions_b: Float = np.asarray(directions_a, dtype=np.float64) @ np.asarray(b_from_a, dtype=np.float64)[:3, :3].T
    return directions_b


def film_from_cam(points_cam: ArrayLike, film_distance: float) -> Float:
    """Where points (..., 3) fall on the film, in metres (..., 2): X = v x / z, Y = v y / z, as on an upright film.

    The real film lies behind the hole and its image is turned by 180 degrees; the upright one is its mirror in front.
    Points at or behind the aperture plane (z <= 0) have no image and give NaN.
    """
    points_cam = np.asarray(points_cam, dtype=np.float64)
    z = points_cam[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(z > 0, film_distance * points_cam[..., :2] / z, np.nan)


def px_from_film(film: ArrayLike, pixel_density: ArrayLike, principal_point: ArrayLike) -> Float:
    """Pixels (..., 2) of film points (..., 2) in metres: u = m_x X + cx, with pixel density m in pixels per metre."""
    return np.asarray(film, dtype=np.float64) * np.asarray(pixel_density, dtype=np.float64) + np.asarray(
        principal_point, dtype=np.float64
    )


def disparity_from_depth(depth: ArrayLike, fx: float, baseline: float, doffs: float = 0.0) -> Float:
    """d = fx B / z - doffs, in pixels. Depth +inf (nothing hit) gives +inf: unknown, not the disparity at infinity.

    Raises InputError for depth <= 0, NaN, or a baseline that is not positive.

    >>> disparity_from_depth([2.0, np.inf], fx=700, baseline=0.1).tolist()
    [35.0, inf]
    """
    z = _positive("depth", depth)
    _check_pair(fx, baseline)
    return np.where(np.isposinf(z), np.inf, fx * baseline / z - doffs)


def depth_from_disparity(disparity: ArrayLike, fx: float, baseline: float, doffs: float = 0.0) -> Float:
    """z = fx B / (d + doffs), in metres. Unknown (+inf) stays unknown; d + doffs = 0 is a point at infinity: +inf.

    Raises InputError for NaN, -inf, or d + doffs < 0, which would lie behind the camera.
    """
    shifted = np.asarray(disparity, dtype=np.float64) + doffs
    _check_pair(fx, baseline)
    if np.isnan(shifted).any() or (shifted < 0).any():
        raise InputError("disparity + doffs must be >= 0 (or +inf for unknown); NaN and negative values have no depth")
    with np.errstate(divide="ignore"):
        return np.where(np.isposinf(shifted), np.inf, fx * baseline / shifted)


def triangulate(
    px_from_worlds: Sequence[ArrayLike],
    pixels: Sequence[ArrayLike],
) -> Float:
    """World points (N, 3) seen at `pixels` (one (N, 2) per camera) by cameras `px_from_worlds` (3x4 each).

    The homogeneous direct linear transform, each row scaled to unit norm; a point at infinity gives inf.
    Raises InputError when counts or shapes do not fit, or a number is not finite.
    Source: Hartley and Zisserman 2004, section 12.2.
    """
    if len(px_from_worlds) != len(pixels) or len(pixels) < 2:
        raise InputError(
            f"triangulate needs two or more cameras with pixels each, got {len(px_from_worlds)} and {len(pixels)}"
        )
    matrices = [_numbers("triangulate", matrix) for matrix in px_from_worlds]
    sightings = [_numbers("triangulate", seen) for seen in pixels]
    if any(p.shape != (3, 4) for p in matrices) or any(uv.shape != (len(sightings[0]), 2) for uv in sightings):
        raise InputError("triangulate needs 3x4 matrices and as many pixels (N, 2) in every camera")
    if not all(np.isfinite(values).all() for values in matrices + sightings):
        raise InputError("triangulate needs finite matrices and pixels: leave out points that a camera does not see")
    rows = []
    for p, uv in zip(matrices, sightings, strict=True):
        rows += [uv[:, :1] * p[2] - p[0], uv[:, 1:] * p[2] - p[1]]
    system = np.stack(rows, axis=1)
    system /= np.linalg.norm(system, axis=2, keepdims=True)
    return dehomogeneous(np.linalg.svd(system)[2][:, -1])


def _numbers(name: str, values: ArrayLike) -> Float:
    """A float64 copy, or InputError for what is not numbers."""
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of numbers: {error}") from error


def _positive(name: str, values: ArrayLike) -> Float:
    array = np.asarray(values, dtype=np.float64)
    if not (array > 0).all():
        raise InputError(f"{name} must be positive (+inf where nothing was hit); NaN and values <= 0 are refused")
    return array


def _check_pair(fx: float, baseline: float) -> None:
    if not (fx > 0 and baseline > 0 and np.isfinite([fx, baseline]).all()):
        raise InputError(f"fx and baseline must be positive and finite, got fx={fx}, baseline={baseline}")
