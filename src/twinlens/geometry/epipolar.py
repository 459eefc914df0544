"""Where the partner of a pixel can lie: essential and fundamental matrix, epipolar lines, epipoles and planes.

All of it follows from a `Rig` and an ordered pair (a, b) of its cameras, any poses and intrinsics. Pixels are ideal, as
a lens without distortion would form them; `ideal_pixels` makes them of measured ones, and `epipolar_curve` is the line
as the distorted image shows it.

Source: Hartley and Zisserman, Multiple View Geometry in Computer Vision, 2nd ed., 2004, chapter 9.
"""

import numpy as np
from numpy.typing import ArrayLike

from twinlens.camera import Camera, Rig
from twinlens.errors import InputError
from twinlens.geometry import Float, homogeneous, rotate, transform_points

_SAME_PLACE = 1e-12  # of the centres' distances from the world's origin: what poses in float64 can tell apart
_NOTHING = 1e-14  # relative: a vector this small is the rounding of zero


def check_pair(rig: Rig, a: int, b: int) -> None:
    """InputError unless a and b are two cameras of the rig that stand apart."""
    if not (0 <= a < len(rig) and 0 <= b < len(rig)) or a == b:
        raise InputError(f"a pair needs two different cameras out of 0 to {len(rig) - 1}, got {a} and {b}")
    reach = sum(float(np.linalg.norm(rig.world_from_cams[i][:3, 3])) for i in (a, b))
    if not rig.baseline(a, b) > _SAME_PLACE * reach:
        raise InputError(f"cameras {a} and {b} stand in one place: without a baseline there is no epipolar geometry")


def essential_matrix(rig: Rig, a: int = 0, b: int = 1) -> Float:
    """E = [t]x R with x_b = R x_a + t, (3, 3) in metres: d_b^T E d_a = 0 for directions d of one point.

    Its singular values are (B, B, 0), B the baseline. Raises InputError where there is no baseline.
    """
    check_pair(rig, a, b)
    pose_a, pose_b = rig.world_from_cams[a], rig.world_from_cams[b]
    to_b = pose_b[:3, :3].T  # differences of centres first: a rig far from the world's origin loses no digits
    return skew(to_b @ (pose_a[:3, 3] - pose_b[:3, 3])) @ to_b @ pose_a[:3, :3]


def fundamental_matrix(rig: Rig, a: int = 0, b: int = 1) -> Float:
    """F = K_b^-T E K_a^-1, (3, 3) of unit Frobenius norm: p_b^T F p_a = 0 for ideal pixels p = (u, v, 1).

    Raises InputError where there is no baseline.
    """
    inverse_a, inverse_b = (np.linalg.inv(rig.cameras[i].K) for i in _both(rig, a, b))
    matrix = inverse_b.T @ essential_matrix(rig, a, b) @ inverse_a
    scaled: Float = matrix / np.linalg.norm(matrix)
    return scaled


def ideal_pixels(camera: Camera, pixels: ArrayLike) -> Float:
    """Where pixels (..., 2) of `camera` would be without its distortion: K (x, y, 1), (..., 2).

    Raises InputError for pixels that are not finite, or so far outside that no ray lands there.
    """
    measured = np.asarray(pixels, dtype=np.float64)
    if measured.shape[-1:] != (2,) or not np.isfinite(measured).all():
        raise InputError(
            f"pixels must be finite and of shape (..., 2), got shape {measured.shape}: leave out the unseen"
        )
    if camera.distortion is None:
        return measured
    ideal = camera.unproject(measured)[..., :2] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    if np.isnan(ideal).any():
        raise InputError("a pixel lies outside what the camera's distortion can form: leave it out")
    return ideal


def epipolar_lines(rig: Rig, pixels: ArrayLike, a: int = 0, b: int = 1) -> Float:
    """The lines (l, m, n) of camera b, l u + m v + n = 0, on which the partners of a's ideal pixels (..., 2) lie.

    (..., 3) with l^2 + m^2 = 1, so that a dot product with (u, v, 1) is a distance in pixels. A line wholly at infinity
    is (0, 0, 1), and the epipole itself, whose partner may lie anywhere, has none: (0, 0, 0).
    """
    points = homogeneous(pixels)
    matrix = fundamental_matrix(rig, a, b)
    lines = points @ matrix.T
    lines[np.abs(lines) <= _NOTHING * (np.abs(points) @ np.abs(matrix).T)] = 0.0
    slope = np.hypot(lines[..., 0], lines[..., 1])[..., None]
    at_infinity = np.where(lines != 0, 1.0, 0.0)
    return np.divide(lines, slope, out=at_infinity, where=slope > 0)


def epipolar_curve(rig: Rig, pixel: ArrayLike, depths: ArrayLike, a: int = 0, b: int = 1) -> Float:
    """What camera b sees, distortion and all, of the points at `depths` (M,) metres along a's pixel (2,): (M, 2).

    NaN for points that b does not see, as `Camera.project` has it. Raises InputError for a depth that is not positive.
    """
    check_pair(rig, a, b)
    z = np.asarray(depths, dtype=np.float64)
    if not (np.isfinite(z).all() and (z > 0).all()):
        raise InputError("depths along an epipolar curve must be finite and positive")
    points = z[..., None] * rig.cameras[a].unproject(pixel)
    return rig.cameras[b].project(transform_points(rig.b_from_a(a, b), points))


def epipoles(rig: Rig, a: int = 0, b: int = 1) -> tuple[Float, Float]:
    """(e_a, e_b), homogeneous ideal pixels (3,) of unit norm: where a sees the centre of b, and b that of a.

    F e_a = 0 and e_b^T F = 0. The last entry is 0 for an epipole at infinity, and negative where the centre lies behind
    the camera.
    """
    return _epipole(rig, *_both(rig, a, b)), _epipole(rig, b, a)


def epipole_in_image(rig: Rig, a: int = 0, b: int = 1) -> bool:
    """Whether the line through both centres pierces a's image, in front or behind: no plane rectifies such a view."""
    camera, towards = rig.cameras[a], _towards(rig, *_both(rig, a, b))
    if towards[2] == 0:
        return False
    return bool(camera.contains(camera.project(towards * np.sign(towards[2]))))


def epipolar_planes(rig: Rig, points_world: ArrayLike, a: int = 0, b: int = 1) -> Float:
    """Planes (n, d), n . X + d = 0 with |n| = 1, in world coordinates, through both centres and each point (..., 3).

    (..., 4). A point in line with the centres lies on all such planes and has none of its own: (0, 0, 0, 0).
    """
    check_pair(rig, a, b)
    origin, other = rig.world_from_cams[a][:3, 3], rig.world_from_cams[b][:3, 3]
    towards = np.asarray(points_world, dtype=np.float64) - origin
    if not np.isfinite(towards).all():
        raise InputError("epipolar planes need finite points: leave out those at infinity")
    across: Float = np.cross(other - origin, towards)
    size = np.linalg.norm(across, axis=-1, keepdims=True)
    apart = size > _SAME_PLACE * np.linalg.norm(towards, axis=-1, keepdims=True) * np.linalg.norm(other - origin)
    normal = np.divide(across, size, out=np.zeros_like(across), where=apart)
    return np.concatenate([normal, -(normal @ origin)[..., None]], axis=-1)


def epipolar_residual(rig: Rig, pixels_a: ArrayLike, pixels_b: ArrayLike, a: int = 0, b: int = 1) -> Float:
    """p_b^T F p_a of ideal pixels (..., 2), F and the homogeneous pixels scaled to unit norm: (...,), 0 for a match."""
    first, second = (p / np.linalg.norm(p, axis=-1, keepdims=True) for p in map(homogeneous, (pixels_a, pixels_b)))
    residual: Float = np.einsum("...i,ij,...j->...", second, fundamental_matrix(rig, a, b), first)
    return residual


def sampson_distance(rig: Rig, pixels_a: ArrayLike, pixels_b: ArrayLike, a: int = 0, b: int = 1) -> Float:
    """How far, to first order, two ideal pixels (..., 2) must move together to match: pixels >= 0, (...,).

    |p_b^T F p_a| / sqrt((F p_a)_1^2 + (F p_a)_2^2 + (F^T p_b)_1^2 + (F^T p_b)_2^2); 0 at the two epipoles, which match
    whatever they meet. Source: Hartley and Zisserman 2004, section 11.4.3.
    """
    first, second, matrix = homogeneous(pixels_a), homogeneous(pixels_b), fundamental_matrix(rig, a, b)
    lines_b, lines_a = first @ matrix.T, second @ matrix
    slope = np.linalg.norm(np.concatenate([lines_b[..., :2], lines_a[..., :2]], axis=-1), axis=-1)
    off = np.abs(np.einsum("...i,...i->...", second, lines_b))
    distance: Float = np.divide(off, slope, out=np.zeros_like(off), where=slope > 0)
    return distance


def skew(vector: ArrayLike) -> Float:
    """[t]x, (3, 3): the cross product t x v as a matrix product.

    >>> (skew([1, 2, 3]) @ [4, 5, 6]).tolist()
    [-3.0, 6.0, -3.0]
    """
    x, y, z = np.asarray(vector, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _both(rig: Rig, a: int, b: int) -> tuple[int, int]:
    check_pair(rig, a, b)
    return a, b


def _towards(rig: Rig, a: int, b: int) -> Float:
    """The unit direction, in camera a's frame, of camera b's centre; rounding errors of zero are zero."""
    pose = rig.world_from_cams[a]
    between = rig.world_from_cams[b][:3, 3] - pose[:3, 3]
    direction = rotate(pose.T, between / np.linalg.norm(between))
    direction[np.abs(direction) <= _NOTHING] = 0.0
    return direction


def _epipole(rig: Rig, a: int, b: int) -> Float:
    point = rig.cameras[a].K @ _towards(rig, a, b)
    unit: Float = point / np.linalg.norm(point)
    return unit
