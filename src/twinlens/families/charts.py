"""Printed test charts: float32 (n, n, 3), no mark finer than two texels."""

from collections.abc import Callable

import numpy as np

from twinlens.families.colors import Palette, shuffled, varied
from twinlens.families.draws import Rng, one_of, weighted
from twinlens.families.patterns import Image, pattern, ramp, texture_seed
from twinlens.scenes import textures

_PAPER = np.array([[0.03, 0.03, 0.035], [0.8, 0.79, 0.76]])


def _checker(rng: Rng, n: int, palette: Palette) -> Image:
    cells = int(rng.integers(5, max(6, min(12, n // 4))))
    return ramp(textures.checker(n, n, (cells, cells)), _PAPER)


def _star(rng: Rng, n: int, palette: Palette) -> Image:
    return ramp(textures.siemens_star(n, n, one_of(rng, [8, 12, 18])), _PAPER)


def _dots(rng: Rng, n: int, palette: Palette) -> Image:
    """A regular grid of dots, as for calibration."""
    cells = int(rng.integers(5, max(6, min(11, n // 6))))
    at = (np.arange(n * 3) + 0.5) / (n * 3) * cells % 1.0 - 0.5
    disc = (np.hypot(at[:, None], at) > 0.3).reshape(n, 3, n, 3).mean(axis=(1, 3))
    return ramp(disc, _PAPER)


def _random_squares(rng: Rng, n: int, palette: Palette) -> Image:
    """Random grey squares, as in random-dot stereograms."""
    cells = min(n // 2, one_of(rng, [16, 24, 32]))
    return ramp(textures.value_noise(n, n, (cells, cells), texture_seed(rng), "nearest"), _PAPER)


def _noise(rng: Rng, n: int, palette: Palette) -> Image:
    """Noise at all scales."""
    grey = textures.fractal_noise(n, n, (4, 4), texture_seed(rng), 7, gain=0.75, contrast=1.8)
    return ramp(grey, np.vstack([_PAPER[:1], varied(rng, palette.accents[:1]), _PAPER[1:]]))


def _bars(rng: Rng, n: int, palette: Palette) -> Image:
    """Bars of increasing frequency."""
    u = (np.arange(n * 4) + 0.5) / (n * 4)
    most = min(n / 5, 28)
    phase = 3 * u + 0.5 * (most - 3) * u**2
    line = (phase % 1.0 < 0.5).reshape(n, 4).mean(axis=1)
    grey = np.broadcast_to(line, (n, n))
    return ramp(grey if rng.random() < 0.5 else grey.T, _PAPER)


def _color_checker(rng: Rng, n: int, palette: Palette) -> Image:
    """Patches of colour and a row of greys in a dark frame."""
    columns, rows = 6, 4
    tones = varied(rng, np.vstack([palette.accents] * 4)[:24], 0.25).reshape(rows, columns, 3)
    tones[-1] = np.linspace(0.03, 0.8, columns)[:, None]
    at = (np.arange(n) + 0.5) / n
    i, j = (at * rows).astype(int), (at * columns).astype(int)
    inside = (np.abs(at * rows % 1 - 0.5) < 0.42)[:, None] & (np.abs(at * columns % 1 - 0.5) < 0.42)
    return np.where(inside[..., None], tones[i][:, j], 0.02).astype(np.float32)


def _poster(rng: Rng, n: int, palette: Palette) -> Image:
    """A print in colour."""
    name = one_of(rng, ["art", "mosaic", "triangles", "marble", "camouflage", "chips", "zigzag", "scales"])
    return pattern(name, n, rng, varied(rng, shuffled(rng, palette.accents)))


CHARTS: tuple[tuple[Callable[[Rng, int, Palette], Image], float], ...] = (
    (_checker, 1.2),
    (_star, 0.8),
    (_dots, 1.0),
    (_random_squares, 1.0),
    (_noise, 1.0),
    (_bars, 0.6),
    (_color_checker, 0.8),
    (_poster, 3.0),
)
"""Every chart and its weight in draws."""


def draw_chart(rng: Rng, n: int, palette: Palette) -> Image:
    """A chart of n x n texels with a margin of paper."""
    draw = weighted(rng, [chart for chart, _ in CHARTS], [weight for _, weight in CHARTS])
    made = np.array(draw(rng, n, palette), dtype=np.float32)
    margin = max(1, n // 24)
    for edge in (made[:margin], made[-margin:], made[:, :margin], made[:, -margin:]):
        edge[:] = _PAPER[1]
    return made
