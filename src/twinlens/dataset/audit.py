"""Is a whole dataset what it says it is: its list, what lies beside its samples, and each sample (`verify_sample`)."""

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence

from twinlens.dataset.croissant import NAME as CROISSANT
from twinlens.dataset.dataset import Dataset, found_samples
from twinlens.dataset.files import is_hidden, read_bytes
from twinlens.dataset.manifest import NAME, read_manifest
from twinlens.dataset.storage import MARK, Place, RemotePath, Where, place
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.verify import is_of_damage, verify_sample
from twinlens.dataset.waiting import waiting_samples
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
        listed = read_manifest(folder).rows
        waiting = waiting_samples(folder, {row.name for row in listed})
        samples = [*(Dataset(folder) if listed or not waiting else ()), *waiting]
    except FileError as error:
        return found_samples(folder), [str(error).removeprefix(f"{folder / NAME}: ")]
    return samples, _of_the_list(folder, {sample.name for sample in samples})


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
        manifest = read_manifest(where)
    except FileError:
        return ""
    count, failed = manifest.recipe.get("count"), manifest.info.get("failed")
    if not isinstance(count, int) or len(manifest.rows) >= count:
        return ""
    lost = len(failed) if isinstance(failed, list) else 0
    waiting = len(waiting_samples(place(where), {row.name for row in manifest.rows}))
    said = [f"{NAME} lists {len(manifest.rows)} of the {count} samples of its recipe"]
    said += [f"{waiting} more {'is' if waiting == 1 else 'are'} made and not listed yet"] if waiting else []
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


def _of_the_list(folder: Place, known: set[str]) -> list[str]:
    """`known`: the names of the samples that are listed, or wait to be."""
    growing = read_manifest(folder).info.get("complete") is False
    beside = [f"{name}: is a sample that {NAME} does not list" for name in _beside(folder, known)]
    return beside + ([] if growing else _of_croissant(folder))


def _without_list(folder: Place, dataset: Dataset) -> list[str]:
    if dataset[0].folder == folder or not any(sample.has(MARK) for sample in dataset):
        return []
    lost = f"is missing, so that no file can be held against its checksum; found without it: {len(dataset)}"
    return [f"{lost}; where `twinlens generate` made them, the same command writes it again"]


def _beside(folder: Place, known: set[str]) -> list[str]:
    """The folders below `folder` with a sample's files in them that are none of `known`, nor lie in a sample."""
    found: set[str] = set()
    for name in sorted(_folders_of_samples(folder, known), key=lambda name: name.count("/")):
        ancestors = {name[:end] for end, letter in enumerate(name) if letter == "/"}
        hidden = any(is_hidden(part) for part in name.split("/"))
        if name and not hidden and not ({name} | ancestors) & (known | found):
            found.add(name)
    return sorted(found)


def _folders_of_samples(folder: Place, known: set[str]) -> Iterator[str]:
    if isinstance(folder, RemotePath):
        yield from {name.rpartition("/")[0] for name in folder.files() if name.rpartition("/")[2] in _OF_A_SAMPLE}
        return
    level = [folder]
    while level:
        below = [entry for each in level for entry in each.iterdir() if entry.is_dir()]
        # What is known is not looked into: most of a dataset's files lie there.
        level = [entry for entry in below if entry.relative_to(folder).as_posix() not in known]
        for entry in level:
            if any((entry / file).is_file() for file in _OF_A_SAMPLE):
                yield entry.relative_to(folder).as_posix()


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
