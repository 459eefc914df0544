"""Rough ground: soil, gravel and crumpled cloth as a surface with dents below a flat sheet, on which things stand."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import map_coordinates

from twinlens.families.draws import Rng, log_uniform
from twinlens.families.patterns import texture_seed
from twinlens.families.surfaces import Sheet
from twinlens.geometry import Float
from twinlens.scenes import shapes, textures
from twinlens.scenes.scene import Mesh

CELLS = 150  # along each side of a sheet, as near to each other as its texels are
_TEXELS, _LUMPS, _OCTAVES = 256, 24, 4
_EDGE = 0.04  # metres, over which the dents end towards the edges of the sheet

Dents = Callable[[Float, Float], Float]
"""How far (rows, columns) a surface is below its sheet at x (columns,) and y (rows,) metres along its sides."""


def draw_front(rng: Rng, sheet: Sheet, depths: tuple[float, float]) -> Mesh:
    """The front of a sheet with random dents, whose largest depth is in this range, metres."""
    depth = log_uniform(rng, *depths)
    tile = rng.uniform(20, 45) * depth
    return rough_front(sheet, draw_dents(rng, depth, tile))


def draw_dents(rng: Rng, depth: float, tile: float) -> Dents:
    """Dents of at most `depth` metres; their pattern repeats after `tile` metres, with 24 lumps along it."""
    noise = textures.fractal_noise(
        _TEXELS, _TEXELS, (_LUMPS, _LUMPS), texture_seed(rng), _OCTAVES, 0.6, 1.5
    )
    highest = float(noise.max())

    def dents(x: Float, y: Float) -> Float:
        rows, columns = np.meshgrid(y / tile, x / tile, indexing="ij")
        places = np.stack([rows, columns]) * _TEXELS
        values = map_coordinates(noise, places, order=1, mode="grid-wrap")
        return np.asarray(depth * (highest - values), dtype=np.float64)

    return dents


def rough_front(sheet: Sheet, dents: Dents) -> Mesh:
    """The front of a sheet with dents, (CELLS + 1)^2 vertices; (u, v) are those of the sheet."""
    share = np.linspace(0, 1, CELLS + 1)
    s = np.interp(share, sheet.across.uv, sheet.across.at)
    t = np.interp(share, sheet.along.uv, sheet.along.at)
    wide, high = sheet.lengths
    x, y = s * wide, t * high
    fade = np.outer(_fade(y, high), _fade(x, wide))
    depth = dents(x, y) * fade
    flat = sheet.corner + s[:, None] * sheet.u + t[:, None, None] * sheet.v
    points = flat - depth[..., None] * sheet.normal

    # The surface n = -depth(x, y) has the tangents u - depth_x n and v - depth_y n.
    depth_y = np.asarray(np.gradient(depth, y, axis=0))
    depth_x = np.asarray(np.gradient(depth, x, axis=1))
    slope = depth_x[..., None] * sheet.u / wide + depth_y[..., None] * sheet.v / high
    normals = sheet.normal + slope
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    uv = np.stack(np.meshgrid(share, share), axis=-1)
    faces = shapes.grid(CELLS + 1, CELLS + 1)
    return Mesh(points.reshape(-1, 3), faces, normals.reshape(-1, 3), uv.reshape(-1, 2))


def _fade(place: Float, length: float) -> Float:
    """0 at both ends of a side of this length, 1 from `_EDGE` metres on."""
    to_end = np.minimum(place, length - place)
    return np.asarray(np.clip(to_end / _EDGE, 0.0, 1.0))
