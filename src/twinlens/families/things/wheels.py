"""Wheels with spokes, and bicycles of them."""

import math

import numpy as np

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


def bicycle(rng: Rng) -> Piece:
    """A bicycle of 1.5 to 1.9 m that faces +x and leans on its kickstand."""
    radius, tire = rng.uniform(0.31, 0.35), rng.uniform(0.025, 0.045)
    base = rng.uniform(0.98, 1.08)
    rear, front = np.array([0, 0, radius]), np.array([base, 0, radius])
    crank = np.array([0.42, 0, 0.28])
    saddle = np.array([0.22, 0, rng.uniform(0.82, 0.95)])
    seat = crank + 0.82 * (saddle - crank)
    head, neck = np.array([0.8 * base, 0, 0.8]), np.array([0.83 * base, 0, 0.7])
    bar = np.add(head, [-0.03, 0, 0.12])
    frame = [
        tube(np.stack([start, end]), radius_of_tube, 12)
        for start, end, radius_of_tube in (
            (crank, saddle, 0.015),
            (crank, neck, 0.017),
            (seat, head, 0.014),
            (neck, bar, 0.016),
        )
    ]
    for side in (-0.05, 0.05):
        off = np.array([0, side, 0])
        frame += [
            tube(np.stack([rear + off, joint + 0.2 * off]), 0.008, 8)
            for joint in (crank, seat)
        ]
        frame.append(tube(np.stack([front + off, neck + 0.4 * off]), 0.01, 8))
    handle = [
        np.add(bar, [0.0, y, 0.02 - abs(y) * 0.1]) for y in (-0.27, -0.1, 0.1, 0.27)
    ]
    metal = [tube(arc(handle), 0.011, 10)]
    ring = shapes.transformed(
        tube(circle(0.09, 32), 0.006, 6, closed=True),
        translation(crank - [0, 0.06, 0]) @ rotation([1, 0, 0], 90.0),
    )
    metal += [
        ring,
        tube([crank - [0, 0.075, 0], np.add(crank, [0, 0.075, 0])], 0.018, 12),
    ]
    for side in (-1.0, 1.0):
        start = np.add(crank, [0, 0.07 * side, 0])
        way = np.array([0.16, 0.01, -0.05]) * side
        metal.append(tube([start, start + way], 0.008, 8))
        pedal = start + way + [0, 0.02 * side, 0]
        metal.append(tube([pedal, np.add(pedal, [0, 0.08 * side, 0])], 0.014, 8))
    spokes = 4 * int(rng.integers(7, 10))
    tires = []
    for middle in (rear, front):
        pose = translation(middle) @ rotation([1, 0, 0], 90.0)
        rubber, rim, hub = wheel_parts(radius, tire, spokes)
        tires.append(shapes.transformed(rubber, pose))
        metal += [shapes.transformed(mesh, pose) for mesh in (rim, hub)]
    cushion = shapes.rounded_box(np.array([0.26, 0.14, 0.06]), 0.029, 3, tile=1.0)
    cushion = shapes.transformed(cushion, translation(np.add(saddle, [0, 0, 0.02])))
    lean = rotation([1, 0, 0], _LEAN_DEG)
    groups = [
        ("frame", frame, "paint"),
        ("metal", metal, "metal"),
        ("tires", tires, "rubber"),
        ("saddle", [cushion], "rubber"),
    ]
    leaning = {
        name: shapes.transformed(shapes.merged(meshes), lean)
        for name, meshes, _ in groups
    }
    lowest = float(leaning["tires"].vertices[:, 2].min())
    hinge = transform_points(lean, np.array([0.36, 0.03, 0.27]))
    foot = np.array([0.24, hinge[1] - 0.22, lowest + 0.007])
    end = foot - np.array([0, 0.04, 0])
    stand = [tube([hinge, foot], 0.006, 10), tube([foot, end], 0.007)]
    leaning["metal"] = shapes.merged([leaning["metal"], *stand])
    parts = [Part(name, leaning[name], word) for name, _, word in groups]
    return standing("bicycle", *parts)
