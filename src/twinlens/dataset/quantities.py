"""Statistics of a sample's truth, stored in its sample.json, and distributions over many samples.

A quantity is stored as quantiles. Unlike histograms they have no bins, so samples of any size and range combine into
one distribution, with linear interpolation between quantiles, one sample in memory at a time.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import Camera, Lens
from twinlens.dataset.truth_files import blur_circle_px
from twinlens.dataset.visibility import HIDDEN, UNKNOWN, VISIBLE

if TYPE_CHECKING:
    from twinlens.dataset.sample import Sample
    from twinlens.dataset.stored import StoredSample

KEY = "statistics"
"""The key in sample.json."""

LEVELS = np.linspace(0.0, 1.0, 33)
_MAX_PIXELS = 1 << 16
_MAX_VALUE = 1e30
_COUNTS = {"size": 1, "cameras": 0, "lenses": 0}
_NESTING = _COUNTS | {"disparity": 1, "depth": 1, "blur_px": 2, "visible": 0, "occluded": 0, "unknown": 0}
"""Keys of the statistics, and how deep their numbers are nested in lists."""

Statistics = dict[str, Any]


def statistics(sample: "Sample") -> Statistics:
    """Statistics of the left view of a sample in memory.

    disparity (px), depth (m) : 33 quantiles of the known values, from minimum to maximum; empty if none is known.
    blur_px : for each lens, the quantiles of the blur circle's diameter.
    visible, occluded, unknown : fractions of the pixels; their sum is 1.
    size, cameras, lenses : width and height of the left image, and counts.

    At most 65,536 pixels on an even grid are used. A sample without truth has counts only.
    """
    camera, lenses = sample.rig.cameras[0], [shot.lens for shot in sample.shots]
    counts = _counts((camera.height, camera.width), len(sample.rig), len(lenses))
    if not sample.truths:
        return counts
    truth = sample.truths[0]
    return counts | _truth_statistics(truth.disparity, truth.depth, truth.mask_nonocc(), camera, lenses)


def stored_statistics(sample: "StoredSample") -> Statistics:
    """Statistics of a stored sample: those in sample.json, or else computed from the truth. Raises FileError."""
    recorded = sample.record.get(KEY) if sample.has("sample.json") else None
    if _is_valid(recorded):
        return dict(recorded)
    if sample.has("truth0.exr"):
        truth, rig = sample.truth0, sample.rig
        lenses = [sample.lens(k).lens for k in range(sample.num_lenses)]
        counts = _counts(truth.depth.shape, len(rig), len(lenses))
        return counts | _truth_statistics(truth.disparity, truth.depth, truth.mask_nonocc(), rig.cameras[0], lenses)
    if not sample.has_disparity(0):
        return _counts(sample.im0.shape, 2, 1)
    disparity = sample.disp0
    depth = sample.calibration.depth(disparity) if sample.has("calib.txt") else np.full(disparity.shape, np.inf)
    return _counts(disparity.shape, 2, 1) | _truth_statistics(disparity, depth, sample.mask0_nonocc, None, [])


def quantiles(values: ArrayLike) -> list[float]:
    """The 33 quantiles of the finite `values`, with five digits; empty if none is finite.

    >>> quantiles([3.0, 1.0, 2.0, np.inf])[::8]
    [1.0, 1.5, 2.0, 2.5, 3.0]
    """
    known = np.asarray(values)[np.isfinite(values)].astype(np.float64)
    return [float(f"{value:.5g}") for value in np.quantile(known, LEVELS)] if known.size else []


def mixed_counts(edges: NDArray[np.float64], many: Iterable[Sequence[float]]) -> NDArray[np.float64]:
    """A histogram (B,) of several distributions, each given by its quantiles and of weight one.

    The edges (B + 1,) increase and enclose all quantiles.

    >>> mixed_counts(np.array([0.0, 1.0, 4.0]), [quantiles([0.0, 2.0]), quantiles([4.0, 4.0])]).round(6).tolist()
    [0.5, 1.5]
    """
    counts = np.zeros(len(edges) - 1)
    for each in many:
        if len(each):
            below = np.interp(edges, np.asarray(each, float), np.linspace(0.0, 1.0, len(each)))
            below[0], below[-1] = 0.0, 1.0  # interpolation is ambiguous where all values are equal
            counts += np.diff(below)
    return counts


def _is_valid(recorded: Any) -> TypeGuard[Mapping[str, Any]]:
    """Whether a sample.json, which users may edit, holds complete statistics."""
    if not isinstance(recorded, Mapping) or set(recorded) not in (set(_NESTING), set(_COUNTS)):
        return False
    return all(_are_numbers(recorded[name], _NESTING[name]) for name in recorded)


def _are_numbers(value: Any, nesting: int) -> bool:
    if nesting:
        return isinstance(value, list) and all(_are_numbers(each, nesting - 1) for each in value)
    return isinstance(value, (int, float)) and abs(value) < _MAX_VALUE


def _counts(shape: Sequence[int], cameras: int, lenses: int) -> Statistics:
    return {"size": [int(shape[1]), int(shape[0])], "cameras": cameras, "lenses": lenses}


def _truth_statistics(
    disparity: NDArray[Any], depth: NDArray[Any], mask: NDArray[Any], camera: Camera | None, lenses: Sequence[Lens]
) -> Statistics:
    step = max(1, int(np.ceil(np.sqrt(mask.size / _MAX_PIXELS))))
    disparity, depth, mask = (array[::step, ::step] for array in (disparity, depth, mask))
    hit = depth[np.isfinite(depth)]
    blurs = [] if camera is None else [quantiles(np.abs(blur_circle_px(hit, camera, lens))) for lens in lenses]
    shares = {"visible": VISIBLE, "occluded": HIDDEN, "unknown": UNKNOWN}
    return {
        "disparity": quantiles(disparity),
        "depth": quantiles(hit),
        "blur_px": blurs,
        **{name: round(float((mask == value).mean()), 5) for name, value in shares.items()},
    }
