"""Real data of KITTI and ETH3D in the folders of their downloads. Middlebury's folders are read as any plain dataset.

    KITTI 2015   training/{image_2,image_3,disp_occ_0,disp_noc_0}/000000_10.png
    KITTI 2012   training/{colored_0,colored_1 or image_0,image_1}/, disp_occ/, disp_noc/
    ETH3D        two_view_training/<scene>/ and, beside it, two_view_training_gt/<scene>/

Source: the readme.txt of KITTI's development kits; https://www.eth3d.net/documentation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.calib import Calibration, read_calib
from twinlens.dataset.codecs.pfm import read_disparity
from twinlens.dataset.codecs.png import read_png
from twinlens.dataset.storage import Place, Where, place
from twinlens.dataset.stored import read_visibility
from twinlens.dataset.visibility import HIDDEN, UNKNOWN, VISIBLE, Disparity, Mask
from twinlens.errors import FileError

_KITTI = (
    ("image_2", "image_3", "disp_occ_0", "disp_noc_0"),
    ("colored_0", "colored_1", "disp_occ", "disp_noc"),
    ("image_0", "image_1", "disp_occ", "disp_noc"),
)
_ETH3D, _ETH3D_TRUTH = "two_view_training", "two_view_training_gt"


@dataclass(frozen=True)
class DownloadedPair:
    """A real pair; every access reads the file. The attributes are those of a `StoredSample`."""

    name: str
    images: tuple[Place, Place]
    truth: Place
    mask: Place
    """ETH3D's mask0nocc.png, or KITTI's map of the pixels visible in both views."""
    calib: Place | None = None

    @property
    def im0(self) -> NDArray[Any]:
        """Left image."""
        return read_png(self.images[0])

    @property
    def im1(self) -> NDArray[Any]:
        """Right image."""
        return read_png(self.images[1])

    @property
    def disp0(self) -> Disparity:
        """Measured disparity of the left view, float32 (H, W), pixels, +inf unknown."""
        return read_disparity(self.truth)

    @property
    def mask0_nonocc(self) -> Mask:
        """uint8 (H, W): 255 visible in both views, 128 occluded, 0 unknown."""
        if self.calib is not None:
            return read_visibility(self.mask)
        seen, known = np.isfinite(read_disparity(self.mask)), np.isfinite(self.disp0)
        if seen.shape != known.shape:
            raise FileError(f"{self.mask}: has another size than {self.truth}")
        return np.where(seen, VISIBLE, np.where(known, HIDDEN, UNKNOWN)).astype(np.uint8)

    @property
    def calibration(self) -> Calibration | None:
        """The content of ETH3D's calib.txt; None for KITTI."""
        return None if self.calib is None else read_calib(self.calib)

    @property
    def ndisp(self) -> int:
        """Disparities to search, 0 <= d < ndisp: from calib.txt, or one more than the largest true disparity."""
        calibration, truth = self.calibration, self.disp0
        if calibration is not None and calibration.ndisp is not None:
            return calibration.ndisp
        known = truth[np.isfinite(truth)]
        return int(np.ceil(known.max())) + 1 if known.size else 1


def downloaded_pairs(path: Where) -> Sequence[DownloadedPair] | None:
    """The pairs of a KITTI or ETH3D download; None if `path` is neither.

    path: the folder `training` or `two_view_training`, or the one that contains it.

    Raises
    ------
    FileError
        A folder of the layout, or the truth or partner of an image, is missing.
    """
    root = place(path)
    for folder in (root, root / _ETH3D):
        if folder.name == _ETH3D and folder.is_dir():
            return _eth3d(folder)
    for folder in (root, root / "training"):
        for names in _KITTI:
            if all((folder / name).is_dir() for name in names[:2]) and not (folder / "im0.png").is_file():
                return _kitti(folder, names)
    return None


def _eth3d(folder: Place) -> list[DownloadedPair]:
    truths = folder.parent / _ETH3D_TRUTH
    _require_folder(truths)
    pairs = []
    for scene in sorted((entry for entry in folder.iterdir() if (entry / "im0.png").is_file()), key=str):
        truth = truths / scene.name
        files = (scene / "im0.png", scene / "im1.png"), truth / "disp0GT.pfm", truth / "mask0nocc.png"
        pairs.append(DownloadedPair(scene.name, *files, scene / "calib.txt"))
    return _complete(pairs, folder)


def _kitti(folder: Place, names: Sequence[str]) -> list[DownloadedPair]:
    left, right, occluded, visible = (folder / name for name in names)
    for needed in (occluded, visible):
        _require_folder(needed)
    # The frames _11 of the next point in time have no truth.
    frames = sorted(entry.name for entry in left.iterdir() if entry.name.endswith("_10.png"))
    pairs = [
        DownloadedPair(name.removesuffix(".png"), (left / name, right / name), occluded / name, visible / name)
        for name in frames
    ]
    return _complete(pairs, left)


def _require_folder(folder: Place) -> None:
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder; it holds the measured disparities of this download")


def _complete(pairs: list[DownloadedPair], folder: Place) -> list[DownloadedPair]:
    if not pairs:
        raise FileError(f"{folder}: has no image with measured disparity")
    for pair in pairs:
        for file in (*pair.images, pair.truth, pair.mask):
            if not file.is_file():
                raise FileError(f"{file}: no such file, needed by the pair {pair.name!r}")
    return pairs
