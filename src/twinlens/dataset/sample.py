"""A sample in memory: a rig, its truth, and the images taken with it. `sample_files` has its files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ApertureLens, Camera, Paraxial, RecipeLens, Rig
from twinlens.camera.truth import Truth
from twinlens.errors import InputError, counted

KIND, VERSION = "twinlens-sample", 1
"""The format and version of sample.json."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The images of one frame of a sequence, and the record of how they were taken; see `Shot`."""

    images: tuple[NDArray[Any], ...]
    radiances: tuple[NDArray[np.float32], ...] | None = None
    record: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Shot:
    """One image per camera of the rig, through one lens.

    lens : RecipeLens
    images : one uint8 or uint16 (H, W, 3) or (H, W) array per camera.
    radiances : one float32 (H, W, 3) linear array per camera, or None to store none.
    record : plain data on how the images were taken (spp, sensor, exposure, ...).
    halves : of dual pixels: the left and the right image of each camera, as `images`; or None.
    frames : of a sequence: the frames after the first, whose images are `images`.
    """

    lens: RecipeLens
    images: tuple[NDArray[Any], ...]
    radiances: tuple[NDArray[np.float32], ...] | None = None
    record: Mapping[str, Any] = field(default_factory=dict)
    halves: tuple[tuple[NDArray[Any], NDArray[Any]], ...] | None = None
    frames: tuple[Frame, ...] = ()

    def at_frame(self, number: int) -> "Shot":
        """The shot with the images of one frame only. The halves are those of the first frame."""
        if number == 0:
            return replace(self, frames=())
        frame = self.frames[number - 1]
        return Shot(self.lens, frame.images, frame.radiances, frame.record)


@dataclass(frozen=True, eq=False)
class Sample:
    """The content of one sample folder: a rig, its truth, and the shots taken with it.

    rig : takes the images. Truth and calibration are those of `rig.nominal`.
    shots : one per lens. The first is the folder's im0 and im1; the others go to lens-1, lens-2, ...
    truths : one per camera, or empty.
    ndisp : bound of the disparities, 0 <= d < ndisp; None: from the truth.
    record : plain data on how the sample was made (seed, scene, backend, versions, ...).
    models : triangles to store, by the name in `ObjectTruth.model`: vertices float (V, 3), metres, and faces (F, 3).

    Raises InputError if an array does not fit the rig, and for shots with different numbers of frames.
    """

    rig: Rig
    shots: tuple[Shot, ...]
    truths: tuple[Truth, ...] = ()
    ndisp: int | None = None
    record: Mapping[str, Any] = field(default_factory=dict)
    models: Mapping[str, tuple[NDArray[Any], NDArray[Any]]] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        if not self.shots:
            raise InputError("a sample needs one or more shots")
        if self.truths:
            self._check_sizes("truths", [truth.depth for truth in self.truths])
        if any(len(shot.frames) != len(self.shots[0].frames) for shot in self.shots):
            raise InputError("the shots of a sample must have equally many frames")
        for number, shot in enumerate(self.shots):
            for frame in shot.frames:
                self._check_sizes(f"images of a frame of shot {number}", frame.images)
            self._check_sizes(f"images of shot {number}", shot.images)
            if shot.radiances is not None:
                self._check_sizes(f"radiances of shot {number}", shot.radiances)
            if shot.halves is not None:
                left, right = zip(*shot.halves, strict=True)
                self._check_sizes(f"left halves of shot {number}", left)
                self._check_sizes(f"right halves of shot {number}", right)

    def _check_sizes(self, what: str, arrays: Sequence[NDArray[Any]]) -> None:
        """Raise InputError unless there is one array for each camera, of its size."""
        if len(arrays) != len(self.rig):
            raise InputError(
                f"{what}: got {len(arrays)}, but the rig has {counted(len(self.rig), 'camera')}"
            )
        for view, (array, camera) in enumerate(
            zip(arrays, self.rig.cameras, strict=True)
        ):
            if array.shape[:2] != (camera.height, camera.width):
                size = f"{camera.width} x {camera.height}"
                raise InputError(
                    f"{what}: camera {view} is {size}, its array is {array.shape}"
                )

    @property
    def num_frames(self) -> int:
        """The number of frames that each shot has; 1 without a sequence."""
        return 1 + len(self.shots[0].frames)

    def at_frame(self, number: int) -> "Sample":
        """The sample with the images of one frame only."""
        shots = tuple(shot.at_frame(number) for shot in self.shots)
        return replace(self, shots=shots)

    @property
    def is_rectified(self) -> bool:
        """Whether the first two cameras are a rectified pair, which calib.txt can describe."""
        return len(self.rig) > 1 and self.rig.nominal.is_rectified()


def rectified_pair(rig: Rig, view: int) -> tuple[int, int] | None:
    """The left and right camera of the pair of a view and its partner, if that pair is rectified."""
    partner = rig.partner(view)
    if partner is None:
        return None
    pair = (min(view, partner), max(view, partner))
    return pair if rig.is_rectified(*pair) else None


def shot_folder(lens: int, frame: int = 0) -> str:
    """The folder of the images through a lens in a frame, with its slash.

    Those of the first lens and frame are in the sample's own.

    >>> shot_folder(2), shot_folder(0, 1), shot_folder(2, 1)
    ('lens-2/', 'frame-1/', 'lens-2/frame-1/')
    """
    of_lens = f"lens-{lens}/" if lens else ""
    return f"{of_lens}frame-{frame}/" if frame else of_lens


def blur_circle_px(
    depth: NDArray[Any], camera: Camera, lens: ApertureLens
) -> NDArray[np.float32]:
    """`ApertureLens.blur_px` of the depth map of a camera, pixels, float32 (H, W)."""
    if isinstance(lens, Paraxial):  # its blur is the same at all film points
        return lens.blur_px(depth, camera.fx).astype(np.float32)
    x, y, _ = np.moveaxis(camera.unproject(camera.pixel_grid()), -1, 0)
    return lens.blur_px(depth, camera.fx, x, y).astype(np.float32)
