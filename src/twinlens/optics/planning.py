"""Plan a stereo rig: baseline, focal length, aperture and focus from a task and its limits.

Two parallel equal cameras, W pixels wide, of pitch p; focal length fx in pixels, film distance v = fx p, working
f-number N = v/A, focus at the vergence k = 1/focus_distance, depths z from near to far:

    depth error    e = z^2 sigma_d / (fx B)               largest at far; sigma_d is the matcher's disparity error
    blur circle    c = A fx |1/z - k|                     largest at near or far
    Airy disk      a = 2.44 lambda N / p                  its diameter, to the first dark ring
    disparities    fx B (1/near - 1/far) + 2              that the matcher searches; its cost is proportional
    overlap        1 - fx B / (near W)                    of the image at near, seen by both cameras
    noise          n / sqrt(n + r^2), n = n1 t / N^2      signal over noise of mid-grey, n1 electrons per second at f/1

Every limit bounds fx, B, N or the product fx B, so the feasible set and the best choice have closed forms.

Sources: Gallup, Frahm, Mordohai and Pollefeys, Variable Baseline/Resolution Stereo, CVPR 2008 (depth error); Born and
Wolf, Principles of Optics, 7th ed., 1999; EMVA Standard 1288, release 4.0 linear (noise).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twinlens import optics
from twinlens.errors import InputError, check_int, check_number, format_value
from twinlens.geometry import Float, depth_error
from twinlens.optics.diffraction import CHANNEL_WAVELENGTHS, airy_diameter

Range = float | tuple[float, float]
"""One number for a fixed quantity, or (least, most) for a free one."""

_EXTRA_DISPARITIES = 2  # for whole numbers at both ends of the search
_TRIAL = 1.1  # a limit binds if the best choice improves when it is loosened by this factor
_LOOSEST = 1e9
_HALVINGS = 60


@dataclass(frozen=True)
class Light:
    """Light on the sensor, and the least signal-to-noise ratio of a mid-grey (18 %) pixel.

    electrons_per_second : of mid-grey through a lens of working f-number 1.
    longest_exposure : seconds, such as what motion allows.
    read_noise : electrons rms. Dark current is neglected.
    most_electrons : of mid-grey, before white saturates.
    least_snr : signal over its standard deviation.

    `twinlens.sensor.light_on_grey` makes one from a sensor and an illuminance in lux. Raises InputError for numbers out
    of range, and where the sensor saturates below `least_snr`.
    """

    electrons_per_second: float
    longest_exposure: float
    read_noise: float = 0.0
    most_electrons: float = math.inf
    least_snr: float = 10.0

    def __post_init__(self) -> None:
        for name in ("electrons_per_second", "longest_exposure", "least_snr"):
            check_number(name, getattr(self, name), "a positive number, up to 1e12", least=1e-12, most=1e12)
        check_number("read_noise", self.read_noise, "a number of electrons from 0 to 1e6", least=0, most=1e6)
        best = self.snr(self.most_electrons)
        if not best >= self.least_snr:
            raise InputError(f"least_snr must be at most {best:.3g}, where white saturates, got {self.least_snr:g}")

    def snr(self, electrons: float) -> float:
        """n / sqrt(n + r^2): shot noise and read noise.

        >>> Light(1e6, 0.01).snr(100.0)
        10.0
        """
        return electrons / math.sqrt(electrons + self.read_noise**2) if electrons < math.inf else math.inf

    def largest_f_number(self, exposure: float) -> float:
        """The f-number at which mid-grey has `least_snr` after `exposure` seconds."""
        square = self.least_snr**2
        needed = 0.5 * (square + math.sqrt(square**2 + 4 * square * self.read_noise**2))
        return math.sqrt(self.electrons_per_second * exposure / needed)

    def exposure(self, f_number: float) -> float:
        """The longest exposure in seconds that does not saturate white."""
        return min(self.longest_exposure, self.most_electrons * f_number**2 / self.electrons_per_second)


@dataclass(frozen=True)
class RigTask:
    """What is known about a stereo rig, and the limits that it must meet.

    width, height : image size, pixels. pixel_pitch_um : width of a pixel, micrometres.
    depth_range : (near, far) in metres, finite.
    fov_x_deg, focal_length_mm : exactly one of them; the focal length is the lens's. A `Range`.
    baseline : metres, a `Range`. f_number : the working f-number v/A, a `Range`.
    focus_distance : metres; None is free.
    depth_error : tolerated at every depth, metres; None is none.
    disparity_error_px : standard deviation sigma_d of the matcher's disparities on images within the other limits.
    blur_px : largest diameter of the blur circle. airy_px : largest diameter of the Airy disk; at 2.4 pixels, about as
    wide at half maximum as a blur circle of one pixel.
    overlap : least share of the left image's columns that the right camera sees at near.
    max_disparities : that the matcher searches, from the disparity at far to that at near.
    light : None is enough light.
    wavelength : of the Airy disk, metres.

    Raises InputError when a value is out of range.
    """

    width: int
    height: int
    pixel_pitch_um: float
    depth_range: tuple[float, float]
    fov_x_deg: Range | None = None
    focal_length_mm: Range | None = None
    baseline: Range = (0.01, 1.0)
    f_number: Range = (1.4, 16.0)
    focus_distance: float | None = None
    depth_error: float | None = None
    disparity_error_px: float = 0.1
    blur_px: float = 1.0
    airy_px: float = 2.5
    overlap: float = 0.6
    max_disparities: float = 128
    light: Light | None = None
    wavelength: float = CHANNEL_WAVELENGTHS[1]

    def __post_init__(self) -> None:
        check_int("width", self.width, 1, 65536)
        check_int("height", self.height, 1, 65536)
        check_number("pixel_pitch_um", self.pixel_pitch_um, "micrometres, 0.01 to 1e4", least=0.01, most=1e4)
        near, far = _ends("depth_range", self.depth_range, 1e-4, 1e6, "metres")
        if not near < far:
            raise InputError(f"depth_range must be (near, far) with near < far, got {format_value(self.depth_range)}")
        if (self.fov_x_deg is None) == (self.focal_length_mm is None):
            raise InputError("give exactly one of fov_x_deg and focal_length_mm, a number or (least, most)")
        if self.fov_x_deg is not None:
            _ends("fov_x_deg", self.fov_x_deg, 0.01, 179, "degrees")
        _ends("baseline", self.baseline, 1e-6, 1e6, "metres")
        _ends("f_number", self.f_number, 0.1, 1000, "")
        if self.focus_distance is not None:
            optics.check_focus(self.focus_distance)
        if self.focal_length_mm is not None:
            most = 1e3 * min(self.focus, 1e3)
            length = _ends("focal_length_mm", self.focal_length_mm, 0.01, 1e6, "millimetres")[1]
            check_number("focal_length_mm", length, f"below the focus distance, {most:g} mm", below=most)
        if self.depth_error is not None:
            check_number("depth_error", self.depth_error, "a number of metres, 1e-9 to 1e9", least=1e-9, most=1e9)
        for name in ("disparity_error_px", "blur_px", "airy_px"):
            check_number(name, getattr(self, name), "a number of pixels, 1e-6 to 1e6", least=1e-6, most=1e6)
        check_number("overlap", self.overlap, "a share from 0 to below 1", least=0, below=1)
        check_number("max_disparities", self.max_disparities, "a number of pixels, 3 to 1e6", least=3, most=1e6)
        check_number("wavelength", self.wavelength, "metres, 1e-9 to 1e-3", least=1e-9, most=1e-3)

    @property
    def focus(self) -> float:
        """`focus_distance`; if it is free, the middle of the disparities, where the blur at both ends is equal."""
        return self.focus_distance or optics.middle_focus(*self.depth_range)

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
        return optics.depth_of_field(self.aperture_diameter, self.fx, 1 / self.focus_distance, self.task.blur_px)

    @property
    def hyperfocal_distance(self) -> float:
        """The nearest focus distance at which infinity is blurred by at most the task's `blur_px`."""
        return optics.hyperfocal_distance(self.aperture_diameter, self.fx, self.task.blur_px)

    @property
    def search(self) -> tuple[int, int]:
        """(min_disparity, num_disparities) of the task's depths."""
        high, low = self.disparity(self.task.depth_range)
        return math.floor(low), math.ceil(high) - math.floor(low) + 1

    @property
    def largest_disparity(self) -> dict[str, float]:
        """The largest disparity in pixels that each limit allows: "disparities" of the matcher, and "overlap"."""
        return {
            "disparities": float(self.disparity(self.task.depth_range[1])) + self.task.max_disparities
            - _EXTRA_DISPARITIES,
            "overlap": (1 - self.task.overlap) * self.task.width,
        }  # fmt: skip

    @property
    def smallest_distance(self) -> tuple[float, str]:
        """The nearest depth that meets the limits, metres, and the limit there: disparities, overlap or blur."""
        nearest = {name: self.fx * self.baseline / d for name, d in self.largest_disparity.items()}
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
        return np.abs(optics.circle_of_confusion_px(depth, self.aperture_diameter, self.fx, k))

    def overlap(self, depth: ArrayLike) -> Float:
        """Share of the left image's columns that the right camera sees."""
        return np.maximum(0.0, 1.0 - self.disparity(depth) / self.task.width)

    @property
    def tables(self) -> dict[str, Any]:
        """The `rig` and `lenses` of a recipe, and of a file for `twinlens render --rig`."""
        task = self.task
        rig = {"baseline": self.baseline, "width": task.width, "height": task.height, "fx": self.fx}
        lens = {"kind": "thin", "aperture_mm": 1e3 * self.aperture_diameter, "focus": self.focus_distance}
        return {"rig": {**rig, "pixel_pitch_um": task.pixel_pitch_um}, "lenses": [lens]}


@dataclass(frozen=True)
class Change:
    """Limits that make an infeasible task feasible when all of them are loosened to `needed`.

    given, needed : by names of `LIMITS`, in the units of `RigTask`; a focal length as a field of view if it has one.
    """

    given: Mapping[str, float]
    needed: Mapping[str, float]


@dataclass(frozen=True)
class RigPlan:
    """The answer of `plan_rig`.

    best : the best choice; None if the task is infeasible.
    feasible : (least, most) of `baseline`, `focal_length_mm`, `fov_x_deg` and `f_number` over all choices that meet the
    limits, and of the `focus_distance` of the best one; empty if the task is infeasible.
    binding : the limits that keep the best choice from a better objective, and the relative gain of loosening each
    by 10 %, largest first.
    reasons : of an infeasible task: what its limits need and what they allow, a sentence each.
    changes : of an infeasible task: the sets of limits which, loosened together, make it feasible: single limits if any
    is enough, otherwise pairs, and so on.
    """

    task: RigTask
    best: RigChoice | None
    feasible: Mapping[str, tuple[float, float]]
    binding: Mapping[str, float]
    reasons: tuple[str, ...]
    changes: tuple[Change, ...]

    @property
    def objective(self) -> str:
        """What is smallest: "baseline" for a tolerated depth error, otherwise "depth error"."""
        return "depth error" if self.task.depth_error is None else "baseline"


def plan_rig(task: RigTask) -> RigPlan:
    """The best stereo rig for a task, all feasible ones, and the limits that bind.

    With a tolerated `depth_error` the best choice has the smallest baseline whose depth error is within it over the
    depth range, and of equal ones the smallest depth error. Without, it has the smallest largest depth error over the
    depth range, and of equal ones the smallest baseline. Of f-numbers that meet the limits it takes the sharpest:
    where the sum of squares of the blur circle at the worse end and of the Airy pattern's width at half maximum, about
    lambda N, is smallest. The focus is at the middle of the disparities unless it is given.

    >>> task = RigTask(1280, 960, 3.45, (0.5, 3.0), fov_x_deg=60, depth_error=0.01, max_disparities=400)
    >>> best = plan_rig(task).best
    >>> round(best.baseline, 4), round(float(best.depth_error(3.0)), 6)
    (0.0812, 0.01)
    """
    limits = _limits(task)
    region = _region(task, limits)
    if region.feasible:
        best = _best(task, region)
        return RigPlan(task, best, _feasible(task, region, best), _binding(task, limits), (), ())
    return RigPlan(task, None, {}, {}, tuple(_reasons(task, limits, region)), tuple(_changes(task, limits)))


@dataclass(frozen=True)
class _Region:
    """The feasible set: ranges of fx, baseline, f-number and fx * baseline, and f_number >= spread * fx^2."""

    fx: tuple[float, float]
    baseline: tuple[float, float]
    f_number: tuple[float, float]
    product: tuple[float, float]
    spread: float

    @property
    def feasible(self) -> bool:
        return (
            all(least <= most for least, most in (self.fx, self.f_number, self.product))
            and self.fx[0] * self.baseline[0] <= self.product[1]
            and self.fx[1] * self.baseline[1] >= self.product[0]
        )


_UPPER = (
    "depth error", "blur", "diffraction", "noise", "disparities", "largest baseline", "longest focal length",
    "largest f-number",
)  # fmt: skip
_LOWER = ("overlap", "smallest baseline", "shortest focal length", "smallest f-number")
LIMITS = (*_UPPER, *_LOWER)
"""The limits of a task, by the names in a plan. "noise" is the longest exposure."""
_SUBJECTS = {
    "diffraction": "diffraction", "noise": "the light", "largest f-number": "the lens", "overlap": "the overlap",
    "disparities": "the matcher",
}  # fmt: skip


def _ends(name: str, value: Any, least: float, most: float, unit: str) -> tuple[float, float]:
    """The ends of a `Range`, checked."""
    ends = tuple(value) if isinstance(value, (tuple, list)) else (value, value)
    allowed = f"a number from {least:g} to {most:g} {unit}".rstrip() + ", or (least, most) of them"
    if len(ends) != 2:
        raise InputError(f"{name} must be {allowed}, got {format_value(value)}")
    for end in ends:
        check_number(name, end, allowed, least=least, most=most)
    if ends[0] > ends[1]:
        raise InputError(f"{name} must be {allowed}, got {format_value(value)}")
    return ends[0], ends[1]


def _limits(task: RigTask) -> dict[str, float]:
    """Every limit that the task has; focal lengths as fx in pixels, noise as the longest exposure."""
    if task.fov_x_deg is not None:
        widest, narrowest = _ends("fov_x_deg", task.fov_x_deg, 0, 180, "")[::-1]
        fx = optics.fx_from_fov(task.width, widest), optics.fx_from_fov(task.width, narrowest)
    else:
        lengths = _ends("focal_length_mm", task.focal_length_mm, 0, math.inf, "")
        fx = _fx_of_lens(task, lengths[0]), _fx_of_lens(task, lengths[1])
    baseline, f_number = _ends("baseline", task.baseline, 0, math.inf, ""), _ends("", task.f_number, 0, math.inf, "")
    limits = {
        "blur": task.blur_px, "diffraction": task.airy_px, "overlap": task.overlap,
        "disparities": task.max_disparities, "smallest baseline": baseline[0], "largest baseline": baseline[1],
        "shortest focal length": fx[0], "longest focal length": fx[1],
        "smallest f-number": f_number[0], "largest f-number": f_number[1],
    }  # fmt: skip
    if task.depth_error is not None:
        limits["depth error"] = task.depth_error
    if task.light is not None:
        limits["noise"] = task.light.longest_exposure
    return limits


def _fx_of_lens(task: RigTask, focal_length_mm: float) -> float:
    return 1.0 / (1e3 / focal_length_mm - 1.0 / task.focus) / task.pitch


def _f_numbers(task: RigTask, limits: Mapping[str, float]) -> dict[str, float]:
    """The largest f-number that each limit allows."""
    most = {
        "largest f-number": limits["largest f-number"],
        "diffraction": limits["diffraction"] * task.pitch / airy_diameter(task.wavelength, 1.0),
    }
    if task.light is not None:
        most["noise"] = task.light.largest_f_number(limits["noise"])
    return most


def _products(task: RigTask, limits: Mapping[str, float]) -> dict[str, float]:
    """The largest fx * baseline that each limit allows."""
    near, far = task.depth_range
    return {
        "disparities": (limits["disparities"] - _EXTRA_DISPARITIES) / (1 / near - 1 / far),
        "overlap": (1 - limits["overlap"]) * task.width * near,
    }


def _region(task: RigTask, limits: Mapping[str, float]) -> _Region:
    spread = task.pitch * task.defocus / limits["blur"]
    largest = min(_f_numbers(task, limits).values())
    sharp = math.sqrt(largest / spread)
    product = _needed_product(task, limits), min(_products(task, limits).values())
    return _Region(
        (limits["shortest focal length"], min(limits["longest focal length"], sharp)),
        (limits["smallest baseline"], limits["largest baseline"]),
        (limits["smallest f-number"], largest),
        product,
        spread,
    )


def _needed_product(task: RigTask, limits: Mapping[str, float]) -> float:
    """The smallest fx * baseline that meets the tolerated depth error."""
    if "depth error" not in limits:
        return 0.0
    return float(depth_error(task.depth_range[1], 1.0, 1.0, task.disparity_error_px)) / limits["depth error"]


def _best(task: RigTask, region: _Region) -> RigChoice:
    longest, (needed, most) = region.fx[1], region.product
    if task.depth_error is None:
        product = min(most, longest * region.baseline[1])
        baseline = max(region.baseline[0], product / longest)
    else:
        baseline = max(region.baseline[0], needed / longest)
    fx = min(longest, most / baseline)
    sharpest = fx * task.pitch * math.sqrt(task.defocus / task.wavelength)
    f_number = min(max(sharpest, region.f_number[0], region.spread * fx**2), region.f_number[1])
    return RigChoice(task, baseline, fx, f_number)


def _objective(task: RigTask, best: RigChoice) -> float:
    return best.baseline if task.depth_error is not None else float(best.depth_error(task.depth_range[1]))


def _feasible(task: RigTask, region: _Region, best: RigChoice) -> dict[str, tuple[float, float]]:
    (f0, f1), (b0, b1), (needed, most) = region.fx, region.baseline, region.product
    fx = max(f0, needed / b1), min(f1, most / b0)
    lengths = tuple(1e3 * optics.focal_length(task.focus, f * task.pitch) for f in fx)
    focus = best.focus_distance, best.focus_distance
    if task.focus_distance is None:
        margin = task.blur_px / (best.aperture_diameter * best.fx)
        low, high = 1 / task.depth_range[0] - margin, 1 / task.depth_range[1] + margin
        focus = 1 / high, (1 / low if low > 0 else math.inf)
    return {
        "baseline": (max(b0, needed / f1), min(b1, most / f0)),
        "focal_length_mm": (lengths[0], lengths[1]),
        "fov_x_deg": (optics.fov_x_deg(task.width, fx[1]), optics.fov_x_deg(task.width, fx[0])),
        "f_number": (max(region.f_number[0], region.spread * fx[0] ** 2), region.f_number[1]),
        "focus_distance": focus,
    }


def _loosened(limits: Mapping[str, float], names: tuple[str, ...], factor: float) -> dict[str, float]:
    return {
        name: value * (factor if name in _UPPER else 1 / factor) if name in names else value
        for name, value in limits.items()
    }


def _binding(task: RigTask, limits: Mapping[str, float]) -> dict[str, float]:
    """The relative gain of the objective by each limit that, loosened by `_TRIAL`, improves it."""
    now = _objective(task, _best(task, _region(task, limits)))
    gains = {}
    for name in limits:
        other = _region(task, _loosened(limits, (name,), _TRIAL))
        gains[name] = 1 - _objective(task, _best(task, other)) / now
    return dict(sorted(((n, g) for n, g in gains.items() if g > 1e-9), key=lambda pair: -pair[1]))


def _changes(task: RigTask, limits: Mapping[str, float]) -> list[Change]:
    """Every smallest set of limits whose loosening makes the task feasible, each loosened as little as possible."""
    for size in range(1, len(limits) + 1):
        found = []
        for names in combinations(limits, size):
            needed = _loosened(limits, names, _LOOSEST)
            if not _region(task, needed).feasible:
                continue
            for each in (names, *((name,) for name in names if size > 1)):
                needed = _tightened(task, limits, needed, each)
            given, needed = (
                {name: _in_task_units(task, name, values[name]) for name in names} for values in (limits, needed)
            )
            found.append(Change(given, needed))
        if found:
            return found
    return []


def _tightened(
    task: RigTask, limits: Mapping[str, float], loose: Mapping[str, float], names: tuple[str, ...]
) -> dict[str, float]:
    """Feasible limits between `limits` and `loose` ones, of which the named ones deviate from `limits` the least."""
    low, high = 0.0, math.log(_LOOSEST)
    tightened = dict(loose)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        trial = {**loose, **{name: _loosened(limits, names, math.exp(middle))[name] for name in names}}
        if _region(task, trial).feasible:
            high, tightened = middle, trial
        else:
            low = middle
    return tightened


def _in_task_units(task: RigTask, name: str, value: float) -> float:
    """A limit as the task has it: fx as a field of view in degrees or a focal length in millimetres."""
    if not name.endswith("focal length"):
        return value
    if task.fov_x_deg is not None:
        return optics.fov_x_deg(task.width, value)
    return 1e3 * optics.focal_length(task.focus, value * task.pitch)


def _reasons(task: RigTask, limits: Mapping[str, float], region: _Region) -> list[str]:
    """What the limits need and what they allow, a sentence for each conflict."""
    stops, products = _f_numbers(task, limits), _products(task, limits)
    stop, room = min(stops, key=lambda name: stops[name]), min(products, key=lambda name: products[name])
    (shortest, sharp), (needed, most), (near, far) = region.fx, region.product, task.depth_range
    allowed_stop = f"{_SUBJECTS[stop]} allows at most f/{stops[stop]:.3g}"
    allowed_disparity = f"{_SUBJECTS[room]} allows at most {most / near:.4g} px"
    reasons = []
    if region.f_number[0] > region.f_number[1]:
        reasons.append(f"the smallest f-number is f/{region.f_number[0]:.3g}, and {allowed_stop}")
    elif shortest > sharp:
        number = region.spread * shortest**2
        needs = f"a blur circle of at most {task.blur_px:g} px from {near:g} to {far:g} m needs f/{number:.3g} or more"
        reasons.append(f"{needs}, even with the shortest focal length, and {allowed_stop}")
    if needed > 0:
        error = f"a depth error of {limits['depth error']:.3g} m at {far:g} m"
        longest, baseline = max(sharp, shortest), region.baseline[1]
        if needed > most:
            reasons.append(
                f"{error} needs a disparity of {needed / near:.4g} px at {near:g} m, and {allowed_disparity}"
            )
        if longest * baseline < needed:
            length = 1e3 * optics.focal_length(task.focus, longest * task.pitch)
            needs = f"{error} needs a baseline of {needed / longest:.3g} m with the longest usable focal length"
            reasons.append(f"{needs}, {length:.3g} mm, and the largest baseline is {baseline:g} m")
    if shortest * region.baseline[0] > most:
        least = shortest * region.baseline[0] / near
        gives = f"the smallest baseline and the shortest focal length give a disparity of {least:.4g} px at {near:g} m"
        reasons.append(f"{gives}, and {allowed_disparity}")
    return reasons
