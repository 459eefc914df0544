"""Coloured textures of scene families: float32 (n, n, 3), linear, periodic in both directions, averaged over texels.

A pattern is drawn for a number of texels that the caller takes from how large a pixel is where the surface is seen:
nothing in it is finer than a texel, so two pixels are its finest period. Each is painted over with faint mottling at
several scales, as paint, glaze and cloth have it, so that no surface is one flat tone.
"""

from collections.abc import Callable

import numpy as np

from twinlens.families import prints
from twinlens.families.brushes import Image, Rng, noise, ramp, seed
from twinlens.families.palettes import STONES, WOODS, varied
from twinlens.geometry import Float
from twinlens.scenes import textures


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
    return np.asarray(np.clip(ramp(rolled, tones) * (light * groove)[..., None], 0, 0.9), dtype=np.float32)


def bricks(n: int, rng: Rng, colors: Float) -> Image:
    """Running bond in the colours of fired clay, or painted over."""
    clay = np.array([[0.32, 0.12, 0.07], [0.5, 0.24, 0.14]]) if rng.random() < 0.5 else 0.75 * colors[:1] + [[0], [0.1]]
    grey = textures.bricks(n, n, (4, 8), seed(rng), mortar=max(0.09, 9.0 / n), variation=0.7)
    mortar = np.array([[0.5, 0.47, 0.43]])
    tone = ramp(np.clip((grey - 0.3) / 0.7, 0, 1), clay)
    weight = np.clip(grey / 0.3, 0, 1)[..., None]
    return np.asarray(mortar * (1 - weight) + tone * weight, dtype=np.float32)


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


PATTERNS: dict[str, Callable[[int, Rng, Float], Image]] = {
    "plain": plain,
    "cloudy": cloudy,
    "marble": marble,
    "granite": granite,
    "wood": wood,
    "planks": planks,
    "stripes": prints.stripes,
    "gingham": prints.gingham,
    "checks": prints.checks,
    "dots": prints.dots,
    "chips": prints.chips,
    "mosaic": prints.mosaic,
    "tiles": prints.tiles,
    "bricks": bricks,
    "triangles": prints.triangles,
    "zigzag": prints.zigzag,
    "scales": prints.scales,
    "camouflage": camouflage,
    "speckled": speckled,
    "weave": weave,
    "art": prints.art,
}


def pattern(name: str, n: int, rng: Rng, colors: Float, mottle: float = 0.07) -> Image:
    """A pattern with faint mottling over it, every texel within what paint can be."""
    painted = PATTERNS[name](n, rng, colors)
    wear = noise(n, rng, 3, octaves=6, gain=0.6) - np.float32(0.5)
    return np.asarray(np.clip(painted * np.exp(np.float32(5 * mottle) * wear)[..., None], 0.01, 0.88), dtype=np.float32)
