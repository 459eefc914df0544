"""A sample on the disk, read when asked: every array comes from its file anew, and nothing is kept.

The folder may be twinlens's own or a plain one with Middlebury's names (im0.png, im1.png, disp0.pfm or disp0GT.pfm,
mask0nocc.png, calib.txt); what it does not hold answers with FileError naming the file.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Lens, Rig
from twinlens.camera.truth import Correspondence, Truth
from twinlens.dataset import items
from twinlens.dataset.codecs.calib import Calibration, read_calib
from twinlens.dataset.codecs.exr import read_exr
from twinlens.dataset.codecs.pfm import read_pfm
from twinlens.dataset.codecs.png import read_png
from twinlens.dataset.correspondence import correspondence_of
from twinlens.dataset.occlusion import Mask, mask_from_both, mask_from_one
from twinlens.dataset.record import lens_from_plain, read_json, relative_name, rig_from_plain
from twinlens.dataset.sample import KIND, VERSION
from twinlens.dataset.storage import Place
from twinlens.dataset.truth_files import blur_circle_px, read_truth, truth_from_arrays
from twinlens.errors import FileError, InputError

Image = NDArray[Any]
Disparity = NDArray[np.float32]

_DISPARITY_NAMES = ("disp{}.pfm", "disp{}GT.pfm")


@dataclass(frozen=True)
class StoredSample(Mapping[str, Any]):
    """One folder of a dataset. Views are numbered from the left: 0 and 1 in a pair.

    folder : where it lies. name : what the dataset calls it. row : its row in dataset.json, empty where there is none.

    Also a mapping, so that a torch DataLoader makes batches of it: its keys are name, the images, disp0 and
    mask0_nonocc; it answers to every name of `twinlens.dataset.items`.
    """

    folder: Place
    name: str
    row: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __new__(cls, *values: Any, **_: Any) -> Any:
        # torch's collate makes a batch of mappings by calling their class with a dict, and reads everything again when
        # that fails: the batch is that dict.
        return values[0] if len(values) == 1 and isinstance(values[0], dict) else super().__new__(cls)

    def __getitem__(self, name: str) -> Any:
        return items.read(self, name)

    def __iter__(self) -> Iterator[str]:
        return items.default_names(self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return name in tuple(self)

    @property
    def im0(self) -> Image:
        """The left image, uint8 or uint16 (H, W, 3) or (H, W)."""
        return self.image(0)

    @property
    def im1(self) -> Image:
        """The right image."""
        return self.image(1)

    @property
    def disp0(self) -> Disparity:
        """The left view's true disparity, float32 (H, W), pixels; +inf unknown."""
        return self.disparity(0)

    @property
    def disp1(self) -> Disparity:
        """The right view's true disparity, u_left - u_right as the left one's."""
        return self.disparity(1)

    @property
    def mask0_nonocc(self) -> Mask:
        """The left view's mask, uint8 (H, W): 255 visible in both, 128 occluded or out of frame, 0 unknown."""
        return self.mask_nonocc(0)

    @property
    def mask1_nonocc(self) -> Mask:
        """The right view's mask."""
        return self.mask_nonocc(1)

    @property
    def truth0(self) -> Truth:
        """The left view's whole truth."""
        return self.truth(0)

    @property
    def truth1(self) -> Truth:
        """The right view's whole truth."""
        return self.truth(1)

    @property
    def calibration(self) -> Calibration:
        """The calibration in calib.txt."""
        return read_calib(self.folder / "calib.txt")

    @property
    def ndisp(self) -> int:
        """Disparities to search, 0 <= d < ndisp: calib.txt's, or else one more than the left truth's largest."""
        if self.has("calib.txt"):
            stated = self.calibration.ndisp
            if stated is not None:
                return stated
        disparity = self.disp0
        known = disparity[np.isfinite(disparity)]
        return max(math.ceil(known.max()) + 1, 1) if known.size else 1

    @property
    def record(self) -> dict[str, Any]:
        """sample.json: everything that made the sample, as plain data."""
        return read_json(self.folder / "sample.json", KIND, VERSION)

    @property
    def rig(self) -> Rig:
        """The cameras and poses that truth and calibration are of: sample.json's, or calib.txt's where there is none.

        Where an error of calibration was left in on purpose, the pictures are those of `photographed_by`.
        """
        return self.photographed_by.nominal

    @property
    def photographed_by(self) -> Rig:
        """The rig as it was when the pictures were taken: `rig`, but for errors of calibration left in on purpose."""
        if not self.has("sample.json"):
            return self.calibration.rig()
        given = self.record.get("rig")
        try:
            return rig_from_plain(given)
        except InputError as error:
            raise FileError(f"{self.folder / 'sample.json'}: {error}") from None

    @property
    def num_lenses(self) -> int:
        """How many lenses photographed it: `lens(0)` to `lens(num_lenses - 1)`."""
        return len(self._shots()) if self.has("sample.json") else 1

    def lens(self, k: int) -> "StoredShot":
        """What was photographed through lens k; 0 is the sample's own im0 and im1. InputError beyond the last."""
        count = self.num_lenses
        if not 0 <= k < count:
            raise InputError(f"{self.name}: has lenses 0 to {count - 1}, no lens {k}")
        shot = self._shots()[k] if self.has("sample.json") else {"folder": "./"}
        folder = str(shot.get("folder")).rstrip("/")
        if folder != ".":
            folder = relative_name(folder, self.folder / "sample.json")
        return StoredShot(self, self.folder / folder, shot)

    def image(self, i: int) -> Image:
        """View i's image."""
        return read_png(self.folder / f"im{i}.png")

    def disparity(self, i: int) -> Disparity:
        """View i's true disparity."""
        path = self._disparity_path(i)
        disparity = read_pfm(path)
        if disparity.ndim != 2:
            raise FileError(f"{path}: holds colours; a disparity map has one number a pixel")
        return disparity

    def mask_nonocc(self, i: int) -> Mask:
        """View i's mask; where no file holds it, made from both views' disparities or from its own alone.

        See `twinlens.dataset.occlusion` for what is made.
        """
        path = self.folder / f"mask{i}nocc.png"
        if not path.exists():
            return self._mask_from_disparities(i)
        mask = read_png(path)
        if mask.ndim != 2 or mask.dtype != np.uint8:
            raise FileError(f"{path}: a mask must be an 8-bit grey PNG")
        return np.asarray(mask, np.uint8)

    def truth(self, i: int) -> Truth:
        """View i's whole truth; depth and position have float32's precision."""
        arrays = read_truth(self.folder / f"truth{i}.exr")
        if self._disparity_path(i).exists():
            disparity = self.disparity(i)
        else:
            disparity = np.full(arrays["depth"].shape, np.inf, np.float32)
        return truth_from_arrays(arrays, disparity)

    def correspondence(self, source: int, target: int) -> Correspondence:
        """Where view `source`'s pixels lie in view `target`: of any two, from their truths. See `correspondence_of`."""
        return correspondence_of((self.truth(source), self.truth(target)), self.rig, source, target)

    def radiance(self, i: int) -> NDArray[np.float32]:
        """View i's linear image, float32 (H, W, 3), where it was kept."""
        return self.lens(0).radiance(i)

    def has(self, name: str) -> bool:
        """Whether the folder holds a file of that name."""
        return (self.folder / name).is_file()

    def _disparity_path(self, i: int) -> Place:
        paths = [self.folder / name.format(i) for name in _DISPARITY_NAMES]
        return next((path for path in paths if path.exists()), paths[0])

    def _mask_from_disparities(self, i: int) -> Mask:
        disparity, partner = self.disparity(i), self._disparity_path(1 - i) if i < 2 else None
        if partner is None or not partner.exists():
            return mask_from_one(disparity, left=i == 0)
        return mask_from_both(disparity, self.disparity(1 - i), left=i == 0)

    def _shots(self) -> list[Any]:
        shots = self.record.get("shots")
        if not isinstance(shots, list) or not shots or not all(isinstance(shot, dict) for shot in shots):
            raise FileError(f'{self.folder / "sample.json"}: "shots" must be a list of objects')
        return shots


@dataclass(frozen=True)
class StoredShot:
    """What was photographed through one lens of a stored sample."""

    sample: StoredSample
    folder: Place
    entry: Mapping[str, Any] = field(compare=False, repr=False)

    @property
    def im0(self) -> Image:
        """The left image."""
        return self.image(0)

    @property
    def im1(self) -> Image:
        """The right image."""
        return self.image(1)

    @property
    def lens(self) -> Lens:
        """The lens."""
        try:
            return lens_from_plain(self.entry.get("lens"))
        except InputError as error:
            raise FileError(f"{self.sample.folder / 'sample.json'}: {error}") from None

    @property
    def record(self) -> dict[str, Any]:
        """How it was taken, as plain data."""
        return dict(self.entry.get("record") or {})

    def image(self, i: int) -> Image:
        """View i's image, uint8 or uint16 (H, W, 3) or (H, W)."""
        return read_png(self.folder / f"im{i}.png")

    def radiance(self, i: int) -> NDArray[np.float32]:
        """View i's linear image, float32 (H, W, 3), where it was kept."""
        path = self.folder / f"radiance{i}.exr"
        channels = read_exr(path).channels
        if not {"R", "G", "B"} <= set(channels):
            raise FileError(f"{path}: needs channels R, G and B, has {', '.join(channels)}")
        return np.stack([np.asarray(channels[name], np.float32) for name in "RGB"], axis=-1)

    def blur_circle_px(self, i: int) -> NDArray[np.float32]:
        """View i's signed blur circle through this lens, pixels, float32 (H, W): `optics.circle_of_confusion_px`."""
        depth = read_truth(self.sample.folder / f"truth{i}.exr")["depth"]
        return blur_circle_px(depth, self.sample.rig.cameras[i], self.lens)
