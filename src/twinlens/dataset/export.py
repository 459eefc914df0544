"""Export of datasets to the layouts of other readers: the table `LAYOUTS`, and `export`.

docs/format.md lists what each layout keeps.
"""

import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import twinlens
from twinlens.dataset import (
    aperture_layouts,
    layouts,
    multiview_layouts,
    object_layouts,
    ros_layout,
)
from twinlens.dataset.dataset import MANIFEST, Dataset
from twinlens.dataset.files import (
    check_replaceable,
    read_bytes,
    remove_abandoned,
    write_folder,
)
from twinlens.dataset.layouts import Files, Source
from twinlens.dataset.metadata import about
from twinlens.dataset.storage import Place, RemotePath, Where, place
from twinlens.dataset.stored import StoredSample
from twinlens.errors import InputError, OutputError, check_known, unknown

NOTE = "EXPORT.md"
_FIRST_LINE = "# Exported by twinlens"


@dataclass(frozen=True)
class Layout:
    """A layout that other programs read.

    files : from samples to (relative name, content) of every file.
    needs_pair : whether it holds the disparity of a rectified pair.
    has_objects : whether it holds masks of objects.
    """

    files: Callable[[Iterable[Source]], Files]
    needs_pair: bool = True
    has_objects: bool = False


def _each(layout: Callable[[Source], Files]) -> Callable[[Iterable[Source]], Files]:
    """A layout of many samples whose files are those of each sample."""
    return lambda sources: itertools.chain.from_iterable(map(layout, sources))


LAYOUTS: dict[str, Layout] = {
    "bop": Layout(object_layouts.bop, needs_pair=False, has_objects=True),
    "carla": Layout(_each(layouts.carla)),
    "coco": Layout(object_layouts.coco, needs_pair=False, has_objects=True),
    "colmap": Layout(_each(multiview_layouts.colmap), needs_pair=False),
    "dpdd": Layout(_each(aperture_layouts.dpdd), needs_pair=False),
    "eslf": Layout(_each(aperture_layouts.eslf), needs_pair=False),
    "eth3d": Layout(_each(layouts.eth3d)),
    "exr": Layout(_each(layouts.exr), needs_pair=False),
    "fod500": Layout(aperture_layouts.fod500, needs_pair=False),
    "hci4d": Layout(_each(aperture_layouts.hci4d), needs_pair=False),
    "kitti2015": Layout(_each(layouts.kitti2015), has_objects=True),
    "mcap": Layout(ros_layout.mcap, needs_pair=False),
    "middlebury": Layout(_each(layouts.middlebury)),
    "nerfstudio": Layout(_each(multiview_layouts.nerfstudio), needs_pair=False),
    "parquet": Layout(layouts.parquet),
    "sceneflow": Layout(_each(layouts.sceneflow)),
    "sintel": Layout(_each(layouts.sintel)),
    "webdataset": Layout(layouts.webdataset),
}
"""The layouts by name."""


def export(
    dataset: Sequence[StoredSample],
    folder: Where,
    to: str,
    lens: int = 0,
    overwrite: bool = False,
    progress: Callable[[float, str], None] = lambda fraction, name: None,
    objects: Collection[str] = (),
) -> dict[str, int]:
    """Write samples to `folder` in the layout `to`, a key of LAYOUTS.

    The folder appears whole or not at all. What killed exports left beside it is removed. It must not exist, unless
    `overwrite` is set and it is an earlier export or empty. EXPORT.md in it lists the samples in order. `lens` selects
    the images of samples taken through several lenses. `progress` is called with the fraction done and the sample's
    name. `objects` are the names of the objects to export, without the numbers of copies, in the layouts that hold
    objects; by default all, and none in kitti2015.

    Returns the size in bytes of each file by relative name. Raises InputError for an unknown layout and for a sample
    that the layout cannot hold, FileError for a file that a sample lacks, and OutputError.
    """
    check_known("layout", to, LAYOUTS)
    layout = LAYOUTS[to]
    if objects and not layout.has_objects:
        others = ", ".join(name for name in LAYOUTS if LAYOUTS[name].has_objects)
        raise InputError(f"{to} has no masks of objects; layouts with masks: {others}")
    if not len(dataset):
        raise InputError("export needs one or more samples")
    folder = place(folder)
    _check_outside(folder, dataset)
    if overwrite:
        check_replaceable(folder, _is_export(folder), "an earlier export")
    sizes: dict[str, int] = {}

    def files() -> Files:
        sources = _sources(dataset, layout, lens, objects, progress)
        note = (NOTE, _note(dataset, to))
        for name, content in itertools.chain(layout.files(sources), [note]):
            sizes[name] = len(content)
            yield name, content

    remove_abandoned(folder.parent)
    write_folder(folder, files(), overwrite)
    return sizes


def _check_outside(folder: Place, dataset: Sequence[StoredSample]) -> None:
    """Raise OutputError for a folder inside the dataset, where the export would be more samples of it."""
    if isinstance(folder, RemotePath):
        return
    around = (folder.absolute(), *folder.absolute().parents)
    for sample in dataset:
        home = Path(str(sample.folder)).absolute()
        in_dataset = home.parent in around and (home.parent / MANIFEST).is_file()
        if home in around or in_dataset:
            raise OutputError(
                f"{folder}: is inside the dataset to export; choose a folder outside of it"
            )


def _is_export(folder: Place) -> bool:
    """Whether the folder was written by `export`."""
    note = folder / NOTE
    return note.is_file() and read_bytes(note).startswith(_FIRST_LINE.encode())


def _note(dataset: Sequence[StoredSample], to: str) -> bytes:
    names = "".join(f"{i}. {sample.name}\n" for i, sample in enumerate(dataset))
    head = f"{_FIRST_LINE} {twinlens.__version__}\n\nLayout: `{to}`. Samples, in order:"
    return f"{head}\n\n{names}".encode()


def _sources(
    dataset: Sequence[StoredSample],
    layout: Layout,
    lens: int,
    objects: Collection[str],
    progress: Callable[[float, str], None],
) -> Iterator[Source]:
    """The samples to export. Raises InputError for an unrectified pair, and for objects that no sample has."""
    names_seen: set[str] = set()
    in_images: set[str] = set()
    texts = {}
    if isinstance(dataset, Dataset):
        texts = about(dataset)[0].model_dump(exclude={"credits"}, exclude_defaults=True)
    for i, sample in enumerate(dataset):
        progress(i / len(dataset), sample.name)
        has_record = sample.has("sample.json")
        if layout.needs_pair and has_record and not sample.has("calib.txt"):
            others = ", ".join(name for name in LAYOUTS if not LAYOUTS[name].needs_pair)
            raise InputError(
                f"{sample.name}: is not a rectified pair; layouts for other rigs: {others}"
            )
        if objects and has_record:
            names = sample.record.get("object_names", [])
            names_seen.update(layouts.category(name, names) for name in names)
            in_images.update(_categories_in_images(sample, names))
        chosen = frozenset(objects) if objects else None
        yield Source(sample, i, lens, chosen, texts)
    for name in objects:
        if name not in names_seen:
            # Lamps behind the camera are objects too, but nothing to choose.
            raise unknown("object", name, in_images or names_seen)


def _categories_in_images(sample: StoredSample, names: Sequence[str]) -> set[str]:
    """The categories of the objects that are in the image of a view; empty in samples of versions before 0.2."""
    instances = [
        instance for view in range(len(sample.rig)) for instance in sample.objects(view)
    ]
    in_images = {names[instance.object_id - 1] for instance in instances}
    return {layouts.category(name, names) for name in in_images}
