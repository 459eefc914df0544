"""Wheels with spokes, and bicycles of them."""

import math

import numpy as np

from twinlens.families.draws import Rng
from twinlens.families.furniture import Piece
from twinlens.families.things.pieces import Part, standing
from twinlens.families.things.sweeps import circle, tube, tubes
from twinlens.geometry import Float, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh

_WIRE = 0.003  # metres, radius
_AXLE = 0.05  # metres, from the middle of the hub to its end


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
    """A bicycle's wheel of 0.4 to 0.7 m that leans back on a stand of wire."""
    radius, tire = rng.uniform(0.2, 0.345), rng.uniform(0.022, 0.05)
    spokes = 4 * int(rng.integers(5, 10))
    lean_deg = rng.uniform(6, 18)
    turn = rotation([1, 0, 0], 90.0 - lean_deg) @ rotation(
        [0, 0, 1], rng.uniform(0, 360)
    )
    rubber, metal, hub = wheel_parts(radius, tire, spokes)
    lowest = float(transform_points(turn, rubber.vertices)[:, 2].min())
    pose = translation([0, 0, -lowest]) @ turn
    axle = transform_points(pose, np.zeros(3))
    behind = transform_points(pose, np.array([0, 0, -_AXLE]))
    return standing(
        "spoked-wheel",
        Part("tire", shapes.transformed(rubber, pose), "rubber"),
        Part("rim", shapes.transformed(metal, pose), "metal"),
        Part("hub", shapes.transformed(hub, pose), "metal"),
        Part("stand", _stand(axle, behind, radius), "metal"),
    )


def _stand(axle: Float, behind: Float, radius: float) -> Mesh:
    """Two legs of wire from the axle of a wheel to level feet behind it, on z = 0."""
    near, far = behind[1] + 0.5 * radius, behind[1] + 0.75 * radius
    bars = [tube([axle, behind], 0.006, 10)]
    for side in (-1, 1):
        foot = np.array([side * 0.45 * radius, near, _WIRE])
        end = np.array([side * 0.45 * radius, far, _WIRE])
        top = behind + np.array([0.004 * side, 0.001, 0.0])
        bars.append(tube([top, foot], _WIRE, 8))
        bars.append(tube([foot - [0, 0.002, 0], end], _WIRE, 8))
    return shapes.merged(bars)
