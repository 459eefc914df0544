"""What a sample may hold: the table `CHANNELS`, one row a channel, and the files that its arrays are in.

Whatever writes, reads, verifies, describes or exports arrays of a sample goes over this table, so a new channel is one
new row. A row of the file `TRUTH` needs a name, a dtype, a meaning, and `since`: its array is the field of `Truth`, or
the entry of `Truth.extra`, with that name.

    Sample -- Channel.of --> arrays -- ViewFile.encode --> bytes -- ViewFile.read --> arrays by name of their channel

calib.txt, sample.json and models/*.ply hold no arrays of a view and are not in the table.
"""

import contextlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pydantic

import twinlens
from twinlens.camera import Camera, Rig, dual_pixel_disparity
from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.dataset import consistency
from twinlens.dataset.codecs.exr import encode_exr, read_exr
from twinlens.dataset.codecs.pfm import encode_pfm, read_disparity
from twinlens.dataset.codecs.png import encode_png, read_png
from twinlens.dataset.consistency import Check
from twinlens.dataset.sample import (
    Sample,
    blur_circle_px,
    rectified_pair,
    shot_folder,
)
from twinlens.dataset.storage import Where
from twinlens.errors import FileError, InputError

PIXELS = "uint8 or uint16"
"""The dtype of photographs."""

FIRST_VERSION = "0.1.0"
"""The first version of twinlens, whose samples all have the channels that were never added later."""

TEXTS = "texts"
"""The dtype of a tuple of texts, which is a string attribute of an EXR file."""

_TEXTS = pydantic.TypeAdapter(tuple[str, ...])
_VERSION = re.compile(r"\d+\.\d+\.\d+")
_FILE_NAME = re.compile(
    r"(?:lens-(\d+)/)?(?:frame-(\d+)/)?[a-z-]+(\d+)[A-Za-z]*\.[a-z]+"
)


@dataclass(frozen=True, eq=False)
class FileFormat:
    """How arrays become the bytes of a file, and back.

    encode : from arrays by their channels. Raises InputError.
    read : arrays by the names of their channels, without those that the file lacks. Raises FileError.
    media_types, data_type : for croissant.json.
    """

    extension: str
    encode: Callable[[Mapping["Channel", Any]], bytes]
    read: Callable[[Where, Sequence["Channel"]], dict[str, Any]]
    media_types: tuple[str, ...]
    data_type: str


@dataclass(frozen=True, eq=False)
class ViewFile:
    """A kind of file that a sample has for each view, or for each view and lens.

    stem, suffix : its name is the stem, the number of the view, the suffix, and the extension of the format.
    meaning : one line, in which {} stands for the number of the view.
    required : whether a sample needs it, by the rig, the view, and whether the lens has dual pixels.
    per_lens : whether each lens has its own, in the folder of the lens.
    per_frame : whether each frame of a sequence has its own, in the folder of the frame.
    is_truth : whether it may be missing together with all other files of truth.
    aliases : suffixes of the same file in Middlebury's folders, read and never written.
    """

    stem: str
    format: FileFormat
    meaning: str
    required: Callable[[Rig, int, bool], bool]
    suffix: str = ""
    per_lens: bool = False
    per_frame: bool = False
    is_truth: bool = False
    aliases: tuple[str, ...] = ()

    def name(self, view: int, lens: int = 0, frame: int = 0) -> str:
        """The name of a view's file, relative to the sample.

        >>> IMAGE.name(1), IMAGE.name(0, lens=2), IMAGE.name(0, frame=3), MASK.name(0)
        ('im1.png', 'lens-2/im0.png', 'frame-3/im0.png', 'mask0nocc.png')
        """
        return self.names(view, lens, frame)[0]

    def names(self, view: int, lens: int = 0, frame: int = 0) -> tuple[str, ...]:
        """`name`, and the names that Middlebury uses for the same file. All names of files of views are made here."""
        start = f"{shot_folder(lens, frame)}{self.stem}{view}"
        suffixes = (self.suffix, *self.aliases)
        return tuple(f"{start}{suffix}{self.format.extension}" for suffix in suffixes)

    @property
    def channels(self) -> list["Channel"]:
        """The rows of the table that are in this file."""
        return [channel for channel in CHANNELS.values() if channel.file is self]

    @property
    def array_names(self) -> list[str]:
        """The names of the arrays in this file: of its channels, but for texts."""
        return [row.name for row in self.channels if row.dtype != TEXTS]

    def description(self, view: int, channels: Sequence["Channel"]) -> str:
        """`meaning` for one view, and a line for each of the channels that the file holds if there are several."""
        lines = [self.meaning.format(view)]
        if len(self.channels) > 1:
            lines += [
                f"- {channel.description}"
                for channel in channels
                if channel.dtype != TEXTS
            ]
        return "\n".join(lines)

    def encode(self, sample: Sample, view: int, lens: int = 0) -> bytes | None:
        """The file of a sample in memory; None if the sample has none of its channels.

        Raises InputError for an array that does not fit its channel, and if the sample lacks some of the channels.
        """
        camera = sample.rig.nominal.cameras[view]
        arrays: dict[Channel, Any] = {}
        for channel in self.channels:
            array = channel.of(sample, view, lens)
            if array is not None:
                channel.check_array(array, camera)
                arrays[channel] = array
        if not arrays:
            return None
        for channel in self.channels:
            if channel not in arrays and channel.is_written_by(twinlens.__version__):
                raise InputError(f"view {view} of the sample lacks {channel.name!r}")
        return self.format.encode(arrays)

    def read(self, path: Where) -> dict[str, Any]:
        """The arrays in such a file by the names of their channels, without those that it lacks. Raises FileError.

        `StoredSample.read_file` also raises FileError if a channel is missing.
        """
        return self.format.read(path, self.channels)


@dataclass(frozen=True, eq=False)
class Channel:
    """An array that a sample may hold for each view: a row of `CHANNELS`.

    name : of the quantity, without the number of the view.
    file : which holds it.
    dtype : of the array that is read, by NumPy's name; `PIXELS` or `TEXTS`.
    meaning, unit : for people.
    planes : names of the planes of an EXR file that hold it, by default its own name. One plane is an array (H, W),
        several are one (H, W, C). {} in a name stands for a projector's number: the array has an axis P before H.
    is_vector : whether the components are along the axes of the world.
    since : the version of twinlens in which it appears, such as 0.3.0: the next one for a new row. Samples of earlier
        versions may lack it, and those of this one must have it. Rows of `TRUTH` state it.
    value : the array of a view and a lens of a sample in memory, or None. By default it is that of the truth.
    check : findings on it, one line each.
    is_basis : whether the checks of other rows would be meaningless if this one fails.
    """

    name: str
    file: ViewFile
    dtype: str
    meaning: str
    unit: str = ""
    planes: tuple[str, ...] = ()
    is_vector: bool = False
    since: str = ""
    value: Callable[[Sample, int, int], Any] | None = field(default=None, repr=False)
    check: Check | None = field(default=None, repr=False)
    is_basis: bool = False

    def __post_init__(self) -> None:
        if not self.since and self.file is not TRUTH:
            object.__setattr__(self, "since", FIRST_VERSION)
        if _VERSION.fullmatch(self.since) is None:
            raise InputError(
                f"since of channel {self.name!r} must be the next version of twinlens, in which the channel appears, "
                f"such as '0.3.0', got {self.since!r}"
            )

    def quantity(self, view: int) -> str:
        """The name of the channel of one view: im0, depth1, mask0_nonocc."""
        start, ending, _ = self.name.partition("_nonocc")
        return f"{start}{view}{ending}"

    def of(self, sample: Sample, view: int, lens: int = 0) -> Any:
        """The array of a sample in memory, or None."""
        if self.value is not None:
            return self.value(sample, view, lens)
        if not sample.truths:
            return None
        truth = sample.truths[view]
        return getattr(truth, self.name, truth.extra.get(self.name))

    @property
    def description(self) -> str:
        """Name, unit and meaning.

        >>> CHANNELS["depth"].description
        'depth [m]: z along the optical axis; +inf unknown'
        """
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{self.name}{unit}: {self.meaning}"

    def is_written_by(self, version: str) -> bool:
        """Whether a version of twinlens writes the channel; an unknown version, "", counts as the first one.

        >>> row = Channel("speed", TRUTH, "float32", "of the point", "m/s", since="0.3.0")
        >>> [row.is_written_by(version) for version in ("", "0.2.9", "0.3.0", "0.12.1.dev3")]
        [False, False, True, True]
        """
        return _numbers(version or FIRST_VERSION) >= _numbers(self.since)

    def check_array(self, array: Any, camera: Camera) -> None:
        """Raise InputError for an array of another shape, or with values that the file would not keep.

        Only floats may be rounded, to float32. Encoders check photographs and texts themselves.
        """
        if self.dtype in (PIXELS, TEXTS):
            return
        components = (len(self.planes),) if len(self.planes) > 1 else ()
        shape = (camera.height, camera.width, *components)
        for part in array if self.per_projector else [array]:
            values = np.asarray(part)
            if values.shape != shape:
                raise InputError(
                    f"channel {self.name!r} must have the shape {shape}, got {values.shape}"
                )
            if not _keeps_values(values, self.dtype):
                raise InputError(
                    f"channel {self.name!r} must be {self.dtype}, got {values.dtype} that it cannot hold"
                )

    @property
    def per_projector(self) -> bool:
        """Whether the array has an axis of projectors, its first."""
        return any("{}" in plane for plane in self.planes)

    def to_planes(self, array: Any) -> dict[str, Any]:
        """The array as planes (H, W) of an EXR file, by name.

        >>> list(CHANNELS["normal"].to_planes(np.zeros((2, 3, 3))))
        ['normal.X', 'normal.Y', 'normal.Z']
        """
        if not self.per_projector:
            return self._split(array, 0)
        planes: dict[str, Any] = {}
        for projector, values in enumerate(array):
            planes |= self._split(values, projector)
        return planes

    def from_planes(self, planes: Mapping[str, Any], projectors: int = 0) -> Any:
        """The array in the planes of an EXR file. Raises KeyError with the name of a missing plane."""
        if not self.per_projector:
            return self._joined(planes, 0).astype(self.dtype, copy=False)
        arrays = [self._joined(planes, number) for number in range(projectors)]
        if arrays:
            return np.stack(arrays).astype(self.dtype, copy=False)
        height, width = next(iter(planes.values())).shape
        components = (len(self.planes),) if len(self.planes) > 1 else ()
        return np.empty((0, height, width, *components), self.dtype)

    def _plane_names(self, projector: int) -> list[str]:
        return [name.format(projector) for name in self.planes or (self.name,)]

    def _split(self, array: Any, projector: int) -> dict[str, Any]:
        names = self._plane_names(projector)
        if len(names) == 1:
            return {names[0]: array}
        return dict(zip(names, np.moveaxis(array, -1, 0), strict=True))

    def _joined(self, planes: Mapping[str, Any], projector: int) -> Any:
        components = [planes[name] for name in self._plane_names(projector)]
        if len(components) == 1:
            return components[0]
        return np.stack(components, axis=-1)


def _numbers(version: str) -> tuple[int, ...]:
    """Major, minor and patch number of a version."""
    return tuple(map(int, re.findall(r"\d+", version)[:3]))


def _keeps_values(values: Any, dtype: str) -> bool:
    """Whether an array can become `dtype` without a change but the rounding of floats."""
    if not np.can_cast(values.dtype, dtype, "same_kind"):
        return False
    return values.dtype.kind == "f" or np.array_equal(values.astype(dtype), values)


def view_files() -> list[ViewFile]:
    """The files that the rows of the table are in."""
    return list(dict.fromkeys(channel.file for channel in CHANNELS.values()))


class FileOf(NamedTuple):
    """A file of a view: its kind, and the view, lens and frame that it is of."""

    file: ViewFile
    view: int
    lens: int = 0
    frame: int = 0

    @property
    def name(self) -> str:
        """The name, relative to the sample."""
        return self.file.name(self.view, self.lens, self.frame)


def parse_file(name: str) -> FileOf | None:
    """Kind of file, view, lens and frame of a name relative to a sample; None if it is no file of a view.

    >>> kind, view, lens, frame = parse_file("lens-2/frame-3/im1.png")
    >>> kind is IMAGE, view, lens, frame
    (True, 1, 2, 3)
    """
    match = _FILE_NAME.fullmatch(name)
    if match is None:
        return None
    lens, frame, view = int(match[1] or 0), int(match[2] or 0), int(match[3])
    for file in view_files():
        if name in file.names(view, lens, frame):
            return FileOf(file, view, lens, frame)
    return None


def _encode_single(
    encode: Callable[[Any], bytes],
) -> Callable[[Mapping[Channel, Any]], bytes]:
    """The encoder of a format that holds one array."""

    def encode_arrays(arrays: Mapping[Channel, Any]) -> bytes:
        (array,) = arrays.values()
        return encode(array)

    return encode_arrays


def _read_single(
    read: Callable[[Where], Any],
) -> Callable[[Where, Sequence[Channel]], dict[str, Any]]:
    """The reader of a format that holds one array."""
    return lambda path, channels: {channels[0].name: read(path)}


def _read_grey(path: Where) -> Any:
    pixels = read_png(path)
    if pixels.ndim != 2 or pixels.dtype != np.uint8:
        raise FileError(f"{path}: a mask must be an 8-bit grey PNG")
    return pixels


def encode_channels(arrays: Mapping[Channel, Any]) -> bytes:
    """An EXR file of the arrays of some channels. Raises InputError for arrays of different sizes."""
    planes: dict[str, Any] = {}
    texts: dict[str, str] = {}
    for channel, array in arrays.items():
        if channel.dtype == TEXTS:
            texts[channel.name] = json.dumps(array)
        else:
            planes |= channel.to_planes(array)
    return encode_exr(planes, texts)


def _read_channels(path: Where, channels: Sequence[Channel]) -> dict[str, Any]:
    """The arrays of some channels in an EXR file, without those that it lacks."""
    exr = read_exr(path)
    projectors = _count_projectors(exr.channels)
    arrays: dict[str, Any] = {}
    for channel in channels:
        if channel.dtype == TEXTS:
            arrays[channel.name] = _texts(exr.text.get(channel.name, "[]"), path)
            continue
        with contextlib.suppress(KeyError):  # a plane that the file lacks
            arrays[channel.name] = channel.from_planes(exr.channels, projectors)
    return arrays


def _count_projectors(planes: Mapping[str, Any]) -> int:
    """The number of different prefixes projector0, projector1, ... in names of planes."""
    prefixes = {name.partition(".")[0] for name in planes}
    return sum(prefix.startswith("projector") for prefix in prefixes)


def _texts(encoded: str, path: Where) -> tuple[str, ...]:
    try:
        return _TEXTS.validate_json(encoded, strict=True)
    except ValueError:
        raise FileError(
            f"{path}: the names of objects or materials are damaged"
        ) from None


# mlcroissant decodes few formats; with a second media type, text/plain, it returns the bytes of the others.
PNG = FileFormat(
    ".png",
    _encode_single(encode_png),
    _read_single(read_png),
    ("image/png",),
    "sc:ImageObject",
)
GREY_PNG = FileFormat(
    ".png",
    _encode_single(encode_png),
    _read_single(_read_grey),
    ("image/png",),
    "sc:ImageObject",
)
PFM = FileFormat(
    ".pfm",
    _encode_single(encode_pfm),
    _read_single(read_disparity),
    ("image/x-portable-floatmap", "text/plain"),
    "sc:ImageObject",
)
EXR = FileFormat(
    ".exr", encode_channels, _read_channels, ("image/x-exr", "text/plain"), "sc:Text"
)


def _always(rig: Rig, view: int, dual: bool) -> bool:
    return True


def _never(rig: Rig, view: int, dual: bool) -> bool:
    return False


def _dual(rig: Rig, view: int, dual: bool) -> bool:
    return dual


def _has_partner(rig: Rig, view: int, dual: bool) -> bool:
    return rig.partner(view) is not None


def _is_rectified(rig: Rig, view: int, dual: bool) -> bool:
    return rectified_pair(rig, view) is not None


def _valid(sample: Sample, view: int, lens: int) -> Any:
    return sample.truths[view].extra.get("valid") if sample.truths else None


IMAGE = ViewFile("im", PNG, "image of view {}", _always, per_lens=True, per_frame=True)
RADIANCE = ViewFile(
    "radiance", EXR, "linear image of view {}", _never, per_lens=True, per_frame=True
)
DP_LEFT = ViewFile(
    "dp-left",
    PNG,
    "image of the left halves of view {}'s dual pixels",
    _dual,
    per_lens=True,
)
DP_RIGHT = ViewFile(
    "dp-right",
    PNG,
    "image of the right halves of view {}'s dual pixels",
    _dual,
    per_lens=True,
)
TRUTH = ViewFile("truth", EXR, "truth of view {}", _always, is_truth=True)
MASK = ViewFile(
    "mask",
    GREY_PNG,
    "view {}: 255 visible in both, 128 occluded or out of frame, 0 unknown",
    _has_partner,
    suffix="nocc",
    is_truth=True,
)
VALID = ViewFile(
    "valid",
    GREY_PNG,
    "view {} of a rectified sample: 255 where the pixel lies in its photograph, 0 elsewhere",
    _never,
)
DISPARITY = ViewFile(
    "disp",
    PFM,
    "true disparity of view {}: float32 pixels, +inf unknown",
    _is_rectified,
    is_truth=True,
    aliases=("GT",),
)
DP_DISPARITY = ViewFile(
    "dp-disp",
    PFM,
    "true disparity of view {}'s dual pixels: float32 pixels, +inf unknown",
    _dual,
    per_lens=True,
    is_truth=True,
)


def _image(sample: Sample, view: int, lens: int) -> Any:
    return sample.shots[lens].images[view]


def _radiance(sample: Sample, view: int, lens: int) -> Any:
    radiances = sample.shots[lens].radiances
    return None if radiances is None else radiances[view]


def _left_half(sample: Sample, view: int, lens: int) -> Any:
    halves = sample.shots[lens].halves
    return None if halves is None else halves[view][0]


def _right_half(sample: Sample, view: int, lens: int) -> Any:
    halves = sample.shots[lens].halves
    return None if halves is None else halves[view][1]


def _blur_circle(sample: Sample, view: int, lens: int) -> Any:
    if not sample.truths:
        return None
    camera = sample.rig.nominal.cameras[view]
    return blur_circle_px(sample.truths[view].depth, camera, sample.shots[0].lens)


def _projector_pixels(sample: Sample, view: int, lens: int) -> Any:
    if not sample.truths:
        return None
    projections = sample.truths[view].projections
    return [projection.pixels.astype(np.float32) for projection in projections]


def _lit(sample: Sample, view: int, lens: int) -> Any:
    if not sample.truths:
        return None
    return [projection.lit for projection in sample.truths[view].projections]


def _mask(sample: Sample, view: int, lens: int) -> Any:
    if not sample.truths or sample.rig.nominal.partner(view) is None:
        return None
    return sample.truths[view].mask_nonocc()


def _disparity(sample: Sample, view: int, lens: int) -> Any:
    if not sample.truths or rectified_pair(sample.rig.nominal, view) is None:
        return None
    return sample.truths[view].disparity


def _dual_disparity(sample: Sample, view: int, lens: int) -> Any:
    shot = sample.shots[lens]
    if not sample.truths or shot.halves is None:
        return None
    camera = sample.rig.nominal.cameras[view]
    return dual_pixel_disparity(sample.truths[view], camera, shot.lens)


def _vector(name: str) -> tuple[str, ...]:
    return tuple(f"{name}.{axis}" for axis in "XYZ")


# fmt: off
_ROWS = (
    Channel("im", IMAGE, PIXELS, "image, gamma-encoded (sRGB)", value=_image),
    Channel("radiance", RADIANCE, "float32", "linear image", planes=("R", "G", "B"), value=_radiance),
    Channel("dp_left", DP_LEFT, PIXELS, "image of the left halves of dual pixels", value=_left_half),
    Channel("dp_right", DP_RIGHT, PIXELS, "image of the right halves of dual pixels", value=_right_half),

    Channel("depth", TRUTH, "float32", "z along the optical axis; +inf unknown", "m", since=FIRST_VERSION),
    Channel("position", TRUTH, "float32", "point in the world; +inf unknown", "m",
            planes=_vector("position"), is_vector=True, since=FIRST_VERSION, check=consistency.check_positions,
            is_basis=True),
    Channel("normal", TRUTH, "float32", "geometric unit normal in the world, towards the camera; 0 unknown",
            planes=_vector("normal"), is_vector=True, since=FIRST_VERSION),
    Channel("shading_normal", TRUTH, "float32", "interpolated unit normal in the world; 0 unknown",
            planes=_vector("shading_normal"), is_vector=True, since=FIRST_VERSION),
    Channel("visible", TRUTH, "bool", "whether the partner view sees the point", since=FIRST_VERSION),
    Channel("object_id", TRUTH, "int32", "1 + index into object_names; 0 unknown",
            check=consistency.check_ids("object_id", "object_names"), since=FIRST_VERSION),
    Channel("material_id", TRUTH, "int32", "1 + index into material_names; 0 unknown",
            check=consistency.check_ids("material_id", "material_names"), since=FIRST_VERSION),
    Channel("material_kind", TRUTH, "uint8", "index into MATERIAL_KINDS",
            check=consistency.check_ids("material_kind", MATERIAL_KINDS[1:]), since=FIRST_VERSION),
    Channel("blur_circle_px", TRUTH, "float32", "signed diameter of the blur circle, positive before the focus", "px",
            value=_blur_circle, check=consistency.check_blur, since=FIRST_VERSION),
    Channel("projector_pixels", TRUTH, "float32", "pixels of the projectors that light the point; +inf unknown", "px",
            planes=("projector{}.u", "projector{}.v"), since=FIRST_VERSION, value=_projector_pixels,
            check=consistency.check_projections),
    Channel("lit", TRUTH, "bool", "whether the light of each projector reaches the point",
            planes=("projector{}.lit",), value=_lit, since=FIRST_VERSION),
    Channel("object_names", TRUTH, TEXTS, "names of the objects", since=FIRST_VERSION),
    Channel("material_names", TRUTH, TEXTS, "names of the materials", since=FIRST_VERSION),

    Channel("dp_disp", DP_DISPARITY, "float32", "true disparity of the halves of dual pixels; +inf unknown", "px",
            value=_dual_disparity, check=consistency.check_dual_pixels),
    Channel("disp", DISPARITY, "float32", "true disparity, u_left - u_right; +inf unknown", "px",
            value=_disparity, check=consistency.check_disparity),
    Channel("mask_nonocc", MASK, "uint8", "255 visible in both views, 128 occluded or out of frame, 0 unknown",
            value=_mask, check=consistency.check_mask),
    Channel("valid", VALID, "uint8", "255 where a rectified pixel lies in its photograph, 0 elsewhere",
            value=_valid),
)
# fmt: on

CHANNELS: dict[str, Channel] = {channel.name: channel for channel in _ROWS}
"""The channels by name. Checks run in this order."""
