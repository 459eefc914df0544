"""Procedural patterns as arrays: float32 (height, width) in [0, 1], the same on every machine for the same seed.

Column 0 is u = 0; row 0 is v = 1, the top. Periodic patterns tile without a seam in both directions. Hard edges are
averaged over each texel.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float

Image = NDArray[np.float32]
_SUPERSAMPLES = 4
_SMOOTH_VARIANCE = 0.05116252195061102
"""Variance of smooth value noise: (mean of w^2 + (1 - w)^2)^2 / 12, w being the quintic weight over a cell."""


def value_noise(
    width: int,
    height: int,
    cells: tuple[int, int],
    seed: int,
    interpolation: str = "smooth",
) -> Image:
    """Uniform random values on a lattice of `cells` = (nx, ny), periodic, mean 1/2; "smooth" (quintic) or "nearest".

    Source: K. Perlin, Improving Noise, SIGGRAPH 2002, for the quintic.
    """
    nx, ny = cells
    lattice = np.random.default_rng(seed).random((ny, nx)).astype(np.float32)
    return _interpolated(
        _interpolated(lattice, height, 0, interpolation), width, 1, interpolation
    )


def _interpolated(values: Image, size: int, axis: int, interpolation: str) -> Image:
    """Periodic values interpolated at the centres of `size` texels along one axis."""
    cells = values.shape[axis]
    position = (np.arange(size) + 0.5) / size * cells
    index = np.floor(position).astype(int)
    here: Image = np.take(values, index % cells, axis)
    if interpolation == "nearest":
        return here
    t = (position - index).astype(np.float32)
    fade = t**3 * (t * (6 * t - 15) + 10)
    step = np.take(values, (index + 1) % cells, axis)
    step -= here
    step *= fade if axis == 1 else fade[:, None]
    here += step
    return here


def fractal_noise(
    width: int,
    height: int,
    cells: tuple[int, int],
    seed: int,
    octaves: int = 6,
    gain: float = 0.5,
    contrast: float = 1,
) -> Image:
    """Octaves of value noise, each twice as fine and `gain` times as strong; periodic, mean near 1/2.

    The sum is scaled so that its expected standard deviation is `contrast`/5, then clipped to [0, 1]. Its power
    spectrum falls as f^-(2 + 2H) with H = -log2(gain). Source: Musgrave et al., Texturing and Modeling, 3rd ed., 2003.
    """
    total = np.zeros((height, width), dtype=np.float32)
    variance = 0.0
    for octave in range(octaves):
        fine = (cells[0] << octave, cells[1] << octave)
        if fine[0] > width or fine[1] > height:
            break  # cells finer than a texel would alias
        strength = gain**octave
        noise = value_noise(width, height, fine, seed + 7919 * octave)
        noise -= np.float32(0.5)
        noise *= np.float32(strength)
        total += noise
        variance += strength**2 * _SMOOTH_VARIANCE
    total *= np.float32(0.2 * contrast / math.sqrt(variance or 1.0))
    total += np.float32(0.5)
    return np.clip(total, 0, 1, out=total)


def random_dots(
    width: int, height: int, count: int, radius: tuple[float, float], seed: int
) -> Image:
    """`count` round dots, 1 on 0, radii uniform in `radius` = (least, most) as fractions of the width; periodic."""
    rng = np.random.default_rng(seed)
    centres = rng.random((count, 2)) * (width, height)
    radii = rng.uniform(*radius, count) * width
    out = np.zeros((height, width), dtype=np.float32)
    for (x, y), r in zip(centres, radii, strict=True):
        columns = np.arange(math.floor(x - r) - 1, math.ceil(x + r) + 2)
        rows = np.arange(math.floor(y - r) - 1, math.ceil(y + r) + 2)
        distance = np.hypot(columns + 0.5 - x, rows[:, None] + 0.5 - y)
        dot = np.clip(r - distance + 0.5, 0, 1)
        np.maximum.at(
            out, np.ix_(rows % height, columns % width), dot.astype(np.float32)
        )
    return out


def checker(width: int, height: int, cells: tuple[int, int], seed: int = 0) -> Image:
    """A chessboard of `cells` = (nx, ny) squares, 1 at the top left; periodic if both counts are even."""
    nx, ny = cells
    return _averaged(
        width, height, lambda u, v: (np.floor(u * nx) + np.floor(v * ny)) % 2 == 0
    )


def stripes(
    width: int,
    height: int,
    count: int,
    seed: int = 0,
    duty: float = 0.5,
    profile: str = "square",
    along: str = "u",
) -> Image:
    """`count` stripes across the picture, "square" (1 for the first `duty` of each period) or "sine"; periodic."""

    def pattern(u: Float, v: Float) -> Float:
        phase = (u if along == "u" else v) * count % 1.0
        if profile == "sine":
            return 0.5 - 0.5 * np.cos(2 * np.pi * phase)
        return (phase < duty).astype(np.float64)

    return _averaged(width, height, pattern)


def siemens_star(
    width: int, height: int, spokes: int, seed: int = 0, radius: float = 0.48
) -> Image:
    """`spokes` bright wedges around the centre, grey 1/2 outside `radius` (in widths)."""

    def pattern(u: Float, v: Float) -> Float:
        x, y = u - 0.5, (v - 0.5) * height / width
        wedge = np.floor(np.arctan2(y, x) / np.pi * spokes) % 2 == 0
        return np.where(np.hypot(x, y) <= radius, wedge, 0.5)

    return _averaged(width, height, pattern)


def bricks(
    width: int,
    height: int,
    cells: tuple[int, int],
    seed: int,
    mortar: float = 0.08,
    variation: float = 0.5,
) -> Image:
    """Running bond of `cells` = (bricks across, courses): mortar 0, bricks random in [1 - variation, 1].

    `mortar` is its width as a fraction of a course. Periodic for an even number of courses.
    """
    nx, ny = cells
    tones = 1 - variation * np.random.default_rng(seed).random((ny, nx))
    aspect = width / nx / (height / ny)  # of one brick

    def pattern(u: Float, v: Float) -> Float:
        course = np.floor(v * ny).astype(int)
        across = u * nx + 0.5 * (course % 2)
        x, y = across % 1.0, v * ny % 1.0
        brick = (np.abs(x - 0.5) * aspect < 0.5 * aspect - 0.5 * mortar) & (
            np.abs(y - 0.5) < 0.5 - 0.5 * mortar
        )
        return np.where(
            brick, tones[course % ny, np.floor(across).astype(int) % nx], 0.0
        )

    return _averaged(width, height, pattern)


def wood(
    width: int,
    height: int,
    rings: int,
    seed: int,
    waviness: float = 0.6,
    grain: float = 0.35,
) -> Image:
    """Wood with fibres along v: `rings` wavy growth rings across u, and fine fibres; periodic."""
    wave = fractal_noise(width, height, (2, 1), seed, octaves=4, gain=0.45) - 0.5
    u = (np.arange(width) + 0.5) / width
    phase = (u * rings + wave * waviness * rings) % 1.0
    ring = np.where(
        phase < 0.85, phase / 0.85, (1 - phase) / 0.15
    )  # gradual early wood, abrupt late wood
    fibre = fractal_noise(
        width,
        height,
        (max(width // 16, 1), max(height // 256, 1)),
        seed + 1,
        octaves=4,
        gain=0.75,
    )
    return np.clip(
        (1 - grain) * ring + grain * (2.2 * (fibre - 0.5) + 0.5), 0, 1
    ).astype(np.float32)


def ramp(grey: NDArray[Any], colors: NDArray[Any]) -> Image:
    """Grey values in [0, 1] mapped to a gradient through colours (K, 3) at even steps."""
    stops = np.linspace(0, 1, len(colors))
    return np.stack(
        [np.interp(grey, stops, colors[:, c]) for c in range(3)], axis=-1
    ).astype(np.float32)


def gradient(width: int, height: int, seed: int = 0, along: str = "v") -> Image:
    """A ramp: 0 at the bottom and 1 at the top (along v), or left to right (along u)."""
    ramp = (
        (np.arange(width) + 0.5) / width
        if along == "u"
        else 1 - (np.arange(height)[:, None] + 0.5) / height
    )
    return np.broadcast_to(ramp, (height, width)).astype(np.float32)


def _averaged(width: int, height: int, pattern: Callable[[Float, Float], Any]) -> Image:
    """Mean of pattern(u, v) over a grid inside each texel; u points right and v DOWN, in [0, 1]."""
    n = _SUPERSAMPLES
    out = np.zeros((height, width))
    for dy in range(n):
        for dx in range(n):
            u = (np.arange(width) + (dx + 0.5) / n) / width
            v = (np.arange(height) + (dy + 0.5) / n) / height
            out += pattern(u[None, :], v[:, None])
    return (out / n**2).astype(np.float32)
