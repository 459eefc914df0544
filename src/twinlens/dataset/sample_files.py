"""The files of a sample, as pure functions of its arrays. docs/format.md describes them.

`sample_files` encodes without touching the disk, so a thread can encode one sample while the next is rendered;
`write_sample` writes atomically.
"""

import hashlib
import math
from typing import Any

import numpy as np

import twinlens
from twinlens.camera import Paraxial
from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.dataset.channels import CHANNELS, view_files
from twinlens.dataset.codecs.calib import Calibration, encode_calib, tidy
from twinlens.dataset.codecs.ply import encode_ply
from twinlens.dataset.files import check_replaceable, write_folder
from twinlens.dataset.record import encode_json, plain
from twinlens.dataset.sample import KIND, VERSION, Sample, Shot, shot_folder
from twinlens.dataset.statistics import KEY, statistics
from twinlens.dataset.storage import MARK, RemotePath, Where, place
from twinlens.errors import check_known

CONVENTIONS = {
    "camera_frame": "x right, y down, z forward; metres",
    "pixel_centres": "at integers: the image spans -0.5 to width - 0.5; arrays are [y, x], row 0 at the top",
    "disparity": "u_left - u_right in pixels; z = fx * baseline / (d + doffs); unknown is +inf",
    "depth": "z along the optical axis; +inf where nothing was hit",
    "world_from_cams": "4x4, a point's world coordinates from its camera coordinates",
    "dp-disp": "u in dp-left - u in dp-right, pixels: positive before the plane of focus; unknown is +inf",
    "mask_nonocc": "255 visible in both views, 128 occluded or out of frame, 0 unknown",
    "ids": "0 nothing hit, else 1 + index into the list of names",
    "objects": "per view; pixel boxes are u, v, width, height, all 0 if empty; silhouettes are COCO's run-length code",
    "blur_circle_px": "signed diameter, aperture_diameter * fx * (1/z - vergence); positive before the plane of focus",
}
WIDTH_OF_BLUR = (
    "signed width of the blur circle along the rows; positive before the plane of focus"
)
"""What `blur_circle_px` is for a lens that is not paraxial, which has no vergence."""


def sample_files(sample: Sample) -> dict[str, bytes]:
    """All files of the sample, relative name -> content. The same sample gives the same bytes.

    Raises InputError if an array does not fit its file, and for a channel of a truth that `CHANNELS` has no row of.
    """
    for truth in sample.truths:
        for name in truth.extra:
            check_known("channel", name, CHANNELS)
    files: dict[str, bytes] = {}
    for view in range(len(sample.rig)):
        for file in view_files():
            for lens in range(len(sample.shots) if file.per_lens else 1):
                content = file.encode(sample, view, lens)
                if content is not None:
                    files[file.name(view, lens)] = content
    for frame in range(1, sample.num_frames):
        files |= _frame_files(sample.at_frame(frame), frame)
    if sample.is_rectified:
        files["calib.txt"] = encode_calib(_calibration(sample)).encode()
    for name, (vertices, faces) in sample.models.items():
        files[f"models/{name}.ply"] = encode_ply(vertices, faces)
    files["sample.json"] = encode_json(_record(sample))
    return files


def _frame_files(sample: Sample, frame: int) -> dict[str, bytes]:
    """The files of a frame after the first, from the sample with the images of this frame."""
    files: dict[str, bytes] = {}
    for file in view_files():
        if not file.per_frame:
            continue
        for lens in range(len(sample.shots)):
            for view in range(len(sample.rig)):
                content = file.encode(sample, view, lens)
                if content is not None:
                    files[file.name(view, lens, frame)] = content
    return files


def write_sample(
    folder: Where, sample: Sample, overwrite: bool = False
) -> dict[str, str]:
    """Write the sample as `folder`, atomically; returns relative name -> SHA-256 of its files, sorted by name.

    Raises OutputError if the folder cannot be written, or exists (unless `overwrite` is set and it is a sample or
    empty); nothing is left behind. Raises InputError if an array does not fit its file format.
    """
    folder = place(folder)
    # `fill_remote` checks remote folders.
    if overwrite and not isinstance(folder, RemotePath):
        check_replaceable(folder, (folder / MARK).is_file(), "a sample")
    files = sample_files(sample)
    write_folder(folder, files, overwrite)
    return {name: hashlib.sha256(files[name]).hexdigest() for name in sorted(files)}


def _calibration(sample: Sample) -> Calibration:
    """calib.txt of the first pair, with the bounds of its true disparities."""
    rig = sample.rig.nominal
    disparities = [truth.disparity.ravel() for truth in sample.truths[:2]]
    values = np.concatenate([*disparities, np.empty(0, np.float32)])
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Calibration.from_rig(rig, sample.ndisp)
    low, high = math.floor(finite.min()), math.ceil(finite.max())
    ndisp = sample.ndisp or max(high + 1, 1)
    return Calibration.from_rig(rig, ndisp).replace(vmin=float(low), vmax=float(high))


def _conventions(sample: Sample) -> dict[str, str]:
    """`CONVENTIONS`, with the blur of the lens that `blur_circle_px` belongs to."""
    if not sample.shots or isinstance(sample.shots[0].lens, Paraxial):
        return CONVENTIONS
    return {**CONVENTIONS, "blur_circle_px": WIDTH_OF_BLUR}


def _shot_record(number: int, shot: Shot) -> dict[str, Any]:
    """The entry of a shot in sample.json."""
    entry = {
        "folder": shot_folder(number) or "./",
        "lens": plain(shot.lens),
        "record": plain(shot.record),
    }
    if shot.frames:
        entry["frames"] = [plain(frame.record) for frame in shot.frames]
    return entry


def _record(sample: Sample) -> dict[str, Any]:
    """The content of sample.json."""
    rig = sample.rig.nominal
    pair = None
    if len(rig) > 1:
        pair = {"baseline": tidy(rig.baseline()), "doffs_px": rig.doffs()}
    shots = [_shot_record(number, shot) for number, shot in enumerate(sample.shots)]
    truth = sample.truths[0] if sample.truths else None
    return {
        "format": KIND,
        "version": VERSION,
        "twinlens": twinlens.__version__,
        "conventions": _conventions(sample),
        "rig": plain(sample.rig),
        "rectified": sample.is_rectified,
        "pair": pair,
        "shots": shots,
        "object_names": truth.object_names if truth else (),
        "material_names": truth.material_names if truth else (),
        "material_kinds": MATERIAL_KINDS,
        "objects": [plain(truth.objects) for truth in sample.truths],
        KEY: statistics(sample),
        "record": plain(sample.record),
    }
