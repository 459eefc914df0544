"""Poses as a scene file gives them: of objects and lights, of an object's copies, and of the left camera."""

import itertools
import math
from typing import Annotated, Any, ClassVar

import numpy as np
import pydantic
from numpy.typing import ArrayLike

from twinlens.errors import InputError
from twinlens.geometry import Float, look_at, skew
from twinlens.schema import NonNegative, Number, StrictModel, exactly, number, satisfies

_COPIES = satisfies(
    lambda count: math.prod(count) <= 100_000, "makes more than 100000 copies, got {}"
)

_FARTHEST = 1e9  # metres; Mitsuba's float32 has steps of 64 m there
Coordinate: Any = number(-_FARTHEST, _FARTHEST)
Length: Any = number(0, _FARTHEST, above=True)
Vector2 = Annotated[list[Coordinate], exactly(2, Coordinate)]
Vector3 = Annotated[list[Coordinate], exactly(3, Coordinate, name="Vector3")]
Scale = Annotated[list[Length], exactly(3, Length, or_one=True, name="Scale")]
"""Three numbers > 0, or one for all three axes."""

_ROW = Annotated[list[Coordinate], exactly(4, Coordinate)]
Matrix = Annotated[list[_ROW], exactly(4, _ROW, name="Matrix")]
_JITTER: Any = number(0, _FARTHEST)
_JITTER_DEG = Annotated[NonNegative, pydantic.Field(le=180)]
_COUNT = Annotated[int, pydantic.Field(ge=1, le=10_000)]


def rotation(axis: ArrayLike, deg: float) -> Float:
    """The 4x4 rotation by `deg` degrees about `axis` (3,), right-handed. Source: Rodrigues 1840."""
    K = skew(np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis))
    angle = math.radians(deg)
    pose = np.eye(4)
    pose[:3, :3] += math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)
    return pose


def euler_rotation(angles_deg: ArrayLike) -> Float:
    """The 4x4 rotation about the fixed axes x, then y, then z, by `angles_deg` (3,) degrees."""
    x, y, z = (
        rotation(axis, deg)
        for axis, deg in zip(np.eye(3), np.asarray(angles_deg), strict=True)
    )
    return np.asarray(z @ y @ x)


def translation(offset: ArrayLike) -> Float:
    """The 4x4 translation by `offset` (3,)."""
    pose = np.eye(4)
    pose[:3, 3] = offset
    return pose


def view_pose(
    position: ArrayLike, target: ArrayLike, up: ArrayLike | None = None
) -> Float:
    """world_from_cam (4, 4) of a camera; `up` is the world's z by default. Raises InputError as for a scene file."""
    try:
        return look_at(position, target, (0.0, 0.0, 1.0) if up is None else up)
    except InputError as error:
        raise InputError(
            "position and look_at must differ, and up must not be parallel to the line between them, "
            f"got position {position!r} and look_at {target!r}"
        ) from error


class Rotation(StrictModel):
    """A right-handed rotation by `deg` degrees about `axis`."""

    axis: Annotated[
        Vector3, satisfies(lambda axis: np.linalg.norm(axis) > 1e-9, "must not be zero")
    ]
    deg: Number


class Pose(StrictModel):
    """Rotation and translation. `rotate`, `euler_deg` and `look_at` exclude each other; `matrix` excludes all.

    `euler_deg` turns about x, y and z in that order. `look_at` is a point that the object's +z axis turns to.
    """

    translate: Vector3 | None = None
    rotate: Rotation | list[Rotation] | None = None
    euler_deg: Vector3 | None = None
    look_at: Vector3 | None = None
    matrix: Matrix | None = None

    placing_keys: ClassVar[tuple[str, ...]] = (
        "translate",
        "rotate",
        "euler_deg",
        "look_at",
        "matrix",
    )
    """The keys that set the pose; other keys of a table describe the object itself."""

    @pydantic.model_validator(mode="after")
    def _check(self) -> "Pose":
        rotations = {"rotate", "euler_deg", "look_at"}
        keys = [key for key in self.placing_keys if key in self.model_fields_set]
        for first, second in itertools.combinations(keys, 2):
            has_matrix = "matrix" in (first, second)
            if has_matrix or {first, second} <= rotations:
                raise InputError(f"{first!r} and {second!r} exclude each other")
        self.world_from_object()
        return self

    def world_from_object(self) -> Float:
        """(4, 4); the identity where no key is given."""
        if self.matrix is not None:
            matrix = np.array(self.matrix, dtype=np.float64)
            if (
                matrix[3].tolist() != [0, 0, 0, 1]
                or not np.linalg.det(matrix[:3, :3]) > 1e-12
            ):
                raise InputError(
                    "matrix must be 4 rows of 4 with last row 0 0 0 1 and determinant > 0 (not mirrored)"
                )
            return matrix
        position = np.array(self.translate or [0.0] * 3)
        turn = np.eye(4)
        if self.euler_deg is not None:
            turn = euler_rotation(self.euler_deg)
        elif self.look_at is not None:
            forward = self.look_at - position
            if not np.linalg.norm(forward) > 1e-9:
                raise InputError(
                    f"look_at: the target {self.look_at} must differ from the object's own position"
                )
            vertical = np.linalg.norm(forward[:2]) < 1e-6 * np.linalg.norm(forward)
            turn = look_at(
                position,
                self.look_at,
                up=(0.0, 1.0, 0.0) if vertical else (0.0, 0.0, 1.0),
            )
            turn[:3, 3] = 0.0
        for step in (
            self.rotate
            if isinstance(self.rotate, list)
            else [self.rotate]
            if self.rotate
            else []
        ):
            turn = rotation(step.axis, step.deg) @ turn
        return translation(position) @ turn


class Placement(Pose):
    """A pose, and a `scale` (one number or three) that is applied first."""

    placing_keys = (*Pose.placing_keys, "scale")
    scale: Scale | None = None

    def world_from_object(self) -> Float:
        return super().world_from_object() @ np.diag([*(self.scale or [1.0] * 3), 1.0])


class CopyGrid(StrictModel):
    """`count` = [nx, ny, nz] copies, `step` = [dx, dy, dz] metres apart, centred on the object.

    `jitter` (metres) and `jitter_deg` bound a random translation and rotation of each copy, per axis.
    """

    count: Annotated[list[_COUNT], exactly(3, _COUNT), _COPIES]
    step: Vector3
    jitter: Annotated[list[_JITTER], exactly(3, _JITTER, or_one=True)] = [0.0] * 3
    jitter_deg: Annotated[list[_JITTER_DEG], exactly(3, _JITTER_DEG, or_one=True)] = [
        0.0
    ] * 3
    seed: int = pydantic.Field(0, ge=0, lt=2**32)

    def poses(self) -> tuple[Float, ...]:
        rng = np.random.default_rng(self.seed)
        count = np.array(self.count)
        cells = np.stack(
            np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), axis=-1
        ).reshape(-1, 3)
        poses = []
        for offset in (cells - (count - 1) / 2) * self.step:
            turn = euler_rotation(rng.uniform(-1, 1, 3) * self.jitter_deg)
            poses.append(
                translation(offset + rng.uniform(-1, 1, 3) * self.jitter) @ turn
            )
        return tuple(poses)


Copies = Annotated[list[Placement], pydantic.Field(min_length=1)] | CopyGrid
"""Placements of an object's copies: a list, or a grid."""
