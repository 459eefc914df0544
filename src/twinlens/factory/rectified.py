"""Rectified pairs from stored samples. Images are warped or rendered again; ground truth is never resampled."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ALIGNED, Misalignment
from twinlens.camera.rectification import Rectification, rectify
from twinlens.camera.truth import Truth
from twinlens.dataset import Sample, Shot, StoredSample
from twinlens.dataset.record import plain
from twinlens.errors import unknown
from twinlens.factory.remake import ORIGIN, remake, scene_of
from twinlens.rendering import Progress, ground_truth
from twinlens.scenes import Scene

PICTURES = ("maps", "render")


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

    Parameters
    ----------
    scene : Scene
        The sample's scene; not needed for a bundled one.
    pictures : {"maps", "render"}
        "maps" warps the stored images (bilinear; black outside them), as software does after a calibration.
        "render" renders the scene again through the rectified cameras.
    fit, zero_doffs, misalignment
        See `rectify`. A misalignment affects the images; the ground truth is that of the aligned pair.

    Returns
    -------
    Sample of two views. The ground truth is computed for the aligned cameras. With "maps", points outside a
    stored image are not visible.

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
    truths = ground_truth(scene, result.aligned_rig, sky_disparity=bool(made.get("sky_disparity")))
    shots = tuple(_warped(stored, k, (left, right), result) for k in range(stored.num_lenses))
    record = {**made, "keep_radiance": False, **origin}
    return Sample(result.rectified_rig, shots, _where_pictured(truths, result), record=record)


def _warped(stored: StoredSample, k: int, views: tuple[int, int], result: Rectification) -> Shot:
    shot = stored.lens(k)
    images = tuple(result.warp(side, shot.image(view)) for side, view in enumerate(views))
    return Shot(shot.lens, images, record=shot.record)


def _where_pictured(truths: list[Truth], result: Rectification) -> tuple[Truth, ...]:
    """The ground truths, visible only where both rectified images have data."""
    valid = [result.valid(side) for side in (0, 1)]
    pictured = (_pictured(truth, side, result, valid) for side, truth in enumerate(truths))
    return tuple(replace(truth, visible=truth.visible & both) for truth, both in zip(truths, pictured, strict=True))


def _pictured(truth: Truth, side: int, result: Rectification, valid: list[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Whether both rectified images have data at a pixel's point."""
    rig, other = result.aligned_rig, 1 - side
    seen = rig.project(other, np.where(truth.hit[..., None], truth.position, np.nan))
    inside = rig.cameras[other].contains(seen)
    u, v = np.floor(np.where(inside[..., None], seen, 0.0) + 0.5).astype(int).transpose(2, 0, 1)
    there = inside & valid[other][v, u]
    pictured: NDArray[np.bool_] = valid[side] & (there | ~truth.hit)
    return pictured
