"""Chairs and stools with thin legs and slats. The front faces -y."""

from dataclasses import dataclass

import numpy as np

from twinlens.families.draws import Rng, one_of
from twinlens.families.furniture import Piece, board
from twinlens.families.things.pieces import Part, standing
from twinlens.families.things.sweeps import arc, circle, tube, tubes
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

_SEAT = 0.45  # metres
_STRETCHER = 0.16  # metres, the height of the bars between a chair's legs


def _pairs(*points: tuple[float, float, float]) -> Float:
    """The points, and those mirrored to the other side of x = 0: paths (2, N, 3)."""
    right = np.array(points)
    return np.stack([right, right * [-1, 1, 1]])


@dataclass(frozen=True)
class _Chair:
    """A chair's measures in metres: half its width and depth, its height, how far its back leans, a leg's radius."""

    half: float
    deep: float
    top: float
    lean: float
    thin: float

    @property
    def inner(self) -> float:
        """Half the width between the legs at the seat."""
        return self.half - 0.02

    def back_at(self, height: float) -> float:
        """The y of the middle of the back at a height."""
        heights = [_SEAT - 0.02, _SEAT, self.top]
        places = [self.deep - 0.03, self.deep - 0.02, self.deep + self.lean]
        return float(np.interp(height, heights, places))

    def legs(self) -> Mesh:
        """Two straight legs at the front, two at the back that bend and carry the back, and the bars between them."""
        half, deep, inner, thin = self.half, self.deep, self.inner, self.thin
        front = _pairs((half, -deep, 0), (inner, 0.02 - deep, _SEAT - 0.03))
        back = _pairs(
            (half, deep + 0.03, 0),
            (inner, deep - 0.02, _SEAT),
            (inner, deep + self.lean, self.top),
        )
        bent = np.stack([arc(leg) for leg in back])
        at_side = half - 0.008
        sides = _pairs((at_side, -deep, _STRETCHER), (at_side, deep + 0.01, _STRETCHER))
        middle = [[-at_side, 0, _STRETCHER], [at_side, 0, _STRETCHER]]
        return shapes.merged(
            [
                tubes(front, thin),
                tubes(bent, thin),
                tubes(sides, 0.6 * thin, 8),
                tube(middle, 0.6 * thin, 8),
            ]
        )

    def rail(self) -> Mesh:
        """The top rail of the back."""
        height = self.top - 0.04
        middle = (0.0, self.back_at(height), height)
        return board((2 * self.inner, 0.016, 0.06), middle, 0.005)

    def slats(self, count: int) -> list[Mesh]:
        """Level slats between the seat and the top rail."""
        heights = np.linspace(_SEAT + 0.1, self.top - 0.14, count).tolist()
        size = (2 * self.inner, 0.01, 0.028)
        return [board(size, (0.0, self.back_at(z), z), 0.003) for z in heights]

    def bars(self, count: int, radius: float) -> Mesh:
        """Thin upright bars between the seat and the top rail."""
        x = np.linspace(-0.8, 0.8, count) * self.inner
        heights = np.linspace(_SEAT - 0.01, self.top - 0.04, 5)
        y = [self.back_at(float(height)) for height in heights]
        line = np.column_stack([np.zeros(5), y, heights])
        paths = line + x[:, None, None] * np.array([1.0, 0, 0])
        return tubes(paths, radius, 8)


def slatted_chair(rng: Rng) -> Piece:
    """A chair of 0.78 to 1.02 m with round legs, stretchers, and a back of thin slats or bars."""
    half, deep = rng.uniform(0.19, 0.23), rng.uniform(0.19, 0.23)
    top, lean = rng.uniform(0.78, 1.02), rng.uniform(0.05, 0.11)
    chair = _Chair(half, deep, top, lean, rng.uniform(0.009, 0.016))
    seat = board((2 * half, 2 * deep, 0.03), (0, 0, _SEAT - 0.015), 0.012)
    back = [chair.rail()]
    if rng.random() < 0.6:
        count = int(rng.integers(5, 10))
        back.append(chair.bars(count, rng.uniform(0.004, 0.007)))
    else:
        back += chair.slats(int(rng.integers(3, 6)))
    word = one_of(rng, ["wood", "wood", "paint", "white"])
    return standing(
        "slatted-chair",
        Part("frame", chair.legs(), word),
        Part("slats", shapes.merged(back), word),
        Part("seat", seat, one_of(rng, [word, "wood", "fabric"])),
    )


def stool(rng: Rng) -> Piece:
    """A stool of 0.42 to 0.8 m with three or four slanted legs and a ring between them."""
    tall, radius = rng.uniform(0.42, 0.78), rng.uniform(0.13, 0.18)
    thin, count = rng.uniform(0.008, 0.014), int(rng.integers(3, 5))
    angle = 2 * np.pi * np.arange(count) / count + rng.uniform(0, 2)
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=-1)
    foot = 1.25 * radius * outward
    top = 0.75 * radius * outward + [0, 0, tall - 0.03]
    legs = tubes(np.stack([foot, top], axis=1), [thin, thin], 10)
    # The ring touches the legs at this share of their height.
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
