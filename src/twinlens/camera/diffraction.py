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

    Each channel is convolved with the Airy kernel of its wavelength (metres, red, green, blue; by default
    `twinlens.optics.diffraction.CHANNEL_WAVELENGTHS`). Borders are continued by reflection. The pattern decreases as
    1/r^3: it is cut where at most 0.5% of the light is outside, or at the size of the image, and scaled to sum 1.

    The kernel is integrated over the pixel, and a rendered image already is: the pixel's square is applied twice. The
    second one is a blur of 1/sqrt(12) = 0.29 pixels standard deviation, with contrast sinc(f) at f cycles a pixel:
    0.99 at 0.08, 0.90 at 0.25, 0.64 at 0.5. To avoid it, render and diffract at several times the resolution, and
    average.

    Limits of the model. The image is made of rays: a point out of focus is a geometric disk, here convolved with the
    far-field pattern of the aperture. This is correct in focus. Out of focus, and always behind a bare aperture, the
    true pattern is Fresnel's. With the Fresnel number n = a^2 / (lambda v) of a bare aperture of radius a, the share of
    misplaced light is 1% at n = 0.05, 3% at 0.1, 9% at 0.2, 28% at 0.5 to 0.7, 24% at 1, 19% at 5 and 10% at 50,
    decreasing as 1/sqrt(n). At n = 1, the sharpest pinhole, the true peak is 4.4 times as high. A `FresnelWarning` is
    given for 0.2 < n < 50. Wider apertures form the geometric disk with fringes of width sqrt(lambda v), narrower ones
    the Airy pattern.

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
    if isinstance(lens, BareAperture):
        _warn_fresnel(lens.aperture_diameter, distance, waves)
    pitch = (distance / camera.fx, distance / camera.fy)
    blurred = [
        convolve_airy(radiance[..., c], pitch, wavelength, distance / lens.aperture_diameter)
        for c, wavelength in enumerate(waves)
    ]
    return np.stack(blurred, axis=-1).astype(np.float32)


def _warn_fresnel(diameter: float, distance: float, wavelengths: tuple[float, ...]) -> None:
    numbers = [fresnel_number(diameter, wavelength, distance) for wavelength in wavelengths]
    if max(numbers) > FRESNEL_LOW and min(numbers) < FRESNEL_HIGH:
        warnings.warn(
            f"bare aperture with Fresnel number {numbers[len(numbers) // 2]:.3g}: between {FRESNEL_LOW:g} and "
            f"{FRESNEL_HIGH:g} blur and diffraction are not separable; more than a tenth of the light is misplaced",
            FresnelWarning,
            stacklevel=3,
        )
