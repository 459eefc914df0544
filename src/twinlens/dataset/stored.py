"""A sample on disk or in a bucket. Every access reads the file; nothing is cached.

The folder may be twinlens's own, or a plain one with Middlebury's names (im0.png, im1.png, disp0.pfm or disp0GT.pfm,
mask0nocc.png, calib.txt). A missing file raises FileError that names it.
"""

import functools
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray

from twinlens.camera import Lens, ObjectTruth, Rig
from twinlens.camera.truth import Correspondence, Projection, Truth
from twinlens.dataset.codecs.calib import Calibration, read_calib
from twinlens.dataset.codecs.exr import read_exr
from twinlens.dataset.codecs.pfm import read_disparity
from twinlens.dataset.codecs.png import read_png
from twinlens.dataset.files import check_relative
from twinlens.dataset.record import (
    LENS,
    RIG,
    FileModel,
    annotation_of,
    read,
    read_json,
    read_part,
)
from twinlens.dataset.sample import KIND, VERSION
from twinlens.dataset.storage import Place, RemotePath, is_whole
from twinlens.dataset.truth_files import (
    PROJECTIONS,
    SCALARS,
    VECTORS,
    blur_circle_px,
    read_truth,
)
from twinlens.dataset.visibility import (
    Disparity,
    Mask,
    correspondence_of,
    mask_from_both,
    mask_from_one,
)
from twinlens.errors import FileError, InputError, format_value, unknown

Image = NDArray[Any]
T = TypeVar("T")


class _PlainShot(FileModel):
    """A `ShotEntry` whose lens is kept as plain data."""

    folder: Annotated[
        str,
        pydantic.AfterValidator(
            lambda name: name if name == "./" else check_relative(name.rstrip("/"))
        ),
    ]
    lens: dict[str, Any]
    record: dict[str, Any] | None = None


class ShotEntry(_PlainShot):
    """A lens of a sample in sample.json."""

    lens: annotation_of(Lens)  # type: ignore[valid-type]


_OBJECT: Any = annotation_of(ObjectTruth)
_OBJECTS: pydantic.TypeAdapter[list[list[ObjectTruth]]] = pydantic.TypeAdapter(
    list[list[_OBJECT]]
)
_SHOTS = pydantic.TypeAdapter(Annotated[list[_PlainShot], pydantic.Field(min_length=1)])


class SampleFile(FileModel):
    """sample.json."""

    format: Literal["twinlens-sample"]
    version: Literal[1]
    twinlens: str = pydantic.Field(
        default="", description="version that wrote the file"
    )
    conventions: dict[str, str] = pydantic.Field(default={})
    rig: annotation_of(Rig)  # type: ignore[valid-type]
    rectified: bool | None = None
    pair: dict[str, float] | None = pydantic.Field(
        None, description="baseline (m) and doffs_px of the first two cameras"
    )
    shots: list[ShotEntry] = pydantic.Field(min_length=1)
    object_names: list[str] = pydantic.Field(default=[])
    material_names: list[str] = pydantic.Field(default=[])
    material_kinds: list[str] = pydantic.Field(default=[])
    objects: list[list[_OBJECT]] = pydantic.Field(
        default=[], description="the objects in the image of each view"
    )
    statistics: Any = None
    record: dict[str, Any] = pydantic.Field(
        default={}, description="seed, scene, backend, versions and everything else"
    )


def _view(method: Callable[[Any, int], T], i: int) -> T:
    """A property that calls a method of the owner with a view's number; type checkers see an attribute of type T."""
    doc = (method.__doc__ or "").replace("view i", f"view {i}")
    return property(lambda owner: getattr(owner, method.__name__)(i), doc=doc)  # type: ignore[return-value]


@dataclass(frozen=True)
class StoredSample(Mapping[str, Any]):
    """One sample of a dataset. Views 0 and 1 are the left and right image of a pair.

    im0, disp0, mask0_nonocc, truth0, im1, ... are `image(0)`, `disparity(0)` and so on. As a mapping, its keys are
    name, the images, disp0 and mask0_nonocc; ``sample[name]`` reads every quantity of docs/loading.md. `row` is its row
    in dataset.json; empty if there is none.
    """

    folder: Place
    name: str
    row: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __getitem__(self, name: str) -> Any:
        return read_quantities((name,), self)[name]

    def __iter__(self) -> Iterator[str]:
        yield "name"
        images = (f"im{i}" for i in itertools.count())
        yield from itertools.takewhile(lambda name: self.has(f"{name}.png"), images)
        if self.has_disparity(0):
            yield from ("disp0", "mask0_nonocc")

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return name in tuple(self)

    def path(self, name: str) -> Place:
        """The place of the sample's file of that name."""
        return self.folder / name

    def has(self, name: str) -> bool:
        """Whether the sample has a file of that name."""
        return self.path(name).is_file()

    def image(self, i: int) -> Image:
        """Image of view i, uint8 or uint16 (H, W, 3) or (H, W)."""
        return read_png(self.path(f"im{i}.png"))

    def disparity(self, i: int) -> Disparity:
        """True disparity of view i, u_left - u_right, float32 (H, W), pixels; +inf unknown."""
        path = self._disparity_path(i)
        if (
            not path.exists()
            and self.has("sample.json")
            and self.record.get("rectified") is False
        ):
            problem = (
                "the pair is not rectified and has no disparity; run `twinlens rectify`"
            )
            raise FileError(
                f"{self.folder}: {problem if len(self.rig) > 1 else 'has one view; disparity needs two'}"
            )
        return read_disparity(path)

    def has_disparity(self, i: int) -> bool:
        """Whether the folder has a disparity map of view i."""
        return self._disparity_path(i).is_file()

    def mask_nonocc(self, i: int) -> Mask:
        """Mask of view i, uint8 (H, W): 255 visible in both, 128 occluded or out of frame, 0 unknown.

        Without a file it follows from the disparity maps: see `twinlens.dataset.visibility`.
        """
        path = self.path(f"mask{i}nocc.png")
        if path.exists():
            mask = read_png(path)
            if mask.ndim != 2 or mask.dtype != np.uint8:
                raise FileError(f"{path}: a mask must be an 8-bit grey PNG")
            return np.asarray(mask, np.uint8)
        if i < 2 and self.has_disparity(1 - i):
            return mask_from_both(self.disparity(i), self.disparity(1 - i), left=i == 0)
        return mask_from_one(self.disparity(i), left=i == 0)

    def truth(self, i: int) -> Truth:
        """Truth of view i; depth, position and the pixels of projectors have float32 precision."""
        fields = read_truth(self.path(f"truth{i}.exr"))
        fields |= {
            name: fields[name].astype(np.float64) for name in ("depth", "position")
        }
        del fields["blur_circle_px"]
        unknown = np.full(fields["depth"].shape, np.inf, np.float32)
        disparity = self.disparity(i) if self.has_disparity(i) else unknown
        pixels, lit = (fields.pop(name) for name in PROJECTIONS)
        projections = tuple(map(Projection, pixels.astype(np.float64), lit))
        return Truth(
            **fields,
            disparity=disparity,
            objects=self.objects(i),
            projections=projections,
        )

    def objects(self, i: int) -> tuple[ObjectTruth, ...]:
        """The objects in the image of view i; empty in samples of versions before 0.2. Raises FileError."""
        record = self.record if self.has("sample.json") else {}
        views = read(
            _OBJECTS, record.get("objects", []), self.folder / "sample.json", "objects"
        )
        return tuple(views[i]) if i < len(views) else ()

    im0, im1 = _view(image, 0), _view(image, 1)
    disp0, disp1 = _view(disparity, 0), _view(disparity, 1)
    mask0_nonocc, mask1_nonocc = _view(mask_nonocc, 0), _view(mask_nonocc, 1)
    truth0, truth1 = _view(truth, 0), _view(truth, 1)

    def correspondence(self, source: int, target: int) -> Correspondence:
        """Where the pixels of view `source` are in view `target`, from their truths. See `correspondence_of`."""
        return correspondence_of(
            (self.truth(source), self.truth(target)), self.rig, source, target
        )

    def radiance(self, i: int) -> NDArray[np.float32]:
        """Linear image of view i, float32 (H, W, 3), if it was stored."""
        return self.lens(0).radiance(i)

    @property
    def calibration(self) -> Calibration:
        """The content of calib.txt."""
        return read_calib(self.path("calib.txt"))

    @property
    def ndisp(self) -> int:
        """Disparities to search, 0 <= d < ndisp: from calib.txt, or one more than the largest true disparity."""
        if self.has("calib.txt") and (ndisp := self.calibration.ndisp) is not None:
            return ndisp
        disparity = self.disp0
        largest = float(disparity[np.isfinite(disparity)].max(initial=0.0))
        return max(math.ceil(largest) + 1, 1)

    @property
    def record(self) -> dict[str, Any]:
        """sample.json, how the sample was made, as plain data."""
        return read_json(self.folder / "sample.json", KIND, VERSION)

    @property
    def scene(self) -> str:
        """Name of the scene that sample.json records; empty if there is none."""
        record = self.record.get("record") if self.has("sample.json") else None
        return str(record.get("scene", "")) if isinstance(record, dict) else ""

    @property
    def file(self) -> SampleFile:
        """sample.json, with its rig and lenses rebuilt. Raises FileError: file, key, what is allowed."""
        return read(SampleFile, self.record, self.folder / "sample.json")

    @property
    def rig(self) -> Rig:
        """Cameras and poses of truth and calibration, from sample.json or else calib.txt."""
        return self.photographed_by.nominal

    @property
    def photographed_by(self) -> Rig:
        """The rig that took the images: `rig`, except for calibration errors introduced on purpose."""
        if not self.has("sample.json"):
            return self.calibration.rig()
        return read_part(RIG, self.record, "rig", self.folder / "sample.json")

    @property
    def num_lenses(self) -> int:
        """Number of lenses."""
        return len(self._shots())

    def lens(self, k: int) -> "StoredShot":
        """The images taken through lens k; 0 is the sample's own im0 and im1. Raises InputError beyond the last."""
        shots = self._shots()
        if not 0 <= k < len(shots):
            raise InputError(
                f"{self.name}: has lenses 0 to {len(shots) - 1}, no lens {k}"
            )
        return StoredShot(self, self.folder / shots[k].folder, k, shots[k])

    def _shots(self) -> list[_PlainShot]:
        if not self.has("sample.json"):
            return [_PlainShot(folder="./", lens={})]
        return read_part(_SHOTS, self.record, "shots", self.folder / "sample.json")

    def _disparity_path(self, i: int) -> Place:
        paths = [self.path(f"disp{i}.pfm"), self.path(f"disp{i}GT.pfm")]
        return next((path for path in paths if path.exists()), paths[0])


@dataclass(frozen=True)
class StoredShot:
    """The images taken through one lens of a stored sample."""

    sample: StoredSample
    folder: Place
    number: int
    entry: _PlainShot = field(compare=False, repr=False)

    @property
    def lens(self) -> Lens:
        """The lens. Raises FileError if the sample has no sample.json."""
        file = self.sample.folder / "sample.json"
        if not self.sample.has("sample.json"):
            raise FileError(f"{file}: no such file")
        return read(LENS, self.entry.lens, file, f"shots[{self.number}].lens")

    @property
    def record(self) -> dict[str, Any]:
        """How the images were taken, as plain data."""
        return dict(self.entry.record or {})

    @property
    def renderer_noise(self) -> float | None:
        """Renderer noise over sensor noise in the noisiest view, or None where it was not measured."""
        ratios = self.record.get("light_paths_over_sensor")
        known = isinstance(ratios, list) and all(
            isinstance(ratio, (int, float)) for ratio in ratios
        )
        return max(ratios) if known and ratios else None

    def path(self, name: str) -> Place:
        """The place of the lens's file of that name."""
        return self.folder / name if self.number else self.sample.path(name)

    def image(self, i: int) -> Image:
        """Image of view i, uint8 or uint16 (H, W, 3) or (H, W)."""
        return read_png(self.path(f"im{i}.png"))

    im0, im1 = _view(image, 0), _view(image, 1)

    def dp_left(self, i: int) -> Image:
        """Image of the left halves of view i's dual pixels, as `image`. Raises FileError without dual pixels."""
        return read_png(self.path(f"dp-left{i}.png"))

    def dp_right(self, i: int) -> Image:
        """Image of the right halves of view i's dual pixels, as `image`. Raises FileError without dual pixels."""
        return read_png(self.path(f"dp-right{i}.png"))

    def dp_disparity(self, i: int) -> Disparity:
        """True disparity of view i's dual pixels, u_left - u_right, float32 (H, W), pixels; +inf unknown."""
        return read_disparity(self.path(f"dp-disp{i}.pfm"))

    dp_left0, dp_right0, dp_disp0 = (
        _view(dp_left, 0),
        _view(dp_right, 0),
        _view(dp_disparity, 0),
    )

    def radiance(self, i: int) -> NDArray[np.float32]:
        """Linear image of view i, float32 (H, W, 3), if it was stored."""
        path = self.path(f"radiance{i}.exr")
        channels = read_exr(path).channels
        if not {"R", "G", "B"} <= set(channels):
            raise FileError(
                f"{path}: needs channels R, G and B, has {', '.join(channels)}"
            )
        return np.stack(
            [np.asarray(channels[name], np.float32) for name in "RGB"], axis=-1
        )

    def blur_circle_px(self, i: int) -> NDArray[np.float32]:
        """Signed blur circle of view i for this lens, pixels, float32 (H, W): `optics.circle_of_confusion_px`."""
        depth = read_truth(self.sample.path(f"truth{i}.exr"))["depth"]
        return blur_circle_px(depth, self.sample.rig.cameras[i], self.lens)


def samples_in(path: Place) -> tuple[StoredSample, ...]:
    """The samples in the subfolders of `path`, or `path` itself; dataset.json is not read."""
    if (path / "im0.png").is_file():
        return (StoredSample(path, path.resolve().name),)
    folders = sorted(
        (entry for entry in path.iterdir() if not entry.name.startswith(".")), key=str
    )
    folders = [folder for folder in folders if (folder / "im0.png").is_file()]
    if isinstance(
        path, RemotePath
    ):  # twinlens writes a mark last: samples without it are incomplete
        folders = [folder for folder in folders if is_whole(folder)] or folders
    return tuple(StoredSample(folder, folder.name) for folder in folders)


_SAMPLE_QUANTITIES = ("name", "ndisp")
_CALIBRATION_QUANTITIES = ("baseline", "doffs")
_CAMERA_QUANTITIES = ("K", "world_from_cam")
_TRUTH_QUANTITIES = (*SCALARS, *VECTORS, *PROJECTIONS)
_DUAL_METHODS = {
    "dp_left": "dp_left",
    "dp_right": "dp_right",
    "dp_disp": "dp_disparity",
}
_VIEW_METHODS = {
    "im": "image",
    "disp": "disparity",
    "mask_nonocc": "mask_nonocc",
    "radiance": "radiance",
}
_LENS_METHODS = {
    "im": "image",
    "radiance": "radiance",
    "blur_circle_px": "blur_circle_px",
    **_DUAL_METHODS,
}
"""The quantities of docs/loading.md. The last three tables give the methods that read them."""

_NAME = re.compile(r"(?:lens(\d{1,4})\.)?([A-Za-z_]+?)(\d{1,4})(_nonocc)?")


def parse_quantity(name: str) -> tuple[str, int | None, int]:
    """Quantity, lens and view of a name of docs/loading.md. Raises InputError, with the nearest name, for another.

    >>> parse_quantity("lens1.im0"), parse_quantity("mask1_nonocc")
    (('im', 1, 0), ('mask_nonocc', None, 1))
    """
    if not isinstance(name, str):
        raise InputError(
            f"the name of a quantity is a text, such as 'im0', got {format_value(name)}"
        )
    if name in (*_SAMPLE_QUANTITIES, *_CALIBRATION_QUANTITIES):
        return name, None, 0
    match = _NAME.fullmatch(name)
    lens, quantity, view = (
        (match[1], match[2] + (match[4] or ""), int(match[3]))
        if match
        else (None, "", 0)
    )
    view_quantities = (
        *_VIEW_METHODS,
        *_DUAL_METHODS,
        *_CAMERA_QUANTITIES,
        *_TRUTH_QUANTITIES,
    )
    if quantity in (_LENS_METHODS if lens else view_quantities):
        return quantity, int(lens) if lens else None, view
    examples = (
        *(f"{each}0" for each in view_quantities if each != "mask_nonocc"),
        "mask0_nonocc",
        "lens1.im0",
    )
    raise unknown(
        "quantity of a sample",
        name,
        (*_SAMPLE_QUANTITIES, *_CALIBRATION_QUANTITIES, *examples),
    )


def read_quantities(names: Iterable[str], sample: StoredSample) -> dict[str, Any]:
    """Read the quantities `names` of a sample, by name; each truth file is read once.

    Raises InputError for an unknown name, FileError for a missing file.
    """
    truth = functools.cache(lambda i: read_truth(sample.path(f"truth{i}.exr")))
    values: dict[str, Any] = {}
    for name in names:
        quantity, lens, view = parse_quantity(name)
        if lens is not None or quantity in _VIEW_METHODS | _DUAL_METHODS:
            owner = (
                sample
                if lens is None and quantity in _VIEW_METHODS
                else sample.lens(lens or 0)
            )
            values[name] = getattr(owner, (_VIEW_METHODS | _LENS_METHODS)[quantity])(
                view
            )
        elif quantity in _TRUTH_QUANTITIES:
            values[name] = truth(view)[quantity]
        elif quantity in _CAMERA_QUANTITIES:
            rig = sample.rig
            if view >= len(rig):
                raise InputError(
                    f"{sample.name}: has cameras 0 to {len(rig) - 1}, no camera {view}"
                )
            values[name] = (
                rig.cameras[view].K
                if quantity == "K"
                else rig.world_from_cams[view].copy()
            )
        else:
            values[name] = getattr(
                sample.calibration if quantity in _CALIBRATION_QUANTITIES else sample,
                quantity,
            )
    return values
