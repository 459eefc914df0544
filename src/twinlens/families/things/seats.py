"""Chairs and stools with thin legs and slats. The front faces -y."""

from collections.abc import Callable

import numpy as np

from twinlens.families.draws import Rng, one_of
from twinlens.families.furniture import Piece, board
from twinlens.families.things.pieces import Part, standing
from twinlens.families.things.sweeps import arc, circle, tube, tubes
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

_SEAT = 0.45  # metres


def _pairs(*points: tuple[float, float, float]) -> Float:
    """The points, and those mirrored to the other side of x = 0: paths (2, N, 3)."""
    one = np.array(points)
    return np.stack([one, one * [-1, 1, 1]])


def slatted_chair(rng: Rng) -> Piece:
    """A chair of 0.78 to 1.02 m with round legs, stretchers, and a back of thin slats or bars."""
    half, deep = rng.uniform(0.19, 0.23), rng.uniform(0.19, 0.23)
    top, lean = rng.uniform(0.78, 1.02), rng.uniform(0.05, 0.11)
    thin = rng.uniform(0.009, 0.016)
    inner = half - 0.02
    front = _pairs((half, -deep, 0), (inner, 0.02 - deep, _SEAT - 0.03))
    back = _pairs(
        (half, deep + 0.03, 0), (inner, deep - 0.02, _SEAT), (inner, deep + lean, top)
    )
    legs = [tubes(front, thin), tubes(np.stack([arc(leg) for leg in back]), thin)]
    low = _pairs((half - 0.008, -deep, 0.16), (half - 0.008, deep + 0.01, 0.16))
    middle = [[0.008 - half, 0, 0.16], [half - 0.008, 0, 0.16]]
    legs += [tubes(low, 0.6 * thin, 8), tube(middle, 0.6 * thin, 8)]
    seat = board((2 * half, 2 * deep, 0.03), (0, 0, _SEAT - 0.015), 0.012)

    def on_back(height: float) -> float:
        """The y of the middle of the back at a height."""
        places = [_SEAT - 0.02, _SEAT, top]
        return float(np.interp(height, places, [deep - 0.03, deep - 0.02, deep + lean]))

    rail = (0.0, on_back(top - 0.04), top - 0.04)
    slats = [board((2 * inner, 0.016, 0.06), rail, 0.005)]
    if rng.random() < 0.6:
        slats.append(_bars(rng, inner, on_back, top))
    else:
        for height in np.linspace(_SEAT + 0.1, top - 0.14, int(rng.integers(3, 6))):
            at = (0.0, on_back(float(height)), float(height))
            slats.append(board((2 * inner, 0.01, 0.028), at, 0.003))
    word = one_of(rng, ["wood", "wood", "paint", "white"])
    return standing(
        "slatted-chair",
        Part("frame", shapes.merged(legs), word),
        Part("slats", shapes.merged(slats), word),
        Part("seat", seat, one_of(rng, [word, "wood", "fabric"])),
    )


def _bars(
    rng: Rng, inner: float, on_back: Callable[[float], float], top: float
) -> Mesh:
    """Thin upright bars between the seat and the top rail."""
    x = np.linspace(-0.8, 0.8, int(rng.integers(5, 10))) * inner
    heights = np.linspace(_SEAT - 0.01, top - 0.04, 5)
    y = [on_back(float(height)) for height in heights]
    line = np.column_stack([np.zeros(5), y, heights])
    paths = line + x[:, None, None] * np.array([1.0, 0, 0])
    return tubes(paths, rng.uniform(0.004, 0.007), 8)


def stool(rng: Rng) -> Piece:
    """A stool of 0.42 to 0.8 m with three or four slanted legs and a ring between them."""
    tall, radius = rng.uniform(0.42, 0.78), rng.uniform(0.13, 0.18)
    thin, count = rng.uniform(0.008, 0.014), int(rng.integers(3, 5))
    angle = 2 * np.pi * np.arange(count) / count + rng.uniform(0, 2)
    way = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=-1)
    foot, top = 1.25 * radius * way, 0.75 * radius * way + [0, 0, tall - 0.03]
    legs = tubes(np.stack([foot, top], axis=1), [thin, thin], 10)
    share = 0.3
    between = 1.25 * radius + share * (0.75 - 1.25) * radius
    ring = tube(circle(between, 40, share * (tall - 0.03)), 0.6 * thin, 8, closed=True)
    seat = tube([[0, 0, tall - 0.035], [0, 0, tall]], radius, 40)
    word = one_of(rng, ["wood", "metal", "paint"])
    return standing(
        "stool",
        Part("legs", legs, word),
        Part("ring", ring, "metal"),
        Part("seat", seat, one_of(rng, ["wood", word])),
    )
