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


def pot(radius: float, tall: float) -> tuple[Mesh, Mesh]:
    """A pot, widest at its rim, and the soil in it."""
    wall = 0.12 * radius
    inside, soil = radius - wall, 0.9 * tall
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
    level = np.cos(elevation)
    x, y = level * np.cos(azimuth), level * np.sin(azimuth)
    return np.stack(np.broadcast_arrays(x, y, np.sin(elevation)), axis=-1)


def _leaf_poses(
    rng: Rng, places: Float, outward: Float, size: Float, roll: float = 0.35
) -> Float:
    """Poses (N, 4, 4) of blades at places (N, 3), along `outward` (N, 3), upper side up, scaled by `size` (N,)."""
    y = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0]) + roll * rng.normal(size=y.shape)
    x = np.cross(y, up)
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
    z = np.cross(x, y)
    poses = np.tile(np.eye(4), (len(y), 1, 1))
    poses[:, :3, :3] = np.stack([x, y, z], axis=-1) * size[:, None, None]
    poses[:, :3, 3] = places
    return poses


def _leaves(rng: Rng, leaf: Mesh, poses: Float) -> Mesh:
    """Copies of a leaf, each on its own part of the pattern of leaves."""
    return copies(leaf, poses, rng.uniform(0, _TILE, (len(poses), 2)))


def pot_plant(rng: Rng) -> Piece:
    """A pot plant of 0.3 to 1.1 m: stems that bend outwards, with leaves all along their upper parts."""
    radius, tall = rng.uniform(0.06, 0.14), rng.uniform(0.1, 0.24)
    rise = rng.uniform(0.2, 0.75)
    stems = int(rng.integers(5, 12))
    azimuth = _GOLDEN * np.arange(stems) + rng.uniform(0, 0.6, stems)
    spread = rng.uniform(0.25, 0.75, stems) * rise
    base = 0.4 * radius * _directions(azimuth, 0.0) + [0, 0, 0.88 * tall]
    t = np.linspace(0, 1, 9)[:, None]
    out = _directions(azimuth, 0.0)[:, None] * (spread[:, None, None] * t**1.7)
    height = rise * rng.uniform(0.6, 1.0, stems)
    up = height[:, None, None] * np.array([0, 0, 1.0]) * np.sin(1.45 * t)
    paths = base[:, None] + out + up
    thin = np.linspace(0.0035, 0.0012, 9)

    per_stem = int(rng.integers(10, 26))
    share = np.linspace(0.22, 0.98, per_stem) * 8
    index = share.astype(int)
    places = paths[:, index] + (share - index)[:, None] * (
        paths[:, index + 1] - paths[:, index]
    )
    turn = _GOLDEN * np.arange(per_stem) + azimuth[:, None]
    elevation = rng.uniform(-0.2, 0.9, turn.shape)
    outward = _directions(turn, elevation).reshape(-1, 3)
    size = rng.uniform(0.6, 1.1, len(outward))
    long = rng.uniform(0.05, 0.14)
    shape = rng.uniform(0.25, 0.65), rng.uniform(0.1, 0.5), rng.uniform(0.0, 0.5)
    leaf = blade(long, shape[0] * long, 3, *shape[1:])
    poses = _leaf_poses(rng, places.reshape(-1, 3), outward, size)
    vessel, earth = pot(radius, tall)
    return standing(
        "pot-plant",
        Part("pot", vessel, "glaze"),
        Part("soil", earth, "soil"),
        Part("stems", tubes(paths, thin, 6), "bark"),
        Part("leaves", _leaves(rng, leaf, poses), "leaf"),
    )


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
    branches = _bent(rng, _along(trunk, share), outward, reach, 6)
    taper = np.linspace(1.0, 0.25, 6)
    branch_radius = (0.35 * thick * (1 - 0.6 * share))[:, None] * taper

    # Twigs leave the outer part of the branches to all sides.
    per_branch = 7
    places = np.linspace(0.3, 1.0, per_branch)
    twig_starts = np.concatenate([_along(branch, places) for branch in branches])
    sides = rng.normal(size=twig_starts.shape)
    sides += np.repeat(outward, per_branch, axis=0) + np.array([0, 0, 0.3])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    twig_reach = np.repeat(reach, per_branch) * rng.uniform(0.25, 0.5, len(sides))
    twigs = _bent(rng, twig_starts, sides, twig_reach, 4)
    twig_radius = np.linspace(0.10, 0.04, 4) * thick

    # Leaves stand on the twigs and hang a little; where there are few, they are large.
    per_twig = round(log_uniform(rng, 4.0, 10.0))
    on_twigs = np.linspace(0.15, 1.0, per_twig)
    leaf_places = np.concatenate([_along(twig, on_twigs) for twig in twigs])
    size = rng.uniform(0.7, 1.2, len(leaf_places))
    leaf_outward = rng.normal(size=leaf_places.shape) - [0, 0, 0.2]
    long = float(rng.uniform(0.6, 0.85)) / math.sqrt(per_twig)
    leaf = _folded_leaf(long, float(rng.uniform(0.5, 0.85)) * long)
    poses = _leaf_poses(rng, leaf_places, leaf_outward, size)

    wood = [
        tubes(trunk[None], thick * np.linspace(1.0, 0.25, len(trunk))[None], 8),
        tubes(branches, branch_radius, 5),
        tubes(twigs, twig_radius, 3),
    ]
    return standing(
        "tree",
        Part("wood", shapes.merged(wood), "bark"),
        Part("leaves", _leaves(rng, leaf, poses), "leaf"),
    )


def _folded_leaf(long: float, wide: float) -> Mesh:
    """A rhombus along +y that is folded along its midrib: two triangles, both sides."""
    rise = 0.12 * wide
    middle = 0.45 * long
    vertices = np.array(
        [[0, 0, 0], [wide / 2, middle, rise], [0, long, 0], [-wide / 2, middle, rise]]
    )
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    return double_sided(vertices, faces, normals, vertices[:, :2].copy(), 2e-4)


def _trunk(rng: Rng, tall: float) -> Float:
    """A line (8, 3) upwards that leaves the vertical by a few per cent of its length."""
    t = np.linspace(0, 1, 8)[:, None]
    lean, bend = rng.normal(0, 0.03, 3), rng.normal(0, 0.04, 3)
    lean[2] = bend[2] = 0.0
    return np.asarray(tall * (t * [0, 0, 1] + t * lean + np.sin(math.pi * t) * bend))


def _along(path: Float, share: Float) -> Float:
    """Points (N, 3) at shares (N,) of a path (M, 3) of equal steps."""
    at = np.clip(share, 0, 1) * (len(path) - 1)
    low = np.minimum(at.astype(int), len(path) - 2)
    return np.asarray(path[low] + (at - low)[:, None] * (path[low + 1] - path[low]))


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

    twigs, steps = int(rng.integers(18, 34)), 7
    half = np.array([long, deep]) / 2 - 0.03
    foot = np.append(half, 0.0) * rng.uniform(-1, 1, (twigs, 3)) + [0, 0, tall]
    reach = np.array([0.12, 0.12, 0.0]) * rng.normal(size=(twigs, 3))
    tip = foot + reach + rise * rng.uniform(0.5, 1.0, (twigs, 1)) * [0, 0, 1.0]
    t = np.linspace(0, 1, steps)[:, None]
    paths = foot[:, None] + t * (tip - foot)[:, None]
    paths[:, 1:-1] += rng.normal(0, 0.012, (twigs, steps - 2, 3))

    per_twig = int(rng.integers(12, 22))
    share = np.linspace(0.1, 1.0, per_twig)
    places = foot[:, None] + share[:, None] * (tip - foot)[:, None]
    places = (places + rng.normal(0, 0.02, places.shape)).reshape(-1, 3)
    outward = rng.normal([0.0, 0.0, 0.4], 1.0, places.shape)
    size = rng.uniform(0.6, 1.2, len(places))
    length = rng.uniform(0.05, 0.13)
    leaf = blade(length, rng.uniform(0.35, 0.7) * length, 2, 0.3, 0.25)
    poses = _leaf_poses(rng, places, outward, size, roll=0.8)
    return standing(
        "hedge",
        Part("planter", box, one_of(rng, ["wood", "paint", "white", "card"])),
        Part("soil", earth, "soil"),
        Part("twigs", tubes(paths, np.linspace(0.004, 0.0015, steps), 5), "bark"),
        Part("leaves", _leaves(rng, leaf, poses), "leaf"),
    )
