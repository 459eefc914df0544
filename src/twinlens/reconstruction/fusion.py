"""Many views' depth maps in one cloud: points that other views confirm, one to a cell."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_number
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
        Metres: points that share a cell of a grid of this side become their mean, colours too. None keeps all.
    min_views : int
        How many views, its own counted, must have a point's depth: another view does when its own depth, at the pixel
        nearest to the point, is within `tolerance` of the point's, relative. 1 keeps all.

    Raises InputError without views, or for more `min_views` than there are. Source: of the test, Merrell et al., ICCV
    2007; it is what COLMAP and others ask of their fused points.
    """
    if not views:
        raise InputError("fusing needs one view or more")
    if isinstance(min_views, bool) or not isinstance(min_views, int) or not 1 <= min_views <= len(views):
        raise InputError(f"min_views must be a whole number from 1 to {len(views)}, got {min_views!r}")
    check_number("tolerance", tolerance, "a positive part of the depth", above=0)
    clouds = [_confirmed(views, i, min_views, tolerance) for i in range(len(views))]
    whole = joined(clouds)
    return whole if spacing is None else thinned(whole, spacing)


def joined(clouds: Sequence[Cloud]) -> Cloud:
    """Several clouds as one; it has colours when all have."""
    colors = [cloud.colors for cloud in clouds if cloud.colors is not None]
    points = np.concatenate([cloud.points for cloud in clouds])
    return Cloud(points, np.concatenate(colors) if len(colors) == len(clouds) else None)


def thinned(cloud: Cloud, spacing: float) -> Cloud:
    """One point, the mean, for each cell of a grid `spacing` metres wide that has any: no place counts for more."""
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


def _confirmed(views: Sequence[DepthView], i: int, min_views: int, tolerance: float) -> Cloud:
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
    """Whether the view has each point's depth at the pixel nearest to it."""
    cam = transform_points(inverse(view.world_from_cam), points)
    pixels = view.camera.project(cam)
    inside = view.camera.contains(pixels)
    u, v = np.floor(np.where(inside[:, None], pixels, 0.0) + 0.5).astype(int).T
    agrees: NDArray[np.bool_] = inside & (np.abs(view.depth[v, u] - cam[:, 2]) <= tolerance * cam[:, 2])
    return agrees
