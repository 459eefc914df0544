"""Is a whole dataset what it says it is: its list, what lies beside its samples, and each sample (`verify_sample`)."""

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twinlens.dataset.croissant import NAME as CROISSANT
from twinlens.dataset.dataset import Dataset, found_samples
from twinlens.dataset.files import is_hidden, read_bytes
from twinlens.dataset.manifest import NAME, Manifest, read_manifest
from twinlens.dataset.storage import MARK, Place, RemotePath, Where, is_whole, place
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.verify import is_of_damage, verify_sample
from twinlens.dataset.waiting import is_of_recipe, kept_rows
from twinlens.errors import FileError

_OF_A_SAMPLE = (MARK, "im0.png")


def verify_place(where: Where, progress: Callable[[float, str], None] | None = None) -> Iterator[tuple[str, list[str]]]:
    """(name, findings): of dataset.json, which stands for the dataset as a whole, and then of each sample in turn.

    Samples that are made and wait to be listed are checked like the others, against their own rows. One sample is in
    memory at a time. `progress` hears the fraction done and the sample's name. Never raises for what a
    file holds; FileError when there is no dataset at all.
    """
    samples, findings = _opened(place(where))
    yield NAME, findings
    for i, sample in enumerate(samples):
        if progress is not None:
            progress(i / len(samples), sample.name)
        yield sample.name, verify_sample(sample)


def _opened(folder: Place) -> tuple[Sequence[StoredSample], list[str]]:
    """The samples that are to be checked, and the findings of the whole."""
    if not (folder / NAME).is_file():
        return (dataset := Dataset(folder)), _without_list(folder, dataset)
    try:
        state = _state(folder)
        samples = state.samples or (() if _grows(state.manifest) else Dataset(folder))
    except FileError as error:
        return found_samples(folder), [str(error).removeprefix(f"{folder / NAME}: ")]
    return samples, state.findings + ([] if state.manifest.info.get("complete") is False else _of_croissant(folder))


@dataclass(frozen=True)
class _State:
    """A dataset at one moment: its list, what is made and waits to be listed, and what is wrong with the whole."""

    folder: Place
    manifest: Manifest
    waiting: Sequence[StoredSample]
    findings: list[str]

    @property
    def samples(self) -> tuple[StoredSample, ...]:
        """Those that are listed, and then those that wait to be."""
        rows = ((row.name, {"files": row.files, "info": row.info}) for row in self.manifest.rows)
        return (*(StoredSample(self.folder / name, name, row) for name, row in rows), *self.waiting)


def _state(folder: Place) -> _State:
    """How things stand in `folder`, others making samples there meanwhile. Raises FileError for its list.

    A sample's folder appears before its row, and its row before it is listed: what is looked for in this order is
    found by a later step when it has moved on since the one before.
    """
    before = {row.name for row in read_manifest(folder).rows}
    folders = list(_folders_of_samples(folder, before))
    kept, unread = kept_rows(folder, before)
    manifest = read_manifest(folder)
    listed = {row.name for row in manifest.rows}
    waiting = [sample for sample in kept if sample.name not in listed]
    beside = _beside(folders, listed | {sample.name for sample in waiting})
    if _grows(manifest):
        rowless, beside = _without_row(folder, manifest, beside)
        waiting = sorted([*waiting, *rowless], key=lambda sample: sample.name)
    findings = [line for name, line in unread.items() if name not in listed]
    return _State(folder, manifest, waiting, findings + [f"{n}: is a sample that {NAME} does not list" for n in beside])


def _grows(manifest: Manifest) -> bool:
    """Whether `twinlens generate` began the dataset and has not finished it."""
    return manifest.info.get("complete") is False and "made_with" in manifest.info


def _without_row(folder: Place, manifest: Manifest, beside: Sequence[str]) -> tuple[list[StoredSample], list[str]]:
    """Of what lies beside, the recipe's own samples that have no row yet (nor ever, after a kill); and the rest."""
    count = manifest.recipe.get("count")
    own = {name for name in beside if is_of_recipe(name.partition("/")[0], count)}
    whole = {name for name in own if is_of_recipe(name, count) and is_whole(folder / name)}
    # In a bucket a sample appears file by file: without its mark it is being written, or will be written over.
    rest = set(beside) - (own if isinstance(folder, RemotePath) else whole)
    return [StoredSample(folder / name, name) for name in sorted(whole)], sorted(rest)


def unchecked(where: Where) -> str:
    """What a dataset does not let itself be checked for, in a line; empty where it does."""
    if (place(where) / NAME).is_file():
        return ""
    return f"no {NAME} here: the files were held against each other, but not against checksums"


def unfinished(where: Where) -> str:
    """How many of its recipe's samples a dataset lacks, and what to do about it, in a line; empty where it lacks none.

    Those that could not be made, or are made and wait to be listed, are told too. A list that cannot be read is told by
    `verify_place`.
    """
    try:
        state = _state(place(where))
    except FileError:
        return ""
    manifest, waiting = state.manifest, len(state.waiting)
    count, failed = manifest.recipe.get("count"), manifest.info.get("failed")
    if not isinstance(count, int) or len(manifest.rows) >= count:
        return ""
    lost = len(failed) if isinstance(failed, list) else 0
    rowless = sum("files" not in sample.row for sample in state.waiting)
    said = [f"{NAME} lists {len(manifest.rows)} of the {count} samples of its recipe"]
    without = f" ({rowless} without checksums so far)" * bool(rowless)
    said += [f"{waiting} more {'is' if waiting == 1 else 'are'} made and not listed yet{without}"] if waiting else []
    said += [f'{lost} could not be made ("failed" in it says why)'] if lost else []
    rest = len(manifest.rows) + waiting + lost < count
    if rest or waiting:
        what = " and ".join(["makes the rest"] * rest + ["lists them"] * bool(waiting))
        said.append(f"the `twinlens generate` that began it {what}")
    return "; ".join(said)


def cure(where: Where, found: Mapping[str, Sequence[str]]) -> str:
    """What to do about the damaged samples of a dataset that `twinlens generate` made, in a line; empty without any.

    `found`: the findings of `verify_place`, by name.
    """
    damaged = sum(any(map(is_of_damage, lines)) for name, lines in found.items() if name != NAME)
    with contextlib.suppress(FileError):
        if damaged and "made_with" in read_manifest(where).info:
            what = f"{damaged} sample{' is' if damaged == 1 else 's are'} damaged"
            return (
                f"{what}: delete the folder of each and run the same `twinlens generate`: it makes them again, the "
                "same to the byte"
            )
    return ""


def _without_list(folder: Place, dataset: Dataset) -> list[str]:
    if dataset[0].folder == folder or not any(sample.has(MARK) for sample in dataset):
        return []
    lost = f"is missing, so that no file can be held against its checksum; found without it: {len(dataset)}"
    return [f"{lost}; where `twinlens generate` made them, the same command writes it again"]


def _beside(folders: Iterable[str], known: set[str]) -> list[str]:
    """Those of `folders`, with a sample's files in them, that are none of `known`, nor lie in a sample."""
    found: set[str] = set()
    for name in sorted(folders, key=lambda name: name.count("/")):
        ancestors = {name[:end] for end, letter in enumerate(name) if letter == "/"}
        if name and not ({name} | ancestors) & (known | found):
            found.add(name)
    return sorted(found)


def _folders_of_samples(folder: Place, known: set[str]) -> Iterator[str]:
    """The names of the folders below `folder` with a sample's files in them, but for hidden ones."""
    if isinstance(folder, RemotePath):
        found = {name.rpartition("/")[0] for name in folder.files() if name.rpartition("/")[2] in _OF_A_SAMPLE}
        yield from (name for name in found if not any(map(is_hidden, name.split("/"))))
        return
    level = [folder]
    while level:
        below = [entry for each in level for entry in _entries(each) if entry.is_dir() and not is_hidden(entry.name)]
        # What is known is not looked into: most of a dataset's files lie there.
        level = [entry for entry in below if entry.relative_to(folder).as_posix() not in known]
        for entry in level:
            if any((entry / file).is_file() for file in _OF_A_SAMPLE):
                yield entry.relative_to(folder).as_posix()


def _entries(folder: Path) -> list[Path]:
    """What lies in a folder; nothing where it has gone meanwhile."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []


def _of_croissant(folder: Place) -> list[str]:
    """croissant.json holds the SHA-256 of dataset.json. It is of the finished one: while a dataset grows, of none."""
    if not (folder / CROISSANT).is_file():
        return []
    try:
        entries = json.loads(read_bytes(folder / CROISSANT))["distribution"]
        stated = [entry["sha256"] for entry in entries if entry.get("contentUrl") == NAME]
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError):
        return [f"{CROISSANT}: is damaged; `twinlens describe` makes it anew"]
    if stated != [hashlib.sha256(read_bytes(folder / NAME)).hexdigest()]:
        return [f"{CROISSANT}: describes another {NAME}; `twinlens describe` makes it anew"]
    return []
