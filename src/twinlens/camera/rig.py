"""Several cameras in one world: any poses, and the rectified stereo pair as the special case people use most."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError
from twinlens.geometry import Float, check_rigid, inverse, rigid, transform_points
from twinlens.optics import check_length

_ALIGNED = 1e-9  # of the baseline (metres) or of a unit axis: beyond this a pair is not rectified

_ROUNDING = 1e-15  # of the distance from the world's origin: what float64 poses cannot say


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras and their poses.

    Parameters
    ----------
    cameras : sequence of Camera
    world_from_cams : sequence of (4, 4) arrays
        One rigid pose a camera.
    calibrated : Rig or None
        The rig that the calibration describes, where it differs on purpose (`camera.misaligned`): images are taken by
        this rig, while a sample's truth and calibration are those of the calibrated one.

    Raises InputError when the counts differ, there is none, or a pose is not rigid.
    """

    cameras: tuple[Camera, ...]
    world_from_cams: tuple[Float, ...]
    calibrated: "Rig | None" = None

    def __init__(
        self, cameras: Sequence[Camera], world_from_cams: Sequence[ArrayLike], calibrated: "Rig | None" = None
    ) -> None:
        if len(cameras) != len(world_from_cams) or not cameras:
            raise InputError(
                f"a rig needs one pose a camera, got {len(cameras)} cameras and {len(world_from_cams)} poses"
            )
        poses = tuple(check_rigid(pose, f"world_from_cams[{i}]") for i, pose in enumerate(world_from_cams))
        _check_calibrated(calibrated, cameras)
        object.__setattr__(self, "calibrated", calibrated)
        object.__setattr__(self, "cameras", tuple(cameras))
        object.__setattr__(self, "world_from_cams", poses)

    @classmethod
    def stereo(
        cls, camera: Camera, baseline: float, world_from_left: ArrayLike | None = None, right: Camera | None = None
    ) -> "Rig":
        """A rectified pair: the right camera stands `baseline` metres along the left one's x axis, axes parallel.

        `right` gives the right camera's own intrinsics (its cx makes doffs = cx_right - cx_left); the left one's unless
        said. World coordinates are the left camera's when no pose is given.
        """
        check_length("baseline", baseline)
        right = right or camera
        if (camera.fx, camera.fy, camera.cy, camera.height) != (right.fx, right.fy, right.cy, right.height):
            raise InputError("the right camera of a rectified pair shares fx, fy, cy and height with the left one")
        left_pose = np.eye(4) if world_from_left is None else check_rigid(world_from_left, "world_from_left")
        left_from_right = rigid(np.eye(3), [baseline, 0.0, 0.0])
        return cls((camera, right), (left_pose, left_pose @ left_from_right))

    @property
    def nominal(self) -> "Rig":
        """The rig of truth and calibration: `calibrated`, or this rig where it has none."""
        return self.calibrated or self

    def __len__(self) -> int:
        return len(self.cameras)

    def b_from_a(self, a: int, b: int) -> Float:
        """Camera b's coordinates from camera a's, (4, 4)."""
        return inverse(self.world_from_cams[b]) @ self.world_from_cams[a]

    def px_from_world(self, index: int) -> Float:
        """The projection matrix K [R | t] of one camera, (3, 4), without its distortion."""
        return self.cameras[index].K @ inverse(self.world_from_cams[index])[:3]

    def project(self, index: int, points_world: ArrayLike) -> Float:
        """Where camera `index` forms world points (..., 3), its distortion included: pixels (..., 2).

        NaN for points that it does not see, as `Camera.project` says.
        """
        return self.cameras[index].project(transform_points(inverse(self.world_from_cams[index]), points_world))

    def unproject(self, index: int, pixels: ArrayLike, depth: ArrayLike) -> Float:
        """The world points (..., 3) at `depth` (...,) metres along the rays of camera `index`'s pixels (..., 2).

        >>> rig = Rig.stereo(Camera.from_fov(64, 48, 60), 0.1)
        >>> rig.project(1, rig.unproject(1, [10.0, 20.0], 2.0)).round(9).tolist()
        [10.0, 20.0]
        """
        along = np.asarray(depth, dtype=np.float64)[..., None] * self.cameras[index].unproject(pixels)
        return transform_points(self.world_from_cams[index], along)

    def partner(self, index: int) -> int | None:
        """The camera that `index` is matched with: 0 with 1, 2 with 3, ...; the last of an odd number with its left."""
        if len(self) == 1:
            return None
        other = index ^ 1
        return other if other < len(self) else index - 1

    def pair(self, a: int, b: int) -> "Rig":
        """The rig of cameras `a` and `b`, in that order, with the pair of its `calibrated` rig."""
        calibrated = None if self.calibrated is None else self.calibrated.pair(a, b)
        return Rig([self.cameras[i] for i in (a, b)], [self.world_from_cams[i] for i in (a, b)], calibrated)

    def baseline(self, a: int = 0, b: int = 1) -> float:
        """Distance of two camera centres, metres."""
        return float(np.linalg.norm(self.world_from_cams[b][:3, 3] - self.world_from_cams[a][:3, 3]))

    def doffs(self, left: int = 0, right: int = 1) -> float:
        """cx_right - cx_left, pixels."""
        return self.cameras[right].cx - self.cameras[left].cx

    def is_rectified(self, left: int = 0, right: int = 1) -> bool:
        """Whether the two are a rectified pair in this order: equal rows, parallel axes, right one along +x."""
        a, b = self.cameras[left], self.cameras[right]
        if a.distortion or b.distortion or (a.fx, a.fy, a.cy, a.height) != (b.fx, b.fy, b.cy, b.height):
            return False
        left_from_right = self.b_from_a(right, left)
        x, y, z = left_from_right[:3, 3]
        parallel = np.abs(left_from_right[:3, :3] - np.eye(3)).max() <= _ALIGNED
        far = max(np.abs(pose[:3, 3]).max() for pose in (self.world_from_cams[left], self.world_from_cams[right]))
        return bool(parallel and x > 0 and max(abs(y), abs(z)) <= _ALIGNED * x + _ROUNDING * far)


def _check_calibrated(calibrated: object, cameras: Sequence[Camera]) -> None:
    if calibrated is None:
        return
    if not isinstance(calibrated, Rig) or calibrated.calibrated is not None:
        raise InputError("calibrated must be a Rig that has no calibrated rig itself")
    if [(c.width, c.height) for c in calibrated.cameras] != [(c.width, c.height) for c in cameras]:
        raise InputError("a rig and its calibrated rig must have the same number of cameras and the same image sizes")
