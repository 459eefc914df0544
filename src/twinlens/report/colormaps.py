"""Matplotlib's colormaps viridis, magma and berlin as 256-step tables, and the colours of a disparity map.

All three are perceptually uniform and readable with colour vision deficiencies; berlin diverges around black.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.film import colourise

NO_ESTIMATE = (102, 112, 127)  # slate

COLORMAPS: Mapping[str, NDArray[np.uint8]] = MappingProxyType(
    {name: colourise(np.arange(256), 0, 255, name) for name in ("viridis", "magma", "berlin")}
)
"""Name -> uint8 (256, 3) sRGB."""


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
