"""Verification: a dataset's list and folders, and each sample's files.

A sample is checked in steps, each only if the previous one found nothing: checksums, readers, sizes, and the relations
between arrays (`twinlens.dataset.consistency`). A finding is one line that begins with a file name.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from twinlens.camera import Rig
from twinlens.camera.rig import check_seen
from twinlens.dataset import consistency
from twinlens.dataset.channels import (
    CHANNELS,
    IMAGE,
    TEXTS,
    TRUTH,
    FileOf,
    ViewFile,
    parse_file,
    view_files,
)
from twinlens.dataset.codecs.calib import Calibration, read_calib
from twinlens.dataset.dataset import (
    MANIFEST,
    ROWS,
    Dataset,
    Manifest,
    Row,
    pending_rows,
    read_manifest,
    stored,
)
from twinlens.dataset.files import hash_files, is_hidden, read_bytes
from twinlens.dataset.metadata import CROISSANT
from twinlens.dataset.storage import MARK, Place, RemotePath, Where, is_whole, place
from twinlens.dataset.stored import SampleFile, StoredSample, samples_in
from twinlens.errors import FileError, InputError, counted

_SAMPLE_FILES = (MARK, IMAGE.name(0))
_OF_SHARED_POINTS = {"visible", "object_id", "depth", "position"}
"""The channels that `check_shared_points` reads."""
_MISSING, _CHANGED = "is missing", "differs from its SHA-256 in"


@dataclass
class _Content:
    """What the files of a sample hold.

    views : the channels of each file of a view. In the order in which they were read.
    names : the names of these files.
    record : sample.json, if the sample has one.
    """

    views: dict[FileOf, dict[str, Any]] = field(default_factory=dict)
    names: dict[FileOf, str] = field(default_factory=dict)
    record: SampleFile | None = None
    calibration: Calibration | None = None

    @property
    def dropped(self) -> set[str]:
        """Names of the channels that the sample says were left out."""
        return set() if self.record is None else set(self.record.dropped)

    @property
    def num_views(self) -> int:
        """Cameras of the rig; of a plain folder 2."""
        return 2 if self.record is None else len(self.record.rig)

    @property
    def num_lenses(self) -> int:
        """Lenses of the sample; of a plain folder 1."""
        return 1 if self.record is None else len(self.record.shots)

    def num_frames(self, lens: int) -> int:
        """Frames that were taken through a lens; of a plain folder 1."""
        return 1 if self.record is None else self.record.shots[lens].num_frames

    def is_dual(self, lens: int) -> bool:
        """Whether the images of the lens were taken with dual pixels."""
        if self.record is None or self.record.record.get("dual_pixel") is not True:
            return False
        diameter: float = self.record.shots[lens].lens.aperture_diameter
        return diameter > 0

    def required(self, is_truth: bool) -> Iterator[FileOf]:
        """The files of views that the sample must have: those of the truth, or the others."""
        for file in view_files():
            if file.is_truth != is_truth:
                continue
            for lens in range(self.num_lenses if file.per_lens else 1):
                for view in range(self.num_views):
                    if self._needs(file, view, lens):
                        yield from self._frames_of(file, view, lens)

    def _frames_of(self, file: ViewFile, view: int, lens: int) -> Iterator[FileOf]:
        """A file in each of the frames that have their own."""
        for frame in range(self.num_frames(lens) if file.per_frame else 1):
            yield FileOf(file, view, lens, frame)

    def _needs(self, file: ViewFile, view: int, lens: int) -> bool:
        """Whether the sample must have a file; a plain folder needs its two images only."""
        if self.record is None:
            return file is IMAGE
        if self.dropped.issuperset(file.array_names):
            return False
        return file.required(self.record.rig.nominal, view, self.is_dual(lens))

    def of_view(self, view: int, lens: int) -> dict[str, Any]:
        """The channels of a view, of the files of one lens and of those that all lenses share; of the first frame."""
        channels: dict[str, Any] = {}
        for (file, number, shot, frame), arrays in self.views.items():
            is_of_lens = shot == lens or not file.per_lens
            if number == view and is_of_lens and frame == 0:
                channels |= arrays
        return channels


def verify_place(
    where: Where, progress: Callable[[float, str], None] | None = None
) -> Iterator[tuple[str, list[str]]]:
    """Yield (name, findings): first for "dataset.json", the dataset as a whole, then for each sample.

    Pending samples, which are made but not yet in dataset.json, are checked against their own rows. One sample is in
    memory at a time. `progress` is called with the fraction done and the sample's name. Raises FileError if there is no
    dataset; never for the content of a file.
    """
    samples, findings = _open(place(where))
    yield MANIFEST, findings
    for i, sample in enumerate(samples):
        if progress is not None:
            progress(i / len(samples), sample.name)
        yield sample.name, verify_sample(sample)


def missing_parts(where: Where) -> str:
    """One line if there are no checksums, or with the counts of missing, pending and failed samples; else empty.

    Also empty if dataset.json cannot be read, which `verify_place` reports.
    """
    if not (place(where) / MANIFEST).is_file():
        return f"no {MANIFEST}: files were checked for consistency, but not against checksums"
    try:
        manifest, samples, _ = _state(place(where))
    except FileError:
        return ""
    listed, pending = len(manifest.rows), samples[len(manifest.rows) :]
    count, failed = manifest.recipe.get("count"), manifest.info.get("failed")
    if not isinstance(count, int) or listed >= count:
        return ""
    num_failed = len(failed) if isinstance(failed, list) else 0
    unhashed = sum("files" not in sample.row for sample in pending)
    counts, actions = [f"{MANIFEST} lists {listed} of {counted(count, 'sample')}"], []
    if pending:
        note = f" ({unhashed} without checksums)" if unhashed else ""
        counts.append(f"{len(pending)} made but not listed yet{note}")
        actions = ["list the finished ones"]
    if num_failed:
        counts.append(f'{num_failed} failed ("failed" in it says why)')
    if listed + len(pending) + num_failed < count:
        actions.insert(0, "make the missing samples")
    if actions:
        counts.append(f"rerun `twinlens generate` to {' and '.join(actions)}")
    return "; ".join(counts)


def repair_hint(where: Where, findings: Mapping[str, Sequence[str]]) -> str:
    """One line on how to repair the damaged samples of a dataset of `twinlens generate`; empty if there are none.

    `findings` are those of `verify_place`, by name. Missing and changed files are damage, additional files are not.
    """
    damaged = {
        name
        for name, lines in findings.items()
        if name != MANIFEST and any(map(_is_damage, lines))
    }
    if not damaged:
        return ""
    which = "1 sample is damaged: delete its folder"
    if len(damaged) > 1:
        which = f"{len(damaged)} samples are damaged: delete their folders"
    with contextlib.suppress(FileError):
        if "made_with" in read_manifest(where).info:
            return f"{which} and rerun `twinlens generate`, which makes identical files"
    return ""


def _is_damage(finding: str) -> bool:
    return finding.endswith((_MISSING, "no such folder")) or _CHANGED in finding


def verify_sample(sample: StoredSample) -> list[str]:
    """Check a sample; one line per finding, none if it is correct. Never raises for the content of a file.

    With a row in dataset.json, or in .rows if it is pending, every file must exist with its SHA-256, and no other.
    Without a row the files must agree with each other. Of plain Middlebury folders, files are read and sizes compared.
    """
    try:
        hashes = hash_files(sample.folder)
    except FileError as error:
        return [str(error)]
    expected = sample.row.get("files", hashes)
    listed_in = sample.row.get("listed_in", MANIFEST)
    findings = [f"{name}: {_MISSING}" for name in expected if name not in hashes]
    for name, digest in hashes.items():
        if name not in expected:
            findings.append(f"{name}: is not listed in {listed_in}")
        elif digest != expected[name]:
            findings.append(f"{name}: {_CHANGED} {listed_in}")
    if findings:
        return findings
    content, findings = _read_files(sample, list(hashes))
    return findings or _check_sizes(content) or _check_truth(content)


def _open(folder: Place) -> tuple[Sequence[StoredSample], list[str]]:
    """The samples to check, and the findings on the dataset as a whole."""
    if not (folder / MANIFEST).is_file():
        dataset = Dataset(folder)
        is_sample = dataset[0].folder == folder
        if is_sample or not any(sample.has(MARK) for sample in dataset):
            return dataset, []  # neither it nor Middlebury's folders need a list
        finding = (
            f"is missing, so no checksums can be verified; {len(dataset)} found without it; "
            "if `twinlens generate` made them, rerun it to restore the file"
        )
        return dataset, [finding]
    try:
        manifest, samples, findings = _state(folder)
        if not samples and not _is_growing(manifest):
            Dataset(folder)  # raises: the list is empty
    except FileError as error:
        return samples_in(folder), [str(error).removeprefix(f"{folder / MANIFEST}: ")]
    complete = manifest.info.get("complete") is not False
    if complete:
        findings += _check_croissant(folder)
    return samples, findings


def _is_growing(manifest: Manifest) -> bool:
    """Whether `twinlens generate` has started the dataset and not finished it."""
    return manifest.info.get("complete") is False and "made_with" in manifest.info


def _state(folder: Place) -> tuple[Manifest, list[StoredSample], list[str]]:
    """The list of `folder`, its samples (the pending ones last), and findings. Raises FileError for the list.

    Other processes may be making samples. A sample's folder appears first, then its row, then its entry in
    dataset.json. They are read in this order, so a sample that moves on between two reads is found by the later one.
    """
    listed_before = {row.name for row in read_manifest(folder).rows}
    folders = list(_sample_folders(folder, listed_before))
    rows, errors = pending_rows(folder, listed_before)
    manifest = read_manifest(folder)
    listed = {row.name for row in manifest.rows}
    pending = {
        name: _pending_sample(folder, name, row)
        for name, row in rows.items()
        if name not in listed
    }
    unlisted = _outside_of(listed | set(pending), folders)
    if _is_growing(manifest):
        whole, excused = _without_row(folder, unlisted, manifest.recipe.get("count"))
        pending |= {name: StoredSample(folder / name, name) for name in whole}
        unlisted = [name for name in unlisted if name not in excused]
    findings = [line for name, line in errors.items() if name not in listed]
    findings += [
        f"{name}: is a sample that {MANIFEST} does not list"
        for name in sorted(unlisted)
    ]
    samples = [stored(folder, row) for row in manifest.rows]
    samples += [pending[name] for name in sorted(pending)]
    return manifest, samples, findings


def _pending_sample(folder: Place, name: str, row: Row | None) -> StoredSample:
    """A sample that dataset.json does not list yet; without a row if that is unreadable."""
    if row is None:
        return StoredSample(folder / name, name)
    return stored(folder, row, f"{ROWS}/{name}.json")


def _outside_of(samples: set[str], folders: Iterable[str]) -> list[str]:
    """The outermost of the `folders` that are neither one of the samples nor inside one."""
    outside: list[str] = []
    for name in sorted(folders, key=lambda name: name.count("/")):
        around = {name, *map(str, PurePosixPath(name).parents)}
        if around.isdisjoint(samples) and around.isdisjoint(outside):
            outside.append(name)
    return outside


def _without_row(
    folder: Place, unlisted: Sequence[str], count: Any
) -> tuple[set[str], set[str]]:
    """Complete samples of a recipe that have no row yet, and folders that are therefore no finding.

    They are being made, or were left by a killed process. A sample in a bucket appears file by file: one without its
    mark is being written, or will be overwritten.
    """
    whole = {
        name
        for name in unlisted
        if _is_of_recipe(name, count) and is_whole(folder / name)
    }
    if not isinstance(folder, RemotePath):
        return whole, whole
    begun = {name for name in unlisted if _is_of_recipe(name.partition("/")[0], count)}
    return whole, begun


def _is_of_recipe(name: str, count: Any) -> bool:
    """Whether `twinlens generate` gives this name to one of the `count` samples of a recipe."""
    return (
        isinstance(count, int)
        and name.isdecimal()
        and int(name) < count
        and name == f"{int(name):07d}"
    )


def _sample_folders(folder: Place, skipped: set[str]) -> Iterator[str]:
    """Names of the folders below `folder` that contain a sample's files, except for hidden and for skipped ones."""
    if isinstance(folder, RemotePath):
        paths = [name.rpartition("/") for name in folder.files()]
        parents = {parent for parent, _, name in paths if name in _SAMPLE_FILES}
        yield from (name for name in parents if name and not is_hidden(name))
        return
    walk = os.walk(folder, onerror=_unless_removed, followlinks=True)
    for path, below, files in walk:
        name = Path(path).relative_to(folder).as_posix()
        if name in skipped:
            below.clear()  # most files of a dataset are there
            continue
        below[:] = [child for child in below if not is_hidden(child)]
        if path != str(folder) and not {*_SAMPLE_FILES}.isdisjoint(files):
            yield name


def _unless_removed(error: OSError) -> None:
    if not isinstance(error, FileNotFoundError):  # removed since it was listed
        raise FileError(f"{error.filename}: {error.strerror}") from error


def _check_croissant(folder: Place) -> list[str]:
    """croissant.json contains the SHA-256 of the complete dataset.json."""
    if not (folder / CROISSANT).is_file():
        return []
    try:
        entries = json.loads(read_bytes(folder / CROISSANT))["distribution"]
        expected = [
            entry["sha256"] for entry in entries if entry.get("contentUrl") == MANIFEST
        ]
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError):
        return [f"{CROISSANT}: is damaged; `twinlens describe` rewrites it"]
    if expected != [hashlib.sha256(read_bytes(folder / MANIFEST)).hexdigest()]:
        return [
            f"{CROISSANT}: describes another {MANIFEST}; `twinlens describe` rewrites it"
        ]
    return []


def _read_files(sample: StoredSample, present: list[str]) -> tuple[_Content, list[str]]:
    """Read all files; the findings are of unreadable files and of missing images."""
    content = _Content()
    findings = []
    for name in present:
        path = sample.folder / name
        try:
            if (kind := parse_file(name)) is not None:
                content.views[kind] = sample.read_file(kind[0], path)
                content.names[kind] = name
            elif name == "calib.txt":
                content.calibration = read_calib(path)
            elif name == MARK:
                content.record = sample.file
        except FileError as error:
            reason = str(error).removeprefix(str(path)).lstrip(": ")
            findings.append(f"{name}: {reason}")
    findings += [
        f"{kind.name}: {_MISSING} (the image of view {kind.view})"
        for kind in content.required(is_truth=False)
        if kind.name not in present
    ]
    return content, findings


def _size_of(file: ViewFile, arrays: Mapping[str, Any]) -> Any:
    """(height, width) of the arrays of a file, by the first that has no other axis before; None if all have."""
    for channel in file.channels:
        is_map = channel.dtype != TEXTS and not channel.per_projector
        if is_map and channel.name in arrays:
            return arrays[channel.name].shape[:2]
    return None


def _check_sizes(content: _Content) -> list[str]:
    """Every array has the size of its camera; without a rig, that of calib.txt or of the first image."""
    if content.record is not None:
        sizes = {
            view: (camera.height, camera.width)
            for view, camera in enumerate(content.record.rig.cameras)
        }
    else:
        size = content.views[FileOf(IMAGE, 0)]["im"].shape[:2]
        if content.calibration is not None:
            size = (content.calibration.height, content.calibration.width)
        sizes = {0: size, 1: size}
    findings = []
    for kind, arrays in content.views.items():
        size = _size_of(kind.file, arrays)
        height, width = sizes.get(kind.view, size)
        if size not in (None, (height, width)):
            problem = f"is {size[1]} x {size[0]}, must be {width} x {height}"
            findings.append(f"{content.names[kind]}: {problem}")
    return findings


def _check_truth(content: _Content) -> list[str]:
    """sample.json, calib.txt and the arrays of all views agree."""
    if content.record is None:
        return []
    rig = content.record.rig.nominal
    findings = []
    try:
        check_seen(rig)
    except InputError as error:
        findings.append(f"sample.json: {error}")
    if content.calibration is not None:
        wrong = consistency.check_calibration(content.calibration, rig)
        findings += _named("calib.txt", wrong)
    elif len(rig) > 1 and rig.is_rectified():
        findings.append(
            f"calib.txt: {_MISSING} (the first two cameras are a rectified pair)"
        )
    expected = list(content.required(is_truth=True))
    if any(kind in content.views for kind in expected):
        findings += [
            f"{kind.name}: {_MISSING}" for kind in expected if kind not in content.views
        ]
    for view in range(len(rig)):
        if FileOf(TRUTH, view) in content.views:
            findings += _check_view(content, content.record, rig, view)
    return findings or _check_exchange(content, rig)


def _check_view(
    content: _Content, record: SampleFile, rig: Rig, view: int
) -> list[str]:
    """Relations between the arrays of a view, with sample.json, and with the truth of the partner."""
    findings: list[str] = []
    for lens, shot in enumerate(record.shots):
        channels = content.of_view(view, lens)
        content_of_view = consistency.ViewContent(channels, rig, view, shot.lens)
        for channel in CHANNELS.values():
            # What the lenses share is checked once, with the first.
            is_new = lens == 0 or channel.file.per_lens
            if channel.check is None or channel.name not in channels or not is_new:
                continue
            wrong = _findings_of(channel.check, content_of_view, content.dropped)
            findings += _named(channel.file.name(view, lens), wrong)
            if wrong and channel.is_basis:
                return findings
    truth = content.views[FileOf(TRUTH, view)]
    if not content.dropped & {"object_id", "object_names"}:
        objects = record.objects[view] if view < len(record.objects) else []
        wrong = consistency.check_objects(objects, truth, f"objects[{view}]")
        findings += _named(MARK, wrong)
    partner = rig.partner(view)
    if findings or partner is None or FileOf(TRUTH, partner) not in content.views:
        return findings
    if content.dropped & _OF_SHARED_POINTS:
        return []
    truths = truth, content.views[FileOf(TRUTH, partner)]
    wrong = consistency.check_shared_points(truths, rig, (view, partner))
    return _named(TRUTH.name(view), wrong)


def _findings_of(
    check: consistency.Check, content: consistency.ViewContent, dropped: Set[str]
) -> list[str]:
    """The findings of a check; none if it needs a channel that was dropped."""
    try:
        return check(content)
    except KeyError as error:
        if error.args[0] not in dropped:
            raise
        return []


def _check_exchange(content: _Content, rig: Rig) -> list[str]:
    """The images of neighbours are not exchanged."""
    findings = []
    for lens in range(content.num_lenses):
        for view in range(len(rig) - 1):
            channels = content.of_view(view, lens)
            if rig.partner(view) != view + 1 or not {"disp", "mask_nonocc"} <= set(
                channels
            ):
                continue
            right = content.views[FileOf(IMAGE, view + 1, lens)]["im"]
            wrong = consistency.check_exchange(
                (channels["im"], right), channels["disp"], channels["mask_nonocc"]
            )
            findings += _named(IMAGE.name(view, lens), wrong)
    return findings


def _named(name: str, findings: list[str]) -> list[str]:
    return [f"{name}: {finding}" for finding in findings]
