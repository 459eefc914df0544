"""Many depth maps in one surface: a grid of truncated signed distances, and the triangles where it crosses zero.

Each view says of a cell how far before (+) or behind (-) its surface the cell lies, along its ray; the mean of what all
say, straight looks counting more than slanted ones, is the distance, and its zero the surface. A cell that no view has
within reach is unknown, and no triangle stands in it. Source: Curless and Levoy, A volumetric method for building
complex models from range images, SIGGRAPH 1996; the triangles are scikit-image's (Lewiner's marching cubes).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError, check_number
from twinlens.geometry import Float, inverse, transform_points
from twinlens.reconstruction.surface import Surface
from twinlens.reconstruction.views import DepthView

_MOST_CELLS = 64_000_000
_REACH = 4.0  # cells: the usual truncation
_LEAST = 0.05  # what a pixel counts at the least


@dataclass(frozen=True, eq=False)
class Volume:
    """Distances on a grid: cell (i, j, k) has its centre at ``origin + cell * (i, j, k)``, world metres.

    distance : float32 (X, Y, Z), of the reach, -1 to 1; positive before the surface.
    weight : float32 (X, Y, Z), how much was told: a look straight at the surface counts 1; 0 is unknown.
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
    """The signed distances that `views` tell.

    Parameters
    ----------
    cell : float
        Side of a cell, metres: finer shows more, and keeps more of the depths' noise.
    reach : float
        Metres beyond which distances are cut and nothing is told behind a surface; 4 cells unless said. It must exceed
        the depths' errors and stay below half the thickness of what is reconstructed.
    bounds : (2, 3)
        Lowest and highest corner, world metres; that of all the views' points, and the reach around, unless said.

    Raises InputError without a view or a known depth, for bounds that are none, and for more than 64 million cells.
    """
    check_number("cell", cell, "a positive number of metres", above=0)
    reach = _REACH * cell if reach is None else reach
    check_number("reach", reach, "a number of metres, a cell or more", least=cell)
    low, high = _bounds(views, reach) if bounds is None else _checked_bounds(bounds)
    shape = _shape(high - low, cell)
    colored = all(view.image is not None for view in views)
    distance, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    colors = np.zeros((*shape, 3), np.float32) if colored else None
    volume = Volume(low, cell, reach, distance, weight, colors)
    trusts = [_trust(view) for view in views]
    for i in range(shape[0]):  # a slab at a time, so that memory stays that of the grid
        slab = _slab(volume, i)
        for view, trust in zip(views, trusts, strict=True):
            _tell(view, trust, slab, volume, i)
    return volume


def surface_of(volume: Volume) -> Surface:
    """The zero of the distances as triangles, seen from outside counter-clockwise, with colours where views had them.

    Raises InputError where no surface crosses the grid.
    """
    from skimage.measure import marching_cubes

    known = volume.weight > 0
    told = np.where(known, volume.distance, 1.0).astype(np.float32)
    whole = _whole_cells(known)
    if not (_crossed(told) & whole).any():
        raise InputError("no surface crosses the grid: check the bounds, and that the cells are smaller than the scene")
    vertices, faces, _, _ = marching_cubes(told, 0.0, mask=whole, gradient_direction="descent")
    colors = None if volume.colors is None else _colors_at(volume.colors, vertices)
    return Surface(volume.origin + volume.cell * vertices.astype(np.float64), faces.astype(np.int64), colors)


def _bounds(views: Sequence[DepthView], reach: float) -> tuple[Float, Float]:
    points = [view.positions()[view.known] for view in views]
    if not any(map(len, points)):
        raise InputError("reconstructing needs one view or more with a known depth")
    every = np.concatenate(points)
    return every.min(axis=0) - reach, every.max(axis=0) + reach


def _checked_bounds(bounds: ArrayLike) -> tuple[Float, Float]:
    corners = np.asarray(bounds, dtype=np.float64)
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] < corners[1]).all():
        raise InputError(f"bounds must be the lowest and the highest corner, (2, 3), got {corners.tolist()}")
    return corners[0], corners[1]


def _shape(extent: Float, cell: float) -> tuple[int, int, int]:
    """Cells along each axis. They are counted as floats, since whole numbers of too many would wrap around."""
    with np.errstate(over="ignore"):
        x, y, z = (np.ceil(extent / cell) + 1).tolist()
    if not x * y * z <= _MOST_CELLS:
        count = f"{x:g} x {y:g} x {z:g}"
        raise InputError(f"cells of {cell} m make {count}, more than 64 million: use larger cells or smaller bounds")
    return int(x), int(y), int(z)


def _slab(volume: Volume, i: int) -> Float:
    """World coordinates (Y, Z, 3) of the cells' centres of one slab."""
    _, ny, nz = volume.distance.shape
    j, k = np.mgrid[:ny, :nz]
    return volume.origin + volume.cell * np.stack([np.full_like(j, i), j, k], axis=-1)


def _trust(view: DepthView) -> Float:
    """What a pixel's word counts, (H, W): the cosine at which its ray meets the surface, _LEAST beside what is unknown.

    Views at a slant see distances stretched, and round a limb they take the far side for the near one.
    """
    points = view.positions()
    with np.errstate(invalid="ignore"):
        normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
        ray = view.world_from_cam[:3, 3] - points
        size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(ray, axis=-1)
        cosine = np.abs((normal * ray).sum(axis=-1)) / np.where(size > 0, size, 1.0)
    trust: Float = np.maximum(np.nan_to_num(cosine, nan=0.0), _LEAST)
    return trust


def _tell(view: DepthView, trust: Float, centres: Float, volume: Volume, i: int) -> None:
    """Add what one view says of the slab's cells."""
    cam = transform_points(inverse(view.world_from_cam), centres)
    pixels = view.camera.project(cam)
    inside = view.camera.contains(pixels)
    if not inside.any():
        return
    depth = np.full(inside.shape, np.inf)
    depth[inside] = _depth_at(view, pixels[inside], volume.reach)
    # The difference in depth, as a distance along the ray: cells far off the axis are further apart than their depths.
    away = (depth - cam[..., 2]) * np.linalg.norm(cam, axis=-1) / np.where(inside, cam[..., 2], 1.0)
    told = inside & np.isfinite(depth) & (away >= -volume.reach)
    u, v = np.floor(pixels[told] + 0.5).astype(int).T
    before, word = volume.weight[i][told], trust[v, u]
    after = before + word
    said = np.minimum(away[told] / volume.reach, 1.0)
    volume.distance[i][told] = (volume.distance[i][told] * before + said * word) / after
    if volume.colors is not None and view.image is not None:
        mixed = volume.colors[i][told] * before[:, None] + view.image[v, u] * word[:, None]
        volume.colors[i][told] = mixed / after[:, None]
    volume.weight[i][told] = after


def _depth_at(view: DepthView, pixels: Float, reach: float) -> Float:
    """Depth (N,) at pixels inside the image: bilinear where the four around are one surface, else the nearest one's."""
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


def _crossed(told: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which cubes have corners on both sides of the surface, under the index of their last corner."""
    before = told > 0
    crossed = np.zeros(told.shape, dtype=bool)
    crossed[1:, 1:, 1:] = _of_corners(np.logical_or, before) & _of_corners(np.logical_or, ~before)
    return crossed


def _whole_cells(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which cubes have eight known corners, under the index of the corner that marching cubes asks for: the last."""
    whole = np.zeros_like(known)
    whole[1:, 1:, 1:] = _of_corners(np.logical_and, known)
    return whole


def _of_corners(joined: np.ufunc, flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The flags of every cube's eight corners `joined`, (X - 1, Y - 1, Z - 1)."""
    ends = (slice(None, -1), slice(1, None))
    found: NDArray[np.bool_] = joined.reduce([flags[a, b, c] for a in ends for b in ends for c in ends])
    return found


def _colors_at(colors: NDArray[np.float32], vertices: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colours (V, 3) of the cell nearest to each vertex: both ends of the edge that it lies on are known."""
    i, j, k = np.rint(vertices).astype(int).T
    nearest: NDArray[np.uint8] = np.rint(colors[i, j, k]).clip(0, 255).astype(np.uint8)
    return nearest
