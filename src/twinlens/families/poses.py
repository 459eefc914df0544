"""4x4 poses of objects: world_from_object, angles in degrees, lengths in metres."""

import numpy as np

from twinlens.families.draws import Rng
from twinlens.geometry import Float, rigid
from twinlens.scenes.placement import rotation, translation


def move(x: float, y: float, z: float) -> Float:
    """The translation by (x, y, z)."""
    return translation(np.array([x, y, z]))


def turn_x(deg: float) -> Float:
    """The rotation about x."""
    return rotation(np.array([1.0, 0.0, 0.0]), float(deg))


def turn_y(deg: float) -> Float:
    """The rotation about y."""
    return rotation(np.array([0.0, 1.0, 0.0]), float(deg))


def turn_z(deg: float) -> Float:
    """The rotation about z, the vertical axis."""
    return rotation(np.array([0.0, 0.0, 1.0]), float(deg))


def similarity(turn: Float, position: Float, size: float) -> Float:
    """The pose that scales by `size`, rotates by `turn` (3, 3), then moves to `position` (3,)."""
    pose = rigid(turn, position)
    pose[:3, :3] *= size
    return pose


def random_rotation(rng: Rng) -> Float:
    """A uniform random rotation (3, 3). Source: Shoemake, Uniform Random Rotations, Graphics Gems III, 1992."""
    q = rng.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
