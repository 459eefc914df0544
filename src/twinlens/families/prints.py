"""Patterns that somebody designed: stripes, checks, tiles, mosaics, chevrons, prints. See `patterns`."""

import math

import numpy as np
from scipy.spatial import cKDTree

from twinlens.families.brushes import Image, Rng, averaged, pick, ramp
from twinlens.families.palettes import varied
from twinlens.geometry import Float
from twinlens.scenes import textures


def stripes(n: int, rng: Rng, colors: Float) -> Image:
    """Bands of several widths, repeated."""
    chosen = pick(rng, colors, int(rng.integers(2, 5)))
    repeats, along_v = int(rng.integers(2, 6)), rng.random() < 0.5
    edges = np.cumsum(rng.dirichlet(np.full(2 * len(chosen), 2.0)))
    order = np.append(np.tile(np.arange(len(chosen)), 2), 0)

    def paint(u: Float, v: Float) -> Float:
        t = (v if along_v else u) * repeats % 1.0
        return np.asarray(chosen[order[np.searchsorted(edges, t)]])

    return averaged(n, paint)


def gingham(n: int, rng: Rng, colors: Float) -> Image:
    """Woven checks: stripes across stripes, the crossings darkest."""
    light, dark = 0.25 * colors[0] + 0.6, colors[1]
    repeats, duty = int(rng.integers(3, 8)), rng.uniform(0.35, 0.6)

    def paint(u: Float, v: Float) -> Float:
        weight = 0.5 * ((u * repeats % 1.0 < duty).astype(float) + (v * repeats % 1.0 < duty))
        return np.asarray(light + (dark - light) * weight[..., None])

    return averaged(n, paint)


def checks(n: int, rng: Rng, colors: Float) -> Image:
    """A chessboard of two colours."""
    cells = 2 * int(rng.integers(2, 5))
    return ramp(textures.checker(n, n, (cells, cells)), colors[:2])


def dots(n: int, rng: Rng, colors: Float) -> Image:
    """Dots on a staggered lattice."""
    cells, radius = 2 * int(rng.integers(2, 5)), rng.uniform(0.18, 0.36)
    spots = pick(rng, colors[1:], min(3, len(colors) - 1))

    def paint(u: Float, v: Float) -> Float:
        row = np.floor(v * cells)
        x = u * cells + 0.5 * (row % 2)
        inside = np.hypot(x % 1.0 - 0.5, v * cells % 1.0 - 0.5) < radius
        spot = spots[((np.floor(x) % cells + row) % len(spots)).astype(int)]
        return np.asarray(np.where(inside[..., None], spot, colors[0]))

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
        return np.asarray(np.where(inside[..., None], tones[near[..., 0]], ground))

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
        return np.asarray(
            np.where((far[..., 1] - far[..., 0] > grout)[..., None], tones[near[..., 0]], np.full(3, 0.55))
        )

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
        return np.asarray(np.where(joint[..., None], 0.5, chosen[y.astype(int), x.astype(int)]))

    return averaged(n, paint)


def triangles(n: int, rng: Rng, colors: Float) -> Image:
    """Squares halved along diagonals, patchwork."""
    cells = int(rng.choice([4, 6, 8]))
    tone = rng.integers(len(colors), size=(cells, cells, 2))
    slope = rng.integers(2, size=(cells, cells))

    def paint(u: Float, v: Float) -> Float:
        i, j = (v * cells).astype(int), (u * cells).astype(int)
        x, y = u * cells % 1.0, v * cells % 1.0
        half = np.where(slope[i, j] == 0, x > y, x + y > 1).astype(int)
        return np.asarray(colors[tone[i, j, half]])

    return averaged(n, paint)


def zigzag(n: int, rng: Rng, colors: Float) -> Image:
    """Chevrons, as woven in rugs."""
    chosen = pick(rng, colors, int(rng.integers(3, 6)))
    across, bands, height = int(rng.integers(2, 6)), int(rng.integers(1, 3)), rng.uniform(0.1, 0.3)

    def paint(u: Float, v: Float) -> Float:
        t = v * bands + height * np.abs(2 * (u * across % 1.0) - 1)
        return np.asarray(chosen[(t * len(chosen) % len(chosen)).astype(int)])

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
        return np.asarray(np.where((best % 2 == 0)[..., None], colors[1], colors[0]))

    return averaged(n, paint)


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
