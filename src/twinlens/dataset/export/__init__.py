"""Export of datasets to the layouts of other readers, all in the dict `LAYOUTS`.

What a layout cannot hold, such as a disparity beyond its range or a missing view, is an error that names the sample.
docs/format.md lists what each layout keeps.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import twinlens
from twinlens.dataset.export.archives import parquet, webdataset
from twinlens.dataset.export.layouts import Files, Source, carla, eth3d, kitti2015, middlebury, sceneflow, sintel
from twinlens.dataset.files import fill_folder, read_bytes
from twinlens.dataset.manifest import NAME as MANIFEST
from twinlens.dataset.storage import Place, RemotePath, Where, place
from twinlens.dataset.stored import StoredSample
from twinlens.errors import InputError, OutputError, unknown

__all__ = ["LAYOUTS", "NOTE", "Layout", "Source", "export"]

Layout = Callable[[Iterable[Source]], Files]


def _folders(layout: Callable[[Source], Files]) -> Layout:
    """A layout whose files each belong to one sample."""
    return lambda sources: (file for source in sources for file in layout(source))


LAYOUTS: dict[str, Layout] = {
    "carla": _folders(carla),
    "eth3d": _folders(eth3d),
    "kitti2015": _folders(kitti2015),
    "middlebury": _folders(middlebury),
    "parquet": parquet,
    "sceneflow": _folders(sceneflow),
    "sintel": _folders(sintel),
    "webdataset": webdataset,
}
"""From samples to (relative name, content) of every file."""

NOTE = "EXPORT.md"
_FIRST_LINE = "# Exported by twinlens"


def export(
    dataset: Sequence[StoredSample],
    folder: Where,
    to: str,
    lens: int = 0,
    overwrite: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> dict[str, int]:
    """Write samples to `folder` in the layout `to`, a key of LAYOUTS.

    The folder appears whole or not at all; it must not exist, unless `overwrite` is set and it is an earlier export or
    empty. EXPORT.md in it lists the samples in order. `lens` selects the images of samples taken through several
    lenses. `progress` is called with the fraction done and the sample's name.

    Returns the size in bytes of each file by relative name. Raises InputError for an unknown layout and for a sample
    that the layout cannot hold, FileError for a file that a sample lacks, and OutputError.
    """
    if to not in LAYOUTS:
        raise unknown("layout", to, LAYOUTS)
    if not len(dataset):
        raise InputError("export needs one or more samples")
    _check_folder(place(folder), dataset, overwrite)
    sizes: dict[str, int] = {}

    def sources() -> Iterator[Source]:
        for i, sample in enumerate(dataset):
            if progress is not None:
                progress(i / len(dataset), sample.name)
            if sample.has("sample.json") and not sample.has("calib.txt"):
                raise InputError(f"{sample.name}: is not a rectified pair, as every export layout requires")
            yield Source(sample, i, lens)

    def files() -> Files:
        names = "".join(f"{i}. {sample.name}\n" for i, sample in enumerate(dataset))
        note = f"{_FIRST_LINE} {twinlens.__version__}\n\nLayout: `{to}`. Samples, in order:\n\n{names}".encode()
        for name, data in itertools.chain(LAYOUTS[to](sources()), [(NOTE, note)]):
            sizes[name] = len(data)
            yield name, data

    fill_folder(folder, files(), overwrite)
    return sizes


def _check_folder(folder: Place, dataset: Sequence[StoredSample], overwrite: bool) -> None:
    """Reject a folder inside the dataset, where the export would be found as more samples.

    Reject overwriting, which removes, a folder that is not an export: a home folder, a dataset.
    """
    if not isinstance(folder, RemotePath):
        around = (folder.absolute(), *folder.absolute().parents)
        for sample in dataset:
            home = Path(str(sample.folder)).absolute()
            if home in around or (home.parent in around and (home.parent / MANIFEST).is_file()):
                raise OutputError(f"{folder}: is inside the dataset to export; choose a folder outside of it")
    if not overwrite or not folder.exists():
        return
    is_export = (folder / NOTE).is_file() and read_bytes(folder / NOTE).startswith(_FIRST_LINE.encode())
    if not is_export and (isinstance(folder, RemotePath) or not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(
            f"{folder}: exists and is not an earlier export, so it is not overwritten; choose another name"
        )
