"""Exposure time and gain, given or automatic."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from twinlens.errors import InputError, check_number, format_value
from twinlens.geometry import Float
from twinlens.settings import Setting, Settings

MIDDLE_GREY = 0.18  # of white: target of the geometric mean
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


def automatic(levels: Float, longest_time: float, largest_gain: float) -> Exposure:
    """One exposure for pixels of these levels, (N, 3): shares of white per second at gain 1.

    The geometric mean luminance of the pixels that are not black becomes 18% of white. If the brightest 2% would
    exceed 90% of white, the exposure is reduced by up to two stops. Time is increased first, then gain, up to their
    limits. Black pixels alone get both limits.
    """
    brightest = levels.max(axis=1)
    highlight = float(np.percentile(brightest, _HIGHLIGHT_PERCENTILE))
    highlight = highlight or float(brightest.max())
    product = math.inf  # time times gain, seconds
    if highlight > 0:
        luminance = levels @ _LUMINANCE
        lit = luminance[luminance > _BLACK * highlight]
        middle = MIDDLE_GREY / float(np.exp(np.log(lit).mean()))
        product = max(min(middle, _HIGHLIGHT / highlight), middle / 2**_STOPS_BELOW)
    time = min(product, longest_time)
    return Exposure(time, min(max(product / time, 1.0), largest_gain))
