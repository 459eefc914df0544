"""Maps as pictures for a study's panels: disparity in colour, errors in grey. For eyes alone."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

_STOPS = np.array(
    [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], np.float64
)  # viridis, every quarter
_UNKNOWN = np.array([196, 200, 206], np.uint8)


def disparity_picture(disparity: ArrayLike, top: float) -> NDArray[np.uint8]:
    """(H, W) disparities as uint8 (H, W, 3), viridis from 0 to `top`; light grey where unknown."""
    values = np.asarray(disparity, np.float64)
    known = np.isfinite(values)
    share = np.clip(np.where(known, values, 0.0) / top, 0.0, 1.0)
    places = np.linspace(0.0, 1.0, len(_STOPS))
    colour = np.stack([np.interp(share, places, _STOPS[:, k]) for k in range(3)], axis=-1)
    return np.where(known[..., None], np.rint(colour).astype(np.uint8), _UNKNOWN)


def error_picture(found: ArrayLike, truth: ArrayLike, most: float = 4.0) -> NDArray[np.uint8]:
    """|found - truth| as uint8 (H, W, 3): white 0, black `most` px or unknown; light grey where there is no truth."""
    true, estimate = np.asarray(truth, np.float64), np.asarray(found, np.float64)
    known = np.isfinite(true)
    error = np.where(
        known & np.isfinite(estimate), np.abs(np.where(known, estimate - np.where(known, true, 0), 0)), np.inf
    )
    grey = np.rint(255 * (1 - np.clip(error / most, 0, 1))).astype(np.uint8)
    return np.where(known[..., None], np.repeat(grey[..., None], 3, axis=2), _UNKNOWN)


def crop(image: NDArray[np.uint8], x: int, y: int, width: int, height: int, zoom: int = 1) -> NDArray[np.uint8]:
    """A part of the image, each pixel drawn `zoom` times as large."""
    part = image[y : y + height, x : x + width]
    return np.repeat(np.repeat(part, zoom, axis=0), zoom, axis=1)
