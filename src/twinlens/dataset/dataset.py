"""A dataset: the samples of a folder, in order. Read by plain Python, numpy, or a torch DataLoader; needs no torch."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Generic, TypeVar, overload

from twinlens.dataset.files import is_hidden
from twinlens.dataset.items import check_name, read_all
from twinlens.dataset.manifest import NAME, Manifest, read_manifest
from twinlens.dataset.storage import Place, RemotePath, Where, is_whole, place
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.waiting import waiting_samples
from twinlens.errors import FileError, InputError, unknown

T = TypeVar("T")


class Dataset(Sequence[StoredSample]):
    """The samples below `path`: its dataset.json's, in that order, or else every folder with an im0.png, by name.

    So it opens what twinlens made and plain folders in Middlebury's layout alike, and the folder of a single sample.
    Indexing gives a `StoredSample`, a slice a Dataset, a name the sample of that name. Nothing is read until asked, and
    nothing is kept, so it may be pickled to worker processes: ``DataLoader(Dataset(path), num_workers=4)`` gives
    batches of name, im0, im1, disp0 and mask0_nonocc; `select` chooses others. An address such as ``s3://bucket/set``
    is read in place, through fsspec.

    Raises FileError when there is no such folder, or no sample in it.
    """

    def __init__(self, path: Where) -> None:
        self.path = place(path)
        if not self.path.is_dir():
            raise FileError(f"{self.path}: no such folder; a dataset is a folder of samples")
        listed = (self.path / NAME).is_file()
        self._samples = _listed(self.path) if listed else _found(self.path)
        if not self._samples and listed:
            raise FileError(_why_none(self.path))
        if not self._samples:
            raise FileError(f"{self.path}: holds no sample: no {NAME}, and no folder with an im0.png")

    def __len__(self) -> int:
        return len(self._samples)

    @overload
    def __getitem__(self, index: int | str) -> StoredSample: ...
    @overload
    def __getitem__(self, index: slice) -> "Dataset": ...
    def __getitem__(self, index: int | str | slice) -> "StoredSample | Dataset":
        if isinstance(index, str):
            return self._named(index)
        if isinstance(index, slice):
            return self._view(self._samples[index])
        return self._samples[index]

    def __iter__(self) -> Iterator[StoredSample]:
        return iter(self._samples)

    def __repr__(self) -> str:
        return f"Dataset({str(self.path)!r}, {len(self)} samples)"

    def __contains__(self, sample: object) -> bool:
        return sample in (self.names if isinstance(sample, str) else self._samples)

    @property
    def names(self) -> tuple[str, ...]:
        """The samples' names, in order."""
        return tuple(sample.name for sample in self._samples)

    @property
    def manifest(self) -> Manifest:
        """dataset.json, of the whole dataset also in a slice of it. Raises FileError where there is none."""
        return read_manifest(self.path)

    def split(self, name: str) -> "Dataset":
        """The samples whose row in dataset.json says that they belong to the split, or InputError when none does."""
        splits = [str(sample.row.get("info", {}).get("split") or "") for sample in self._samples]
        if not any(splits):
            raise InputError(f"{self.path}: has no splits, asked was {name!r}; a recipe's [splits] makes them")
        if name not in splits or not name:
            raise unknown("split", name, set(splits) - {""})
        return self._view(tuple(s for s, split in zip(self._samples, splits, strict=True) if split == name))

    def select(self, *names: str) -> "Mapped[dict[str, Any]]":
        """The dataset with a dict of the named quantities for each sample, read when it is asked for.

        ``Dataset(path).select("im0", "lens1.im0", "normal0", "K0")``; `twinlens.dataset.items` lists the names.
        Raises InputError for a name that is not known, with the nearest that is.
        """
        for name in names:
            check_name(name)
        return self.map(partial(read_all, names))

    def map(self, function: Callable[[StoredSample], T]) -> "Mapped[T]":
        """The dataset with `function` applied to each sample when it is asked for; it pickles if the function does."""
        return Mapped(self, function)

    def _named(self, name: str) -> StoredSample:
        for sample in self._samples:
            if sample.name == name:
                return sample
        raise unknown("sample", name, [sample.name for sample in self._samples])

    def _view(self, samples: tuple[StoredSample, ...]) -> "Dataset":
        view = object.__new__(Dataset)
        view.path, view._samples = self.path, samples
        return view


class Mapped(Sequence[T], Generic[T]):
    """A dataset and what is made of each sample. Pickles when the function does."""

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


def arrays(sample: StoredSample) -> dict[str, Any]:
    """name, im0, im1, disp0 and mask0_nonocc of a sample, all in memory."""
    return read_all(("name", "im0", "im1", "disp0", "mask0_nonocc"), sample)


def found_samples(path: Place) -> Dataset:
    """The dataset of the samples that lie below `path`, whatever its dataset.json says; it may be empty."""
    view = object.__new__(Dataset)
    view.path, view._samples = path, _found(path)
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


def _why_none(path: Place) -> str:
    """Why a dataset.json lists no sample: `twinlens generate` keeps what it could not make, and whether it goes on."""
    info = read_manifest(path).info
    failed = info.get("failed")
    if isinstance(failed, list) and failed:
        return f'{path / NAME}: lists no sample: {len(failed)} could not be made; "failed" in it says why'
    going_on = "lists those that are there and makes the rest" if waiting_samples(path, ()) else "makes them"
    more = f"; the `twinlens generate` that began it {going_on}" if info.get("complete") is False else ""
    return f"{path / NAME}: lists no sample{more}"


def _listed(path: Place) -> tuple[StoredSample, ...]:
    rows = read_manifest(path).rows
    return tuple(StoredSample(path / row.name, row.name, {"files": row.files, "info": row.info}) for row in rows)


def _found(path: Place) -> tuple[StoredSample, ...]:
    if (path / "im0.png").is_file():
        return (StoredSample(path, path.resolve().name),)
    folders = sorted((entry for entry in path.iterdir() if not is_hidden(entry.name)), key=str)
    folders = [folder for folder in folders if (folder / "im0.png").is_file()]
    if isinstance(path, RemotePath):  # where some have twinlens's mark, those without it are not whole
        folders = [folder for folder in folders if is_whole(folder)] or folders
    return tuple(StoredSample(folder, folder.name) for folder in folders)
