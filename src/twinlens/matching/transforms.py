"""Image transforms before matching: census and rank, invariant to monotonic brightness changes, and a clipped Sobel."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.images import Image, extended

SOBEL_CAP = 31


def described(image: Image, transform: str, side: int) -> list[Image]:
    """The images whose pixels are compared: census words, ranks, or the image itself."""
    if transform == "census":
        return census_images(image, side)
    return [rank_image(image, side)] if transform == "rank" else [image]


def census_images(image: Image, side: int) -> list[NDArray[Any]]:
    """One bit for each neighbour in the window, set where it is darker than the centre.

    uint32 words up to 5x5, uint64 beyond; as many images of words as the window needs.
    Source: Zabih and Woodfill, "Non-parametric local transforms for computing visual correspondence", ECCV 1994.
    """
    from twinlens.matching.kernels.windows import census_words

    word = np.uint32 if side <= 5 else np.uint64
    room, bits, radius = 8 * np.dtype(word).itemsize, side * side - 1, side // 2
    rows, columns = ((-radius, size + radius) for size in image.shape)
    padded = extended(image, rows, columns)
    result = [np.zeros(image.shape, word) for _ in range(0, max(bits, 1), room)]
    for index, words in enumerate(result):
        census_words(padded, side, index * room, min((index + 1) * room, bits), words)
    return result


def rank_image(image: Image, side: int) -> NDArray[Any]:
    """Number of neighbours in the window that are darker than the centre: uint8, or uint16 for windows above 15x15.

    Source: Zabih and Woodfill, 1994, as census.
    """
    radius, (height, width) = side // 2, image.shape
    padded = extended(image, (-radius, height + radius), (-radius, width + radius))
    result = np.zeros(image.shape, np.uint8 if side <= 15 else np.uint16)
    for y, x in np.ndindex(side, side):  # the centre is not darker than itself
        result += padded[y : y + height, x : x + width] < image
    return result


def clipped_slope(levels: NDArray[np.int32]) -> NDArray[np.uint8]:
    """The horizontal Sobel derivative of grey levels 0..255, clipped to +-31 and raised by 31: uint8 from 0 to 62.

    The prefilter of OpenCV's StereoBM (PREFILTER_XSOBEL with its default cap): invariant to offsets, and no edge
    dominates a window. Sobel: (1, 2, 1) down times (-1, 0, 1) across, edges continued.
    Source: OpenCV, modules/calib3d/src/stereobm.cpp; the idea is Konolige's, "Small vision systems", 1997.

    >>> clipped_slope(np.array([[0, 3, 6, 200]], np.int32))
    array([[43, 55, 62, 62]], dtype=uint8)
    """
    height, width = levels.shape
    padded = extended(levels, (-1, height + 1), (-1, width + 1))
    down = padded[:-2] + 2 * padded[1:-1] + padded[2:]
    slope = down[:, 2:] - down[:, :-2]
    return np.asarray(np.clip(slope, -SOBEL_CAP, SOBEL_CAP) + SOBEL_CAP, np.uint8)
