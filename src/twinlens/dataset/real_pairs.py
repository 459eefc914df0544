"""Real pairs in the folders of KITTI and ETH3D, with measured truth or, where its folders are missing, without.

    KITTI 2015   training/{image_2,image_3,disp_occ_0,disp_noc_0}/000000_10.png
    KITTI 2012   training/{colored_0,colored_1 or image_0,image_1}/, disp_occ/, disp_noc/
    ETH3D        two_view_training/<scene>/ and, beside it, two_view_training_gt/<scene>/

Without truth are KITTI's other sets, such as testing/ and the sequences of odometry, and ETH3D's two_view_test.
Middlebury's folders are read as any plain dataset.

Source: the readme.txt of KITTI's development kits; https://www.eth3d.net/documentation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.channels import DISPARITY, IMAGE, MASK
from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.codecs.pfm import read_disparity
from twinlens.dataset.dataset import open_sample
from twinlens.dataset.files import read_text
from twinlens.dataset.storage import Place, Where, place
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.visibility import Mask, mask_of
from twinlens.errors import FileError, InputError

_KITTI = (
    ("image_2", "image_3", "disp_occ_0", "disp_noc_0"),
    ("colored_0", "colored_1", "disp_occ", "disp_noc"),
    ("image_0", "image_1", "disp_occ", "disp_noc"),
)
_CAMERAS = {"image_2": (2, 3), "colored_0": (2, 3), "image_0": (0, 1)}
"""KITTI's numbers of the two cameras, by the folder of the left images."""
_ETH3D, _ETH3D_BLIND = "two_view_training", "two_view_test"
_ETH3D_TRUTH = "two_view_training_gt"
# The folders that `twinlens export` makes for torchvision.
_EXPORTS = ("Kitti2015", "ETH3D")
# KITTI's map of the pixels that are visible in both views.
_VISIBLE = "disp_noc"


@dataclass(frozen=True)
class DownloadedPair(StoredSample):
    """A pair of KITTI or ETH3D. `files` are the places of its files by the names of a `StoredSample`.

    kitti_cameras: the numbers of its cameras in a calibration of KITTI, which "calib.txt" then is.
    """

    files: Mapping[str, Place] = field(default_factory=dict, compare=False, repr=False)
    kitti_cameras: tuple[int, int] | None = None

    def path(self, name: str) -> Place:
        return self.files.get(name, self.folder / name)

    @property
    def calibration(self) -> Calibration:
        if self.kitti_cameras is None:
            return super().calibration
        height, width = self.im0.shape[:2]
        return read_kitti_calib(
            self.path("calib.txt"), self.kitti_cameras, width, height
        )

    def mask_nonocc(self, i: int) -> Mask:
        if i != 0 or _VISIBLE not in self.files:
            return super().mask_nonocc(i)
        visible = np.isfinite(read_disparity(self.files[_VISIBLE]))
        has_truth = np.isfinite(self.disp0)
        if visible.shape != has_truth.shape:
            raise FileError(
                f"{self.files[_VISIBLE]}: has another size than {self.path(DISPARITY.name(0))}"
            )
        return mask_of(has_truth, visible)


def downloaded_pairs(path: Where) -> Sequence[DownloadedPair] | None:
    """The pairs of a KITTI or ETH3D download; None if `path` is neither.

    path: the folder `training` or `two_view_training`, the one that contains it, an export in such a layout, the folder
    of one scene of ETH3D, or a folder of theirs without truth: with image_2 and image_3, or `two_view_test`.

    Raises FileError if the truth of an image is missing where others have it, if its partner is, or if there is none.
    """
    root = place(path)
    if (truth := _eth3d_truth(root)) is not None:
        return _checked([_eth3d_pair(root, truth)], root)
    root = next((root / name for name in _EXPORTS if (root / name).is_dir()), root)
    for folder in (root, root / _ETH3D):
        if folder.name == _ETH3D and folder.is_dir():
            return _checked(_eth3d(folder), folder)
    for folder in (root, root / _ETH3D_BLIND):
        if folder.name == _ETH3D_BLIND and folder.is_dir():
            return _checked(_eth3d_without_truth(folder), folder)
    for folder in (root, root / "training"):
        for names in _KITTI:
            has_views = all((folder / name).is_dir() for name in names[:2])
            if not has_views or (folder / IMAGE.name(0)).is_file():
                continue
            has_truth = any((folder / name).is_dir() for name in names[2:])
            pairs = _kitti if has_truth else _kitti_without_truth
            return _checked(pairs(folder, names), folder / names[0])
    return None


def open_pair(path: Where) -> StoredSample:
    """The sample at `path`, as `open_sample`, or the pair DOWNLOAD/NAME of a KITTI or ETH3D folder.

    Raises InputError for several pairs, FileError for anything else.
    """
    location = place(path)
    folder = location if location.is_dir() else location.parent
    pairs = downloaded_pairs(folder)
    if pairs is None:
        return open_sample(path)
    if location.is_dir() and len(pairs) == 1:
        return pairs[0]
    for pair in pairs:
        if not location.is_dir() and pair.name == location.name:
            return pair
    raise InputError(
        f"{path}: name one of its {len(pairs)} pairs, such as {folder / pairs[0].name}"
    )


def _eth3d(folder: Place) -> list[DownloadedPair]:
    scenes = [entry for entry in folder.iterdir() if (entry / IMAGE.name(0)).is_file()]
    truths = folder.parent / _ETH3D_TRUTH
    return [
        _eth3d_pair(scene, truths / scene.name) for scene in sorted(scenes, key=str)
    ]


def _eth3d_pair(scene: Place, truth: Place) -> DownloadedPair:
    """The pair in the folder of a scene, and the folder of its truth, whose name is the scene's."""
    files = {
        IMAGE.name(1): scene / "im1.png",
        DISPARITY.name(0): truth / "disp0GT.pfm",
        MASK.name(0): truth / "mask0nocc.png",
    }
    return DownloadedPair(scene, truth.name, files=files)


def _eth3d_truth(scene: Place) -> Place | None:
    """The folder of truth of a scene in two_view_training; None for other folders, or without two_view_training_gt."""
    location = scene.resolve()
    truths = location.parent.parent / _ETH3D_TRUTH
    is_scene = location.parent.name == _ETH3D and (scene / IMAGE.name(0)).is_file()
    return truths / location.name if is_scene and truths.is_dir() else None


def _kitti(folder: Place, names: Sequence[str]) -> list[DownloadedPair]:
    ours = (IMAGE.name(0), IMAGE.name(1), DISPARITY.name(0), _VISIBLE)
    folders = {name: folder / theirs for name, theirs in zip(ours, names, strict=True)}
    # The frames _11 of the next point in time have no truth.
    frames = sorted(
        entry.name
        for entry in folders[IMAGE.name(0)].iterdir()
        if entry.name.endswith("_10.png")
    )
    pairs = []
    for frame in frames:
        files = {name: below / frame for name, below in folders.items()}
        pairs.append(DownloadedPair(folder, frame.removesuffix(".png"), files=files))
    return pairs


def _eth3d_without_truth(folder: Place) -> list[DownloadedPair]:
    scenes = [entry for entry in folder.iterdir() if (entry / IMAGE.name(0)).is_file()]
    return [
        DownloadedPair(scene, scene.name, files={IMAGE.name(1): scene / "im1.png"})
        for scene in sorted(scenes, key=str)
    ]


def _kitti_without_truth(folder: Place, names: Sequence[str]) -> list[DownloadedPair]:
    left, right = folder / names[0], folder / names[1]
    frames = sorted(
        entry.name for entry in left.iterdir() if entry.name.endswith(".png")
    )
    pairs = []
    for frame in frames:
        files = {IMAGE.name(0): left / frame, IMAGE.name(1): right / frame}
        name = frame.removesuffix(".png")
        # KITTI's frames _10 and _11 share a calibration; a sequence has one for all of its frames.
        number = name.partition("_")[0]
        places = (
            folder / "calib_cam_to_cam" / f"{number}.txt",
            folder / "calib" / f"{number}.txt",
            folder / "calib.txt",
        )
        calibrations = [file for file in places if file.is_file()]
        if calibrations:
            files["calib.txt"] = calibrations[0]
        cameras = _CAMERAS[names[0]]
        pairs.append(DownloadedPair(folder, name, files=files, kitti_cameras=cameras))
    return pairs


def read_kitti_calib(
    path: Where, cameras: tuple[int, int], width: int, height: int
) -> Calibration:
    """The calibration of two rectified cameras in a file of KITTI: the lines "P2:" or "P_rect_02:" of 12 numbers.

    P is (3, 4), row by row: K and, as its last column, K times minus the camera's place in metres. The baseline is
    (P_left[0, 3] - P_right[0, 3]) / fx. width, height: of the images, pixels. Raises FileError for a missing line, and
    for numbers that are no such matrix.
    """
    lines = {}
    for line in read_text(path).splitlines():
        key, _, values = line.partition(":")
        lines[key.strip()] = values
    left, right = (_projection(lines, camera, str(path)) for camera in cameras)
    if left[0, 0] <= 0 or left[0, 3] <= right[0, 3]:
        raise FileError(
            f"{path}: P{cameras[0]} and P{cameras[1]} are no left and right camera of one rectified pair"
        )
    focal = float(left[0, 0])
    cam0, cam1 = (
        (float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]))
        for P in (left, right)
    )
    return Calibration(
        cam0, cam1, float(left[0, 3] - right[0, 3]) / focal, width, height,
        doffs=cam1[2] - cam0[2],
    )  # fmt: skip


def _projection(
    lines: Mapping[str, str], camera: int, name: str
) -> NDArray[np.float64]:
    """The matrix P (3, 4) of a camera. Raises FileError."""
    keys = (f"P_rect_0{camera}", f"P{camera}")
    text = next((lines[key] for key in keys if key in lines), None)
    if text is None:
        raise FileError(f"{name}: has no line {keys[0]}: or {keys[1]}:")
    try:
        numbers = np.array([float(number) for number in text.split()])
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != 12 or not np.isfinite(numbers).all():
        raise FileError(
            f"{name}: {keys[1]} must be 12 numbers, got {text.strip()[:60]!r}"
        )
    return numbers.reshape(3, 4)


def _checked(pairs: list[DownloadedPair], folder: Place) -> list[DownloadedPair]:
    if not pairs:
        raise FileError(f"{folder}: has no image of a pair")
    for pair in pairs:
        for file in pair.files.values():
            if not file.is_file():
                raise FileError(
                    f"{file}: no such file, needed by the pair {pair.name!r}"
                )
    return pairs
