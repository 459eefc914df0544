"""Exposure time and gain, automatic exposure, and the light of a scene for planning a rig."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from twinlens.camera import ApertureLens, Camera, ThinLens
from twinlens.errors import InputError, check_number, format_value
from twinlens.optics.rig_task import Light
from twinlens.settings import Setting, Settings

if TYPE_CHECKING:
    from twinlens.sensor.model import Sensor

_MIDDLE_GREY = 0.18  # of white: target of the geometric mean
_HIGHLIGHT = 0.9  # of white: limit of the highlight percentile
_HIGHLIGHT_PERCENTILE = 98.0
_STOPS_BELOW = 2.0  # largest reduction of the mean for the highlights
_BLACK = 1e-3  # of the highlight: darker pixels are excluded from the mean
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. ITU-R BT.709


@dataclass(frozen=True)
class Exposure(Settings, noun="exposure"):
    """Exposure time and gain. At gain 1 a full well fills the converter's range.

    Raises InputError when a value is out of range.
    """

    time: Annotated[float, Setting("Exposure time.", "seconds", least=1e-30, most=1e9)]
    gain: Annotated[
        float,
        Setting(
            "Factor of the base sensitivity, doubling per stop as ISO speeds do.",
            least=1e-9,
            most=1e9,
        ),
    ] = 1.0

    def value(self, working_f_number: float) -> float:
        """The exposure value EV = log2(N^2 / t), N = v/A.

        >>> Exposure(time=1 / 64).value(8.0)
        12.0
        """
        check_number(
            "working_f_number",
            working_f_number,
            "a positive number",
            least=1e-24,
            most=1e24,
        )
        return math.log2(working_f_number**2 / self.time)


def check_exposure(exposure: Exposure | None) -> None:
    """Raise InputError unless `exposure` is an Exposure, or None (automatic)."""
    if not isinstance(exposure, Exposure | None):
        raise InputError(
            f"exposure must be an Exposure or None (automatic), got {format_value(exposure)}"
        )


def auto_exposure(
    images: Sequence[ArrayLike],
    *,
    sensor: "Sensor",
    cameras: Sequence[Camera] | Camera,
    lens: ApertureLens,
) -> Exposure:
    """One exposure for all `images` (linear radiance (H, W, 3)), so that a stereo pair is exposed equally.

    The geometric mean luminance of the pixels that are not black becomes 18% of white. If the brightest 2% would
    exceed 90% of white, the exposure is reduced by up to two stops. Time is increased first, up to the sensor's
    `longest_exposure`, then gain, up to its `largest_gain`. A black image gets both limits.
    """
    per_image = (
        [cameras] * len(images) if isinstance(cameras, Camera) else list(cameras)
    )
    if not images or len(per_image) != len(images):
        raise InputError(
            f"auto exposure needs images and one camera each, got {len(images)} and {len(per_image)}"
        )
    levels = [
        sensor.level_rate(image, camera=c, lens=lens).reshape(-1, 3)
        for image, c in zip(images, per_image, strict=True)
    ]
    shares = np.concatenate(levels)  # (N, 3), of white per second at gain 1
    highlight = float(
        np.percentile(shares.max(axis=1), _HIGHLIGHT_PERCENTILE)
    ) or float(shares.max())
    product = math.inf  # time times gain, seconds
    if highlight > 0:
        luminance = shares @ _LUMINANCE
        lit = luminance[luminance > _BLACK * highlight]
        middle = _MIDDLE_GREY / float(np.exp(np.log(lit).mean()))
        product = max(min(middle, _HIGHLIGHT / highlight), middle / 2**_STOPS_BELOW)
    time = min(product, sensor.longest_exposure)
    return Exposure(time, min(max(product / time, 1.0), sensor.largest_gain))


def light_on_grey(
    sensor: "Sensor",
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
        _MIDDLE_GREY * illuminance_lux / math.pi / efficacy / sensor.radiance_scale
    )
    camera = Camera.from_fov(1, 1, 90, pixel_pitch_um)
    lens = ThinLens(camera.film_distance, math.inf)  # f/1
    rates = radiance * sensor.electrons_per_radiance(camera, lens)
    rate = float(rates.sum() if sensor.filters == "mono" else rates[1])
    return Light(
        rate,
        longest_exposure,
        sensor.read_noise,
        _MIDDLE_GREY * sensor.full_well,
        least_snr,
    )


def _luminosity(nm: float) -> float:
    """CIE 1931 luminous efficiency. Source: Wyman, Sloan and Shirley, JCGT 2(2), 2013, the fit of two lobes."""
    lobes = ((0.821, 568.8, 0.0213, 0.0247), (0.286, 530.9, 0.0613, 0.0322))
    return sum(
        height * math.exp(-0.5 * ((nm - peak) * (left if nm < peak else right)) ** 2)
        for height, peak, left, right in lobes
    )
