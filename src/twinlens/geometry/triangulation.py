"""Points from pixels of two or more views, by three methods, and the covariance that pixel noise causes.

Each method takes calibration matrices, poses and ideal (undistorted) pixels. `twinlens.camera.triangulate` takes a rig.

Sources: Hartley and Sturm, Triangulation, CVIU 68(2), 1997; Hartley and Zisserman 2004, chapter 12 and section 5.2.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError
from twinlens.geometry.epipolar import essential_matrix, fundamental_matrix
from twinlens.geometry.hartley_sturm import correct_matches
from twinlens.geometry.transforms import (
    Float,
    dehomogeneous,
    float_array,
    homogeneous,
    inverse,
    rotate,
    transform_points,
)

_PARALLEL = 1e-12  # sine of the angle between rays that do not intersect
_SINGULAR = 1e-12  # relative to the largest singular value

Method = Callable[[Sequence[Float], Sequence[Float], Sequence[Float]], Float]
"""K (3, 3), world_from_cam (4, 4) and ideal pixels (N, 2) of each view -> world points (N, 3); inf where rays are
parallel."""


def triangulate_dlt(px_from_worlds: Sequence[ArrayLike], pixels: Sequence[ArrayLike]) -> Float:
    """World points (N, 3) seen at `pixels`, one (N, 2) per view, by projection matrices `px_from_worlds`, (3, 4) each.

    The homogeneous direct linear transform, each row scaled to unit norm; a point at infinity gives inf.
    Raises InputError when counts or shapes do not fit, or a number is not finite.
    Source: Hartley and Zisserman 2004, section 12.2.
    """
    if len(px_from_worlds) != len(pixels) or len(pixels) < 2:
        raise InputError(
            f"triangulate_dlt needs two or more views with pixels each, got {len(px_from_worlds)} and {len(pixels)}"
        )
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
    finite: NDArray[np.bool_] = np.all(np.isfinite(points), axis=1)
    safe = np.where(finite[:, None], points, 0.0)
    depths = [(safe - pose[:3, 3]) @ pose[:3, 2] for pose in world_from_cams]
    return np.logical_and(finite, np.all(np.stack(depths) > 0, axis=0))


def covariance(jacobians: Float) -> Float:
    """(J^T J)^-1, (N, 3, 3): the first-order covariance of points from the pixel derivatives J (N, 2 V, 3) of V views.

    J is d(u, v)/d(world point) divided by the standard deviation of the pixels.
    Raises InputError for a point that its pixels do not determine. Source: Hartley and Zisserman 2004, section 5.2.
    """
    _, size, axes = np.linalg.svd(jacobians)
    if (size[:, 2] <= _SINGULAR * size[:, 0]).any():
        raise InputError(
            "a point on the line through the cameras, or very far away, is not determined by its pixels: leave it out"
        )
    spread: Float = np.einsum("nki,nk,nkj->nij", axes, size**-2, axes)
    return spread


def _directions(K: Float, pixels: Float) -> Float:
    return homogeneous((pixels - K[:2, 2]) / (K[0, 0], K[1, 1]))


def _rays(Ks: Sequence[Float], poses: Sequence[Float], pixels: Sequence[Float]) -> tuple[Float, Float]:
    """Centres (V, 1, 3) and unit directions (V, N, 3) in world axes."""
    centres = np.stack([pose[:3, 3] for pose in poses])[:, None]
    rays = np.stack([rotate(pose, _directions(K, uv)) for K, pose, uv in zip(Ks, poses, pixels, strict=True)])
    return centres, rays / np.linalg.norm(rays, axis=-1, keepdims=True)
