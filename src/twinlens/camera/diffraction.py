"""Diffraction of an image at the aperture of the lens that took it."""

import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.film import checked_radiance
from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import BareAperture, Lens, check_lens, film_distance
from twinlens.errors import InputError
from twinlens.optics.diffraction import (
    CHANNEL_WAVELENGTHS,
    FRESNEL_HIGH,
    FRESNEL_LOW,
    FresnelWarning,
    check_wavelengths,
    convolve_airy,
    fresnel_number,
)


def diffract(
    image: ArrayLike, camera: Camera, lens: Lens, wavelengths: tuple[float, float, float] = CHANNEL_WAVELENGTHS
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
    check_lens(lens)
    if lens.aperture_diameter == 0:
        raise InputError("a pinhole (zero width) has no diffraction pattern; give the aperture a diameter")
    if lens.aperture.name != "disk":
        raise InputError(f"diffraction is available for a disk aperture only, got {lens.aperture.name}")
    distance = film_distance(camera, lens)
    numbers = [fresnel_number(lens.aperture_diameter, wavelength, distance) for wavelength in waves]
    if isinstance(lens, BareAperture) and max(numbers) > FRESNEL_LOW and min(numbers) < FRESNEL_HIGH:
        warnings.warn(
            f"bare aperture with Fresnel number {numbers[len(numbers) // 2]:.3g}: between {FRESNEL_LOW:g} and "
            f"{FRESNEL_HIGH:g} blur and diffraction are not separable; more than a tenth of the light is misplaced",
            FresnelWarning,
            stacklevel=2,
        )
    pitch = (distance / camera.fx, distance / camera.fy)
    blurred = [
        convolve_airy(radiance[..., c], pitch, wavelength, distance / lens.aperture_diameter)
        for c, wavelength in enumerate(waves)
    ]
    return np.stack(blurred, axis=-1).astype(np.float32)
