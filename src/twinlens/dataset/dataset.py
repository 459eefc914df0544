"""A dataset: the samples of a folder, in order. Plain Python, numpy or torch read it; torch is optional."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Generic, TypeVar, overload

from twinlens.dataset.manifest import NAME, Manifest, Row, pending_rows, read_manifest
from twinlens.dataset.storage import Place, RemotePath, Where, is_whole, place
from twinlens.dataset.stored import StoredSample, parse_quantity, read_quantities
from twinlens.errors import FileError, InputError, unknown

T = TypeVar("T")


class SampleIndexError(InputError, IndexError):
    """An index beyond the samples of a dataset. It is an IndexError so that iteration by index ends."""


class Dataset(Sequence[StoredSample]):
    """The samples of a folder: those of its dataset.json, in order, or else every subfolder with an im0.png, by name.

    It opens datasets of twinlens, plain folders in Middlebury's layout, and the folder of a single sample. Indexing by
    number or name gives a `StoredSample`, a slice gives a Dataset. Files are read on access and not cached, so a
    Dataset can be pickled to worker processes: ``DataLoader(Dataset(path), num_workers=4)`` gives batches of name, im0,
    im1, disp0 and mask0_nonocc; `select` chooses other quantities.

    `path` is a folder, or an fsspec address such as ``s3://bucket/set``. Raises FileError if it does not exist or has
    no sample.
    """

    def __init__(self, path: Where) -> None:
        self.path = place(path)
        if not self.path.is_dir():
            raise FileError(f"{self.path}: no such folder; a dataset is a folder of samples")
        if (self.path / NAME).is_file():
            manifest = read_manifest(self.path)
            self._samples = tuple(stored(self.path, row) for row in manifest.rows)
            if not self._samples:
                raise FileError(f"{self.path / NAME}: lists no sample{_why_empty(self.path, manifest.info)}")
            return
        self._samples = found_samples(self.path)
        if not self._samples:
            raise FileError(f"{self.path}: has no sample: no {NAME}, and no folder with an im0.png")

    def __len__(self) -> int:
        return len(self._samples)

    @overload
    def __getitem__(self, index: int | str) -> StoredSample: ...
    @overload
    def __getitem__(self, index: slice) -> "Dataset": ...
    def __getitem__(self, index: int | str | slice) -> "StoredSample | Dataset":
        if isinstance(index, str):
            if index not in self.names:
                raise unknown("sample", index, self.names)
            return self._samples[self.names.index(index)]
        if isinstance(index, slice):
            return _view(self.path, self._samples[index])
        try:
            return self._samples[index]
        except IndexError:
            raise SampleIndexError(f"{self.path}: has {len(self)} samples, no sample {index}") from None

    def __repr__(self) -> str:
        return f"Dataset({str(self.path)!r}, {len(self)} samples)"

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
        splits = [str(sample.row.get("info", {}).get("split") or "") for sample in self._samples]
        if not any(splits):
            raise InputError(f"{self.path}: has no splits, so no split {name!r}; [splits] in a recipe defines them")
        if name not in splits or not name:
            raise unknown("split", name, set(splits) - {""})
        return _view(self.path, tuple(s for s, split in zip(self._samples, splits, strict=True) if split == name))

    def select(self, *names: str) -> "Mapped[dict[str, Any]]":
        """The dataset as dicts of the named quantities, read on access; docs/loading.md lists the names.

        ``Dataset(path).select("im0", "lens1.im0", "normal0", "K0")``. Raises InputError for an unknown name.
        """
        for name in names:
            parse_quantity(name)
        return self.map(partial(read_quantities, names))

    def map(self, function: Callable[[StoredSample], T]) -> "Mapped[T]":
        """The dataset with `function` applied to each sample on access; it can be pickled if the function can."""
        return Mapped(self, function)


class Mapped(Sequence[T], Generic[T]):
    """A dataset with a function applied to each sample on access."""

    def __init__(self, dataset: Dataset, function: Callable[[StoredSample], T]) -> None:
        self.dataset, self.function = dataset, function

    def __len__(self) -> int:
        return len(self.dataset)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> "Mapped[T]": ...
    def __getitem__(self, index: int | slice) -> "T | Mapped[T]":
        if isinstance(index, slice):
            return Mapped(self.dataset[index], self.function)
        return self.function(self.dataset[index])


def stored(folder: Place, row: Row, listed_in: str = NAME) -> StoredSample:
    """The sample of a row, and the file that lists it."""
    return StoredSample(folder / row.name, row.name, {"files": row.files, "info": row.info, "listed_in": listed_in})


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
        raise InputError(f"{path}: is a dataset of {len(dataset)} samples; name one of them, such as {example}")
    return dataset[0]


def _why_empty(path: Place, info: Mapping[str, Any]) -> str:
    """Why a dataset.json lists no sample, from what `twinlens generate` writes in it."""
    failed = info.get("failed")
    if isinstance(failed, list) and failed:
        return f'; {len(failed)} samples failed ("failed" in it says why)'
    if info.get("complete") is False:
        action = "list the finished samples and make the others" if pending_rows(path, ())[0] else "make them"
        return f"; rerun `twinlens generate` to {action}"
    return ""


def found_samples(path: Place) -> tuple[StoredSample, ...]:
    """The samples in the subfolders of `path`, or at `path` itself, whatever its dataset.json lists."""
    if (path / "im0.png").is_file():
        return (StoredSample(path, path.resolve().name),)
    folders = sorted((entry for entry in path.iterdir() if not entry.name.startswith(".")), key=str)
    folders = [folder for folder in folders if (folder / "im0.png").is_file()]
    if isinstance(path, RemotePath):  # among samples of twinlens, those without a mark are incomplete
        folders = [folder for folder in folders if is_whole(folder)] or folders
    return tuple(StoredSample(folder, folder.name) for folder in folders)
