"""A dataset: dataset.json, and the samples of a folder, in order. Torch is optional.

dataset.json has how the dataset was made, and the SHA-256 of every file in it. `twinlens generate` writes the row of a
sample to DIR/.rows/NAME.json as soon as its folder appears, and moves the rows to dataset.json later. Until then the
samples are pending, as those of parallel shards and of interrupted runs are.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar, overload

import numpy as np
import pydantic
from numpy.typing import NDArray

import twinlens
from twinlens.dataset.channels import IMAGE
from twinlens.dataset.files import (
    check_relative,
    files_below,
    hash_files,
    read_bytes,
    write_file,
)
from twinlens.dataset.record import (
    FileModel,
    decode_json,
    encode_json,
    read,
    read_json,
    read_part,
)
from twinlens.dataset.storage import Place, Where, is_whole, place
from twinlens.dataset.stored import (
    StoredSample,
    image_of_another_format,
    parse_quantity,
    read_quantities,
    samples_in,
)
from twinlens.errors import (
    FileError,
    InputError,
    check_known,
    counted,
    file_hint,
    format_value,
    unknown,
)

MANIFEST, _KIND, _VERSION = "dataset.json", "twinlens-dataset", 1
ROW_KIND, ROW_VERSION, ROWS = "twinlens-row", 1, ".rows"

T = TypeVar("T")
U = TypeVar("U")
Chosen = slice | list[int] | list[str] | NDArray[Any]
RelativeName = Annotated[str, pydantic.AfterValidator(check_relative)]


@dataclass(frozen=True)
class Row:
    """One sample: its folder (with / if nested), its files, and plain data, such as the split."""

    __pydantic_config__ = pydantic.ConfigDict(strict=False)  # so that a mapping is read

    name: RelativeName
    files: Mapping[
        RelativeName, Annotated[str, pydantic.Field(description="SHA-256, hexadecimal")]
    ]
    info: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Manifest:
    """The content of a dataset.json: rows in order, recipe, seed, and plain data (versions, counts)."""

    rows: Sequence[Row]
    recipe: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    info: Mapping[str, Any] = field(default_factory=dict)


class DatasetFile(FileModel):
    """dataset.json."""

    format: Literal["twinlens-dataset"]
    version: Literal[1]
    twinlens: str = pydantic.Field(
        default="", description="version that wrote the file"
    )
    seed: int | None = None
    recipe: dict[str, Any]
    info: dict[str, Any]
    samples: list[Row]

    @pydantic.field_validator("samples")
    @classmethod
    def _check_unique(cls, samples: list[Row]) -> list[Row]:
        for name, count in Counter(row.name for row in samples).items():
            if count > 1:
                raise InputError(f"lists the sample {name!r} twice")
        return samples


_ROW = pydantic.TypeAdapter(Row)


def write_manifest(folder: Where, manifest: Manifest) -> None:
    """Write `folder`/dataset.json atomically. The same manifest gives the same bytes. Raises OutputError."""
    record = {
        "format": _KIND,
        "version": _VERSION,
        "twinlens": twinlens.__version__,
        "seed": manifest.seed,
        "recipe": manifest.recipe,
        "info": manifest.info,
        "samples": [
            {"name": row.name, "files": row.files, "info": row.info}
            for row in manifest.rows
        ],
    }
    write_file(place(folder) / MANIFEST, encode_json(record))


def read_manifest(folder: Where) -> Manifest:
    """Read `folder`/dataset.json. Raises FileError: file, key, what is allowed."""
    path = place(folder) / MANIFEST
    file = read(DatasetFile, read_json(path, _KIND, _VERSION), path)
    return Manifest(tuple(file.samples), file.recipe, file.seed, file.info)


def row_of(dataset: Where, name: str, info: Mapping[str, Any] | None = None) -> Row:
    """The row of the sample `dataset`/`name`, with its files hashed now. Raises FileError."""
    return Row(name, hash_files(place(dataset) / name), info or {})


def pending_rows(
    folder: Place, listed: Collection[str]
) -> tuple[dict[str, Row | None], dict[str, str]]:
    """The rows of the pending samples by name, None for an unreadable row; and the errors of unreadable rows by name.

    `listed` are the names in dataset.json.
    """
    rows: dict[str, Row | None] = {}
    errors: dict[str, str] = {}
    files = files_below(folder / ROWS) if (folder / ROWS).is_dir() else []
    for file in files:
        if "/" in file or not file.endswith(".json"):
            continue
        name = file.removesuffix(".json")
        path = f"{ROWS}/{name}.json"
        try:
            if name in listed or not is_whole(folder / check_relative(name)):
                continue  # a sample that failed has a row too, and no folder
            rows[name] = None
            record = decode_json(read_bytes(folder / path), path, ROW_KIND, ROW_VERSION)
            rows[name] = replace(read_part(_ROW, record, "row", path), name=name)
        except FileError as error:
            # Unless it has been moved to dataset.json meanwhile.
            if (folder / path).exists():
                message = str(error).removeprefix(f"{folder}/")
                errors[name] = (
                    f"{message}; the next `twinlens generate` makes it again, from the sample's files"
                )
        except InputError as error:
            errors[name] = f"{path}: {error}"
    return rows, errors


class SampleIndexError(InputError, IndexError):
    """An index beyond the samples of a dataset. It is an IndexError so that iteration by index ends."""


class Dataset(Sequence[StoredSample]):
    """The samples of a folder: those of its dataset.json, in order, or else every subfolder with an im0.png, by name.

    It opens datasets of twinlens, plain folders in Middlebury's layout, and the folder of a single sample. Indexing by
    number or name gives a `StoredSample`; a slice, or an array of numbers or names, gives a Dataset. Files are read on
    access and not cached, so a Dataset can be pickled to worker processes: ``DataLoader(Dataset(path), num_workers=4)``
    gives batches of name, im0, im1, disp0 and mask0_nonocc; `select` chooses other quantities.

    `path` is a folder, or an fsspec address such as ``s3://bucket/set``. Raises FileError if it does not exist or has
    no sample.
    """

    def __init__(self, path: Where) -> None:
        self.path = place(path)
        if not self.path.is_dir():
            is_missing = not self.path.exists()
            problem = "no such folder" if is_missing else "not a folder"
            hint = file_hint(self.path) if is_missing else ""
            raise FileError(
                f"{self.path}: {problem}; a dataset is a folder of samples{hint}"
            )
        if (self.path / MANIFEST).is_file():
            manifest = read_manifest(self.path)
            self._samples = tuple(stored(self.path, row) for row in manifest.rows)
            if not self._samples:
                raise FileError(
                    f"{self.path / MANIFEST}: lists no sample{_why_empty(self.path, manifest.info)}"
                )
            return
        self._samples = samples_in(self.path)
        if not self._samples:
            _check_format(self.path)
            problem = f"has no sample: no {MANIFEST}, and no folder with an im0.png (left; im1.png is the right image)"
            raise FileError(f"{self.path}: {problem}{_datasets_below(self.path)}")

    def __len__(self) -> int:
        return len(self._samples)

    @overload
    def __getitem__(self, index: int | str) -> StoredSample: ...
    @overload
    def __getitem__(self, index: Chosen) -> "Dataset": ...
    def __getitem__(self, index: int | str | Chosen) -> "StoredSample | Dataset":
        if isinstance(index, slice):
            return _view(self.path, self._samples[index])
        if not isinstance(index, (int, str, np.integer)):
            return _view(self.path, self._chosen(index))
        if isinstance(index, str):
            check_known("sample", index, self.names)
            index = self.names.index(index)
        try:
            return self._samples[index]
        except IndexError:
            raise SampleIndexError(
                f"{self.path}: has {counted(len(self), 'sample')}, no sample {index}"
            ) from None

    def __getitems__(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """The samples of a batch as dicts. DataLoader of torch calls this; each file is then read once."""
        return [dict(self[index]) for index in indices]

    def _chosen(
        self, index: list[int] | list[str] | NDArray[Any]
    ) -> tuple[StoredSample, ...]:
        """The samples at numbers or names or of a mask, as NumPy indexes an array."""
        picked = np.asarray(index)
        if picked.ndim != 1:
            raise SampleIndexError(
                f"{self.path}: an index is a number, a name, a slice or a 1-D array of these"
            )
        if picked.size and picked.dtype.kind == "U":
            numbers = {name: i for i, name in enumerate(self.names)}
            for name in picked.tolist():
                check_known("sample", name, numbers)
            picked = np.array([numbers[name] for name in picked.tolist()])
        try:
            chosen = np.arange(len(self))[picked if picked.size else []]
        except IndexError as error:
            raise SampleIndexError(
                f"{self.path}: has {counted(len(self), 'sample')}; {error}"
            ) from None
        return tuple(self._samples[i] for i in chosen.tolist())

    def __repr__(self) -> str:
        return f"Dataset({str(self.path)!r}, {counted(len(self), 'sample')})"

    def __contains__(self, sample: object) -> bool:
        return sample in (self.names if isinstance(sample, str) else self._samples)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the samples, in order."""
        return tuple(sample.name for sample in self._samples)

    @property
    def manifest(self) -> Manifest:
        """dataset.json of the whole dataset, also for a slice. Raises FileError if there is none."""
        return read_manifest(self.path)

    def split(self, name: str) -> "Dataset":
        """The samples whose row in dataset.json names the split. Raises InputError if there are none."""
        splits = [
            str(sample.row.get("info", {}).get("split") or "")
            for sample in self._samples
        ]
        if not any(splits):
            raise InputError(
                f"{self.path}: has no splits, so no split {name!r}; [splits] in a recipe defines them"
            )
        if name not in splits or not name:
            raise unknown("split", name, set(splits) - {""})
        pairs = zip(self._samples, splits, strict=True)
        return _view(
            self.path, tuple(sample for sample, split in pairs if split == name)
        )

    def select(self, *names: str) -> "Mapped[dict[str, Any]]":
        """The dataset as dicts of the named quantities, read on access; docs/loading.md lists the names.

        ``Dataset(path).select("im0", "lens1.im0", "normal0", "K0")``. Raises InputError for an unknown name, and
        without names.
        """
        if not names:
            raise InputError(
                'select needs the names of quantities, such as select("im0", "disp0")'
            )
        for name in names:
            parse_quantity(name)
        return self.map(partial(read_quantities, names))

    def map(self, function: Callable[[StoredSample], T]) -> "Mapped[T]":
        """The dataset with `function` applied to each sample on access; it can be pickled if the function can."""
        return Mapped(self, function)


class Mapped(Sequence[T], Generic[T]):
    """A dataset with a function applied to each sample on access. A slice or an array of indices gives a Mapped."""

    def __init__(
        self, dataset: "Dataset | Mapped[Any]", function: Callable[[Any], T]
    ) -> None:
        if not callable(function):
            raise InputError(
                f"map needs a function of a sample, got {format_value(function)}"
            )
        self.dataset, self.function = dataset, function

    def __len__(self) -> int:
        return len(self.dataset)

    @overload
    def __getitem__(self, index: int | str) -> T: ...
    @overload
    def __getitem__(self, index: Chosen) -> "Mapped[T]": ...
    def __getitem__(self, index: int | str | Chosen) -> "T | Mapped[T]":
        if isinstance(index, (int, str, np.integer)):
            return self.function(self.dataset[index])
        return Mapped(self.dataset[index], self.function)

    def map(self, function: Callable[[T], U]) -> "Mapped[U]":
        """`function` applied to each item on access, after the functions before it."""
        return Mapped(self, function)


def stored(folder: Place, row: Row, listed_in: str = MANIFEST) -> StoredSample:
    """The sample of a row, and the file that lists it."""
    return StoredSample(
        folder / row.name,
        row.name,
        {"files": row.files, "info": row.info, "listed_in": listed_in},
    )


def _view(path: Place, samples: tuple[StoredSample, ...]) -> Dataset:
    view = object.__new__(Dataset)
    view.path, view._samples = path, samples
    return view


def open_sample(path: Where) -> StoredSample:
    """The sample at `path`: a sample's folder, DATASET/SAMPLE, or a dataset of one sample.

    Raises InputError for a dataset of several samples, FileError for anything else.
    """
    dataset = Dataset(path)
    if len(dataset) > 1:
        example = dataset.path / dataset[0].name
        raise InputError(
            f"{path}: is a dataset of {counted(len(dataset), 'sample')}; name one of them, such as {example}"
        )
    return dataset[0]


def _check_format(path: Place) -> None:
    """Raise FileError for a folder whose images are of another format; not for a bucket, where a search is slow."""
    image = image_of_another_format(path) if isinstance(path, Path) else None
    if image is None:
        return
    if image.suffix.lower() == ".png":
        remedy = f"rename it to {IMAGE.name(0)}"
    else:
        remedy = f"convert it, such as by `magick {image.name} {IMAGE.name(0)}`"
    raise FileError(
        f"{image}: the images of a pair must be {IMAGE.name(0)} and {IMAGE.name(1)}; {remedy}"
    )


def _datasets_below(path: Place) -> str:
    """Which folders one or two levels below have samples; empty for a bucket, where a search is slow."""
    if not isinstance(path, Path):
        return ""
    image = IMAGE.name(0)
    images = (*path.glob(f"*/*/{image}"), *path.glob(f"*/*/*/{image}"))
    folders = sorted({file.parent.parent for file in images})
    # A folder with an image is a sample, and its subfolders are lenses.
    names = [str(folder) for folder in folders if not (folder / image).exists()]
    return f"; these have: {', '.join(names[:3])}" if names else ""


def _why_empty(path: Place, info: Mapping[str, Any]) -> str:
    """Why a dataset.json lists no sample, from what `twinlens generate` writes in it."""
    failed = info.get("failed")
    if isinstance(failed, list) and failed:
        return f'; {counted(len(failed), "sample")} failed ("failed" in it says why)'
    if info.get("complete") is False and "subset" in info:
        return "; rerun the same `twinlens subset` to finish it"
    if info.get("complete") is False:
        action = (
            "list the finished samples and make the others"
            if pending_rows(path, ())[0]
            else "make them"
        )
        return f"; rerun `twinlens generate` to {action}"
    return ""
