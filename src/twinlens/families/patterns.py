"""Coloured textures, float32 (n, n, 3), linear: patterns, periodic in both directions, and printed test charts.

The caller chooses n so that a texel is no smaller than a pixel where the surface is seen; the finest period is two
texels. Each texel is an average over its area.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from twinlens.families.draws import (
    STONES,
    WOODS,
    Rng,
    log_uniform,
    one_of,
    varied,
    weighted,
)
from twinlens.geometry import Float
from twinlens.scenes import textures
from twinlens.scenes.textures import Image, ramp

# Grain: cells of 4 cm to 1.25 mm, each octave of the same contrast.
_COARSEST, _OCTAVES = 0.04, 6
# Least and largest standard deviation of the logarithm of the reflectance.
_PLAIN_GRAIN, _GRAIN = (0.015, 0.14), (0.15, 0.45)
_PAPER = np.array([[0.03, 0.03, 0.035], [0.8, 0.79, 0.76]])


def texture_seed(rng: Rng) -> int:
    """A seed for the functions of `twinlens.scenes.textures`."""
    return int(rng.integers(1 << 31))


def noise(
    n: int,
    rng: Rng,
    cells: int = 4,
    octaves: int = 6,
    gain: float = 0.55,
    contrast: float = 1.0,
) -> Image:
    """Fractal noise (n, n) in [0, 1]; its coarsest cells are 1/cells wide."""
    return textures.fractal_noise(
        n, n, (cells, cells), texture_seed(rng), octaves, gain, contrast
    )


def _averaged(
    draw: Callable[[int, Float, Float, Rng, Float], Float],
) -> Callable[[int, Rng, Float], Image]:
    """A pattern drawn at positions finer than the texels (u rightwards, v downwards) and averaged over each texel."""

    def drawn(n: int, rng: Rng, colors: Float) -> Image:
        inner = 1
        if n <= 320:
            inner = 3 if n <= 160 else 2
        at = (np.arange(n * inner) + 0.5) / (n * inner)
        fine = draw(n, *np.meshgrid(at, at), rng, colors)
        if inner == 1:
            return fine.astype(np.float32)
        texels = fine.reshape(n, inner, n, inner, 3)
        return np.asarray(texels.mean(axis=(1, 3)), dtype=np.float32)

    return drawn


def _plain(n: int, rng: Rng, colors: Float) -> Image:
    return np.broadcast_to(colors[0], (n, n, 3)).astype(np.float32)


def _cloudy(n: int, rng: Rng, colors: Float) -> Image:
    cells = int(rng.integers(2, 6))
    return ramp(noise(n, rng, cells, contrast=1.7), colors[:2])


def _checks(n: int, rng: Rng, colors: Float) -> Image:
    cells = 2 * int(rng.integers(2, 5))
    return ramp(textures.checker(n, n, (cells, cells)), colors[:2])


def _marble(n: int, rng: Rng, colors: Float) -> Image:
    stone = one_of(rng, STONES)
    veins = np.zeros((n, n))
    for strength, cells in ((1.0, 2), (0.55, 4)):
        # Veins are where smooth noise crosses its mean.
        field = noise(n, rng, cells, octaves=6, gain=0.5, contrast=2.0)
        distance = np.abs(field.astype(np.float64) - 0.5)
        veins = np.maximum(veins, strength * np.exp(-distance / 0.035))
    cloud = noise(n, rng, 3, contrast=1.2)
    return ramp(np.clip(0.35 * cloud + 0.75 * veins, 0, 1), varied(rng, stone, 0.08))


def _granite(n: int, rng: Rng, colors: Float) -> Image:
    stone = one_of(rng, STONES)
    tones = np.vstack([stone, stone.mean(axis=0, keepdims=True), 0.3 * stone[1:]])
    grains = noise(n, rng, 24, octaves=4, gain=0.8, contrast=2.2)
    return ramp(grains, varied(rng, tones, 0.06))


def _wood(n: int, rng: Rng, colors: Float) -> Image:
    tones = varied(rng, one_of(rng, WOODS), 0.08)
    rings = int(rng.integers(3, 9))
    seed = texture_seed(rng)
    waviness = rng.uniform(0.15, 0.7)
    return ramp(textures.wood(n, n, rings, seed, waviness, grain=0.4), tones)


def _planks(n: int, rng: Rng, colors: Float) -> Image:
    """Boards along v, side by side along u; each is two pieces of half the length, with a tint of their own."""
    tones = varied(rng, one_of(rng, WOODS), 0.08)
    count = one_of(rng, [4, 5, 6])
    seed = texture_seed(rng)
    grey = textures.wood(n, n, count, seed, waviness=0.35, grain=0.45)
    grey = grey.astype(np.float64)
    starts = rng.random(count)
    cuts = rng.random(count)
    tint = rng.normal(0, 0.13, (count, 2))

    at = (np.arange(n) + 0.5) / n
    board = np.floor(at * count).astype(int)
    # Each board shows another part of the wood.
    rows = np.arange(n)[:, None] + (starts[board] * n).astype(int)
    fibres = grey[rows % n, np.arange(n)]
    along = at[:, None] + cuts[board]
    is_upper = along % 1.0 < 0.5
    light = np.exp(np.where(is_upper, tint[board, 0], tint[board, 1]))
    groove = 1 - 0.65 * _gaps_of_planks(n, at * count % 1.0, count, along)
    painted = ramp(fibres, tones) * (light * groove)[..., None]
    return np.asarray(np.clip(painted, 0, 0.9), dtype=np.float32)


def _gaps_of_planks(n: int, across: Float, count: int, along: Float) -> Float:
    """How much (n, n) of a texel is gap: at the sides of `count` boards, and where their pieces meet.

    across : shares (n,) of a board's width. along : shares (n, n) of a board's length from its first cut.
    """
    gap = max(0.004, 0.7 / n)
    to_side = np.minimum(across, 1 - across) / count
    beside = np.clip(1.5 - to_side / gap, 0, 1)
    is_cut = np.abs(along % 0.5 - 0.25) - 0.25 + gap / 2 > 0
    return np.asarray(np.maximum(beside, is_cut))


def _bricks(n: int, rng: Rng, colors: Float) -> Image:
    is_red = rng.random() < 0.5
    red = np.array([[0.32, 0.12, 0.07], [0.5, 0.24, 0.14]])
    clay = red if is_red else 0.75 * colors[:1] + [[0], [0.1]]
    width = max(0.09, 9.0 / n)
    grey = textures.bricks(n, n, (4, 8), texture_seed(rng), width, variation=0.7)
    mortar = np.array([[0.5, 0.47, 0.43]])
    tone = ramp(np.clip((grey - 0.3) / 0.7, 0, 1), clay)
    weight = np.clip(grey / 0.3, 0, 1)[..., None]
    return np.asarray(mortar * (1 - weight) + tone * weight, dtype=np.float32)


def _camouflage(n: int, rng: Rng, colors: Float) -> Image:
    field = noise(n, rng, int(rng.integers(2, 5)), octaves=4, contrast=1.6)
    steps = np.sort(rng.uniform(0.3, 0.7, 3))
    width = 0.02  # of the soft edge between two tones
    tone = sum(np.clip((field - step) / width + 0.5, 0, 1) for step in steps) / 3.0
    return ramp(tone, colors[:4])


def _speckled(n: int, rng: Rng, colors: Float) -> Image:
    pale = 0.35 * colors[:1] + 0.4
    radii = max(0.003, 0.6 / n), max(0.012, 1.0 / n)
    count = int(rng.integers(60, 200))
    specks = textures.random_dots(n, n, count, radii, texture_seed(rng))
    weight = (0.8 * specks)[..., None]
    return np.asarray(pale * (1 - weight) + 0.12 * colors[1] * weight, dtype=np.float32)


def _weave(n: int, rng: Rng, colors: Float) -> Image:
    """Plain weave of two yarns; a thread is at least four texels wide."""
    threads = max(4, min(n // 4, 40)) // 2 * 2
    over = textures.checker(n, n, (threads, threads))
    tone = 0.5 * over + 0.5 * noise(n, rng, 6, contrast=1.2)
    return ramp(tone, np.vstack([0.72 * colors[0], colors[0]]))


def _stripes(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    count = int(rng.integers(2, 5))
    chosen = rng.permutation(colors)[:count]
    repeats = int(rng.integers(2, 6))
    along_v = rng.random() < 0.5
    # Each colour twice a period, in stripes of random widths; `edges` are their upper ends.
    widths = rng.dirichlet(np.full(2 * len(chosen), 2.0))
    edges = np.cumsum(widths)
    tone_of_stripe = np.append(np.tile(np.arange(len(chosen)), 2), 0)
    t = (v if along_v else u) * repeats % 1.0
    stripe = np.searchsorted(edges, t)
    return np.asarray(chosen[tone_of_stripe[stripe]])


def _gingham(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    light, dark = 0.25 * colors[0] + 0.6, colors[1]
    repeats, duty = int(rng.integers(3, 8)), rng.uniform(0.35, 0.6)
    warp = (u * repeats % 1.0 < duty).astype(float)
    weft = v * repeats % 1.0 < duty
    weight = 0.5 * (warp + weft)
    return np.asarray(light + (dark - light) * weight[..., None])


def _dots(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    cells, radius = 2 * int(rng.integers(2, 5)), rng.uniform(0.18, 0.36)
    spots = rng.permutation(colors[1:])[: min(3, len(colors) - 1)]
    row = np.floor(v * cells)
    x = u * cells + 0.5 * (row % 2)  # every second row is shifted by half a cell
    from_middle = np.hypot(x % 1.0 - 0.5, v * cells % 1.0 - 0.5)
    column = np.floor(x) % cells
    tone = ((column + row) % len(spots)).astype(int)
    is_spot = (from_middle < radius)[..., None]
    return np.asarray(np.where(is_spot, spots[tone], colors[0]))


def _chips(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    """Terrazzo: angular chips of several colours and sizes on a pale ground."""
    count = int(rng.integers(90, 260))
    centres, size = rng.random((count, 2)), rng.lognormal(0, 0.35, count)
    tones = varied(rng, colors[rng.integers(len(colors), size=count)], 0.1)
    reach = 0.42 / math.sqrt(count)
    nearest, second, index = _two_nearest(centres, u, v)
    is_near = nearest < reach * size[index]
    is_off_border = second - nearest > 0.25 * reach
    is_chip = (is_near & is_off_border)[..., None]
    ground = 0.3 * colors[-1] + 0.45
    return np.asarray(np.where(is_chip, tones[index], ground))


def _two_nearest(centres: Float, u: Float, v: Float) -> tuple[Float, Float, Any]:
    """Distances of the two nearest centres, and the index of the nearest; the plane repeats with period 1.

    Their difference is 0 on the borders of the cells of a Voronoi diagram.
    """
    tree = cKDTree(centres, boxsize=1.0)
    distance, index = tree.query(np.stack([u, v], axis=-1), k=2)
    return distance[..., 0], distance[..., 1], index[..., 0]


def _mosaic(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    count = int(rng.integers(40, 130))
    centres = rng.random((count, 2))
    tones = varied(rng, colors[rng.integers(len(colors), size=count)], 0.1)
    nearest, second, index = _two_nearest(centres, u, v)
    joint = np.full(3, 0.55)
    is_tile = (second - nearest > 0.09 / math.sqrt(count))[..., None]
    return np.asarray(np.where(is_tile, tones[index], joint))


def _tiles(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    cells = one_of(rng, [4, 6, 8])
    width = max(0.035, 1.2 * cells / n)  # of a joint, in tiles
    is_other = rng.random((cells, cells)) < rng.uniform(0, 0.5)
    if rng.random() < 0.4:
        is_other = np.add.outer(np.arange(cells), np.arange(cells)) % 2 == 1
    light = np.exp(rng.normal(0, 0.07, (cells, cells, 1)))
    tiles = colors[is_other.astype(int)] * light
    x, y = u * cells, v * cells
    is_upright_joint = np.abs(x % 1.0 - 0.5) > 0.5 - width / 2
    is_level_joint = np.abs(y % 1.0 - 0.5) > 0.5 - width / 2
    is_joint = (is_upright_joint | is_level_joint)[..., None]
    return np.asarray(np.where(is_joint, 0.5, tiles[y.astype(int), x.astype(int)]))


def _triangles(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    cells = one_of(rng, [4, 6, 8])
    tone = rng.integers(len(colors), size=(cells, cells, 2))
    slope = rng.integers(2, size=(cells, cells))
    row, column = (v * cells).astype(int), (u * cells).astype(int)
    x, y = u * cells % 1.0, v * cells % 1.0
    # Each square is cut along one of its diagonals.
    is_right = np.where(slope[row, column] == 0, x > y, x + y > 1)
    return np.asarray(colors[tone[row, column, is_right.astype(int)]])


def _zigzag(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    count = int(rng.integers(3, 6))
    chosen = rng.permutation(colors)[:count]
    across = int(rng.integers(2, 6))
    bands = int(rng.integers(1, 3))
    height = rng.uniform(0.1, 0.3)
    rise = height * np.abs(2 * (u * across % 1.0) - 1)
    t = v * bands + rise
    tone = t * len(chosen) % len(chosen)
    return np.asarray(chosen[tone.astype(int)])


def _scales(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    """Overlapping fans of concentric rings (seigaiha)."""
    cells = one_of(rng, [4, 6])
    best = np.full(u.shape, -1)
    rows_of_fans = v * 2 * cells
    for row in range(3, -1, -1):  # the lowest fans are drawn last, over the others
        base = np.floor(rows_of_fans) + row - 1
        x = u * cells + 0.5 * (base % 2)
        radius = np.hypot(x % 1.0 - 0.5, (rows_of_fans - base - 1) / 2)
        ring = np.clip((1 - radius / 0.56) * 4, -1, 3.99)
        best = np.where(radius < 0.56, ring.astype(int), best)
    is_even = (best % 2 == 0)[..., None]
    return np.asarray(np.where(is_even, colors[1], colors[0]))


def _art(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    """Discs, bars and rings of random places and sizes, one over the other."""
    out = np.broadcast_to(colors[0], (*u.shape, 3)).copy()
    for _ in range(int(rng.integers(5, 12))):
        shape = one_of(rng, (_disc, _bar, _ring))
        x, y = rng.random(2)
        size = rng.uniform(0.06, 0.3)
        angle = rng.uniform(0, math.pi)
        tone = int(rng.integers(1, len(colors)))
        dx = (u - x + 0.5) % 1.0 - 0.5
        dy = (v - y + 0.5) % 1.0 - 0.5
        out[shape(dx, dy, size, angle)] = colors[tone]
    return out


def _disc(dx: Float, dy: Float, size: float, angle: float) -> Any:
    """Whether places at dx, dy from its middle are in a disc."""
    return np.hypot(dx, dy) < size


def _ring(dx: Float, dy: Float, size: float, angle: float) -> Any:
    """Whether places at dx, dy from its middle are in a ring."""
    return np.abs(np.hypot(dx, dy) - size) < 0.18 * size


def _bar(dx: Float, dy: Float, size: float, angle: float) -> Any:
    """Whether places at dx, dy from its middle are in a bar at an angle from u."""
    along = dx * math.cos(angle) + dy * math.sin(angle)
    across = dy * math.cos(angle) - dx * math.sin(angle)
    is_within_length = np.abs(along) < min(1.4 * size, 0.35)
    return is_within_length & (np.abs(across) < 0.22 * size)


_SMOOTH = (_marble, _granite, _wood, _planks, _bricks, _camouflage, _speckled, _weave)
_SHARP = (
    _stripes,
    _gingham,
    _dots,
    _chips,
    _mosaic,
    _tiles,
    _triangles,
    _zigzag,
    _scales,
    _art,
)
PATTERNS: dict[str, Callable[[int, Rng, Float], Image]] = {
    "plain": _plain,
    "cloudy": _cloudy,
    "checks": _checks,
    **{function.__name__[1:]: function for function in _SMOOTH},
    **{function.__name__[1:]: _averaged(function) for function in _SHARP},
}
"""Every pattern by name: functions of the size, a random stream and colours."""


def pattern(name: str, n: int, rng: Rng, colors: Float, tile: float = 0.3) -> Image:
    """A pattern with the grain of a surface, for a tile of `tile` metres, clipped to the albedo of paint.

    Octaves of grain that are finer than a texel are left out; the contrast of the others does not depend on n.
    """
    painted = PATTERNS[name](n, rng, colors)
    painted *= _grain(name, n, rng, tile)[..., None]
    return np.clip(painted, 0.01, 0.88, out=painted)


def _grain(name: str, n: int, rng: Rng, tile: float) -> Image:
    """Factors (n, n) of the reflectance, of mean near 1: the grain of a surface with this pattern."""
    across = max(3, round(tile / _COARSEST))
    is_wood = name in ("wood", "planks")
    along = max(1, across // 8) if is_wood else across  # fibres are along v
    octaves = int(np.clip(math.log2(n / across) + 1, 0, _OCTAVES))
    seed = texture_seed(rng)
    grain = textures.fractal_noise(n, n, (across, along), seed, octaves, 1.0)
    # Noise has a deviation of 1/5. Octaves of equal contrast add in quadrature, so those that are left out take
    # their share of the variance with them.
    least, largest = _PLAIN_GRAIN if name == "plain" else _GRAIN
    strength = 5 * log_uniform(rng, least, largest) * math.sqrt(octaves / _OCTAVES)
    grain -= np.float32(0.5)
    grain *= np.float32(strength)
    return np.exp(grain, out=grain)


def half_size(image: Image) -> Image:
    """The image at half its size: means over 2x2 texels; an odd last row or column is dropped."""
    height, width = (length // 2 * 2 for length in image.shape[:2])
    if not image.flags.c_contiguous:
        # Means sum in the order of memory, so the sums below would differ in the last bit.
        blocks = image[:height, :width].reshape(height // 2, 2, width // 2, 2, -1)
        return np.asarray(blocks.mean(axis=(1, 3)))
    # Sums of slices take a fifth of the time of means over short axes.
    upper, lower = image[0:height:2], image[1:height:2]
    total = upper[:, 0:width:2] + upper[:, 1:width:2]
    total += lower[:, 0:width:2]
    total += lower[:, 1:width:2]
    return np.asarray(total / 4)


def _dot_chart(rng: Rng, n: int, accents: Float) -> Image:
    cells = int(rng.integers(5, max(6, min(11, n // 6))))
    # Places from the middle of a cell, three to a texel.
    at = (np.arange(n * 3) + 0.5) / (n * 3) * cells % 1.0 - 0.5
    is_paper = np.hypot(at[:, None], at) > 0.3
    in_texel = is_paper.reshape(n, 3, n, 3)
    return ramp(in_texel.mean(axis=(1, 3)), _PAPER)


def _bars(rng: Rng, n: int, accents: Float) -> Image:
    u = (np.arange(n * 4) + 0.5) / (n * 4)
    # A chirp: the phase of 3 periods a width at u = 0, and of `most` at u = 1.
    most = min(n / 5, 28)
    phase = 3 * u + 0.5 * (most - 3) * u**2
    is_paper = phase % 1.0 < 0.5
    line = is_paper.reshape(n, 4).mean(axis=1)
    upright = np.broadcast_to(line, (n, n))
    grey = upright if rng.random() < 0.5 else upright.T
    return ramp(grey, _PAPER)


def _color_checker(rng: Rng, n: int, accents: Float) -> Image:
    columns, rows = 6, 4
    repeated = np.vstack([accents] * 4)[: rows * columns]
    tones = varied(rng, repeated, 0.25).reshape(rows, columns, 3)
    tones[-1] = np.linspace(0.03, 0.8, columns)[:, None]  # greys
    at = (np.arange(n) + 0.5) / n
    row, column = (at * rows).astype(int), (at * columns).astype(int)
    in_row = np.abs(at * rows % 1 - 0.5) < 0.42
    in_column = np.abs(at * columns % 1 - 0.5) < 0.42
    is_patch = (in_row[:, None] & in_column)[..., None]
    return np.where(is_patch, tones[row][:, column], 0.02).astype(np.float32)


def _random_squares(rng: Rng, n: int, accents: Float) -> Image:
    cells = min(n // 2, one_of(rng, [16, 24, 32]))
    squares = textures.value_noise(n, n, (cells, cells), texture_seed(rng), "nearest")
    return ramp(squares, _PAPER)


def _chessboard(rng: Rng, n: int, accents: Float) -> Image:
    cells = int(rng.integers(5, max(6, min(12, n // 4))))
    return ramp(textures.checker(n, n, (cells, cells)), _PAPER)


def _siemens_star(rng: Rng, n: int, accents: Float) -> Image:
    return ramp(textures.siemens_star(n, n, one_of(rng, [8, 12, 18])), _PAPER)


def _clouds(rng: Rng, n: int, accents: Float) -> Image:
    grey = noise(n, rng, 4, 7, 0.75, 1.8)
    return ramp(grey, np.insert(_PAPER, 1, varied(rng, accents[:1]), 0))


def _poster(rng: Rng, n: int, accents: Float) -> Image:
    name = one_of(rng, _POSTERS)
    return pattern(name, n, rng, varied(rng, rng.permutation(accents)))


_POSTERS = (
    "art",
    "mosaic",
    "triangles",
    "marble",
    "camouflage",
    "chips",
    "zigzag",
    "scales",
)
_CHARTS: tuple[tuple[float, Callable[[Rng, int, Float], Image]], ...] = (
    (1.2, _chessboard),
    (0.8, _siemens_star),
    (1.0, _dot_chart),
    (1.0, _random_squares),
    (1.0, _clouds),
    (0.6, _bars),
    (0.8, _color_checker),
    (3.0, _poster),
)
"""Every chart and its weight in draws."""


def draw_chart(rng: Rng, n: int, accents: Float) -> Image:
    """A test chart of n x n texels with a margin of paper; no mark is finer than two texels. `accents` is (N, 3)."""
    weights, charts = zip(*_CHARTS, strict=True)
    draw = weighted(rng, charts, weights)
    made = np.array(draw(rng, n, accents), dtype=np.float32)
    margin = max(1, n // 24)
    for edge in (made[:margin], made[-margin:], made[:, :margin], made[:, -margin:]):
        edge[:] = _PAPER[1]
    return made
