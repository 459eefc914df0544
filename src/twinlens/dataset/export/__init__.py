"""Export of datasets to the layouts of other readers, all in the dict `LAYOUTS`.

A layout is a function from samples to (relative name, content) pairs. What a layout cannot hold, such as a disparity
beyond its range or a missing view, is an error that names the sample. docs/format.md lists what each layout keeps.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import twinlens
from twinlens.dataset.export.archives import parquet, webdataset
from twinlens.dataset.export.layouts import carla, eth3d, kitti2015, middlebury, sceneflow, sintel
from twinlens.dataset.export.source import Source
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
    """Write samples to `folder` in the layout `to`, a key of LAYOUTS.

    The folder appears whole or not at all. EXPORT.md in it lists the samples in order.

    Parameters
    ----------
    dataset : sequence of StoredSample
    folder : str or path
        Must not exist, unless `overwrite` is set and it is an earlier export or empty.
    to : str
    lens : int
        Which images to export of samples taken through several lenses.
    overwrite : bool
    progress : callable or None
        Called with the fraction done and the sample's name.

    Returns
    -------
    dict
        Relative name -> size in bytes.

    Raises
    ------
    InputError
        For an unknown layout, or a sample that the layout cannot hold.
    FileError
        For a file that a sample lacks.
    OutputError
    """
    if to not in LAYOUTS:
        raise unknown("layout", to, LAYOUTS)
    if not len(dataset):
        raise InputError("export needs one or more samples")
    _check_outside(place(folder), dataset)
    if overwrite:
        _check_replaceable(place(folder))
    sizes: dict[str, int] = {}

    def files() -> Iterator[tuple[str, bytes]]:
        for name, data in _files(dataset, to, lens, progress):
            sizes[name] = len(data)
            yield name, data

    fill_folder(folder, files(), overwrite)
    return sizes


def _files(
    dataset: Sequence[StoredSample], to: str, lens: int, progress: Progress | None
) -> Iterator[tuple[str, bytes]]:
    def sources() -> Iterator[Source]:
        for i, sample in enumerate(dataset):
            if progress is not None:
                progress(i / len(dataset), sample.name)
            source = Source(sample, i, lens)
            source.check()
            yield source

    yield from LAYOUTS[to](sources())
    names = "".join(f"{i}. {sample.name}\n" for i, sample in enumerate(dataset))
    yield NOTE, f"{_FIRST_LINE} {twinlens.__version__}\n\nLayout: `{to}`. Samples, in order:\n\n{names}".encode()


def _check_outside(folder: Place, dataset: Sequence[StoredSample]) -> None:
    """Reject a folder inside the dataset, where the export would be found as more samples."""
    if isinstance(folder, RemotePath):
        return
    around = (folder.absolute(), *folder.absolute().parents)
    for sample in dataset:
        home = Path(str(sample.folder)).absolute()
        if home in around or (home.parent in around and (home.parent / MANIFEST).is_file()):
            raise OutputError(f"{folder}: is inside the dataset to export; choose a folder outside of it")


def _check_replaceable(folder: Place) -> None:
    """Reject overwriting, which removes, a folder that is not an export: a home folder, a dataset."""
    if not folder.exists():
        return
    if (folder / NOTE).is_file() and read_bytes(folder / NOTE).startswith(_FIRST_LINE.encode()):
        return
    if isinstance(folder, RemotePath) or not folder.is_dir() or any(folder.iterdir()):
        raise OutputError(
            f"{folder}: exists and is not an earlier export, so it is not overwritten; choose another name"
        )
