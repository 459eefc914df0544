"""Where an error happens: masks (H, W) bool as pure functions of arrays; whether truth is known is not asked here.

Textureless, discontinuity and occluded follow Scharstein and Szeliski, "A Taxonomy and Evaluation of Dense Two-Frame
Stereo Correspondence Algorithms", IJCV 47 (2002), section 5.1, and the authors' evaluator (StcEvaluate.cpp); as there,
the first two are meant to be reported inside the non-occluded pixels, and `REGIONS` does so.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.errors import InputError, unknown
from twinlens.scoring.checks import Mask, disparity_map

HIDDEN = 128
"""The value of a uint8 visibility mask for a known pixel that the partner camera does not see."""
TEXTURE_WINDOW, TEXTURE_LIMIT = 3, 4.0
JUMP, JUMP_WINDOW = 2.0, 9
BLUR_LIMIT_PX = 2.0


def textureless(image: ArrayLike, window: int = TEXTURE_WINDOW, limit: float = TEXTURE_LIMIT) -> Mask:
    """Where the mean over a window of the squared horizontal difference is below limit^2, in grey levels squared.

    A pixel's squared difference is the larger of those to its left and right neighbours, averaged over the channels;
    the window repeats the image at its border.

    Parameters
    ----------
    image
        uint8 (H, W) or (H, W, 3), W >= 2.

    >>> textureless(np.array([[10, 10, 10, 10, 10, 200, 10]], np.uint8)).tolist()
    [[True, True, True, False, False, False, False]]
    """
    levels = np.asarray(image)
    if levels.dtype != np.uint8 or levels.ndim not in (2, 3) or levels.shape[1] < 2:
        raise InputError(f"image is {levels.dtype} {levels.shape}: expected uint8 (H, W) or (H, W, 3), W >= 2")
    _odd("window", window)
    channels = levels.reshape(*levels.shape[:2], -1).astype(np.int64)
    steps = (np.diff(channels, axis=1) ** 2).sum(axis=2)
    largest = np.maximum(np.pad(steps, ((0, 0), (1, 0)), mode="edge"), np.pad(steps, ((0, 0), (0, 1)), mode="edge"))
    ones = np.ones(window, np.int64)
    sums = ndimage.correlate1d(ndimage.correlate1d(largest, ones, axis=0, mode="nearest"), ones, axis=1, mode="nearest")
    # Sums of integers against an integer-exact bound: a mean in floats would decide ties by its rounding.
    mask: Mask = sums < limit * limit * window * window * channels.shape[2]
    return mask


def discontinuity(gt: ArrayLike, jump: float = JUMP, window: int = JUMP_WINDOW) -> Mask:
    """Pixels within a square window of a jump of the true disparity, |d - d'| >= jump between 4-neighbours, in pixels.

    A step to or from an unknown pixel is no jump: nothing is known about it.

    >>> discontinuity([[5.0, 5.0, 5.0, 9.0, 9.0]], window=3).tolist()
    [[False, True, True, True, True]]
    """
    truth = disparity_map("gt", gt)
    _odd("window", window)
    known = np.where(np.isfinite(truth), truth, np.nan)
    edge = np.zeros(truth.shape, np.bool_)
    with np.errstate(invalid="ignore"):
        across, down = np.abs(np.diff(known, axis=1)) >= jump, np.abs(np.diff(known, axis=0)) >= jump
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    grown: Mask = ndimage.binary_dilation(edge, np.ones((window, window), np.bool_))
    return grown


def occluded(mask_nonocc: NDArray[Any]) -> Mask:
    """Known pixels that the partner does not see: 128 of a uint8 mask (255 seen, 0 unknown), False of a boolean one.

    >>> occluded(np.array([[255, 128, 0]], np.uint8)).tolist()
    [[False, True, False]]
    """
    mask = np.asarray(mask_nonocc)
    if mask.dtype == np.bool_:
        return ~mask
    if mask.dtype != np.uint8:
        raise InputError(f"mask_nonocc holds {mask.dtype}: expected bool, or uint8 of 255, 128 and 0")
    hidden: Mask = mask == HIDDEN
    return hidden


def out_of_focus(blur_px: ArrayLike, limit_px: float = BLUR_LIMIT_PX) -> Mask:
    """Where the blur circle's diameter |blur_px| exceeds limit_px; a signed or unsigned (H, W) map in pixels.

    Where the map is not finite (nothing was hit) the answer is False.

    >>> out_of_focus([[-3.0, 1.0, np.inf]]).tolist()
    [[True, False, False]]
    """
    blur = np.asarray(blur_px, np.float64)
    mask: Mask = np.isfinite(blur) & (np.abs(blur) > limit_px)
    return mask


def distance_bands(gt: ArrayLike, edges: tuple[float, float] | None = None) -> tuple[Mask, Mask, Mask]:
    """(near, mid, far): far is d <= edges[0], near is d > edges[1], in pixels of true disparity.

    Without edges they cut the range of the known disparities in thirds (not the number of pixels: a scene of a few
    planes could not be cut so).

    >>> [band.tolist() for band in distance_bands([[1.0, 2.0, 4.0, np.inf]])]
    [[[False, False, True, False]], [[False, False, False, False]], [[True, True, False, False]]]
    """
    truth = disparity_map("gt", gt)
    known = np.isfinite(truth)
    low, high = edges if edges is not None else _thirds(truth[known])
    if not low <= high:
        raise InputError(f"edges are {edges}: expected (far, near) disparities in rising order")
    far, near = known & (truth <= low), known & (truth > high)
    return near, known & ~far & ~near, far


def _thirds(values: NDArray[Any]) -> tuple[float, float]:
    """Where the range of the values is a third and two thirds through."""
    if not values.size:
        return 0.0, 0.0
    low, high = float(values.min()), float(values.max())
    return low + (high - low) / 3, low + (high - low) * 2 / 3


def of_material(material_kind: ArrayLike, kind: str) -> Mask:
    """Pixels whose material is of that kind, one of `truth.MATERIAL_KINDS` ("mirror", "transmissive", ...).

    >>> of_material(np.array([[1, 3]], np.uint8), "mirror").tolist()
    [[False, True]]
    """
    if kind not in MATERIAL_KINDS:
        raise unknown("material kind", kind, MATERIAL_KINDS)
    mask: Mask = np.asarray(material_kind) == MATERIAL_KINDS.index(kind)
    return mask


def _odd(name: str, size: int) -> None:
    if size < 1 or size % 2 == 0:
        raise InputError(f"{name} is {size}: expected an odd number of pixels")
