"""Fusion of many depth maps: into one point cloud, and into one surface by a truncated signed distance function (TSDF).

The TSDF of a cell is the distance along the viewing ray to the view's surface, positive in front: the mean over the
views, weighted by the cosine of incidence (Curless and Levoy, A volumetric method for building complex models from
range images, SIGGRAPH 1996). Points are checked for consistency after Merrell et al., ICCV 2007.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

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
        others = (*views[:i], *views[i + 1 :]) if min_views > 1 else ()
        cloud = points_of(view)
        agree = sum(
            (_agrees(other, cloud.points, tolerance).astype(int) for other in others),
            np.ones(len(cloud), int),
        )
        points.append(cloud.points[agree >= min_views])
        if cloud.colors is not None:
            colors.append(cloud.colors[agree >= min_views])
    whole = Cloud(
        np.concatenate(points),
        np.concatenate(colors) if len(colors) == len(views) else None,
    )
    return whole if spacing is None else thinned(whole, spacing)


def thinned(cloud: Cloud, spacing: float) -> Cloud:
    """The mean point, and mean colour, of each occupied cell of a grid `spacing` metres wide."""
    check_number("spacing", spacing, "a positive number of metres", above=0)
    if not len(cloud):
        return cloud
    cell = np.unique(
        np.floor(cloud.points / spacing).astype(np.int64), axis=0, return_inverse=True
    )[1].reshape(-1)
    values = (
        cloud.points
        if cloud.colors is None
        else np.hstack([cloud.points, cloud.colors])
    )
    means = np.stack(
        [ndimage.mean(each, cell, np.arange(cell.max() + 1)) for each in values.T],
        axis=1,
    )
    return Cloud(
        means[:, :3],
        None if cloud.colors is None else np.rint(means[:, 3:]).astype(np.uint8),
    )


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
        points = np.vstack(
            [np.empty((0, 3)), *(points_of(view).points for view in views)]
        )
        if not len(points):
            raise InputError("integrating needs at least one view with a known depth")
        bounds = points.min(axis=0) - reach, points.max(axis=0) + reach
    corners = np.asarray(bounds, dtype=np.float64)
    if (
        corners.shape != (2, 3)
        or not np.isfinite(corners).all()
        or not (corners[0] < corners[1]).all()
    ):
        raise InputError(
            f"bounds must be the lowest and highest corner, (2, 3), got {corners.tolist()}"
        )
    low = corners[0]
    with np.errstate(over="ignore"):
        shape = (np.ceil((corners[1] - low) / cell) + 1).tolist()
    if not math.prod(shape) <= _MOST_CELLS:
        count = " x ".join(f"{side:g}" for side in shape)
        raise InputError(
            f"cells of {cell} m make {count}, more than 64 million: use larger cells or smaller bounds"
        )
    shape = [int(side) for side in shape]
    colors = (
        np.zeros((*shape, 3), np.float32)
        if all(view.image is not None for view in views)
        else None
    )
    volume = Volume(
        low,
        cell,
        reach,
        np.zeros(shape, np.float32),
        np.zeros(shape, np.float32),
        colors,
    )
    weighted = [(view, _pixel_weights(view)) for view in views]
    j, k = np.mgrid[: shape[1], : shape[2]]
    for i in range(shape[0]):  # one slab at a time bounds the memory
        centres = low + cell * np.stack([np.full_like(j, i), j, k], axis=-1)
        for view, weights in weighted:
            _add_view(view, weights, centres, volume, i)
    return volume


def surface_of(volume: Volume) -> Surface:
    """The zero crossing as triangles, counter-clockwise seen from outside, with colours if all views have images.

    Marching cubes by scikit-image (Lewiner). There are no triangles at unknown cells. Raises InputError without any.
    """
    from skimage.measure import marching_cubes

    distance = np.where(volume.weight > 0, volume.distance, np.float32(1.0))
    cube = np.ones(
        (2, 2, 2)
    )  # of a cell and the seven before it; marching cubes takes masks at the last corner
    known_cubes, outside, inside = (
        ndimage.binary_erosion(flags, cube)
        for flags in (volume.weight > 0, distance > 0, distance <= 0)
    )
    if not (known_cubes & ~outside & ~inside).any():
        raise InputError(
            "no surface crosses the grid: check the bounds, and that the cells are smaller than the scene"
        )
    vertices, faces, _, _ = marching_cubes(
        distance, 0.0, mask=known_cubes, gradient_direction="descent"
    )
    colors = None
    if volume.colors is not None:  # of the nearest cell
        colors = (
            np.rint(volume.colors[tuple(np.rint(vertices).astype(int).T)])
            .clip(0, 255)
            .astype(np.uint8)
        )
    return Surface(
        volume.origin + volume.cell * vertices.astype(np.float64),
        faces.astype(np.int64),
        colors,
    )


def _agrees(view: DepthView, points: Float, tolerance: float) -> NDArray[np.bool_]:
    """Whether the view's depth at the nearest pixel agrees with each point (N,)."""
    cam = transform_points(inverse(view.world_from_cam), points)
    pixels = view.camera.project(cam)
    inside = view.camera.contains(pixels)
    u, v = np.floor(np.where(inside[:, None], pixels, 0.0) + 0.5).astype(int).T
    return np.asarray(
        inside & (np.abs(view.depth[v, u] - cam[:, 2]) <= tolerance * cam[:, 2])
    )


def _pixel_weights(view: DepthView) -> Float:
    """Weight of each pixel (H, W): the cosine between its ray and the surface normal, at least `_MIN_WEIGHT`."""
    points = view.positions()
    with np.errstate(invalid="ignore"):
        normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
        ray = view.world_from_cam[:3, 3] - points
        size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(ray, axis=-1)
        cosine = np.abs((normal * ray).sum(axis=-1)) / np.where(size > 0, size, 1.0)
    return np.asarray(np.maximum(np.nan_to_num(cosine, nan=0.0), _MIN_WEIGHT))


def _add_view(
    view: DepthView, pixel_weights: Float, centres: Float, volume: Volume, i: int
) -> None:
    """Add one view to the cells of slab i, with centres (Y, Z, 3)."""
    cam = transform_points(inverse(view.world_from_cam), centres)
    pixels = view.camera.project(cam)
    inside = view.camera.contains(pixels)
    if not inside.any():
        return
    depth = np.full(inside.shape, np.inf)
    depth[inside] = _depth_at(view, pixels[inside], volume.reach)
    # The difference of depths, as a distance along the ray.
    away = (
        (depth - cam[..., 2])
        * np.linalg.norm(cam, axis=-1)
        / np.where(inside, cam[..., 2], 1.0)
    )
    seen = inside & np.isfinite(depth) & (away >= -volume.reach)
    u, v = np.floor(pixels[seen] + 0.5).astype(int).T
    before, weight = volume.weight[i][seen], pixel_weights[v, u]
    after = before + weight
    truncated = np.minimum(away[seen] / volume.reach, 1.0)
    volume.distance[i][seen] = (
        volume.distance[i][seen] * before + truncated * weight
    ) / after
    if volume.colors is not None and view.image is not None:
        mixed = (
            volume.colors[i][seen] * before[:, None]
            + view.image[v, u] * weight[:, None]
        )
        volume.colors[i][seen] = mixed / after[:, None]
    volume.weight[i][seen] = after


def _depth_at(view: DepthView, pixels: Float, reach: float) -> Float:
    """Depth (N,) at pixels: bilinear where the four neighbours differ by at most `reach`, otherwise the nearest."""
    height, width = view.depth.shape
    u, v = pixels.clip(0, (width - 1, height - 1)).T
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    columns, rows = (
        (left, np.minimum(left + 1, width - 1)),
        (top, np.minimum(top + 1, height - 1)),
    )
    corners = np.stack([view.depth[row, column] for row in rows for column in columns])
    shares = np.stack(
        [y * x for y in (1 - (v - top), v - top) for x in (1 - (u - left), u - left)]
    )
    nearest = np.take_along_axis(corners, shares.argmax(axis=0)[None], axis=0)[0]
    with np.errstate(invalid="ignore"):  # inf - inf
        smooth = np.ptp(corners, axis=0) <= reach
    return np.asarray(
        np.where(smooth, (np.where(smooth, corners, 0.0) * shares).sum(axis=0), nearest)
    )
