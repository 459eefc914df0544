"""Verification: a dataset's list and folders, and each sample's files.

A sample is checked in steps, each only if the previous one found nothing: checksums, readers, sizes, and the relations
between arrays (`twinlens.dataset.consistency`). A finding is one line that begins with a file name.
"""

import contextlib
import hashlib
import itertools
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from twinlens.camera import Rig
from twinlens.camera.rig import check_seen
from twinlens.dataset import consistency
from twinlens.dataset.codecs.calib import Calibration, read_calib
from twinlens.dataset.codecs.exr import read_exr
from twinlens.dataset.codecs.pfm import read_pfm
from twinlens.dataset.codecs.png import read_png
from twinlens.dataset.dataset import (
    MANIFEST,
    ROWS,
    Dataset,
    Manifest,
    pending_rows,
    read_manifest,
    stored,
)
from twinlens.dataset.files import hash_files, is_hidden, read_bytes
from twinlens.dataset.metadata import CROISSANT
from twinlens.dataset.sample import lens_folder, rectified_pair
from twinlens.dataset.storage import MARK, Place, RemotePath, Where, is_whole, place
from twinlens.dataset.stored import StoredSample, samples_in
from twinlens.dataset.truth_files import read_truth
from twinlens.errors import FileError, InputError

_SAMPLE_FILES = (MARK, "im0.png")
_MISSING, _CHANGED = "is missing", "differs from its SHA-256 in"
_VIEW_FILE = re.compile(
    r"(?:lens-\d+/)?(im|disp|mask|truth|radiance|dp-left|dp-right|dp-disp)(\d+)(?:GT|nocc)?(\.png|\.pfm|\.exr)$"
)

_READERS: dict[str, Callable[[Any], Any]] = {
    ".png": read_png,
    ".pfm": read_pfm,
    ".exr": lambda path: (
        read_truth(path) if path.name.startswith("truth") else read_exr(path).channels
    ),
}

Content = dict[str, Any]
"""What the files of a sample hold, by name; sample.json as "rig" and "lenses"."""


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
    parts, actions = [f"{MANIFEST} lists {listed} of {count} samples"], []
    if pending:
        note = f" ({unhashed} without checksums)" if unhashed else ""
        parts.append(f"{len(pending)} made but not listed yet{note}")
        actions = ["list the finished ones"]
    if num_failed:
        parts.append(f'{num_failed} failed ("failed" in it says why)')
    if listed + len(pending) + num_failed < count:
        actions.insert(0, "make the missing samples")
    return "; ".join(
        [*parts, f"rerun `twinlens generate` to {' and '.join(actions)}"]
        if actions
        else parts
    )


def repair_hint(where: Where, findings: Mapping[str, Sequence[str]]) -> str:
    """One line on how to repair the damaged samples of a dataset of `twinlens generate`; empty if there are none.

    `findings` are those of `verify_place`, by name. Missing and changed files are damage, additional files are not.
    """
    lost = (_MISSING, "no such folder")
    damaged = {
        name
        for name, lines in findings.items()
        if any(x.endswith(lost) or _CHANGED in x for x in lines)
    }
    count = len(damaged - {MANIFEST})
    which = (
        f"{count} samples are damaged: delete their folders"
        if count > 1
        else "1 sample is damaged: delete its folder"
    )
    with contextlib.suppress(FileError):
        if count and "made_with" in read_manifest(where).info:
            return f"{which} and rerun `twinlens generate`, which makes identical files"
    return ""


def verify_sample(sample: StoredSample) -> list[str]:
    """Check a sample; one line per finding, none if it is correct. Never raises for the content of a file.

    With a row in dataset.json, or in .rows if it is pending, every file must exist with its SHA-256, and no other.
    Without a row the files must agree with each other. Of plain Middlebury folders, files are read and sizes compared.
    """
    try:
        hashes = hash_files(sample.folder)
    except FileError as error:
        return [str(error)]
    expected, listed_in = (
        sample.row.get("files", hashes),
        sample.row.get("listed_in", MANIFEST),
    )
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
        if dataset[0].folder == folder or not any(
            sample.has(MARK) for sample in dataset
        ):
            return (
                dataset,
                [],
            )  # a single sample and plain Middlebury folders need no list
        lost = f"is missing, so no checksums can be verified; {len(dataset)} found without it"
        return dataset, [
            f"{lost}; if `twinlens generate` made them, rerun it to restore the file"
        ]
    try:
        manifest, samples, findings = _state(folder)
        if not samples and not _is_growing(manifest):
            Dataset(folder)  # raises: the list is empty
    except FileError as error:
        return samples_in(folder), [str(error).removeprefix(f"{folder / MANIFEST}: ")]
    complete = manifest.info.get("complete") is not False
    return samples, findings + (_check_croissant(folder) if complete else [])


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
        name: StoredSample(folder / name, name)
        if row is None
        else stored(folder, row, f"{ROWS}/{name}.json")
        for name, row in rows.items()
        if name not in listed
    }
    known, unlisted = listed | set(pending), list[str]()
    for name in sorted(folders, key=lambda name: name.count("/")):
        if not {name, *map(str, PurePosixPath(name).parents)} & {*known, *unlisted}:
            unlisted.append(name)
    if _is_growing(
        manifest
    ):  # samples of the recipe without a row are being made, or left after a kill
        count = manifest.recipe.get("count")
        own = [
            name for name in unlisted if _is_of_recipe(name.partition("/")[0], count)
        ]
        whole = [
            name
            for name in own
            if _is_of_recipe(name, count) and is_whole(folder / name)
        ]
        pending |= {name: StoredSample(folder / name, name) for name in whole}
        # In a bucket a sample appears file by file: one without its mark is being written, or will be overwritten.
        unlisted = [
            name
            for name in unlisted
            if name not in (own if isinstance(folder, RemotePath) else whole)
        ]
    findings = [line for name, line in errors.items() if name not in listed]
    findings += [
        f"{name}: is a sample that {MANIFEST} does not list"
        for name in sorted(unlisted)
    ]
    samples = [
        *(stored(folder, row) for row in manifest.rows),
        *(pending[name] for name in sorted(pending)),
    ]
    return manifest, samples, findings


def _is_of_recipe(name: str, count: Any) -> bool:
    """Whether `twinlens generate` gives this name to one of the `count` samples of a recipe."""
    return (
        isinstance(count, int)
        and name.isdecimal()
        and int(name) < count
        and name == f"{int(name):07d}"
    )


def _sample_folders(folder: Place, known: set[str]) -> Iterator[str]:
    """Names of the folders below `folder` that contain a sample's files, except for hidden ones."""
    if isinstance(folder, RemotePath):
        found = {
            name.rpartition("/")[0]
            for name in folder.files()
            if name.rpartition("/")[2] in _SAMPLE_FILES
        }
        yield from (name for name in found if name and not is_hidden(name))
        return
    for path, below, files in os.walk(
        folder, onerror=_unless_removed, followlinks=True
    ):
        name = Path(path).relative_to(folder).as_posix()
        # Most files of a dataset are in known folders: skip those.
        below[:] = [each for each in below if name not in known and not is_hidden(each)]
        if (
            name not in known
            and path != str(folder)
            and not {*_SAMPLE_FILES}.isdisjoint(files)
        ):
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


def _read_files(sample: StoredSample, present: list[str]) -> tuple[Content, list[str]]:
    content: Content = {}
    findings = []
    for name in present:
        path = sample.folder / name
        try:
            if _VIEW_FILE.match(name):
                content[name] = _READERS[name[-4:]](path)
            elif name == "calib.txt":
                content[name] = read_calib(path)
            elif name == "sample.json":
                file = sample.file
                content["rig"], content["lenses"] = (
                    file.rig.nominal,
                    [shot.lens for shot in file.shots],
                )
                content["objects"] = file.objects
                dual = file.record.get("dual_pixel") is True
                content["dual"] = [
                    k
                    for k, lens in enumerate(content["lenses"])
                    if dual and lens.aperture_diameter > 0
                ]
        except FileError as error:
            findings.append(
                f"{name}: {str(error).removeprefix(str(path)).lstrip(': ')}"
            )
    views, lenses = len(content.get("rig", (0, 1))), len(content.get("lenses", (0,)))
    images = [
        (i, f"{lens_folder(k)}im{i}.png") for k in range(lenses) for i in range(views)
    ]
    images += [
        (i, f"{lens_folder(k)}dp-{half}{i}.png") for k, i, half in _halves(content)
    ]
    findings += [
        f"{name}: is missing (the image of view {i})"
        for i, name in images
        if name not in present
    ]
    return content, findings


def _check_sizes(content: Content) -> list[str]:
    calibration = content.get("calib.txt")
    size = (
        (calibration.height, calibration.width)
        if calibration
        else content["im0.png"].shape[:2]
    )
    cameras = content["rig"].cameras if "rig" in content else ()
    expected = {
        i: (camera.height, camera.width) for i, camera in enumerate(cameras)
    } or {0: size, 1: size}
    findings = []
    for view in filter(None, map(_VIEW_FILE.match, content)):
        value = content[view[0]]
        size = (
            value if isinstance(value, np.ndarray) else next(iter(value.values()))
        ).shape[:2]
        height, width = expected.get(int(view[2]), size)
        if size != (height, width):
            findings.append(
                f"{view[0]}: is {size[1]} x {size[0]}, must be {width} x {height}"
            )
    return findings


def _check_truth(content: Content) -> list[str]:
    if "rig" not in content:
        return []
    rig: Rig = content["rig"]
    findings = []
    try:
        check_seen(rig)
    except InputError as error:
        findings.append(f"sample.json: {error}")
    if "calib.txt" in content:
        findings += _named(
            "calib.txt", consistency.check_calibration(content["calib.txt"], rig)
        )
    elif len(rig) > 1 and rig.is_rectified():
        findings.append(
            "calib.txt: is missing (the first two cameras are a rectified pair)"
        )
    views = range(len(rig))
    expected = [f"truth{i}.exr" for i in views]
    expected += [f"mask{i}nocc.png" for i in views if rig.partner(i) is not None]
    expected += [f"disp{i}.pfm" for i in views if rectified_pair(rig, i) is not None]
    expected += [
        f"{lens_folder(k)}dp-disp{i}.pfm" for k in content["dual"] for i in views
    ]
    if any(name in content for name in expected):
        findings += [f"{name}: is missing" for name in expected if name not in content]
    for i in views:
        if f"truth{i}.exr" in content:
            findings += _check_view(content, rig, i)
    return findings or _check_exchange(content, rig)


def _check_view(content: Content, rig: Rig, i: int) -> list[str]:
    """Relations within the truth of view i, and with its partner's."""
    name, camera, partner = f"truth{i}.exr", rig.cameras[i], rig.partner(i)
    truth, disparity, mask = (
        content[name],
        content.get(f"disp{i}.pfm"),
        content.get(f"mask{i}nocc.png"),
    )
    if findings := _named(
        name, consistency.check_positions(truth, camera, rig.world_from_cams[i])
    ):
        return findings
    blur = consistency.check_blur(truth, camera, content["lenses"][0])
    light = consistency.check_projections(truth, rig)
    findings, known = (
        _named(name, consistency.check_ids(truth) + blur + light),
        truth["object_id"] > 0,
    )
    for k in content["dual"]:
        own = f"{lens_folder(k)}dp-disp{i}.pfm"
        if own in content:
            findings += _named(
                own,
                consistency.check_dual_pixels(
                    truth, content[own], camera, content["lenses"][k]
                ),
            )
    objects = dict(enumerate(content["objects"])).get(i, [])
    findings += _named(
        "sample.json", consistency.check_objects(objects, truth, f"objects[{i}]")
    )
    if disparity is not None:
        known |= np.isfinite(disparity)
        if (pair := rectified_pair(rig, i)) is None:
            findings.append(
                f"disp{i}.pfm: is a disparity map, but the view is not in a rectified pair"
            )
        else:
            calibration = Calibration.from_rig(rig.pair(*pair))
            findings += _named(
                f"disp{i}.pfm",
                consistency.check_disparity(truth, disparity, calibration),
            )
    if mask is not None:
        findings += _named(
            f"mask{i}nocc.png", consistency.check_mask(mask, known, truth["visible"])
        )
    if not findings and partner is not None and f"truth{partner}.exr" in content:
        findings = _named(
            name,
            consistency.check_views(
                (truth, content[f"truth{partner}.exr"]), rig, (i, partner)
            ),
        )
    return findings


def _check_exchange(content: Content, rig: Rig) -> list[str]:
    findings = []
    for k, i in itertools.product(range(len(content["lenses"])), range(len(rig) - 1)):
        disparity, mask = content.get(f"disp{i}.pfm"), content.get(f"mask{i}nocc.png")
        if rig.partner(i) == i + 1 and disparity is not None and mask is not None:
            left, right = (f"{lens_folder(k)}im{j}.png" for j in (i, i + 1))
            findings += _named(
                left,
                consistency.check_exchange(
                    (content[left], content[right]), disparity, mask
                ),
            )
    return findings


def _halves(content: Content) -> Iterator[tuple[int, int, str]]:
    """Number of lens, view and name of each image of halves of dual pixels that the sample must have."""
    return itertools.product(
        content.get("dual", ()), range(len(content.get("rig", ()))), ("left", "right")
    )


def _named(name: str, findings: list[str]) -> list[str]:
    return [f"{name}: {finding}" for finding in findings]
