"""Fusion of depth maps into one point cloud, with a consistency check between views and thinning on a grid."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_int, check_number
from twinlens.geometry import Float, inverse, transform_points
from twinlens.reconstruction.surface import Cloud, points_of
from twinlens.reconstruction.views import DepthView


def fuse(
    views: Sequence[DepthView], spacing: float | None = None, min_views: int = 1, tolerance: float = 0.01
) -> Cloud:
    """The points of all views as one cloud.

    Parameters
    ----------
    spacing : float
        Side of a grid's cells, metres: the points in a cell are replaced by their mean, colours too. None keeps all.
    min_views : int
        Views required per point, including its own. Another view counts if its depth at the nearest pixel differs
        from the point's by at most `tolerance`, relative. 1 keeps all points.

    Raises InputError without views, or for more `min_views` than views. Source of the check: Merrell et al., ICCV 2007;
    COLMAP uses the same kind.
    """
    if not views:
        raise InputError("fusing needs at least one view")
    check_int("min_views", min_views, 1, len(views))
    check_number("tolerance", tolerance, "a positive fraction of the depth", above=0)
    clouds = [_consistent_points(views, i, min_views, tolerance) for i in range(len(views))]
    colors = [cloud.colors for cloud in clouds if cloud.colors is not None]
    points = np.concatenate([cloud.points for cloud in clouds])
    whole = Cloud(points, np.concatenate(colors) if len(colors) == len(clouds) else None)
    return whole if spacing is None else thinned(whole, spacing)


def thinned(cloud: Cloud, spacing: float) -> Cloud:
    """The mean point of each occupied cell of a grid `spacing` metres wide."""
    check_number("spacing", spacing, "a positive number of metres", above=0)
    if not len(cloud):
        return cloud
    cells = np.floor(cloud.points / spacing).astype(np.int64)
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    cell = cell.reshape(-1)
    colors = None if cloud.colors is None else np.rint(_means(cloud.colors, cell, count)).astype(np.uint8)
    return Cloud(_means(cloud.points, cell, count), colors)


def _means(values: NDArray[np.generic], cell: NDArray[np.int64], count: NDArray[np.int64]) -> Float:
    sums = [np.bincount(cell, weights=values[:, k].astype(np.float64)) for k in range(values.shape[1])]
    return np.stack(sums, axis=1) / count[:, None]


def _consistent_points(views: Sequence[DepthView], i: int, min_views: int, tolerance: float) -> Cloud:
    cloud = points_of(views[i])
    if min_views == 1:
        return cloud
    votes = np.ones(len(cloud), dtype=int)
    for j, other in enumerate(views):
        if j != i:
            votes += _agrees(other, cloud.points, tolerance)
    keep = votes >= min_views
    return Cloud(cloud.points[keep], None if cloud.colors is None else cloud.colors[keep])


def _agrees(view: DepthView, points: Float, tolerance: float) -> NDArray[np.bool_]:
    """Whether the view's depth at the nearest pixel agrees with each point (N,)."""
    cam = transform_points(inverse(view.world_from_cam), points)
    pixels = view.camera.project(cam)
    inside = view.camera.contains(pixels)
    u, v = np.floor(np.where(inside[:, None], pixels, 0.0) + 0.5).astype(int).T
    agrees: NDArray[np.bool_] = inside & (np.abs(view.depth[v, u] - cam[:, 2]) <= tolerance * cam[:, 2])
    return agrees
