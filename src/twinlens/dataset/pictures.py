"""Pictures to look at: 8-bit colours, false colours of maps, and contact sheets."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageOps

from twinlens.errors import InputError, check_known

NO_TRUTH = (196, 200, 206)  # light grey: viridis, magma and berlin contain no greys
_TILE_WIDTH, _GAP = 160, 4


def rgb8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """A uint8 or uint16 image (H, W[, 3]) as uint8 (H, W, 3)."""
    eight = (
        (image >> 8).astype(np.uint8)
        if image.dtype == np.uint16
        else image.astype(np.uint8)
    )
    return np.repeat(eight[..., None], 3, axis=2) if eight.ndim == 2 else eight


def colourise(
    values: ArrayLike,
    low: float,
    high: float,
    colormap: str = "viridis",
    unknown_colour: Sequence[int] = NO_TRUTH,
) -> NDArray[np.uint8]:
    """(H, W) numbers as a uint8 (H, W, 3) sRGB image; the colormap spans [low, high], values outside saturate.

    Values that are not finite get `unknown_colour`. Raises InputError unless `colormap` is one of matplotlib's, and
    low < high.

    >>> colourise([[0.0, 1.0, np.inf]], 0, 1).tolist()
    [[[68, 1, 84], [253, 231, 37], [196, 200, 206]]]
    """
    import matplotlib

    check_known("colormap", colormap, matplotlib.colormaps)
    if not low < high:
        raise InputError(f"the colour range is [{low}, {high}]: expected low < high")
    numbers = np.asarray(values, np.float64)
    known = np.isfinite(numbers)
    share = (np.where(known, numbers, low) - low) / (high - low)
    colours = matplotlib.colormaps[colormap](
        np.rint(np.clip(share, 0, 1) * 255).astype(np.intp)
    )
    return np.where(
        known[..., None], np.rint(255 * colours[..., :3]), unknown_colour
    ).astype(np.uint8)


def disparity_limits(disparity: ArrayLike, matcher: object) -> tuple[float, float]:
    """(low, high) for the colours of a disparity map, at least 1 apart.

    The matcher's search range, or the range of the map if the matcher has none or searches one disparity.
    """
    values = np.asarray(disparity)
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    first, count = (
        getattr(matcher, "min_disparity", None),
        getattr(matcher, "num_disparities", None),
    )
    if first is not None and count is not None and count > 1:
        low, high = float(first), float(first + count - 1)
    return low, max(high, low + 1.0)


def tile(image: NDArray[Any]) -> Image.Image:
    """A uint8 or uint16 image (H, W[, 3]) scaled to a width of 160 pixels."""
    picture = Image.fromarray(rgb8(image)).reduce(
        max(1, image.shape[1] // (3 * _TILE_WIDTH))
    )
    height = max(round(_TILE_WIDTH * image.shape[0] / image.shape[1]), 1)
    return picture.resize((_TILE_WIDTH, height), Image.Resampling.LANCZOS)


def contact_sheet(tiles: Sequence[Image.Image], columns: int = 8) -> Image.Image:
    """Tiles in rows, padded to the size of the first. Raises InputError without tiles."""
    from skimage.util import montage

    if not tiles:
        raise InputError("a contact sheet needs one or more images")
    columns = min(columns, len(tiles))
    padded = [ImageOps.pad(each, tiles[0].size, color="white") for each in tiles]
    grid = {
        "grid_shape": (-(-len(tiles) // columns), columns),
        "padding_width": _GAP,
        "fill": (255, 255, 255),
    }
    return Image.fromarray(
        montage(
            np.stack([np.asarray(each) for each in padded]), channel_axis=-1, **grid
        )
    )
