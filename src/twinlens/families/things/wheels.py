"""Wheels with spokes, and bicycles of them."""

import math

import numpy as np

from twinlens.families.draws import Rng
from twinlens.families.furniture import Piece
from twinlens.families.things.pieces import Part, standing
from twinlens.families.things.sweeps import circle, tube, tubes
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh


def wheel_parts(radius: float, tire: float, spokes: int) -> tuple[Mesh, Mesh, Mesh]:
    """Tire, rim with spokes and hub about the z axis; `radius` is that of the tire's outside, `tire` its thickness."""
    middle = radius - tire / 2
    rubber = tube(circle(middle, 56), tire / 2, 12, closed=True)
    inner = radius - tire - 0.006
    rim = tube(circle(inner, 56), 0.009, 8, closed=True)
    flange, wide = 0.022, 0.032
    # Spokes alternate between the two ends of the hub, and cross: they leave it along its tangent.
    number = np.arange(spokes)
    angle = 2 * math.pi * number / spokes
    side = np.where(number % 2 == 0, wide, -wide)
    lead = np.where(number % 4 < 2, 1.0, -1.0) * math.radians(55)
    start = _around(flange, angle + lead, 0.9 * side)
    end = _around(inner, angle, 0.08 * side)
    bars = tubes(np.stack([start, end], axis=1), 0.0012, 5)
    hub = tube([[0, 0, -wide], [0, 0, wide]], flange + 0.002, 20)
    return rubber, shapes.merged([rim, bars]), hub


def _around(radius: float, angle: Float, height: Float) -> Float:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)


def spoked_wheel(rng: Rng) -> Piece:
    """A bicycle's wheel of 0.4 to 0.7 m that stands on its tire and leans back a little."""
    radius, tire = rng.uniform(0.2, 0.35), rng.uniform(0.022, 0.05)
    spokes = 4 * int(rng.integers(5, 10))
    turn = rotation([1, 0, 0], 90.0 - rng.uniform(2, 14))
    pose = turn @ rotation([0, 0, 1], rng.uniform(0, 360)) @ translation([0, 0, 0])
    rubber, metal, hub = (
        shapes.transformed(mesh, pose) for mesh in wheel_parts(radius, tire, spokes)
    )
    return standing(
        "spoked-wheel",
        Part("tire", rubber, "rubber"),
        Part("rim", metal, "metal"),
        Part("hub", hub, "metal"),
    )
