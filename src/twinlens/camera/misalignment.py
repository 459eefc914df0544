"""Errors of calibration left in on purpose: a camera stands and looks a little otherwise than its owner believes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from twinlens.camera.rig import Rig
from twinlens.errors import InputError, check_number
from twinlens.geometry import rigid


@dataclass(frozen=True)
class Misalignment:
    """How far one camera is from where calibration has it.

    vertical_px : its image is shifted down by this many pixels (cy is).
    pitch_deg, yaw_deg, roll_deg : the camera is turned about the x, then the y, then the z axis that calibration gives
    it; these stay where they are meanwhile: R = Rz(roll) Ry(yaw) Rx(pitch).

    Raises InputError for what is no number, and for a quarter turn and more, which is another camera and no error.
    """

    vertical_px: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check_number(name, value, "a finite number")
            if name.endswith("_deg"):
                check_number(name, value, "less than a quarter turn, -90 to 90 degrees", above=-90, below=90)

    def applied(self, rig: Rig) -> Rig:
        """The pair `rig` with its second camera so shifted and turned; its `calibrated` is the rig as it was."""
        if len(rig) != 2:
            raise InputError(f"one misalignment is that of a pair's second camera; this rig has {len(rig)} cameras")
        return misaligned(rig, (ALIGNED, self))


ALIGNED = Misalignment()


def misaligned(rig: Rig, errors: Sequence[Misalignment]) -> Rig:
    """`rig` with one error a camera; its `calibrated` is the rig as it was. Raises InputError when the counts differ."""
    if len(errors) != len(rig):
        raise InputError(f"a rig of {len(rig)} cameras needs as many misalignments, got {len(errors)}")
    cameras, poses = [], []
    for camera, pose, error in zip(rig.cameras, rig.world_from_cams, errors, strict=True):
        angles = (error.pitch_deg, error.yaw_deg, error.roll_deg)
        turn = rigid(Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), np.zeros(3))
        cameras.append(camera.replace(cy=camera.cy + error.vertical_px))
        poses.append(pose @ turn)
    return Rig(cameras, poses, calibrated=rig)
