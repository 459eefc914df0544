"""Matplotlib's colormaps viridis, magma and berlin as 256-step tables, and flat colours for unknown values.

All three are perceptually uniform and readable with colour vision deficiencies; berlin diverges around black.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import matplotlib
import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError, check_known

NO_TRUTH, NO_ESTIMATE = (196, 200, 206), (102, 112, 127)  # light grey and slate; the colormaps contain no greys

COLORMAPS: Mapping[str, NDArray[np.uint8]] = MappingProxyType(
    {
        name: np.rint(255 * matplotlib.colormaps[name](np.arange(256))[:, :3]).astype(np.uint8)
        for name in ("viridis", "magma", "berlin")
    }
)
"""Name -> uint8 (256, 3) sRGB."""


def colourise(
    values: ArrayLike, low: float, high: float, colormap: str = "viridis", unknown_colour: Sequence[int] = NO_TRUTH
) -> NDArray[np.uint8]:
    """(H, W) numbers as a uint8 (H, W, 3) sRGB image; the colormap spans [low, high], values outside saturate.

    Values that are not finite get `unknown_colour`. Raises InputError for an unknown colormap, or low >= high.

    >>> colourise([[0.0, 1.0, np.inf]], 0, 1).tolist()
    [[[68, 1, 84], [253, 231, 37], [196, 200, 206]]]
    """
    check_known("colormap", colormap, COLORMAPS)
    if not low < high:
        raise InputError(f"the colour range is [{low}, {high}]: expected low < high")
    numbers = np.asarray(values, np.float64)
    known = np.isfinite(numbers)
    share = (np.where(known, numbers, low) - low) / (high - low)
    index = np.rint(np.clip(share, 0, 1) * 255).astype(np.intp)
    return np.where(known[..., None], COLORMAPS[colormap][index], np.array(unknown_colour, np.uint8))


def disparity_limits(disparity: ArrayLike, matcher: object) -> tuple[float, float]:
    """(low, high) for the colours of a disparity map, at least 1 apart.

    The matcher's search range, or the range of the map if the matcher has none or searches one disparity.
    """
    values = np.asarray(disparity)
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    first, count = getattr(matcher, "min_disparity", None), getattr(matcher, "num_disparities", None)
    if first is not None and count is not None and count > 1:
        low, high = float(first), float(first + count - 1)
    return low, max(high, low + 1.0)
