"""From the converter's numbers to a picture: white balance, demosaicing, a curve, and 8 or 16 bits."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import MissingExtraError

Float = NDArray[np.float64]

BAYER = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Colour filter mosaics, named by the 2x2 block at the top left, row by row."""

FILTERS = ("rgb", "mono", *BAYER)
"""`rgb`: three values at every pixel, as three chips behind a prism. `mono`: one, of all three bands."""

_DEMOSAIC_RANGE = 65535.0


class Curve(Protocol):
    """From linear values in 0..1 to encoded ones in 0..1."""

    def __call__(self, linear: Float, gamma: float) -> Float: ...


def srgb(linear: Float, gamma: float = 2.4) -> Float:
    """The curve of sRGB, IEC 61966-2-1; `gamma` plays no part.

    >>> round(float(srgb(np.array(0.18))) * 255)
    118
    """
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def _straight(linear: Float, gamma: float) -> Float:
    return linear


def _power(linear: Float, gamma: float) -> Float:
    encoded: Float = linear ** (1.0 / gamma)
    return encoded


CURVES: dict[str, Curve] = {"srgb": srgb, "linear": _straight, "gamma": _power}


def channel_map(pattern: str, height: int, width: int) -> NDArray[np.intp]:
    """Which channel (0 red, 1 green, 2 blue) each pixel of a mosaic sees, (H, W).

    >>> channel_map("GRBG", 2, 4).tolist()
    [[1, 0, 1, 0], [2, 1, 2, 1]]
    """
    block = np.array(["RGB".index(letter) for letter in pattern]).reshape(2, 2)
    return block[np.arange(height)[:, None] % 2, np.arange(width) % 2]


def mosaic(values: Float, pattern: str) -> Float:
    """What a mosaic (H, W) sees of values (H, W, 3)."""
    channel = channel_map(pattern, *values.shape[:2])
    return np.take_along_axis(values, channel[..., None], axis=2)[..., 0]


def demosaic(values: Float, pattern: str) -> Float:
    """Three channels (H, W, 3) of a mosaic (H, W) in 0..1, by OpenCV's edge-aware interpolation in 16 bits.

    Raises MissingExtraError without OpenCV.
    """
    cv2 = _opencv()
    code = getattr(cv2, f"COLOR_Bayer{pattern}2RGB_EA")
    whole = np.rint(np.clip(values, 0.0, 1.0) * _DEMOSAIC_RANGE).astype(np.uint16)
    full: Float = cv2.cvtColor(whole, code).astype(np.float64)
    return full / _DEMOSAIC_RANGE


def encode(linear: Float, curve: str, gamma: float, bits: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """A picture of `bits` (8 or 16) from linear values, clipped to 0..1."""
    encoded: Float = np.rint(CURVES[curve](np.clip(linear, 0.0, 1.0), gamma) * (2**bits - 1))
    return encoded.astype(np.uint8) if bits == 8 else encoded.astype(np.uint16)


def _opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("demosaicing a Bayer sensor needs OpenCV: pip install 'twinlens[opencv]'") from error
    return cv2
