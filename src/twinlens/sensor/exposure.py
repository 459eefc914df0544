"""How long and how strongly: an exposure, the automatic one, and how two eyes may differ in it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import Lens
from twinlens.errors import InputError, check_number, format_value

if TYPE_CHECKING:
    from twinlens.sensor.model import Sensor

Float = NDArray[np.float64]

_MIDDLE_GREY = 0.18  # of white: where the geometric mean of a picture goes
_HIGHLIGHT = 0.9  # of white: where the highlight percentile may go
_HIGHLIGHT_PERCENTILE = 98.0
_STOPS_BELOW = 2.0  # how far highlights may push the middle grey down
_BLACK = 1e-3  # of the highlight: darker pixels have no say in the mean
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. ITU-R BT.709


@dataclass(frozen=True)
class Exposure:
    """Exposure time in seconds, and gain: 1 at the sensor's base sensitivity, each doubling a stop, as ISO speeds go.

    At gain 1 a full well fills the converter's range. Raises InputError unless both are positive and finite.
    """

    time: float
    gain: float = 1.0

    def __post_init__(self) -> None:
        check_number("exposure time", self.time, "a positive number of seconds, 1e-30 to 1e9", least=1e-30, most=1e9)
        check_number("exposure gain", self.gain, "positive, 1e-9 to 1e9", least=1e-9, most=1e9)

    def value(self, working_f_number: float) -> float:
        """The exposure value EV = log2(N^2 / t), N = v/A.

        >>> Exposure(time=1 / 64).value(8.0)
        12.0
        """
        check_number("working_f_number", working_f_number, "a positive number", least=1e-24, most=1e24)
        return math.log2(working_f_number**2 / self.time)


@dataclass(frozen=True)
class Mismatch:
    """What every eye but the first has differently, unknown to whoever develops its picture.

    Parameters
    ----------
    gain, time : float
        Factors on the exposure's gain and time, > 0.
    black_level : float
        Added to the black level, DN.
    """

    gain: float = 1.0
    time: float = 1.0
    black_level: float = 0.0

    def __post_init__(self) -> None:
        for name in ("gain", "time"):
            allowed = "a positive factor from 0.001 to 1000"
            check_number(f"mismatch {name}", getattr(self, name), allowed, least=1e-3, most=1e3)
        check_number(
            "mismatch black_level",
            self.black_level,
            "a finite number of DN, at most 1e6 either way",
            least=-1e6,
            most=1e6,
        )

    def applied(self, exposure: Exposure) -> Exposure:
        """The exposure that such an eye has when the rig is given `exposure`. Raises InputError where none is so long.

        >>> Mismatch(time=2.0).applied(Exposure(0.01))
        Exposure(time=0.02, gain=1.0)
        """
        try:
            return Exposure(exposure.time * self.time, exposure.gain * self.gain)
        except InputError as error:
            raise InputError(f"the mismatch makes an exposure that cannot be: {error}") from error


def check_exposure(exposure: Exposure | None) -> None:
    """Raise InputError for what is neither an exposure nor None, the automatic one."""
    if not isinstance(exposure, Exposure | None):
        raise InputError(f"exposure must be an Exposure or None (automatic), got {format_value(exposure)}")


def auto_exposure(
    images: Sequence[ArrayLike], *, sensor: "Sensor", cameras: Sequence[Camera] | Camera, lens: Lens
) -> Exposure:
    """One exposure for all `images` (linear radiance (H, W, 3)), so that a stereo pair is exposed alike.

    The geometric mean luminance of what is not black goes to 18% of white, unless the brightest 2% would then pass 90%
    of white: they are held there, at the cost of up to two stops of the mean. The time is used first, to the sensor's
    `longest_exposure`, then the gain, to its `largest_gain`. An image without light gets both.
    """
    each = [cameras] * len(images) if isinstance(cameras, Camera) else list(cameras)
    if not images or len(each) != len(images):
        raise InputError(f"auto exposure needs images and one camera each, got {len(images)} and {len(each)}")
    levels = [
        sensor.level_rate(image, camera=c, lens=lens).reshape(-1, 3) for image, c in zip(images, each, strict=True)
    ]
    wanted = _wanted(np.concatenate(levels))
    time = min(wanted, sensor.longest_exposure)
    return Exposure(time, min(max(wanted / time, 1.0), sensor.largest_gain))


def _wanted(levels: Float) -> float:
    """Time x gain in seconds for `levels` (N, 3), shares of white a second at gain 1."""
    highlight = float(np.percentile(levels.max(axis=1), _HIGHLIGHT_PERCENTILE)) or float(levels.max())
    if highlight == 0:
        return math.inf
    luminance = levels @ _LUMINANCE
    lit = luminance[luminance > _BLACK * highlight]
    middle = _MIDDLE_GREY / float(np.exp(np.log(lit).mean()))
    return max(min(middle, _HIGHLIGHT / highlight), middle / 2**_STOPS_BELOW)
