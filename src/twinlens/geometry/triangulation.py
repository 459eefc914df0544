"""From pixels of two or more cameras back to the point, and how far noise in the pixels carries it.

Three ways, one visible dict: `midpoint` (nearest to the rays), `dlt` (the linear one) and `optimal` (Hartley and Sturm:
the smallest move of the pixels that makes two rays meet). Distortion is undone first.

Sources: Hartley and Sturm, Triangulation, CVIU 68(2), 1997; Hartley and Zisserman 2004, chapter 12 and section 5.2.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens import geometry
from twinlens.camera import Rig
from twinlens.camera.jacobian import projection_jacobian
from twinlens.errors import InputError, unknown
from twinlens.geometry import Float
from twinlens.geometry.epipolar import check_pair, fundamental_matrix, ideal_pixels
from twinlens.geometry.hartley_sturm import correct_matches

_PARALLEL = 1e-12  # sine of the angle between rays below which they meet nowhere
_SINGULAR = 1e-12  # of the largest singular value: below this the pixels say nothing about one direction

Method = Callable[[Rig, tuple[int, ...], list[Float]], Float]


def triangulate(
    rig: Rig, pixels: Sequence[ArrayLike], cameras: Sequence[int] = (0, 1), method: str = "optimal"
) -> Float:
    """World points (N, 3), metres, seen at `pixels`: one (N, 2) array for each of the rig's `cameras`.

    Parameters
    ----------
    rig : Rig
    pixels : sequence of (N, 2) arrays
        As measured; the camera's distortion is undone here.
    cameras : sequence of int
        Which cameras, two or more; the optimal method takes two.
    method : {"optimal", "midpoint", "dlt"}

    Returns
    -------
    float64 (N, 3). +inf in all three coordinates where there is no point in front of every camera: rays that are
    parallel (a point at infinity), that part (noise beyond infinity), or that both look along the baseline.

    Raises InputError for pixels that are not finite, cameras that stand in one place, or an unknown method.
    """
    if method not in METHODS:
        raise unknown("triangulation method", method, METHODS)
    chosen = _checked(rig, pixels, cameras)
    ideal = [ideal_pixels(rig.cameras[i], seen) for i, seen in zip(chosen, pixels, strict=True)]
    if len({seen.shape for seen in ideal}) != 1 or ideal[0].ndim != 2:
        raise InputError(f"pixels must be as many (N, 2) in every camera, got {[seen.shape for seen in ideal]}")
    points = METHODS[method](rig, chosen, ideal)
    return np.where(_before_all(rig, chosen, points)[:, None], points, np.inf)


def covariance(
    rig: Rig, points_world: ArrayLike, sigma_px: float | Sequence[float] = 1.0, cameras: Sequence[int] = (0, 1)
) -> Float:
    """Covariance (N, 3, 3), square metres in world axes, of points (N, 3) triangulated from noisy pixels.

    To first order C = (sum_i J_i^T J_i / sigma_i^2)^-1, J_i the (2, 3) derivative of the pixel in camera i (distortion
    included): the bound that the optimal method reaches. `sigma_px` is the standard deviation of u and of v, pixels,
    independent, one number or one a camera. Source: Hartley and Zisserman 2004, section 5.2.

    Raises InputError for points at infinity, behind a camera, or so near the line through the centres (or so far) that
    the pixels do not fix them.
    """
    chosen = _checked(rig, cameras, cameras)
    points = np.asarray(points_world, dtype=np.float64)
    sigmas = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), len(chosen))
    if not (np.isfinite(sigmas).all() and (sigmas > 0).all()):
        raise InputError(f"sigma_px must be positive numbers of pixels, got {sigma_px}")
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError("covariance needs finite points (N, 3): leave out those at infinity")
    rows = [_world_jacobian(rig, i, points) / sigma for i, sigma in zip(chosen, sigmas, strict=True)]
    _, size, axes = np.linalg.svd(np.concatenate(rows, axis=1))
    if (size[:, 2] <= _SINGULAR * size[:, 0]).any():
        raise InputError(
            "a point in line with the cameras, or far beyond them, is not fixed by its pixels: leave it out"
        )
    spread: Float = np.einsum("nki,nk,nkj->nij", axes, size**-2, axes)
    return spread


def _checked(rig: Rig, pixels: Sequence[object], cameras: Sequence[int]) -> tuple[int, ...]:
    """The cameras, some two of which stand apart, with pixels each."""
    chosen = tuple(cameras)
    if len(chosen) < 2 or len(chosen) != len(pixels) or len(set(chosen)) != len(chosen):
        raise InputError(
            f"triangulation needs pixels of two or more different cameras, got cameras {list(chosen)} and "
            f"{len(pixels)} arrays"
        )
    if not all(0 <= i < len(rig) for i in chosen):
        raise InputError(f"cameras must be out of 0 to {len(rig) - 1}, got {list(chosen)}")
    check_pair(rig, chosen[0], max(chosen[1:], key=lambda i: rig.baseline(chosen[0], i)))
    return chosen


def _rays(rig: Rig, cameras: tuple[int, ...], ideal: list[Float]) -> tuple[Float, Float]:
    """Centres (n, 1, 3) and unit directions (n, N, 3) in world axes."""
    centres = np.stack([rig.world_from_cams[i][:3, 3] for i in cameras])[:, None]
    rays = [geometry.rotate(rig.world_from_cams[i], _direction(rig, i, p)) for i, p in zip(cameras, ideal, strict=True)]
    directions = np.stack(rays)
    return centres, directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def _direction(rig: Rig, index: int, ideal: Float) -> Float:
    camera = rig.cameras[index]
    return geometry.homogeneous((ideal - (camera.cx, camera.cy)) / (camera.fx, camera.fy))


def _midpoint(rig: Rig, cameras: tuple[int, ...], ideal: list[Float]) -> Float:
    """The point with the least sum of squared distances from the rays; inf where they are parallel.

    The projections I - d d^T away from each ray are stacked and solved by their singular values, not by the normal
    equations, which would square the small angle between far rays.
    """
    centres, rays = _rays(rig, cameras, ideal)
    origin, scale = centres[0], np.abs(centres - centres[0]).max()
    away = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    offsets = np.einsum("knij,kxj->nki", away, (centres - origin) / scale).reshape(rays.shape[1], 3 * len(rays))
    left, size, axes = np.linalg.svd(away.swapaxes(0, 1).reshape(rays.shape[1], 3 * len(rays), 3), full_matrices=False)
    meeting = size[:, 2:] > _PARALLEL
    along = np.einsum("nki,nk->ni", left, offsets) / np.where(meeting, size, 1.0)
    return np.where(meeting, origin + scale * np.einsum("nki,nk->ni", axes, along), np.inf)


def _dlt(rig: Rig, cameras: tuple[int, ...], ideal: list[Float]) -> Float:
    """`geometry.triangulate` in the first camera's frame, in units of the rig's extent, for its conditioning."""
    first = rig.world_from_cams[cameras[0]]
    scale = max(rig.baseline(cameras[0], i) for i in cameras[1:])
    matrices = [rig.b_from_a(cameras[0], i)[:3] / ([1.0, 1.0, 1.0, scale]) for i in cameras]
    seen = [_direction(rig, i, p)[:, :2] for i, p in zip(cameras, ideal, strict=True)]
    points = geometry.triangulate(matrices, seen)
    _, rays = _rays(rig, cameras, ideal)
    meeting = (np.linalg.norm(np.cross(rays[0], rays[1:]), axis=-1) > _PARALLEL).any(axis=0)
    known = meeting & np.isfinite(points).all(axis=1)
    world = geometry.transform_points(first, scale * np.where(known[:, None], points, 0.0))
    return np.where(known[:, None], world, np.inf)


def _optimal(rig: Rig, cameras: tuple[int, ...], ideal: list[Float]) -> Float:
    """The pixels moved least until their rays meet; where they do is then the same by any method."""
    if len(cameras) != 2:
        raise InputError(f"the optimal method takes two cameras, got {len(cameras)}: use 'midpoint' or 'dlt' for more")
    corrected = correct_matches(fundamental_matrix(rig, *cameras), *ideal)
    return _midpoint(rig, cameras, list(corrected))


METHODS: dict[str, Method] = {"optimal": _optimal, "midpoint": _midpoint, "dlt": _dlt}
"""Every way to triangulate, by name."""


def _before_all(rig: Rig, cameras: tuple[int, ...], points: Float) -> NDArray[np.bool_]:
    """Which points (N, 3) are finite and have positive depth in every camera."""
    finite: NDArray[np.bool_] = np.all(np.isfinite(points), axis=1)
    safe = np.where(finite[:, None], points, 0.0)
    depths = [(safe - rig.world_from_cams[i][:3, 3]) @ rig.world_from_cams[i][:3, 2] for i in cameras]
    return np.logical_and(finite, np.all(np.stack(depths) > 0, axis=0))


def _world_jacobian(rig: Rig, index: int, points: Float) -> Float:
    """d(u, v)/d(world point), (N, 2, 3)."""
    cam_from_world = geometry.inverse(rig.world_from_cams[index])
    return (
        projection_jacobian(rig.cameras[index], geometry.transform_points(cam_from_world, points))
        @ (cam_from_world[:3, :3])
    )
