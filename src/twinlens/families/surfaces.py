"""Large flat surfaces (floors, walls, table tops): patterns baked for the view, finer near the camera than far away.

A surface may be 30 m long and begin half a metre from the camera. Its texels are therefore spread as the pixels that
see it: along each side, the texture coordinate is a piecewise linear function of the position, steep near the camera.

The renderer has no mipmaps. Each texel is taken from the levels of an image pyramid that match the size of a pixel
there, so no visible detail is finer than two pixels; a pixel that covers a long strip of the surface takes several
places along it. Sources: Williams, Pyramidal Parametrics, SIGGRAPH 1983; McCormack et al., Feline, SIGGRAPH 1999.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.families.composition import Composition, Viewpoint
from twinlens.families.draws import Palette, Rng, one_of, varied
from twinlens.families.materials import material
from twinlens.families.patterns import half_size, pattern, texture_seed
from twinlens.geometry import Float
from twinlens.scenes import shapes, textures
from twinlens.scenes.materials import Bitmap, Material
from twinlens.scenes.scene import Mesh
from twinlens.scenes.textures import Image

Mask = NDArray[np.bool_]
Texels = NDArray[np.complex128]
_MAX_TEXELS = 8192  # along a side
_MAX_PATTERN = 2048  # texels along a tile
_PATTERN_STEP = 64  # so that half, quarter, ... sizes are whole
_WEAR = 64  # texels along each side
_TEXELS_PER_PIXEL = 1.0  # at least, in the picture
_UNSEEN = 0.04  # share of the texels that is spread evenly, also outside of the picture
_CELLS = 32  # along a side, in which the texture coordinate is linear
_SAMPLES = 4  # places in a cell where the pixels are computed
_REFINEMENTS = 6
_BEYOND = 1.4  # half widths of the picture: what the right camera may see of a surface
_ABOVE = 1.1  # half heights
_SEEN = np.array([_BEYOND, _ABOVE])
_MIN_TEXELS = 128
_BAND = 16  # rows that are baked at a time
_MAX_STRIDE = 16
_COLUMNS_PER_PIXEL = 1.5  # computed ones; those between are interpolated
_MAX_TAPS = 4  # places along the strip that a pixel covers
_SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


@dataclass(frozen=True, eq=False)
class Knots:
    """A piecewise linear map from shares of a side, `at`, to texture coordinates, `uv`; both rise from 0 to 1."""

    at: Float
    uv: Float
    texels: int = 0

    def shares(self) -> Float:
        """The shares of the side at the centres of its texels."""
        return np.interp((np.arange(self.texels) + 0.5) / self.texels, self.uv, self.at)

    def steps(self) -> Float:
        """The lengths of its texels, as shares of the side."""
        edges = np.arange(self.texels + 1) / self.texels
        return np.diff(np.interp(edges, self.uv, self.at))


EVEN = Knots(np.array([0.0, 1.0]), np.array([0.0, 1.0]))


@dataclass(frozen=True, eq=False)
class Sheet:
    """A rectangle: a corner (3,) and two perpendicular sides (3,) as vectors; its front is u x v.

    `across` and `along` are the texture coordinates along u and v; `seen_from` fits them to a view.
    """

    corner: Float
    u: Float
    v: Float
    across: Knots = EVEN
    along: Knots = EVEN

    @property
    def lengths(self) -> tuple[float, float]:
        return float(np.linalg.norm(self.u)), float(np.linalg.norm(self.v))

    @property
    def normal(self) -> Float:
        n = np.cross(self.u, self.v)
        return np.asarray(n / np.linalg.norm(n))

    def seen_from(self, view: Viewpoint, texel: float) -> "Sheet":
        """The same rectangle, with texels as small as the pixels of a view, but not smaller than `texel` metres."""
        across, along = _fitted(self, view, texel)
        return replace(self, across=across, along=along)

    def front(self) -> Mesh:
        """Two triangles for each cell in which the texture coordinates are linear."""
        uv = np.stack(np.meshgrid(self.across.uv, self.along.uv), axis=-1)
        share = np.stack(np.meshgrid(self.across.at, self.along.at), axis=-1)
        corners = self.corner + share.reshape(-1, 2) @ np.stack([self.u, self.v])
        rows, columns = share.shape[:2]
        first = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, :-1]
        cell = first.reshape(-1, 1) + np.array([0, 1, columns + 1, columns])
        faces = cell[:, QUAD.astype(np.int64)].reshape(-1, 3).astype(np.uint32)
        normals = np.tile(self.normal, (len(corners), 1))
        return Mesh(corners, faces, normals, uv.reshape(-1, 2))

    def mesh(self, thickness: float = 0.0, front: Mesh | None = None) -> Mesh:
        """The front or, with a thickness, a closed slab behind it; (u, v) are those of the front.

        front : another front, of the same outline.
        """
        front = front or self.front()
        if thickness == 0:
            return front
        corners = self.corner + _SQUARE @ np.stack([self.u, self.v])
        behind = corners - thickness * self.normal
        sides = []
        for i in range(4):
            # From corner i to the next one, which is number i - 3.
            edge = [corners[i], behind[i], behind[i - 3], corners[i - 3]]
            sides.append(quad(np.stack(edge), _SQUARE[[i, i, i - 3, i - 3]]))
        back = quad(behind[::-1], _SQUARE[::-1])
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
) -> tuple[Sheet, Material]:
    """The sheet with texels as small as the view's pixels, and its material.

    The material has a pattern that repeats every `tile` metres, filtered for the view.
    """
    # Of the view alone, so that another pattern does not change the mesh.
    sheet = sheet.seen_from(scene.view, 0.0)
    near = _nearest_pixel(sheet, scene.view)
    if name == "cloudy":
        # Clouds of a wall are faint: the other colours are mixed with the first one.
        colors = np.vstack([colors[:1], 0.55 * colors[:1] + 0.45 * colors[1:]])
    image = pattern(name, _pattern_texels(tile, near), rng, colors, tile)
    baked = bake(image, tile, sheet, scene.view)

    # Wear: noise that is slow over the whole surface, faint on plain paint.
    seed = texture_seed(rng)
    slow = textures.fractal_noise(_WEAR, _WEAR, (2, 2), seed, 2, contrast=0.5)
    strength = np.float32(0.05 if name == "plain" else 0.3)
    baked *= (1 + strength * (_on_texels(slow, sheet) - np.float32(0.5)))[..., None]
    kind = "fabric" if name in _CLOTH else finish
    return sheet, material(rng, kind, Bitmap(np.clip(baked, 0.005, 0.88), wrap="clamp"))


def _pattern_texels(tile: float, pixel: float) -> int:
    """Texels of a tile of `tile` metres: none larger than a pixel of `pixel` metres, in whole steps of the pyramid."""
    steps = math.ceil(tile / (_PATTERN_STEP * pixel))
    return int(np.clip(_PATTERN_STEP * steps, _PATTERN_STEP, _MAX_PATTERN))


def _on_texels(picture: Image, sheet: Sheet) -> Image:
    """Values (rows, columns) of a picture (n, n), stretched over the sheet, at its texels; linear along each side."""
    n = len(picture)
    centres = (np.arange(n) + 0.5) / n

    def weights(shares: Float) -> Image:
        """The linear interpolation (len(shares), n) between the picture's centres."""
        hats = [np.interp(shares, centres, unit) for unit in np.eye(n)]
        return np.stack(hats, axis=-1).astype(np.float32)

    down = 1 - sheet.along.shares()[::-1]  # row 0 is the top, where the share is 1
    return np.asarray(weights(down) @ picture @ weights(sheet.across.shares()).T)


def _nearest_pixel(sheet: Sheet, view: Viewpoint) -> float:
    """The width in metres of a pixel where a fitted sheet is visible and nearest; at 1 m if no part is visible."""
    depth, is_visible = _project(sheet, view, sheet.across.at, sheet.along.at, _SEEN)
    nearest = float(depth[is_visible].min()) if is_visible.any() else 1.0
    return view.pixel(nearest)


def _project(
    sheet: Sheet, view: Viewpoint, s: Float, t: Float, reach: Float
) -> tuple[Float, Mask]:
    """Depth (rows, columns) at shares t, s of the sides, and whether the point is within `reach` half pictures."""
    points = sheet.corner + s[None, :, None] * sheet.u + t[:, None, None] * sheet.v
    in_cam = (points - view.eye) @ view.world_from_cam[:3, :3]
    depth = in_cam[..., 2]
    # Positions in the picture, 1 at its edges.
    position = np.abs(in_cam[..., :2]) / np.maximum(depth, 1e-9)[..., None] / view.half
    return depth, (depth > 1e-6) & (position < reach).all(axis=-1)


def _fitted(sheet: Sheet, view: Viewpoint, texel: float) -> tuple[Knots, Knots]:
    """Knots of both sides, whose texels are as small as the pixels that see them, but not smaller than `texel`.

    The knots, between which the density of texels is constant, are moved to where most texels are.
    """
    wide, high = sheet.lengths
    s = t = np.linspace(0, 1, _CELLS * _SAMPLES + 1)
    for _ in range(_REFINEMENTS):
        _, is_visible = _project(sheet, view, s, t, _SEEN)
        stretch = _stretch(sheet, view, s[None, :], t[:, None])
        # Pixels in a metre along each side; the most that any visible place needs.
        pixels = _pixels_per_metre(stretch) * is_visible[..., None]
        needed = np.minimum(_TEXELS_PER_PIXEL * pixels, 1 / max(texel, 1e-9))
        across = _knots(s, wide * needed[..., 0].max(axis=0))
        along = _knots(t, high * needed[..., 1].max(axis=1))
        s, t = _samples(across.at), _samples(along.at)
    return across, along


def _pixels_per_metre(stretch: "_Stretch") -> Float:
    """Pixels (..., 2) of a metre along each side, for texels that are no larger than a pixel in any direction.

    A texel is a parallelogram in the picture. With sides of length 1 at the angle a, it has the singular values
    sqrt(1 +- cos a): along its long diagonal it is larger than along its sides.
    """
    right_u, right_v, down_u, down_v = stretch
    length_u = np.sqrt(right_u**2 + down_u**2)
    length_v = np.sqrt(right_v**2 + down_v**2)
    product = np.abs(right_u * right_v + down_u * down_v)
    cosine = product / np.maximum(length_u * length_v, 1e-12)
    longer = np.sqrt(1 + cosine)
    return np.stack([length_u * longer, length_v * longer], axis=-1)


def _samples(knots: Float) -> Float:
    """`_SAMPLES` places in each cell, and its ends."""
    cells = len(knots) - 1
    place = np.arange(cells * _SAMPLES + 1) / _SAMPLES
    return np.interp(place, np.arange(cells + 1), knots)


def _knots(at: Float, density: Float) -> Knots:
    """Knots for texels of this density at places `at` of a side of length 1; 0 where nothing is seen."""
    in_step = np.maximum(density[1:], density[:-1])
    needed = in_step * np.diff(at)
    total = max(float(needed.sum()), _MIN_TEXELS)
    # Some texels are spread evenly over all of the side, so that no part is without.
    edges = np.append(0.0, np.cumsum(needed + _UNSEEN * total * np.diff(at)))
    knots = np.interp(np.linspace(0, edges[-1], _CELLS + 1), edges, at)
    # The ends of what is seen are knots, as the density falls to little there.
    seen = np.flatnonzero(in_step > 0)
    if seen.size:
        knots = np.union1d(knots, [at[seen[0]], at[seen[-1] + 1]])
    uv = np.interp(knots, at, edges / edges[-1])
    return Knots(knots, uv, _texel_count(edges[-1]))


def _texel_count(needed: float) -> int:
    return int(np.clip(math.ceil(needed), _MIN_TEXELS, _MAX_TEXELS))


class _Stretch(NamedTuple):
    """Pixels, rightwards and downwards, that a metre along each side, u and v, of a sheet spans: (...) each."""

    right_u: Float
    right_v: Float
    down_u: Float
    down_v: Float


def _stretch(sheet: Sheet, view: Viewpoint, s: Float, t: Float) -> _Stretch:
    """How a view stretches a sheet at shares s, t of its sides, which broadcast.

    The projection x / z has the derivative (dx - dz x / z) / z, in units of the focal length.
    """
    cam_from_world = view.cam_from_world[:3, :3]
    corner = cam_from_world @ (sheet.corner - view.eye)
    u_side, v_side = cam_from_world @ sheet.u, cam_from_world @ sheet.v
    x, y, z = (corner[i] + s * u_side[i] + t * v_side[i] for i in range(3))
    depth = np.maximum(z, 1e-6)
    x_slope, y_slope = x / depth, y / depth
    pixel = depth * view.pixel(1.0)
    u, v = u_side / sheet.lengths[0], v_side / sheet.lengths[1]
    return _Stretch(
        right_u=(u[0] - x_slope * u[2]) / pixel,
        right_v=(v[0] - x_slope * v[2]) / pixel,
        down_u=(u[1] - y_slope * u[2]) / pixel,
        down_v=(v[1] - y_slope * v[2]) / pixel,
    )


def bake(image: Image, tile: float, sheet: Sheet, view: Viewpoint) -> Image:
    """A periodic image repeated over the texels of a sheet (rows, columns, 3), filtered to the size of pixels."""
    pyramid = _pyramid(image)
    t = sheet.along.shares()[::-1]  # row 0 is the top, where the share is 1
    high = sheet.along.steps()[::-1] * sheet.lengths[1]
    shares = sheet.across.shares()
    widths = sheet.across.steps() * sheet.lengths[0]
    # Places in tiles; y runs downwards.
    x_of_columns = shares * sheet.lengths[0] / tile
    y_of_rows = (1 - t) * sheet.lengths[1] / tile
    baked = np.empty((len(t), sheet.across.texels, 3), dtype=np.float32)
    for band, columns in enumerate(_needed_columns(sheet, view, t)):
        rows = slice(band * _BAND, (band + 1) * _BAND)
        texel = widths[columns], high[rows, None]
        strip = _footprint(sheet, view, shares[columns], t[rows, None], texel)
        x, y = np.broadcast_arrays(x_of_columns[columns], y_of_rows[rows, None])
        values = _filtered(pyramid, tile, x, y, strip)
        baked[rows] = _every_column(values, columns)
    return baked


def _pyramid(image: Image) -> list[Texels]:
    """The image, its half size, and so on until it has at most two texels a side; all packed."""
    levels = [image]
    while len(levels[-1]) > 2:
        levels.append(half_size(levels[-1]))
    return [_packed(level) for level in levels]


def _needed_columns(
    sheet: Sheet, view: Viewpoint, t: Float
) -> Iterator[NDArray[np.int64]]:
    """The columns of texels (N,) to compute in each band of rows, of all rows at shares `t` of the side.

    Among them are the first and the last column. Columns are as near to each other as the nearest rows of a band need.
    In other rows, those that are a part of a pixel from each other suffice, and fewer where nothing is seen.
    """
    columns = sheet.across.texels
    ends = np.arange(0, columns + _MAX_STRIDE - 1, _MAX_STRIDE).clip(max=columns - 1)
    s = sheet.across.shares()[ends]
    wide = sheet.across.steps()[ends] * sheet.lengths[0]
    _, is_visible = _project(sheet, view, s, t, _SEEN)
    strip = _footprint(sheet, view, s, t[:, None], (wide, np.zeros_like(wide)))
    in_pixel = np.where(is_visible, strip.width / wide, np.inf)
    least_of_bands = np.minimum.reduceat(in_pixel, np.arange(0, len(t), _BAND), axis=0)
    gaps = np.diff(ends)
    for in_band in np.clip(least_of_bands / _COLUMNS_PER_PIXEL, 1, _MAX_STRIDE):
        # Between two ends, the smaller step of both. A column is needed where the steps reach the next whole number.
        step = np.minimum(in_band[:-1], in_band[1:])
        place = np.cumsum(np.repeat(1 / step, gaps))
        is_needed = np.diff(np.floor(place), prepend=-1.0) > 0
        yield np.union1d(np.flatnonzero(is_needed), [0, columns - 1])


def _every_column(values: Image, computed: NDArray[np.int64]) -> Image:
    """All columns of values (R, N, 3) at the columns `computed` (N,), the last of which is the last of all; linear."""
    columns = int(computed[-1]) + 1
    if len(computed) == columns:
        return values
    left = np.repeat(np.arange(len(computed) - 1), np.diff(computed))
    left = np.append(left, len(computed) - 2)
    gap = computed[left + 1] - computed[left]
    weight = ((np.arange(columns) - computed[left]) / gap).astype(np.float32)[:, None]
    start = values[:, left]
    return np.asarray(start + weight * (values[:, left + 1] - start))


class _Strip(NamedTuple):
    """The part of a sheet that a pixel sees: its width and length in metres, (...) each.

    skew, excess : its direction is at half the angle of (excess, skew) from u to v.
    """

    width: Float
    length: Float
    skew: Float
    excess: Float

    def across_and_along(self, chosen: Mask) -> tuple[Float, Float]:
        """The chosen strips, from end to end, as vectors (N,) along u and v, metres."""
        angle = 0.5 * np.arctan2(self.skew[chosen], self.excess[chosen])
        length = self.length[chosen]
        return np.cos(angle) * length, np.sin(angle) * length


def _footprint(
    sheet: Sheet, view: Viewpoint, s: Float, t: Float, texel: Sequence[Float]
) -> _Strip:
    """What a pixel sees at shares s, t of the sides; nothing smaller than a texel of these lengths along u and v.

    With J the pixels a metre, a round pixel is an ellipse on the sheet, of the matrix C = (J^T J)^-1. Its axes are the
    roots of C's eigenvalues. Source: Heckbert, Fundamentals of Texture Mapping and Image Warping, 1989.
    """
    right_u, right_v, down_u, down_v = _stretch(sheet, view, s, t)
    determinant = (right_u * down_v - right_v * down_u) ** 2
    determinant = np.maximum(determinant, 1e-12)
    # A texel that is longer than the ellipse is seen interpolated.
    texel_u, texel_v = texel
    c_uu = np.maximum((right_v**2 + down_v**2) / determinant, texel_u**2)
    c_vv = np.maximum((right_u**2 + down_u**2) / determinant, texel_v**2)
    c_uv = -(right_u * right_v + down_u * down_v) / determinant
    mean, half = 0.5 * (c_uu + c_vv), 0.5 * (c_uu - c_vv)
    root = np.hypot(half, c_uv)
    largest, least = mean + root, np.maximum(mean - root, 0.0)
    # The eigenvector of the largest eigenvalue is at half the angle of (c_uu - c_vv, 2 c_uv).
    return _Strip(np.sqrt(least), np.sqrt(largest), c_uv, half)


def _filtered(
    pyramid: list[Texels], tile: float, x: Float, y: Float, strip: _Strip
) -> Image:
    """The mean (..., 3) of a periodic image over strips around x, y, in tiles: of places that are a width apart."""
    # No narrower than what `_MAX_TAPS` places cover, nor than the image's texels.
    width = np.maximum(strip.width, strip.length / _MAX_TAPS)
    width = np.maximum(width, tile / len(pyramid[0]))
    taps = np.rint(strip.length / width).astype(np.int64).clip(1, _MAX_TAPS)
    level = np.log2(width * len(pyramid[0]) / tile).clip(0, len(pyramid) - 1.001)
    out = np.empty((*x.shape, 3), dtype=np.float32)
    for count in np.flatnonzero(np.bincount(taps.ravel())):
        chosen = taps == count
        if count == 1:
            values = _blended(pyramid, level[chosen], x[chosen], y[chosen])
            out[chosen] = values[:, :3]
            continue
        # Between strips of several places, levels need no blending.
        whole_level = np.rint(level[chosen]).astype(np.int64)
        across, along = strip.across_and_along(chosen)
        total = np.zeros((len(across), 4), dtype=np.float32)
        for offset in (np.arange(count) + 0.5) / count - 0.5:
            # Along the strip; y runs against v.
            x_at = x[chosen] + offset * (across / tile)
            y_at = y[chosen] - offset * (along / tile)
            total += _at_levels(pyramid, whole_level, x_at, y_at)
        out[chosen] = total[:, :3] / np.float32(count)
    return out


def _blended(pyramid: list[Texels], level: Float, x: Float, y: Float) -> Image:
    """Values (N, 4) at places x, y (N,), in tiles, between the two images of the pyramid nearest to levels (N,)."""
    lower = level.astype(np.int64)
    out = _at_levels(pyramid, lower, x, y)
    fraction = (level - lower).astype(np.float32)
    between = np.flatnonzero(fraction)
    rough = _at_levels(pyramid, lower[between] + 1, x[between], y[between])
    out[between] += fraction[between, None] * (rough - out[between])
    return out


def _at_levels(
    pyramid: list[Texels], level: NDArray[np.int64], x: Float, y: Float
) -> Image:
    """Values (N, 4) at places x, y (N,), in tiles, in the images of the pyramid of levels (N,)."""
    column, row = x.astype(np.float32), y.astype(np.float32)
    numbers = np.flatnonzero(np.bincount(level))
    if len(numbers) == 1:
        return _wrapped(pyramid[numbers[0]], row, column)
    out = np.empty((len(x), 4), dtype=np.float32)
    for number in numbers:
        here = np.flatnonzero(level == number)
        out[here] = _wrapped(pyramid[number], row[here], column[here])
    return out


def _packed(picture: Image) -> Texels:
    """A picture (n, n, 3) with a fourth channel, each texel as one number of 16 bytes: `take` is twice as fast."""
    padded = np.zeros((*picture.shape[:2], 4), dtype=np.float32)
    padded[..., :3] = picture
    return padded.view(np.complex128)[..., 0]


def _wrapped(picture: Texels, y: Image, x: Image) -> Image:
    """Bilinear values (N, 4) of a packed periodic picture (n, n) at fractions y, x of its height and width."""
    n = len(picture)
    above, below, fy = _neighbours(y, n)
    left, right, fx = _neighbours(x, n)
    # Offsets into the flat picture, of whole rows and of columns: `take` is twice as fast as two indices.
    above *= n
    below *= n
    flat = picture.reshape(-1)

    def texels_at(row: NDArray[np.int32], column: NDArray[np.int32]) -> Image:
        return np.take(flat, row + column).view(np.float32).reshape(-1, 4)

    upper = texels_at(above, left)
    upper += fx * (texels_at(above, right) - upper)
    lower = texels_at(below, left)
    lower += fx * (texels_at(below, right) - lower)
    upper += fy * (lower - upper)
    return upper


def _neighbours(
    place: Image, n: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], Float]:
    """The texels (N,) before and after places (N,) of a periodic side of n texels, and how far between them (N, 1)."""
    at = place * n - np.float32(0.5)
    before = np.floor(at).astype(np.int32)
    share = (at - before)[:, None]
    before %= n
    after = before + 1
    after[after == n] = 0
    return before, after, share


Patterns = tuple[float, tuple[tuple[str, float], ...]]
"""The probability that a surface is plain, and patterns with the size in metres of a tile."""

# At night: the share of dark walls, floors and tables, and the factor of their colours.
_DARK_AT_NIGHT, _DARK = 0.85, 0.07
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
TOPS: Patterns = (0.28, (
    ("planks", 0.7), ("planks", 0.9), ("wood", 0.6), ("wood", 0.8), ("marble", 0.9), ("gingham", 0.35),
    ("stripes", 0.5), ("weave", 0.3), ("chips", 0.5), ("tiles", 0.5), ("granite", 0.5), ("mosaic", 0.5),
))
FLOORS: Patterns = (0.28, (
    ("planks", 1.1), ("planks", 1.3), ("planks", 1.2), ("tiles", 1.6), ("chips", 1.2), ("checks", 1.2),
    ("granite", 0.8), ("mosaic", 1.2), ("marble", 1.6), ("weave", 0.4),
))
# fmt: on


def surface_pattern(
    scene: Composition, rng: Rng, patterns: Patterns
) -> tuple[str, float]:
    """The pattern of a wall, table top or floor, and the size of its tile in metres."""
    plain_share, with_pattern = patterns
    if rng.random() >= scene.plain_share(plain_share):
        return one_of(rng, with_pattern)
    if scene.plain_surfaces:
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


def surface_colors(scene: Composition, rng: Rng, contrast: float = 0.35) -> Float:
    """Colours of a wall, floor or table: at night most are dark, so that shadows are not lit by what is around them."""
    colors = wall_colors(rng, scene.palette, contrast)
    is_dark = scene.is_night and rng.random() < _DARK_AT_NIGHT
    return colors * (_DARK if is_dark else 1.0)
