"""Large flat surfaces (floors, walls, table tops): patterns baked for the view, finer near the camera than far away.

The renderer has no mipmaps, so each texel is taken from the level of an image pyramid that the size of a pixel on the
surface calls for there: nothing is finer than two pixels where it is seen, near or far. Source: Williams, Pyramidal
Parametrics, SIGGRAPH 1983.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from twinlens.geometry import Float
from twinlens.scenes.families.finishes import material, texels
from twinlens.scenes.families.palettes import Palette, varied
from twinlens.scenes.families.patterns import Image, Rng, noise, pattern
from twinlens.scenes.families.view import View
from twinlens.scenes.scene import Bitmap, Mesh, Plugin

_MOST_TEXELS = 1024
_STEEPEST = 0.25  # cosine: beyond, a surface is seen too flat to be filtered for


@dataclass(frozen=True, eq=False)
class Sheet:
    """A rectangle: a corner (3,), and its two sides (3,) as vectors, at right angles; its front is u x v."""

    corner: Float
    u: Float
    v: Float

    @property
    def lengths(self) -> tuple[float, float]:
        """Of its sides, metres."""
        return float(np.linalg.norm(self.u)), float(np.linalg.norm(self.v))

    @property
    def normal(self) -> Float:
        """Of its front, unit length."""
        n = np.cross(self.u, self.v)
        return np.asarray(n / np.linalg.norm(n))

    def mesh(self, thickness: float = 0.0) -> Mesh:
        """Two triangles, or with a thickness a closed slab behind them; (u, v) as seen from the front everywhere."""
        corners = self.corner + np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) @ np.stack([self.u, self.v])
        square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
        quad = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
        if thickness == 0:
            return Mesh(corners, quad, np.tile(self.normal, (4, 1)), square)
        behind = corners - thickness * self.normal
        rings = [corners, behind[::-1]]
        rings += [np.stack([corners[i], behind[i], behind[i - 3], corners[i - 3]]) for i in range(4)]
        uvs = [square, square[::-1]] + [square[[i, i, i - 3, i - 3]] for i in range(4)]
        faces = np.concatenate([quad + np.uint32(4 * i) for i in range(6)])
        normals = [np.cross(r[1] - r[0], r[2] - r[0]) for r in rings]
        unit = np.concatenate([np.tile(n / np.linalg.norm(n), (4, 1)) for n in normals])
        return Mesh(np.concatenate(rings), faces, unit, np.concatenate(uvs))


def surface(
    rng: Rng,
    sheet: Sheet,
    view: View,
    name: str,
    colors: Float,
    tile: float,
    finish: str = "matte",
    roughness: float = 0.25,
    mottle: float = 0.1,
) -> Plugin:
    """The material of a sheet in a pattern that repeats every `tile` metres, filtered for `view`."""
    near = max(view.pixel(_nearest(sheet, view)), 1e-6)
    image = pattern(name, texels(tile, near, _MOST_TEXELS), rng, colors, mottle)
    baked = bake(image, tile, sheet, view)
    drift = noise(256, rng, 2, octaves=3, contrast=0.5)
    rows, columns = (np.linspace(0, 255, count) for count in baked.shape[:2])
    slow = map_coordinates(drift, np.meshgrid(rows, columns, indexing="ij"), order=1)
    baked = np.clip(baked * (1 + 0.7 * (slow - 0.5))[..., None], 0.005, 0.88).astype(np.float32)
    return material(finish, Bitmap(baked, wrap="clamp"), roughness)


def _nearest(sheet: Sheet, view: View) -> float:
    """A depth about that of the nearest part of the sheet in the picture."""
    depth, inside = _seen(sheet, view, np.linspace(0.02, 0.98, 25), np.linspace(0.02, 0.98, 25))
    chosen = depth[inside] if inside.any() else depth[depth > 0]
    return float(chosen.min()) if chosen.size else 1.0


def _seen(sheet: Sheet, view: View, s: Float, t: Float) -> tuple[Float, Float]:
    """Depth (rows, columns) at the fractions t, s of the sides, and whether the picture shows that point."""
    points = sheet.corner + s[None, :, None] * sheet.u + t[:, None, None] * sheet.v
    cam = (points - view.eye) @ view.world_from_cam[:3, :3]
    depth = cam[..., 2]
    x, y = (np.abs(cam[..., i]) / np.maximum(depth, 1e-9) / view.half[i] for i in range(2))
    return depth, (depth > 1e-6) & (x < 1.05) & (y < 1.05)


def bake(image: Image, tile: float, sheet: Sheet, view: View) -> Image:
    """A periodic image, `tile` metres wide, laid out over a whole sheet at the sharpness each place is seen with."""
    texel = tile / len(image)
    columns, rows = (int(np.clip(math.ceil(length / texel), 8, _MOST_TEXELS)) for length in sheet.lengths)
    s, t = (np.arange(columns) + 0.5) / columns, 1 - (np.arange(rows) + 0.5) / rows
    level = _level(sheet, view, s, t, texel, max(sheet.lengths[0] / columns, sheet.lengths[1] / rows))
    x = s * sheet.lengths[0] / tile
    y = (1 - t) * sheet.lengths[1] / tile
    pyramid = [image]
    while len(pyramid[-1]) > 2:
        p = pyramid[-1]
        pyramid.append(0.25 * (p[::2, ::2] + p[1::2, ::2] + p[::2, 1::2] + p[1::2, 1::2]))
    level = np.clip(level, 0, len(pyramid) - 1.001)
    out = np.zeros((rows, columns, 3), dtype=np.float32)
    for number, picture in enumerate(pyramid):
        weight = np.clip(1 - np.abs(level - number), 0, 1).astype(np.float32)
        row, column = np.nonzero(weight)
        if len(row):
            out[row, column] += weight[row, column, None] * _wrapped(picture, y[row], x[column])
    return out


def _level(sheet: Sheet, view: View, s: Float, t: Float, texel: float, laid: float) -> Float:
    """Pyramid level (rows, columns): log2 of texels a pixel covers there, the long way where it is seen aslant."""
    points = sheet.corner + s[None, :, None] * sheet.u + t[:, None, None] * sheet.v
    away = points - view.eye
    depth = np.maximum(away @ view.world_from_cam[:3, 2], 1e-6)
    cosine = np.abs(away @ sheet.normal) / np.linalg.norm(away, axis=-1)
    pixel = view.pixel(1.0) * depth / np.maximum(cosine, _STEEPEST)
    return np.asarray(np.log2(np.maximum(np.maximum(pixel, laid) / texel, 1.0)))


def _wrapped(picture: Image, y: Float, x: Float) -> Image:
    """Bilinear values (N, 3) of a periodic picture at fractions of its height and width."""
    n = len(picture)
    rows, columns = y * n - 0.5, x * n - 0.5
    i, j = np.floor(rows).astype(int), np.floor(columns).astype(int)
    fy, fx = (rows - i).astype(np.float32)[:, None], (columns - j).astype(np.float32)[:, None]
    i, j, below, right = i % n, j % n, (i + 1) % n, (j + 1) % n
    upper = picture[i, j] * (1 - fx) + picture[i, right] * fx
    lower = picture[below, j] * (1 - fx) + picture[below, right] * fx
    return np.asarray(upper * (1 - fy) + lower * fy)


WALLS = (
    ("cloudy", 1.6), ("cloudy", 1.2), ("weave", 0.5), ("stripes", 0.7), ("bricks", 1.0), ("scales", 0.8), ("dots", 0.8),
    ("tiles", 0.8), ("planks", 1.1), ("granite", 1.0), ("triangles", 1.4), ("zigzag", 0.9),
)  # fmt: skip
TOPS = (
    ("planks", 0.7), ("planks", 0.9), ("wood", 0.6), ("marble", 0.9), ("gingham", 0.35), ("stripes", 0.5), ("weave", 0.3),
    ("chips", 0.5), ("tiles", 0.5), ("granite", 0.5), ("zigzag", 0.6), ("mosaic", 0.5), ("cloudy", 0.8),
)  # fmt: skip
FLOORS = (
    ("planks", 1.1), ("planks", 1.3), ("tiles", 1.6), ("chips", 1.2), ("checks", 1.2), ("granite", 0.8), ("mosaic", 1.2),
    ("marble", 1.6), ("weave", 0.4),
)  # fmt: skip


def wall_colors(rng: Rng, palette: Palette, quiet: float = 0.35) -> Float:
    """Colours of a wall: a ground and others drawn towards it, so that a pattern on it stays behind what stands before.

    Two neighbours differ by at least what a matcher needs to tell places apart.
    """
    ground = varied(rng, palette.grounds[rng.permutation(len(palette.grounds))], 0.06)
    if rng.random() < 0.25:
        ground[0] = 0.75 * varied(rng, palette.accents[rng.permutation(len(palette.accents))][:1], 0.1)[0] + 0.02
    others = np.vstack([ground[1:], palette.accents])
    return np.vstack([ground[:1], ground[0] + (others - ground[0]) * (quiet + 0.15)])
