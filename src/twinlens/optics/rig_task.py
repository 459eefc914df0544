"""What is known about a stereo rig, and one choice of it: `RigTask`, `RigChoice`. `planning` finds the best choice.

Two parallel equal cameras, W pixels wide, of pitch p; focal length fx in pixels, film distance v = fx p, working
f-number N = v/A, focus at the vergence k = 1/focus_distance, depths z from near to far:

    depth error    e = z^2 sigma_d / (fx B)               largest at far; sigma_d is the matcher's disparity error
    blur circle    c = A fx |1/z - k|                     largest at near or far
    Airy disk      a = 2.44 lambda N / p                  its diameter, to the first dark ring
    disparities    fx B (1/near - 1/far) + 2              that the matcher searches; its cost is proportional
    overlap        1 - fx B / (near W)                    of the image at near, seen by both cameras
    noise          n / sqrt(n + r^2), n = n1 t / N^2      signal over noise of mid-grey, n1 electrons per second at f/1

Sources: Gallup, Frahm, Mordohai and Pollefeys, Variable Baseline/Resolution Stereo, CVPR 2008 (depth error); Born and
Wolf, Principles of Optics, 7th ed., 1999; EMVA Standard 1288, release 4.0 linear (noise).
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from twinlens import optics
from twinlens.errors import InputError, check_number, format_value
from twinlens.geometry import Float, depth_error
from twinlens.optics.diffraction import CHANNEL_WAVELENGTHS, airy_diameter
from twinlens.settings import Setting, Settings

Range = float | tuple[float, float]
"""One number for a fixed quantity, or (least, most) for a free one."""

EXTRA_DISPARITIES = 2
"""For whole numbers at both ends of the search."""
_ROUNDING = 1e-9
_PIXELS: dict[str, Any] = {"unit": "pixels", "least": 1e-6, "most": 1e6}
_RANGES = {
    "baseline": ("metres", 1e-6, 1e6),
    "f_number": ("", 0.1, 1000),
    "fov_x_deg": ("degrees", 0.01, 179),
    "focal_length_mm": ("millimetres", 0.01, 1e6),
}
"""The unit of each `Range` of a task, the least and the most of its ends."""


@dataclass(frozen=True)
class Light(Settings, noun="light"):
    """Light on the sensor, and the least signal-to-noise ratio of a mid-grey (18 %) pixel. Dark current is neglected.

    `twinlens.sensor.light_on_grey` makes one from a sensor and an illuminance in lux. Raises InputError for numbers out
    of range, and where the sensor saturates below `least_snr`.
    """

    electrons_per_second: Annotated[
        float,
        Setting(
            "Of mid-grey through a lens of working f-number 1.",
            "electrons per second",
            least=1e-12,
            most=1e12,
        ),
    ]
    longest_exposure: Annotated[
        float,
        Setting(
            "Longest exposure, such as what motion allows.",
            "seconds",
            least=1e-12,
            most=1e12,
        ),
    ]
    read_noise: Annotated[
        float, Setting("Temporal dark noise, rms.", "electrons", least=0, most=1e6)
    ] = 0.0
    most_electrons: Annotated[
        float,
        Setting(
            "Of mid-grey, before white saturates.", "electrons", least=0, infinite=True
        ),
    ] = math.inf
    least_snr: Annotated[
        float,
        Setting("Least signal-to-noise ratio of mid-grey.", least=1e-12, most=1e12),
    ] = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        best = self.snr(self.most_electrons)
        if not best >= self.least_snr:
            raise InputError(
                f"least_snr must be at most {best:.3g}, where white saturates, got {self.least_snr:g}"
            )

    def snr(self, electrons: float) -> float:
        """n / sqrt(n + r^2): shot noise and read noise.

        >>> Light(1e6, 0.01).snr(100.0)
        10.0
        """
        if electrons == math.inf:
            return math.inf
        return electrons / math.sqrt(electrons + self.read_noise**2)

    def largest_f_number(self, exposure: float) -> float:
        """The f-number at which mid-grey has `least_snr` after `exposure` seconds."""
        # The electrons n needed for a ratio s solve n^2 - s^2 n - s^2 r^2 = 0.
        square = self.least_snr**2
        needed = 0.5 * (square + math.sqrt(square**2 + 4 * square * self.read_noise**2))
        return math.sqrt(self.electrons_per_second * exposure / needed)

    def exposure(self, f_number: float) -> float:
        """The longest exposure in seconds that does not saturate white."""
        saturating = self.most_electrons * f_number**2 / self.electrons_per_second
        return min(self.longest_exposure, saturating)


@dataclass(frozen=True)
class RigTask(Settings, noun="rig"):
    """What is known about a stereo rig, and the limits that it must meet.

    depth_range : (near, far) in metres, finite.
    fov_x_deg, focal_length_mm : exactly one of them; the focal length is the lens's. A `Range`.
    baseline : metres, a `Range`. f_number : the working f-number v/A, a `Range`.
    light : None is enough light.

    Raises InputError when a value is out of range.
    """

    width: Annotated[
        int, Setting("Width of the images.", "pixels", least=1, most=65536)
    ]
    height: Annotated[
        int, Setting("Height of the images.", "pixels", least=1, most=65536)
    ]
    pixel_pitch_um: Annotated[
        float, Setting("Width of a pixel.", "micrometres", least=0.01, most=1e4)
    ]
    depth_range: tuple[float, float]
    fov_x_deg: Range | None = None
    focal_length_mm: Range | None = None
    baseline: Range = (0.01, 1.0)
    f_number: Range = (1.4, 16.0)
    focus_distance: Annotated[
        float | None,
        Setting(
            "Focus distance; free by default.",
            "metres",
            least=optics.SHORTEST,
            infinite=True,
        ),
    ] = None
    depth_error: Annotated[
        float | None,
        Setting("Tolerated error at every depth.", "metres", least=1e-9, most=1e9),
    ] = None
    disparity_error_px: Annotated[
        float,
        Setting("Standard deviation sigma_d of the matcher's disparities.", **_PIXELS),
    ] = 0.1
    blur_px: Annotated[
        float, Setting("Largest diameter of the blur circle.", **_PIXELS)
    ] = 1.0
    # At 2.4 pixels the disk is about as wide at half maximum as a blur circle of one.
    airy_px: Annotated[
        float, Setting("Largest diameter of the Airy disk.", **_PIXELS)
    ] = 2.5
    overlap: Annotated[
        float,
        Setting(
            "Least share of the left image that the right camera sees at the nearest depth.",
            least=0,
            below=1,
        ),
    ] = 0.6
    max_disparities: Annotated[
        int,
        Setting("Most disparities that the matcher searches.", least=3, most=1_000_000),
    ] = 128
    light: Annotated[Light | None, Setting("Light on the sensor.")] = None
    wavelength: Annotated[
        float,
        Setting("Wavelength of the Airy disk.", "metres", least=1e-9, most=1e-3),
    ] = CHANNEL_WAVELENGTHS[1]

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_depth_range(self.depth_range)
        if (self.fov_x_deg is None) == (self.focal_length_mm is None):
            raise InputError(
                "give exactly one of fov_x_deg and focal_length_mm, a number or (least, most)"
            )
        for name, (unit, least, most) in _RANGES.items():
            value = getattr(self, name)
            if value is not None:
                _check_range(name, value, least, most, unit)
        if self.focal_length_mm is not None:
            focus_mm = 1e3 * self.focus
            allowed = f"below the focus distance, {focus_mm:g} mm"
            longest = self.ends("focal_length_mm")[1]
            check_number("focal_length_mm", longest, allowed, below=focus_mm)

    @property
    def focus(self) -> float:
        """`focus_distance`; if it is free, the middle of the disparities, where the blur at both ends is equal."""
        return self.focus_distance or optics.middle_focus(*self.depth_range)

    def ends(self, name: str) -> tuple[float, float]:
        """(least, most) of a field that is a `Range`."""
        value = getattr(self, name)
        if isinstance(value, (tuple, list)):
            return value[0], value[1]
        return value, value

    @property
    def defocus(self) -> float:
        """The largest difference of the vergences of a depth and of the focus, 1/m."""
        return max(abs(1 / depth - 1 / self.focus) for depth in self.depth_range)

    @property
    def pitch(self) -> float:
        """Metres from pixel to pixel."""
        return 1e-6 * self.pixel_pitch_um


@dataclass(frozen=True)
class RigChoice:
    """A stereo rig for a task. Lengths in metres, fx in pixels, `f_number` the working f-number v/A."""

    task: RigTask
    baseline: float
    fx: float
    f_number: float

    @property
    def focus_distance(self) -> float:
        """Of the lens, metres."""
        return self.task.focus

    @property
    def film_distance(self) -> float:
        """v = fx p."""
        return self.fx * self.task.pitch

    @property
    def focal_length(self) -> float:
        """Of the lens: f = 1/(1/focus_distance + 1/v)."""
        return optics.focal_length(self.focus_distance, self.film_distance)

    @property
    def aperture_diameter(self) -> float:
        """A = v/N."""
        return self.film_distance / self.f_number

    @property
    def fov_x_deg(self) -> float:
        """Horizontal field of view, edge to edge."""
        return optics.fov_x_deg(self.task.width, self.fx)

    @property
    def airy_px(self) -> float:
        """Diameter of the Airy disk."""
        return airy_diameter(self.task.wavelength, self.f_number) / self.task.pitch

    @property
    def depth_of_field(self) -> tuple[float, float]:
        """(near, far) between which the blur circle is at most the task's `blur_px`."""
        return optics.depth_of_field(
            self.aperture_diameter, self.fx, 1 / self.focus_distance, self.task.blur_px
        )

    @property
    def hyperfocal_distance(self) -> float:
        """The nearest focus distance at which infinity is blurred by at most the task's `blur_px`."""
        return optics.hyperfocal_distance(
            self.aperture_diameter, self.fx, self.task.blur_px
        )

    @property
    def exposure(self) -> float | None:
        """The longest exposure in seconds that meets the task's light; None without one."""
        light = self.task.light
        return None if light is None else light.exposure(self.f_number)

    @property
    def snr(self) -> float | None:
        """The signal-to-noise ratio of mid-grey after `exposure`; None without a light."""
        light, exposure = self.task.light, self.exposure
        if light is None or exposure is None:
            return None
        return light.snr(light.electrons_per_second * exposure / self.f_number**2)

    @property
    def search(self) -> tuple[int, int]:
        """(min_disparity, num_disparities) of the task's depths."""
        high, low = self.disparity(self.task.depth_range)
        least = math.floor(low + _ROUNDING)
        return least, math.ceil(high - _ROUNDING) - least + 1

    @property
    def largest_disparity(self) -> dict[str, float]:
        """The largest disparity in pixels that each limit allows: "disparities" of the matcher, and "overlap"."""
        task = self.task
        least = float(self.disparity(task.depth_range[1]))
        return {
            "disparities": least + task.max_disparities - EXTRA_DISPARITIES,
            "overlap": (1 - task.overlap) * task.width,
        }

    @property
    def smallest_distance(self) -> tuple[float, str]:
        """The nearest depth that meets the limits, metres, and the limit there: disparities, overlap or blur."""
        nearest = {
            name: self.fx * self.baseline / disparity
            for name, disparity in self.largest_disparity.items()
        }
        nearest["blur"] = self.depth_of_field[0]
        limit = max(nearest, key=lambda name: nearest[name])
        return nearest[limit], limit

    def disparity(self, depth: ArrayLike) -> Float:
        """fx B / z, pixels."""
        return np.asarray(self.fx * self.baseline / np.asarray(depth, dtype=np.float64))

    def depth_error(self, depth: ArrayLike) -> Float:
        """Standard deviation of depth, metres."""
        return depth_error(depth, self.fx, self.baseline, self.task.disparity_error_px)

    def blur_px(self, depth: ArrayLike) -> Float:
        """Diameter of the blur circle, pixels."""
        k = 1 / self.focus_distance
        return np.abs(
            optics.circle_of_confusion_px(depth, self.aperture_diameter, self.fx, k)
        )

    def overlap(self, depth: ArrayLike) -> Float:
        """Share of the left image's columns that the right camera sees."""
        return np.maximum(0.0, 1.0 - self.disparity(depth) / self.task.width)

    @property
    def tables(self) -> dict[str, Any]:
        """The size, `rig` and `lenses` of a recipe, and of a file for `twinlens render --rig`."""
        task = self.task
        rig = {
            "baseline": self.baseline,
            "fx": self.fx,
            "pixel_pitch_um": task.pixel_pitch_um,
        }
        lens = {
            "kind": "thin",
            "aperture_mm": 1e3 * self.aperture_diameter,
            "focus": self.focus_distance,
        }
        return {
            "width": task.width,
            "height": task.height,
            "rig": rig,
            "lenses": [lens],
        }


def _check_depth_range(value: Any) -> None:
    """Raise InputError unless `value` is (near, far) with near < far."""
    allowed = "two numbers from 0.0001 to 1e+06 metres, near and far"
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(f"depth_range must be {allowed}, got {format_value(value)}")
    for depth in value:
        check_number("depth_range", depth, allowed, least=1e-4, most=1e6)
    near, far = value
    if not near < far:
        raise InputError(
            f"depth_range must be (near, far) with near < far, got {format_value(value)}"
        )


def _check_range(name: str, value: Any, least: float, most: float, unit: str) -> None:
    """Raise InputError unless `value` is a `Range` within least to most."""
    ends = tuple(value) if isinstance(value, (tuple, list)) else (value, value)
    allowed = (
        f"a number from {least:g} to {most:g} {unit}".rstrip()
        + ", or (least, most) of them"
    )
    for end in ends:
        check_number(name, end, allowed, least=least, most=most)
    if len(ends) != 2:
        raise InputError(f"{name} must be {allowed}, got {format_value(value)}")
    if ends[0] > ends[1]:
        raise InputError(
            f"{name} must be (least, most) with least <= most, got {format_value(value)}"
        )
