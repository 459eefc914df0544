"""Statistics of a sample's truth, stored in its sample.json, and distributions over many samples.

A quantity is stored as quantiles. Unlike histograms they have no bins, so samples of any size and range combine into
one distribution, with linear interpolation between quantiles, one sample in memory at a time.
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

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


def statistics(sample: "Sample") -> Statistics:
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


def stored_statistics(sample: "StoredSample") -> Statistics:
    """Statistics of a stored sample: those in sample.json, or else computed from the truth. Raises FileError."""
    recorded = sample.record.get(KEY) if sample.has("sample.json") else None
    complete = isinstance(recorded, dict) and set(recorded) in (
        set(_NESTING),
        set(_COUNTS),
    )
    # Users may edit the file.
    if (
        recorded
        and complete
        and all(_are_numbers(recorded[name], _NESTING[name]) for name in recorded)
    ):
        return dict(recorded)
    if sample.has("truth0.exr"):
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


def quantiles(values: ArrayLike) -> list[float]:
    """The 33 quantiles of the finite `values`, with five digits; empty if none is finite.

    >>> quantiles([3.0, 1.0, 2.0, np.inf])[::8]
    [1.0, 1.5, 2.0, 2.5, 3.0]
    """
    known = np.asarray(values)[np.isfinite(values)].astype(np.float64)
    return (
        [float(f"{value:.5g}") for value in np.quantile(known, LEVELS)]
        if known.size
        else []
    )


def mixed_counts(
    edges: NDArray[np.float64], many: Iterable[Sequence[float]]
) -> NDArray[np.float64]:
    """A histogram (B,) of several distributions, each given by its quantiles and of weight one.

    The edges (B + 1,) increase and enclose all quantiles.

    >>> mixed_counts(np.array([0.0, 1.0, 4.0]), [quantiles([0.0, 2.0]), quantiles([4.0, 4.0])]).round(6).tolist()
    [0.5, 1.5]
    """
    counts = np.zeros(len(edges) - 1)
    for each in many:
        if len(each):
            below = np.interp(
                edges, np.asarray(each, float), np.linspace(0.0, 1.0, len(each))
            )
            below[0], below[-1] = (
                0.0,
                1.0,
            )  # interpolation is ambiguous where all values are equal
            counts += np.diff(below)
    return counts


def _are_numbers(value: Any, nesting: int) -> bool:
    if nesting:
        return isinstance(value, list) and all(
            _are_numbers(each, nesting - 1) for each in value
        )
    return isinstance(value, (int, float)) and abs(value) < 1e30


def _statistics(
    shape: Sequence[int],
    cameras: int,
    lenses: Sequence[Lens | None],
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
    hit = depth[np.isfinite(depth)]
    blurs = [
        quantiles(np.abs(blur_circle_px(hit, camera, lens)))
        for lens in lenses
        if camera and lens
    ]
    shares = {"visible": VISIBLE, "occluded": HIDDEN, "unknown": UNKNOWN}
    return {
        **counts,
        "disparity": quantiles(disparity),
        "depth": quantiles(hit),
        "blur_px": blurs,
        **{
            name: round(float((mask == value).mean()), 5)
            for name, value in shares.items()
        },
    }
