"""Which pixels of a view the partner sees, told from disparity maps alone, where no mask was measured.

Exact masks come with rendered truth; these are for real pairs. With both views' disparities a pixel is visible when the
two agree (the cross-check). With one view's alone it is warped into the partner, and a pixel is hidden where something
nearer lands on the same place.

Source: Scharstein and Szeliski, A taxonomy and evaluation of dense two-frame stereo correspondence algorithms, 2002,
section 5 (occlusion by forward and inverse mapping).
"""

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError

VISIBLE, HIDDEN, UNKNOWN = 255, 128, 0

_AGREE_PX = 1.0

Mask = NDArray[np.uint8]
Disparity = NDArray[np.float32]


def mask_from_both(disparity: Disparity, partner: Disparity, left: bool = True) -> Mask:
    """Middlebury's mask of a view, uint8 (H, W), by the cross-check with its partner's disparity.

    A pixel is visible (255) when the partner's disparity at the nearest pixel of its match is known and differs by at
    most one pixel, hidden (128) otherwise or when the match lies outside the image, unknown (0) when it has none.
    `left`: the view is the left one, so that its match lies at u - d. Raises InputError when the shapes differ.
    """
    _check(disparity, partner)
    known = np.isfinite(disparity)
    target, inside = _targets(disparity, left)
    seen = np.take_along_axis(partner, np.where(inside, target, 0), axis=1)
    agree = inside & (np.abs(np.where(inside, seen, np.inf) - np.where(known, disparity, 0)) <= _AGREE_PX)
    return _mask(known, agree)


def mask_from_one(disparity: Disparity, left: bool = True) -> Mask:
    """Middlebury's mask of a view, uint8 (H, W), from its own disparity alone: what nothing nearer covers is visible.

    Every known pixel is carried to its match, at u - d (`left`) or u + d, where it covers both whole pixels that it
    falls between; where several meet, the largest disparity stays. A pixel is hidden (128) when at the nearest whole
    pixel of its match something more than one pixel of disparity nearer has stayed, or when its match lies outside the
    image. Surfaces of unknown disparity hide nothing, so this is an upper bound of what is visible.

    >>> mask_from_one(np.float32([[0, 0, 0, 2, 0]])).tolist()
    [[255, 128, 255, 255, 255]]
    """
    _check(disparity, disparity)
    known = np.isfinite(disparity)
    target, inside = _targets(disparity, left)
    nearest = _nearest(disparity, left)
    met = np.take_along_axis(nearest, np.where(inside, target, 0), axis=1)
    return _mask(known, inside & (met <= np.where(known, disparity, 0) + _AGREE_PX))


def _targets(disparity: Disparity, left: bool) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """The whole pixel nearest to each match (H, W), and whether there is one inside the image."""
    exact = _matches(disparity, left)
    inside = (exact >= -0.5) & (exact < disparity.shape[1] - 0.5)
    return np.floor(np.where(inside, exact, 0.0) + 0.5).astype(np.intp), inside


def _matches(disparity: Disparity, left: bool) -> NDArray[np.float64]:
    u = np.arange(disparity.shape[1], dtype=np.float64)
    return u - disparity if left else u + disparity


def _nearest(disparity: Disparity, left: bool) -> Disparity:
    """The largest disparity that lands on each pixel of the partner, -inf where none does."""
    width = disparity.shape[1]
    nearest = np.full(disparity.shape, -np.inf, np.float32)
    exact = _matches(disparity, left)
    for side in (np.floor(exact), np.ceil(exact)):
        lands = (side >= 0) & (side < width)
        rows = np.nonzero(lands)[0]
        np.maximum.at(nearest, (rows, side[lands].astype(np.intp)), disparity[lands])
    return nearest


def _mask(known: NDArray[np.bool_], visible: NDArray[np.bool_]) -> Mask:
    return np.where(known & visible, VISIBLE, np.where(known, HIDDEN, UNKNOWN)).astype(np.uint8)


def _check(disparity: Disparity, partner: Disparity) -> None:
    if disparity.ndim != 2 or disparity.shape != partner.shape:
        raise InputError(f"disparity maps must be (H, W) and of one shape, got {disparity.shape} and {partner.shape}")
    if not ((disparity > -np.inf).all() and (partner > -np.inf).all()):
        raise InputError("a disparity map holds NaN or -inf; +inf is the one mark for unknown")
