"""What a sensor asks of the values it is given."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError


def check_number(name: str, value: float, *, above: float | None = None, least: float | None = None) -> None:
    """InputError unless `value` is finite, and > `above` or >= `least`."""
    fine = math.isfinite(value) and (above is None or value > above) and (least is None or value >= least)
    if not fine:
        bound = f"> {above:g}" if above is not None else f">= {least:g}"
        raise InputError(f"sensor {name} must be a finite number {bound}, got {value}")


def check_triple(name: str, values: tuple[float, ...]) -> None:
    """InputError unless there are three positive numbers."""
    if len(values) != 3 or not all(v > 0 and math.isfinite(v) for v in values):
        raise InputError(f"sensor {name} must be three positive numbers (red, green, blue), got {values}")


def check_seed(name: str, value: int) -> None:
    """InputError unless `value` is a whole number >= 0."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
        raise InputError(f"{name} must be a whole number >= 0, got {value}")


def checked_radiance(radiance: ArrayLike, camera: Camera) -> NDArray[np.float64]:
    """`radiance` as float64 (H, W, 3) of the camera's size; InputError for another shape, NaN or negative values."""
    image = np.asarray(radiance, dtype=np.float64)
    wanted = (camera.height, camera.width, 3)
    if image.shape != wanted:
        raise InputError(f"radiance must be (H, W, 3) = {wanted} as the camera is, got shape {image.shape}")
    if not (np.isfinite(image).all() and (image >= 0).all()):
        raise InputError("radiance must be finite and >= 0; NaN, infinite and negative values are refused")
    return image
