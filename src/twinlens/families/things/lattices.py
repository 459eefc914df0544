"""Things of bars and rods: fences, grilles, steps, tripods, lamps with cables, baskets."""

import math

import numpy as np

from twinlens.families.draws import Rng, one_of
from twinlens.families.furniture import Piece, board
from twinlens.families.things.pieces import Part, standing
from twinlens.families.things.sweeps import arc, circle, tube, tubes
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.placement import translation
from twinlens.scenes.scene import Mesh

_FLAT_BAR = 0.022  # metres, of the frame of a grille
_HANDRAIL = 0.85  # metres above a tread
_SHADE_WALL = 0.003  # metres
_CABLE = 0.0035  # metres, radius
_QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


def fence(rng: Rng) -> Piece:
    """A fence of 1.6 to 3 m: pickets before two rails, on two posts with feet."""
    wide, tall = rng.uniform(1.6, 3.0), rng.uniform(0.7, 1.3)
    pitch, picket = rng.uniform(0.08, 0.16), rng.uniform(0.02, 0.06)
    last = wide / 2 - picket / 2
    pickets = [
        board((picket, 0.015, tall - 0.05), (float(x), -0.0275, tall / 2 + 0.025))
        for x in np.arange(-last, last + 1e-9, pitch)
    ]
    rails = [board((wide, 0.04, 0.05), (0, 0, share * tall)) for share in (0.22, 0.8)]
    sides = (0.2 - wide / 2, wide / 2 - 0.2)
    posts = [board((0.07, 0.07, tall), (x, 0.055, tall / 2)) for x in sides]
    feet = [board((0.05, 0.5, 0.04), (x + 0.06, 0.055, 0.02)) for x in sides]
    word = one_of(rng, ["wood", "white", "paint"])
    return standing(
        "fence",
        Part("pickets", shapes.merged([*pickets, *rails]), word),
        Part("posts", shapes.merged([*posts, *feet]), word),
    )


def grille(rng: Rng) -> Piece:
    """A metal grille of 0.5 to 1.3 m on two feet: a frame of flat bars with round bars both ways."""
    wide, tall = rng.uniform(0.4, 1.0), rng.uniform(0.5, 1.3)
    radius = rng.uniform(0.0025, 0.006)
    columns, rows = int(rng.integers(6, 16)), int(rng.integers(2, 12))
    uprights = _upright_bars(columns, wide, tall, radius)
    level = _level_bars(rows, wide, tall, radius)
    frame = _frame_of_grille(wide, tall)
    word = one_of(rng, ["metal", "paint", "rubber"])
    return standing(
        "grille",
        Part("bars", shapes.merged([uprights, level]), word),
        Part("frame", frame, word),
    )


def _upright_bars(count: int, wide: float, tall: float, radius: float) -> Mesh:
    """Upright round bars between the two level bars of a frame."""
    x = np.linspace(-wide / 2, wide / 2, count + 2)[1:-1]
    zero = np.zeros_like(x)
    low = zero + 0.5 * _FLAT_BAR
    high = zero + (tall - 0.5 * _FLAT_BAR)
    start = np.stack([x, zero, low], axis=-1)
    end = np.stack([x, zero, high], axis=-1)
    return tubes(np.stack([start, end], axis=1), radius, 8)


def _level_bars(count: int, wide: float, tall: float, radius: float) -> Mesh:
    """Level round bars just before the upright ones."""
    x = np.full(count, 0.5 * _FLAT_BAR - wide / 2)
    y = np.full(count, -2 * radius)
    z = np.linspace(0, tall, count + 2)[1:-1]
    start = np.stack([x, y, z], axis=-1)
    end = start * [-1, 1, 1]
    return tubes(np.stack([start, end], axis=1), radius, 8)


def _frame_of_grille(wide: float, tall: float) -> Mesh:
    """Two upright and two level flat bars, and a foot at each side."""
    bars = []
    for side in (-1, 1):
        at = side * (wide - _FLAT_BAR) / 2
        bars.append(board((_FLAT_BAR, 0.03, tall), (at, 0, tall / 2)))
        height = tall / 2 + side * (tall - _FLAT_BAR) / 2
        # Shorter than the gap, so that no two surfaces coincide.
        between = wide - 2 * _FLAT_BAR - 5e-4
        bars.append(board((between, 0.03, _FLAT_BAR), (0, 0, height)))
    reach = 0.25 * tall + 0.05
    for side in (-1, 1):
        at = side * (wide / 2 + 0.006)
        bars.append(board((0.012, reach, 0.014), (at, 0, 0.007)))
    return shapes.merged(bars)


def steps(rng: Rng) -> Piece:
    """Open steps of three to nine treads between two slanted strings on posts, with thin handrails."""
    count, rise = int(rng.integers(3, 10)), rng.uniform(0.15, 0.19)
    going, wide = rng.uniform(0.22, 0.29), rng.uniform(0.6, 1.0)
    treads = [
        board((wide, going + 0.02, 0.035), (0, k * going, (k + 1) * rise), 0.006)
        for k in range(count)
    ]
    side_view = _string(count, rise, going)
    last, top = count * going - going, count * rise
    strings, rails = [], []
    for side in (-1, 1):
        x = side * (wide / 2 + 0.015)
        strings.append(_slab(side_view, x - 0.015, x + 0.015))
        post = board((0.03, 0.05, top), (x + side * 0.03, last, top / 2))
        strings.append(post)
        rails += _handrail(np.array([[x, 0.0, rise], [x, last, top]]))
    word = one_of(rng, ["wood", "paint"])
    return standing(
        "steps",
        Part("treads", shapes.merged(treads), "wood"),
        Part("strings", shapes.merged(strings), word),
        Part("rails", shapes.merged(rails), one_of(rng, ["metal", word])),
    )


def _string(count: int, rise: float, going: float) -> Float:
    """The side view (5, 2) of (y, z) of a board along a flight of steps, below the treads."""
    slope = math.atan2(rise, going)
    half_depth = 0.09 / math.cos(slope)
    last, top = count * going - going, count * rise
    return np.array(
        [
            (-going, -0.0),
            (0.4 * going, 0.0),
            (last, top - half_depth),
            (last, top + 0.05),
            (-going, 0.08),
        ]
    )


def _handrail(foot: Float) -> list[Mesh]:
    """Two posts on the feet (2, 3) at both ends of a flight of steps, and a rail between their tops."""
    top = np.add(foot, [0, 0, _HANDRAIL])
    posts = tubes(np.stack([foot, top], axis=1), 0.011, 10)
    return [posts, tube(top, 0.018, 12)]


def _slab(outline: Float, low: float, high: float) -> Mesh:
    """A flat body between x = low and x = high over a convex outline (N, 2) of (y, z), counter-clockwise."""
    count = len(outline)
    right = np.column_stack([np.full(count, high), outline])
    left = np.column_stack([np.full(count, low), outline])
    fan = np.array([(0, k, k + 1) for k in range(1, count - 1)], dtype=np.uint32)
    normal = np.tile([1.0, 0, 0], (count, 1))
    parts = [
        Mesh(right, fan, normal, outline.copy()),
        Mesh(left, fan[:, ::-1], -normal, outline.copy()),
    ]
    for k in range(count):
        after = (k + 1) % count
        corners = np.stack([left[k], left[after], right[after], right[k]])
        parts.append(_rectangle(corners, high - low))
    return shapes.merged(parts)


def _rectangle(corners: Float, wide: float) -> Mesh:
    """A flat rectangle of corners (4, 3), whose second side is `wide` metres; (u, v) in metres."""
    first_side = corners[1] - corners[0]
    across = np.cross(first_side, corners[3] - corners[0])
    unit = across / np.linalg.norm(across)
    long = float(np.linalg.norm(first_side))
    uv = np.array([[0, 0], [long, 0], [long, wide], [0, wide]])
    return Mesh(corners, _QUAD, np.tile(unit, (4, 1)), uv)


def tripod(rng: Rng) -> Piece:
    """A tripod of 0.4 to 1.6 m with spread legs, a column and a small head."""
    tall = rng.uniform(0.4, 1.6)
    spread, thin = rng.uniform(0.3, 0.5) * tall, rng.uniform(0.006, 0.013)
    turn = 2 * math.pi * np.arange(3) / 3 + rng.uniform(0, 2)
    outward = np.stack([np.cos(turn), np.sin(turn), np.zeros(3)], axis=-1)
    foot = spread * outward + [0, 0, thin]
    hip = 0.025 * outward + [0, 0, 0.8 * tall]
    legs = tubes(np.stack([foot, hip], axis=1), [thin, 1.3 * thin], 10)
    hub = tube([[0, 0, 0.77 * tall], [0, 0, 0.83 * tall]], 0.035, 16)

    knee = 0.98 * (0.5 * (foot + hip))
    end = np.tile(np.array([0, 0, 0.45 * tall]), (3, 1))
    braces = tubes(np.stack([knee, end], axis=1), 0.003, 6)
    column = tube([[0, 0, 0.44 * tall], [0, 0, 0.93 * tall]], 1.2 * thin, 12)
    head = board((0.07, 0.05, 0.07 * tall), (0, 0, 0.95 * tall), 0.008)
    word = one_of(rng, ["metal", "rubber", "wood"])
    return standing(
        "tripod",
        Part("legs", shapes.merged([legs, hub]), word),
        Part("braces", shapes.merged([braces, column]), "metal"),
        Part("head", head, "rubber"),
    )


def desk_lamp(rng: Rng) -> Piece:
    """A lamp with two thin arms, a shade, and a cable that winds over the table."""
    lower, upper = rng.uniform(0.18, 0.3), rng.uniform(0.18, 0.3)
    lower_angle, upper_angle = rng.uniform(1.8, 2.3), rng.uniform(-0.3, 0.5)
    hip = np.array([0, 0, 0.02])
    elbow = hip + lower * _in_side_view(lower_angle)
    tip = elbow + upper * _in_side_view(upper_angle)
    arms = _arms(hip, elbow, tip, rng.uniform(0.004, 0.007))
    base = tube([[0.0, 0, 0], [0, 0, 0.022]], rng.uniform(0.08, 0.1), 36)
    shade = _shade(rng.uniform(0.05, 0.08), rng.uniform(0.07, 0.12))
    shade = shapes.transformed(shade, translation(np.add(tip, [0, 0, 0.004])))
    cable = _cable(rng)
    word = one_of(rng, ["metal", "paint", "white"])
    return standing(
        "desk-lamp",
        Part("stand", shapes.merged([base, *arms]), word),
        Part("shade", shade, word),
        Part("cable", cable, "rubber"),
    )


def _in_side_view(angle: float) -> Float:
    """The unit vector (3,) at an angle from +x to +z."""
    return np.array([math.cos(angle), 0, math.sin(angle)])


def _arms(hip: Float, elbow: Float, tip: Float, thin: float) -> list[Mesh]:
    """The two arms of a lamp, and the joint between them; the arms are a little aside of each other."""
    aside = np.array([0, 0.3 * thin, 0])
    half_joint = np.array([0, 0.012, 0])
    lower = tube([hip, elbow], thin)
    upper = tube([elbow + aside, tip + aside], thin)
    joint = tube([elbow - half_joint, elbow + half_joint], 0.012, 14)
    return [lower, upper, joint]


def _shade(low: float, deep: float) -> Mesh:
    """A thin cone of `deep` metres, open below, with the radius `low` there; its top is at z = 0."""
    high = 0.02
    outside = [(0, 0), (high, 0), (high, 0), (low, -deep), (low, -deep)]
    edge = [(low - _SHADE_WALL, -deep), (low - _SHADE_WALL, -deep)]
    top = (high - _SHADE_WALL, -0.004)
    inside = [top, top, (0, -0.004)]
    # From the axis at the bottom back to the axis, as `lathe` takes profiles.
    outline = np.array([*outside, *edge, *inside])[::-1]
    return shapes.lathe(outline, 36, smooth=False)


def _cable(rng: Rng) -> Mesh:
    """A cable that lies on z = 0 and winds away from a lamp's base, towards -x."""
    share = np.linspace(0, 1, 7)
    swing = rng.uniform(0.02, 0.08) * np.sin(share * rng.uniform(3, 9))
    height = np.full(7, _CABLE + 1e-4)
    path = np.column_stack([-0.05 - 0.4 * share, swing, height])
    return tube(arc(path), _CABLE, 8)


def basket(rng: Rng) -> Piece:
    """A basket of rings and slanted stakes, open between them, with a floor and a thick rim."""
    low, tall = rng.uniform(0.09, 0.17), rng.uniform(0.12, 0.32)
    high = low * rng.uniform(1.05, 1.4)
    thin = rng.uniform(0.0025, 0.004)
    rings = []
    for share in np.linspace(0.08, 0.94, int(rng.integers(7, 16))):
        ring = circle(low + (high - low) * share, 40, tall * share)
        rings.append(tube(ring, thin, 7, closed=True))
    stakes = _stakes(int(rng.integers(14, 30)), low + thin, high + thin, tall, thin)
    rim = tube(circle(high, 40, tall), 2.5 * thin, 8, closed=True)
    floor = tube([[0.0, 0, 0], [0, 0, 0.012]], low + 2 * thin, 40)
    return standing(
        "basket",
        Part("weave", shapes.merged([*rings, stakes]), "rattan"),
        Part("rim", shapes.merged([rim, floor]), "rattan"),
    )


def _stakes(count: int, low: float, high: float, tall: float, thin: float) -> Mesh:
    """Slanted bars from a circle of radius `low` on the floor of a basket to one of radius `high` at its rim."""
    angle = 2 * math.pi * np.arange(count) / count
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=-1)
    foot = low * outward + [0, 0, 0.006]
    top = high * outward + [0, 0, tall]
    return tubes(np.stack([foot, top], axis=1), 0.9 * thin, 7)
