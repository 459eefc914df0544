"""Rectified pairs from stored samples. Images are warped or rendered again; truth is computed, never resampled."""

import warnings
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ALIGNED, Misalignment, Rig
from twinlens.camera.rectification import Rectification, rectify
from twinlens.camera.truth import Truth
from twinlens.dataset import Frame, Place, Sample, Shot, StoredSample, read_manifest
from twinlens.dataset.dataset import MANIFEST
from twinlens.dataset.record import plain
from twinlens.dataset.stored import StoredShot
from twinlens.errors import InputError, check_known
from twinlens.factory.doubts import ResultWarning
from twinlens.factory.recipe import recipe_from_table
from twinlens.factory.remake import ORIGIN, remake, scene_of
from twinlens.factory.sources import Sources
from twinlens.rendering import Progress, ground_truth
from twinlens.scenes import Scene, bundled_scenes
from twinlens.sensor import Sensor

PICTURES = ("maps", "render")
_MOST_CHANGED = 0.005
"""Share of pixels whose object may differ by rounding between versions."""


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
    sources: Sources | None = None,
    progress: Progress | None = None,
) -> Sample:
    """Views `left` and `right` of a stored sample as a rectified pair (`rectification.rectify`), with exact truth.

    scene, folder : the sample's, as for `remake`; a bundled scene and that of a family need not be given.
    sources : files of the sample's recipe, if its scene is made of them: `recipe_from_table(...).sources`.
    pictures : "maps" warps the stored images (bilinear; black outside them, where no point counts as visible), as
        software does after a calibration. "render" renders the scene again through the rectified cameras, of which the
        right one differs as its camera did.
    fit, zero_doffs, misalignment : see `rectify`. A misalignment affects the images; the ground truth is that of the
        aligned pair.

    Raises InputError for a pair that cannot be rectified, and for a scene that is not the sample's.
    """
    check_known("pictures", pictures, PICTURES)
    is_given = scene is not None
    scene = scene_of(stored.record, scene, folder, pictures == "render", sources)
    if not is_given and stored.has_truth(left):
        _check_same_scene(stored, scene, left)
    result = rectify(
        stored.rig,
        left,
        right,
        fit=fit,
        zero_doffs=zero_doffs,
        misalignment=misalignment,
    )
    origin = {
        "sample": stored.name,
        "views": [left, right],
        "fit": fit,
        "pictures": pictures,
        **_spec(stored),
    }
    if pictures == "render":
        sample = _rendered_pair(stored, scene, result, right or left, progress)
    else:
        sample = _warped_pair(stored, scene, result, (left, right))
    _warn_of_no_overlap(stored.name, sample)
    return replace(sample, record={**sample.record, "rectified_from": origin})


def _warn_of_no_overlap(name: str, sample: Sample) -> None:
    if not any(truth.visible.any() for truth in sample.truths):
        warnings.warn(
            f"{name}: no pixel is visible in both rectified views; are the lengths of the rig's file in metres?",
            ResultWarning,
            stacklevel=3,
        )


def _spec(stored: StoredSample) -> dict[str, Any]:
    """The spec of a recipe's sample, whose drawn values describe its rectified pair too."""
    spec = stored.record["record"].get("spec")
    return {} if spec is None else {"spec": spec}


def _check_same_scene(stored: StoredSample, scene: Scene, view: int) -> None:
    """Raise InputError where the scene is another one than that of the stored truth.

    A family makes other scenes in another version of twinlens.
    """
    spec = stored.record["record"].get("spec") or {}
    if spec.get("kind") != "family":
        return
    stored_ids = stored.truth(view).object_id
    ids = ground_truth(scene, stored.rig.nominal, objects=False)[view].object_id
    if (ids != stored_ids).mean() > _MOST_CHANGED:
        raise InputError(
            f"{stored.name}: this version of twinlens makes another scene from its record; make the dataset again"
        )


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
        frames = map(shot.frame, range(shot.num_frames))
        first, *others = [
            Frame(_warped_images(frame, result, views), record=frame.record)
            for frame in frames
        ]
        shots.append(
            Shot(shot.lens, first.images, record=first.record, frames=tuple(others))
        )
    return tuple(shots)


def _warped_images(
    frame: StoredShot, result: Rectification, views: tuple[int, int]
) -> tuple[NDArray[Any], ...]:
    """The images of two views in one frame, warped into the rectified cameras."""
    return tuple(
        result.warp(side, frame.image(view)) for side, view in enumerate(views)
    )


def _rectified_truths(
    scene: Scene, result: Rectification, sky_disparity: bool
) -> tuple[Truth, ...]:
    """The truth of the aligned pair, with the channel `valid`. Points outside either stored image are not visible."""
    rig = result.aligned_rig
    valid = [result.valid(side) for side in (0, 1)]
    truths = ground_truth(scene, rig, sky_disparity=sky_disparity)
    return tuple(
        replace(
            truth,
            visible=truth.visible & _in_both(truth, side, rig, valid),
            extra={**truth.extra, "valid": np.uint8(255) * valid[side]},
        )
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


def sources_of(dataset: Place, folder: Path) -> Sources | None:
    """The files that the scenes of a dataset are made of, relative to the `folder` of its recipe.

    None where there are none but bundled scenes. Raises InputError.
    """
    if not (dataset / MANIFEST).exists():
        return None
    recipe = read_manifest(dataset).recipe
    has_files = set(recipe.get("scenes", ())) - set(bundled_scenes())
    if not (has_files or "assets" in recipe):
        return None
    return recipe_from_table(recipe, folder / "recipe.toml").sources
