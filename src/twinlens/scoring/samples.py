"""Samples of a benchmark: the `ScoredSample` interface, a `Pair` in memory, the pairs of a dataset on disk."""

import hashlib
import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset import Calibration, Dataset, StoredSample, downloaded_pairs
from twinlens.dataset.layouts import MIDDLEBURY_FOLDER
from twinlens.dataset.storage import place
from twinlens.dataset.visibility import mask_from_one
from twinlens.errors import FileError, InputError, located
from twinlens.matching.contract import DEFAULT_DISPARITIES
from twinlens.scoring.board import LENS_SEPARATOR, Board, Recorded
from twinlens.scoring.grouping import groups_by
from twinlens.scoring.metrics import Disparity, boolean_mask, disparity_map
from twinlens.scoring.recorded import recorded_values, scalars


class ScoredSample(Protocol):
    """Any object with these attributes is a sample; each is read once.

    im0, im1: uint8 or uint16 (H, W[, 3]), left and right. disp0: float32 (H, W), true disparity of the left view in
    pixels, +inf unknown; None for a pair without truth. mask0_nonocc: uint8 (H, W), 255 visible in both views, or None.
    ndisp: disparities to search. Other attributes of `Pair` are optional.
    """

    @property
    def name(self) -> str: ...
    @property
    def im0(self) -> NDArray[Any]: ...
    @property
    def im1(self) -> NDArray[Any]: ...
    @property
    def disp0(self) -> Disparity | None: ...
    @property
    def mask0_nonocc(self) -> NDArray[np.uint8] | NDArray[np.bool_] | None: ...
    @property
    def ndisp(self) -> int: ...


@dataclass(frozen=True, eq=False)
class Pair:
    """A sample in memory. See `ScoredSample` for the other arrays.

    calibration: for errors in metres. blur0 (pixels), material_kind0: (H, W), for regions. The search covers
    min_disparity to min_disparity + ndisp - 1. aliases: other names of this sample's map in a submission, the
    recommended one first. renderer_noise: over the sensor's noise, if measured. scene: a name that views of the same
    surfaces share; empty if it is not known. recorded: how the sample was made, by name (`scoring.recorded`).
    is_search_assumed: ndisp is a default, because nothing says what it is.

    Raises InputError for images that are not 8 or 16 bit, sizes that differ, and ndisp < 1.
    """

    name: str
    im0: NDArray[Any]
    im1: NDArray[Any]
    disp0: Disparity | None
    mask0_nonocc: NDArray[np.uint8] | NDArray[np.bool_] | None
    ndisp: int
    calibration: Calibration | None = None
    blur0: NDArray[np.floating[Any]] | None = None
    material_kind0: NDArray[np.uint8] | None = None
    min_disparity: int = 0
    aliases: tuple[str, ...] = ()
    renderer_noise: float | None = None
    scene: str = ""
    recorded: Mapping[str, Recorded] = field(default_factory=dict)
    is_search_assumed: bool = False

    def __post_init__(self) -> None:
        # The class is frozen.
        object.__setattr__(self, "recorded", dict(scalars(self.recorded)))
        with located(f"sample {self.name!r}"):
            self._check()

    def warn_of_search(self) -> None:
        """Warn where no true disparity is in the range of the search, and where the range is a default."""
        last = self.min_disparity + self.ndisp - 1
        if self.is_search_assumed:
            warnings.warn(
                f"sample {self.name!r}: no number of disparities in calib.txt or truth; searching "
                f"{self.min_disparity} to {last}; set it with --num-disparities",
                stacklevel=2,
            )
        if self.disp0 is None:
            return
        finite = self.disp0[np.isfinite(self.disp0)]
        if not finite.size or ((finite >= self.min_disparity) & (finite <= last)).any():
            return
        warnings.warn(
            f"sample {self.name!r}: all true disparities, {finite.min():.4g} to {finite.max():.4g} px, are beyond the "
            f"search of {self.min_disparity} to {last}: is ndisp that of another image size?",
            stacklevel=2,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the left image, and of the truth."""
        height, width = self.im0.shape[:2]
        return height, width

    @property
    def truth(self) -> Disparity:
        """`disp0`; without truth a map of the left image's size that is +inf, unknown, everywhere."""
        if self.disp0 is None:
            return np.full(self.shape, np.inf, np.float32)
        return self.disp0

    def _check(self) -> None:
        size = self.im0.shape[:2]
        if self.disp0 is not None:
            size = disparity_map("disp0", self.disp0).shape
        for name, image in (("im0", self.im0), ("im1", self.im1)):
            if (
                image.dtype not in (np.uint8, np.uint16)
                or image.shape[:2] != size
                or image.shape[2:] not in ((), (3,))
            ):
                raise InputError(
                    f"{name} is {image.dtype} {image.shape}: expected uint8 or uint16 {size} or {(*size, 3)}"
                )
        if self.im0.dtype != self.im1.dtype:
            raise InputError(
                f"im0 is {self.im0.dtype} and im1 is {self.im1.dtype}: expected the same bit depth"
            )
        if self.calibration is not None:
            self.calibration.check_size(self.im0.shape, "calib.txt")
        if self.mask0_nonocc is not None:
            boolean_mask("mask0_nonocc", self.mask0_nonocc, size)
        for name, extra in (
            ("blur0", self.blur0),
            ("material_kind0", self.material_kind0),
        ):
            if extra is not None and extra.shape != size:
                raise InputError(
                    f"{name} has shape {extra.shape}: expected the truth's, {size}"
                )
        if self.ndisp < 1:
            raise InputError(f"ndisp is {self.ndisp}: expected 1 or more")
        if not float(self.min_disparity).is_integer():
            raise InputError(
                f"min_disparity is {self.min_disparity}: expected a whole number of pixels"
            )

    @property
    def search(self) -> dict[str, int]:
        """Keyword arguments of a matcher: num_disparities and min_disparity."""
        return {
            "num_disparities": int(self.ndisp),
            "min_disparity": int(self.min_disparity),
        }


def with_search(
    pair: Pair, num_disparities: int | None = None, min_disparity: int | None = None
) -> Pair:
    """The pair with another range of the search, in pixels; None keeps its own."""
    changes: dict[str, Any] = {}
    if num_disparities is not None:
        changes = {"ndisp": num_disparities, "is_search_assumed": False}
    if min_disparity is not None:
        changes["min_disparity"] = min_disparity
    return replace(pair, **changes) if changes else pair


def motorcycle() -> Pair:
    """Middlebury 2014 Motorcycle, 741 x 500, from scikit-image's files; the mask is that of `mask_from_one`.

    The calibration is the official one divided by four. Source: Scharstein et al., High-resolution stereo datasets with
    subpixel-accurate ground truth, GCPR 2014.
    """
    from skimage.data import stereo_motorcycle

    left, right, disparity = stereo_motorcycle()
    # scikit-image documents NaN for unknown pixels, its file has +inf.
    truth = np.where(np.isfinite(disparity), disparity, np.inf).astype(np.float32)
    ndisp = 70
    calibration = Calibration(
        cam0=(994.978, 994.978, 311.193, 254.877),
        cam1=(994.978, 994.978, 342.279, 254.877),
        baseline=0.193001,
        width=741,
        height=500,
        doffs=31.086,
        ndisp=ndisp,
        vmin=7.0,
        vmax=60.0,
    )
    mask = mask_from_one(truth)
    return Pair("motorcycle", left, right, truth, mask, ndisp, calibration)


def load_pair(sample: ScoredSample | StoredSample, lens: int = 0) -> Pair:
    """The sample as a `Pair`; optional data that is missing becomes None. lens: index of a lens of a stored sample."""
    if isinstance(sample, Pair):
        return sample
    images: Any = sample
    if isinstance(sample, StoredSample):
        images = sample.lens(lens)
        blur = _optional(lambda: images.blur_circle_px(0))
        kinds = _optional(lambda: sample.truth0.material_kind)
    else:
        blur = _optional(lambda: getattr(sample, "blur0", None))
        kinds = _optional(lambda: getattr(sample, "material_kind0", None))
    if isinstance(sample, StoredSample):
        # A calib.txt that cannot be read is an error, not a missing one.
        calibration = sample.calibration if sample.has("calib.txt") else None
    else:
        calibration = _optional(lambda: getattr(sample, "calibration", None))
    truth = _truth_of(sample)
    ndisp, is_assumed = _disparities_of(sample, calibration, truth)
    low = getattr(sample, "min_disparity", None)
    if low is None:
        ndisp, low = search_range(ndisp, calibration, truth, images.im0.shape[1])
    return Pair(
        sample.name,
        images.im0,
        images.im1,
        truth,
        None if truth is None else sample.mask0_nonocc,
        ndisp,
        calibration,
        blur,
        kinds,
        low,
        renderer_noise=getattr(images, "renderer_noise", None),
        scene=str(getattr(sample, "scene", "")),
        recorded=_recorded(sample, lens),
        is_search_assumed=is_assumed,
    )


def _recorded(sample: Any, lens: int) -> Mapping[str, Recorded]:
    """How a pair was made, by name."""
    if isinstance(sample, StoredSample):
        return recorded_values(sample, lens)
    return dict(scalars(getattr(sample, "recorded", {})))


def _truth_of(sample: ScoredSample | StoredSample) -> Disparity | None:
    """The true disparity of a sample, None where it has none.

    Raises FileError for a sample that records a pair that is not rectified: its rows cannot be matched.
    """
    if isinstance(sample, StoredSample) and not sample.may_have_disparity(0):
        return None
    return sample.disp0


def _disparities_of(
    sample: ScoredSample | StoredSample,
    calibration: Calibration | None,
    truth: Disparity | None,
) -> tuple[int, bool]:
    """The number of disparities to search, and whether it is a default because no file has it."""
    if isinstance(sample, StoredSample) and truth is None:
        if calibration is None or calibration.ndisp is None:
            return DEFAULT_DISPARITIES, True
        return calibration.ndisp, False
    return sample.ndisp, False


def search_range(
    bound: int,
    calibration: Calibration | None,
    truth: Disparity | None,
    width: int | None = None,
) -> tuple[int, int]:
    """(ndisp, min_disparity) below `bound`; the latter is negative if the calibration's vmin, or else the truth, is.

    width: that of the images, in pixels; by default the truth's.
    """
    low = None if calibration is None else calibration.vmin
    if low is None or not math.isfinite(low):
        low = 0.0 if truth is None else float(np.min(truth, initial=0.0))
    if width is None and truth is not None:
        width = truth.shape[1]
    # Disparities beyond the image's width match nothing.
    first = max(min(math.floor(low), 0), -(width or 0))
    return bound - first, first


def _optional(read: Callable[[], Any]) -> Any:
    """The result of `read`, or None if its file is missing."""
    try:
        return read()
    except FileError:
        return None


def fingerprint(sample: Pair) -> str:
    """SHA-256 of everything a score depends on: images, truth, mask, search range, calibration and region maps."""
    search = {"ndisp": int(sample.ndisp)}
    if sample.min_disparity:
        search["min_disparity"] = sample.min_disparity
    digest = hashlib.sha256(f"{search} {sample.calibration}".encode())
    maps = sample.mask0_nonocc, sample.blur0, sample.material_kind0
    for array in (sample.im0, sample.im1, sample.disp0, *maps):
        if array is None:
            digest.update(b"none")
        else:
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


class DatasetPairs(Sequence[Pair]):
    """Every sample of the datasets (sequences of stored or other samples), once for each lens.

    A pair has its sample's name, or "name · lens" if the sample has several lenses, numbered if labels repeat.
    A name that several datasets have is preceded by the dataset's label: "label/name". The scene of a pair is the one
    that its sample records, or else the sample. Of several datasets, a pair records its own label as "dataset".
    search: as for `with_search`, of all pairs. Indexing reads a pair from disk; nothing is cached. Raises InputError if
    two pairs have the same name.
    """

    def __init__(
        self,
        *datasets: Sequence[StoredSample | ScoredSample],
        labels: Sequence[str] | None = None,
        search: Mapping[str, int | None] | None = None,
    ) -> None:
        self._search = dict(search or {})
        self._places: dict[
            str, tuple[StoredSample | ScoredSample, int, tuple[str, ...]]
        ] = {}
        self._sources: list[tuple[int, str]] = []
        self._labels: dict[str, str] = {}
        self._are_several = len(datasets) > 1
        named = [_named_pairs(samples) for samples in datasets]
        counts = Counter(name for pairs in named for _, _, name, _ in pairs)
        labels = labels or [""] * len(named)
        for source, (label, pairs) in enumerate(zip(labels, named, strict=True)):
            names = {name for _, _, name, _ in pairs}
            for sample, lens, name, aliases in pairs:
                prefix = f"{label}/" if label and counts[name] > 1 else ""
                if prefix + name in self._places:
                    raise InputError(
                        f"two samples are named {prefix + name!r}: run each dataset separately"
                    )
                free = tuple(prefix + alias for alias in aliases if alias not in names)
                self._places[prefix + name] = sample, lens, free
                self._sources.append((source, label))
                self._labels[prefix + name] = label
        self._pairs = list(self._places.items())

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, index: int) -> Pair: ...
    @overload
    def __getitem__(self, index: slice) -> list[Pair]: ...
    def __getitem__(self, index: int | slice) -> Pair | list[Pair]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        name, (sample, lens, aliases) = self._pairs[index]
        pair = with_search(load_pair(sample, lens), **self._search)
        scene = _scene_of(name, pair)
        recorded = {**pair.recorded, **self._label_of(name)}
        aliases = pair.aliases or aliases
        return replace(pair, name=name, aliases=aliases, scene=scene, recorded=recorded)

    def on(self, board: Board) -> Iterator[Pair]:
        """The pairs that the board scores. Raises InputError if a dataset has none, or if one has changed."""
        shared = [k for k, name in enumerate(self._places) if name in board.samples]
        scored_sources = {self._sources[k] for k in shared}
        unscored = sorted({*self._sources} - scored_sources)
        if unscored or not shared:
            label = unscored[0][1] if unscored else ""
            listed = ", ".join(board.samples[:3])
            raise InputError(
                f"{label or 'dataset'}: none of its samples is on the board, which has {listed}"
            )
        ranges = {
            entry.sample: (entry.ndisp, entry.min_disparity) for entry in board.entries
        }
        for pair in (self[k] for k in shared):
            # The board may have searched another range than that of the files.
            searched = with_search(pair, *ranges[pair.name])
            board.check_sample(pair.name, fingerprint(searched))
            yield searched

    def check_groups(self, name: str, board: Board | None = None) -> None:
        """Raise InputError unless the value `name` makes groups of these pairs, and of the samples of a board to which
        they are added; reads no image. See `groups_by`."""
        earlier = board or Board()
        recorded, scenes = dict(earlier.recorded), dict(earlier.scenes)
        for pair, (sample, lens, _) in self._places.items():
            recorded[pair] = {**_recorded(sample, lens), **self._label_of(pair)}
            scenes[pair] = _scene_of(pair, sample)
        groups_by(
            replace(earlier, recorded=recorded, scenes=scenes), name, self._places
        )

    def _label_of(self, pair: str) -> dict[str, Recorded]:
        """The label of a pair's dataset, if there are several datasets."""
        label = self._labels[pair]
        return {"dataset": label} if self._are_several and label else {}

    @property
    def aliases(self) -> dict[str, tuple[str, ...]]:
        """Pair name -> other names of its map in a submission, without extension. Reads no image."""
        return {name: aliases for name, (_, _, aliases) in self._places.items()}


def open_pairs(
    names: Iterable[str], search: Mapping[str, int | None] | None = None
) -> DatasetPairs:
    """The pairs of dataset folders, of KITTI's and ETH3D's downloads, and of "motorcycle" (from scikit-image).

    The last part of a folder's name is its label. search: num_disparities and min_disparity, as for `with_search`.
    """
    folders = list(names)
    return DatasetPairs(
        *map(_open, folders),
        labels=[str(name).rstrip("/").rpartition("/")[2] for name in folders],
        search=search,
    )


def _scene_of(name: str, sample: Any) -> str:
    """The scene that a sample records; of others the sample, by the name of its pair without the lens."""
    return str(getattr(sample, "scene", "")) or name.partition(LENS_SEPARATOR)[0]


def _open(name: str) -> Sequence[Any]:
    if name == "motorcycle" and not Path(name).exists():
        return [motorcycle()]
    if (downloaded := downloaded_pairs(name)) is not None:
        return downloaded
    export = place(name) / MIDDLEBURY_FOLDER
    return Dataset(export if export.is_dir() else name)


def _named_pairs(samples: Iterable[Any]) -> list[tuple[Any, int, str, tuple[str, ...]]]:
    """(sample, lens, name, aliases) of each pair."""
    pairs = []
    for sample in samples:
        for lens, (name, aliases) in enumerate(_names(sample)):
            pairs.append((sample, lens, name, aliases))
    return pairs


def _names(sample: Any) -> list[tuple[str, tuple[str, ...]]]:
    """Name and aliases of the pair of each lens: name/lens-k, name-lens-k, and for the first lens also name."""
    count = getattr(sample, "num_lenses", 1)
    if count == 1:
        return [(sample.name, ())]
    labels = [sample.lens(k).label for k in range(count)]
    names: list[tuple[str, tuple[str, ...]]] = []
    for k, label in enumerate(labels):
        number = f" ({k})" if labels.count(label) > 1 else ""
        aliases = [f"{sample.name}/lens-{k}", f"{sample.name}-lens-{k}"]
        if k == 0:
            aliases.append(sample.name)
        names.append((f"{sample.name}{LENS_SEPARATOR}{label}{number}", tuple(aliases)))
    return names
