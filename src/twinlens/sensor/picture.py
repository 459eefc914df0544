"""Images from the converter's numbers: colour filter arrays, demosaicing, tone curves, 8 or 16 bits."""

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float

Image = NDArray[np.uint8] | NDArray[np.uint16]

BAYER = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Colour filter arrays, named by the 2x2 block at the top left, row by row."""

FILTERS = ("rgb", "mono", *BAYER)
"""`rgb`: three values per pixel, as of a three-chip camera. `mono`: one value, the sum of the three bands."""

# Malvar, He and Cutler, High-quality linear interpolation for demosaicing of Bayer-patterned color images, ICASSP 2004.
_GREEN = (
    np.array(
        [
            [0, 0, -1, 0, 0],
            [0, 0, 2, 0, 0],
            [-1, 2, 4, 2, -1],
            [0, 0, 2, 0, 0],
            [0, 0, -1, 0, 0],
        ]
    )
    / 8
)
_IN_ROW = (
    np.array(
        [
            [0, 0, 1, 0, 0],
            [0, -2, 0, -2, 0],
            [-2, 8, 10, 8, -2],
            [0, -2, 0, -2, 0],
            [0, 0, 1, 0, 0],
        ]
    )
    / 16
)
_OPPOSITE = (
    np.array(
        [
            [0, 0, -3, 0, 0],
            [0, 4, 0, 4, 0],
            [-3, 0, 12, 0, -3],
            [0, 4, 0, 4, 0],
            [0, 0, -3, 0, 0],
        ]
    )
    / 16
)


CURVES = ("srgb", "linear", "gamma")
"""Tone curves: of sRGB, none, and the power 1/gamma."""


def channel_map(pattern: str, height: int, width: int) -> NDArray[np.intp]:
    """The channel (0 red, 1 green, 2 blue) of each pixel of a colour filter array, (H, W).

    >>> channel_map("GRBG", 2, 4).tolist()
    [[1, 0, 1, 0], [2, 1, 2, 1]]
    """
    block = np.array(["RGB".index(letter) for letter in pattern]).reshape(2, 2)
    return block[np.arange(height)[:, None] % 2, np.arange(width) % 2]


def mosaic(values: Float, pattern: str) -> Float:
    """The values (H, W) that a colour filter array passes of values (H, W, 3)."""
    channel = channel_map(pattern, *values.shape[:2])
    return np.take_along_axis(values, channel[..., None], axis=2)[..., 0]


def demosaic(values: Float, pattern: str) -> Float:
    """Three channels (H, W, 3) of a mosaic (H, W) in 0..1, by gradient-corrected linear interpolation.

    The bilinear estimate of a missing channel, plus a share of the Laplacian of the channel that the pixel has, because
    edges of the channels coincide. The shares are 1/2 for green, and for red and blue 5/8 at green pixels and 3/4 at
    each other's: rounded Wiener estimates of the source.
    Source: Malvar, He and Cutler, ICASSP 2004. Borders are continued by reflection about the outermost pixels.
    """
    from scipy.ndimage import convolve  # slow to import

    values = np.clip(values, 0.0, 1.0)
    channel = channel_map(pattern, *values.shape)
    green, in_row, in_column, opposite = (
        convolve(values, kernel, mode="mirror")
        for kernel in (_GREEN, _IN_ROW, _IN_ROW.T, _OPPOSITE)
    )
    full = np.stack([values] * 3, axis=-1)
    full[..., 1] = np.where(channel == 1, values, green)
    for c, letter in ((0, "R"), (2, "B")):
        same_row = (np.arange(len(values)) % 2 == pattern.index(letter) // 2)[:, None]
        at_green = np.where(same_row, in_row, in_column)
        full[..., c] = np.select(
            [channel == c, channel == 1], [values, at_green], opposite
        )
    return full


def linear(image: Image, curve: str, gamma: float) -> Float:
    """The values in 0..1 of an image before its tone curve, the inverse of `encode`.

    >>> linear(encode(np.array([0.18, 0.5]), "srgb", 2.2, 16), "srgb", 2.2).round(4).tolist()
    [0.18, 0.5]
    """
    encoded = image.astype(np.float64) / np.iinfo(image.dtype).max
    if curve == "srgb":
        power = ((encoded + 0.055) / 1.055) ** 2.4
        return np.where(encoded <= 0.04045, encoded / 12.92, power)
    return encoded**gamma if curve == "gamma" else encoded


def encode(linear: Float, curve: str, gamma: float, bits: int) -> Image:
    """An image of `bits` (8 or 16) from linear values, clipped to 0..1; the sRGB curve is that of IEC 61966-2-1.

    >>> encode(np.array([0.18, 2.0]), "srgb", 2.2, 8).tolist()
    [118, 255]
    """
    encoded = np.clip(linear, 0.0, 1.0)
    if curve == "srgb":
        power = 1.055 * np.maximum(encoded, 1e-9) ** (1 / 2.4) - 0.055
        encoded = np.where(encoded <= 0.0031308, 12.92 * encoded, power)
    elif curve == "gamma":
        encoded = encoded ** (1.0 / gamma)
    numbers: Float = np.rint(encoded * (2**bits - 1))
    return numbers.astype(np.uint8) if bits == 8 else numbers.astype(np.uint16)
