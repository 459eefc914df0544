"""Wheels with spokes, and bicycles of them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinlens.families.draws import Rng
from twinlens.families.furniture import Piece
from twinlens.families.things.pieces import Part, standing
from twinlens.families.things.sweeps import arc, circle, tube, tubes
from twinlens.geometry import Float, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh

_WIRE = 0.003  # metres, radius
_LEAN_DEG = 7.0
_AXLE = 0.05  # metres, from the middle of the hub to its end
_FLANGE, _HALF_HUB = 0.022, 0.032  # metres, radius and half length of a hub


def wheel_parts(radius: float, tire: float, spokes: int) -> tuple[Mesh, Mesh, Mesh]:
    """Tire, rim with spokes and hub about the z axis; `radius` is that of the tire's outside, `tire` its thickness."""
    rubber = tube(circle(radius - tire / 2, 56), tire / 2, 12, closed=True)
    inner = radius - tire - 0.006
    rim = tube(circle(inner, 56), 0.009, 8, closed=True)
    bars = _spokes(inner, spokes)
    hub = tube([[0, 0, -_HALF_HUB], [0, 0, _HALF_HUB]], _FLANGE + 0.002, 20)
    return rubber, shapes.merged([rim, bars]), hub


def _spokes(rim: float, count: int) -> Mesh:
    """Spokes from the hub to a rim of this radius. They alternate between the two ends of the hub.

    They cross: every second pair leaves the hub forwards along its tangent, the others backwards.
    """
    number = np.arange(count)
    angle = 2 * math.pi * number / count
    side = np.where(number % 2 == 0, _HALF_HUB, -_HALF_HUB)
    lead = np.where(number % 4 < 2, 1.0, -1.0) * math.radians(55)
    start = _around(_FLANGE, angle + lead, 0.9 * side)
    end = _around(rim, angle, 0.08 * side)
    return tubes(np.stack([start, end], axis=1), 0.0012, 5)


def _around(radius: float, angle: Float, height: Float) -> Float:
    """Points (N, 3) at angles and heights of a cylinder about the z axis."""
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)


def spoked_wheel(rng: Rng) -> Piece:
    """A bicycle's wheel of 0.4 to 0.7 m that leans back on a stand of wire."""
    radius, tire = rng.uniform(0.2, 0.345), rng.uniform(0.022, 0.05)
    spokes = 4 * int(rng.integers(5, 10))
    upright = rotation([1, 0, 0], 90.0 - rng.uniform(6, 18))
    turn = upright @ rotation([0, 0, 1], rng.uniform(0, 360))
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


@dataclass(frozen=True, eq=False)
class _Joints:
    """The places (3,) of an upright bicycle's parts, which faces +x; metres, in the plane y = 0."""

    rear: Float
    front: Float
    crank: Float
    saddle: Float
    seat: Float
    head: Float
    neck: Float
    bar: Float

    @staticmethod
    def draw(rng: Rng, radius: float) -> "_Joints":
        """Of a bicycle whose wheels have this radius."""
        base = rng.uniform(0.98, 1.08)
        crank = np.array([0.42, 0, 0.28])
        saddle = np.array([0.22, 0, rng.uniform(0.82, 0.95)])
        head = np.array([0.8 * base, 0, 0.8])
        return _Joints(
            rear=np.array([0, 0, radius]),
            front=np.array([base, 0, radius]),
            crank=crank,
            saddle=saddle,
            seat=crank + 0.82 * (saddle - crank),
            head=head,
            neck=np.array([0.83 * base, 0, 0.7]),
            bar=np.add(head, [-0.03, 0, 0.12]),
        )


def bicycle(rng: Rng) -> Piece:
    """A bicycle of 1.5 to 1.9 m that faces +x and leans on its kickstand."""
    radius, tire = rng.uniform(0.31, 0.35), rng.uniform(0.025, 0.045)
    joints = _Joints.draw(rng, radius)
    spokes = 4 * int(rng.integers(7, 10))
    tires, rims = _two_wheels(joints, wheel_parts(radius, tire, spokes))
    metal = [_handlebar(joints.bar), *_pedals(joints.crank), *rims]

    lean = rotation([1, 0, 0], _LEAN_DEG)

    def leaning(meshes: list[Mesh]) -> Mesh:
        return shapes.transformed(shapes.merged(meshes), lean)

    rubber = leaning(tires)
    lowest = float(rubber.vertices[:, 2].min())
    stand = _kickstand(lean, lowest)
    return standing(
        "bicycle",
        Part("frame", leaning(_bicycle_frame(joints)), "paint"),
        Part("metal", shapes.merged([leaning(metal), *stand]), "metal"),
        Part("tires", rubber, "rubber"),
        Part("saddle", leaning([_saddle(joints.saddle)]), "rubber"),
    )


def _bar(start: ArrayLike, end: ArrayLike, radius: float, sides: int) -> Mesh:
    """A straight tube between two points (3,)."""
    return tube(np.stack([start, end]), radius, sides)


def _bicycle_frame(joints: _Joints) -> list[Mesh]:
    """Four tubes in the middle, and on each side two from the rear axle and one blade of the fork."""
    bars = [
        _bar(joints.crank, joints.saddle, 0.015, 12),
        _bar(joints.crank, joints.neck, 0.017, 12),
        _bar(joints.seat, joints.head, 0.014, 12),
        _bar(joints.neck, joints.bar, 0.016, 12),
    ]
    for side in (-0.05, 0.05):
        off = np.array([0, side, 0])
        axle = joints.rear + off
        bars.append(_bar(axle, joints.crank + 0.2 * off, 0.008, 8))
        bars.append(_bar(axle, joints.seat + 0.2 * off, 0.008, 8))
        bars.append(_bar(joints.front + off, joints.neck + 0.4 * off, 0.01, 8))
    return bars


def _handlebar(middle: Float) -> Mesh:
    """A bar across, a little lower at its ends."""
    across = (-0.27, -0.1, 0.1, 0.27)
    points = [np.add(middle, [0.0, y, 0.02 - abs(y) * 0.1]) for y in across]
    return tube(arc(points), 0.011, 10)


def _pedals(crank: Float) -> list[Mesh]:
    """The chain ring, its axle, and on both sides an arm with a pedal, one forwards and one backwards."""
    ring = tube(circle(0.09, 32), 0.006, 6, closed=True)
    upright = translation(crank - [0, 0.06, 0]) @ rotation([1, 0, 0], 90.0)
    half_axle = np.array([0, 0.075, 0])
    parts = [
        shapes.transformed(ring, upright),
        tube([crank - half_axle, crank + half_axle], 0.018, 12),
    ]
    for side in (-1.0, 1.0):
        start = np.add(crank, [0, 0.07 * side, 0])
        end = start + np.array([0.16, 0.01, -0.05]) * side
        parts.append(tube([start, end], 0.008, 8))
        pedal = np.add(end, [0, 0.02 * side, 0])
        parts.append(tube([pedal, np.add(pedal, [0, 0.08 * side, 0])], 0.014, 8))
    return parts


def _two_wheels(
    joints: _Joints, wheel: tuple[Mesh, Mesh, Mesh]
) -> tuple[list[Mesh], list[Mesh]]:
    """Copies of a wheel at both axles: their tires, and their rims and hubs."""
    rubber, rim, hub = wheel
    tires, metal = [], []
    for middle in (joints.rear, joints.front):
        pose = translation(middle) @ rotation([1, 0, 0], 90.0)
        tires.append(shapes.transformed(rubber, pose))
        metal.append(shapes.transformed(rim, pose))
        metal.append(shapes.transformed(hub, pose))
    return tires, metal


def _saddle(top: Float) -> Mesh:
    """A cushion just above the end of the tube that carries it."""
    cushion = shapes.rounded_box(np.array([0.26, 0.14, 0.06]), 0.029, 3, tile=1.0)
    return shapes.transformed(cushion, translation(np.add(top, [0, 0, 0.02])))


def _kickstand(lean: Float, lowest: float) -> list[Mesh]:
    """A leg from the frame of a leaning bicycle, at the pose `lean`, to a foot at the height of its tires."""
    hinge = transform_points(lean, np.array([0.36, 0.03, 0.27]))
    foot = np.array([0.24, hinge[1] - 0.22, lowest + 0.007])
    end = foot - np.array([0, 0.04, 0])
    return [tube([hinge, foot], 0.006, 10), tube([foot, end], 0.007)]
