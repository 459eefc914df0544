"""Coloured textures, float32 (n, n, 3), linear: patterns, periodic in both directions, and printed test charts.

The caller chooses n so that a texel is no smaller than a pixel where the surface is seen; the finest period is two
texels. Each texel is an average over its area.
"""

import math
from collections.abc import Callable

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

_COARSEST, _OCTAVES = (
    0.04,
    6,
)  # of grain: cells of 4 cm to 1.25 mm, all of the same contrast
_PLAIN_GRAIN, _GRAIN = (
    (0.015, 0.14),
    (0.15, 0.45),
)  # least and largest s.d. of the logarithm of the reflectance
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
        inner = 3 if n <= 160 else 2 if n <= 320 else 1
        at = (np.arange(n * inner) + 0.5) / (n * inner)
        fine = draw(n, *np.meshgrid(at, at), rng, colors)
        return np.asarray(
            fine.reshape(n, inner, n, inner, 3).mean(axis=(1, 3)), dtype=np.float32
        )

    return drawn


def _marble(n: int, rng: Rng, colors: Float) -> Image:
    stone = one_of(rng, STONES)
    veins = np.zeros((n, n))
    for strength, cells in ((1.0, 2), (0.55, 4)):
        field = (
            noise(n, rng, cells, octaves=6, gain=0.5, contrast=2.0).astype(np.float64)
            - 0.5
        )
        veins = np.maximum(veins, strength * np.exp(-np.abs(field) / 0.035))
    cloud = noise(n, rng, 3, contrast=1.2)
    return ramp(np.clip(0.35 * cloud + 0.75 * veins, 0, 1), varied(rng, stone, 0.08))


def _granite(n: int, rng: Rng, colors: Float) -> Image:
    stone = one_of(rng, STONES)
    tones = np.vstack([stone, stone.mean(axis=0, keepdims=True), 0.3 * stone[1:]])
    grains = noise(n, rng, 24, octaves=4, gain=0.8, contrast=2.2)
    return ramp(grains, varied(rng, tones, 0.06))


def _wood(n: int, rng: Rng, colors: Float) -> Image:
    tones = varied(rng, one_of(rng, WOODS), 0.08)
    count = int(rng.integers(3, 9))
    return ramp(
        textures.wood(
            n, n, count, texture_seed(rng), waviness=rng.uniform(0.15, 0.7), grain=0.4
        ),
        tones,
    )


def _planks(n: int, rng: Rng, colors: Float) -> Image:
    tones = varied(rng, one_of(rng, WOODS), 0.08)
    count = one_of(rng, [4, 5, 6])
    grey = textures.wood(
        n, n, count, texture_seed(rng), waviness=0.35, grain=0.45
    ).astype(np.float64)
    starts, cuts, tint = (
        rng.random(count),
        rng.random(count),
        rng.normal(0, 0.13, (count, 2)),
    )
    u = (np.arange(n) + 0.5) / n
    board = np.floor(u * count).astype(int)
    rolled = grey[
        (np.arange(n)[:, None] + (starts[board] * n).astype(int)) % n, np.arange(n)
    ]
    upper = (u[:, None] + cuts[board]) % 1.0 < 0.5
    light = np.exp(np.where(upper, tint[board, 0], tint[board, 1]))
    gap = max(0.004, 0.7 / n)
    across = np.minimum(u * count % 1.0, 1 - u * count % 1.0) / count
    along = np.abs((u[:, None] + cuts[board]) % 0.5 - 0.25) - 0.25 + gap / 2
    groove = 1 - 0.65 * np.maximum(np.clip(1.5 - across / gap, 0, 1), along > 0)
    return np.asarray(
        np.clip(ramp(rolled, tones) * (light * groove)[..., None], 0, 0.9),
        dtype=np.float32,
    )


def _bricks(n: int, rng: Rng, colors: Float) -> Image:
    clay = (
        np.array([[0.32, 0.12, 0.07], [0.5, 0.24, 0.14]])
        if rng.random() < 0.5
        else 0.75 * colors[:1] + [[0], [0.1]]
    )
    grey = textures.bricks(
        n, n, (4, 8), texture_seed(rng), mortar=max(0.09, 9.0 / n), variation=0.7
    )
    mortar = np.array([[0.5, 0.47, 0.43]])
    tone = ramp(np.clip((grey - 0.3) / 0.7, 0, 1), clay)
    weight = np.clip(grey / 0.3, 0, 1)[..., None]
    return np.asarray(mortar * (1 - weight) + tone * weight, dtype=np.float32)


def _camouflage(n: int, rng: Rng, colors: Float) -> Image:
    field = noise(n, rng, int(rng.integers(2, 5)), octaves=4, contrast=1.6)
    steps = np.sort(rng.uniform(0.3, 0.7, 3))
    width = 0.02
    return ramp(
        sum(np.clip((field - s) / width + 0.5, 0, 1) for s in steps) / 3.0, colors[:4]
    )


def _speckled(n: int, rng: Rng, colors: Float) -> Image:
    pale = 0.35 * colors[:1] + 0.4
    radii = max(0.003, 0.6 / n), max(0.012, 1.0 / n)
    specks = textures.random_dots(
        n, n, int(rng.integers(60, 200)), radii, texture_seed(rng)
    )
    weight = (0.8 * specks)[..., None]
    return np.asarray(pale * (1 - weight) + 0.12 * colors[1] * weight, dtype=np.float32)


def _weave(n: int, rng: Rng, colors: Float) -> Image:
    """Plain weave of two yarns; a thread is at least four texels wide."""
    threads = max(4, min(n // 4, 40)) // 2 * 2
    over = textures.checker(n, n, (threads, threads))
    return ramp(
        0.5 * over + 0.5 * noise(n, rng, 6, contrast=1.2),
        np.vstack([0.72 * colors[0], colors[0]]),
    )


def _stripes(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    count = int(rng.integers(2, 5))
    chosen = rng.permutation(colors)[:count]
    repeats, along_v = int(rng.integers(2, 6)), rng.random() < 0.5
    edges = np.cumsum(rng.dirichlet(np.full(2 * len(chosen), 2.0)))
    order = np.append(np.tile(np.arange(len(chosen)), 2), 0)
    t = (v if along_v else u) * repeats % 1.0
    return np.asarray(chosen[order[np.searchsorted(edges, t)]])


def _gingham(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    light, dark = 0.25 * colors[0] + 0.6, colors[1]
    repeats, duty = int(rng.integers(3, 8)), rng.uniform(0.35, 0.6)
    weight = 0.5 * (
        (u * repeats % 1.0 < duty).astype(float) + (v * repeats % 1.0 < duty)
    )
    return np.asarray(light + (dark - light) * weight[..., None])


def _dots(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    cells, radius = 2 * int(rng.integers(2, 5)), rng.uniform(0.18, 0.36)
    spots = rng.permutation(colors[1:])[: min(3, len(colors) - 1)]
    row = np.floor(v * cells)
    x = u * cells + 0.5 * (row % 2)
    inside = np.hypot(x % 1.0 - 0.5, v * cells % 1.0 - 0.5) < radius
    spot = spots[((np.floor(x) % cells + row) % len(spots)).astype(int)]
    return np.asarray(np.where(inside[..., None], spot, colors[0]))


def _chips(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    """Terrazzo: angular chips of several colours and sizes on a pale ground."""
    count = int(rng.integers(90, 260))
    centres, size = rng.random((count, 2)), rng.lognormal(0, 0.35, count)
    tones = varied(rng, colors[rng.integers(len(colors), size=count)], 0.1)
    reach = 0.42 / math.sqrt(count)
    distance, index = cKDTree(centres, boxsize=1.0).query(
        np.stack([u, v], axis=-1), k=2
    )  # the two nearest centres
    inside = (distance[..., 0] < reach * size[index[..., 0]]) & (
        distance[..., 1] - distance[..., 0] > 0.25 * reach
    )
    return np.asarray(
        np.where(inside[..., None], tones[index[..., 0]], 0.3 * colors[-1] + 0.45)
    )


def _mosaic(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    count = int(rng.integers(40, 130))
    centres = rng.random((count, 2))
    tones = varied(rng, colors[rng.integers(len(colors), size=count)], 0.1)
    distance, index = cKDTree(centres, boxsize=1.0).query(
        np.stack([u, v], axis=-1), k=2
    )
    tile = distance[..., 1] - distance[..., 0] > 0.09 / math.sqrt(count)
    return np.asarray(np.where(tile[..., None], tones[index[..., 0]], np.full(3, 0.55)))


def _tiles(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    cells = one_of(rng, [4, 6, 8])
    width = max(0.035, 1.2 * cells / n)
    chosen = colors[np.where(rng.random((cells, cells)) < rng.uniform(0, 0.5), 1, 0)]
    if rng.random() < 0.4:
        chosen = colors[np.add.outer(np.arange(cells), np.arange(cells)) % 2]
    chosen = chosen * np.exp(rng.normal(0, 0.07, (cells, cells, 1)))
    x, y = u * cells, v * cells
    joint = (np.abs(x % 1.0 - 0.5) > 0.5 - width / 2) | (
        np.abs(y % 1.0 - 0.5) > 0.5 - width / 2
    )
    return np.asarray(
        np.where(joint[..., None], 0.5, chosen[y.astype(int), x.astype(int)])
    )


def _triangles(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    cells = one_of(rng, [4, 6, 8])
    tone = rng.integers(len(colors), size=(cells, cells, 2))
    slope = rng.integers(2, size=(cells, cells))
    i, j = (v * cells).astype(int), (u * cells).astype(int)
    x, y = u * cells % 1.0, v * cells % 1.0
    half = np.where(slope[i, j] == 0, x > y, x + y > 1).astype(int)
    return np.asarray(colors[tone[i, j, half]])


def _zigzag(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    count = int(rng.integers(3, 6))
    chosen = rng.permutation(colors)[:count]
    across, bands, height = (
        int(rng.integers(2, 6)),
        int(rng.integers(1, 3)),
        rng.uniform(0.1, 0.3),
    )
    t = v * bands + height * np.abs(2 * (u * across % 1.0) - 1)
    return np.asarray(chosen[(t * len(chosen) % len(chosen)).astype(int)])


def _scales(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    """Overlapping fans of concentric rings (seigaiha)."""
    cells = one_of(rng, [4, 6])
    best = np.full(u.shape, -1)
    for row in range(3, -1, -1):  # the lowest fans are drawn last, over the others
        base = np.floor(v * 2 * cells) + row - 1
        x = u * cells + 0.5 * (base % 2)
        r = np.hypot(x % 1.0 - 0.5, (v * 2 * cells - base - 1) / 2 * 1.0)
        ring = np.clip((1 - r / 0.56) * 4, -1, 3.99)
        best = np.where(r < 0.56, ring.astype(int), best)
    return np.asarray(np.where((best % 2 == 0)[..., None], colors[1], colors[0]))


def _art(n: int, u: Float, v: Float, rng: Rng, colors: Float) -> Float:
    out = np.broadcast_to(colors[0], (*u.shape, 3)).copy()
    for _ in range(int(rng.integers(5, 12))):
        kind, (x, y), size = int(rng.integers(3)), rng.random(2), rng.uniform(0.06, 0.3)
        angle, tone = rng.uniform(0, math.pi), int(rng.integers(1, len(colors)))
        dx, dy = (u - x + 0.5) % 1.0 - 0.5, (v - y + 0.5) % 1.0 - 0.5
        r = np.hypot(dx, dy)
        along, across = (
            dx * math.cos(angle) + dy * math.sin(angle),
            dy * math.cos(angle) - dx * math.sin(angle),
        )
        bar = (np.abs(along) < min(1.4 * size, 0.35)) & (np.abs(across) < 0.22 * size)
        out[(r < size, bar, np.abs(r - size) < 0.18 * size)[kind]] = colors[tone]
    return out


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
    "plain": lambda n, rng, colors: np.broadcast_to(colors[0], (n, n, 3)).astype(
        np.float32
    ),
    "cloudy": lambda n, rng, colors: ramp(
        noise(n, rng, int(rng.integers(2, 6)), contrast=1.7), colors[:2]
    ),
    "checks": lambda n, rng, colors: ramp(
        textures.checker(n, n, (2 * int(rng.integers(2, 5)),) * 2), colors[:2]
    ),
    **{function.__name__[1:]: function for function in _SMOOTH},
    **{function.__name__[1:]: _averaged(function) for function in _SHARP},
}
"""Every pattern by name: functions of the size, a random stream and colours."""


def pattern(name: str, n: int, rng: Rng, colors: Float, tile: float = 0.3) -> Image:
    """A pattern with the grain of a surface, for a tile of `tile` metres, clipped to the albedo of paint.

    Octaves of grain that are finer than a texel are left out; the contrast of the others does not depend on n.
    """
    painted = PATTERNS[name](n, rng, colors)
    across = max(3, round(tile / _COARSEST))
    along = (
        max(1, across // 8) if name in ("wood", "planks") else across
    )  # the fibres of wood are along v
    octaves = int(np.clip(math.log2(n / across) + 1, 0, _OCTAVES))
    grain = textures.fractal_noise(
        n, n, (across, along), texture_seed(rng), octaves, 1.0
    ) - np.float32(0.5)
    least, largest = _PLAIN_GRAIN if name == "plain" else _GRAIN
    strength = 5 * log_uniform(rng, least, largest) * math.sqrt(octaves / _OCTAVES)
    return np.asarray(
        np.clip(painted * np.exp(np.float32(strength) * grain)[..., None], 0.01, 0.88),
        np.float32,
    )


def half_size(image: Image) -> Image:
    """The image at half its size: means over 2x2 texels; an odd last row or column is dropped."""
    h, w = (length // 2 * 2 for length in image.shape[:2])
    return np.asarray(image[:h, :w].reshape(h // 2, 2, w // 2, 2, -1).mean(axis=(1, 3)))


def _dot_chart(rng: Rng, n: int, accents: Float) -> Image:
    cells = int(rng.integers(5, max(6, min(11, n // 6))))
    at = (np.arange(n * 3) + 0.5) / (n * 3) * cells % 1.0 - 0.5
    disc = (np.hypot(at[:, None], at) > 0.3).reshape(n, 3, n, 3).mean(axis=(1, 3))
    return ramp(disc, _PAPER)


def _bars(rng: Rng, n: int, accents: Float) -> Image:
    u = (np.arange(n * 4) + 0.5) / (n * 4)
    most = min(n / 5, 28)
    phase = 3 * u + 0.5 * (most - 3) * u**2
    line = (phase % 1.0 < 0.5).reshape(n, 4).mean(axis=1)
    grey = np.broadcast_to(line, (n, n))
    return ramp(grey if rng.random() < 0.5 else grey.T, _PAPER)


def _color_checker(rng: Rng, n: int, accents: Float) -> Image:
    columns, rows = 6, 4
    tones = varied(rng, np.vstack([accents] * 4)[:24], 0.25).reshape(rows, columns, 3)
    tones[-1] = np.linspace(0.03, 0.8, columns)[:, None]
    at = (np.arange(n) + 0.5) / n
    i, j = (at * rows).astype(int), (at * columns).astype(int)
    inside = (np.abs(at * rows % 1 - 0.5) < 0.42)[:, None] & (
        np.abs(at * columns % 1 - 0.5) < 0.42
    )
    return np.where(inside[..., None], tones[i][:, j], 0.02).astype(np.float32)


def _random_squares(rng: Rng, n: int, accents: Float) -> Image:
    cells = min(n // 2, one_of(rng, [16, 24, 32]))
    return ramp(
        textures.value_noise(n, n, (cells, cells), texture_seed(rng), "nearest"), _PAPER
    )


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
    (
        1.2,
        lambda rng, n, _: ramp(
            textures.checker(
                n, n, (int(rng.integers(5, max(6, min(12, n // 4)))),) * 2
            ),
            _PAPER,
        ),
    ),
    (
        0.8,
        lambda rng, n, _: ramp(
            textures.siemens_star(n, n, one_of(rng, [8, 12, 18])), _PAPER
        ),
    ),
    (1.0, _dot_chart),
    (1.0, _random_squares),
    (
        1.0,
        lambda rng, n, tones: ramp(
            noise(n, rng, 4, 7, 0.75, 1.8),
            np.insert(_PAPER, 1, varied(rng, tones[:1]), 0),
        ),
    ),
    (0.6, _bars),
    (0.8, _color_checker),
    (
        3.0,
        lambda rng, n, accents: pattern(
            one_of(rng, _POSTERS), n, rng, varied(rng, rng.permutation(accents))
        ),
    ),
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
