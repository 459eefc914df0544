"""Datasets in the layouts that other people's readers open: one module a layout, all in `LAYOUTS`.

A layout is a function from samples to (relative name, content) pairs; nothing is assumed of the samples but what they
say themselves, and what a layout cannot hold (a disparity beyond its range, a missing view) is an error that names the
sample. docs/format.md tells what each one keeps.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence

from twinlens.dataset.export.eth3d import eth3d
from twinlens.dataset.export.kitti import kitti2015
from twinlens.dataset.export.middlebury import carla, middlebury
from twinlens.dataset.export.parquet import parquet
from twinlens.dataset.export.sceneflow import sceneflow
from twinlens.dataset.export.sintel import sintel
from twinlens.dataset.export.source import Source
from twinlens.dataset.export.webdataset import webdataset
from twinlens.dataset.files import fill_folder
from twinlens.dataset.stored import StoredSample
from twinlens.errors import InputError, unknown

Layout = Callable[[Iterable[Source]], Iterator[tuple[str, bytes]]]

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

__all__ = ["LAYOUTS", "Layout", "Source", "export"]


def export(dataset: Sequence[StoredSample], folder: str | os.PathLike[str], to: str, lens: int = 0) -> list[str]:
    """Write the samples as `folder` in the layout `to` (a name of LAYOUTS); the names of the files written.

    `lens` chooses the images of samples photographed through several. The folder appears whole or not at all, and must
    not be there already. Raises InputError for an unknown layout or a sample that it cannot hold, FileError for a file
    that a sample lacks, OutputError.
    """
    if to not in LAYOUTS:
        raise unknown("layout", to, LAYOUTS)
    if not len(dataset):
        raise InputError("export needs one sample or more")
    sources = (Source(sample, i, lens) for i, sample in enumerate(dataset))
    return fill_folder(folder, LAYOUTS[to](sources))
