"""Regions of the image that are scored apart: functions of arrays to (H, W) bool masks, and their table `REGIONS`.

Textureless, discontinuity and occluded follow Scharstein and Szeliski, "A Taxonomy and Evaluation of Dense Two-Frame
Stereo Correspondence Algorithms", IJCV 47 (2002), section 5.1, and StcEvaluate.cpp. Unknown truth does not matter here.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.errors import check_known
from twinlens.scoring.metrics import Mask, boolean_mask, disparity_map
from twinlens.scoring.samples import Pair

HIDDEN = 128  # in a uint8 visibility mask: a known pixel that is not visible in the partner camera
BLUR_LIMIT_PX = 2.0


def textureless(image: NDArray[np.uint8], window: int = 3, limit: float = 4.0) -> Mask:
    """Pixels whose squared horizontal difference, averaged over an odd window, is below limit^2 (grey levels squared).

    A pixel's squared difference is the larger of those to its left and right neighbours, averaged over the channels.
    At the border the image is extended by its edge pixels. image: uint8 (H, W) or (H, W, 3), W >= 2.
    """
    channels = image.reshape(*image.shape[:2], -1).astype(np.int64)
    steps = (np.diff(channels, axis=1) ** 2).sum(axis=2)
    to_left = np.pad(steps, ((0, 0), (1, 0)), mode="edge")
    to_right = np.pad(steps, ((0, 0), (0, 1)), mode="edge")
    ones = np.ones(window, np.int64)
    sums = np.maximum(to_left, to_right)
    for axis in (0, 1):
        sums = ndimage.correlate1d(sums, ones, axis=axis, mode="nearest")
    # Integer sums: the rounding of a floating-point mean would decide ties.
    return np.asarray(sums < limit * limit * window * window * channels.shape[2])


def discontinuity(gt: ArrayLike, window: int = 9, jump: float = 2.0) -> Mask:
    """Pixels within an odd window of a jump: neighbours whose known true disparities differ by `jump` px or more."""
    truth = disparity_map("gt", gt)
    values = np.where(np.isfinite(truth), truth, np.nan)
    edge = np.zeros(truth.shape, np.bool_)
    # Along columns and, transposed, along rows; both sides of a jump are marked.
    for line, marked in ((values, edge), (values.T, edge.T)):
        with np.errstate(invalid="ignore"):
            steps = np.abs(np.diff(line, axis=0)) >= jump
        marked[1:] |= steps
        marked[:-1] |= steps
    return np.asarray(
        ndimage.binary_dilation(edge, np.ones((window, window), np.bool_))
    )


def occluded(mask_nonocc: NDArray[Any]) -> Mask:
    """Known pixels not visible in the right camera: 128 of a uint8 mask (255 visible), False of a bool mask."""
    return np.asarray(
        mask_nonocc == (False if mask_nonocc.dtype == np.bool_ else HIDDEN)
    )


def out_of_focus(blur_px: ArrayLike) -> Mask:
    """Pixels whose blur circle is wider than 2 px; (H, W) diameters, signed or unsigned, False where not finite."""
    size = np.abs(np.asarray(blur_px, np.float64))
    return np.asarray(np.isfinite(size) & (size > BLUR_LIMIT_PX))


def distance_bands(gt: ArrayLike) -> tuple[Mask, Mask, Mask]:
    """(near, mid, far): the upper, middle and lower third of the range of the known true disparities."""
    truth = disparity_map("gt", gt)
    has_truth = np.isfinite(truth)
    least = most = 0.0
    if has_truth.any():
        least, most = float(truth[has_truth].min()), float(truth[has_truth].max())
    far = has_truth & (truth <= least + (most - least) / 3)
    near = has_truth & (truth > least + (most - least) * 2 / 3)
    return near, has_truth & ~far & ~near, far


@dataclass(frozen=True)
class Region:
    """A named part of the image: its `mask`, or None if a sample has none, and the data of a `Pair` that it needs."""

    name: str
    text: str
    mask: Callable[[Any], Mask | None]
    needs: tuple[str, ...] = ()


def _nonocc(sample: Any) -> Mask:
    return boolean_mask("mask0_nonocc", sample.mask0_nonocc, sample.shape)


def _textureless(sample: Any) -> Mask | None:
    """In 8-bit grey levels, the unit of the limit; None for an image one pixel wide."""
    image = sample.im0
    if image.shape[1] < 2:
        return None
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    return _nonocc(sample) & textureless(image)


def _material(kind: str) -> Region:
    number = MATERIAL_KINDS.index(kind)
    return Region(
        kind,
        f"{kind} materials",
        lambda s: np.equal(s.material_kind0, number),
        ("material_kind0",),
    )


_SEEN = ("mask0_nonocc",)
_TRUTH = ("disp0",)
_REGIONS = (
    Region(
        "all",
        "every pixel with known truth; of a pair without truth, every pixel",
        lambda s: np.ones(s.shape, np.bool_),
    ),
    Region("nonocc", "visible in both cameras", _nonocc, _SEEN),
    Region(
        "occluded",
        "known, but hidden from or outside the right view",
        lambda s: occluded(s.mask0_nonocc),
        _SEEN,
    ),
    Region(
        "textureless",
        "non-occluded; mean squared horizontal difference over 3x3 below 16 (Middlebury 2002)",
        _textureless,
        _SEEN,
    ),
    Region(
        "discontinuity",
        "non-occluded; within 9x9 of a disparity jump of 2 px or more (Middlebury 2002)",
        lambda s: _nonocc(s) & discontinuity(s.disp0),
        (*_SEEN, *_TRUTH),
    ),
    Region(
        "out-of-focus",
        f"blur circle wider than {BLUR_LIMIT_PX:g} px",
        lambda s: out_of_focus(s.blur0),
        ("blur0",),
    ),
    Region(
        "near",
        "upper third of the range of true disparities",
        lambda s: distance_bands(s.disp0)[0],
        _TRUTH,
    ),
    Region(
        "mid",
        "middle third of the range of true disparities",
        lambda s: distance_bands(s.disp0)[1],
        _TRUTH,
    ),
    Region(
        "far",
        "lower third of the range of true disparities",
        lambda s: distance_bands(s.disp0)[2],
        _TRUTH,
    ),
    *map(_material, MATERIAL_KINDS[1:]),
)
REGIONS: Mapping[str, Region] = {region.name: region for region in _REGIONS}


def region_masks(sample: Pair, names: Iterable[str]) -> dict[str, Mask]:
    """Masks of the named regions, in that order, without those that the sample has no data for.

    Raises InputError for an unknown name.
    """
    masks = {}
    for name in names:
        check_known("region", name, REGIONS)
        if all(getattr(sample, data) is not None for data in REGIONS[name].needs):
            masks[name] = REGIONS[name].mask(sample)
    return {name: mask for name, mask in masks.items() if mask is not None}
