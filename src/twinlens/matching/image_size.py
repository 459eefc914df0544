"""Limits of a search by the size of the images."""

from typing import Any

from twinlens.errors import InputError

DEFAULT_DISPARITIES = 64
LARGEST_DEFAULT_WINDOW = 35
"""The largest default of a window option, over all methods."""
WINDOW_OPTIONS = ("block_size", "census_window", "median")


def check_image_size(matcher: Any, size: tuple[int, ...]) -> None:
    """Refuse search ranges and windows that are larger than images of `size` (H, W) can use.

    Two pixels of a row of W are at most W - 1 apart, so there are 2 W - 1 disparities; a window with a side of
    2 max(H, W) - 1 covers the whole image at every pixel. Defaults are always allowed. Raises InputError.
    """
    height, width = size
    disparities = f"an image {width} pixels wide has disparities from {1 - width} to {width - 1}"
    count, first = getattr(matcher, "num_disparities", 1), getattr(matcher, "min_disparity", 0)
    if count > max(2 * width - 1, DEFAULT_DISPARITIES):
        raise InputError(f"num_disparities is {count}: {disparities}, {2 * width - 1} in all")
    if not -width < first < width:
        raise InputError(f"min_disparity is {first}: {disparities}")
    largest = max(2 * max(size) - 1, LARGEST_DEFAULT_WINDOW)
    for option in WINDOW_OPTIONS:
        window = getattr(matcher, option, 0)
        if window > largest:
            covered = f"a window of {largest} covers all of an image of {width} x {height} at every pixel"
            raise InputError(f"{option} is {window}: {covered}")
