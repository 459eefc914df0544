"""The world points of a stored view: from its depth where that is more exact than float32 coordinates, or alone."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera
from twinlens.geometry import Float, rotate

_FAR = 10.0
"""Coordinates of this many distances from the camera are less exact in float32 than depths are."""

_LEAST_COSINE = 0.05
"""Between a ray and the axis: at larger angles, the rounding of a float32 depth counts more."""


def world_points(
    camera: Camera, world_from_cam: Float, depth: NDArray[Any], position: NDArray[Any]
) -> Float:
    """The points (H, W, 3), float64, of a view with float32 `depth` (H, W) and `position` (H, W, 3).

    Far from the origin they are computed from depth, along the chief rays: centre + depth / cosine * ray.
    """
    points = position.astype(np.float64)
    centre = world_from_cam[:3, 3]
    has_depth = np.isfinite(depth)
    if not np.abs(centre).max() > (_FAR - 1) * depth[has_depth].min(initial=np.inf):
        return points
    rays = camera.rays(camera.pixel_grid())
    cosine = rays[..., 2]
    has_depth &= cosine > _LEAST_COSINE
    distance = depth[has_depth].astype(np.float64) / cosine[has_depth]
    is_far = np.abs(points[has_depth]).max(axis=-1, initial=0.0) > _FAR * distance
    ahead = rotate(world_from_cam, rays[has_depth])
    from_depth = centre + distance[:, None] * ahead
    points[has_depth] = np.where(is_far[:, None], from_depth, points[has_depth])
    return points


def points_from_depth(
    camera: Camera, world_from_cam: Float, depth: NDArray[Any]
) -> Float:
    """The points (H, W, 3), float64, of a view by its depth (H, W) alone; +inf where that is unknown.

    centre + depth / cosine * ray, so for rays of nearly 90 degrees from the axis less exact than a stored position.
    """
    points = np.full((*depth.shape, 3), np.inf)
    has_depth = np.isfinite(depth)
    rays = camera.rays(camera.pixel_grid())[has_depth]
    distance = depth[has_depth].astype(np.float64) / rays[:, 2]
    ahead = rotate(world_from_cam, rays)
    points[has_depth] = world_from_cam[:3, 3] + distance[:, None] * ahead
    return points


def rounding_scale(world: Float, *centres: Float) -> Float:
    """The magnitude (N,), metres, that sets the rounding of `world_points` (N, 3) seen from camera centres (3,).

    That of the coordinates, or of the distances where the points are from depth.
    """
    coordinates = np.abs(world).sum(axis=-1)
    distances = np.zeros(len(world))
    for centre in centres:
        coordinates = coordinates + np.abs(centre).sum()
        distances = distances + np.linalg.norm(world - centre, axis=-1)
    return np.asarray(np.minimum(coordinates, 3 * _FAR * distances))
