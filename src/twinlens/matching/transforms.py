"""Images made of order instead of brightness: census and rank, which no monotonic change of exposure can move."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.matching.images import Image, extended


def neighbours(image: Image, side: int) -> list[Image]:
    """The image shifted to each pixel of a window but its centre, row by row; edges are continued."""
    radius, (height, width) = side // 2, image.shape
    padded = extended(image, (-radius, height + radius), (-radius, width + radius))
    places = [(y, x) for y in range(side) for x in range(side) if (y, x) != (radius, radius)]
    return [padded[y : y + height, x : x + width] for y, x in places]


def census_images(image: Image, side: int) -> list[NDArray[Any]]:
    """One bit for each neighbour in the window: is it darker than the centre?

    uint32 words up to 5x5, uint64 beyond, and as many images of words as the window needs.
    Source: Zabih and Woodfill, "Non-parametric local transforms for computing visual correspondence", ECCV 1994.
    """
    from twinlens.matching.kernels.order import census_words

    word = np.uint32 if side <= 5 else np.uint64
    room, bits, radius = 8 * np.dtype(word).itemsize, side * side - 1, side // 2
    rows, columns = ((-radius, size + radius) for size in image.shape)
    padded = extended(image, rows, columns)
    result = [np.zeros(image.shape, word) for _ in range(0, max(bits, 1), room)]
    for index, words in enumerate(result):
        census_words(padded, side, index * room, min((index + 1) * room, bits), words)
    return result


def rank_image(image: Image, side: int) -> NDArray[Any]:
    """How many neighbours in the window are darker than the centre: uint8, or uint16 for windows above 15x15.

    Source: Zabih and Woodfill, 1994, as census.
    """
    result = np.zeros(image.shape, np.uint8 if side <= 15 else np.uint16)
    for shifted in neighbours(image, side):
        result += shifted < image
    return result
