"""Fusion of many depth maps: into one point cloud, and into one surface by a truncated signed distance function (TSDF).

The TSDF of a cell is the distance along the viewing ray to the view's surface, positive in front: the mean over the
views, weighted by the cosine of incidence (Curless and Levoy, A volumetric method for building complex models from
range images, SIGGRAPH 1996). Points are checked for consistency after Merrell et al., ICCV 2007.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from twinlens.errors import InputError, check_int, check_number
from twinlens.geometry import Float, inverse, transform_points
from twinlens.reconstruction.surface import Cloud, DepthView, Surface, points_of

_MOST_CELLS = 64_000_000
_REACH = 4.0  # cells
_MIN_WEIGHT = 0.05


def fuse(
    views: Sequence[DepthView],
    spacing: float | None = None,
    min_views: int = 1,
    tolerance: float = 0.01,
) -> Cloud:
    """The points of all views as one cloud, `thinned` if a `spacing` (metres) is given.

    min_views : views required per point, including its own. Another view counts if its depth at the nearest pixel
    differs from the point's by at most `tolerance`, relative. Raises InputError for fewer views than that.
    """
    if not views:
        raise InputError("fusing needs at least one view")
    check_int("min_views", min_views, 1, len(views))
    check_number("tolerance", tolerance, "a positive fraction of the depth", above=0)
    points, colors = [], []
    for i, view in enumerate(views):
        cloud = points_of(view)
        agreeing = np.ones(len(cloud), int)
        if min_views > 1:
            for partner in (*views[:i], *views[i + 1 :]):
                agreeing += _agrees(partner, cloud.points, tolerance)
        confirmed = agreeing >= min_views
        points.append(cloud.points[confirmed])
        if cloud.colors is not None:
            colors.append(cloud.colors[confirmed])
    has_colors = len(colors) == len(views)
    fused = Cloud(
        np.concatenate(points), np.concatenate(colors) if has_colors else None
    )
    return fused if spacing is None else thinned(fused, spacing)


def thinned(cloud: Cloud, spacing: float) -> Cloud:
    """The mean point, and mean colour, of each occupied cell of a grid `spacing` metres wide."""
    check_number("spacing", spacing, "a positive number of metres", above=0)
    if not len(cloud):
        return cloud
    cells = np.floor(cloud.points / spacing).astype(np.int64)
    occupied, cell = np.unique(cells, axis=0, return_inverse=True)
    labels = np.arange(len(occupied))

    def cell_means(values: NDArray[Any]) -> Float:
        columns = [ndimage.mean(column, cell.ravel(), labels) for column in values.T]
        return np.stack(columns, axis=1)

    if cloud.colors is None:
        return Cloud(cell_means(cloud.points))
    colors = np.rint(cell_means(cloud.colors.astype(np.float64))).astype(np.uint8)
    return Cloud(cell_means(cloud.points), colors)


@dataclass(frozen=True, eq=False)
class Volume:
    """A TSDF: cell (i, j, k) has its centre at ``origin + cell * (i, j, k)``, world metres.

    distance : float32 (X, Y, Z), relative to the reach, -1 to 1; positive in front of the surface.
    weight : float32 (X, Y, Z), sum of the views' weights; 0 where unknown.
    colors : float32 (X, Y, Z, 3), 0 to 255, or None.
    """

    origin: Float
    cell: float
    reach: float
    distance: NDArray[np.float32]
    weight: NDArray[np.float32]
    colors: NDArray[np.float32] | None


def integrate(
    views: Sequence[DepthView],
    cell: float,
    reach: float | None = None,
    bounds: ArrayLike | None = None,
) -> Volume:
    """The TSDF of `views`.

    cell : side of a cell, metres. Smaller cells show more detail and more noise.
    reach : truncation distance, metres; more than the depth errors, less than half the object's thickness.
    bounds : (2, 3), lowest and highest corner, world metres; by default those of all points, extended by the reach.

    Raises InputError without a known depth, for invalid bounds, and for more than 64 million cells.
    """
    check_number("cell", cell, "a positive number of metres", above=0)
    reach = _REACH * cell if reach is None else reach
    check_number("reach", reach, "a number of metres, one cell or more", least=cell)
    if bounds is None:
        bounds = _bounds_of(views, reach)
    corners = _checked_corners(bounds)
    has_colors = all(view.image is not None for view in views)
    volume = _empty_volume(corners, cell, reach, has_colors)
    weighted = [(view, _pixel_weights(view)) for view in views]
    slabs, rows, columns = volume.weight.shape
    j, k = np.mgrid[:rows, :columns]
    for i in range(slabs):  # one slab at a time bounds the memory
        centres = volume.origin + cell * np.stack([np.full_like(j, i), j, k], axis=-1)
        for view, weights in weighted:
            _add_view(view, weights, centres, volume, i)
    return volume


def _checked_corners(bounds: ArrayLike) -> Float:
    """Bounds in float64 (2, 3). Raises InputError."""
    corners = np.asarray(bounds, dtype=np.float64)
    has_two_corners = corners.shape == (2, 3) and np.isfinite(corners).all()
    if not has_two_corners or not (corners[0] < corners[1]).all():
        raise InputError(
            f"bounds must be the lowest and highest corner, (2, 3), got {corners.tolist()}"
        )
    return corners


def _bounds_of(views: Sequence[DepthView], margin: float) -> tuple[Float, Float]:
    """The lowest and highest corner of all points, extended by a margin, metres."""
    clouds = [points_of(view).points for view in views]
    points = np.vstack([np.empty((0, 3)), *clouds])
    if not len(points):
        raise InputError("integrating needs at least one view with a known depth")
    return points.min(axis=0) - margin, points.max(axis=0) + margin


def _empty_volume(
    corners: Float, cell: float, reach: float, has_colors: bool
) -> Volume:
    low, high = corners
    with np.errstate(over="ignore"):
        sides = (np.ceil((high - low) / cell) + 1).tolist()
    if not math.prod(sides) <= _MOST_CELLS:
        count = " x ".join(f"{side:g}" for side in sides)
        raise InputError(
            f"cells of {cell} m make {count}, more than 64 million: use larger cells or smaller bounds"
        )
    shape = tuple(int(side) for side in sides)
    return Volume(
        low,
        cell,
        reach,
        distance=np.zeros(shape, np.float32),
        weight=np.zeros(shape, np.float32),
        colors=np.zeros((*shape, 3), np.float32) if has_colors else None,
    )


def surface_of(volume: Volume) -> Surface:
    """The zero crossing as triangles, counter-clockwise seen from outside, with colours if all views have images.

    Marching cubes by scikit-image (Lewiner). There are no triangles at unknown cells. Raises InputError without any.
    """
    from skimage.measure import marching_cubes

    is_known = volume.weight > 0
    distance = np.where(is_known, volume.distance, np.float32(1.0))
    # Flags of a cube: those of a cell and of the seven before it. Marching cubes takes masks at the last corner.
    cube = np.ones((2, 2, 2))
    known_cubes = ndimage.binary_erosion(is_known, cube)
    outside = ndimage.binary_erosion(distance > 0, cube)
    inside = ndimage.binary_erosion(distance <= 0, cube)
    if not (known_cubes & ~outside & ~inside).any():
        raise InputError(
            "no surface crosses the grid: check the bounds, and that the cells are smaller than the scene"
        )
    vertices, faces, _, _ = marching_cubes(
        distance, 0.0, mask=known_cubes, gradient_direction="descent"
    )
    colors = None
    if volume.colors is not None:
        i, j, k = np.rint(vertices).astype(int).T  # the nearest cells
        colors = np.rint(volume.colors[i, j, k]).clip(0, 255).astype(np.uint8)
    positions = volume.origin + volume.cell * vertices.astype(np.float64)
    return Surface(positions, faces.astype(np.int64), colors)


def _agrees(view: DepthView, points: Float, tolerance: float) -> NDArray[np.bool_]:
    """Whether the view's depth at the nearest pixel agrees with each point (N,)."""
    cam = transform_points(inverse(view.world_from_cam), points)
    pixels = view.camera.project(cam)
    inside = view.camera.contains(pixels)
    u, v = np.floor(np.where(inside[:, None], pixels, 0.0) + 0.5).astype(int).T
    depth = cam[:, 2]
    difference = np.abs(view.depth[v, u] - depth)
    return np.asarray(inside & (difference <= tolerance * depth))


def _pixel_weights(view: DepthView) -> Float:
    """Weight of each pixel (H, W): the cosine between its ray and the surface normal, at least `_MIN_WEIGHT`."""
    points = view.positions()
    # Positions are +inf where the depth is unknown, and inf - inf is NaN.
    with np.errstate(invalid="ignore"):
        # Differences along u and v are two tangents of the surface.
        normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
        ray = view.world_from_cam[:3, 3] - points
        size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(ray, axis=-1)
        cosine = np.abs((normal * ray).sum(axis=-1)) / np.where(size > 0, size, 1.0)
    return np.asarray(np.maximum(np.nan_to_num(cosine, nan=0.0), _MIN_WEIGHT))


def _add_view(
    view: DepthView, pixel_weights: Float, centres: Float, volume: Volume, i: int
) -> None:
    """Add one view to the cells of slab i, with centres (Y, Z, 3).

    With the truncated distance d and the weight w of the view, D <- (W D + w d) / (W + w) and W <- W + w. Source:
    Curless and Levoy, A volumetric method for building complex models from range images, SIGGRAPH 1996, section 3.
    """
    cam = transform_points(inverse(view.world_from_cam), centres)
    pixels = view.camera.project(cam)
    inside = view.camera.contains(pixels)
    if not inside.any():
        return
    depth = np.full(inside.shape, np.inf)
    depth[inside] = _depth_at(view, pixels[inside], volume.reach)
    # The distance along the ray from the cell to the surface: depths are along the axis.
    ray_distance = np.linalg.norm(cam, axis=-1)
    per_depth = ray_distance / np.where(inside, cam[..., 2], 1.0)
    away = (depth - cam[..., 2]) * per_depth
    # Cells farther behind the surface than the reach are hidden: this view says nothing about them.
    observed = inside & np.isfinite(depth) & (away >= -volume.reach)
    u, v = np.floor(pixels[observed] + 0.5).astype(int).T
    weight_before, weight = volume.weight[i][observed], pixel_weights[v, u]
    weight_after = weight_before + weight

    def running_mean(mean: NDArray[Any], values: NDArray[Any]) -> Any:
        shape = (-1,) + (1,) * (mean.ndim - 1)
        before, new = weight_before.reshape(shape), weight.reshape(shape)
        return (mean * before + values * new) / weight_after.reshape(shape)

    truncated = np.minimum(away[observed] / volume.reach, 1.0)
    volume.distance[i][observed] = running_mean(volume.distance[i][observed], truncated)
    if volume.colors is not None and view.image is not None:
        colors = volume.colors[i]
        colors[observed] = running_mean(colors[observed], view.image[v, u])
    volume.weight[i][observed] = weight_after


def _depth_at(view: DepthView, pixels: Float, reach: float) -> Float:
    """Depth (N,) at pixels: bilinear where the four neighbours differ by at most `reach`, otherwise the nearest."""
    height, width = view.depth.shape
    u, v = pixels.clip(0, (width - 1, height - 1)).T
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    x, y = u - left, v - top  # of the pixel between its neighbours, 0 to 1
    depth = view.depth
    above = depth[top, left], depth[top, right]
    below = depth[bottom, left], depth[bottom, right]
    corners = np.stack([*above, *below])
    shares = np.stack([(1 - y) * (1 - x), (1 - y) * x, y * (1 - x), y * x])
    # The neighbour with the largest share is the nearest pixel.
    nearest = np.take_along_axis(corners, shares.argmax(axis=0)[None], axis=0)[0]
    with np.errstate(invalid="ignore"):  # inf - inf
        smooth = np.ptp(corners, axis=0) <= reach
    bilinear = (np.where(smooth, corners, 0.0) * shares).sum(axis=0)
    return np.asarray(np.where(smooth, bilinear, nearest))
