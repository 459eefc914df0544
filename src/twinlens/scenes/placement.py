"""Where an object stands: scale, then rotate, then translate; or aim; or a whole 4x4."""

import math
from typing import Any

import numpy as np

from twinlens.errors import InputError
from twinlens.geometry import Float, look_at
from twinlens.scenes.table import At, Table, listed, number, scalar_or_vector, show, vector, whole

KEYS = ("translate", "rotate", "euler_deg", "look_at", "scale", "matrix")


def rotation(axis: Float, deg: float) -> Float:
    """The 4x4 rotation by `deg` degrees about `axis` (3,), right-handed. Source: Rodrigues 1840.

    >>> rotation([0, 0, 1], 90)[:3, 0].round(12).tolist()
    [0.0, 1.0, 0.0]
    """
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = math.radians(deg)
    pose = np.eye(4)
    pose[:3, :3] += math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)
    return pose


def translation(offset: Float) -> Float:
    """The 4x4 translation by `offset` (3,)."""
    pose = np.eye(4)
    pose[:3, 3] = offset
    return pose


def placement(table: Table[Any]) -> Float:
    """world_from_object (4, 4) from the placing keys of a table; the identity where it has none.

    `scale` (one number or three, > 0), then one of `rotate` = {axis, deg} (or a list of them, applied in order),
    `euler_deg` = [about x, about y, about z] applied in that order, `look_at` = a point the object's +z axis turns to;
    then `translate`. Or `matrix` = 4 rows of 4, alone.
    """
    if table.has("matrix"):
        for key in KEYS:
            if key != "matrix" and table.has(key):
                raise table.at.wrong(f"'matrix' says everything about the placement; drop it or {key!r}")
        return table.take("matrix", _matrix)  # type: ignore[no-any-return]
    move = table.take("translate", vector(3), np.zeros(3))
    stretch = table.take("scale", scalar_or_vector(3, number(above=0.0)), np.ones(3))
    return translation(move) @ _turn(table, move) @ np.diag([*stretch, 1.0])


def _turn(table: Table[Any], position: Float) -> Float:
    given = [key for key in ("rotate", "euler_deg", "look_at") if table.has(key)]
    if len(given) > 1:
        raise table.at.wrong(f"{given[0]!r} and {given[1]!r} both turn the object; keep one")
    if table.has("euler_deg"):
        angles = table.take("euler_deg", vector(3))
        x, y, z = (rotation(axis, deg) for axis, deg in zip(np.eye(3), angles, strict=True))
        turn: Float = z @ y @ x
        return turn
    if table.has("look_at"):
        return _aimed(table.at / "look_at", position, table.take("look_at", vector(3)))
    return table.take("rotate", _rotations, np.eye(4))  # type: ignore[no-any-return]


def _rotations(at: At, value: Any) -> Float:
    if not isinstance(value, list):
        return _one_rotation(at, value)
    turn = np.eye(4)
    for step in listed(_one_rotation)(at, value):
        turn = step @ turn
    return turn


def _one_rotation(at: At, value: Any) -> Float:
    table: Table[Any] = Table(at, value)
    axis, deg = table.take("axis", vector(3)), table.take("deg", number())
    table.done()
    if not np.linalg.norm(axis) > 1e-9:
        raise at.wrong("the axis must not be zero")
    return rotation(axis, deg)


def _aimed(at: At, position: Float, target: Float) -> Float:
    """The rotation that turns +z to the target, with -y as far up as it can be (as a camera would look)."""
    forward = target - position
    if not np.linalg.norm(forward) > 1e-9:
        raise at.wrong(f"the target {target.tolist()} must lie away from the object's own place")
    vertical = np.linalg.norm(forward[:2]) < 1e-6 * np.linalg.norm(forward)
    pose = look_at(position, target, up=(0.0, 1.0, 0.0) if vertical else (0.0, 0.0, 1.0))
    pose[:3, 3] = 0.0
    return pose


def _matrix(at: At, value: Any) -> Float:
    rows = np.array(listed(vector(4), 4, 4)(at, value))
    if rows[3].tolist() != [0, 0, 0, 1] or not np.linalg.det(rows[:3, :3]) > 1e-12:
        raise at.wrong("must be 4 rows of 4 with last row 0 0 0 1, invertible and not mirrored (determinant > 0)")
    return rows


def instances(at: At, value: Any) -> tuple[Float, ...]:
    """Poses of an object's copies: a list of placements, or an array {count, step, jitter, jitter_deg, seed}."""
    if isinstance(value, list):
        return tuple(listed(_instance, 1)(at, value))
    if isinstance(value, dict):
        return _array(Table(at, value))
    raise at.wrong(f"must be a list of placements or a table with count and step, got {show(value)}")


def _instance(at: At, value: Any) -> Float:
    table: Table[Any] = Table(at, value)
    pose = placement(table)
    table.done()
    return pose


def _array(table: Table[Any]) -> tuple[Float, ...]:
    """`count` = [nx, ny, nz] copies `step` = [dx, dy, dz] metres apart, centred, each moved and turned a little."""
    count = np.array(table.take("count", listed(whole(1, 10_000), 3, 3)))
    step = table.take("step", vector(3))
    jitter = table.take("jitter", scalar_or_vector(3, number(0.0)), np.zeros(3))
    jitter_deg = table.take("jitter_deg", scalar_or_vector(3, number(0.0, 180.0)), np.zeros(3))
    rng = np.random.default_rng(table.take("seed", whole(0, 2**32 - 1), 0))
    table.done()
    if count.prod() > 100_000:
        raise table.at.wrong(f"count makes {count.prod()} copies; at most 100000")
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), axis=-1).reshape(-1, 3)
    poses = []
    for offset in (cells - (count - 1) / 2) * step:
        angles = rng.uniform(-1, 1, 3) * jitter_deg
        x, y, z = (rotation(axis, deg) for axis, deg in zip(np.eye(3), angles, strict=True))
        poses.append(translation(offset + rng.uniform(-1, 1, 3) * jitter) @ z @ y @ x)
    return tuple(poses)


def camera_pose(table: Table[Any]) -> Float:
    """world_from_left from `position`, `look_at` and `up`."""
    eye, target = table.take("position", vector(3)), table.take("look_at", vector(3))
    up = table.take("up", vector(3), np.array([0.0, 0.0, 1.0]))
    try:
        return look_at(eye, target, up)
    except InputError as error:
        raise table.at.wrong(str(error)) from error
