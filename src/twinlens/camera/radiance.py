"""The picture that a camera's film receives, before diffraction or a sensor make anything of it: linear radiance."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError, format_value

_REAL = "buif"  # numpy's kinds of truth values, integers and floating-point numbers


def checked_radiance(name: str, radiance: ArrayLike, camera: Camera) -> NDArray[np.float64]:
    """`radiance` as float64 (H, W, 3) of the camera's size.

    Raises InputError, which begins with `name`, for what is no array of real numbers, for another shape, and for NaN,
    infinite and negative values.
    """
    if not isinstance(camera, Camera):
        raise InputError(f"camera must be a Camera, got {format_value(camera)}")
    wanted = (camera.height, camera.width, 3)
    try:
        image = np.asarray(radiance)
    except ValueError as error:
        raise InputError(
            f"{name} must be one array (H, W, 3) = {wanted} of numbers, got rows of unequal shape"
        ) from error
    if image.dtype.kind not in _REAL:
        raise InputError(f"{name} must be an array (H, W, 3) = {wanted} of real numbers, got {image.dtype}")
    if image.shape != wanted:
        raise InputError(f"{name} must be (H, W, 3) = {wanted} as the camera is, got shape {image.shape}")
    if not (np.isfinite(image).all() and (image >= 0).all()):
        raise InputError(
            f"{name} must be finite and >= 0, linear radiance: NaN, infinite and negative values are refused"
        )
    return image.astype(np.float64, copy=False)
