"""Validation of disparity maps and masks."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError

Disparity = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]

EVALUATED = 255
"""Value of evaluated pixels in a uint8 mask (Middlebury v3, ETH3D)."""


def disparity_map(name: str, values: ArrayLike) -> Disparity:
    """`values` as an (H, W) float array in pixels, +inf where unknown; InputError for another shape, NaN or -inf.

    >>> disparity_map("disp", [[1, 2]])
    array([[1., 2.]])
    """
    array = np.asarray(values)
    if array.ndim != 2 or array.size == 0:
        raise InputError(f"{name} has shape {array.shape}: expected (height, width), neither of them 0")
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name} holds {array.dtype}: expected real numbers, float32 pixels with +inf where unknown")
    if array.dtype.kind != "f":
        return array.astype(np.float32 if array.dtype.itemsize <= 2 else np.float64)
    for what, wrong in (("NaN", np.isnan(array)), ("-inf", np.isneginf(array))):
        if wrong.any():
            y, x = np.argwhere(wrong)[0]
            raise InputError(
                f"{name} holds {what} at {wrong.sum()} of {array.size} pixels, the first at x={x}, y={y}: mark unknown "
                "as +inf"
            )
    return array


def mask_of(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Mask:
    """`values` as an (H, W) boolean mask, where 255 is True of uint8; InputError for another shape or dtype.

    >>> mask_of("mask", np.array([[255, 128, 0]], np.uint8), (1, 3)).tolist()
    [[True, False, False]]
    """
    array = np.asarray(values)
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}: expected the truth's, {shape}")
    if array.dtype == np.bool_:
        return array
    if array.dtype != np.uint8:
        raise InputError(f"{name} holds {array.dtype}: expected bool, or uint8 with 255 where a pixel is evaluated")
    mask: Mask = array == EVALUATED
    return mask
