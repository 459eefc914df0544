"""Samples from stored ones: a sample rendered again from its record, and rectified pairs.

Images of a rectified pair are warped or rendered again; ground truth is computed, never resampled.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, create_model

from twinlens.camera import ALIGNED, Misalignment, Rig
from twinlens.camera.rectification import Rectification, rectify
from twinlens.camera.truth import Truth
from twinlens.dataset import Sample, Shot, StoredSample
from twinlens.dataset.record import LENS, RIG, FileModel, plain, read
from twinlens.errors import InputError, check_known, format_value, located
from twinlens.factory.objects import with_objects
from twinlens.factory.produce import under_sky
from twinlens.factory.sample import Shoot, make_sample
from twinlens.factory.settings import ExposureTable, SceneTable, SensorTable
from twinlens.factory.sources import file_digests
from twinlens.rendering import Progress, ground_truth
from twinlens.scenes import Scene, load_scene
from twinlens.schema import declared
from twinlens.sensor import Sensor
from twinlens.settings import fields_of

PICTURES = ("maps", "render")
ORIGIN = ("spec", "rejections", "sources_sha256", "rectified_from")
"""Keys of a record that state where a sample comes from; `make_sample` does not write them."""


def remake(
    record: Mapping[str, Any],
    scene: Scene | None = None,
    *,
    folder: str | Path = ".",
    progress: Progress | None = None,
) -> Sample:
    """Render the sample again whose sample.json is `record` (`StoredSample.record`).

    Its files are the same to the byte if backend and versions are those in the record. A bundled scene is found by its
    name; any other must be given as `scene`, as `load_scene` reads it. The sky and the objects of the sample's recipe
    are added to it.

    folder : of the recipe, whose sky and objects have files relative to it.

    Raises InputError if the scene differs from the record's, or is neither bundled nor given; if the images were warped
    from others; or if `make_sample` did not write the record.
    """
    if not isinstance(record, Mapping):
        raise InputError(
            f"record must be a sample's, such as Dataset('out')[0].record, got {format_value(record)}"
        )
    settings = read(_Record, record, _FILE).record
    if (settings.rectified_from or {}).get("pictures") == "maps":
        raise InputError(
            "its images were warped from another sample's; rectify that sample again"
        )
    scene = scene_of(record, scene, folder)
    if settings.sky != (scene.sky.record if scene.sky else None):
        raise InputError(
            "the sample was lit by another sky than the scene's; its file has changed"
        )
    written = record["record"]  # plain values, which are written as they were read
    sample = make_sample(
        scene,
        read(RIG, record.get("rig"), _FILE, "rig"),
        [read(LENS, shot.get("lens"), _FILE, "lens") for shot in record["shots"]],
        Shoot.from_record(written),
        progress=progress,
    )
    origin = {key: written[key] for key in ORIGIN if key in written}
    return replace(
        sample,
        ndisp=None if settings.spec is None else settings.spec.ndisp,
        record={**sample.record, **origin},
    )


class _Spec(FileModel):
    """What `remake` reads of a SampleSpec."""

    seed: int = 0
    drawn: dict[str, Any] = Field(default_factory=dict)
    ndisp: int | None = None


class _MadeWith(FileModel):
    """What `make_sample` records beside its `Shoot`."""

    scene: str
    scene_files: dict[str, str]
    sky: dict[str, Any] | None = None
    ambient: float = 1.0
    denoise: dict[str, Any] | None = None
    sensor: SensorTable
    exposure: ExposureTable | None = None
    spec: _Spec | None = None
    rectified_from: dict[str, Any] | None = None


ADDED = ("noise", "sampler", "dual_pixel", "keep_models")
"""Settings that the first versions did not write."""


def _recorded_keys() -> dict[str, Any]:
    """The types of the settings in a record that have a plain value there."""
    keys = {}
    for name, field in fields_of(Shoot).items():
        if field.is_plain and name != "denoise":
            written = field if name in ADDED else replace(field, default=...)
            keys[name] = declared(written)
    return keys


_Settings: Any = create_model("_Settings", __base__=_MadeWith, **_recorded_keys())


class _Record(FileModel):
    """The keys of a sample.json that `remake` reads."""

    record: _Settings
    shots: list[dict[str, Any]]


_FILE = Path("sample.json")


def scene_of(
    record: Mapping[str, Any],
    given_scene: Scene | None = None,
    folder: str | Path = ".",
    lit: bool = True,
) -> Scene:
    """The scene of a sample's record: the given one, or the bundled one of that name. Its files must be unchanged.

    The objects of the recipe in `folder` are added to it, and if `lit` its sky, unless the given scene has one.

    Raises InputError as `remake` does.
    """
    settings = read(_Record, record, _FILE).record
    try:
        scene = given_scene or load_scene(settings.scene)
    except InputError as error:
        raise InputError(
            f"scene {settings.scene!r} is not bundled; load it with load_scene and pass it"
        ) from error
    if lit and settings.sky is not None and scene.sky is None:
        table = {key: value for key, value in settings.sky.items() if key != "sha256"}
        with located(f"{_FILE}: record.sky"):
            scene = under_sky(scene, table, Path(folder))
    scene = replace(scene, ambient=settings.ambient)
    if settings.spec is not None and "scene" in settings.spec.drawn:
        objects = read(
            SceneTable, settings.spec.drawn["scene"], _FILE, "record.spec.drawn.scene"
        ).objects
        rig = read(RIG, record.get("rig"), _FILE, "rig").nominal
        scene = with_objects(
            scene, objects, rig, settings.spec.seed, Path(folder), _FILE
        )
    if (scene.name, file_digests(scene)) != (settings.scene, settings.scene_files):
        raise InputError(
            f"scene {scene.name!r} is not the one that the record names: its files have changed"
        )
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
    folder: str | Path = ".",
    progress: Progress | None = None,
) -> Sample:
    """Views `left` and `right` of a stored sample as a rectified pair (`rectification.rectify`), with exact truth.

    scene, folder : the sample's, as for `remake`; a bundled scene need not be given.
    pictures : "maps" warps the stored images (bilinear; black outside them, where no point counts as visible), as
        software does after a calibration. "render" renders the scene again through the rectified cameras, of which the
        right one differs as its camera did.
    fit, zero_doffs, misalignment : see `rectify`. A misalignment affects the images; the ground truth is that of the
        aligned pair.

    Raises InputError for a pair that cannot be rectified, and for a scene that is not the sample's.
    """
    check_known("pictures", pictures, PICTURES)
    scene = scene_of(stored.record, scene, folder, lit=pictures == "render")
    result = rectify(
        stored.rig,
        left,
        right,
        fit=fit,
        zero_doffs=zero_doffs,
        misalignment=misalignment,
    )
    origin = {
        "rectified_from": {
            "sample": stored.name,
            "views": [left, right],
            "fit": fit,
            "pictures": pictures,
        }
    }
    if pictures == "render":
        sample = _rendered_pair(stored, scene, result, right or left, progress)
    else:
        sample = _warped_pair(stored, scene, result, (left, right))
    return replace(sample, record={**sample.record, **origin})


def _settings(stored: StoredSample) -> dict[str, Any]:
    """The settings of a stored sample, without its origin."""
    record = stored.record["record"]
    return {key: value for key, value in record.items() if key not in ORIGIN}


def _rendered_pair(
    stored: StoredSample,
    scene: Scene,
    result: Rectification,
    second: int,
    progress: Progress | None,
) -> Sample:
    """The scene, rendered again through the rectified cameras. The right one differs as view `second` did."""
    settings = _settings(stored)
    mismatch = Sensor.from_record(settings["sensor"]).mismatch_of(second)
    settings["sensor"] = {**settings["sensor"], "mismatch": asdict(mismatch)}
    rig = plain(result.rectified_rig)
    changed = {**stored.record, "record": settings, "rig": rig}
    return remake(changed, scene, progress=progress)


def _warped_pair(
    stored: StoredSample, scene: Scene, result: Rectification, views: tuple[int, int]
) -> Sample:
    """The stored images, warped: without halves of dual pixels, radiance and models."""
    settings = _settings(stored)
    absent = dict.fromkeys(("dual_pixel", "keep_radiance", "keep_models"), False)
    return Sample(
        result.rectified_rig,
        _warped_shots(stored, result, views),
        _rectified_truths(scene, result, settings["sky_disparity"]),
        record={**settings, **absent},
    )


def _warped_shots(
    stored: StoredSample, result: Rectification, views: tuple[int, int]
) -> tuple[Shot, ...]:
    """The stored images of two views through each lens, warped into the rectified cameras."""
    shots = []
    for shot in map(stored.lens, range(stored.num_lenses)):
        images = tuple(
            result.warp(side, shot.image(view)) for side, view in enumerate(views)
        )
        shots.append(Shot(shot.lens, images, record=shot.record))
    return tuple(shots)


def _rectified_truths(
    scene: Scene, result: Rectification, sky_disparity: bool
) -> tuple[Truth, ...]:
    """The truth of the aligned pair. Points outside either stored image do not count as visible."""
    rig = result.aligned_rig
    valid = [result.valid(side) for side in (0, 1)]
    truths = ground_truth(scene, rig, sky_disparity=sky_disparity)
    return tuple(
        replace(truth, visible=truth.visible & _in_both(truth, side, rig, valid))
        for side, truth in enumerate(truths)
    )


def _in_both(
    truth: Truth, side: int, rig: Rig, valid: list[NDArray[np.bool_]]
) -> NDArray[np.bool_]:
    """Whether the point of each pixel is in the valid area of both rectified images, bool (H, W)."""
    partner = 1 - side
    pixels = rig.project(
        partner, np.where(truth.hit[..., None], truth.position, np.nan)
    )
    inside = rig.cameras[partner].contains(pixels)
    u, v = (
        np.floor(np.where(inside[..., None], pixels, 0.0) + 0.5)
        .astype(int)
        .transpose(2, 0, 1)
    )
    in_other = inside & valid[partner][v, u]
    return np.asarray(valid[side] & (in_other | ~truth.hit))
