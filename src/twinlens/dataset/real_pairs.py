"""Real pairs with measured truth: the downloads of KITTI and ETH3D.

    KITTI 2015   training/{image_2,image_3,disp_occ_0,disp_noc_0}/000000_10.png
    KITTI 2012   training/{colored_0,colored_1 or image_0,image_1}/, disp_occ/, disp_noc/
    ETH3D        two_view_training/<scene>/ and, beside it, two_view_training_gt/<scene>/

Middlebury's folders are read as any plain dataset.

Source: the readme.txt of KITTI's development kits; https://www.eth3d.net/documentation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from twinlens.dataset.channels import DISPARITY, IMAGE, MASK
from twinlens.dataset.codecs.pfm import read_disparity
from twinlens.dataset.storage import Place, Where, place
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.visibility import Mask, mask_of
from twinlens.errors import FileError

_KITTI = (
    ("image_2", "image_3", "disp_occ_0", "disp_noc_0"),
    ("colored_0", "colored_1", "disp_occ", "disp_noc"),
    ("image_0", "image_1", "disp_occ", "disp_noc"),
)
_ETH3D = "two_view_training"
# The folders that `twinlens export` makes for torchvision.
_EXPORTS = ("Kitti2015", "ETH3D")
# KITTI's map of the pixels that are visible in both views.
_VISIBLE = "disp_noc"


@dataclass(frozen=True)
class DownloadedPair(StoredSample):
    """A pair of KITTI or ETH3D. `files` are the places of its files by the names of a `StoredSample`."""

    files: Mapping[str, Place] = field(default_factory=dict, compare=False, repr=False)

    def path(self, name: str) -> Place:
        return self.files.get(name, self.folder / name)

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

    path: the folder `training` or `two_view_training`, the one that contains it, or an export in such a layout.

    Raises FileError if the truth or the partner of an image is missing, or if there is no image.
    """
    root = place(path)
    root = next((root / name for name in _EXPORTS if (root / name).is_dir()), root)
    for folder in (root, root / _ETH3D):
        if folder.name == _ETH3D and folder.is_dir():
            return _checked(_eth3d(folder), folder)
    for folder in (root, root / "training"):
        for names in _KITTI:
            has_views = all((folder / name).is_dir() for name in names[:2])
            if has_views and not (folder / IMAGE.name(0)).is_file():
                return _checked(_kitti(folder, names), folder / names[0])
    return None


def _eth3d(folder: Place) -> list[DownloadedPair]:
    scenes = [entry for entry in folder.iterdir() if (entry / IMAGE.name(0)).is_file()]
    pairs = []
    for scene in sorted(scenes, key=str):
        truth = folder.parent / "two_view_training_gt" / scene.name
        files = {
            IMAGE.name(1): scene / "im1.png",
            DISPARITY.name(0): truth / "disp0GT.pfm",
            MASK.name(0): truth / "mask0nocc.png",
        }
        pairs.append(DownloadedPair(scene, scene.name, files=files))
    return pairs


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


def _checked(pairs: list[DownloadedPair], folder: Place) -> list[DownloadedPair]:
    if not pairs:
        raise FileError(f"{folder}: has no image with measured disparity")
    for pair in pairs:
        for file in pair.files.values():
            if not file.is_file():
                raise FileError(
                    f"{file}: no such file, needed by the pair {pair.name!r}"
                )
    return pairs
