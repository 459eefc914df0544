"""Plants: leaves on branches, in pots and outdoors."""

import math

import numpy as np
from numpy.typing import ArrayLike

from twinlens.families.draws import Rng
from twinlens.families.furniture import Piece
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
