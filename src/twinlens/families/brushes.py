"""What patterns are painted with: noise, ramps of colour, and means over texels."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.scenes import textures

Rng = np.random.Generator
Image = NDArray[np.float32]


def seed(rng: Rng) -> int:
    """A seed for the functions of `twinlens.scenes.textures`."""
    return int(rng.integers(1 << 31))


def noise(n: int, rng: Rng, cells: int = 4, octaves: int = 6, gain: float = 0.55, contrast: float = 1.0) -> Image:
    """Fractal noise (n, n) in [0, 1], its coarsest cells 1/cells wide."""
    made: Image = textures.fractal_noise(n, n, (cells, cells), seed(rng), octaves, gain, contrast)
    return made


def ramp(grey: Float | Image, colors: Float) -> Image:
    """Grey values in [0, 1] through colours (K, 3) spread evenly."""
    stops = np.linspace(0, 1, len(colors))
    return np.stack([np.interp(grey, stops, colors[:, c]) for c in range(3)], axis=-1).astype(np.float32)


def averaged(n: int, paint: Callable[[Float, Float], Float]) -> Image:
    """paint(u, v) -> (..., 3) averaged over each texel; u rightwards, v downwards, both in [0, 1)."""
    inner = 3 if n <= 160 else 2 if n <= 320 else 1
    at = (np.arange(n * inner) + 0.5) / (n * inner)
    u, v = np.meshgrid(at, at)
    fine = paint(u, v)
    return np.asarray(fine.reshape(n, inner, n, inner, 3).mean(axis=(1, 3)), dtype=np.float32)


def pick(rng: Rng, colors: Float, count: int) -> Float:
    """So many of the colours, in a random order."""
    return colors[rng.permutation(len(colors))[:count]]
