"""Statistics of a sample's truth, stored in its sample.json, and distributions over many samples.

A quantity is stored as quantiles. Unlike histograms they have no bins, so samples of any size and range combine into
one distribution, with linear interpolation between quantiles, one sample in memory at a time.
"""

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import Camera, RecipeLens
from twinlens.dataset.sample import Sample, blur_circle_px
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.visibility import HIDDEN, UNKNOWN, VISIBLE

KEY = "statistics"
"""The key in sample.json."""

LEVELS = np.linspace(0.0, 1.0, 33)
_MAX_PIXELS = 1 << 16
_COUNTS = {"size": 1, "cameras": 0, "lenses": 0}
_NESTING = _COUNTS | {
    "disparity": 1,
    "depth": 1,
    "blur_px": 2,
    "visible": 0,
    "occluded": 0,
    "unknown": 0,
}
"""Keys of the statistics, and how deep their numbers are nested in lists."""

Statistics = dict[str, Any]


def statistics(sample: Sample) -> Statistics:
    """Statistics of the left view of a sample in memory.

    disparity (px), depth (m) : 33 quantiles of the known values, from minimum to maximum; empty if none is known.
    blur_px : for each lens, the quantiles of the blur circle's diameter.
    visible, occluded, unknown : fractions of the pixels; their sum is 1.
    size, cameras, lenses : width and height of the left image, and counts; a sample without truth has only these.

    At most 65,536 pixels on an even grid are used.
    """
    truth = sample.truths[0] if sample.truths else None
    maps = (
        None if truth is None else (truth.disparity, truth.depth, truth.mask_nonocc())
    )
    camera = sample.rig.cameras[0]
    lenses = [shot.lens for shot in sample.shots]
    return _statistics(
        (camera.height, camera.width), len(sample.rig), lenses, maps, camera
    )


def stored_statistics(sample: StoredSample) -> Statistics:
    """Statistics of a stored sample: those in sample.json, or else computed from the truth. Raises FileError."""
    if sample.has("sample.json") and _is_complete(sample.record.get(KEY)):
        return dict(sample.record[KEY])
    if sample.has_truth(0):
        truth, rig = sample.truth0, sample.rig
        maps = (truth.disparity, truth.depth, truth.mask_nonocc())
        lenses = [sample.lens(k).lens for k in range(sample.num_lenses)]
        return _statistics(truth.depth.shape, len(rig), lenses, maps, rig.cameras[0])
    if not sample.has_disparity(0):
        return _statistics(sample.im0.shape, 2, [None])
    disparity = sample.disp0
    depth = (
        sample.calibration.depth(disparity)
        if sample.has("calib.txt")
        else np.full(disparity.shape, np.inf)
    )
    return _statistics(
        disparity.shape, 2, [None], (disparity, depth, sample.mask0_nonocc)
    )


def _is_complete(recorded: Any) -> bool:
    """Whether the statistics of a sample.json, which users may edit, are usable."""
    if not isinstance(recorded, dict):
        return False
    if set(recorded) not in (set(_NESTING), set(_COUNTS)):
        return False
    return all(_are_numbers(recorded[name], _NESTING[name]) for name in recorded)


def quantiles(values: ArrayLike) -> list[float]:
    """The 33 quantiles of the finite `values`, with five digits; empty if none is finite.

    >>> quantiles([3.0, 1.0, 2.0, np.inf])[::8]
    [1.0, 1.5, 2.0, 2.5, 3.0]
    """
    finite = np.asarray(values)[np.isfinite(values)].astype(np.float64)
    if not finite.size:
        return []
    return [float(f"{value:.5g}") for value in np.quantile(finite, LEVELS)]


def mixed_counts(
    edges: NDArray[np.float64], many: Iterable[Sequence[float]]
) -> NDArray[np.float64]:
    """A histogram (B,) of several distributions, each given by its quantiles and of weight one.

    The edges (B + 1,) increase and enclose all quantiles.

    >>> mixed_counts(np.array([0.0, 1.0, 4.0]), [quantiles([0.0, 2.0]), quantiles([4.0, 4.0])]).round(6).tolist()
    [0.5, 1.5]
    """
    counts = np.zeros(len(edges) - 1)
    for levels in many:
        if not len(levels):
            continue
        shares = np.linspace(0.0, 1.0, len(levels))
        below = np.interp(edges, np.asarray(levels, float), shares)
        # Interpolation is ambiguous where all values are equal.
        below[0], below[-1] = 0.0, 1.0
        counts += np.diff(below)
    return counts


def distributions(
    many: Sequence[Statistics],
) -> tuple[list[list[float]], list[list[float]], list[list[float]]]:
    """Quantiles of disparity, of depth, and of each blur circle that is not 0, of the samples that have them."""
    with_truth = [sample for sample in many if "disparity" in sample]
    disparities = [sample["disparity"] for sample in with_truth if sample["disparity"]]
    depths = [sample["depth"] for sample in with_truth if sample["depth"]]
    all_blurs = itertools.chain.from_iterable(
        sample["blur_px"] for sample in with_truth
    )
    blurs = [blur for blur in all_blurs if blur and blur[-1] > 0]
    return disparities, depths, blurs


def _are_numbers(value: Any, nesting: int) -> bool:
    """Whether it is a finite number, or a list of such in `nesting` levels."""
    if nesting == 0:
        return isinstance(value, (int, float)) and abs(value) < 1e30
    if not isinstance(value, list):
        return False
    return all(_are_numbers(entry, nesting - 1) for entry in value)


def _statistics(
    shape: Sequence[int],
    cameras: int,
    lenses: Sequence[RecipeLens | None],
    maps: tuple[NDArray[Any], NDArray[Any], NDArray[Any]] | None = None,
    camera: Camera | None = None,
) -> Statistics:
    """`maps` are disparity, depth and mask of the left view, if known."""
    counts = {
        "size": [int(shape[1]), int(shape[0])],
        "cameras": cameras,
        "lenses": len(lenses),
    }
    if maps is None:
        return counts
    step = max(1, int(np.ceil(np.sqrt(maps[0].size / _MAX_PIXELS))))
    disparity, depth, mask = (array[::step, ::step] for array in maps)
    is_hit = np.isfinite(depth)
    blurs = []
    for lens in lenses:
        if camera and lens:
            blur = blur_circle_px(maps[1], camera, lens)[::step, ::step]
            blurs.append(quantiles(np.abs(blur[is_hit])))
    shares = {"visible": VISIBLE, "occluded": HIDDEN, "unknown": UNKNOWN}
    return {
        **counts,
        "disparity": quantiles(disparity),
        "depth": quantiles(depth[is_hit]),
        "blur_px": blurs,
        **{
            name: round(float((mask == value).mean()), 5)
            for name, value in shares.items()
        },
    }
