"""Large flat surfaces (floors, walls, table tops): patterns baked for the view, finer near the camera than far away.

The renderer has no mipmaps. Each texel is therefore taken from the level of an image pyramid that matches the size of a
pixel there, so no visible detail is finer than two pixels. Source: Williams, Pyramidal Parametrics, SIGGRAPH 1983.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.families.composition import Composition, Viewpoint
from twinlens.families.draws import Palette, Rng, one_of, varied
from twinlens.families.materials import material, texels
from twinlens.families.patterns import half_size, pattern, texture_seed
from twinlens.geometry import Float
from twinlens.scenes import shapes, textures
from twinlens.scenes.materials import Bitmap, Material
from twinlens.scenes.scene import Mesh
from twinlens.scenes.textures import Image

Mask = NDArray[np.bool_]
_MAX_TEXELS = 2048
_BLOCK = 4  # texels, rows and columns, that share a value outside the picture
_BEYOND = 1.4  # half widths of the picture: what the right camera may see of a surface
_MIN_COSINE = 0.25  # views at a smaller one are filtered like this one
_SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


@dataclass(frozen=True, eq=False)
class Sheet:
    """A rectangle: a corner (3,) and two perpendicular sides (3,) as vectors; its front is u x v."""

    corner: Float
    u: Float
    v: Float

    @property
    def lengths(self) -> tuple[float, float]:
        return float(np.linalg.norm(self.u)), float(np.linalg.norm(self.v))

    @property
    def normal(self) -> Float:
        n = np.cross(self.u, self.v)
        return np.asarray(n / np.linalg.norm(n))

    def mesh(self, thickness: float = 0.0) -> Mesh:
        """Two triangles or, with a thickness, a closed slab behind them; (u, v) are those of the front."""
        corners = self.corner + _SQUARE @ np.stack([self.u, self.v])
        if thickness == 0:
            return Mesh(corners, QUAD, np.tile(self.normal, (4, 1)), _SQUARE)
        behind = corners - thickness * self.normal
        sides = []
        for i in range(4):
            # From corner i to the next one, which is number i - 3.
            edge = [corners[i], behind[i], behind[i - 3], corners[i - 3]]
            sides.append(quad(np.stack(edge), _SQUARE[[i, i, i - 3, i - 3]]))
        front, back = quad(corners, _SQUARE), quad(behind[::-1], _SQUARE[::-1])
        return shapes.merged([front, back, *sides])


def quad(corners: Float, uv: Float) -> Mesh:
    """A flat quadrilateral of corners (4, 3), counter-clockwise as seen from its front."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    unit = normal / np.linalg.norm(normal)
    return Mesh(corners, QUAD, np.tile(unit, (4, 1)), uv)


def surface(
    scene: Composition,
    rng: Rng,
    sheet: Sheet,
    name: str,
    colors: Float,
    tile: float,
    finish: str = "matte",
) -> Material:
    """The material of a sheet: a pattern that repeats every `tile` metres, filtered for the scene's view."""
    near = _nearest_pixel(sheet, scene.view)
    if name == "cloudy":
        # Clouds of a wall are faint: the other colours are mixed with the first one.
        colors = np.vstack([colors[:1], 0.55 * colors[:1] + 0.45 * colors[1:]])
    image = pattern(name, texels(tile, near, 1024), rng, colors, tile)
    baked = bake(image, tile, sheet, scene.view)

    # Wear: noise that is slow over the whole surface, faint on plain paint.
    height, width = baked.shape[:2]
    seed = texture_seed(rng)
    slow = textures.fractal_noise(width, height, (2, 2), seed, 2, contrast=0.5)
    strength = np.float32(0.05 if name == "plain" else 0.3)
    wear = 1 + strength * (slow - np.float32(0.5))
    worn = np.clip(baked * wear[..., None], 0.005, 0.88)
    kind = "fabric" if name in _CLOTH else finish
    return material(rng, kind, Bitmap(worn, wrap="clamp"))


def _nearest_pixel(sheet: Sheet, view: Viewpoint) -> float:
    """The width in metres of a pixel where the sheet is nearest: in the picture, else anywhere before the camera.

    At 1 m if all of it is behind the camera.
    """
    shares = np.linspace(0.02, 0.98, 25)
    depth, inside = _project(sheet, view, shares, shares)
    chosen = depth[inside] if inside.any() else depth[depth > 0]
    nearest = float(chosen.min()) if chosen.size else 1.0
    return max(view.pixel(nearest), 1e-6)


def _project(
    sheet: Sheet, view: Viewpoint, s: Float, t: Float, reach: float = 1.05
) -> tuple[Float, Mask]:
    """Depth (rows, columns) at fractions t, s of the sides, and whether the point is within `reach` half pictures."""
    points = sheet.corner + s[None, :, None] * sheet.u + t[:, None, None] * sheet.v
    in_cam = (points - view.eye) @ view.world_from_cam[:3, :3]
    depth = in_cam[..., 2]
    # Positions in the picture, 1 at its edges.
    x, y = (
        np.abs(in_cam[..., axis]) / np.maximum(depth, 1e-9) / view.half[axis]
        for axis in range(2)
    )
    return depth, (depth > 1e-6) & (x < reach) & (y < reach)


def bake(image: Image, tile: float, sheet: Sheet, view: Viewpoint) -> Image:
    """A periodic image repeated over a sheet, filtered to the size of a pixel there; coarser outside the picture."""
    # As fine as the image, in multiples of the blocks, but not beyond three texels a pixel across the picture.
    texel = tile / len(image)
    most = min(_MAX_TEXELS, 3 * view.width_px // _BLOCK * _BLOCK)
    columns, rows = (
        int(np.clip(math.ceil(length / texel / _BLOCK) * _BLOCK, 8, most))
        for length in sheet.lengths
    )
    pyramid = [image]
    while len(pyramid[-1]) > 2:
        pyramid.append(half_size(pyramid[-1]))

    # Blocks of texels first, then each texel of the blocks that a camera may see.
    block_rows, block_columns = rows // _BLOCK, columns // _BLOCK
    coarse = _sampled(pyramid, tile, sheet, view, block_rows, block_columns, None)
    s = (np.arange(block_columns) + 0.5) / block_columns
    t = 1 - (np.arange(block_rows) + 0.5) / block_rows  # row 0 is the top, t = 1
    _, is_visible = _project(sheet, view, s, t, _BEYOND)
    baked, inside = _enlarged(coarse), _enlarged(is_visible)
    if inside.any():
        baked[inside] = _sampled(pyramid, tile, sheet, view, rows, columns, inside)
    return baked


def _enlarged(blocks: NDArray[Any]) -> NDArray[Any]:
    """Each block repeated in all its rows and columns of texels."""
    return np.repeat(np.repeat(blocks, _BLOCK, axis=0), _BLOCK, axis=1)


def _sampled(
    pyramid: list[Image],
    tile: float,
    sheet: Sheet,
    view: Viewpoint,
    rows: int,
    columns: int,
    inside: Mask | None,
) -> Image:
    """The image at a grid of texels (rows, columns, 3), or at those `inside` (N, 3): trilinear in the pyramid."""
    row, column = np.indices((rows, columns)) if inside is None else np.nonzero(inside)
    s = ((column + 0.5) / columns).astype(np.float32)
    t = (1 - (row + 0.5) / rows).astype(np.float32)
    wide, high = sheet.lengths
    footprint = _pixel_footprint(sheet, view, s, t)
    # No finer than the texels that are baked, which are seen interpolated.
    footprint = np.maximum(footprint, np.float32(max(wide / columns, high / rows)))
    texel = np.float32(tile / len(pyramid[0]))
    level = np.asarray(np.log2(np.maximum(footprint / texel, 1.0)), np.float32)
    level = np.clip(level, 0, len(pyramid) - 1.001)

    x, y = s * np.float32(wide / tile), (1 - t) * np.float32(high / tile)
    out = np.zeros((*level.shape, 3), dtype=np.float32)
    lower = level.astype(np.int64)
    fraction = (level - lower).astype(np.float32)
    for number in np.unique(lower):
        here = lower == number
        w = fraction[here][:, None]
        fine = _wrapped(pyramid[number], y[here], x[here])
        rough = _wrapped(pyramid[number + 1], y[here], x[here])
        out[here] = fine * (1 - w) + rough * w
    return out


def _pixel_footprint(sheet: Sheet, view: Viewpoint, s: Image, t: Image) -> Image:
    """The longer side, in metres, of the part of the sheet that a pixel sees at shares s, t of its sides.

    A pixel covers p z across at depth z, and along the slope 1/cosine of that.
    """
    cam_from_world = view.cam_from_world[:3, :3]
    origin = cam_from_world @ (sheet.corner - view.eye)
    u, v = cam_from_world @ sheet.u, cam_from_world @ sheet.v
    x, y, z = (
        np.float32(origin[i]) + s * np.float32(u[i]) + t * np.float32(v[i])
        for i in range(3)
    )
    distance_of_plane = abs(float((sheet.corner - view.eye) @ sheet.normal))
    cosine = np.float32(distance_of_plane) / np.sqrt(x * x + y * y + z * z)
    cosine = np.maximum(cosine, np.float32(_MIN_COSINE))
    depth = np.maximum(z, np.float32(1e-6))
    return np.asarray(np.float32(view.pixel(1.0)) * depth / cosine)


def _wrapped(picture: Image, y: Image, x: Image) -> Image:
    """Bilinear values (N, 3) of a periodic picture at fractions y, x of its height and width."""
    n = len(picture)
    rows, columns = y * n - np.float32(0.5), x * n - np.float32(0.5)
    i, j = np.floor(rows).astype(np.int32), np.floor(columns).astype(np.int32)
    fy, fx = (rows - i)[:, None], (columns - j)[:, None]
    # Offsets into the flat picture, of whole rows and of columns: `take` is twice as fast as two indices.
    above, below = i % n * n, (i + 1) % n * n
    left, right = j % n, (j + 1) % n
    flat = picture.reshape(-1, 3)

    def texels_at(row: NDArray[np.int32], column: NDArray[np.int32]) -> Image:
        return np.take(flat, row + column, axis=0)

    upper = texels_at(above, left) * (1 - fx) + texels_at(above, right) * fx
    lower = texels_at(below, left) * (1 - fx) + texels_at(below, right) * fx
    return np.asarray(upper * (1 - fy) + lower * fy)


Patterns = tuple[float, tuple[tuple[str, float], ...]]
"""The probability that a surface is plain, and patterns with the size in metres of a tile."""

_CLOTH = (
    "weave",
    "gingham",
    "stripes",
    "zigzag",
)  # of table cloths, carpets and wall hangings
# fmt: off
WALLS: Patterns = (0.5, (
    ("cloudy", 1.6), ("weave", 0.5), ("stripes", 0.7), ("bricks", 1.0), ("scales", 0.8), ("dots", 0.8), ("tiles", 0.8),
    ("planks", 1.1), ("granite", 1.0), ("triangles", 1.4), ("zigzag", 0.9),
))
TOPS: Patterns = (0.2, (
    ("planks", 0.7), ("planks", 0.9), ("wood", 0.6), ("wood", 0.8), ("marble", 0.9), ("gingham", 0.35),
    ("stripes", 0.5), ("weave", 0.3), ("chips", 0.5), ("tiles", 0.5), ("granite", 0.5), ("mosaic", 0.5),
))
FLOORS: Patterns = (0.2, (
    ("planks", 1.1), ("planks", 1.3), ("planks", 1.2), ("tiles", 1.6), ("chips", 1.2), ("checks", 1.2),
    ("granite", 0.8), ("mosaic", 1.2), ("marble", 1.6), ("weave", 0.4),
))
# fmt: on


def surface_pattern(
    rng: Rng, patterns: Patterns, may_be_plain: bool = True
) -> tuple[str, float]:
    """The pattern of a wall, table top or floor, and the size of its tile in metres."""
    plain_share, with_pattern = patterns
    if rng.random() >= plain_share:
        return one_of(rng, with_pattern)
    if may_be_plain:
        return "plain", 1.6
    # From a stream of its own, which keeps the draws that follow.
    return one_of(rng.spawn(1)[0], with_pattern)


def wall_colors(rng: Rng, palette: Palette, contrast: float = 0.35) -> Float:
    """Colours of a wall: a ground, and others mixed with it so that the pattern keeps a low contrast."""
    grounds = varied(rng, rng.permutation(palette.grounds), 0.06)
    if rng.random() < 0.15:
        accent = varied(rng, rng.permutation(palette.accents)[:1], 0.1)[0]
        grounds[0] = 0.75 * accent + 0.02
    ground = grounds[0]
    paints = np.vstack([grounds[1:], palette.accents])
    return np.vstack([grounds[:1], ground + (paints - ground) * (contrast + 0.15)])
