"""Colours as a scene file writes them, always linear sRGB once read."""

import re
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.scenes.scene import Color
from twinlens.scenes.table import At, listed, number, show

_HEX = re.compile(r"#[0-9a-fA-F]{6}")


def linear_from_srgb(encoded: ArrayLike) -> NDArray[np.float32]:
    """Linear light from sRGB-encoded values in [0, 1]; float32, same shape. Source: IEC 61966-2-1:1999.

    >>> [round(float(v), 6) for v in linear_from_srgb([0.0, 0.04045, 1.0])]
    [0.0, 0.003131, 1.0]
    """
    v = np.asarray(encoded, dtype=np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((np.maximum(v, 0.04045) + 0.055) / 1.055) ** 2.4).astype(np.float32)


def color(at: At, value: Any) -> Color:
    """A colour: "#rrggbb" as a screen shows it (sRGB), [r, g, b] linear, or one number for a grey; none negative."""
    if isinstance(value, str):
        if not _HEX.fullmatch(value):
            raise at.wrong(f'must be a colour: "#rrggbb", [r, g, b] linear or a number, got {show(value)}')
        encoded = [int(value[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        return Color(tuple(linear_from_srgb(encoded).astype(float).tolist()))
    if isinstance(value, list):
        r, g, b = listed(number(0.0), 3, 3)(at, value)
        return Color((r, g, b))
    grey = number(0.0)(at, value)
    return Color((grey, grey, grey))
