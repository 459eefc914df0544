"""Epipolar geometry and triangulation for the cameras of a `Rig`, with any poses, intrinsics and distortion.

The formulas are in `twinlens.geometry`. A pair is given by the indices (a, b) of its cameras, in this order. Ideal
pixels are undistorted ones; `ideal_pixels` computes them from measured ones.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from twinlens.camera.distortion import PERSPECTIVE
from twinlens.camera.intrinsics import Camera
from twinlens.camera.rig import Rig
from twinlens.errors import InputError, check_known
from twinlens.geometry import Float, epipolar, inverse, transform_points, triangulation

_SINGULAR = 1e-12  # relative to the largest singular value


def check_pair(rig: Rig, a: int, b: int) -> None:
    """Raise InputError unless a and b are two cameras of the rig with a baseline between them."""
    if not (0 <= a < len(rig) and 0 <= b < len(rig)) or a == b:
        raise InputError(
            f"a pair needs two different cameras from 0 to {len(rig) - 1}, got {a} and {b}"
        )
    epipolar.check_baseline(rig.world_from_cams[a], rig.world_from_cams[b])


def essential_matrix(rig: Rig, a: int = 0, b: int = 1) -> Float:
    """E of cameras a and b, (3, 3) in metres; see `geometry.epipolar.essential_matrix`."""
    check_pair(rig, a, b)
    return epipolar.essential_matrix(rig.world_from_cams[a], rig.world_from_cams[b])


def fundamental_matrix(rig: Rig, a: int = 0, b: int = 1) -> Float:
    """F of cameras a and b, (3, 3); see `geometry.epipolar`. Raises InputError where there is no baseline."""
    return epipolar.fundamental_matrix(
        essential_matrix(rig, a, b), rig.cameras[a].K, rig.cameras[b].K
    )


def ideal_pixels(camera: Camera, pixels: ArrayLike) -> Float:
    """The ideal pixels (..., 2), K (x, y, 1), of measured pixels (..., 2) of `camera`.

    Raises InputError for pixels that are not finite, or outside the range of the distortion.
    """
    measured = np.asarray(pixels, dtype=np.float64)
    if measured.shape[-1:] != (2,) or not np.isfinite(measured).all():
        raise InputError(
            f"pixels must be finite, of shape (..., 2), got {measured.shape}: leave out invisible points"
        )
    if camera.projection is PERSPECTIVE:
        return measured
    xy = camera.unproject(measured)[..., :2]
    ideal: Float = xy * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    if np.isnan(ideal).any():
        raise InputError(
            "a pixel is outside the range of the camera's distortion: leave it out"
        )
    return ideal


def epipolar_curve(
    rig: Rig, pixel: ArrayLike, depths: ArrayLike, a: int = 0, b: int = 1
) -> Float:
    """Pixels (M, 2) in camera b, distorted, of the points at `depths` (M,) metres on the ray of camera a's pixel (2,).

    NaN where b does not see the point. Raises InputError for a depth that is not positive and finite.
    """
    check_pair(rig, a, b)
    z = np.asarray(depths, dtype=np.float64)
    if not (np.isfinite(z).all() and (z > 0).all()):
        raise InputError("depths along an epipolar curve must be finite and positive")
    points = z[..., None] * rig.cameras[a].unproject(pixel)
    return rig.cameras[b].project(transform_points(rig.b_from_a(a, b), points))


def epipoles(rig: Rig, a: int = 0, b: int = 1) -> tuple[Float, Float]:
    """(e_a, e_b), homogeneous ideal pixels (3,) of unit norm: the image of b's centre in a, and of a's centre in b.

    F e_a = 0 and e_b^T F = 0. The last entry is 0 for an epipole at infinity, and negative where the other centre is
    behind the camera.
    """
    check_pair(rig, a, b)
    poses = rig.world_from_cams
    e_a = rig.cameras[a].K @ epipolar.centre_direction(poses[a], poses[b])
    e_b = rig.cameras[b].K @ epipolar.centre_direction(poses[b], poses[a])
    return e_a / np.linalg.norm(e_a), e_b / np.linalg.norm(e_b)


def epipole_in_image(rig: Rig, a: int = 0, b: int = 1) -> Float | None:
    """The pixel (2,), distorted, where the line through both centres meets a's image, in front or behind; or None.

    A view that contains its epipole cannot be rectified.
    """
    check_pair(rig, a, b)
    direction = epipolar.centre_direction(
        rig.world_from_cams[a], rig.world_from_cams[b]
    )
    # A centre behind the camera is replaced by its opposite direction, on the same line.
    pixel = rig.cameras[a].project(direction * np.sign(direction[2]))
    return pixel if rig.cameras[a].contains(pixel) else None


def triangulate(
    rig: Rig,
    pixels: Sequence[ArrayLike],
    cameras: Sequence[int] = (0, 1),
    method: str = "optimal",
) -> Float:
    """World points, float64 (N, 3), metres, from their measured `pixels`: one (N, 2) array for each of `cameras`.

    `method` is "optimal" (two cameras), "midpoint" or "dlt"; see `geometry.triangulation`. A point is +inf in all three
    coordinates if there is none in front of every camera: parallel rays (a point at infinity), diverging rays, or rays
    along the baseline.

    Raises InputError for pixels that are not finite, cameras without a baseline, or an unknown method.
    """
    check_known("triangulation method", method, triangulation.METHODS)
    chosen = _checked_cameras(rig, pixels, cameras)
    ideal = [
        ideal_pixels(rig.cameras[i], measured)
        for i, measured in zip(chosen, pixels, strict=True)
    ]
    shapes = [pixels.shape for pixels in ideal]
    if len(set(shapes)) != 1 or ideal[0].ndim != 2:
        raise InputError(
            f"pixels must be (N, 2), with the same N in every camera, got {shapes}"
        )
    poses = [rig.world_from_cams[i] for i in chosen]
    points = triangulation.METHODS[method](
        [rig.cameras[i].K for i in chosen], poses, ideal
    )
    return np.where(triangulation.in_front(poses, points)[:, None], points, np.inf)


def covariance(
    rig: Rig,
    points_world: ArrayLike,
    sigma_px: float | Sequence[float] = 1.0,
    cameras: Sequence[int] = (0, 1),
) -> Float:
    """Covariance (N, 3, 3), square metres in world axes, of points (N, 3) triangulated from noisy pixels.

    To first order C = (sum_i J_i^T J_i / sigma_i^2)^-1, J_i the (2, 3) derivative of the pixel in camera i (distortion
    included). The optimal method reaches this bound. `sigma_px` is the standard deviation of the independent errors of
    u and v, pixels: one number, or one per camera. Source: Hartley and Zisserman 2004, section 5.2.

    Raises InputError for points at infinity or behind a camera, and for points that the pixels do not determine: near
    the line through the centres, or very far away.
    """
    chosen = _checked_cameras(rig, cameras, cameras)
    points = np.asarray(points_world, dtype=np.float64)
    sigmas = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), len(chosen))
    if not (np.isfinite(sigmas).all() and (sigmas > 0).all()):
        raise InputError(f"sigma_px must be positive numbers of pixels, got {sigma_px}")
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(
            "covariance needs finite points (N, 3): leave out those at infinity"
        )
    # J_i / sigma_i of each camera, in world axes, below each other: (N, 2 V, 3).
    rows = []
    for i, sigma in zip(chosen, sigmas, strict=True):
        cam_from_world = inverse(rig.world_from_cams[i])
        jacobian = rig.cameras[i].projection_jacobian(
            transform_points(cam_from_world, points)
        )
        rows.append(jacobian @ cam_from_world[:3, :3] / sigma)
    # The inverse of J^T J by the singular values of J, which are not squared before they are compared.
    _, singular, axes = np.linalg.svd(np.concatenate(rows, axis=1))
    if (singular[:, 2] <= _SINGULAR * singular[:, 0]).any():
        raise InputError(
            "the pixels do not determine a point near the line of the cameras or very far away"
        )
    return np.asarray(np.einsum("nki,nk,nkj->nij", axes, singular**-2, axes))


def _checked_cameras(
    rig: Rig, pixels: Sequence[object], cameras: Sequence[int]
) -> tuple[int, ...]:
    """The cameras. InputError unless they differ, each has pixels, and two of them have a baseline."""
    chosen = tuple(cameras)
    if len(chosen) < 2 or len(chosen) != len(pixels) or len(set(chosen)) != len(chosen):
        got = f"cameras {list(chosen)} and {len(pixels)} arrays"
        raise InputError(
            f"triangulation needs pixels of two or more different cameras, got {got}"
        )
    if not all(0 <= i < len(rig) for i in chosen):
        raise InputError(
            f"cameras must be from 0 to {len(rig) - 1}, got {list(chosen)}"
        )
    check_pair(
        rig, chosen[0], max(chosen[1:], key=lambda i: rig.baseline(chosen[0], i))
    )
    return chosen
