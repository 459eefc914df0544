"""A new dataset of samples of others: a part of one, or several merged, with other splits or fewer channels.

    datasets, or parts of them -> Plan: a name for every sample -> one folder a sample -> dataset.json, card

Samples are written one by one, each completely or not at all, and dataset.json last. The same call resumes after any
stop. dataset.json records what the dataset was made from under `info.subset`; the recipes of the sources are there.
"""

import hashlib
import itertools
import json
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from twinlens.dataset.card import describe
from twinlens.dataset.dataset import (
    MANIFEST,
    Dataset,
    Manifest,
    Row,
    read_manifest,
    write_manifest,
)
from twinlens.dataset.dropping import check_dropped, without
from twinlens.dataset.files import (
    files_below,
    hash_files,
    is_hidden,
    locked,
    read_bytes,
    remove_unfinished,
    write_folder,
)
from twinlens.dataset.merged_about import merged_about
from twinlens.dataset.metadata import KEY as ABOUT
from twinlens.dataset.record import plain
from twinlens.dataset.storage import Place, RemotePath, Where, place
from twinlens.dataset.stored import StoredSample
from twinlens.errors import FileError, InputError, OutputError

SUBSET = "subset"
"""The key of `info` in dataset.json: what the dataset was made from, and how."""

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class Origin:
    """A dataset that samples were taken from: its name in the new one, its dataset.json, and the samples taken."""

    name: str
    dataset: Dataset
    manifest: Manifest
    digest: str

    def record(self) -> dict[str, Any]:
        """What the new dataset.json says of it."""
        info = {
            key: self.manifest.info[key] for key in _KEPT if key in self.manifest.info
        }
        return {
            "name": self.name,
            "dataset_sha256": self.digest,
            "samples": len(self.dataset),
            "of": len(self.manifest.rows) or len(self.dataset),
            "seed": self.manifest.seed,
            "recipe": self.manifest.recipe,
            "info": info,
        }


_KEPT = (ABOUT, "made_with", "versions", "rejections", SUBSET)
"""The keys of the `info` of a source that the new dataset.json has; `sources` and `bundled` are merged."""


@dataclass(frozen=True)
class Task:
    """A sample to write: the name in the new dataset, the sample, where it is from, and its split, if any."""

    name: str
    sample: StoredSample
    origin: Origin
    split: str | None = None


@dataclass(frozen=True)
class Combined:
    """What `combine` has done: samples of the new dataset, those made now, repeated ones, files, and bytes written.

    linked : files that are hard links, which take no room.
    """

    samples: int
    made: int = 0
    repeated: int = 0
    files: int = 0
    linked: int = 0
    bytes: int = 0
    splits: Mapping[str, int] = field(default_factory=dict)


def combine(
    datasets: Sequence[Dataset],
    folder: Where,
    *,
    dropped: Collection[str] = (),
    split_of: Callable[[Sequence[StoredSample]], Sequence[str]] | None = None,
    link: bool = False,
    how: Mapping[str, Any] | None = None,
    report: Report = lambda fraction, name: None,
) -> Combined:
    """Write the samples of `datasets`, which may be slices, as the new dataset `folder`.

    dropped : names of channels to leave out, see `droppable`.
    split_of : the split of each sample, in order; by default samples keep theirs.
    link : make hard links to the files that do not change, instead of copies. Files are then not read.
    how : what the caller chose the samples by, for dataset.json. Two calls that differ in it make two datasets.
    report : called with the fraction done and a sample's name.

    Names stay if they differ. Otherwise each source is a folder in the new dataset. A sample that two sources have
    under one name with the same files is written once. Copied files are compared with their SHA-256.

    Raises InputError without samples, FileError for a damaged source, and OutputError.
    """
    check_dropped(dropped)
    root = place(folder)
    if link and isinstance(root, RemotePath):
        raise InputError(f"{root}: a bucket has no hard links; copy the files instead")
    origins = _origins(datasets, root)
    tasks, repeated = _tasks(origins)
    if split_of is not None:
        splits = split_of([task.sample for task in tasks])
        pairs = zip(tasks, splits, strict=True)
        tasks = [replace(task, split=split) for task, split in pairs]
    record = {
        "sources": [origin.record() for origin in origins],
        "dropped": sorted(dropped),
        "names_sha256": _digest_of(tasks),
        **(how or {}),
    }
    done = Combined(len(tasks), repeated=repeated)
    with locked(root):
        if _is_begun(root, plain(record)):
            return replace(done, splits=_counts(read_manifest(root).rows))
        write_manifest(root, Manifest((), info={"complete": False, SUBSET: record}))
        rows = []
        for row, change in _written(root, tasks, dropped, link, report):
            rows.append(row)
            done = _added(done, change)
        _finish(root, rows, origins, record)
    return replace(done, splits=_counts(rows))


def _origins(datasets: Sequence[Dataset], root: Place) -> list[Origin]:
    """The sources with names that differ. Raises InputError for no sample, OutputError for an output inside of one."""
    origins: list[Origin] = []
    for dataset in datasets:
        if not len(dataset):
            continue
        _check_apart(dataset.path, root)
        name = _free_name(dataset.path, {origin.name for origin in origins})
        manifest, digest = Manifest(()), ""
        if (dataset.path / MANIFEST).is_file():
            data = read_bytes(dataset.path / MANIFEST)
            manifest, digest = dataset.manifest, hashlib.sha256(data).hexdigest()
        origins.append(Origin(name, dataset, manifest, digest))
    if not origins:
        raise InputError("no sample is left to write")
    return origins


def _free_name(path: Place, taken: Collection[str]) -> str:
    """The name of a folder, with a number if it is taken."""
    stem = path.resolve().name or "dataset"
    names = (f"{stem}-{number}" for number in itertools.count(2))
    return next(name for name in itertools.chain([stem], names) if name not in taken)


def _check_apart(source: Place, root: Place) -> None:
    """Raise OutputError for an output that is a source, or inside of one."""
    if isinstance(source, RemotePath) or isinstance(root, RemotePath):
        is_inside = f"{root}/".startswith(f"{source}/")
    else:
        around = (root.resolve(), *root.resolve().parents)
        is_inside = source.resolve() in around
    if is_inside:
        raise OutputError(
            f"{root}: is the source {source}, or inside of it; choose a folder outside of it"
        )


def _tasks(origins: Sequence[Origin]) -> tuple[list[Task], int]:
    """What to write, under names that differ, and how many samples were left out as repeated."""
    files: dict[str, Mapping[str, str]] = {}
    tasks: list[Task] = []
    repeated, clash = 0, False
    for origin in origins:
        for sample in origin.dataset:
            hashes = sample.row.get("files", {})
            if sample.name not in files:
                files[sample.name] = hashes
            elif hashes and files[sample.name] == hashes:
                repeated += 1
                continue
            else:
                clash = True
            tasks.append(Task(sample.name, sample, origin))
    if clash:
        tasks = [
            replace(task, name=f"{task.origin.name}/{task.name}") for task in tasks
        ]
    _check_nesting([task.name for task in tasks])
    return tasks, repeated


def _check_nesting(names: Sequence[str]) -> None:
    """Raise InputError if the folder of a sample would be inside that of another one."""
    folders = set(names)
    for name in names:
        for parent in PurePosixPath(name).parents:
            if str(parent) in folders:
                raise InputError(
                    f"the sample {name!r} would be inside the sample {str(parent)!r}; rename one of the folders"
                )


def _digest_of(tasks: Sequence[Task]) -> str:
    """A digest of the names, files and splits that the new dataset will have."""
    lines = [
        [task.name, task.sample.row.get("files", {}), task.split] for task in tasks
    ]
    return hashlib.sha256(json.dumps(lines, sort_keys=True).encode()).hexdigest()


def _is_begun(root: Place, record: Any) -> bool:
    """Whether the dataset is complete already. Raises OutputError where something else is in the folder."""
    if not (root / MANIFEST).is_file():
        names = [entry.name for entry in root.iterdir()] if root.is_dir() else []
        if others := sorted(name for name in names if not is_hidden(name)):
            raise OutputError(
                f"{root}: contains {others[0]!r} and no {MANIFEST}; choose a new or an empty folder"
            )
        return False
    info = read_manifest(root).info
    if info.get(SUBSET) != record:
        what = (
            "was made with other options, or from other sources"
            if SUBSET in info
            else "is another dataset"
        )
        raise OutputError(f"{root}: {what}; choose another folder, or delete this one")
    return info.get("complete") is True


@dataclass(frozen=True)
class _Change:
    """What the writing of one sample has added: files, hard links among them, and bytes; nothing if it was there."""

    files: int = 0
    linked: int = 0
    bytes: int = 0
    is_new: bool = False


def _added(done: Combined, change: _Change) -> Combined:
    return replace(
        done,
        made=done.made + change.is_new,
        files=done.files + change.files,
        linked=done.linked + change.linked,
        bytes=done.bytes + change.bytes,
    )


def _written(
    root: Place,
    tasks: Sequence[Task],
    dropped: Collection[str],
    link: bool,
    report: Report,
) -> Iterator[tuple[Row, _Change]]:
    """Write every sample that is not there yet; its row, and what was written."""
    for parent in {(root / task.name).parent for task in tasks}:
        if isinstance(parent, RemotePath) or parent.is_dir():
            remove_unfinished(parent)
    for number, task in enumerate(tasks):
        report(number / len(tasks), task.name)
        yield _write_sample(root, task, dropped, link)
    if isinstance(root, Path):
        # Once, instead of after each of many small files.
        os.sync()


def _write_sample(
    root: Place, task: Task, dropped: Collection[str], link: bool
) -> tuple[Row, _Change]:
    """Write one sample. A sample that an earlier run wrote stays if its files are right, and is replaced if not."""
    sample = task.sample
    expected = dict(sample.row.get("files") or hash_files(sample.folder))
    kept = list(expected)
    changed: dict[str, bytes] = {}
    if dropped:
        kept, changed = without(sample, expected, dropped)
        for name in changed:
            _checked(sample, name, expected[name])
    hashes = {name: expected[name] for name in kept}
    hashes |= {name: hashlib.sha256(data).hexdigest() for name, data in changed.items()}
    row = Row(task.name, dict(sorted(hashes.items())), _row_info(task))
    folder = root / task.name
    if folder.exists() and _is_right(folder, row, sample, kept if link else ()):
        return row, _Change()
    files, links = dict(changed), {}
    for name in kept:
        if link:
            links[name] = _local(sample.path(name))
        else:
            files[name] = _checked(sample, name, expected[name])
    write_folder(folder, files, overwrite=True, links=links, flush=False)
    size = sum(map(len, files.values()))
    return row, _Change(len(files) + len(links), len(links), size, True)


def _row_info(task: Task) -> dict[str, Any]:
    """The `info` of the new row: that of the old one, with the new split, and the source if its name was needed."""
    info = dict(task.sample.row.get("info", {}))
    if task.split is not None:
        info["split"] = task.split
    return info


def _is_right(
    folder: Place, row: Row, sample: StoredSample, linked: Collection[str]
) -> bool:
    """Whether a folder has the files of the row: hard links by their inode, others by their SHA-256."""
    if set(files_below(folder)) != set(row.files):
        return False
    for name, digest in row.files.items():
        if name in linked:
            if not Path(str(folder / name)).samefile(str(sample.path(name))):
                return False
        elif hashlib.sha256(read_bytes(folder / name)).hexdigest() != digest:
            return False
    return True


def _local(path: Place) -> Path:
    """The local file of a hard link. Raises InputError in a bucket, FileError where it is missing."""
    if isinstance(path, RemotePath):
        raise InputError(f"{path}: a bucket has no hard links; copy the files instead")
    if not path.is_file():
        raise FileError(f"{path}: no such file; `twinlens verify` checks the source")
    # A link to a symbolic link would be one itself.
    return path.resolve()


def _checked(sample: StoredSample, name: str, expected: str) -> bytes:
    """The content of a file of the source. Raises FileError if it is not the one in dataset.json."""
    data = read_bytes(sample.path(name))
    if hashlib.sha256(data).hexdigest() != expected:
        raise FileError(
            f"{sample.path(name)}: differs from its SHA-256 in {MANIFEST}; `twinlens verify` checks the source"
        )
    return data


def _finish(
    root: Place,
    rows: Sequence[Row],
    origins: Sequence[Origin],
    record: Mapping[str, Any],
) -> None:
    """Write the final dataset.json, the card, and the metadata."""
    sources = [
        (origin.name, origin.manifest, origin.dataset.path / MANIFEST)
        for origin in origins
    ]
    info = {"complete": True, **merged_about(sources)}
    if counts := _counts(rows):
        info["splits"] = counts
    info[SUBSET] = record
    write_manifest(root, Manifest(tuple(rows), info=info))
    describe(root)


def _counts(rows: Sequence[Row]) -> dict[str, int]:
    """Samples by split; empty without splits."""
    splits = [row.info.get("split") for row in rows]
    counts = Counter(str(split) for split in splits if split is not None)
    return dict(sorted(counts.items()))
