"""Coloured textures of scene families: float32 (n, n, 3), linear, periodic in both directions, averaged over texels.

A pattern is drawn for a number of texels that the caller takes from how large a pixel is where the surface is seen:
nothing in it is finer than a texel, so two pixels are its finest period. Each is painted over with faint mottling at
several scales, as paint, glaze and cloth have it, so that no surface is one flat tone.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twinlens.geometry import Float
from twinlens.scenes import textures
from twinlens.scenes.families.palettes import STONES, WOODS, varied

Rng = np.random.Generator
Image = NDArray[np.float32]


def seed(rng: Rng) -> int:
    """A seed for the functions of `twinlens.scenes.textures`."""
    return int(rng.integers(1 << 31))


def noise(n: int, rng: Rng, cells: int = 4, octaves: int = 6, gain: float = 0.55, contrast: float = 1.0) -> Image:
    """Fractal noise (n, n) in [0, 1], its coarsest cells 1/cells wide."""
    return textures.fractal_noise(n, n, (cells, cells), seed(rng), octaves, gain, contrast)


def ramp(grey: Float | Image, colors: Float) -> Image:
    """Grey values in [0, 1] through colours (K, 3) spread evenly."""
    stops = np.linspace(0, 1, len(colors))
    return np.stack([np.interp(grey, stops, colors[:, c]) for c in range(3)], axis=-1).astype(np.float32)


def averaged(n: int, paint: Callable[[Float, Float], Float]) -> Image:
    """paint(u, v) -> (..., 3) averaged over each texel; u rightwards, v downwards, both in [0, 1)."""
    inner = 3 if n <= 192 else 2
    at = (np.arange(n * inner) + 0.5) / (n * inner)
    u, v = np.meshgrid(at, at)
    fine = paint(u, v)
    return fine.reshape(n, inner, n, inner, 3).mean(axis=(1, 3)).astype(np.float32)


def _pick(rng: Rng, colors: Float, count: int) -> Float:
    return colors[rng.permutation(len(colors))[:count]]


def plain(n: int, rng: Rng, colors: Float) -> Image:
    """One colour."""
    return np.broadcast_to(colors[0], (n, n, 3)).astype(np.float32)


def cloudy(n: int, rng: Rng, colors: Float) -> Image:
    """Two colours running into each other, as reactive glaze and washed plaster do."""
    return ramp(noise(n, rng, int(rng.integers(2, 6)), contrast=1.7), colors[:2])


def marble(n: int, rng: Rng, colors: Float) -> Image:
    """Veins along the level lines of noise in a clouded stone."""
    stone = STONES[int(rng.integers(len(STONES)))]
    veins = np.zeros((n, n))
    for strength, cells in ((1.0, 2), (0.55, 4)):
        field = noise(n, rng, cells, octaves=6, gain=0.5, contrast=2.0).astype(np.float64) - 0.5
        veins = np.maximum(veins, strength * np.exp(-np.abs(field) / 0.035))
    cloud = noise(n, rng, 3, contrast=1.2)
    return ramp(np.clip(0.35 * cloud + 0.75 * veins, 0, 1), varied(rng, stone, 0.08))


def granite(n: int, rng: Rng, colors: Float) -> Image:
    """Grains of three tones."""
    stone = STONES[int(rng.integers(len(STONES)))]
    tones = np.vstack([stone, stone.mean(axis=0, keepdims=True), 0.3 * stone[1:]])
    grains = noise(n, rng, max(4, n // 16), octaves=3, gain=0.8, contrast=2.2)
    return ramp(grains, varied(rng, tones, 0.06))


def wood(n: int, rng: Rng, colors: Float) -> Image:
    """Grain along v."""
    tones = varied(rng, WOODS[int(rng.integers(len(WOODS)))], 0.08)
    grey = textures.wood(n, n, int(rng.integers(3, 9)), seed(rng), waviness=rng.uniform(0.15, 0.7), grain=0.4)
    return ramp(grey, tones)


def planks(n: int, rng: Rng, colors: Float) -> Image:
    """Boards side by side along v, each of its own tone and piece of grain."""
    tones = varied(rng, WOODS[int(rng.integers(len(WOODS)))], 0.08)
    count = int(rng.choice([4, 5, 6]))
    grey = textures.wood(n, n, count, seed(rng), waviness=0.35, grain=0.45).astype(np.float64)
    starts, cuts, tint = rng.random(count), rng.random(count), rng.normal(0, 0.13, (count, 2))
    u = (np.arange(n) + 0.5) / n
    board = np.floor(u * count).astype(int)
    rolled = grey[(np.arange(n)[:, None] + (starts[board] * n).astype(int)) % n, np.arange(n)]
    upper = (u[:, None] + cuts[board]) % 1.0 < 0.5
    light = np.exp(np.where(upper, tint[board, 0], tint[board, 1]))
    gap = max(0.004, 0.7 / n)
    across = np.minimum(u * count % 1.0, 1 - u * count % 1.0) / count
    along = np.abs((u[:, None] + cuts[board]) % 0.5 - 0.25) - 0.25 + gap / 2
    groove = 1 - 0.65 * np.maximum(np.clip(1.5 - across / gap, 0, 1), along > 0)
    return np.clip(ramp(rolled, tones) * (light * groove)[..., None], 0, 0.9).astype(np.float32)


def stripes(n: int, rng: Rng, colors: Float) -> Image:
    """Bands of several widths, repeated."""
    chosen = _pick(rng, colors, int(rng.integers(2, 5)))
    repeats, along_v = int(rng.integers(2, 6)), rng.random() < 0.5
    edges = np.cumsum(rng.dirichlet(np.full(2 * len(chosen), 2.0)))
    order = np.append(np.tile(np.arange(len(chosen)), 2), 0)

    def paint(u: Float, v: Float) -> Float:
        t = (v if along_v else u) * repeats % 1.0
        return chosen[order[np.searchsorted(edges, t)]]

    return averaged(n, paint)


def gingham(n: int, rng: Rng, colors: Float) -> Image:
    """Woven checks: stripes across stripes, the crossings darkest."""
    light, dark = 0.25 * colors[0] + 0.6, colors[1]
    repeats, duty = int(rng.integers(3, 8)), rng.uniform(0.35, 0.6)

    def paint(u: Float, v: Float) -> Float:
        weight = 0.5 * ((u * repeats % 1.0 < duty).astype(float) + (v * repeats % 1.0 < duty))
        return light + (dark - light) * weight[..., None]

    return averaged(n, paint)


def checks(n: int, rng: Rng, colors: Float) -> Image:
    """A chessboard of two colours."""
    cells = 2 * int(rng.integers(2, 5))
    return ramp(textures.checker(n, n, (cells, cells)), colors[:2])


def dots(n: int, rng: Rng, colors: Float) -> Image:
    """Dots on a staggered lattice."""
    cells, radius = 2 * int(rng.integers(2, 5)), rng.uniform(0.18, 0.36)
    spots = _pick(rng, colors[1:], min(3, len(colors) - 1))

    def paint(u: Float, v: Float) -> Float:
        row = np.floor(v * cells)
        x = u * cells + 0.5 * (row % 2)
        inside = np.hypot(x % 1.0 - 0.5, v * cells % 1.0 - 0.5) < radius
        spot = spots[((np.floor(x) % cells + row) % len(spots)).astype(int)]
        return np.where(inside[..., None], spot, colors[0])

    return averaged(n, paint)


def chips(n: int, rng: Rng, colors: Float) -> Image:
    """Terrazzo: angular chips of several colours and sizes in a pale ground."""
    count = int(rng.integers(90, 260))
    centres, size = rng.random((count, 2)), rng.lognormal(0, 0.35, count)
    tones = varied(rng, colors[rng.integers(len(colors), size=count)], 0.1)
    tree = cKDTree(centres, boxsize=1.0)
    reach = 0.42 / math.sqrt(count)
    ground = 0.3 * colors[-1] + 0.45

    def paint(u: Float, v: Float) -> Float:
        far, near = tree.query(np.stack([u, v], axis=-1), k=2)
        inside = (far[..., 0] < reach * size[near[..., 0]]) & (far[..., 1] - far[..., 0] > 0.25 * reach)
        return np.where(inside[..., None], tones[near[..., 0]], ground)

    return averaged(n, paint)


def mosaic(n: int, rng: Rng, colors: Float) -> Image:
    """Broken tiles with grout between."""
    count = int(rng.integers(40, 130))
    centres = rng.random((count, 2))
    tones = varied(rng, colors[rng.integers(len(colors), size=count)], 0.1)
    tree = cKDTree(centres, boxsize=1.0)
    grout = 0.09 / math.sqrt(count)

    def paint(u: Float, v: Float) -> Float:
        far, near = tree.query(np.stack([u, v], axis=-1), k=2)
        return np.where((far[..., 1] - far[..., 0] > grout)[..., None], tones[near[..., 0]], np.full(3, 0.55))

    return averaged(n, paint)


def tiles(n: int, rng: Rng, colors: Float) -> Image:
    """Square tiles with grout, some of another colour."""
    cells = int(rng.choice([4, 6, 8]))
    width = max(0.035, 1.2 * cells / n)
    chosen = colors[np.where(rng.random((cells, cells)) < rng.uniform(0, 0.5), 1, 0)]
    if rng.random() < 0.4:
        chosen = colors[np.add.outer(np.arange(cells), np.arange(cells)) % 2]
    chosen = chosen * np.exp(rng.normal(0, 0.07, (cells, cells, 1)))

    def paint(u: Float, v: Float) -> Float:
        x, y = u * cells, v * cells
        joint = (np.abs(x % 1.0 - 0.5) > 0.5 - width / 2) | (np.abs(y % 1.0 - 0.5) > 0.5 - width / 2)
        return np.where(joint[..., None], 0.5, chosen[y.astype(int), x.astype(int)])

    return averaged(n, paint)


def bricks(n: int, rng: Rng, colors: Float) -> Image:
    """Running bond in the colours of fired clay, or painted over."""
    clay = np.array([[0.32, 0.12, 0.07], [0.5, 0.24, 0.14]]) if rng.random() < 0.5 else 0.75 * colors[:1] + [[0], [0.1]]
    grey = textures.bricks(n, n, (4, 8), seed(rng), mortar=max(0.09, 9.0 / n), variation=0.7)
    mortar = np.array([[0.5, 0.47, 0.43]])
    tone = ramp(np.clip((grey - 0.3) / 0.7, 0, 1), clay)
    weight = np.clip(grey / 0.3, 0, 1)[..., None]
    return np.asarray(mortar * (1 - weight) + tone * weight, dtype=np.float32)


def triangles(n: int, rng: Rng, colors: Float) -> Image:
    """Squares halved along diagonals, patchwork."""
    cells = int(rng.choice([4, 6, 8]))
    tone = rng.integers(len(colors), size=(cells, cells, 2))
    slope = rng.integers(2, size=(cells, cells))

    def paint(u: Float, v: Float) -> Float:
        i, j = (v * cells).astype(int), (u * cells).astype(int)
        x, y = u * cells % 1.0, v * cells % 1.0
        half = np.where(slope[i, j] == 0, x > y, x + y > 1).astype(int)
        return colors[tone[i, j, half]]

    return averaged(n, paint)


def zigzag(n: int, rng: Rng, colors: Float) -> Image:
    """Chevrons, as woven in rugs."""
    chosen = _pick(rng, colors, int(rng.integers(3, 6)))
    across, bands, height = int(rng.integers(2, 6)), int(rng.integers(1, 3)), rng.uniform(0.1, 0.3)

    def paint(u: Float, v: Float) -> Float:
        t = v * bands + height * np.abs(2 * (u * across % 1.0) - 1)
        return chosen[(t * len(chosen) % len(chosen)).astype(int)]

    return averaged(n, paint)


def scales(n: int, rng: Rng, colors: Float) -> Image:
    """Overlapping fans of concentric rings (seigaiha)."""
    cells = int(rng.choice([4, 6]))

    def paint(u: Float, v: Float) -> Float:
        best = np.full(u.shape, -1)
        for row in range(3, -1, -1):  # the lowest fans lie on top
            base = np.floor(v * 2 * cells) + row - 1
            x = u * cells + 0.5 * (base % 2)
            r = np.hypot(x % 1.0 - 0.5, (v * 2 * cells - base - 1) / 2 * 1.0)
            ring = np.clip((1 - r / 0.56) * 4, -1, 3.99)
            best = np.where(r < 0.56, ring.astype(int), best)
        return np.where((best % 2 == 0)[..., None], colors[1], colors[0])

    return averaged(n, paint)


def camouflage(n: int, rng: Rng, colors: Float) -> Image:
    """Noise in steps: islands within islands."""
    field = noise(n, rng, int(rng.integers(2, 5)), octaves=4, contrast=1.6)
    steps = np.sort(rng.uniform(0.3, 0.7, 3))
    width = 0.02
    return ramp(sum(np.clip((field - s) / width + 0.5, 0, 1) for s in steps) / 3.0, colors[:4])


def speckled(n: int, rng: Rng, colors: Float) -> Image:
    """Stoneware: dark specks in a pale glaze."""
    pale = 0.35 * colors[:1] + 0.4
    specks = textures.random_dots(
        n, n, int(rng.integers(60, 200)), (max(0.003, 0.6 / n), max(0.012, 1.0 / n)), seed(rng)
    )
    weight = (0.8 * specks)[..., None]
    return np.asarray(pale * (1 - weight) + 0.12 * colors[1] * weight, dtype=np.float32)


def weave(n: int, rng: Rng, colors: Float) -> Image:
    """Plain cloth of two yarns, as fine as four texels a thread."""
    threads = max(4, min(n // 4, 40)) // 2 * 2
    over = textures.checker(n, n, (threads, threads))
    return ramp(0.5 * over + 0.5 * noise(n, rng, 6, contrast=1.2), np.vstack([0.72 * colors[0], colors[0]]))


def art(n: int, rng: Rng, colors: Float) -> Image:
    """An abstract print: discs, bars and rings over a ground."""
    shapes = [
        (
            int(rng.integers(3)),
            *rng.random(2),
            rng.uniform(0.06, 0.3),
            rng.uniform(0, math.pi),
            int(rng.integers(1, len(colors))),
        )
        for _ in range(int(rng.integers(5, 12)))
    ]

    def paint(u: Float, v: Float) -> Float:
        out = np.broadcast_to(colors[0], (*u.shape, 3)).copy()
        for kind, x, y, size, angle, tone in shapes:
            dx, dy = (u - x + 0.5) % 1.0 - 0.5, (v - y + 0.5) % 1.0 - 0.5
            r = np.hypot(dx, dy)
            along, across = dx * math.cos(angle) + dy * math.sin(angle), dy * math.cos(angle) - dx * math.sin(angle)
            bar = (np.abs(along) < min(1.4 * size, 0.35)) & (np.abs(across) < 0.22 * size)
            inside = (r < size, bar, np.abs(r - size) < 0.18 * size)[kind]
            out[inside] = colors[tone]
        return out

    return averaged(n, paint)


PATTERNS: dict[str, Callable[[int, Rng, Float], Image]] = {
    "plain": plain,
    "cloudy": cloudy,
    "marble": marble,
    "granite": granite,
    "wood": wood,
    "planks": planks,
    "stripes": stripes,
    "gingham": gingham,
    "checks": checks,
    "dots": dots,
    "chips": chips,
    "mosaic": mosaic,
    "tiles": tiles,
    "bricks": bricks,
    "triangles": triangles,
    "zigzag": zigzag,
    "scales": scales,
    "camouflage": camouflage,
    "speckled": speckled,
    "weave": weave,
    "art": art,
}


def pattern(name: str, n: int, rng: Rng, colors: Float, mottle: float = 0.07) -> Image:
    """A pattern with faint mottling over it, every texel within what paint can be."""
    painted = PATTERNS[name](n, rng, colors)
    wear = noise(n, rng, 3, octaves=6, gain=0.6) - np.float32(0.5)
    return np.clip(painted * np.exp(np.float32(5 * mottle) * wear)[..., None], 0.01, 0.88).astype(np.float32)
