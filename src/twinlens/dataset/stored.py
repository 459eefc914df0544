"""A sample on disk or in a bucket. Every access reads the file; nothing is cached.

The folder may be twinlens's own, or a plain one with Middlebury's names (im0.png, im1.png, disp0.pfm or disp0GT.pfm,
mask0nocc.png, calib.txt). A missing file raises FileError that names it.
"""

import functools
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray

from twinlens.camera import ObjectTruth, RecipeLens, Rig
from twinlens.camera.projector import MAX_FRAMES
from twinlens.camera.truth import Correspondence, Projection, Truth
from twinlens.dataset.channels import (
    CHANNELS,
    DISPARITY,
    DP_DISPARITY,
    DP_LEFT,
    DP_RIGHT,
    FIRST_VERSION,
    IMAGE,
    MASK,
    RADIANCE,
    TEXTS,
    TRUTH,
    Channel,
    ViewFile,
)
from twinlens.dataset.codecs.calib import Calibration, read_calib
from twinlens.dataset.files import check_relative
from twinlens.dataset.lens_labels import label_of_lens, written_label
from twinlens.dataset.points import points_from_depth, world_points
from twinlens.dataset.record import (
    LENS,
    RIG,
    FileModel,
    annotation_of,
    read,
    read_json,
    read_part,
)
from twinlens.dataset.sample import KIND, VERSION, blur_circle_px, shot_folder
from twinlens.dataset.storage import MARK, Place, RemotePath, is_whole
from twinlens.dataset.visibility import (
    Disparity,
    Mask,
    correspondence_of,
    mask_from_both,
    mask_from_one,
)
from twinlens.errors import FileError, InputError, format_value, nearest, unknown

Image = NDArray[Any]
# "png" is for IM0.PNG, which is not im0.png on most file systems.
_OTHER_FORMATS = ("jpg", "jpeg", "tif", "tiff", "bmp", "webp", "ppm", "pgm", "png")
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
    frames: list[dict[str, Any]] = pydantic.Field(
        default=[],
        max_length=MAX_FRAMES,
        description="records of the frames of a sequence after the first",
    )

    @property
    def num_frames(self) -> int:
        """The number of frames."""
        return 1 + len(self.frames)


class ShotEntry(_PlainShot):
    """A lens of a sample in sample.json."""

    lens: annotation_of(RecipeLens)  # type: ignore[valid-type]


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
    dropped: list[str] = pydantic.Field(
        default=[], description="channels that `twinlens subset` left out"
    )
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

    im0, disp0, mask0_nonocc, truth0, im1, ... are `image(0)`, `disparity(0)` and so on; every other channel of
    `channels.CHANNELS` is an attribute too, such as depth0. As a mapping, its keys are name, the images, disp0 and
    mask0_nonocc; ``sample[name]`` reads every quantity of docs/loading.md. `row` is its row in dataset.json; empty if
    there is none.
    """

    folder: Place
    name: str
    row: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __getitem__(self, name: str) -> Any:
        return read_quantities((name,), self)[name]

    if not TYPE_CHECKING:  # so that type checkers still find misspelt names

        def __getattr__(self, name: str) -> Any:
            quantity = None if name.startswith("_") else find_quantity(name)
            if quantity is None or quantity.channel is None:
                kind = type(self).__name__
                near = None if name.startswith("_") else nearest(name, _array_names())
                hint = f"; did you mean {near!r}?" if near else ""
                raise AttributeError(f"{kind!r} object has no attribute {name!r}{hint}")
            return self[name]

    def __iter__(self) -> Iterator[str]:
        yield "name"
        for view in itertools.count():
            if not self.has(IMAGE.name(view)):
                break
            yield CHANNELS["im"].quantity(view)
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
        image: Image = self._read(IMAGE, i)["im"]
        return image

    def disparity(self, i: int) -> Disparity:
        """True disparity of view i, u_left - u_right, float32 (H, W), pixels; +inf unknown."""
        if not self.has_disparity(i) and self._is_not_rectified:
            problem = "has one view; disparity needs two"
            if len(self.rig) > 1:
                problem = "the pair is not rectified and has no disparity; run `twinlens rectify`"
            raise FileError(f"{self.folder}: {problem}")
        disparity: Disparity = self._read(DISPARITY, i)["disp"]
        return disparity

    def has_disparity(self, i: int) -> bool:
        """Whether the folder has a disparity map of view i."""
        return self._view_path(DISPARITY, i).is_file()

    def may_have_disparity(self, i: int) -> bool:
        """Whether `disparity` reads a map, or raises an error that says why there is none.

        It does for a pair that is not rectified, and for a sample of twinlens that has lost this file: it has others of
        truth. A sample without any, and a plain folder, are of a pair without truth.
        """
        if self.has_disparity(i) or self._is_not_rectified:
            return True
        if not self.has("sample.json") or "disp" in self.dropped:
            return False
        files = itertools.product((DISPARITY, MASK, TRUTH), (0, 1))
        return any(self._view_path(file, view).is_file() for file, view in files)

    @property
    def _is_not_rectified(self) -> bool:
        """Whether sample.json says that the sample is no rectified pair."""
        return self.has("sample.json") and self.record.get("rectified") is False

    def has_truth(self, i: int) -> bool:
        """Whether the folder has the truth of view i."""
        return self._view_path(TRUTH, i).is_file()

    def mask_nonocc(self, i: int) -> Mask:
        """Mask of view i, uint8 (H, W): 255 visible in both, 128 occluded or out of frame, 0 unknown.

        Without a file it follows from the disparity maps: see `twinlens.dataset.visibility`.
        """
        if self._view_path(MASK, i).exists():
            mask: Mask = self._read(MASK, i)["mask_nonocc"]
            return mask
        if i < 2 and self.has_disparity(1 - i):
            return mask_from_both(self.disparity(i), self.disparity(1 - i), left=i == 0)
        return mask_from_one(self.disparity(i), left=i == 0)

    def truth(self, i: int) -> Truth:
        """Truth of view i; depth, position and the pixels of projectors have float32 precision.

        Far from the origin, positions are computed from depth, in float64.
        """
        channels = self._read(TRUTH, i)
        # The blur circle is that of a lens, and a Truth is of no lens.
        channels.pop("blur_circle_px", None)
        self._check_complete(channels, i)
        view = self.rig.cameras[i], self.rig.world_from_cams[i], channels["depth"]
        if "position" in channels:
            channels["position"] = world_points(*view, channels["position"])
        else:
            channels["position"] = points_from_depth(*view)
        channels["depth"] = channels["depth"].astype(np.float64)
        pixels, lit = channels.pop("projector_pixels"), channels.pop("lit")
        projections = map(Projection, pixels.astype(np.float64), lit)
        disparity = np.full(channels["depth"].shape, np.inf, np.float32)
        if self.has_disparity(i):
            disparity = self.disparity(i)
        named = {field.name for field in fields(Truth)}
        return Truth(
            **{name: channels.pop(name) for name in named & channels.keys()},
            disparity=disparity,
            objects=self.objects(i),
            projections=tuple(projections),
            extra=channels,
        )

    def _check_complete(self, channels: Mapping[str, Any], i: int) -> None:
        """Raise FileError unless a view's channels of truth make a Truth; the position follows from the depth."""
        missing = [
            channel.name
            for channel in TRUTH.channels
            if channel.name not in {*channels, "position", "blur_circle_px"}
        ]
        dropped = [name for name in missing if name in self.dropped]
        if dropped:
            raise FileError(
                f"{self.path(TRUTH.name(i))}: has no {', '.join(dropped)}, which `twinlens subset` dropped; "
                "read single channels, such as sample.depth0"
            )

    @property
    def dropped(self) -> tuple[str, ...]:
        """Names of the channels that `twinlens subset` left out, by sample.json."""
        names = self.record.get("dropped", []) if self.has("sample.json") else []
        return tuple(map(str, names)) if isinstance(names, list) else ()

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
            calibration = self.calibration
            if self.has(IMAGE.name(0)):
                calibration.check_size(self.im0.shape, self.path("calib.txt"))
            return calibration.rig()
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

    @property
    def num_frames(self) -> int:
        """Number of frames, each with its images; 1 unless a projector showed a sequence of patterns."""
        return self._shots()[0].num_frames

    def frame(self, k: int) -> "StoredShot":
        """The images of frame k through the first lens; 0 is the sample's own. Raises InputError beyond the last."""
        return self.lens(0).frame(k)

    def _shots(self) -> list[_PlainShot]:
        if not self.has("sample.json"):
            return [_PlainShot(folder="./", lens={})]
        return read_part(_SHOTS, self.record, "shots", self.folder / "sample.json")

    def _view_path(self, file: ViewFile, view: int) -> Place:
        """The place of a view's file, under twinlens's name or else under one of Middlebury's."""
        paths = [self.path(name) for name in file.names(view)]
        if len(paths) == 1:
            return paths[0]
        return next((path for path in paths if path.exists()), paths[0])

    @property
    def written_by(self) -> str:
        """The version of twinlens that wrote the sample; empty if it is unknown."""
        if not self.has("sample.json"):
            return ""
        return str(self.record.get("twinlens", ""))

    def read_file(self, file: ViewFile, path: Place) -> dict[str, Any]:
        """The arrays in a file of the sample by channel.

        Raises FileError, also for a channel that the file lacks, unless the sample is older than the channel, or says
        that it was dropped.
        """
        arrays = file.read(path)
        missing = [channel for channel in file.channels if channel.name not in arrays]
        dropped = self.dropped if missing else ()
        for channel in missing:
            if channel.name in dropped:
                continue
            problem = f"{path}: has no channel {channel.name!r}"
            if channel.since == FIRST_VERSION:
                raise FileError(problem)
            version = self.written_by
            if channel.is_written_by(version):
                raise FileError(
                    f"{problem}, which samples written by twinlens {version} must have, since its row in CHANNELS says "
                    f"since={channel.since!r}; the row of a new channel must say the next version"
                )
        return arrays

    def _read(self, file: ViewFile, view: int) -> dict[str, Any]:
        return self._read_kept(file, self._view_path(file, view))

    def _read_kept(self, file: ViewFile, path: Place) -> dict[str, Any]:
        """`read_file`; the FileError of a file that was dropped says so."""
        try:
            return self.read_file(file, path)
        except FileError:
            names = file.array_names
            if path.exists() or not set(names) <= set(self.dropped):
                raise
            raise FileError(
                f"{path}: is not in this dataset; `twinlens subset` dropped {', '.join(names)}"
            ) from None


@dataclass(frozen=True)
class ReadOnce(StoredSample):
    """A sample whose sample.json is read once, for passes over many samples that use several of its values."""

    @functools.cached_property
    def record(self) -> dict[str, Any]:
        """sample.json, how the sample was made, as plain data."""
        return StoredSample(self.folder, self.name).record

    @functools.cached_property
    def _is_recorded(self) -> bool:
        return StoredSample(self.folder, self.name).has(MARK)

    def has(self, name: str) -> bool:
        """Whether the sample has a file of that name."""
        return self._is_recorded if name == MARK else super().has(name)

    @classmethod
    def of(cls, sample: StoredSample) -> "ReadOnce":
        """The sample, of which nothing has been read yet."""
        return cls(sample.folder, sample.name, sample.row)


@dataclass(frozen=True)
class StoredShot:
    """The images taken through one lens of a stored sample, in one frame of its sequence."""

    sample: StoredSample
    folder: Place
    number: int
    entry: _PlainShot = field(compare=False, repr=False)
    frame_number: int = 0

    @property
    def lens(self) -> RecipeLens:
        """The lens. Raises FileError if the sample has no sample.json."""
        file = self.sample.folder / "sample.json"
        if not self.sample.has("sample.json"):
            raise FileError(f"{file}: no such file")
        return read(LENS, self.entry.lens, file, f"shots[{self.number}].lens")

    @property
    def label(self) -> str:
        """The lens as the maker of the sample wrote it, such as f/1.4, or else by its aperture and focus distance."""
        return written_label(self.sample.record, self.number) or label_of_lens(
            self.lens
        )

    @property
    def record(self) -> dict[str, Any]:
        """How the images were taken, as plain data."""
        if self.frame_number:
            return dict(self.entry.frames[self.frame_number - 1])
        return dict(self.entry.record or {})

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return self.entry.num_frames

    def frame(self, k: int) -> "StoredShot":
        """The images of frame k through this lens. Raises InputError beyond the last."""
        if not 0 <= k < self.num_frames:
            raise InputError(
                f"{self.sample.name}: has frames 0 to {self.num_frames - 1}, no frame {k}"
            )
        return replace(self, frame_number=k)

    @property
    def renderer_noise(self) -> float | None:
        """Renderer noise over sensor noise in the noisiest view, or None where it was not measured."""
        ratios = self.record.get("light_paths_over_sensor")
        if not isinstance(ratios, list) or not ratios:
            return None
        are_numbers = all(isinstance(ratio, (int, float)) for ratio in ratios)
        return max(ratios) if are_numbers else None

    def path(self, name: str) -> Place:
        """The place of the lens's file of that name, in the folder of the frame."""
        if self.frame_number:
            name = f"{shot_folder(0, self.frame_number)}{name}"
        return self.folder / name if self.number else self.sample.path(name)

    def image(self, i: int) -> Image:
        """Image of view i, uint8 or uint16 (H, W, 3) or (H, W)."""
        image: Image = self._read(IMAGE, i)["im"]
        return image

    im0, im1 = _view(image, 0), _view(image, 1)

    def dp_left(self, i: int) -> Image:
        """Image of the left halves of view i's dual pixels, as `image`. Raises FileError without dual pixels."""
        image: Image = self._read(DP_LEFT, i)["dp_left"]
        return image

    def dp_right(self, i: int) -> Image:
        """Image of the right halves of view i's dual pixels, as `image`. Raises FileError without dual pixels."""
        image: Image = self._read(DP_RIGHT, i)["dp_right"]
        return image

    def dp_disparity(self, i: int) -> Disparity:
        """True disparity of view i's dual pixels, u_left - u_right, float32 (H, W), pixels; +inf unknown."""
        disparity: Disparity = self._read(DP_DISPARITY, i)["dp_disp"]
        return disparity

    dp_left0 = _view(dp_left, 0)
    dp_right0 = _view(dp_right, 0)
    dp_disp0 = _view(dp_disparity, 0)

    def radiance(self, i: int) -> NDArray[np.float32]:
        """Linear image of view i, float32 (H, W, 3), if it was stored."""
        radiance: NDArray[np.float32] = self._read(RADIANCE, i)["radiance"]
        return radiance

    def blur_circle_px(self, i: int) -> NDArray[np.float32]:
        """Signed blur circle of view i for this lens, pixels, float32 (H, W): `optics.circle_of_confusion_px`."""
        depth = self.sample[CHANNELS["depth"].quantity(i)]
        return blur_circle_px(depth, self.sample.rig.cameras[i], self.lens)

    def _read(self, file: ViewFile, view: int) -> dict[str, Any]:
        return self.sample._read_kept(file, self.path(file.name(view)))


def samples_in(path: Place) -> tuple[StoredSample, ...]:
    """The samples in the subfolders of `path`, or `path` itself; dataset.json is not read."""
    if _is_sample(path):
        return (StoredSample(path, path.resolve().name),)
    folders = sorted(
        (entry for entry in path.iterdir() if not entry.name.startswith(".")), key=str
    )
    folders = [folder for folder in folders if _is_sample(folder)]
    # twinlens writes a mark last: remote samples without it are incomplete.
    if isinstance(path, RemotePath):
        folders = [folder for folder in folders if is_whole(folder)] or folders
    return tuple(StoredSample(folder, folder.name) for folder in folders)


def _is_sample(folder: Place) -> bool:
    return (folder / IMAGE.name(0)).is_file()


def image_of_another_format(path: Path) -> Path | None:
    """The first left image, such as im0.jpg or im0.tif, in `path` or a subfolder of it; None if there is none."""
    stem = IMAGE.name(0).removesuffix(".png")
    for folder in (path, *sorted(path.iterdir(), key=str)):
        if not folder.is_dir():
            continue
        for entry in sorted(folder.iterdir(), key=str):
            name, _, ending = entry.name.rpartition(".")
            if name.lower() == stem and ending.lower() in _OTHER_FORMATS:
                return entry
    return None


def _camera_of(sample: StoredSample, view: int) -> Rig:
    """The rig, if it has a camera of that number. Raises InputError."""
    rig = sample.rig
    if view >= len(rig):
        raise InputError(
            f"{sample.name}: has cameras 0 to {len(rig) - 1}, no camera {view}"
        )
    return rig


_PER_SAMPLE = ("name", "ndisp", "baseline", "doffs")
_PER_CAMERA = ("K", "world_from_cam")
_NOT_IN_ONE_FILE: dict[str, Callable[[StoredSample, int], Any]] = {
    "name": lambda sample, view: sample.name,
    "ndisp": lambda sample, view: sample.ndisp,
    "baseline": lambda sample, view: sample.calibration.baseline,
    "doffs": lambda sample, view: sample.calibration.doffs,
    "K": lambda sample, view: _camera_of(sample, view).cameras[view].K,
    "world_from_cam": lambda sample, view: (
        _camera_of(sample, view).world_from_cams[view].copy()
    ),
    # Plain folders may have these two in another form, or not at all.
    "disp": StoredSample.disparity,
    "mask_nonocc": StoredSample.mask_nonocc,
}
"""How the quantities are read that are not simply an array of a file."""

_NAME = re.compile(
    r"(?:lens(\d{1,4})\.)?(?:frame(\d{1,4})\.)?([A-Za-z_]+?)(\d{1,4})(_nonocc)?"
)


class Quantity(NamedTuple):
    """A value that a sample has under a name of docs/loading.md, such as im0, lens1.im0, K1 or ndisp.

    kind : the name of a channel, or of a quantity of the sample or of a camera.
    lens : the number of the lens in the name, or None.
    view : the number of the view; 0 for a quantity of the sample.
    frame : the number of the frame in the name, or None.
    """

    kind: str
    lens: int | None = None
    view: int = 0
    frame: int | None = None

    @property
    def channel(self) -> Channel | None:
        """The row of the table of channels that has the quantity, if one has."""
        return CHANNELS.get(self.kind)


def find_quantity(name: str) -> Quantity | None:
    """The quantity of that name, or None."""
    if name in _PER_SAMPLE:
        return Quantity(name)
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    lens, frame, stem, view, ending = match.groups()
    of_lens, of_frame = (None if text is None else int(text) for text in (lens, frame))
    quantity = Quantity(stem + (ending or ""), of_lens, int(view), of_frame)
    channel = quantity.channel
    if channel is None:
        is_of_camera = quantity.kind in _PER_CAMERA and lens is None and frame is None
        return quantity if is_of_camera else None
    has_lenses = channel.file.per_lens or channel.name == "blur_circle_px"
    if channel.dtype == TEXTS or (lens is not None and not has_lenses):
        return None
    if frame is not None and not channel.file.per_frame:
        return None
    return quantity


def parse_quantity(name: str) -> Quantity:
    """The quantity of that name. Raises InputError, with the nearest name, if there is none.

    >>> parse_quantity("lens1.im0")
    Quantity(kind='im', lens=1, view=0, frame=None)
    >>> parse_quantity("frame3.im1")
    Quantity(kind='im', lens=None, view=1, frame=3)
    """
    if not isinstance(name, str):
        raise InputError(
            f"the name of a quantity is a text, such as 'im0', got {format_value(name)}"
        )
    quantity = find_quantity(name)
    if quantity is None:
        names = [*_PER_SAMPLE, *_array_names()]
        names += [*(f"{kind}0" for kind in _PER_CAMERA), "lens1.im0"]
        raise unknown("quantity of a sample", name, names)
    return quantity


def _array_names() -> list[str]:
    """The names of the arrays of view 0."""
    arrays = [channel for channel in CHANNELS.values() if channel.dtype != TEXTS]
    return [channel.quantity(0) for channel in arrays]


def read_quantities(names: Iterable[str], sample: StoredSample) -> dict[str, Any]:
    """Read the quantities `names` of a sample, by name; each file of truth is read once.

    Raises InputError for an unknown name, FileError for a missing file.
    """
    truth = functools.cache(functools.partial(sample._read, TRUTH))
    return {name: _read_quantity(parse_quantity(name), sample, truth) for name in names}


def _read_quantity(
    quantity: Quantity, sample: StoredSample, truth: Callable[[int], dict[str, Any]]
) -> Any:
    kind, lens, view, frame = quantity
    if kind in _NOT_IN_ONE_FILE:
        return _NOT_IN_ONE_FILE[kind](sample, view)
    file = CHANNELS[kind].file
    if file is TRUTH and lens is not None:
        # The file has the blur circle of the first lens; those of others are computed.
        return sample.lens(lens).blur_circle_px(view)
    if file is TRUTH:
        arrays = truth(view)
    elif lens is None and frame is None:
        arrays = sample._read(file, view)
    else:
        arrays = sample.lens(lens or 0).frame(frame or 0)._read(file, view)
    if kind not in arrays and kind in sample.dropped:
        return _recomputed(kind, sample, view, arrays)
    if kind not in arrays:
        raise FileError(f"{sample.path(file.name(view))}: has no channel {kind!r}")
    return arrays[kind]


def _recomputed(
    kind: str, sample: StoredSample, view: int, arrays: Mapping[str, Any]
) -> Any:
    """A channel of truth that was dropped, if it follows from the depth. Raises FileError."""
    if "depth" in arrays and kind == "position":
        camera, pose = sample.rig.cameras[view], sample.rig.world_from_cams[view]
        points = points_from_depth(camera, pose, arrays["depth"])
        return points.astype(CHANNELS[kind].dtype)
    if "depth" in arrays and kind == "blur_circle_px":
        return sample.lens(0).blur_circle_px(view)
    raise FileError(
        f"{sample.path(TRUTH.name(view))}: has no {kind}, which `twinlens subset` dropped"
    )
