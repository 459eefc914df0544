"""What the truth of a sample holds, in a few numbers that stand in its sample.json; and many of them together.

A quantity is kept as its quantiles. They have no bins, so those of samples of any size and range mix into one
distribution exactly at the quantiles and by straight lines between them, one sample in memory at a time.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import Camera, Lens
from twinlens.dataset.occlusion import HIDDEN, UNKNOWN, VISIBLE
from twinlens.dataset.truth_files import blur_circle_px

if TYPE_CHECKING:
    from twinlens.dataset.sample import Sample
    from twinlens.dataset.stored import StoredSample

KEY = "statistics"
"""Under which name sample.json holds them."""

LEVELS = np.linspace(0.0, 1.0, 33)
_PIXELS = 1 << 16
_LARGEST = 1e30
_COUNTED = {"size": 1, "cameras": 0, "lenses": 0}
_NESTED = _COUNTED | {"disparity": 1, "depth": 1, "blur_px": 2, "visible": 0, "occluded": 0, "unknown": 0}

Statistics = dict[str, Any]


def statistics(sample: "Sample") -> Statistics:
    """The statistics of the left view of a sample in memory.

    disparity (px), depth (m) : 33 quantiles of the known values, from the least to the greatest; empty where none is.
    blur_px : for each lens, the same of the blur circle's absolute diameter.
    visible, occluded, unknown : fractions of the pixels, together 1.
    size, cameras, lenses : width and height of the left image, and how many of them there are.

    Quantities are of an even grid of at most 65,536 pixels; they are left out of a sample without truth.
    """
    camera, lenses = sample.rig.cameras[0], [shot.lens for shot in sample.shots]
    counts = _counts((camera.height, camera.width), len(sample.rig), len(lenses))
    if not sample.truths:
        return counts
    truth = sample.truths[0]
    return counts | _of(truth.disparity, truth.depth, truth.mask_nonocc(), camera, lenses)


def stored_statistics(sample: "StoredSample") -> Statistics:
    """The statistics of a sample on the disk: sample.json's, or else taken from the truth. Raises FileError."""
    kept = sample.record.get(KEY) if sample.has("sample.json") else None
    if _is_sound(kept):
        return dict(kept)
    if sample.has("truth0.exr"):
        truth, rig = sample.truth0, sample.rig
        lenses = [sample.lens(k).lens for k in range(sample.num_lenses)]
        counts = _counts(truth.depth.shape, len(rig), len(lenses))
        return counts | _of(truth.disparity, truth.depth, truth.mask_nonocc(), rig.cameras[0], lenses)
    if not any(sample.has(name) for name in ("disp0.pfm", "disp0GT.pfm")):
        return _counts(sample.im0.shape, 2, 1)
    disparity = sample.disp0
    depth = sample.calibration.depth(disparity) if sample.has("calib.txt") else np.full(disparity.shape, np.inf)
    return _counts(disparity.shape, 2, 1) | _of(disparity, depth, sample.mask0_nonocc, None, [])


def quantiles(values: ArrayLike) -> list[float]:
    """The 33 quantiles of the finite `values`, of five digits; none where none is finite.

    >>> quantiles([3.0, 1.0, 2.0, np.inf])[::8]
    [1.0, 1.5, 2.0, 2.5, 3.0]
    """
    known = np.asarray(values)[np.isfinite(values)].astype(np.float64)
    if not known.size:
        return []
    return [float(f"{value:.5g}") for value in np.quantile(known, LEVELS)]


def mixed_counts(edges: NDArray[np.float64], many: Iterable[Sequence[float]]) -> NDArray[np.float64]:
    """How much of the distributions `many` (each its quantiles, each of weight one) falls between `edges`, (B,).

    The edges rise, and hold all quantiles.

    >>> mixed_counts(np.array([0.0, 1.0, 4.0]), [quantiles([0.0, 2.0]), quantiles([4.0, 4.0])]).round(6).tolist()
    [0.5, 1.5]
    """
    counts = np.zeros(len(edges) - 1)
    for each in many:
        if len(each):
            levels = np.linspace(0.0, 1.0, len(each))
            below = np.interp(edges, np.asarray(each, float), levels)
            below[0], below[-1] = 0.0, 1.0  # where all values are equal, an edge on them tells nothing
            counts += np.diff(below)
    return counts


def _is_sound(kept: Any) -> TypeGuard[Mapping[str, Any]]:
    """Whether it has the shape of what `statistics` answers: anyone may have edited a sample.json."""
    if not isinstance(kept, Mapping) or set(kept) not in (set(_NESTED), set(_COUNTED)):
        return False
    return all(_are_numbers(kept[name], _NESTED[name]) for name in kept)


def _are_numbers(value: Any, nested: int) -> bool:
    if nested:
        return isinstance(value, list) and all(_are_numbers(each, nested - 1) for each in value)
    return isinstance(value, (int, float)) and abs(value) < _LARGEST


def _counts(shape: Sequence[int], cameras: int, lenses: int) -> Statistics:
    return {"size": [int(shape[1]), int(shape[0])], "cameras": cameras, "lenses": lenses}


def _of(
    disparity: NDArray[Any], depth: NDArray[Any], mask: NDArray[Any], camera: Camera | None, lenses: Sequence[Lens]
) -> Statistics:
    step = max(1, int(np.ceil(np.sqrt(mask.size / _PIXELS))))
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
