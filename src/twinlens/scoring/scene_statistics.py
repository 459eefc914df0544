"""How hard the scene of a pair is, from its truth and left image: edges, thin things, slant, dark and plain parts.

Disparities are those of the left view, pixels; unknown ones are +inf and count nowhere but in `unknown`.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.scoring.regions import discontinuity, textureless

_JUMP_PX = 2.0
_JUMP_WINDOW = 9  # 4 px to each side
_OPENING = 11  # pixels along a row
_AREA_WINDOW = 21
_AREA_SHARE = 0.8  # of the window
_DARK, _BRIGHT = 16, 250  # grey levels of 255
_HIGH = 0.9

Map = NDArray[np.floating[Any]]


def geometry_statistics(disparity: Map) -> dict[str, float]:
    """What the true disparities (H, W) of the left view say of the scene; all NaN if none is known.

    edges : share of the known pixels within 4 px, along rows and columns, of a jump of 2 px or more.
    thin : share that is nearer by 2 px or more than the opening of its row over 11 px.
    slant, slant_high : median and 90 % quantile of the absolute step to the next pixel of the row, without jumps, px.
    range : from the 2 % to the 98 % quantile, over the image's width.
    unknown : share of all pixels.
    """
    names = ("edges", "thin", "slant", "slant_high", "range", "unknown")
    has_truth = np.isfinite(disparity)
    if not has_truth.any():
        return dict.fromkeys(names, math.nan)
    steps = _steps(disparity)
    slant = np.quantile(steps, (0.5, _HIGH)) if steps.size else (math.nan, math.nan)
    low, high = np.quantile(disparity[has_truth].astype(np.float64), (0.02, 0.98))
    numbers = (
        discontinuity(disparity, _JUMP_WINDOW, _JUMP_PX)[has_truth].mean(),
        thin(disparity)[has_truth].mean(),
        *slant,
        (high - low) / disparity.shape[1],
        1 - has_truth.mean(),
    )
    return dict(zip(names, map(float, numbers), strict=True))


def thin(disparity: Map) -> NDArray[np.bool_]:
    """Pixels (H, W) of things narrower than 11 px in front of what is beside them.

    The opening of a row is its largest lower bound without peaks narrower than the window. Holes in the truth beside a
    thing, which it hides from the other camera, count as what is behind it.
    """
    has_truth = np.isfinite(disparity)
    margin = ((0, 0), (_OPENING, _OPENING))
    padded = np.pad(_filled_along_rows(disparity, has_truth), margin, mode="edge")
    opened = ndimage.grey_opening(padded, size=(1, _OPENING))
    is_nearer = (padded - opened >= _JUMP_PX)[:, _OPENING:-_OPENING]
    return np.asarray(has_truth & is_nearer)


def image_statistics(grey: NDArray[np.floating[Any]]) -> dict[str, float]:
    """Shares of the pixels of a left image (H, W), grey levels 0 to 255.

    dark, bright : below 16, above 250.
    plain_areas : textureless in the sense of Middlebury 2002 in more than 80 % of the 21x21 pixels around.
    """
    plain = textureless(np.rint(grey).astype(np.uint8))
    around = ndimage.uniform_filter(plain.astype(np.float64), _AREA_WINDOW)
    return {
        "dark": float((grey < _DARK).mean()),
        "bright": float((grey > _BRIGHT).mean()),
        "plain_areas": float((around > _AREA_SHARE).mean()),
    }


def _steps(disparity: Map) -> Map:
    """Absolute steps between neighbours of a row (N,), of which both are known, without jumps."""
    with np.errstate(invalid="ignore"):
        steps = np.abs(np.diff(disparity.astype(np.float64), axis=1))
    # Comparisons with NaN, from two unknown neighbours, are false.
    return np.asarray(steps[steps < _JUMP_PX])


def _filled_along_rows(disparity: Map, has_truth: NDArray[np.bool_]) -> Map:
    """The disparities, where unknown the smaller of the nearest known ones of the row to the left and to the right.

    0 in rows without any.
    """
    filled = np.zeros(disparity.shape)
    columns = np.arange(disparity.shape[1])
    for row, values, is_known in zip(filled, disparity, has_truth, strict=True):
        places = columns[is_known]
        if not places.size:
            continue
        # The known place at or after each column, and the one at or before it; at the ends there is only one.
        after = np.searchsorted(places, columns)
        before = np.searchsorted(places, columns, side="right") - 1
        last = len(places) - 1
        left, right = places[before.clip(0)], places[after.clip(0, last)]
        row[:] = np.minimum(values[left], values[right])
    return filled
