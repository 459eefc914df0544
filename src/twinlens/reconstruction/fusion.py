"""Fusion of many depth maps: into one point cloud, and into one surface by a truncated signed distance function (TSDF).

Each view gives a cell of the TSDF the distance along the viewing ray from the cell to the view's surface, positive in
front. The TSDF is the mean over the views, weighted by the cosine of incidence; the surface is its zero crossing. Cells
that no view reaches are unknown and get no triangles.

Sources: Merrell et al., ICCV 2007, for the consistency check of points, which COLMAP uses as well; Curless and Levoy, A
volumetric method for building complex models from range images, SIGGRAPH 1996. Triangles by scikit-image (Lewiner's
marching cubes).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError, check_int, check_number
from twinlens.geometry import Float, inverse, transform_points
from twinlens.reconstruction.surface import Cloud, Surface, points_of
from twinlens.reconstruction.views import DepthView

_MOST_CELLS = 64_000_000
_REACH = 4.0  # cells
_MIN_WEIGHT = 0.05


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

    Raises InputError without views, or for more `min_views` than views.
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
    views: Sequence[DepthView], cell: float, reach: float | None = None, bounds: ArrayLike | None = None
) -> Volume:
    """The TSDF of `views`.

    Parameters
    ----------
    cell : float
        Side of a cell, metres. Smaller cells show more detail and more noise.
    reach : float
        Truncation distance, metres; 4 cells by default. It must exceed the depth errors and be less than half the
        thickness of the object.
    bounds : (2, 3)
        Lowest and highest corner, world metres; by default those of all points of the views, extended by the reach.

    Raises InputError without a known depth, for invalid bounds, and for more than 64 million cells.
    """
    check_number("cell", cell, "a positive number of metres", above=0)
    reach = _REACH * cell if reach is None else reach
    check_number("reach", reach, "a number of metres, one cell or more", least=cell)
    low, high = _bounds(views, reach) if bounds is None else _checked_bounds(bounds)
    shape = _shape(high - low, cell)
    colored = all(view.image is not None for view in views)
    distance, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    colors = np.zeros((*shape, 3), np.float32) if colored else None
    volume = Volume(low, cell, reach, distance, weight, colors)
    weights = [_pixel_weights(view) for view in views]
    j, k = np.mgrid[: shape[1], : shape[2]]
    for i in range(shape[0]):  # one slab at a time bounds the memory
        centres = low + cell * np.stack([np.full_like(j, i), j, k], axis=-1)
        for view, pixel_weights in zip(views, weights, strict=True):
            _add_view(view, pixel_weights, centres, volume, i)
    return volume


def surface_of(volume: Volume) -> Surface:
    """The zero crossing as triangles, counter-clockwise seen from outside, with colours if all views have images.

    Raises InputError if there is none.
    """
    from skimage.measure import marching_cubes

    known = volume.weight > 0
    distance = np.where(known, volume.distance, 1.0).astype(np.float32)
    known_cubes = _all_corners(known)
    crossed = ~_all_corners(distance > 0) & ~_all_corners(distance <= 0)
    if not (crossed & known_cubes).any():
        raise InputError("no surface crosses the grid: check the bounds, and that the cells are smaller than the scene")
    vertices, faces, _, _ = marching_cubes(distance, 0.0, mask=known_cubes, gradient_direction="descent")
    colors = None if volume.colors is None else _colors_at(volume.colors, vertices)
    return Surface(volume.origin + volume.cell * vertices.astype(np.float64), faces.astype(np.int64), colors)


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


def _bounds(views: Sequence[DepthView], reach: float) -> tuple[Float, Float]:
    points = [view.positions()[view.known] for view in views]
    if not any(map(len, points)):
        raise InputError("integrating needs at least one view with a known depth")
    every = np.concatenate(points)
    return every.min(axis=0) - reach, every.max(axis=0) + reach


def _checked_bounds(bounds: ArrayLike) -> tuple[Float, Float]:
    corners = np.asarray(bounds, dtype=np.float64)
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] < corners[1]).all():
        raise InputError(f"bounds must be the lowest and highest corner, (2, 3), got {corners.tolist()}")
    return corners[0], corners[1]


def _shape(extent: Float, cell: float) -> tuple[int, int, int]:
    """Cells along each axis, counted as floats because integers would overflow."""
    with np.errstate(over="ignore"):
        x, y, z = (np.ceil(extent / cell) + 1).tolist()
    if not x * y * z <= _MOST_CELLS:
        count = f"{x:g} x {y:g} x {z:g}"
        raise InputError(f"cells of {cell} m make {count}, more than 64 million: use larger cells or smaller bounds")
    return int(x), int(y), int(z)


def _pixel_weights(view: DepthView) -> Float:
    """Weight of each pixel (H, W): the cosine between its ray and the surface normal, at least `_MIN_WEIGHT`.

    At grazing incidence the distance along the ray exceeds the distance to the surface.
    """
    points = view.positions()
    with np.errstate(invalid="ignore"):
        normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
        ray = view.world_from_cam[:3, 3] - points
        size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(ray, axis=-1)
        cosine = np.abs((normal * ray).sum(axis=-1)) / np.where(size > 0, size, 1.0)
    weights: Float = np.maximum(np.nan_to_num(cosine, nan=0.0), _MIN_WEIGHT)
    return weights


def _add_view(view: DepthView, pixel_weights: Float, centres: Float, volume: Volume, i: int) -> None:
    """Add one view to the cells of slab i, with centres (Y, Z, 3)."""
    cam = transform_points(inverse(view.world_from_cam), centres)
    pixels = view.camera.project(cam)
    inside = view.camera.contains(pixels)
    if not inside.any():
        return
    depth = np.full(inside.shape, np.inf)
    depth[inside] = _depth_at(view, pixels[inside], volume.reach)
    # The difference of depths, as a distance along the ray.
    away = (depth - cam[..., 2]) * np.linalg.norm(cam, axis=-1) / np.where(inside, cam[..., 2], 1.0)
    seen = inside & np.isfinite(depth) & (away >= -volume.reach)
    u, v = np.floor(pixels[seen] + 0.5).astype(int).T
    before, weight = volume.weight[i][seen], pixel_weights[v, u]
    after = before + weight
    truncated = np.minimum(away[seen] / volume.reach, 1.0)
    volume.distance[i][seen] = (volume.distance[i][seen] * before + truncated * weight) / after
    if volume.colors is not None and view.image is not None:
        mixed = volume.colors[i][seen] * before[:, None] + view.image[v, u] * weight[:, None]
        volume.colors[i][seen] = mixed / after[:, None]
    volume.weight[i][seen] = after


def _depth_at(view: DepthView, pixels: Float, reach: float) -> Float:
    """Depth (N,) at pixels: bilinear where the four neighbours differ by at most `reach`, otherwise the nearest."""
    height, width = view.depth.shape
    u, v = pixels.clip(0, (width - 1, height - 1)).T
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    columns, rows = (left, np.minimum(left + 1, width - 1)), (top, np.minimum(top + 1, height - 1))
    corners = np.stack([view.depth[row, column] for row in rows for column in columns])
    shares = np.stack([y * x for y in (1 - (v - top), v - top) for x in (1 - (u - left), u - left)])
    nearest: Float = np.take_along_axis(corners, shares.argmax(axis=0)[None], axis=0)[0]
    high = corners.max(axis=0)
    smooth = np.isfinite(high) & (np.where(np.isfinite(high), high, 0.0) - corners.min(axis=0) <= reach)
    between = (np.where(smooth, corners, 0.0) * shares).sum(axis=0)
    return np.where(smooth, between, nearest)


def _all_corners(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether all eight corners of a cube are flagged, at the index of its last corner, as marching cubes expects."""
    ends = (slice(None, -1), slice(1, None))
    whole = np.zeros_like(flags)
    whole[1:, 1:, 1:] = np.logical_and.reduce([flags[a, b, c] for a in ends for b in ends for c in ends])
    return whole


def _colors_at(colors: NDArray[np.float32], vertices: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colours (V, 3) of the cell nearest to each vertex."""
    i, j, k = np.rint(vertices).astype(int).T
    nearest: NDArray[np.uint8] = np.rint(colors[i, j, k]).clip(0, 255).astype(np.uint8)
    return nearest
