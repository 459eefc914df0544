"""Electrons per second from the light on the film.

    rate = QE * E * pixel area / (h c / lambda)        electrons per second in a pixel

E is that of the lens (`ApertureLens.irradiance`). A rendered image is the mean radiance over the open aperture,
weighted evenly: natural vignetting is the cos^4 of the aperture's centre, also for wide apertures. Mechanical
vignetting darkens the image; the blur circles keep their shape.

Source: EMVA Standard 1288, release 4.0 linear, section 2.
"""

import math
import warnings

from twinlens.camera import ApertureLens, Camera, film_distance
from twinlens.geometry import Float
from twinlens.optics.irradiance import lens_irradiance

PLANCK = 6.62607015e-34  # J s, exact in the SI
SPEED = 299792458.0  # m/s, of light, exact in the SI


class ParaxialWarning(UserWarning):
    """The working f-number of a lens is below 1, where the paraxial formula gives too much light."""


def warn_below_f1(camera: Camera, lens: ApertureLens, stacklevel: int) -> None:
    """Give a `ParaxialWarning` for a lens of v/A < 1; for given exposures, as automatic ones compensate."""
    if lens.is_bare:
        return  # its formula is exact
    number = working_f_number(camera, lens, math.inf)
    if number < 1:
        warnings.warn(
            f"working f-number v/A = {number:.3g} is below 1, where the paraxial formula pi/4 (A/v)^2 L gives too much "
            "light: use a smaller aperture, or give the camera a larger pixel_pitch_um",
            ParaxialWarning,
            stacklevel=stacklevel,
        )


def working_f_number(
    camera: Camera, lens: ApertureLens, pinhole_f_number: float
) -> float:
    """N = v/A; `pinhole_f_number` for an aperture of zero width.

    Not f/A, the number engraved on a lens (`ThinLens.from_f_number`); they are equal for a focus at infinity.
    """
    diameter = lens.aperture_diameter
    return film_distance(camera, lens) / diameter if diameter > 0 else pinhole_f_number


def irradiance_factor(
    camera: Camera, lens: ApertureLens, pinhole_f_number: float
) -> float:
    """E/L in steradians, on the axis; that of `pinhole_f_number` for an aperture of zero width.

    >>> from twinlens.camera import ThinLens
    >>> camera = Camera.from_fov(640, 480, fov_x_deg=50)
    >>> lens = ThinLens(camera.film_distance / 2, focus_distance=1.0)
    >>> round(irradiance_factor(camera, lens, 8.0) / math.pi, 12)
    0.0625
    """
    if lens.aperture_diameter > 0:
        return lens.irradiance(camera)
    return lens_irradiance(pinhole_f_number)


def vignetting(camera: Camera, lens: ApertureLens) -> Float:
    """The light of the pixels relative to the axis, (H, W): `ApertureLens.relative_light`."""
    return lens.relative_light(camera)
