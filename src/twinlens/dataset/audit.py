"""Verification of a whole dataset: its list, pending samples, unlisted samples, and each sample (`verify_sample`)."""

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinlens.dataset.croissant import NAME as CROISSANT
from twinlens.dataset.dataset import Dataset, found_samples, stored
from twinlens.dataset.files import is_hidden, read_bytes
from twinlens.dataset.manifest import NAME, ROWS, Manifest, pending_rows, read_manifest
from twinlens.dataset.storage import MARK, Place, RemotePath, Where, is_whole, place
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.verify import is_damage, verify_sample
from twinlens.errors import FileError

_SAMPLE_FILES = (MARK, "im0.png")


def verify_place(where: Where, progress: Callable[[float, str], None] | None = None) -> Iterator[tuple[str, list[str]]]:
    """Yield (name, findings): first for "dataset.json", the dataset as a whole, then for each sample.

    Pending samples, which are made but not yet in dataset.json, are checked against their own rows. One sample is in
    memory at a time. Raises FileError if there is no dataset; never for the content of a file.

    Parameters
    ----------
    where : str or path
    progress : callable or None
        Called with the fraction done and the sample's name.
    """
    samples, findings = _open(place(where))
    yield NAME, findings
    for i, sample in enumerate(samples):
        if progress is not None:
            progress(i / len(samples), sample.name)
        yield sample.name, verify_sample(sample)


def unchecked(where: Where) -> str:
    """One line if there are no checksums to verify; else empty."""
    exists = (place(where) / NAME).is_file()
    return "" if exists else f"no {NAME}: files were checked for consistency, but not against checksums"


def unfinished(where: Where) -> str:
    """One line that counts the missing, pending and failed samples of a recipe; empty if the dataset is complete.

    Also empty if dataset.json cannot be read, which `verify_place` reports.
    """
    try:
        state = _state(place(where))
    except FileError:
        return ""
    manifest, pending = state.manifest, len(state.pending)
    count, failed = manifest.recipe.get("count"), manifest.info.get("failed")
    if not isinstance(count, int) or len(manifest.rows) >= count:
        return ""
    num_failed = len(failed) if isinstance(failed, list) else 0
    unhashed = sum("files" not in sample.row for sample in state.pending)
    parts = [f"{NAME} lists {len(manifest.rows)} of {count} samples"]
    if pending:
        parts.append(f"{pending} made but not listed yet" + (f" ({unhashed} without checksums)" if unhashed else ""))
    if num_failed:
        parts.append(f'{num_failed} failed ("failed" in it says why)')
    missing = len(manifest.rows) + pending + num_failed < count
    if missing or pending:
        actions = ["make the missing samples"] * missing + ["list the finished ones"] * bool(pending)
        parts.append(f"rerun `twinlens generate` to {' and '.join(actions)}")
    return "; ".join(parts)


def repair_hint(where: Where, findings: Mapping[str, Sequence[str]]) -> str:
    """One line on how to repair the damaged samples of a dataset of `twinlens generate`; empty if there are none.

    `findings` are those of `verify_place`, by name.
    """
    damaged = sum(any(map(is_damage, lines)) for name, lines in findings.items() if name != NAME)
    with contextlib.suppress(FileError):
        if damaged and "made_with" in read_manifest(where).info:
            which = (
                "1 sample is damaged: delete its folder"
                if damaged == 1
                else f"{damaged} samples are damaged: delete their folders"
            )
            return f"{which} and rerun `twinlens generate`, which makes identical files"
    return ""


@dataclass(frozen=True)
class _State:
    """A dataset at one moment: its list, its pending samples, and the findings on the dataset as a whole."""

    folder: Place
    manifest: Manifest
    pending: Sequence[StoredSample]
    findings: list[str]


def _open(folder: Place) -> tuple[Sequence[StoredSample], list[str]]:
    """The samples to check, and the findings on the dataset as a whole."""
    if not (folder / NAME).is_file():
        return (dataset := Dataset(folder)), _check_missing_manifest(folder, dataset)
    try:
        state = _state(folder)
        samples = (*(stored(folder, row) for row in state.manifest.rows), *state.pending)
        if not samples and not _is_growing(state.manifest):
            Dataset(folder)  # raises: the list is empty
    except FileError as error:
        return found_samples(folder), [str(error).removeprefix(f"{folder / NAME}: ")]
    complete = state.manifest.info.get("complete") is not False
    return samples, state.findings + (_check_croissant(folder) if complete else [])


def _state(folder: Place) -> _State:
    """The state of `folder` while other processes may be making samples in it. Raises FileError for its list.

    A sample's folder appears first, then its row, then its entry in dataset.json. They are read in this order, so a
    sample that moves on between two reads is found by the later one.
    """
    listed_before = {row.name for row in read_manifest(folder).rows}
    folders = list(_sample_folders(folder, listed_before))
    rows, errors = pending_rows(folder, listed_before)
    manifest = read_manifest(folder)
    listed = {row.name for row in manifest.rows}
    pending = [
        StoredSample(folder / name, name) if row is None else stored(folder, row, f"{ROWS}/{name}.json")
        for name, row in rows.items()
        if name not in listed
    ]
    unlisted = _unlisted_folders(folders, listed | {sample.name for sample in pending})
    if _is_growing(manifest):
        rowless, unlisted = _split_rowless(folder, manifest, unlisted)
        pending = sorted([*pending, *rowless], key=lambda sample: sample.name)
    findings = [line for name, line in errors.items() if name not in listed]
    findings += [f"{name}: is a sample that {NAME} does not list" for name in unlisted]
    return _State(folder, manifest, pending, findings)


def _is_growing(manifest: Manifest) -> bool:
    """Whether `twinlens generate` has started the dataset and not finished it."""
    return manifest.info.get("complete") is False and "made_with" in manifest.info


def _split_rowless(folder: Place, manifest: Manifest, unlisted: Sequence[str]) -> tuple[list[StoredSample], list[str]]:
    """Split `unlisted` into samples of the recipe without a row (being made, or after a kill) and all others."""
    count = manifest.recipe.get("count")
    own = {name for name in unlisted if _is_of_recipe(name.partition("/")[0], count)}
    whole = {name for name in own if _is_of_recipe(name, count) and is_whole(folder / name)}
    # In a bucket a sample appears file by file: one without its mark is being written, or will be overwritten.
    others = set(unlisted) - (own if isinstance(folder, RemotePath) else whole)
    return [StoredSample(folder / name, name) for name in sorted(whole)], sorted(others)


def _is_of_recipe(name: str, count: Any) -> bool:
    """Whether `twinlens generate` gives this name to one of the `count` samples of a recipe."""
    return isinstance(count, int) and name.isdecimal() and int(name) < count and name == f"{int(name):07d}"


def _check_missing_manifest(folder: Place, dataset: Dataset) -> list[str]:
    """The finding of a missing dataset.json; a single sample and plain Middlebury folders need none."""
    if dataset[0].folder == folder or not any(sample.has(MARK) for sample in dataset):
        return []
    lost = f"is missing, so no checksums can be verified; {len(dataset)} found without it"
    return [f"{lost}; if `twinlens generate` made them, rerun it to restore the file"]


def _unlisted_folders(folders: Iterable[str], known: set[str]) -> list[str]:
    """The `folders` that are not known, without those inside a known folder or inside one another."""
    found: set[str] = set()
    for name in sorted(folders, key=lambda name: name.count("/")):
        ancestors = {name[:end] for end, letter in enumerate(name) if letter == "/"}
        if name and not ({name} | ancestors) & (known | found):
            found.add(name)
    return sorted(found)


def _sample_folders(folder: Place, known: set[str]) -> Iterator[str]:
    """Names of the folders below `folder` that contain a sample's files, except for hidden ones."""
    if isinstance(folder, RemotePath):
        found = {name.rpartition("/")[0] for name in folder.files() if name.rpartition("/")[2] in _SAMPLE_FILES}
        yield from (name for name in found if not any(map(is_hidden, name.split("/"))))
        return
    level = [folder]
    while level:
        below = [entry for each in level for entry in _entries(each) if entry.is_dir() and not is_hidden(entry.name)]
        # Most files of a dataset are in known folders: skip those.
        level = [entry for entry in below if entry.relative_to(folder).as_posix() not in known]
        for entry in level:
            if any((entry / file).is_file() for file in _SAMPLE_FILES):
                yield entry.relative_to(folder).as_posix()


def _entries(folder: Path) -> list[Path]:
    """The entries of a folder; none if it has been removed meanwhile."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []


def _check_croissant(folder: Place) -> list[str]:
    """croissant.json contains the SHA-256 of the complete dataset.json."""
    if not (folder / CROISSANT).is_file():
        return []
    try:
        entries = json.loads(read_bytes(folder / CROISSANT))["distribution"]
        expected = [entry["sha256"] for entry in entries if entry.get("contentUrl") == NAME]
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError):
        return [f"{CROISSANT}: is damaged; `twinlens describe` rewrites it"]
    if expected != [hashlib.sha256(read_bytes(folder / NAME)).hexdigest()]:
        return [f"{CROISSANT}: describes another {NAME}; `twinlens describe` rewrites it"]
    return []
