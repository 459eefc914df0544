"""A sample on disk or in a bucket. Every access reads the file; nothing is cached.

The folder may be twinlens's own, or a plain one with Middlebury's names (im0.png, im1.png, disp0.pfm or disp0GT.pfm,
mask0nocc.png, calib.txt). A missing file raises FileError that names it.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from twinlens.camera import Lens, Rig
from twinlens.camera.truth import Correspondence, Truth
from twinlens.dataset import items
from twinlens.dataset.codecs.calib import Calibration, read_calib
from twinlens.dataset.codecs.disparity import read_disparity
from twinlens.dataset.codecs.exr import read_exr
from twinlens.dataset.codecs.png import read_png
from twinlens.dataset.files import check_relative
from twinlens.dataset.record import FileModel, annotation_of, lens_from_plain, read, read_json, rig_from_plain
from twinlens.dataset.sample import KIND, VERSION
from twinlens.dataset.storage import Place
from twinlens.dataset.truth_files import blur_circle_px, read_truth, truth_from_arrays
from twinlens.dataset.visibility import Disparity, Mask, correspondence_of, mask_from_both, mask_from_one
from twinlens.errors import FileError, InputError

Image = NDArray[Any]

_DISPARITY_NAMES = ("disp{}.pfm", "disp{}GT.pfm")


def _check_folder(name: str) -> str:
    return name if name == "./" else check_relative(name.rstrip("/"))


class ShotEntry(FileModel):
    """A lens of a sample in sample.json, not yet rebuilt."""

    folder: Annotated[str, pydantic.AfterValidator(_check_folder)]
    lens: dict[str, Any]
    record: dict[str, Any] | None = None


class _ShotFile(ShotEntry):
    lens: annotation_of(Lens)  # type: ignore[valid-type]


class SampleFile(FileModel):
    """sample.json."""

    format: Literal["twinlens-sample"]
    version: Literal[1]
    twinlens: str = pydantic.Field(default="", description="version that wrote the file")
    conventions: dict[str, str] = pydantic.Field(default={})
    rig: annotation_of(Rig)  # type: ignore[valid-type]
    rectified: bool | None = None
    pair: dict[str, float] | None = pydantic.Field(
        None, description="baseline (m) and doffs_px of the first two cameras"
    )
    shots: list[_ShotFile] = pydantic.Field(min_length=1)
    object_names: list[str] = pydantic.Field(default=[])
    material_names: list[str] = pydantic.Field(default=[])
    material_kinds: list[str] = pydantic.Field(default=[])
    statistics: Any = None
    record: dict[str, Any] = pydantic.Field(
        default={}, description="seed, scene, backend, versions and everything else"
    )


class _Shots(FileModel):
    shots: list[ShotEntry] = pydantic.Field(min_length=1)


@dataclass(frozen=True)
class StoredSample(Mapping[str, Any]):
    """One sample of a dataset. Views 0 and 1 are the left and right image of a pair.

    As a mapping, so that a torch DataLoader makes batches of it, its keys are name, the images, disp0 and mask0_nonocc;
    ``sample[name]`` reads every quantity of docs/loading.md.

    Attributes
    ----------
    folder : path
    name : str
    row : mapping
        Its row in dataset.json; empty if there is none.
    """

    folder: Place
    name: str
    row: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __new__(cls, *values: Any, **_: Any) -> Any:
        # torch's collate calls the class of a mapping with the batch as a dict, and reads everything again if that
        # fails: return that dict.
        return values[0] if len(values) == 1 and isinstance(values[0], dict) else super().__new__(cls)

    def __getitem__(self, name: str) -> Any:
        return items.read_all((name,), self)[name]

    def __iter__(self) -> Iterator[str]:
        return items.default_names(self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return name in tuple(self)

    @property
    def im0(self) -> Image:
        """Left image, uint8 or uint16 (H, W, 3) or (H, W)."""
        return self.image(0)

    @property
    def im1(self) -> Image:
        """Right image."""
        return self.image(1)

    @property
    def disp0(self) -> Disparity:
        """True disparity of the left view, float32 (H, W), pixels; +inf unknown."""
        return self.disparity(0)

    @property
    def disp1(self) -> Disparity:
        """True disparity of the right view, u_left - u_right as in the left one."""
        return self.disparity(1)

    @property
    def mask0_nonocc(self) -> Mask:
        """Mask of the left view, uint8 (H, W): 255 visible in both, 128 occluded or out of frame, 0 unknown."""
        return self.mask_nonocc(0)

    @property
    def mask1_nonocc(self) -> Mask:
        """Mask of the right view."""
        return self.mask_nonocc(1)

    @property
    def truth0(self) -> Truth:
        """Truth of the left view."""
        return self.truth(0)

    @property
    def truth1(self) -> Truth:
        """Truth of the right view."""
        return self.truth(1)

    @property
    def calibration(self) -> Calibration:
        """The content of calib.txt."""
        return read_calib(self.folder / "calib.txt")

    @property
    def ndisp(self) -> int:
        """Disparities to search, 0 <= d < ndisp: from calib.txt, or one more than the largest true disparity."""
        if self.has("calib.txt"):
            ndisp = self.calibration.ndisp
            if ndisp is not None:
                return ndisp
        disparity = self.disp0
        known = disparity[np.isfinite(disparity)]
        return max(math.ceil(known.max()) + 1, 1) if known.size else 1

    @property
    def record(self) -> dict[str, Any]:
        """sample.json, how the sample was made, as plain data."""
        return read_json(self.folder / "sample.json", KIND, VERSION)

    @property
    def rig(self) -> Rig:
        """Cameras and poses of truth and calibration, from sample.json or else calib.txt."""
        return self.photographed_by.nominal

    @property
    def photographed_by(self) -> Rig:
        """The rig that took the images: `rig`, except for calibration errors introduced on purpose."""
        if not self.has("sample.json"):
            return self.calibration.rig()
        return rig_from_plain(self.record.get("rig"), self.folder / "sample.json")

    @property
    def num_lenses(self) -> int:
        """Number of lenses: `lens(0)` to `lens(num_lenses - 1)`."""
        return len(self._shots())

    def lens(self, k: int) -> "StoredShot":
        """The images taken through lens k; 0 is the sample's own im0 and im1. Raises InputError beyond the last."""
        shots = self._shots()
        if not 0 <= k < len(shots):
            raise InputError(f"{self.name}: has lenses 0 to {len(shots) - 1}, no lens {k}")
        return StoredShot(self, self.folder / shots[k].folder, k, shots[k])

    def image(self, i: int) -> Image:
        """Image of view i."""
        return read_png(self.folder / f"im{i}.png")

    def disparity(self, i: int) -> Disparity:
        """True disparity of view i."""
        return read_disparity(self._disparity_path(i))

    def has_disparity(self, i: int) -> bool:
        """Whether the folder has a disparity map of view i."""
        return self._disparity_path(i).is_file()

    def mask_nonocc(self, i: int) -> Mask:
        """Mask of view i; without a file, from the disparity maps: see `twinlens.dataset.visibility`."""
        path = self.folder / f"mask{i}nocc.png"
        if path.exists():
            mask = read_png(path)
            if mask.ndim != 2 or mask.dtype != np.uint8:
                raise FileError(f"{path}: a mask must be an 8-bit grey PNG")
            return np.asarray(mask, np.uint8)
        if i < 2 and self.has_disparity(1 - i):
            return mask_from_both(self.disparity(i), self.disparity(1 - i), left=i == 0)
        return mask_from_one(self.disparity(i), left=i == 0)

    def truth(self, i: int) -> Truth:
        """Truth of view i; depth and position have float32 precision."""
        arrays = read_truth(self.folder / f"truth{i}.exr")
        unknown = np.full(arrays["depth"].shape, np.inf, np.float32)
        return truth_from_arrays(arrays, self.disparity(i) if self.has_disparity(i) else unknown)

    def correspondence(self, source: int, target: int) -> Correspondence:
        """Where the pixels of view `source` are in view `target`, from their truths. See `correspondence_of`."""
        return correspondence_of((self.truth(source), self.truth(target)), self.rig, source, target)

    def radiance(self, i: int) -> NDArray[np.float32]:
        """Linear image of view i, float32 (H, W, 3), if it was stored."""
        return self.lens(0).radiance(i)

    def has(self, name: str) -> bool:
        """Whether the folder has a file of that name."""
        return (self.folder / name).is_file()

    def _disparity_path(self, i: int) -> Place:
        paths = [self.folder / name.format(i) for name in _DISPARITY_NAMES]
        return next((path for path in paths if path.exists()), paths[0])

    def _shots(self) -> list[ShotEntry]:
        if not self.has("sample.json"):
            return [ShotEntry(folder="./", lens={})]
        return read(_Shots, self.record, self.folder / "sample.json").shots


@dataclass(frozen=True)
class StoredShot:
    """The images taken through one lens of a stored sample."""

    sample: StoredSample
    folder: Place
    number: int
    entry: ShotEntry = field(compare=False, repr=False)

    @property
    def im0(self) -> Image:
        """Left image."""
        return self.image(0)

    @property
    def im1(self) -> Image:
        """Right image."""
        return self.image(1)

    @property
    def lens(self) -> Lens:
        """The lens."""
        return lens_from_plain(self.entry.lens, self.sample.folder / "sample.json", f"shots[{self.number}].lens")

    @property
    def record(self) -> dict[str, Any]:
        """How the images were taken, as plain data."""
        return dict(self.entry.record or {})

    def image(self, i: int) -> Image:
        """Image of view i, uint8 or uint16 (H, W, 3) or (H, W)."""
        return read_png(self.folder / f"im{i}.png")

    def radiance(self, i: int) -> NDArray[np.float32]:
        """Linear image of view i, float32 (H, W, 3), if it was stored."""
        path = self.folder / f"radiance{i}.exr"
        channels = read_exr(path).channels
        if not {"R", "G", "B"} <= set(channels):
            raise FileError(f"{path}: needs channels R, G and B, has {', '.join(channels)}")
        return np.stack([np.asarray(channels[name], np.float32) for name in "RGB"], axis=-1)

    def blur_circle_px(self, i: int) -> NDArray[np.float32]:
        """Signed blur circle of view i for this lens, pixels, float32 (H, W): `optics.circle_of_confusion_px`."""
        depth = read_truth(self.sample.folder / f"truth{i}.exr")["depth"]
        return blur_circle_px(depth, self.sample.rig.cameras[i], self.lens)
