"""What stands in streets: cars of simple make, benches, posts, signs and bins."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from twinlens.families.draws import Rng, one_of
from twinlens.families.furniture import Piece, board, rod
from twinlens.families.solids import extruded
from twinlens.families.things.pieces import Part, standing
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh

_WHEEL = 0.31  # metres, the radius of a car's tires
_CLEARANCE = 0.22  # metres below a car's body


def car(rng: Rng) -> Piece:
    """A car of 3.5 to 4.7 m along x: a bevelled body, a cabin with dark panes below a roof, and wheels with hubs."""
    long, wide = rng.uniform(3.5, 4.7), rng.uniform(1.62, 1.8)
    belt, top = rng.uniform(0.85, 1.0), rng.uniform(1.38, 1.75)
    front, rear = long / 2, -long / 2
    # Where the bonnet meets the windscreen, and where the rear pane ends.
    nose = front - rng.uniform(0.2, 0.33) * long
    tail = rear + rng.uniform(0.02, 0.2) * long
    body = _profile(_body_outline(long / 2, belt, nose), wide, 0.06)
    cabin = _profile(_cabin_outline(belt, top, nose, tail), wide - 0.22, 0.04)
    roof_front, roof_rear = nose - 0.6, tail + 0.3
    roof = board(
        (roof_front - roof_rear, wide - 0.3, 0.06),
        ((roof_front + roof_rear) / 2, 0, top - 0.03),
    )
    bumpers = [board((0.16, wide - 0.1, 0.14), (x, 0, 0.42)) for x in (rear, front)]
    side = wide / 2 - 0.24
    lamps = [
        board((0.05, 0.3, 0.12), (x, y, belt - 0.36))
        for x, y in product((rear, front), (-side, side))
    ]
    tires, hubs = _wheels(wide, (rear + 0.75, front - 0.78))
    return standing(
        "car",
        Part("body", shapes.merged([body, roof]), "lacquer"),
        Part("panes", cabin, "pane"),
        Part("bumpers", shapes.merged(bumpers), one_of(rng, ["rubber", "metal"])),
        Part("lamps", shapes.merged(lamps), "white"),
        Part("tires", tires, "rubber"),
        Part("hubs", hubs, "metal"),
    )


def _body_outline(half: float, belt: float, nose: float) -> list[tuple[float, float]]:
    """The side view (x, z) of a car's body, from -half to half, its bonnet and boot at the height `belt`."""
    return [
        (-half, _CLEARANCE),
        (half, _CLEARANCE),
        (half, belt - 0.3),
        (half - 0.12, belt - 0.12),
        (nose, belt),
        (0.1 - half, belt),
        (-half, belt - 0.2),
    ]


def _cabin_outline(
    belt: float, top: float, nose: float, tail: float
) -> list[tuple[float, float]]:
    """The side view (x, z) of a car's panes between its body and its roof."""
    return [
        (nose, belt - 0.02),
        (nose - 0.65, top - 0.04),
        (tail + 0.35, top - 0.04),
        (tail + 0.02, belt - 0.02),
    ]


def _wheels(wide: float, axles: tuple[float, float]) -> tuple[Mesh, Mesh]:
    """The tires and hubs of four wheels at the positions of two axles along x."""
    tires, hubs = [], []
    for x in axles:
        for y in (-wide / 2 + 0.09, wide / 2 - 0.09):
            inner = np.array([x, y - 0.11, _WHEEL])
            outer = np.array([x, y + 0.11, _WHEEL])
            tires.append(rod(inner, outer, _WHEEL))
            # A hub is a little longer than its tire.
            more = np.array([0, 0.005, 0])
            hubs.append(rod(inner - more, outer + more, 0.6 * _WHEEL))
    return shapes.merged(tires), shapes.merged(hubs)


def _profile(outline: Sequence[tuple[float, float]], wide: float, bevel: float) -> Mesh:
    """A closed prism of a side view (x, z), `wide` metres along y, with bevelled edges; (u, v) in metres."""
    points = np.array(outline)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    solid = extruded(points - middle, wide, bevel=bevel).mesh
    # Solids have extent 1.
    size = float(max(*np.ptp(points, axis=0), wide))
    vertices = solid.vertices * size
    scaled = replace(solid, vertices=vertices, uv=np.asarray(solid.uv) * size)
    # From (x, z, across) to (x, -across, z).
    upright = translation([middle[0], 0, middle[1]]) @ rotation([1, 0, 0], 90.0)
    return shapes.transformed(scaled, upright)


def bench(rng: Rng) -> Piece:
    """A park bench of slats with a low back."""
    long, gap = rng.uniform(1.3, 1.9), rng.uniform(0.12, 0.15)
    slats = [board((long, 0.1, 0.035), (0, y, 0.45)) for y in gap * np.arange(-1, 2)]
    heights = (0.6, 0.75) if rng.random() < 0.5 else (0.58, 0.7, 0.82)
    slats += [board((long, 0.03, 0.08), (0, 0.19, z)) for z in heights]
    legs = []
    for x in (-0.4 * long, 0.4 * long):
        legs.append(board((0.06, 0.36, 0.43), (x, 0, 0.215)))
        legs.append(board((0.06, 0.03, 0.86), (x, 0.22, 0.43)))
    return standing(
        "bench",
        Part("slats", shapes.merged(slats), one_of(rng, ["wood", "wood", "paint"])),
        Part("legs", shapes.merged(legs), "metal"),
    )


def lamp_post(rng: Rng) -> Piece:
    """A post of 2.5 to 6.5 m with a head, at the end of a short arm that reaches towards -y, or a lantern on top."""
    tall, thick = rng.uniform(2.5, 6.5), rng.uniform(0.035, 0.06)
    base = rod([0, 0, 0], [0, 0, 0.03], 0.2)
    post = [base, rod([0, 0, 0.02], [0, 0, tall], thick)]
    if rng.random() < 0.6:
        reach = rng.uniform(0.4, 0.65)
        post.append(rod([0, 0, tall - 0.03], [0, -reach, tall + 0.1], 0.6 * thick))
        head = board((0.16, 0.36, 0.07), (0, -reach - 0.1, tall + 0.1), 0.02)
        lamp = Part("head", head, "white")
    else:
        wide = rng.uniform(0.12, 0.2)
        lantern = board((wide, wide, 1.5 * wide), (0, 0, tall + 0.7 * wide), 0.03)
        lamp = Part("lantern", lantern, "white")
    return standing(
        "lamp-post",
        Part("post", shapes.merged(post), one_of(rng, ["metal", "paint"])),
        lamp,
    )


def road_sign(rng: Rng) -> Piece:
    """A round, square or triangular sign on a pole, its face to -y."""
    tall, half = rng.uniform(2.0, 2.8), rng.uniform(0.2, 0.38)
    corners = one_of(rng, [3, 4, 4, 24])
    turn = np.pi / 2 if corners != 4 else np.pi / 4
    angle = turn + 2 * np.pi * np.arange(corners) / corners
    outline = half * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    disc = _profile([(x, z) for x, z in outline], 0.02, 0.005)
    plate = shapes.transformed(disc, translation([0, -0.04, tall - half]))
    pole = [rod([0, 0, 0], [0, 0, 0.02], 0.1), rod([0, 0, 0.01], [0, 0, tall], 0.028)]
    return standing(
        "road-sign",
        Part("plate", plate, "lacquer"),
        Part("pole", shapes.merged(pole), "metal"),
    )


def bollard(rng: Rng) -> Piece:
    """A short post, with or without a ball on top."""
    tall, thick = rng.uniform(0.6, 1.0), rng.uniform(0.04, 0.09)
    parts = [rod([0, 0, 0], [0, 0, tall], thick)]
    if rng.random() < 0.5:
        ball = _ball(1.3 * thick)
        parts.append(shapes.transformed(ball, translation([0, 0, tall + 0.8 * thick])))
    return standing(
        "bollard",
        Part("post", shapes.merged(parts), one_of(rng, ["paint", "metal", "rubber"])),
    )


def _ball(radius: float) -> Mesh:
    """A ball about the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 9)
    half_circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    half_circle[[0, -1], 0] = 0.0  # the poles are on the axis
    return shapes.lathe(half_circle, 18, smooth=False)


def litter_bin(rng: Rng) -> Piece:
    """A round bin with a lid that is wider than it."""
    tall, radius = rng.uniform(0.7, 1.1), rng.uniform(0.2, 0.28)
    lid = rod([0, 0, tall], [0, 0, tall + 0.05], radius + 0.025)
    return standing(
        "litter-bin",
        Part("body", rod([0, 0, 0], [0, 0, tall], radius), "paint"),
        Part("lid", lid, one_of(rng, ["metal", "rubber"])),
    )
