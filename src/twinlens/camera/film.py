"""Images on the film of a camera: the check of linear radiance, the inverted image of a real film, false colours."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError, check_known, format_value

SENSOR_WIDTHS_MM = {"1/2.3": 6.17, "1/1.7": 7.6, "2/3": 8.8, "1": 13.2, "4/3": 17.3, "APS-C": 23.5, "35mm": 36.0}
"""Widths of sensor formats in mm; APS-C is that of Nikon and Sony, Canon's is 22.3 mm. Source: the table of sensor
formats and sizes in Wikipedia, Image sensor format; 36 x 24 mm is the image size of 135 film, ISO 1007."""

NO_TRUTH = (196, 200, 206)  # light grey: viridis, magma and berlin contain no greys


def film_image(image: NDArray[Any]) -> NDArray[Any]:
    """`image` (H, W, ...) rotated by 180 degrees: the image on the film behind the aperture, seen from behind.

    twinlens renders the upright image of a film in front of the aperture. The principal point (cx, cy) becomes
    (W - 1 - cx, H - 1 - cy). The function is its own inverse.

    >>> film_image(np.array([[1, 2], [3, 4]])).tolist()
    [[4, 3], [2, 1]]
    """
    return np.ascontiguousarray(image[::-1, ::-1])


def checked_radiance(name: str, radiance: ArrayLike, camera: Camera) -> NDArray[np.float64]:
    """`radiance` as a float64 (H, W, 3) image of the camera's size.

    Raises InputError, starting with `name`, unless it is an array of that shape of finite real numbers >= 0.
    """
    if not isinstance(camera, Camera):
        raise InputError(f"camera must be a Camera, got {format_value(camera)}")
    allowed = f"an array (H, W, 3) = {(camera.height, camera.width, 3)} of real numbers, the size of its camera"
    try:
        image = np.asarray(radiance)
    except ValueError as error:
        raise InputError(f"{name} must be {allowed}, got rows of unequal length") from error
    if image.dtype.kind not in "buif" or image.shape != (camera.height, camera.width, 3):
        raise InputError(f"{name} must be {allowed}, got {image.dtype} of shape {image.shape}")
    if not (np.isfinite(image).all() and (image >= 0).all()):
        raise InputError(f"{name} must be finite and >= 0 (linear radiance), got NaN, infinite or negative values")
    return image.astype(np.float64, copy=False)


def rgb8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """A uint8 or uint16 image (H, W[, 3]) as uint8 (H, W, 3)."""
    eight = (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image.astype(np.uint8)
    return np.repeat(eight[..., None], 3, axis=2) if eight.ndim == 2 else eight


def colourise(
    values: ArrayLike, low: float, high: float, colormap: str = "viridis", unknown_colour: Sequence[int] = NO_TRUTH
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
    colours = matplotlib.colormaps[colormap](np.rint(np.clip(share, 0, 1) * 255).astype(np.intp))
    return np.where(known[..., None], np.rint(255 * colours[..., :3]), unknown_colour).astype(np.uint8)


def disparity_limits(disparity: ArrayLike, matcher: object) -> tuple[float, float]:
    """(low, high) for the colours of a disparity map, at least 1 apart.

    The matcher's search range, or the range of the map if the matcher has none or searches one disparity.
    """
    values = np.asarray(disparity)
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    first, count = getattr(matcher, "min_disparity", None), getattr(matcher, "num_disparities", None)
    if first is not None and count is not None and count > 1:
        low, high = float(first), float(first + count - 1)
    return low, max(high, low + 1.0)


def sensor_width_mm(value: Any) -> float:
    """The width of a sensor in mm, given as a number or as a name of `SENSOR_WIDTHS_MM`.

    >>> sensor_width_mm("APS-C"), sensor_width_mm(36)
    (23.5, 36.0)

    Raises InputError for another name, and unless the number is positive.
    """
    if isinstance(value, str):
        check_known("sensor format", value, SENSOR_WIDTHS_MM)
        return SENSOR_WIDTHS_MM[value]
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0 < value < math.inf:
        raise InputError(f"must be a positive number or the name of a format, got {format_value(value)}")
    return float(value)
