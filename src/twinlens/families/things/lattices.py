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


def fence(rng: Rng) -> Piece:
    """A fence of 1.6 to 3 m: pickets before two rails, on two posts with feet."""
    wide, tall = rng.uniform(1.6, 3.0), rng.uniform(0.7, 1.3)
    pitch, picket = rng.uniform(0.08, 0.16), rng.uniform(0.02, 0.06)
    x = np.arange(-wide / 2 + picket / 2, wide / 2 - picket / 2 + 1e-9, pitch)
    made = [
        board((picket, 0.015, tall - 0.05), (float(place), -0.0275, tall / 2 + 0.025))
        for place in x
    ]
    rails = (0.22 * tall, 0.8 * tall)
    made += [board((wide, 0.04, 0.05), (0, 0, height)) for height in rails]
    sides = (0.2 - wide / 2, wide / 2 - 0.2)
    posts = [board((0.07, 0.07, tall), (x, 0.055, tall / 2)) for x in sides]
    posts += [board((0.05, 0.5, 0.04), (x + 0.06, 0.055, 0.02)) for x in sides]
    word = one_of(rng, ["wood", "white", "paint"])
    return standing(
        "fence",
        Part("pickets", shapes.merged(made), word),
        Part("posts", shapes.merged(posts), word),
    )


def _bars_between(x: Float, low: float, high: float, radius: float) -> Mesh:
    """Upright round bars at places x from z = low to z = high."""
    zero = np.zeros_like(x)
    start = np.stack([x, zero, zero + low], axis=-1)
    end = np.stack([x, zero, zero + high], axis=-1)
    return tubes(np.stack([start, end], axis=1), radius, 8)


def grille(rng: Rng) -> Piece:
    """A metal grille of 0.5 to 1.3 m on two feet: a frame of flat bars with round bars both ways."""
    wide, tall = rng.uniform(0.4, 1.0), rng.uniform(0.5, 1.3)
    radius, bar = rng.uniform(0.0025, 0.006), 0.022
    columns, rows = int(rng.integers(6, 16)), int(rng.integers(2, 12))
    x = np.linspace(-wide / 2, wide / 2, columns + 2)[1:-1]
    uprights = _bars_between(x, 0.5 * bar, tall - 0.5 * bar, radius)
    z = np.linspace(0, tall, rows + 2)[1:-1]
    y = np.full(rows, -2 * radius)
    start = np.stack([np.full(rows, 0.5 * bar - wide / 2), y, z], axis=-1)
    level = tubes(np.stack([start, start * [-1, 1, 1]], axis=1), radius, 8)
    frame = []
    for side in (-1, 1):
        at = side * (wide - bar) / 2
        frame.append(board((bar, 0.03, tall), (at, 0, tall / 2)))
        end = tall / 2 + side * (tall - bar) / 2
        frame.append(board((wide - 2 * bar - 5e-4, 0.03, bar), (0, 0, end)))
    reach = 0.25 * tall + 0.05
    for side in (-1, 1):
        at = side * (wide / 2 + 0.006)
        frame.append(board((0.012, reach, 0.014), (at, 0, 0.007)))
    word = one_of(rng, ["metal", "paint", "rubber"])
    return standing(
        "grille",
        Part("bars", shapes.merged([uprights, level]), word),
        Part("frame", shapes.merged(frame), word),
    )


def steps(rng: Rng) -> Piece:
    """Open steps of three to nine treads between two slanted strings on posts, with thin handrails."""
    count, rise = int(rng.integers(3, 10)), rng.uniform(0.15, 0.19)
    going, wide = rng.uniform(0.22, 0.29), rng.uniform(0.6, 1.0)
    treads = [
        board((wide, going + 0.02, 0.035), (0, k * going, (k + 1) * rise), 0.006)
        for k in range(count)
    ]
    run, top = count * going, count * rise
    slope = math.atan2(rise, going)
    half_string = 0.09 / math.cos(slope)
    made, rails = [], []
    for side in (-1, 1):
        x = side * (wide / 2 + 0.015)
        side_view = np.array(
            [(-going, -0.0), (0.4 * going, 0.0), (run - going, top - half_string),
             (run - going, top + 0.05), (-going, 0.08)]
        )  # fmt: skip
        made.append(_slab(side_view, x - 0.015, x + 0.015))
        foot = np.array([[x, 0.0, rise], [x, run - going, top]])
        posts = np.stack([foot, np.add(foot, [0, 0, 0.85])], axis=1)
        rails.append(tubes(posts, 0.011, 10))
        made.append(board((0.03, 0.05, top), (x + side * 0.03, run - going, top / 2)))
        rails.append(tube(np.add(foot, [0, 0, 0.85]), 0.018, 12))
    word = one_of(rng, ["wood", "paint"])
    return standing(
        "steps",
        Part("treads", shapes.merged(treads), "wood"),
        Part("strings", shapes.merged(made), word),
        Part("rails", shapes.merged(rails), one_of(rng, ["metal", word])),
    )


def _slab(outline: Float, low: float, high: float) -> Mesh:
    """A flat body between x = low and x = high over a convex outline (N, 2) of (y, z), counter-clockwise."""
    n = len(outline)
    right = np.column_stack([np.full(n, high), outline])
    left = np.column_stack([np.full(n, low), outline])
    fan = np.array([(0, k, k + 1) for k in range(1, n - 1)], dtype=np.uint32)
    normal = np.tile([1.0, 0, 0], (n, 1))
    parts = [
        Mesh(right, fan, normal, outline.copy()),
        Mesh(left, fan[:, ::-1], -normal, outline.copy()),
    ]
    quad = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    for k in range(n):
        after = (k + 1) % n
        corners = np.stack([left[k], left[after], right[after], right[k]])
        across = np.cross(corners[1] - corners[0], corners[3] - corners[0])
        length = float(np.linalg.norm(corners[1] - corners[0]))
        uv = np.array([[0, 0], [length, 0], [length, high - low], [0, high - low]])
        unit = across / np.linalg.norm(across)
        parts.append(Mesh(corners, quad, np.tile(unit, (4, 1)), uv))
    return shapes.merged(parts)


def tripod(rng: Rng) -> Piece:
    """A tripod of 0.4 to 1.6 m with spread legs, a column and a small head."""
    tall = rng.uniform(0.4, 1.6)
    spread, thin = rng.uniform(0.3, 0.5) * tall, rng.uniform(0.006, 0.013)
    turn = 2 * math.pi * np.arange(3) / 3 + rng.uniform(0, 2)
    way = np.stack([np.cos(turn), np.sin(turn), np.zeros(3)], axis=-1)
    foot = spread * way + [0, 0, thin]
    hip = 0.025 * way + [0, 0, 0.8 * tall]
    legs = [tubes(np.stack([foot, hip], axis=1), [thin, 1.3 * thin], 10)]
    middle, end = 0.5 * (foot + hip), np.array([0, 0, 0.45 * tall])
    braces = tubes(np.stack([0.98 * middle, np.tile(end, (3, 1))], axis=1), 0.003, 6)
    column = tube([[0, 0, 0.44 * tall], [0, 0, 0.93 * tall]], 1.2 * thin, 12)
    head = board((0.07, 0.05, 0.07 * tall), (0, 0, 0.95 * tall), 0.008)
    hub = tube([[0, 0, 0.77 * tall], [0, 0, 0.83 * tall]], 0.035, 16)
    word = one_of(rng, ["metal", "rubber", "wood"])
    return standing(
        "tripod",
        Part("legs", shapes.merged([*legs, hub]), word),
        Part("braces", shapes.merged([braces, column]), "metal"),
        Part("head", head, "rubber"),
    )


def desk_lamp(rng: Rng) -> Piece:
    """A lamp with two thin arms, a shade, and a cable that winds over the table."""
    one, two = rng.uniform(0.18, 0.3), rng.uniform(0.18, 0.3)
    first, second = rng.uniform(1.8, 2.3), rng.uniform(-0.3, 0.5)
    hip = np.array([0, 0, 0.02])
    elbow = hip + one * np.array([math.cos(first), 0, math.sin(first)])
    tip = elbow + two * np.array([math.cos(second), 0, math.sin(second)])
    thin = rng.uniform(0.004, 0.007)
    aside = np.array([0, 0.3 * thin, 0])
    arms = [tube([hip, elbow], thin), tube([elbow + aside, tip + aside], thin)]
    arms.append(tube([elbow - [0, 0.012, 0], np.add(elbow, [0, 0.012, 0])], 0.012, 14))
    base = tube([[0.0, 0, 0], [0, 0, 0.022]], rng.uniform(0.08, 0.1), 36)
    low, high, deep = rng.uniform(0.05, 0.08), 0.02, rng.uniform(0.07, 0.12)
    outline = np.array(
        [(0, 0), (high, 0), (high, 0), (low, -deep), (low, -deep), (low - 0.003, -deep),
         (low - 0.003, -deep), (high - 0.003, -0.004), (high - 0.003, -0.004), (0, -0.004)]
    )[::-1]  # fmt: skip
    shade = shapes.lathe(outline, 36, smooth=False)
    shade = shapes.transformed(shade, translation(np.add(tip, [0, 0, 0.004])))
    steps = np.linspace(0, 1, 7)
    swing = rng.uniform(0.02, 0.08) * np.sin(steps * rng.uniform(3, 9))
    floor = np.column_stack([-0.05 - 0.4 * steps, swing, np.full(7, 0.0036)])
    cable = tube(arc(floor), 0.0035, 8)
    word = one_of(rng, ["metal", "paint", "white"])
    return standing(
        "desk-lamp",
        Part("stand", shapes.merged([base, *arms]), word),
        Part("shade", shade, word),
        Part("cable", cable, "rubber"),
    )


def basket(rng: Rng) -> Piece:
    """A basket of rings and slanted stakes, open between them, with a floor and a thick rim."""
    low, tall = rng.uniform(0.09, 0.17), rng.uniform(0.12, 0.32)
    high = low * rng.uniform(1.05, 1.4)
    thin = rng.uniform(0.0025, 0.004)
    rings = int(rng.integers(7, 16))
    made = []
    for share in np.linspace(0.08, 0.94, rings):
        ring = circle(low + (high - low) * share, 40, tall * share)
        made.append(tube(ring, thin, 7, closed=True))
    stakes = int(rng.integers(14, 30))
    angle = 2 * math.pi * np.arange(stakes) / stakes
    way = np.stack([np.cos(angle), np.sin(angle), np.zeros(stakes)], axis=-1)
    foot, top = (low + thin) * way + [0, 0, 0.006], (high + thin) * way + [0, 0, tall]
    made.append(tubes(np.stack([foot, top], axis=1), 0.9 * thin, 7))
    rim = tube(circle(high, 40, tall), 2.5 * thin, 8, closed=True)
    floor = tube([[0.0, 0, 0], [0, 0, 0.012]], low + 2 * thin, 40)
    return standing(
        "basket",
        Part("weave", shapes.merged(made), "rattan"),
        Part("rim", shapes.merged([rim, floor]), "rattan"),
    )
