"""Several cameras with poses in one world, the rectified stereo pair, and calibration errors made on purpose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from twinlens.camera.distortion import BrownConrady
from twinlens.camera.intrinsics import Camera
from twinlens.camera.projector import Projector
from twinlens.errors import InputError, check_int, counted, format_value
from twinlens.geometry import Float, check_rigid, inverse, rigid, transform_points
from twinlens.geometry.motion import Motion, check_time
from twinlens.optics import check_length
from twinlens.settings import Setting, Settings

_ALIGNED = (
    1e-9  # relative to the baseline, and for unit axes: tolerance of a rectified pair
)
_ROUNDING = (
    1e-15  # relative to the distance from the world's origin: rounding of float64 poses
)


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras and their poses, one rigid (4, 4) array per camera.

    calibrated : the rig that the calibration describes, where it differs on purpose (`camera.misaligned`): images are
    taken by this rig, while a sample's truth and calibration are those of the calibrated one.
    projectors : they move with the first camera, in whose axes their poses are.
    motion : how the rig moves as one body, by default about the centre of its first camera. `at(time)` is the still rig
        that renders; a trajectory is of the axes in which the poses are given.

    Raises InputError when the counts differ, the rig is empty, a pose is not rigid, `calibrated` has other projectors,
    or has them at other places in the world, and for a motion that names an object or a light.
    """

    cameras: tuple[Camera, ...]
    world_from_cams: tuple[Float, ...]
    calibrated: "Rig | None" = None
    projectors: tuple[Projector, ...] = ()
    motion: Motion | None = None

    def __init__(
        self,
        cameras: Sequence[Camera],
        world_from_cams: Sequence[ArrayLike],
        calibrated: "Rig | None" = None,
        projectors: Sequence[Projector] = (),
        motion: Motion | None = None,
    ) -> None:
        if len(cameras) != len(world_from_cams) or not cameras:
            got = f"{counted(len(cameras), 'camera')} and {counted(len(world_from_cams), 'pose')}"
            raise InputError(f"a rig needs one pose per camera, got {got}")
        poses = tuple(
            check_rigid(pose, f"world_from_cams[{i}]")
            for i, pose in enumerate(world_from_cams)
        )
        if calibrated is not None:
            _check_calibrated(calibrated, cameras)
        if not isinstance(projectors, Sequence) or not all(
            isinstance(projector, Projector) for projector in projectors
        ):
            raise InputError(
                f"the projectors of a rig must be a list of Projectors, got {format_value(projectors)}"
            )
        values = {
            "cameras": tuple(cameras),
            "world_from_cams": poses,
            "calibrated": calibrated,
            "motion": _checked_motion(motion, poses[0][:3, 3]),
        }
        _check_sequences(projectors)
        for name, value in (values | {"projectors": tuple(projectors)}).items():
            object.__setattr__(self, name, value)
        if calibrated is not None and not _same_projectors(self, calibrated):
            raise InputError(
                "a rig and its calibrated rig must have the same projectors, at the same places"
            )

    @classmethod
    def stereo(
        cls,
        camera: Camera,
        baseline: float,
        world_from_left: ArrayLike | None = None,
        right: Camera | None = None,
    ) -> "Rig":
        """A rectified pair: the right camera is `baseline` metres along the left one's x axis, with parallel axes.

        `right` gives the right camera other intrinsics (its cx makes doffs = cx_right - cx_left); by default both
        are equal. By default the world frame is the left camera's.
        """
        check_length("baseline", baseline)
        right = right or camera
        if (camera.fx, camera.fy, camera.cy, camera.height) != (
            right.fx,
            right.fy,
            right.cy,
            right.height,
        ):
            raise InputError(
                "the cameras of a rectified pair must have equal fx, fy, cy and height"
            )
        left_pose = (
            np.eye(4)
            if world_from_left is None
            else check_rigid(world_from_left, "world_from_left")
        )
        left_from_right = rigid(np.eye(3), [baseline, 0.0, 0.0])
        return cls((camera, right), (left_pose, left_pose @ left_from_right))

    def moving(self, motion: Motion) -> "Rig":
        """The same rig, and its calibrated one, with a motion in place of any that they have. Raises InputError."""
        # Both turn about one point.
        fixed = _checked_motion(motion, self.world_from_cams[0][:3, 3])
        calibrated = self.calibrated
        if calibrated is not None:
            calibrated = replace(calibrated, motion=fixed)
        return replace(self, motion=fixed, calibrated=calibrated)

    def at(self, time: float) -> "Rig":
        """The still rig at a time (seconds); a rig without motion is the same at all times.

        Raises InputError outside the times of its keyframes or trajectory, with the range that they cover.

        >>> rig = Rig.stereo(Camera.from_fov(64, 48, 60), 0.1).moving(Motion(velocity=(0.5, 0, 0)))
        >>> rig.at(0.4).world_from_cams[0][:3, 3].tolist()
        [0.2, 0.0, 0.0]
        """
        check_time(time)
        if self.motion is None:
            return self
        origin = self.world_from_cams[0][:3, 3]
        return self._displaced(self.motion.displacement(time, origin))

    def _displaced(self, displacement: Float) -> "Rig":
        """The still rig, and its calibrated one, after a displacement (4, 4) in the world."""
        poses = [displacement @ pose for pose in self.world_from_cams]
        calibrated = None
        if self.calibrated is not None:
            calibrated = self.calibrated._displaced(displacement)
        return Rig(self.cameras, poses, calibrated, self.projectors)

    @property
    def nominal(self) -> "Rig":
        """The rig of truth and calibration: `calibrated`, or this rig where it has none."""
        return self.calibrated or self

    def __len__(self) -> int:
        return len(self.cameras)

    def b_from_a(self, a: int, b: int) -> Float:
        """The transform from camera a's coordinates to camera b's, (4, 4)."""
        return inverse(self.world_from_cams[b]) @ self.world_from_cams[a]

    def project(self, index: int, points_world: ArrayLike) -> Float:
        """Pixels (..., 2) of world points (..., 3) in camera `index`, distorted; NaN as in `Camera.project`."""
        return self.cameras[index].project(
            transform_points(inverse(self.world_from_cams[index]), points_world)
        )

    def unproject(self, index: int, pixels: ArrayLike, depth: ArrayLike) -> Float:
        """The world points (..., 3) at `depth` (...,) metres of the pixels (..., 2) of camera `index`.

        >>> rig = Rig.stereo(Camera.from_fov(64, 48, 60), 0.1)
        >>> rig.project(1, rig.unproject(1, [10.0, 20.0], 2.0)).round(9).tolist()
        [10.0, 20.0]
        """
        directions = self.cameras[index].unproject(pixels)
        points_cam = np.asarray(depth, dtype=np.float64)[..., None] * directions
        return transform_points(self.world_from_cams[index], points_cam)

    @property
    def world_from_projectors(self) -> tuple[Float, ...]:
        """The poses of the projectors in the world, (4, 4) each."""
        return tuple(
            self.world_from_cams[0] @ projector.pose for projector in self.projectors
        )

    def with_projectors(self, projectors: Sequence[Projector]) -> "Rig":
        """The same cameras with these projectors; a `calibrated` rig gets them at the same places in the world."""
        made = Rig(
            self.cameras,
            self.world_from_cams,
            projectors=projectors,
            motion=self.motion,
        )
        if self.calibrated is None:
            return made
        moved = made.projectors_from(self.calibrated.world_from_cams[0])
        return replace(made, calibrated=self.calibrated.with_projectors(moved))

    def projectors_from(self, world_from_first: Float) -> tuple[Projector, ...]:
        """The projectors where they are, for a rig whose first camera has this pose."""
        first_from_world = inverse(world_from_first)
        poses = self.world_from_projectors
        return tuple(
            replace(p, pose=first_from_world @ pose)
            for p, pose in zip(self.projectors, poses, strict=True)
        )

    @property
    def num_frames(self) -> int:
        """The number of frames of a sample: that of the patterns of its projectors' sequences, or 1."""
        return max((projector.num_frames for projector in self.projectors), default=1)

    def at_frame(self, frame: int) -> "Rig":
        """The rig with the patterns that its projectors show in a frame. Raises InputError for another frame."""
        check_int("frame", frame, 0, self.num_frames - 1)
        if self.num_frames == 1:
            return self
        shown = [projector.at_frame(frame) for projector in self.projectors]
        return self.with_projectors(shown)

    @property
    def views(self) -> "Rig":
        """The cameras and then the projectors as cameras: projector i is camera len(rig) + i.

        For geometry between cameras and projectors, as `camera.multiview.triangulate`.
        """
        cameras = [
            *self.cameras,
            *(projector.intrinsics for projector in self.projectors),
        ]
        poses = [*self.world_from_cams, *self.world_from_projectors]
        return Rig(cameras, poses, motion=self.motion)

    def partner(self, index: int) -> int | None:
        """The camera that `index` is matched with: 0 with 1, 2 with 3, ...; an odd last one with the one before it.

        The count is among the cameras of its band, or among all where it is the only one of its band.
        """
        band = self.cameras[index].band
        alike = [i for i, camera in enumerate(self.cameras) if camera.band == band]
        if len(alike) == 1:
            alike = list(range(len(self)))
        if len(alike) == 1:
            return None
        place = alike.index(index)
        partner = place ^ 1  # exchanges 0 with 1, 2 with 3, ...
        return alike[partner] if partner < len(alike) else alike[place - 1]

    def pair(self, a: int, b: int) -> "Rig":
        """The rig of cameras `a` and `b`, in that order, with the pair of its `calibrated` rig.

        Projectors whose light neither of the two sees are left out.
        """
        calibrated = None if self.calibrated is None else self.calibrated.pair(a, b)
        cameras = [self.cameras[i] for i in (a, b)]
        poses = [self.world_from_cams[i] for i in (a, b)]
        seen = _bands(cameras)
        projectors = [
            projector
            for projector in self.projectors_from(poses[0])
            if projector.band in seen
        ]
        return Rig(cameras, poses, calibrated, projectors, self.motion)

    def baseline(self, a: int = 0, b: int = 1) -> float:
        """Distance of two camera centres, metres."""
        return float(
            np.linalg.norm(
                self.world_from_cams[b][:3, 3] - self.world_from_cams[a][:3, 3]
            )
        )

    def doffs(self, left: int = 0, right: int = 1) -> float:
        """cx_right - cx_left, pixels."""
        return self.cameras[right].cx - self.cameras[left].cx

    def is_rectified(self, left: int = 0, right: int = 1) -> bool:
        """Whether the two are a rectified pair in this order: equal rows, parallel axes, the right one along +x."""
        a, b = self.cameras[left], self.cameras[right]
        if (
            a.distortion
            or b.distortion
            or (a.fx, a.fy, a.cy, a.height) != (b.fx, b.fy, b.cy, b.height)
        ):
            return False
        left_from_right = self.b_from_a(right, left)
        x, y, z = left_from_right[:3, 3]
        parallel = np.abs(left_from_right[:3, :3] - np.eye(3)).max() <= _ALIGNED
        extent = max(
            np.abs(pose[:3, 3]).max()
            for pose in (self.world_from_cams[left], self.world_from_cams[right])
        )
        return bool(
            parallel
            and x > 0
            and max(abs(y), abs(z)) <= _ALIGNED * x + _ROUNDING * extent
        )


def _checked_motion(motion: Motion | None, centre: Float) -> Motion | None:
    """The motion of a rig about `centre`. Raises InputError for what is not one, or is that of an object or a light."""
    if motion is None:
        return None
    if not isinstance(motion, Motion):
        raise InputError(
            f"the motion of a rig must be a Motion, got {format_value(motion)}"
        )
    if motion.object is not None or motion.light is not None:
        raise InputError(
            f"the motion of a rig must not name what moves, it names {motion.subject}"
        )
    return motion.about_point(centre)


def _check_sequences(projectors: Sequence[Projector]) -> None:
    """Raise InputError for sequences of different lengths."""
    lengths = [projector.num_frames for projector in projectors if projector.sequence]
    if len(set(lengths)) > 1:
        raise InputError(
            f"the sequences of a rig's projectors must have equally many patterns, got {lengths}"
        )


def _check_calibrated(calibrated: Rig, cameras: Sequence[Camera]) -> None:
    """InputError unless it is a rig of as many cameras, of the same image sizes, and not itself a rig in error."""
    if not isinstance(calibrated, Rig) or calibrated.calibrated is not None:
        raise InputError("calibrated must be a Rig that has no calibrated rig itself")
    sizes = [(camera.width, camera.height) for camera in cameras]
    if [(camera.width, camera.height) for camera in calibrated.cameras] != sizes:
        raise InputError(
            "a rig and its calibrated rig must have as many cameras, of the same image sizes"
        )


def _same_projectors(a: Rig, b: Rig) -> bool:
    if len(a.projectors) != len(b.projectors):
        return False
    pairs = zip(a.projectors_from(np.eye(4)), b.projectors_from(np.eye(4)), strict=True)
    return all(one.agrees_with(partner) for one, partner in pairs)


def _bands(cameras: Sequence[Camera]) -> set[str]:
    """The bands that any of the cameras sees."""
    return set[str]().union(*(camera.bands for camera in cameras))


def check_seen(rig: Rig) -> None:
    """Raise InputError for a projector whose light no camera of `rig` sees."""
    seen = _bands(rig.cameras)
    for i, projector in enumerate(rig.projectors):
        if projector.band not in seen:
            remedy = f"give a camera band = {projector.band!r}, or the projector another band"
            raise InputError(
                f"projectors[{i}] has the band {projector.band!r}, which no camera sees: {remedy}"
            )


@dataclass(frozen=True)
class Misalignment(Settings, noun="misalignment"):
    """The error of one camera against its calibration.

    The rotation is R = Rz(roll) Ry(yaw) Rx(pitch) about the calibrated axes; the displacement is along them.

    Raises InputError when a value is out of range.
    """

    vertical_px: Annotated[
        float,
        Setting(
            "Shift of the image down, added to cy.", "pixels", least=-1e9, most=1e9
        ),
    ] = 0.0
    pitch_deg: Annotated[
        float,
        Setting("Rotation about the x axis.", "degrees", least=-89.999, most=89.999),
    ] = 0.0
    yaw_deg: Annotated[
        float,
        Setting("Rotation about the y axis.", "degrees", least=-89.999, most=89.999),
    ] = 0.0
    roll_deg: Annotated[
        float,
        Setting("Rotation about the z axis.", "degrees", least=-89.999, most=89.999),
    ] = 0.0
    focal: Annotated[
        float, Setting("Factor of the focal length.", least=0.1, most=10)
    ] = 1.0
    k1: Annotated[
        float,
        Setting(
            "Added to the distortion's first radial coefficient.", least=-1e6, most=1e6
        ),
    ] = 0.0
    right_mm: Annotated[
        float, Setting("Displacement along x.", "millimetres", least=-1e6, most=1e6)
    ] = 0.0
    down_mm: Annotated[
        float, Setting("Displacement along y.", "millimetres", least=-1e6, most=1e6)
    ] = 0.0
    forward_mm: Annotated[
        float, Setting("Displacement along z.", "millimetres", least=-1e6, most=1e6)
    ] = 0.0

    def camera(self, camera: Camera) -> Camera:
        """A calibrated camera's intrinsics with this error. Raises InputError if the distortion folds the image."""
        distortion = camera.distortion
        if self.k1:
            distortion = distortion or BrownConrady()
            distortion = replace(distortion, k1=distortion.k1 + self.k1)
        fx, fy = camera.fx * self.focal, camera.fy * self.focal
        cy = camera.cy + self.vertical_px
        return camera.replace(fx=fx, fy=fy, cy=cy, distortion=distortion)


ALIGNED = Misalignment()


def misaligned(rig: Rig, errors: Sequence[Misalignment]) -> Rig:
    """`rig` with one error per camera; its `calibrated` is that of `rig`. Raises InputError when the counts differ."""
    from scipy.spatial.transform import Rotation  # 0.3 s to import

    if len(errors) != len(rig):
        raise InputError(
            f"a rig of {counted(len(rig), 'camera')} needs {counted(len(rig), 'misalignment')}, got {len(errors)}"
        )
    cameras, poses = [], []
    for camera, pose, error in zip(
        rig.cameras, rig.world_from_cams, errors, strict=True
    ):
        angles = (error.pitch_deg, error.yaw_deg, error.roll_deg)
        step = 1e-3 * np.array([error.right_mm, error.down_mm, error.forward_mm])
        motion = rigid(
            Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), step
        )
        cameras.append(error.camera(camera))
        poses.append(pose @ motion)
    projectors = rig.projectors_from(poses[0])
    return Rig(cameras, poses, rig.nominal, projectors, rig.motion)
