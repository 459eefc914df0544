"""Motion of rigid bodies: where an object, a light or a rig is at a time.

`Motion.displacement` is the one formula; poses of objects, of copies, of lights and of cameras are products with it.
Times are seconds. Between samples of a path, translations are linear and rotations are Slerp (Shoemake 1985).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from twinlens.errors import InputError, check_number, format_value
from twinlens.geometry import Float, float_array, rigid
from twinlens.settings import Setting, Settings

_FARTHEST = 1e9  # metres, as in scene files
_UNIT = (
    1e-3  # largest deviation of a quaternion's length from 1, which four digits explain
)
_SAME_TIME = 1e-6  # seconds outside of a path that count as its end; unix times are rounded to 2e-7
_HALF_TURN_DEG = 180.0

Vector = tuple[float, float, float]


def check_time(value: Any) -> float:
    """A time in seconds. Raises InputError unless it is a finite number."""
    check_number("a time", value, "a finite number of seconds")
    return float(value)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A sampled path: poses world_from_body at rising times.

    times : (N,), seconds, N >= 2.
    positions : (N, 3), metres.
    quaternions : (N, 4), x y z w, scaled to length 1.

    Raises InputError for other shapes, values that are not finite, times that do not rise, and quaternions whose length
    is not 1 within 0.001.
    """

    times: Float
    positions: Float
    quaternions: Float

    def __post_init__(self) -> None:
        times = float_array("the times of a trajectory", self.times)
        if times.ndim != 1 or len(times) < 2:
            raise InputError(
                f"a trajectory needs two times or more (N,), got the shape {times.shape}"
            )
        _check_rising(times.tolist())
        object.__setattr__(self, "times", times)
        for name, width in (("positions", 3), ("quaternions", 4)):
            values = float_array(f"the {name} of a trajectory", getattr(self, name))
            if values.shape != (len(times), width):
                raise InputError(
                    f"the {name} of a trajectory must have the shape ({len(times)}, {width}), got {values.shape}"
                )
            if not np.isfinite(values).all():
                row = int((~np.isfinite(values)).any(axis=1).argmax())
                raise InputError(
                    f"the {name} of a trajectory must be finite; row {row} is not"
                )
            object.__setattr__(self, name, values)
        self._scale_to_unit()

    def _scale_to_unit(self) -> None:
        lengths = np.linalg.norm(self.quaternions, axis=1)
        worst = int(np.abs(lengths - 1).argmax())
        if abs(lengths[worst] - 1) > _UNIT:
            raise InputError(
                f"the quaternion (x y z w) at {self.times[worst]:.15g} s must have the length 1, its length deviates "
                f"by {lengths[worst] - 1:+.3g}: {format_value(self.quaternions[worst].tolist())}"
            )
        object.__setattr__(self, "quaternions", self.quaternions / lengths[:, None])

    def at(self, time: float) -> Float:
        """world_from_body (4, 4) at a time. Raises InputError outside of the times, with the range that they cover."""
        from scipy.spatial.transform import Rotation, Slerp  # 0.3 s to import

        first, last = self.times[[0, -1]].tolist()
        if not first - _SAME_TIME <= time <= last + _SAME_TIME:
            raise InputError(
                f"covers {first:.15g} s to {last:.15g} s, but is asked for {time:.15g} s"
            )
        time = min(max(time, first), last)
        after = int(np.searchsorted(self.times[1:-1], time, side="right")) + 1
        ends = slice(after - 1, after + 1)
        start, stop = self.times[ends].tolist()
        share = (time - start) / (stop - start)
        a, b = self.positions[ends]
        turn = Slerp([start, stop], Rotation.from_quat(self.quaternions[ends]))(time)
        return rigid(turn.as_matrix(), (1 - share) * a + share * b)


def _check_rising(times: Sequence[float]) -> None:
    """Raise InputError unless all times are finite, and later than those before."""
    for number, time in enumerate(times):
        check_time(time)
        if number and not time > times[number - 1]:
            is_same = time == times[number - 1]
            problem = "repeats" if is_same else "is before"
            raise InputError(
                f"times must rise: the time {number} (from 0), {time:.15g} s, {problem} the one before, "
                f"{times[number - 1]:.15g} s"
            )


@dataclass(frozen=True)
class Turn(Settings, noun="rotation"):
    """A right-handed rotation about an axis. Raises InputError where the axis is 0 0 0."""

    axis: Annotated[Vector, Setting("Axis, of any length.", least=-1e9, most=1e9)]
    deg: Annotated[float, Setting("Angle.", "degrees", least=-1e9, most=1e9)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.linalg.norm(self.axis) > 1e-9:
            raise InputError(
                f"rotation axis must not be zero, got {format_value(self.axis)}"
            )

    @property
    def vector(self) -> Float:
        """The rotation vector (3,): the unit axis times the angle in degrees."""
        axis = np.array(self.axis)
        return np.asarray(self.deg * axis / np.linalg.norm(axis))


@dataclass(frozen=True)
class Keyframe(Settings, noun="keyframe"):
    """Where a body is at a time, relative to its placement, along the axes of the world."""

    time: Annotated[float, Setting("Time.", "seconds", least=-1e12, most=1e12)]
    translate: Annotated[
        Vector,
        Setting(
            "Displacement along the axes of the world.",
            "metres",
            least=-_FARTHEST,
            most=_FARTHEST,
        ),
    ] = (0.0, 0.0, 0.0)
    rotate: Annotated[
        Turn | None, Setting("Rotation about the body's origin, or `about`.")
    ] = None

    @property
    def vector(self) -> Float:
        """The rotation vector (3,) in degrees."""
        return np.zeros(3) if self.rotate is None else self.rotate.vector


_POINT = Setting(
    "Point that rotations are about, where it is at time 0 or in the placement; the body's own origin by default.",
    "metres",
    least=-_FARTHEST,
    most=_FARTHEST,
)


@dataclass(frozen=True)
class Motion(Settings, noun="motion"):
    """How an object, a light or a rig moves: at constant velocity, by keyframes, or along a trajectory.

    With velocities, a body is at its placement at time 0: it moves by v t, and turns by w t about its own origin, both
    along the axes of the world. Keyframes are such displacements at given times. A trajectory has poses of axes in
    which the placement is: world_from_object(t) = trajectory(t) @ placement. Outside the times of keyframes and
    trajectories a pose is unknown, and asking for it raises InputError.

    Raises InputError unless exactly one of the three is given, for keyframes whose times do not rise, and for two
    keyframes half a turn or more apart about one axis, between which Slerp would turn the other way.
    """

    object: Annotated[
        str | None,
        Setting("Name of an object, or of one of its copies as `name[0]`."),
    ] = None
    light: Annotated[str | None, Setting("Name of a point light or spot.")] = None
    velocity: Annotated[
        Vector | None,
        Setting(
            "Velocity along the axes of the world.",
            "metres per second",
            least=-_FARTHEST,
            most=_FARTHEST,
        ),
    ] = None
    angular_velocity_deg: Annotated[
        Vector | None,
        Setting(
            "Rotation per second: its axis in the world, times its speed.",
            "degrees per second",
            least=-1e9,
            most=1e9,
        ),
    ] = None
    about: Annotated[Vector | None, _POINT] = None
    keyframes: Annotated[
        tuple[Keyframe, ...], Setting("Displacements at two times or more.")
    ] = ()
    trajectory: Annotated[
        Trajectory | None, Setting("Poses of the axes of the placement.")
    ] = None

    def __post_init__(self) -> None:
        if isinstance(self.keyframes, list):
            object.__setattr__(self, "keyframes", tuple(self.keyframes))
        super().__post_init__()
        if self.object is not None and self.light is not None:
            raise InputError("'object' and 'light' exclude each other")
        self._check_kind()
        if self.keyframes:
            self._check_keyframes()

    def _check_kind(self) -> None:
        """Raise InputError unless exactly one kind of motion is given, and `about` not with a trajectory."""
        has_velocity = (
            self.velocity is not None or self.angular_velocity_deg is not None
        )
        kinds = {
            "velocity": has_velocity,
            "keyframes": bool(self.keyframes),
            "trajectory": self.trajectory is not None,
        }
        names = [name for name, is_set in kinds.items() if is_set]
        if not names:
            raise InputError(
                "a motion needs velocity, angular_velocity_deg, keyframes or a trajectory"
            )
        if len(names) > 1:
            raise InputError(f"{names[0]!r} and {names[1]!r} exclude each other")
        if self.about is not None and self.trajectory is not None:
            raise InputError("'trajectory' and 'about' exclude each other")

    def _check_keyframes(self) -> None:
        if len(self.keyframes) < 2:
            raise InputError("keyframes: needs two or more, got 1")
        try:
            _check_rising([keyframe.time for keyframe in self.keyframes])
        except InputError as error:
            raise InputError(f"keyframes: {error}") from error
        vectors = [keyframe.vector for keyframe in self.keyframes]
        for number in range(1, len(vectors)):
            before, after = vectors[number - 1 : number + 1]
            lengths = np.linalg.norm(before) * np.linalg.norm(after)
            # Parallel but for rounding.
            is_one_axis = np.linalg.norm(np.cross(before, after)) <= 1e-9 * lengths
            turned = float(np.linalg.norm(after - before))
            if is_one_axis and turned >= _HALF_TURN_DEG:
                raise InputError(
                    f"keyframes {number - 1} and {number} are {turned:g} degrees apart, and the shorter way "
                    "between them is not this one: add a keyframe between, so that each step is under 180 degrees"
                )

    @property
    def subject(self) -> str:
        """What moves, for messages."""
        if self.object is not None:
            return f"object {self.object!r}"
        return "the rig" if self.light is None else f"light {self.light!r}"

    @cached_property
    def _path(self) -> Trajectory | None:
        """The samples of keyframes or of the trajectory; None for velocities."""
        from scipy.spatial.transform import Rotation  # 0.3 s to import

        if not self.keyframes:
            return self.trajectory
        vectors = np.array([keyframe.vector for keyframe in self.keyframes])
        return Trajectory(
            np.array([keyframe.time for keyframe in self.keyframes]),
            np.array([keyframe.translate for keyframe in self.keyframes]),
            Rotation.from_rotvec(vectors, degrees=True).as_quat(),
        )

    def displacement(self, time: float, origin: ArrayLike) -> Float:
        """The rigid (4, 4) that takes points of the body from its placement to where they are at a time.

        With the rotation R and the displacement d at that time, a point x goes to R (x - o) + o + d. The centre o is
        `about`, or else `origin` (3,). Along a trajectory it is the pose of the trajectory.

        Raises InputError outside the times of keyframes or trajectory, with the range that they cover.
        """
        moved = self._moved(check_time(time))
        if self.trajectory is not None:
            return moved
        centre = np.asarray(origin if self.about is None else self.about, np.float64)
        turn, shift = moved[:3, :3], moved[:3, 3]
        return rigid(turn, shift + centre - turn @ centre)

    def _moved(self, time: float) -> Float:
        """[R d] at a time (4, 4)."""
        from scipy.spatial.transform import Rotation

        path = self._path
        if path is not None:
            try:
                return path.at(time)
            except InputError as error:
                kind = "keyframes of" if self.keyframes else "trajectory of"
                raise InputError(f"{kind} {self.subject}: {error}") from error
        still = (0.0, 0.0, 0.0)
        turned_deg = time * np.array(self.angular_velocity_deg or still)
        turn = Rotation.from_rotvec(turned_deg, degrees=True).as_matrix()
        return rigid(turn, time * np.array(self.velocity or still))

    def pose_at(self, time: float, placement: ArrayLike) -> Float:
        """world_from_object (4, 4) at a time, of a body whose pose in its scene file is `placement`, affine (4, 4)."""
        pose = np.asarray(placement, dtype=np.float64)
        return np.asarray(self.displacement(time, pose[:3, 3]) @ pose)

    def about_point(self, point: Iterable[float]) -> "Motion":
        """The same motion, whose rotations are about a point (3,) unless it has one already."""
        if self.about is not None or self.trajectory is not None:
            return self
        x, y, z = map(float, point)
        return replace(self, about=(x, y, z))
