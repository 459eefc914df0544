"""Random draws shared by all families: choices, numbers, and colours in linear RGB."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from twinlens.geometry import Float
from twinlens.scenes.assets import linear_from_srgb

T = TypeVar("T")
Rng = np.random.Generator


def one_of(rng: Rng, options: Sequence[T]) -> T:
    """One of the options, all equally likely."""
    return options[int(rng.integers(len(options)))]


def weighted(rng: Rng, options: Sequence[T], weights: Sequence[float]) -> T:
    """One of the options, with a probability proportional to its weight."""
    p = np.array(weights)
    return options[int(rng.choice(len(options), p=p / p.sum()))]


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """A number whose logarithm is uniform between those of `low` and `high`."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def varied(rng: Rng, colors: Float, amount: float = 0.12) -> Float:
    """The colours (N, 3) with random changes of lightness and warmth, clipped to the albedo of paint."""
    light = np.exp(rng.normal(0, amount, (len(colors), 1)))
    warm = 1 + rng.normal(0, 0.35 * amount, (len(colors), 1)) * np.array(
        [1.0, 0.0, -1.0]
    )
    return np.asarray(np.clip(colors * light * warm, 0.012, 0.86))


@dataclass(frozen=True, eq=False)
class Palette:
    """The colours of one scene, each (N, 3): muted `grounds` for walls and floors, `accents` for objects."""

    grounds: Float
    accents: Float


def _linear(words: str) -> Float:
    """Linear RGB (N, 3) of hexadecimal sRGB colours."""
    encoded = [
        [int(word[i : i + 2], 16) / 255 for i in (0, 2, 4)] for word in words.split()
    ]
    return np.asarray(linear_from_srgb(encoded), dtype=np.float64)


# fmt: off
PALETTES = tuple(Palette(_linear(grounds), _linear(accents)) for grounds, accents in (
    ("e8e2d6 c9d3d6 7f95a3", "1f3b57 d9573f f2c14e 8fb8c4 f4efe6 46606e"),  # harbour
    ("efe3d3 dcc3a6 b7a28c", "c0593a e6a15c 5c6f52 8b3a2b f3e5cf 33483f"),  # terracotta
    ("f2ecd9 d5dcc0 a7b58c", "b7342c e08a2e 6c8f3c f1d36b 7a4b2a 2f5d3a"),  # orchard
    ("e9ebea cfd4d3 aab3b2", "2d3e4f c9a66b 8aa399 d7816a f6f3ec 5e6b73"),  # nordic
    ("d9c7cf a98da0 6b5b7b", "3b2f5c e07a8b f2b880 8d6fb0 f7e3d4 4a6b8a"),  # dusk
    ("e3efe9 b9d8d0 7fb0ac", "0f5e63 f0a35e d94f4f 3f9a8d f6ebd2 24434a"),  # lagoon
    ("efefef d2d2d0 9b9b98", "2b2b2b d7432c f2b233 2f6db3 f7f7f2 6d6d6a"),  # studio
    ("f0dfc2 d8b98a a47c4f", "8c2f1b d98324 f0c94b 5b3a29 6e7f3a f6e8cc"),  # spice
    ("edf1dd cbdcae 93b07a", "3f6b35 f3d34a d96d8e 7fb4d6 fbf7e8 8c5a35"),  # meadow
    ("f4f1ea dfe4ea b6c4d4", "23427a 6f93c7 f4f1ea c9493b d9b36a 33405a"),  # porcelain
    ("ece5d8 d6cbb8 a39a8a", "d02d28 1d4f9c f3bd1f 1f1f1f f3ede0 5f8d7a"),  # bauhaus
    ("dfe0d2 b4bda2 6d7a5c", "27402f 8a9a5b c98b4a 5a3b25 e9e1c7 a33f2e"),  # forest
    ("f9ebe7 f2d3d6 d9b6c4", "e4577a 52b5b0 f7c85c 8a6bb8 fdf4ee 3e7fb5"),  # candy
    ("c9cdd2 8d959e 4f5963", "d98a4b e8e4da 2c343c 7fa0b2 b4553f c7b98a"),  # slate
    ("f0ddc5 ddb892 b98b66", "9c4a2f 3f7f82 e6b35a 6b4a3a f5ead6 c76f55"),  # desert
    ("d8cbb3 a58d6a 6b5137", "5c1f1f 1f3b2d 26324f b08a3e e9dfc8 7a3e22"),  # library
    ("f6f3e4 e4ecc9 c3d39a", "f08a24 f4c430 6aa84f d9412f fbf8ea 2f6f6d"),  # citrus
    ("8f9bb0 56627c 2e374d", "f0b34a d95d55 6fa8c9 e9e4d8 8d7bb5 3f8f7d"),  # midnight
))
WOODS = tuple(map(_linear, (
    "8a5a33 c08a55", "5b3a22 8d6240", "b98d5c dcb98a", "6e4a2f a87a4d", "3f2a1c 6b4a33", "c9a77a e6cfa8",
)))
STONES = tuple(map(_linear, (
    "cfcac0 8f8a80", "e8e4da b9ae9b", "77797c 4b4d50", "d9cbb6 a18b6d", "3b3d42 8d9095", "e9e9e6 9fa6a8",
)))
METALS = tuple(_linear("f0d9a0 e3b58f d9dadb b9bcc2 e8c46a c7cdd6 8d8f94"))
# fmt: on
