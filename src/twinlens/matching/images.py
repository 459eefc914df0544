"""The images that matchers accept, of one size and dtype with finite values, and their transforms before matching."""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError

Image = NDArray[Any]
Disparity = NDArray[np.float32]
Confidence = NDArray[np.float32]

SOBEL_CAP = 31
LUMA_14_BIT = (4899, 9617, 1868)  # 0.299, 0.587, 0.114 in 1/16384; they sum to 16384


def grey(image: Image) -> Image:
    """The luma of a colour image, Y = 0.299 R + 0.587 G + 0.114 B, in the image's own dtype.

    Grey images are returned unchanged. Integers are weighted in 1/16384 and rounded half up, so that equal channels
    keep their value. The weights apply to the stored (gamma-encoded) values, as in video and OpenCV's BGR2GRAY.

    Parameters: image (H, W), (H, W, 1) or (H, W, 3). Returns (H, W). Source: ITU-R BT.601-7, section 2.5.1.

    >>> grey(np.full((1, 2, 3), 200, np.uint8))
    array([[200, 200]], dtype=uint8)
    """
    if image.ndim == 2:
        return image
    if image.ndim == 3 and image.shape[2] == 1:
        return image[:, :, 0]
    if image.ndim != 3 or image.shape[2] != 3:
        raise InputError(
            f"an image has shape {image.shape}; (H, W) or (H, W, 3) can be matched"
        )
    red, green, blue = (image[:, :, channel] for channel in range(3))
    if image.dtype.kind not in "iu":
        return np.asarray(0.299 * red + 0.587 * green + 0.114 * blue, dtype=image.dtype)
    r, g, b = LUMA_14_BIT
    wide = (
        red.astype(np.int32) * r
        + green.astype(np.int32) * g
        + blue.astype(np.int32) * b
    )
    return ((wide + (1 << 13)) >> 14).astype(image.dtype)


def to_working_dtype(image: Image, name: str) -> Image:
    """The image in a dtype of the kernels, without loss: uint8, uint16 or float64.

    bool becomes 0 and 1; int8, int16, float16 and float32 become float64. InputError for other dtypes and NaN or inf.
    """
    if image.dtype == np.bool_:
        return image.astype(np.uint8)
    if image.dtype in (np.uint8, np.uint16):
        return image
    if image.dtype.kind != "f" and image.dtype not in (np.int8, np.int16):
        raise InputError(
            f"the {name} image is {image.dtype}; use uint8, uint16 or float32"
        )
    bad = np.argwhere(~np.isfinite(image))
    if len(bad):
        place = ", ".join(str(i) for i in bad[0])
        raise InputError(
            f"the {name} image holds {image[tuple(bad[0])]} at [{place}]; every pixel must be finite"
        )
    return image.astype(np.float64)


def pair(left: Any, right: Any) -> tuple[Image, Image]:
    """Both images grey and in one working dtype: uint8, uint16 or float64. Raises InputError for anything else."""
    for name, image in (("left", left), ("right", right)):
        if isinstance(image, (str, os.PathLike)):
            remedy = "give an array: twinlens.dataset.read_image(path)"
            raise InputError(f"the {name} image is {os.fspath(image)!r}; {remedy}")
        if np.ndim(image) not in (2, 3) or 0 in np.shape(image):
            raise InputError(
                f"the {name} image has shape {np.shape(image)}; (H, W) or (H, W, 3) can be matched"
            )
    left, right = np.asarray(left), np.asarray(right)
    if left.shape[:2] != right.shape[:2]:
        sizes = " and ".join(
            f"{image.shape[1]}x{image.shape[0]}" for image in (left, right)
        )
        raise InputError(
            f"the left and right images are {sizes}; both must have one size"
        )
    if left.dtype != right.dtype:
        raise InputError(
            f"the left image is {left.dtype}, the right {right.dtype}; both must have one dtype"
        )
    left = grey(to_working_dtype(left, "left"))
    right = grey(to_working_dtype(right, "right"))
    return np.ascontiguousarray(left), np.ascontiguousarray(right)


def levels(left: Image, right: Image) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Both images as whole grey levels 0..255: uint8 as it is, uint16 / 257, floats from their common range."""
    if left.dtype == np.uint8:
        return left.astype(np.int32), right.astype(np.int32)
    low, high = 0.0, 65535.0
    if left.dtype.kind == "f":
        low, high = min(left.min(), right.min()), max(left.max(), right.max())
    scale = 255.0 / (high - low) if high > low else 0.0
    left_levels = np.rint((left - low) * scale).astype(np.int32)
    right_levels = np.rint((right - low) * scale).astype(np.int32)
    return left_levels, right_levels


def extended(image: Image, rows: tuple[int, int], columns: tuple[int, int]) -> Image:
    """image[..., rows[0]:rows[1], columns[0]:columns[1]]; pixels outside the image repeat its nearest edge pixel."""
    height, width = image.shape[-2:]
    taken = image.take(np.clip(np.arange(*rows), 0, height - 1), axis=-2)
    return taken.take(np.clip(np.arange(*columns), 0, width - 1), axis=-1)


def described(image: Image, transform: str, side: int) -> list[Image]:
    """The images whose pixels are compared: those of a transform, or the image itself.

    Census: one bit for each neighbour in the window, set where it is darker than the centre; uint32 words up to 5x5,
    uint64 beyond, as many images of words as the window needs. Rank: the number of these neighbours, uint8, or uint16
    for windows above 15x15. Bounds: one float64 image (3, H, W), the pixels and their minimum and maximum within half
    a pixel along the row, interpolated.
    Source: Zabih and Woodfill, "Non-parametric local transforms for computing visual correspondence", ECCV 1994.
    """
    if not transform:
        return [image]
    if transform == "bounds":
        return [_bounds(image)]
    radius, (height, width) = side // 2, image.shape
    padded = extended(image, (-radius, height + radius), (-radius, width + radius))
    if transform == "rank":
        return [_ranks(image, padded, side)]
    return _census(image, padded, side)


def _bounds(image: Image) -> Image:
    """(3, H, W): the pixels, and the least and the largest value within half a pixel along the row.

    The interpolation is linear, so the extremes are at the pixel and at its two half-way points.
    """
    wide = np.pad(image.astype(np.float64), ((0, 0), (1, 1)), mode="edge")
    pixel = wide[:, 1:-1]
    before = (wide[:, :-2] + pixel) / 2
    after = (pixel + wide[:, 2:]) / 2
    near = pixel, before, after
    return np.stack([pixel, np.min(near, axis=0), np.max(near, axis=0)])


def _ranks(image: Image, padded: Image, side: int) -> Image:
    """The number of pixels in the window that are darker than its centre."""
    height, width = image.shape
    ranks = np.zeros(image.shape, np.uint8 if side <= 15 else np.uint16)
    for y, x in np.ndindex(side, side):  # the centre is not darker than itself
        ranks += padded[y : y + height, x : x + width] < image
    return ranks


def _census(image: Image, padded: Image, side: int) -> list[Image]:
    """The words of the census, as many images as its side^2 - 1 bits need."""
    from twinlens.matching.kernels.windows import census_words

    word = np.uint32 if side <= 5 else np.uint64
    word_bits = 8 * np.dtype(word).itemsize
    bits = side * side - 1
    result = []
    # A window of one pixel has no neighbours, and a word of zeros.
    for first in range(0, max(bits, 1), word_bits):
        words = np.zeros(image.shape, word)
        census_words(padded, side, first, min(first + word_bits, bits), words)
        result.append(words)
    return result


def clipped_slope(levels: NDArray[np.int32]) -> NDArray[np.uint8]:
    """The horizontal Sobel derivative of grey levels 0..255, clipped to +-31 and raised by 31: uint8 from 0 to 62.

    The prefilter of OpenCV's StereoBM (PREFILTER_XSOBEL with its default cap): invariant to offsets, and no edge
    dominates a window. Source: OpenCV, modules/calib3d/src/stereobm.cpp; Konolige, "Small vision systems", 1997.

    >>> clipped_slope(np.array([[0, 3, 6, 200]], np.int32))
    array([[43, 55, 62, 62]], dtype=uint8)
    """
    height, width = levels.shape
    padded = extended(levels, (-1, height + 1), (-1, width + 1))
    down = padded[:-2] + 2 * padded[1:-1] + padded[2:]
    slope = down[:, 2:] - down[:, :-2]
    return np.asarray(np.clip(slope, -SOBEL_CAP, SOBEL_CAP) + SOBEL_CAP, np.uint8)
