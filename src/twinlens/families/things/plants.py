"""Plants: leaves on branches, in pots and outdoors."""

import math

import numpy as np
from numpy.typing import ArrayLike

from twinlens.families.draws import Rng, log_uniform, one_of
from twinlens.families.furniture import Piece, board
from twinlens.families.solids import double_sided
from twinlens.families.things.pieces import Part, standing
from twinlens.families.things.sweeps import blade, copies, tubes
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

_TILE = 0.4  # metres, of the pattern of leaves
_GOLDEN = math.pi * (3 - math.sqrt(5))  # between leaves that follow each other
_UP = np.array([0.0, 0.0, 1.0])
_POINTS_OF_STEM, _POINTS_OF_BRANCH, _POINTS_OF_TWIG = 9, 6, 4
_POINTS_OF_TRUNK, _POINTS_OF_HEDGE_TWIG = 8, 7
_TWIGS_OF_BRANCH = 7


def pot(radius: float, tall: float) -> tuple[Mesh, Mesh]:
    """A pot, widest at its rim, and the soil in it."""
    wall = 0.12 * radius
    inside, soil = radius - wall, 0.9 * tall
    # Points that are written twice make hard edges.
    outline = [
        (0, 0), (0.72 * radius, 0), (0.72 * radius, 0), (0.95 * radius, 0.86 * tall),
        (0.95 * radius, 0.86 * tall), (radius, 0.86 * tall), (radius, 0.86 * tall),
        (radius, tall), (radius, tall), (inside, tall), (inside, tall),
        (0.7 * inside, 0.2 * tall), (0.7 * inside, 0.2 * tall), (0, 0.2 * tall),
    ]  # fmt: skip
    vessel = shapes.lathe(np.array(outline), 40, smooth=False)
    mound = [
        (0, 0.5 * tall), (0.8 * inside, 0.5 * tall), (0.8 * inside, 0.5 * tall),
        (0.9 * inside, soil), (0.9 * inside, soil), (0, soil + 0.03 * tall),
    ]  # fmt: skip
    earth = shapes.lathe(np.array(mound), 24, smooth=False)
    return vessel, earth


def _directions(azimuth: ArrayLike, elevation: ArrayLike) -> Float:
    """Unit vectors (..., 3) at azimuths from +x to +y, and elevations above the horizon."""
    level = np.cos(elevation)
    x, y = level * np.cos(azimuth), level * np.sin(azimuth)
    return np.stack(np.broadcast_arrays(x, y, np.sin(elevation)), axis=-1)


def _leaf_poses(
    rng: Rng, places: Float, outward: Float, size: Float, roll: float = 0.35
) -> Float:
    """Poses (N, 4, 4) of blades at places (N, 3), along `outward` (N, 3), upper side up, scaled by `size` (N,)."""
    y = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    up = _UP + roll * rng.normal(size=y.shape)
    x = np.cross(y, up)
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
    z = np.cross(x, y)
    turn = np.stack([x, y, z], axis=-1)
    poses = np.tile(np.eye(4), (len(y), 1, 1))
    poses[:, :3, :3] = turn * size[:, None, None]
    poses[:, :3, 3] = places
    return poses


def _leaves(rng: Rng, leaf: Mesh, poses: Float) -> Mesh:
    """Copies of a leaf, each on its own part of the pattern of leaves."""
    return copies(leaf, poses, rng.uniform(0, _TILE, (len(poses), 2)))


def pot_plant(rng: Rng) -> Piece:
    """A pot plant of 0.3 to 1.1 m: stems that bend outwards, with leaves all along their upper parts."""
    radius, tall = rng.uniform(0.06, 0.14), rng.uniform(0.1, 0.24)
    rise = rng.uniform(0.2, 0.75)
    count = int(rng.integers(5, 12))
    azimuth = _GOLDEN * np.arange(count) + rng.uniform(0, 0.6, count)
    base = 0.4 * radius * _directions(azimuth, 0.0) + [0, 0, 0.88 * tall]
    stems = _stems(rng, base, azimuth, rise)
    leaves = _leaves_of_stems(rng, stems, azimuth)
    thickness = np.linspace(0.0035, 0.0012, _POINTS_OF_STEM)
    vessel, earth = pot(radius, tall)
    return standing(
        "pot-plant",
        Part("pot", vessel, "glaze"),
        Part("soil", earth, "soil"),
        Part("stems", tubes(stems, thickness, 6), "bark"),
        Part("leaves", leaves, "leaf"),
    )


def _stems(rng: Rng, base: Float, azimuth: Float, rise: float) -> Float:
    """Paths (N, 9, 3) from `base` (N, 3) that rise at most `rise` metres, bend outwards and end nearly level."""
    count = len(base)
    spread = rng.uniform(0.25, 0.75, count) * rise
    height = rise * rng.uniform(0.6, 1.0, count)
    t = np.linspace(0, 1, _POINTS_OF_STEM)[:, None]
    outward = _directions(azimuth, 0.0)[:, None] * (spread[:, None, None] * t**1.7)
    upward = height[:, None, None] * _UP * np.sin(1.45 * t)
    return np.asarray(base[:, None] + outward + upward)


def _leaves_of_stems(rng: Rng, stems: Float, azimuth: Float) -> Mesh:
    """Leaves all along the upper parts of stems (N, 9, 3), to all sides by turns."""
    per_stem = int(rng.integers(10, 26))
    share = np.linspace(0.22, 0.98, per_stem) * (_POINTS_OF_STEM - 1)
    index = share.astype(int)
    start, end = stems[:, index], stems[:, index + 1]
    places = start + (share - index)[:, None] * (end - start)
    turn = _GOLDEN * np.arange(per_stem) + azimuth[:, None]
    elevation = rng.uniform(-0.2, 0.9, turn.shape)
    outward = _directions(turn, elevation).reshape(-1, 3)
    size = rng.uniform(0.6, 1.1, len(outward))
    long = rng.uniform(0.05, 0.14)
    slender = rng.uniform(0.25, 0.65)
    droop, fold = rng.uniform(0.1, 0.5), rng.uniform(0.0, 0.5)
    leaf = blade(long, slender * long, 3, droop, fold)
    poses = _leaf_poses(rng, places.reshape(-1, 3), outward, size)
    return _leaves(rng, leaf, poses)


def tree(rng: Rng) -> Piece:
    """A broad-leaved tree of 3.5 to 9 m: a trunk, branches, and twigs with 300 to 1,200 leaves."""
    tall = float(rng.uniform(3.5, 9.0))
    bare = float(rng.uniform(0.22, 0.4))  # share of the trunk below the crown
    wide = float(rng.uniform(0.25, 0.42)) * tall  # of the crown, from its middle
    trunk = _trunk(rng, tall)
    thick = 0.018 * tall + 0.03

    # Branches leave the trunk around it, the lower the longer; the crown is round, and narrow at its top.
    count = int(rng.integers(10, 18))
    share = bare + (0.95 - bare) * (np.arange(count) + 0.5) / count
    height = (share - bare) / (1 - bare)
    reach = wide * np.sqrt(np.maximum(1 - (1.5 * height - 0.35) ** 2, 0.05))
    azimuth = _GOLDEN * np.arange(count) + rng.uniform(-0.4, 0.4, count)
    rise = rng.uniform(0.15, 0.5, count) + 0.6 * height
    outward = _directions(azimuth, rise)
    starts = _along(trunk, share)
    branches = _bent(rng, starts, outward, reach, _POINTS_OF_BRANCH)
    twigs = _twigs(rng, branches, outward, reach)
    leaves = _leaves_of_twigs(rng, twigs)

    trunk_radius = thick * np.linspace(1.0, 0.25, _POINTS_OF_TRUNK)
    taper = np.linspace(1.0, 0.25, _POINTS_OF_BRANCH)
    branch_radius = (0.35 * thick * (1 - 0.6 * share))[:, None] * taper
    twig_radius = np.linspace(0.10, 0.04, _POINTS_OF_TWIG) * thick
    wood = [
        tubes(trunk[None], trunk_radius[None], 8),
        tubes(branches, branch_radius, 5),
        tubes(twigs, twig_radius, 3),
    ]
    return standing(
        "tree",
        Part("wood", shapes.merged(wood), "bark"),
        Part("leaves", leaves, "leaf"),
    )


def _trunk(rng: Rng, tall: float) -> Float:
    """A line (8, 3) upwards that leaves the vertical by a few per cent of its length."""
    t = np.linspace(0, 1, _POINTS_OF_TRUNK)[:, None]
    lean, bend = rng.normal(0, 0.03, 3), rng.normal(0, 0.04, 3)
    lean[2] = bend[2] = 0.0
    return np.asarray(tall * (t * _UP + t * lean + np.sin(math.pi * t) * bend))


def _twigs(rng: Rng, branches: Float, outward: Float, reach: Float) -> Float:
    """Paths (N, 4, 3) of twigs that leave the outer parts of branches to all sides.

    outward, reach : directions (B, 3) and lengths (B,) of the branches.
    """
    share = np.linspace(0.3, 1.0, _TWIGS_OF_BRANCH)
    starts = np.concatenate([_along(branch, share) for branch in branches])
    sides = rng.normal(size=starts.shape)
    sides += np.repeat(outward, _TWIGS_OF_BRANCH, axis=0) + np.array([0, 0, 0.3])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    reach_of_branch = np.repeat(reach, _TWIGS_OF_BRANCH)
    length = reach_of_branch * rng.uniform(0.25, 0.5, len(sides))
    return _bent(rng, starts, sides, length, _POINTS_OF_TWIG)


def _leaves_of_twigs(rng: Rng, twigs: Float) -> Mesh:
    """Leaves that stand on twigs (N, 4, 3) and hang a little; where there are few, they are large."""
    per_twig = round(log_uniform(rng, 4.0, 10.0))
    share = np.linspace(0.15, 1.0, per_twig)
    places = np.concatenate([_along(twig, share) for twig in twigs])
    size = rng.uniform(0.7, 1.2, len(places))
    outward = rng.normal(size=places.shape) - [0, 0, 0.2]
    long = float(rng.uniform(0.6, 0.85)) / math.sqrt(per_twig)
    leaf = _folded_leaf(long, float(rng.uniform(0.5, 0.85)) * long)
    poses = _leaf_poses(rng, places, outward, size)
    return _leaves(rng, leaf, poses)


def _folded_leaf(long: float, wide: float) -> Mesh:
    """A rhombus along +y that is folded along its midrib: two triangles, both sides."""
    rise = 0.12 * wide
    middle = 0.45 * long
    base, tip = [0, 0, 0], [0, long, 0]
    right, left = [wide / 2, middle, rise], [-wide / 2, middle, rise]
    vertices = np.array([base, right, tip, left])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    return double_sided(vertices, faces, normals, vertices[:, :2].copy(), 2e-4)


def _along(path: Float, share: Float) -> Float:
    """Points (N, 3) at shares (N,) of a path (M, 3) of equal steps."""
    at = np.clip(share, 0, 1) * (len(path) - 1)
    low = np.minimum(at.astype(int), len(path) - 2)
    step = path[low + 1] - path[low]
    return np.asarray(path[low] + (at - low)[:, None] * step)


def _bent(rng: Rng, starts: Float, outward: Float, length: Float, count: int) -> Float:
    """Paths (N, count, 3) from `starts` along `outward` (N, 3) that bend upwards and to a side."""
    t = np.linspace(0, 1, count)[:, None]
    side = rng.normal(0, 0.12, outward.shape) + np.array([0, 0, 0.15])
    lines = outward[:, None] * t + side[:, None] * t**2
    return np.asarray(starts[:, None] + length[:, None, None] * lines)


def hedge(rng: Rng) -> Piece:
    """A planter of 0.4 to 1.2 m with a thicket of thin twigs, full of leaves at all angles."""
    long, deep = rng.uniform(0.4, 1.1), rng.uniform(0.16, 0.3)
    tall, rise = rng.uniform(0.12, 0.3), rng.uniform(0.3, 0.8)
    box = board((long, deep, tall), (0, 0, tall / 2), 0.01)
    earth = board((long - 0.04, deep - 0.04, 0.02), (0, 0, tall + 0.004))
    foot, tip = _ends_of_thicket(rng, np.array([long, deep]) / 2 - 0.03, tall, rise)
    twigs = _crooked(rng, foot, tip)
    leaf, poses = _leaves_of_thicket(rng, foot, tip)
    word = one_of(rng, ["wood", "paint", "white", "card"])
    thickness = np.linspace(0.004, 0.0015, _POINTS_OF_HEDGE_TWIG)
    return standing(
        "hedge",
        Part("planter", box, word),
        Part("soil", earth, "soil"),
        Part("twigs", tubes(twigs, thickness, 5), "bark"),
        Part("leaves", _leaves(rng, leaf, poses), "leaf"),
    )


def _ends_of_thicket(
    rng: Rng, half: Float, tall: float, rise: float
) -> tuple[Float, Float]:
    """The lower and upper ends (N, 3) of twigs that stand on a rectangle of half sides (2,) at z = `tall`."""
    count = int(rng.integers(18, 34))
    foot = np.append(half, 0.0) * rng.uniform(-1, 1, (count, 3)) + [0, 0, tall]
    lean = np.array([0.12, 0.12, 0.0]) * rng.normal(size=(count, 3))
    tip = foot + lean + rise * rng.uniform(0.5, 1.0, (count, 1)) * _UP
    return foot, tip


def _crooked(rng: Rng, foot: Float, tip: Float) -> Float:
    """Paths (N, 7, 3) from foot to tip, (N, 3) each, that leave the straight line by a centimetre."""
    t = np.linspace(0, 1, _POINTS_OF_HEDGE_TWIG)[:, None]
    paths = foot[:, None] + t * (tip - foot)[:, None]
    inner = paths[:, 1:-1]
    inner += rng.normal(0, 0.012, inner.shape)
    return paths


def _leaves_of_thicket(rng: Rng, foot: Float, tip: Float) -> tuple[Mesh, Float]:
    """A leaf, and its poses (N, 4, 4) at all angles around the lines from foot to tip, (N, 3) each."""
    per_twig = int(rng.integers(12, 22))
    share = np.linspace(0.1, 1.0, per_twig)[:, None]
    on_lines = foot[:, None] + share * (tip - foot)[:, None]
    places = (on_lines + rng.normal(0, 0.02, on_lines.shape)).reshape(-1, 3)
    outward = rng.normal([0.0, 0.0, 0.4], 1.0, places.shape)
    size = rng.uniform(0.6, 1.2, len(places))
    long = rng.uniform(0.05, 0.13)
    leaf = blade(long, rng.uniform(0.35, 0.7) * long, 2, 0.3, 0.25)
    return leaf, _leaf_poses(rng, places, outward, size, roll=0.8)
