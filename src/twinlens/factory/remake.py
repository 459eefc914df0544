"""Samples from stored ones: the same sample made again from its record, and rectified pairs.

In a rectified pair images are warped or rendered again; ground truth is never resampled.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ALIGNED, Misalignment, Rig
from twinlens.camera.rectification import rectify
from twinlens.camera.truth import Truth
from twinlens.dataset import Sample, Shot, StoredSample
from twinlens.dataset.record import FileModel, lens_from_plain, plain, read, rig_from_plain
from twinlens.errors import InputError, unknown
from twinlens.factory.sample import make_sample
from twinlens.factory.settings import ExposureTable, SensorTable
from twinlens.factory.sources import file_digests
from twinlens.rendering import Progress, ground_truth
from twinlens.scenes import Scene, load_scene
from twinlens.sensor import Exposure, Mismatch, Sensor

PICTURES = ("maps", "render")
ORIGIN = ("spec", "rejections", "sources_sha256", "rectified_from")
"""Keys of a record that `make_sample` does not write: the recipe's draw, or another sample."""


def remake(record: Mapping[str, Any], scene: Scene | None = None, *, progress: Progress | None = None) -> Sample:
    """Make the sample again whose sample.json is `record` (`StoredSample.record`).

    Its files are the same to the byte if backend and versions are those in the record. A bundled scene is found by its
    name; any other must be given as `scene`, as `load_scene` reads it.

    Raises InputError if the scene differs from the record's, or is neither bundled nor given; if the images were warped
    from others; or if `make_sample` did not write the record.
    """
    made = read(_Record, record, _FILE).record
    if (made.rectified_from or {}).get("pictures") == "maps":
        raise InputError("its images were warped from another sample's; rectify that sample again")
    scene = scene_of(record, scene)
    written = record["record"]  # the values as they were written, such as whole numbers
    mismatch = Mismatch(**written["sensor"].get("mismatch", {}))
    sample = make_sample(
        scene,
        rig_from_plain(record.get("rig")),
        [lens_from_plain(shot.get("lens")) for shot in record["shots"]],
        spp=made.spp,
        denoise=made.denoise is not None,
        noise=made.noise,
        seed=made.seed,
        sensor=Sensor(**{**written["sensor"], "mismatch": mismatch}),
        exposure=None if made.exposure is None else Exposure(**written["exposure"]),
        diffraction=made.diffraction,
        sky_disparity=made.sky_disparity,
        keep_radiance=made.keep_radiance,
        progress=progress,
    )
    origin = {key: written[key] for key in ORIGIN if key in written}
    return replace(sample, ndisp=(made.spec or {}).get("ndisp"), record={**sample.record, **origin})


class _Made(FileModel):
    scene: str
    scene_files: dict[str, str]
    spp: int
    denoise: dict[str, Any] | None = None
    noise: float | None = None
    seed: int
    sensor: SensorTable
    exposure: ExposureTable | None = None
    diffraction: bool
    sky_disparity: bool
    keep_radiance: bool
    spec: dict[str, Any] | None = None
    rectified_from: dict[str, Any] | None = None


class _Record(FileModel):
    """What `remake` needs of a sample.json."""

    record: _Made
    shots: list[dict[str, Any]]


_FILE = Path("sample.json")


def scene_of(record: Mapping[str, Any], given: Scene | None = None) -> Scene:
    """The scene of a sample's record: the given one, or the bundled one of that name. Its files must be unchanged.

    Raises InputError as `remake` does.
    """
    made = read(_Record, record, _FILE).record
    try:
        scene = given or load_scene(made.scene)
    except InputError as error:
        raise InputError(
            f"scene {made.scene!r} is not bundled; give it, as load_scene reads it from its file"
        ) from error
    if (scene.name, file_digests(scene)) != (made.scene, made.scene_files):
        raise InputError(f"scene {scene.name!r} is not the one that the record names: its files have changed")
    return scene


def rectified_sample(
    stored: StoredSample,
    scene: Scene | None = None,
    left: int = 0,
    right: int = 1,
    *,
    pictures: str = "maps",
    fit: str = "focal",
    zero_doffs: bool = True,
    misalignment: Misalignment = ALIGNED,
    progress: Progress | None = None,
) -> Sample:
    """Views `left` and `right` of a stored sample as a rectified pair (`rectification.rectify`), with exact truth.

    scene : the sample's; not needed for a bundled one.
    pictures : "maps" warps the stored images (bilinear; black outside them, where no point counts as visible), as
        software does after a calibration. "render" renders the scene again through the rectified cameras.
    fit, zero_doffs, misalignment : see `rectify`. A misalignment affects the images; the ground truth is that of the
        aligned pair.

    Raises InputError for a pair that cannot be rectified, and for a scene that is not the sample's.
    """
    if pictures not in PICTURES:
        raise unknown("pictures", pictures, PICTURES)
    scene = scene_of(stored.record, scene)
    made = {key: value for key, value in stored.record["record"].items() if key not in ORIGIN}
    result = rectify(stored.rig, left, right, fit=fit, zero_doffs=zero_doffs, misalignment=misalignment)
    origin = {"rectified_from": {"sample": stored.name, "views": [left, right], "fit": fit, "pictures": pictures}}
    if pictures == "render":
        new = {**stored.record, "record": made, "rig": plain(result.rectified_rig)}
        sample = remake(new, scene, progress=progress)
        return replace(sample, record={**sample.record, **origin})
    shots = []
    for shot in map(stored.lens, range(stored.num_lenses)):
        images = tuple(result.warp(side, shot.image(view)) for side, view in enumerate((left, right)))
        shots.append(Shot(shot.lens, images, record=shot.record))
    truths, valid = [], [result.valid(side) for side in (0, 1)]
    for side, truth in enumerate(ground_truth(scene, result.aligned_rig, sky_disparity=made["sky_disparity"])):
        pictured = _pictured(truth, side, result.aligned_rig, valid)
        truths.append(replace(truth, visible=truth.visible & pictured))
    record = {**made, "keep_radiance": False, **origin}
    return Sample(result.rectified_rig, tuple(shots), tuple(truths), record=record)


def _pictured(truth: Truth, side: int, rig: Rig, valid: list[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Whether both rectified images have data at a pixel's point."""
    other = 1 - side
    seen = rig.project(other, np.where(truth.hit[..., None], truth.position, np.nan))
    inside = rig.cameras[other].contains(seen)
    u, v = np.floor(np.where(inside[..., None], seen, 0.0) + 0.5).astype(int).transpose(2, 0, 1)
    there = inside & valid[other][v, u]
    pictured: NDArray[np.bool_] = valid[side] & (there | ~truth.hit)
    return pictured
