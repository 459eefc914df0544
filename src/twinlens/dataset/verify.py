"""Verification of one sample: files present and unchanged, readable, of the right size, and consistent.

Each step runs only if the previous one found nothing: checksums, readers, sizes, and the relations between arrays
(`twinlens.dataset.consistency`). A finding is one line that begins with a file name.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from twinlens.camera import Rig
from twinlens.dataset import consistency
from twinlens.dataset.codecs.calib import Calibration, read_calib
from twinlens.dataset.codecs.exr import read_exr
from twinlens.dataset.codecs.pfm import read_pfm
from twinlens.dataset.codecs.png import read_png
from twinlens.dataset.dataset import Dataset
from twinlens.dataset.manifest import NAME, hash_files
from twinlens.dataset.record import read
from twinlens.dataset.sample import lens_folder
from twinlens.dataset.stored import SampleFile, StoredSample
from twinlens.dataset.truth_files import read_truth
from twinlens.errors import FileError

_MISSING, _CHANGED = "is missing", "differs from its SHA-256 in"
_VIEW_FILE = re.compile(r"(?:lens-\d+/)?(im|disp|mask|truth|radiance)(\d+)(?:GT|nocc)?(\.png|\.pfm|\.exr)$")

_READERS: dict[str, Callable[[Any], Any]] = {
    ".png": read_png,
    ".pfm": read_pfm,
    ".exr": lambda path: read_truth(path) if path.name.startswith("truth") else read_exr(path).channels,
}

Content = dict[str, Any]
"""What the files of a sample hold, by name; sample.json as "rig" and "lenses"."""


def verify_sample(sample: StoredSample) -> list[str]:
    """Check a sample; one line per finding, none if it is correct. Never raises for the content of a file.

    With a row in dataset.json, or in .rows if it is pending, every file must exist with its SHA-256, and no other.
    Without a row the files must agree with each other. Of plain Middlebury folders, files are read and sizes compared.
    """
    try:
        hashes = hash_files(sample.folder)
    except FileError as error:
        return [str(error)]
    findings = _check_hashes(sample, hashes)
    if findings:
        return findings
    content, findings = _read_files(sample, list(hashes))
    return findings or _check_sizes(content) or _check_truth(content)


def is_damage(finding: str) -> bool:
    """Whether a finding reports a lost or changed file, which making the sample again repairs.

    >>> is_damage("im0.png: is missing"), is_damage("notes.txt: is not listed in dataset.json")
    (True, False)
    """
    return finding.endswith((_MISSING, "no such folder")) or _CHANGED in finding


def verify_dataset(dataset: Dataset) -> Iterator[tuple[str, list[str]]]:
    """(name, findings) of each sample; see `verify_sample`."""
    for sample in dataset:
        yield sample.name, verify_sample(sample)


def _check_hashes(sample: StoredSample, hashes: dict[str, str]) -> list[str]:
    expected = sample.row.get("files")
    if expected is None:
        return []
    listed_in = sample.row.get("listed_in", NAME)
    findings = [f"{name}: {_MISSING}" for name in expected if name not in hashes]
    for name, digest in hashes.items():
        if name not in expected:
            findings.append(f"{name}: is not listed in {listed_in}")
        elif digest != expected[name]:
            findings.append(f"{name}: {_CHANGED} {listed_in}")
    return findings


def _read_files(sample: StoredSample, present: list[str]) -> tuple[Content, list[str]]:
    content: Content = {}
    findings = []
    for name in present:
        path = sample.folder / name
        try:
            if _VIEW_FILE.match(name):
                content[name] = _READERS[path.suffix](path)
            elif name == "calib.txt":
                content[name] = read_calib(path)
            elif name == "sample.json":
                file = read(SampleFile, sample.record, path)
                content["rig"], content["lenses"] = file.rig.nominal, [shot.lens for shot in file.shots]
        except FileError as error:
            findings.append(f"{name}: {str(error).removeprefix(str(path)).lstrip(': ')}")
    views, lenses = len(content.get("rig", (0, 1))), len(content.get("lenses", (0,)))
    images = [(i, f"{lens_folder(k)}im{i}.png") for k in range(lenses) for i in range(views)]
    findings += [f"{name}: is missing (the image of view {i})" for i, name in images if name not in present]
    return content, findings


def _check_sizes(content: Content) -> list[str]:
    if "rig" in content:
        expected = {i: (camera.height, camera.width) for i, camera in enumerate(content["rig"].cameras)}
    elif "calib.txt" in content:
        expected = dict.fromkeys((0, 1), (content["calib.txt"].height, content["calib.txt"].width))
    else:
        expected = dict.fromkeys((0, 1), content["im0.png"].shape[:2])
    findings = []
    for name, value in content.items():
        if (view := _VIEW_FILE.match(name)) is not None:
            arrays = value.values() if isinstance(value, dict) else [value]
            size = next(array.shape[:2] for array in arrays if isinstance(array, np.ndarray))
            height, width = expected.get(int(view[2]), size)
            if size != (height, width):
                findings.append(f"{name}: is {size[1]} x {size[0]}, must be {width} x {height}")
    return findings


def _check_truth(content: Content) -> list[str]:
    if "rig" not in content:
        return []
    rig: Rig = content["rig"]
    findings = []
    if "calib.txt" in content:
        findings += _named("calib.txt", consistency.check_calibration(content["calib.txt"], rig))
    elif len(rig) > 1 and rig.is_rectified():
        findings.append("calib.txt: is missing (the first two cameras are a rectified pair)")
    findings += [f"{name}: is missing" for name in _expected_truth(content, rig) if name not in content]
    for i in range(len(rig)):
        if f"truth{i}.exr" in content:
            findings += _check_view(content, rig, i)
    return findings or _check_exchange(content, rig)


def _expected_truth(content: Content, rig: Rig) -> list[str]:
    """The truth files of a sample with truth: for each view, and for views with partners masks and disparities."""
    names = [f"truth{i}.exr" for i in range(len(rig))]
    if not any(name in content for name in (*names, "disp0.pfm", "mask0nocc.png")):
        return []
    for i in range(len(rig)):
        partner = rig.partner(i)
        if partner is not None:
            names.append(f"mask{i}nocc.png")
            names += [f"disp{i}.pfm"] if rig.is_rectified(*sorted((i, partner))) else []
    return names


def _check_view(content: Content, rig: Rig, i: int) -> list[str]:
    """Relations within the truth of view i, and with its partner's."""
    name, camera, partner = f"truth{i}.exr", rig.cameras[i], rig.partner(i)
    truth, disparity, mask = content[name], content.get(f"disp{i}.pfm"), content.get(f"mask{i}nocc.png")
    findings = _named(name, consistency.check_positions(truth, camera, rig.world_from_cams[i]))
    if findings:
        return findings
    findings += _named(name, consistency.check_ids(truth))
    findings += _named(name, consistency.check_blur(truth, camera, content["lenses"][0]))
    if disparity is not None:
        pair = tuple(sorted((i, i if partner is None else partner)))
        if partner is None or not rig.is_rectified(*pair):
            findings.append(f"disp{i}.pfm: is a disparity map, but the view is not in a rectified pair")
        else:
            calibration = Calibration.from_rig(rig.pair(*pair))
            findings += _named(f"disp{i}.pfm", consistency.check_disparity(truth, disparity, calibration))
    if mask is not None:
        known = truth["object_id"] > 0 if disparity is None else (truth["object_id"] > 0) | np.isfinite(disparity)
        findings += _named(f"mask{i}nocc.png", consistency.check_mask(mask, known, truth["visible"]))
    if not findings and partner is not None and f"truth{partner}.exr" in content:
        findings += _named(name, consistency.check_views((truth, content[f"truth{partner}.exr"]), rig, (i, partner)))
    return findings


def _check_exchange(content: Content, rig: Rig) -> list[str]:
    findings = []
    for k, i in ((k, i) for k in range(len(content["lenses"])) for i in range(len(rig) - 1)):
        disparity, mask = content.get(f"disp{i}.pfm"), content.get(f"mask{i}nocc.png")
        if rig.partner(i) == i + 1 and disparity is not None and mask is not None:
            left, right = (f"{lens_folder(k)}im{j}.png" for j in (i, i + 1))
            findings += _named(left, consistency.check_exchange((content[left], content[right]), disparity, mask))
    return findings


def _named(name: str, findings: list[str]) -> list[str]:
    return [f"{name}: {finding}" for finding in findings]
