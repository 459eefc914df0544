"""Colormaps viridis, magma and berlin as 256-step tables, and flat colours for unknown values.

All three are perceptually uniform and readable with colour vision deficiencies. viridis and magma: van der Walt and
Smith, 2015 (CC0); berlin: after Crameri, Zenodo 1243862, diverging around black. Interpolated from some anchor colours.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError, unknown

NO_TRUTH, NO_ESTIMATE = (196, 200, 206), (102, 112, 127)  # light grey and slate; the colormaps contain no greys

_ANCHORS = {
    "viridis": "440154 481567 482677 453781 404788 39568c 33638d 2d708e 287d8e 238a8d 1f968b 20a387 29af7f 3cbb75"
    " 55c667 73d055 95d840 b8de29 dce319 fde725",
    "magma": "000004 180f3d 440f76 721f81 9e2f7f cd4071 f1605d fd9668 feca8d fcfdbf",
    "berlin": "9eb0ff 5aa4da 2d7597 1a4256 111114 501803 8a3f2a c4756a ffadad",
}


def _table(anchors: str) -> NDArray[np.uint8]:
    colours = np.array([list(bytes.fromhex(c)) for c in anchors.split()], np.float64)
    at, steps = np.linspace(0, 1, len(colours)), np.linspace(0, 1, 256)
    return np.stack([np.interp(steps, at, channel) for channel in colours.T], axis=1).round().astype(np.uint8)


COLORMAPS: Mapping[str, NDArray[np.uint8]] = MappingProxyType({name: _table(each) for name, each in _ANCHORS.items()})
"""Name -> uint8 (256, 3) sRGB."""


def colourise(
    values: ArrayLike, low: float, high: float, colormap: str = "viridis", unknown_colour: Sequence[int] = NO_TRUTH
) -> NDArray[np.uint8]:
    """(H, W) numbers as a uint8 (H, W, 3) sRGB image; the colormap spans [low, high], values outside saturate.

    Values that are not finite get `unknown_colour`. Raises InputError for an unknown colormap, or low >= high.

    >>> colourise([[0.0, 1.0, np.inf]], 0, 1).tolist()
    [[[68, 1, 84], [253, 231, 37], [196, 200, 206]]]
    """
    if colormap not in COLORMAPS:
        raise unknown("colormap", colormap, COLORMAPS)
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
