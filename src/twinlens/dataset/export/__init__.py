"""Datasets in the layouts that other people's readers open: one module a layout, all in `LAYOUTS`.

A layout is a function from samples to (relative name, content) pairs; nothing is assumed of the samples but what they
say themselves, and what a layout cannot hold (a disparity beyond its range, a missing view) is an error that names the
sample. docs/format.md tells what each one keeps.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import twinlens
from twinlens.dataset.export.eth3d import eth3d
from twinlens.dataset.export.kitti import kitti2015
from twinlens.dataset.export.middlebury import carla, middlebury
from twinlens.dataset.export.parquet import parquet
from twinlens.dataset.export.sceneflow import sceneflow
from twinlens.dataset.export.sintel import sintel
from twinlens.dataset.export.source import Source
from twinlens.dataset.export.webdataset import webdataset
from twinlens.dataset.files import fill_folder, read_bytes
from twinlens.dataset.manifest import NAME as MANIFEST
from twinlens.dataset.storage import Place, RemotePath, Where, place
from twinlens.dataset.stored import StoredSample
from twinlens.errors import InputError, OutputError, unknown

Layout = Callable[[Iterable[Source]], Iterator[tuple[str, bytes]]]
Progress = Callable[[float, str], None]

LAYOUTS: dict[str, Layout] = {
    "carla": carla,
    "eth3d": eth3d,
    "kitti2015": kitti2015,
    "middlebury": middlebury,
    "parquet": parquet,
    "sceneflow": sceneflow,
    "sintel": sintel,
    "webdataset": webdataset,
}

NOTE = "EXPORT.md"
_FIRST_LINE = "# Exported by twinlens"

__all__ = ["LAYOUTS", "NOTE", "Layout", "Source", "export"]


def export(
    dataset: Sequence[StoredSample],
    folder: Where,
    to: str,
    lens: int = 0,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, int]:
    """Write the samples as `folder` in the layout `to` (a name of LAYOUTS); relative name -> size in bytes.

    `lens` chooses the images of samples photographed through several. The folder appears whole or not at all; one that
    is there already is refused unless `overwrite` is said and it is an earlier export. EXPORT.md in it names the
    samples in their order. `progress` hears the fraction done and the sample's name. Raises InputError for an unknown
    layout or a sample that it cannot hold, FileError for a file that a sample lacks, OutputError.
    """
    if to not in LAYOUTS:
        raise unknown("layout", to, LAYOUTS)
    if not len(dataset):
        raise InputError("export needs one sample or more")
    _check_outside(place(folder), dataset)
    if overwrite:
        _check_replaceable(place(folder))
    sizes: dict[str, int] = {}
    fill_folder(folder, _measured(_files(dataset, to, lens, progress), sizes), overwrite)
    return sizes


def _files(
    dataset: Sequence[StoredSample], to: str, lens: int, progress: Progress | None
) -> Iterator[tuple[str, bytes]]:
    names: list[str] = []

    def sources() -> Iterator[Source]:
        for i, sample in enumerate(dataset):
            if progress is not None:
                progress(i / len(dataset), sample.name)
            names.append(sample.name)
            source = Source(sample, i, lens)
            source.check()
            yield source

    yield from LAYOUTS[to](sources())
    lines = "".join(f"{i}. {name}\n" for i, name in enumerate(names))
    head = f"{_FIRST_LINE} {twinlens.__version__}\n\nIn the layout `{to}`; the samples, in order:\n\n"
    yield NOTE, (head + lines).encode()


def _measured(files: Iterator[tuple[str, bytes]], sizes: dict[str, int]) -> Iterator[tuple[str, bytes]]:
    for name, data in files:
        sizes[name] = len(data)
        yield name, data


def _check_outside(folder: Place, dataset: Sequence[StoredSample]) -> None:
    """An export inside the dataset would be taken for more of its samples."""
    if isinstance(folder, RemotePath):
        return
    around = (folder.absolute(), *folder.absolute().parents)
    for sample in dataset:
        home = Path(str(sample.folder)).absolute()
        if home in around or (home.parent in around and (home.parent / MANIFEST).is_file()):
            raise OutputError(f"{folder}: lies inside the dataset that is exported; choose a folder beside it")


def _check_replaceable(folder: Place) -> None:
    """Refuse to overwrite, which removes, what is no export: a home folder, a dataset."""
    if not folder.exists():
        return
    if (folder / NOTE).is_file() and read_bytes(folder / NOTE).startswith(_FIRST_LINE.encode()):
        return
    if isinstance(folder, RemotePath) or not folder.is_dir() or any(folder.iterdir()):
        raise OutputError(f"{folder}: is there and is no earlier export, so it is not overwritten; choose another name")
