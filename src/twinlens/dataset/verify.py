"""Is a sample what it says it is: files there and unchanged, readable, of one size, and true to each other.

Three steps, each only when the one before found nothing: the files against their checksums, each file by its reader,
and the laws between their arrays (`twinlens.dataset.laws`). A finding is one line that begins with a file's name.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.dataset import laws
from twinlens.dataset.codecs.calib import Calibration, read_calib
from twinlens.dataset.codecs.exr import read_exr
from twinlens.dataset.codecs.pfm import read_pfm
from twinlens.dataset.codecs.png import read_png
from twinlens.dataset.dataset import Dataset
from twinlens.dataset.manifest import NAME, checksums
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.truth_files import read_truth
from twinlens.errors import FileError

_LOST, _CHANGED = "is missing", "differs from its SHA-256 in"
_VIEW = re.compile(r"(?:lens-\d+/)?(im|disp|mask|truth|radiance)(\d+)(?:GT|nocc)?(\.png|\.pfm|\.exr)$")

_READERS: dict[str, Callable[[Any], Any]] = {
    ".png": read_png,
    ".pfm": read_pfm,
    ".exr": lambda path: read_truth(path) if path.name.startswith("truth") else read_exr(path).channels,
}


def verify_sample(sample: StoredSample) -> list[str]:
    """What is wrong with a sample, one line a finding; empty when all is well. Never raises for what a file holds.

    With a row of dataset.json, or one that waits to be listed there, every file must be there with its SHA-256 and no
    other; without one the files that are there must agree. Plain Middlebury folders are read and their sizes compared.
    """
    findings = _unlike_their_checksums(sample)
    if findings:
        return findings
    try:
        present = list(checksums(sample.folder))
    except FileError as error:
        return [str(error)]
    content, findings = _contents(sample, present)
    return findings or _sizes(content) or _truths(content)


def is_of_damage(finding: str) -> bool:
    """Whether a finding is of what was lost or changed since the sample was made, and not of what it was made with.

    >>> is_of_damage("im0.png: is missing"), is_of_damage("notes.txt: is not listed in dataset.json")
    (True, False)
    """
    return finding.endswith((_LOST, "no such folder")) or _CHANGED in finding


def verify_dataset(dataset: Dataset) -> Iterator[tuple[str, list[str]]]:
    """(name, findings) of each sample in turn; see `verify_sample`."""
    for sample in dataset:
        yield sample.name, verify_sample(sample)


def _unlike_their_checksums(sample: StoredSample) -> list[str]:
    if "files" not in sample.row:
        return []
    stated, stands_in = sample.row["files"], sample.row.get("stands_in", NAME)
    try:
        found = checksums(sample.folder)
    except FileError as error:
        return [str(error)]
    missing = [f"{name}: {_LOST}" for name in stated if name not in found]
    changed = [f"{name}: {_CHANGED} {stands_in}" for name in found if found[name] != stated.get(name)]
    added = {name: f"{name}: is not listed in {stands_in}" for name in found if name not in stated}
    return missing + [added.get(line.partition(":")[0], line) for line in changed]


def _contents(sample: StoredSample, present: list[str]) -> tuple[dict[str, Any], list[str]]:
    """Each file of a sample's own names by its reader, and what the readers refused."""
    content: dict[str, Any] = {}
    findings = []
    for name in present:
        path = sample.folder / name
        try:
            if _VIEW.match(name):
                content[name] = _READERS[path.suffix](path)
            elif name == "calib.txt":
                content[name] = read_calib(path)
            elif name == "sample.json":
                content["rig"] = sample.rig
                content["lenses"] = [sample.lens(k).lens for k in range(sample.num_lenses)]
        except FileError as error:
            findings.append(f"{name}: {str(error).removeprefix(str(path)).lstrip(': ')}")
    for i, name in _expected_images(content):
        if name not in present:
            findings.append(f"{name}: is missing (the image of view {i})")
    return content, findings


def _expected_images(content: dict[str, Any]) -> list[tuple[int, str]]:
    views = len(content["rig"]) if "rig" in content else 2
    folders = [f"lens-{k}/" if k else "" for k in range(len(content.get("lenses", [0])))]
    return [(i, f"{folder}im{i}.png") for folder in folders for i in range(views)]


def _sizes(content: dict[str, Any]) -> list[str]:
    expected = _expected_sizes(content)
    findings = []
    for name, value in content.items():
        view = _VIEW.match(name)
        if view is None:
            continue
        arrays = value.values() if isinstance(value, dict) else [value]
        size = next(array.shape[:2] for array in arrays if isinstance(array, np.ndarray))
        wanted = expected.get(int(view[2]), size)
        if size != wanted:
            findings.append(f"{name}: is {size[1]} x {size[0]}, and must be {wanted[1]} x {wanted[0]}")
    return findings


def _expected_sizes(content: dict[str, Any]) -> dict[int, tuple[int, int]]:
    if "rig" in content:
        return {i: (camera.height, camera.width) for i, camera in enumerate(content["rig"].cameras)}
    if "calib.txt" in content:
        return dict.fromkeys((0, 1), (content["calib.txt"].height, content["calib.txt"].width))
    return dict.fromkeys((0, 1), content["im0.png"].shape[:2])


def _truths(content: dict[str, Any]) -> list[str]:
    if "rig" not in content:
        return []
    rig: Rig = content["rig"]
    findings = []
    if "calib.txt" in content:
        findings += _named("calib.txt", laws.calibration_agrees(content["calib.txt"], rig))
    elif len(rig) > 1 and rig.is_rectified():
        findings.append("calib.txt: is missing (the first two cameras are a rectified pair)")
    findings += _missing_truth(content, rig)
    for i in range(len(rig)):
        if f"truth{i}.exr" in content:
            findings += _view_of(content, rig, i)
    return findings or _exchanged(content, rig)


def _missing_truth(content: dict[str, Any], rig: Rig) -> list[str]:
    """A view with truth has partners with truth, and masks, and disparities where the two are rectified."""
    names = [f"truth{i}.exr" for i in range(len(rig))]
    if not any(name in content for name in (*names, "disp0.pfm", "mask0nocc.png")):
        return []
    for i in range(len(rig)):
        partner = rig.partner(i)
        if partner is not None:
            names.append(f"mask{i}nocc.png")
            names += [f"disp{i}.pfm"] if rig.is_rectified(*sorted((i, partner))) else []
    return [f"{name}: is missing" for name in names if name not in content]


def _exchanged(content: dict[str, Any], rig: Rig) -> list[str]:
    findings = []
    for k, i in ((k, i) for k in range(len(content["lenses"])) for i in range(len(rig) - 1)):
        folder, maps = f"lens-{k}/" if k else "", (f"disp{i}.pfm", f"mask{i}nocc.png")
        partner = rig.partner(i)
        if partner == i + 1 and all(name in content for name in maps):
            images = (content[f"{folder}im{i}.png"], content[f"{folder}im{partner}.png"])
            findings += _named(f"{folder}im{i}.png", laws.eyes_agree(images, content[maps[0]], content[maps[1]]))
    return findings


def _view_of(content: dict[str, Any], rig: Rig, i: int) -> list[str]:
    """The laws of view i's truth, alone and with its partner."""
    truth = content[f"truth{i}.exr"]
    findings = _named(f"truth{i}.exr", laws.positions_agree(truth, rig.cameras[i], rig.world_from_cams[i]))
    if findings:
        return findings
    findings += _named(f"truth{i}.exr", laws.ids_agree(truth))
    findings += _named(f"truth{i}.exr", laws.blur_agrees(truth, rig.cameras[i], content["lenses"][0]))
    disparity = content.get(f"disp{i}.pfm")
    if disparity is not None:
        findings += _named(f"disp{i}.pfm", _disparity_agrees(truth, disparity, rig, i))
    if f"mask{i}nocc.png" in content:
        known = truth["object_id"] > 0
        if disparity is not None:
            known = known | np.isfinite(disparity)
        mask = content[f"mask{i}nocc.png"]
        findings += _named(f"mask{i}nocc.png", laws.mask_agrees(mask, known, truth["visible"]))
    partner = rig.partner(i)
    if not findings and partner is not None and f"truth{partner}.exr" in content:
        pair = (truth, content[f"truth{partner}.exr"])
        findings += _named(f"truth{i}.exr", laws.views_agree(pair, rig, (i, partner)))
    return findings


def _disparity_agrees(truth: laws.Arrays, disparity: NDArray[np.float32], rig: Rig, i: int) -> list[str]:
    partner = rig.partner(i)
    left, right = sorted((i, i if partner is None else partner))
    if left == right or not rig.is_rectified(left, right):
        return ["holds disparities, and the view is one of no rectified pair"]
    return laws.disparity_agrees(truth, disparity, Calibration.from_rig(rig.pair(left, right)))


def _named(name: str, findings: list[str]) -> list[str]:
    return [f"{name}: {finding}" for finding in findings]
