"""Turned bodies: vases, bottles, bowls, cups, plates, fruit, candles, pawns. Profiles walk up the outside and, where a
body is hollow, down the inside, from the axis back to the axis."""

import numpy as np

from twinlens.families.solids import Rng, Solid, cuboid, turned
from twinlens.geometry import Float


def _hollow(outside: list[tuple[float, float]], wall: float, floor: float) -> Float:
    """An outside profile from foot to lip, closed by its own inside, `wall` thinner; corners at foot and lip."""
    outer = [(0.0, outside[0][1]), outside[0], *outside]
    lip = outside[-1]
    inner = [(max(r - wall, 0.35 * r), h) for r, h in reversed(outside) if h > floor]
    inner = [(lip[0] - wall, lip[1])] + [p for p in inner if p[1] < lip[1] - 1e-6]
    end = inner[-1][0]
    return np.array([*outer, lip, *inner, (0.7 * end, floor), (0.0, floor)])


def vase(rng: Rng) -> Solid:
    """A belly, a neck, a lip."""
    belly, neck, tall = rng.uniform(0.3, 0.5), rng.uniform(0.09, 0.24), rng.uniform(0.9, 1.7)
    foot, lip = rng.uniform(0.4, 0.75) * belly, neck * rng.uniform(1.1, 1.7)
    at = rng.uniform(0.25, 0.6)
    outside = [
        (foot, 0.0), (0.5 * (foot + belly) * 1.1, 0.5 * at * tall), (belly, at * tall),
        (0.55 * belly + 0.45 * neck, (0.45 * at + 0.55 * 0.8) * tall), (neck, 0.86 * tall), (lip, tall),
    ]  # fmt: skip
    return turned("vase", _hollow(outside, 0.03, 0.06))


def bottle(rng: Rng) -> Solid:
    """Straight below, a shoulder, a narrow neck; closed."""
    r, tall, neck = rng.uniform(0.2, 0.36), rng.uniform(1.1, 1.8), rng.uniform(0.07, 0.1)
    shoulder = rng.uniform(0.5, 0.66) * tall
    profile = [
        (0, 0), (0.92 * r, 0), (0.92 * r, 0), (r, 0.05), (r, 0.6 * shoulder), (r, shoulder),
        (0.75 * r, shoulder + 0.13),
        (neck * 1.15, shoulder + 0.26), (neck, tall - 0.12), (neck, tall - 0.1), (neck, tall - 0.1),
        (neck * 1.3, tall - 0.1),
        (neck * 1.3, tall - 0.1), (neck * 1.3, tall), (neck * 1.3, tall), (0, tall),
    ]  # fmt: skip
    return turned("bottle", np.array(profile))


def bowl(rng: Rng) -> Solid:
    """Wide and open."""
    deep, foot = rng.uniform(0.25, 0.5), rng.uniform(0.18, 0.28)
    outside = [(foot, 0.0), (foot, 0.03), (0.33, 0.25 * deep), (0.46, 0.62 * deep), (0.5, deep)]
    return turned("bowl", _hollow(outside, 0.03, 0.055))


def cup(rng: Rng) -> Solid:
    """A beaker, straight, tapered or bellied."""
    tall, foot, lip = rng.uniform(0.7, 1.2), rng.uniform(0.26, 0.4), rng.uniform(0.34, 0.44)
    middle = 0.5 * (foot + lip) * rng.uniform(0.95, 1.15)
    return turned("cup", _hollow([(foot, 0.0), (foot * 1.02, 0.04), (middle, 0.5 * tall), (lip, tall)], 0.03, 0.06))


def goblet(rng: Rng) -> Solid:
    """A bowl on a stem."""
    tall, r = rng.uniform(1.1, 1.6), rng.uniform(0.26, 0.36)
    outside = [(0.05, 0.45 * tall), (0.6 * r, 0.52 * tall), (r, 0.7 * tall), (0.88 * r, tall)]
    foot = [(0, 0), (0.28, 0), (0.28, 0), (0.26, 0.03), (0.06, 0.09), (0.04, 0.25 * tall)]
    wall = 0.025
    inside = [(0.88 * r - wall, tall), (r - wall, 0.7 * tall), (0.5 * r, 0.56 * tall), (0, 0.53 * tall)]
    return turned("goblet", np.array([*foot, *outside, outside[-1], *inside]))


def plate(rng: Rng) -> Solid:
    """Flat, with a rim."""
    r, rise = 0.5, rng.uniform(0.05, 0.1)
    outside = [(0.6 * r, 0), (0.66 * r, 0.012), (0.8 * r, 0.5 * rise), (r, rise)]
    inside = [(r, rise + 0.02), (0.8 * r, 0.5 * rise + 0.022), (0.62 * r, 0.03), (0, 0.03)]
    return turned("plate", np.array([(0, 0), (0.6 * r, 0), *outside, outside[-1], inside[0], *inside]))


def jar(rng: Rng) -> Solid:
    """A canister with a lid and a knob."""
    r, tall = rng.uniform(0.34, 0.48), rng.uniform(0.6, 1.1)
    lid = tall + 0.09
    profile = [
        (0, 0), (r, 0), (r, 0), (r * 1.04, 0.5 * tall), (r, tall), (r, tall), (r * 1.07, tall), (r * 1.07, tall),
        (r * 1.07, lid), (r * 1.07, lid), (0.3 * r, lid + 0.05), (0.12 * r, lid + 0.09), (0.22 * r, lid + 0.17),
        (0, lid + 0.23),
    ]  # fmt: skip
    return turned("jar", np.array(profile))


def tin(rng: Rng) -> Solid:
    """A can with rolled rims."""
    r, tall = rng.uniform(0.28, 0.5), rng.uniform(0.4, 1.2)
    e = 0.018
    profile = [
        (0, 0.012), (r - e, 0.012), (r - e, 0), (r + e, 0), (r + e, 0), (r + e, 0.03), (r + e, 0.03), (r, 0.045),
        (r, 0.045),
        (r, tall - 0.045), (r, tall - 0.045), (r + e, tall - 0.03), (r + e, tall - 0.03), (r + e, tall), (r + e, tall),
        (r - e, tall), (r - e, tall), (r - e, tall - 0.012), (r - e, tall - 0.012), (0, tall - 0.012),
    ]  # fmt: skip
    return turned("tin", np.array(profile), smooth=False)


def candle(rng: Rng) -> Solid:
    """A wax cylinder with rounded edges."""
    r, tall = rng.uniform(0.16, 0.36), rng.uniform(0.5, 1.2)
    profile = [(0, 0), (r, 0), (r, 0), (r, tall - 0.06), (r, tall - 0.06), (0.96 * r, tall - 0.015), (0.85 * r, tall),
               (0.5 * r, tall - 0.02), (0, tall - 0.03)]  # fmt: skip
    return turned("candle", np.array(profile))


def apple(rng: Rng) -> Solid:
    """A dimpled fruit, standing on its shoulders."""
    wide = rng.uniform(0.46, 0.54)
    profile = [(0, 0.07), (0.12, 0.012), (0.22, 0.0), (0.36, 0.09), (wide, 0.42), (0.9 * wide, 0.72), (0.26, 0.86),
               (0.1, 0.82), (0, 0.72)]  # fmt: skip
    return turned("apple", np.array(profile))


def pear(rng: Rng) -> Solid:
    """Heavy below, narrow above."""
    profile = [
        (0, 0.05),
        (0.1, 0.01),
        (0.2, 0.0),
        (0.36, 0.1),
        (0.42, 0.34),
        (0.3, 0.66),
        (0.2, 0.88),
        (0.13, 1.02),
        (0, 1.06),
    ]
    return turned("pear", np.array(profile) * [rng.uniform(0.9, 1.1), 1.0])


def egg(rng: Rng) -> Solid:
    """Lies on its side, as eggs and lemons do."""
    t = np.linspace(-np.pi / 2, np.pi / 2, 12)
    r = 0.38 * np.cos(t) * (1 - 0.12 * np.sin(t))
    r[[0, -1]] = 0.0
    return turned("egg", np.stack([r, 0.52 * np.sin(t)], axis=-1), upright=False)


def pawn(rng: Rng) -> Solid:
    """A turned game piece or chair knob."""
    waist, head = rng.uniform(0.1, 0.16), rng.uniform(0.18, 0.24)
    profile = [
        (0, 0), (0.34, 0), (0.34, 0), (0.35, 0.07), (0.29, 0.12), (0.27, 0.18), (0.2, 0.24), (waist, 0.55),
        (waist + 0.01, 0.66),
        (0.22, 0.7), (0.22, 0.73), (0.11, 0.77), (head, 0.77 + 0.9 * head), (0.7 * head, 0.77 + 1.65 * head),
        (0, 0.77 + 1.95 * head),
    ]  # fmt: skip
    return turned("pawn", np.array(profile))


def cylinder(rng: Rng) -> Solid:
    """A drum or rod that may lie down."""
    r, tall, e = rng.uniform(0.15, 0.5), rng.uniform(0.3, 1.2), 0.015
    profile = [
        (0, 0),
        (r - e, 0),
        (r - e, 0),
        (r, e),
        (r, e),
        (r, tall - e),
        (r, tall - e),
        (r - e, tall),
        (r - e, tall),
        (0, tall),
    ]
    return turned("cylinder", np.array(profile), upright=False, smooth=False)


def cone(rng: Rng) -> Solid:
    """A cone, or a frustum."""
    r, top, tall = rng.uniform(0.3, 0.5), float(rng.choice([0.02, 0.02, 0.18])), rng.uniform(0.6, 1.2)
    profile = [(0, 0), (r, 0), (r, 0), (top, tall), (top, tall), (0, tall + 0.01)]
    return turned("cone", np.array(profile), smooth=False)


def capsule(rng: Rng) -> Solid:
    """A cylinder with round ends."""
    r, straight = rng.uniform(0.18, 0.32), rng.uniform(0.2, 0.7)
    t = np.linspace(-np.pi / 2, 0, 7)
    below = np.stack([r * np.cos(t), r * np.sin(t)], axis=-1)
    below[0, 0] = 0.0
    above = below[::-1] * [1, -1] + [0, straight]
    return turned("capsule", np.vstack([below, above]), upright=False)


def book(rng: Rng) -> Solid:
    """A closed book, lying."""
    return cuboid("book", np.array([1.0, rng.uniform(0.62, 0.8), rng.uniform(0.08, 0.26)]), 0.012)


def carton(rng: Rng) -> Solid:
    """A box that stands on a side: packets, toy bricks, parcels."""
    extents = np.array([rng.uniform(0.4, 1.0), rng.uniform(0.3, 0.8), rng.uniform(0.4, 1.1)])
    return cuboid("carton", extents, 0.012)
