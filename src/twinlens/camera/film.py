"""Images on the film of a camera: the check of linear radiance, the inverted image of a real film, diffraction."""

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import (
    ApertureLens,
    film_distance,
    require_aperture,
)
from twinlens.errors import InputError, check_known, format_value
from twinlens.optics.diffraction import (
    CHANNEL_WAVELENGTHS,
    FRESNEL_HIGH,
    FRESNEL_LOW,
    FresnelWarning,
    check_wavelengths,
    convolve_airy,
    fresnel_number,
)

SENSOR_WIDTHS_MM = {
    "1/3": 4.8, "1/2.5": 5.76, "1/2.3": 6.17, "1/2": 6.4, "1/1.8": 7.18, "1/1.7": 7.6, "2/3": 8.8, "1": 13.2,
    "4/3": 17.3, "APS-C": 23.5, "35mm": 36.0,
}  # fmt: skip
"""Widths of sensor formats in mm; APS-C is that of Nikon and Sony, Canon's is 22.3 mm. Source: the table of sensor
formats and sizes in Wikipedia, Image sensor format; 36 x 24 mm is the image size of 135 film, ISO 1007."""


def film_image(image: NDArray[Any]) -> NDArray[Any]:
    """`image` (H, W, ...) rotated by 180 degrees: the image on the film behind the aperture, seen from behind.

    twinlens renders the upright image of a film in front of the aperture. The principal point (cx, cy) becomes
    (W - 1 - cx, H - 1 - cy). The function is its own inverse.

    >>> film_image(np.array([[1, 2], [3, 4]])).tolist()
    [[4, 3], [2, 1]]
    """
    return np.ascontiguousarray(image[::-1, ::-1])


def checked_radiance(
    name: str, radiance: ArrayLike, camera: Camera
) -> NDArray[np.float64]:
    """`radiance` as a float64 (H, W, 3) image of the camera's size.

    Raises InputError, starting with `name`, unless it is an array of that shape of finite real numbers >= 0.
    """
    if not isinstance(camera, Camera):
        raise InputError(f"camera must be a Camera, got {format_value(camera)}")
    allowed = f"an array (H, W, 3) = {(camera.height, camera.width, 3)} of real numbers, the size of its camera"
    try:
        image = np.asarray(radiance)
    except ValueError as error:
        raise InputError(
            f"{name} must be {allowed}, got rows of unequal length"
        ) from error
    if image.dtype.kind not in "buif" or image.shape != (
        camera.height,
        camera.width,
        3,
    ):
        raise InputError(
            f"{name} must be {allowed}, got {image.dtype} of shape {image.shape}"
        )
    if not (np.isfinite(image).all() and (image >= 0).all()):
        raise InputError(
            f"{name} must be finite and >= 0 (linear radiance), got NaN, infinite or negative values"
        )
    return image.astype(np.float64, copy=False)


def diffract(
    image: ArrayLike,
    camera: Camera,
    lens: ApertureLens,
    wavelengths: tuple[float, float, float] = CHANNEL_WAVELENGTHS,
) -> NDArray[np.float32]:
    """`image`, linear radiance (H, W, 3), blurred by diffraction at the circular aperture of `lens`; float32 (H, W, 3).

    Each channel is convolved with the Airy kernel of its wavelength (metres, red, green, blue). Borders are continued
    by reflection. The pattern is cut where at most 0.5% of the light is outside, or at the image's size, and scaled
    to sum 1. The kernel is integrated over the pixel, and a rendered image already is: the second integration is a blur
    of 0.29 pixels standard deviation. To avoid it, render and diffract at several times the resolution, and average.

    In focus this is correct. Out of focus, and always behind a bare aperture, the true pattern is Fresnel's:
    docs/camera.md has the share of misplaced light by Fresnel number n. A `FresnelWarning` is given for a bare
    aperture with 0.2 < n < 50, where it exceeds 9%.

    Raises InputError for an aperture of zero width or other than a disk, and for a wrong image or wavelengths.
    """
    radiance = checked_radiance("image to diffract", image, camera)
    waves = check_wavelengths("wavelengths", wavelengths)
    require_aperture(lens, "diffraction")
    if lens.aperture_diameter == 0:
        raise InputError(
            "a pinhole (zero width) has no diffraction pattern; give the aperture a diameter"
        )
    if lens.aperture.name != "disk":
        raise InputError(
            f"diffraction is available for a disk aperture only, got {lens.aperture.name}"
        )
    distance = film_distance(camera, lens)
    if lens.is_bare:
        _warn_of_fresnel(lens.aperture_diameter, distance, waves)
    pitch = (distance / camera.fx, distance / camera.fy)
    number = distance / lens.aperture_diameter
    blurred = [
        convolve_airy(radiance[..., channel], pitch, wavelength, number)
        for channel, wavelength in enumerate(waves)
    ]
    return np.stack(blurred, axis=-1).astype(np.float32)


def _warn_of_fresnel(
    diameter: float, distance: float, wavelengths: Sequence[float]
) -> None:
    """Give a `FresnelWarning` where the pattern of a bare aperture is neither its shadow nor Fraunhofer's."""
    numbers = [
        fresnel_number(diameter, wavelength, distance) for wavelength in wavelengths
    ]
    if max(numbers) > FRESNEL_LOW and min(numbers) < FRESNEL_HIGH:
        warnings.warn(
            f"bare aperture with Fresnel number {numbers[len(numbers) // 2]:.3g}: between {FRESNEL_LOW:g} and "
            f"{FRESNEL_HIGH:g} blur and diffraction are not separable; more than a tenth of the light is misplaced",
            FresnelWarning,
            stacklevel=3,
        )


def sensor_width_mm(value: Any) -> float:
    """The width of a sensor in mm, given as a number or as a name of `SENSOR_WIDTHS_MM`.

    >>> sensor_width_mm("APS-C"), sensor_width_mm(36)
    (23.5, 36.0)

    Raises InputError for another name, and unless the number is positive.
    """
    if isinstance(value, str):
        check_known("sensor format", value, SENSOR_WIDTHS_MM)
        return SENSOR_WIDTHS_MM[value]
    if (
        not isinstance(value, (int, float))
        or isinstance(value, bool)
        or not 0 < value < math.inf
    ):
        raise InputError(
            f"must be a positive number or the name of a format, got {format_value(value)}"
        )
    return float(value)
