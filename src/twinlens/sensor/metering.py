"""The exposure that a sensor chooses for images, and the light that it gets from a grey surface."""

import math
from collections.abc import Sequence

from numpy.typing import ArrayLike

from twinlens.camera import ApertureLens, Camera, ThinLens
from twinlens.errors import InputError, check_number
from twinlens.optics.rig_task import Light
from twinlens.sensor.exposure import MIDDLE_GREY, Exposure
from twinlens.sensor.model import Sensor


def auto_exposure(
    images: Sequence[ArrayLike],
    *,
    sensor: Sensor,
    cameras: Sequence[Camera] | Camera,
    lens: ApertureLens,
) -> Exposure:
    """One exposure for all `images` (linear radiance (H, W, 3)), so that a stereo pair is exposed equally.

    The geometric mean luminance of the pixels that are not black becomes 18% of white. If the brightest 2% would
    exceed 90% of white, the exposure is reduced by up to two stops. Time is increased first, up to the sensor's
    `longest_exposure`, then gain, up to its `largest_gain`. A black image gets both limits.
    """
    if isinstance(cameras, Camera):
        cameras = [cameras] * len(images)
    if not images or len(cameras) != len(images):
        raise InputError(
            f"auto exposure needs images and one camera each, got {len(images)} and {len(cameras)}"
        )
    return sensor.metered(images, cameras, lens)


def light_on_grey(
    sensor: Sensor,
    illuminance_lux: float,
    pixel_pitch_um: float,
    longest_exposure: float,
    least_snr: float = 10.0,
) -> Light:
    """The light that a mid-grey (18 %) diffuse surface gives to a pixel, for `plan_rig`.

    The surface has the luminance 0.18 E / pi and equal radiances in the sensor's three bands. The signal is that of the
    green band, and of all three for `filters="mono"`.

    >>> from twinlens.sensor import Sensor
    >>> round(light_on_grey(Sensor(), 500, pixel_pitch_um=3.45, longest_exposure=0.01).electrons_per_second)
    434120
    """
    check_number(
        "illuminance_lux",
        illuminance_lux,
        "a number of lux, 1e-6 to 1e9",
        least=1e-6,
        most=1e9,
    )
    efficacy = sum(
        683.0 * _luminosity(1e9 * wavelength) for wavelength in sensor.wavelengths
    )
    radiance = (
        MIDDLE_GREY * illuminance_lux / math.pi / efficacy / sensor.radiance_scale
    )
    camera = Camera.from_fov(1, 1, 90, pixel_pitch_um)
    lens = ThinLens(camera.film_distance, math.inf)  # f/1
    rates = radiance * sensor.electrons_per_radiance(camera, lens)
    rate = float(rates.sum() if sensor.filters == "mono" else rates[1])
    return Light(
        rate,
        longest_exposure,
        sensor.read_noise,
        MIDDLE_GREY * sensor.full_well,
        least_snr,
    )


def _luminosity(nm: float) -> float:
    """CIE 1931 luminous efficiency. Source: Wyman, Sloan and Shirley, JCGT 2(2), 2013, the fit of two lobes."""
    lobes = ((0.821, 568.8, 0.0213, 0.0247), (0.286, 530.9, 0.0613, 0.0322))
    return sum(
        height * math.exp(-0.5 * ((nm - peak) * (left if nm < peak else right)) ** 2)
        for height, peak, left, right in lobes
    )
