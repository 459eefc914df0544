"""The best stereo rig for a task, all feasible ones, and the limits that bind; the formulas are those of `rig_task`.

Every limit bounds the focal length fx, the baseline B, the f-number N, or the product fx B, so the feasible set and the
best choice have closed forms.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

from twinlens import optics
from twinlens.errors import InputError, format_value
from twinlens.geometry import depth_error
from twinlens.optics.diffraction import airy_diameter
from twinlens.optics.rig_task import EXTRA_DISPARITIES, RigChoice, RigTask

_TRIAL = (
    1.1  # a limit binds if the best choice improves when it is loosened by this factor
)
_LOOSEST = 1e30
_HALVINGS = 64


@dataclass(frozen=True)
class RigPlan:
    """The answer of `plan_rig`. The names of limits are those of `LIMITS`.

    best : the best choice; None if the task is infeasible.
    limits : of the task in its units; limits of the focal length as a field of view if the task has one, and `noise` as
    the longest exposure.
    used : what the best choice needs of each limit, in the same units.
    feasible : (least, most) of `baseline`, `focal_length_mm`, `fov_x_deg` and `f_number` over all choices that meet the
    limits, and of the `focus_distance` of the best one; empty if the task is infeasible.
    binding : the limits that keep the best choice from a better objective, and the relative gain of loosening each
    by 10 %, largest first.
    reasons : of an infeasible task: what its limits need and what they allow, a sentence each.
    changes : of an infeasible task: values of limits which, changed together, make it feasible: single limits if any
    is enough, otherwise pairs, and so on.
    """

    task: RigTask
    best: RigChoice | None
    limits: Mapping[str, float]
    used: Mapping[str, float]
    feasible: Mapping[str, tuple[float, float]]
    binding: Mapping[str, float]
    reasons: tuple[str, ...]
    changes: tuple[Mapping[str, float], ...]

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
    if not isinstance(task, RigTask):
        raise InputError(f"plan_rig needs a RigTask, got {format_value(task)}")
    limits = _limits(task)
    shown, region = _in_task_units(task, limits), _region(task, limits)
    if not region.feasible:
        reasons, changes = _reasons(task, limits, region), _changes(task, limits)
        return RigPlan(task, None, shown, {}, {}, {}, tuple(reasons), tuple(changes))
    best = _best(task, region)
    used = _in_task_units(task, _used(best, limits))
    return RigPlan(
        task,
        best,
        shown,
        used,
        _feasible(task, region, best),
        _binding(task, limits),
        (),
        (),
    )


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


def _limits(task: RigTask) -> dict[str, float]:
    """Every limit that the task has; focal lengths as fx in pixels, noise as the longest exposure."""
    if task.fov_x_deg is not None:
        longest, shortest = (
            optics.fx_from_fov(task.width, fov) for fov in task.ends("fov_x_deg")
        )
    else:
        lengths = (1e-3 * length for length in task.ends("focal_length_mm"))
        shortest, longest = (
            1 / (1 / length - 1 / task.focus) / task.pitch for length in lengths
        )
    baseline, f_number = task.ends("baseline"), task.ends("f_number")
    limits = {} if task.depth_error is None else {"depth error": task.depth_error}
    limits |= {
        "blur": task.blur_px, "diffraction": task.airy_px, "overlap": task.overlap,
        "disparities": task.max_disparities, "smallest baseline": baseline[0], "largest baseline": baseline[1],
        "shortest focal length": shortest, "longest focal length": longest,
        "smallest f-number": f_number[0], "largest f-number": f_number[1],
    }  # fmt: skip
    if task.light is not None:
        limits["noise"] = task.light.longest_exposure
    return limits


def _used(best: RigChoice, limits: Mapping[str, float]) -> dict[str, float]:
    """What a choice needs of each limit, as `_limits`."""
    task = best.task
    near, far = best.disparity(task.depth_range).tolist()
    used = {
        "depth error": float(best.depth_error(task.depth_range[1])),
        "blur": float(best.blur_px(task.depth_range).max()),
        "diffraction": best.airy_px,
        "overlap": float(best.overlap(task.depth_range[0])),
        "disparities": near - far + EXTRA_DISPARITIES,
    }
    used |= dict.fromkeys(("smallest baseline", "largest baseline"), best.baseline)
    used |= dict.fromkeys(("shortest focal length", "longest focal length"), best.fx)
    used |= dict.fromkeys(("smallest f-number", "largest f-number"), best.f_number)
    if task.light is not None:
        used["noise"] = (best.f_number / task.light.largest_f_number(1.0)) ** 2
    return {name: used[name] for name in limits}


def _f_numbers(task: RigTask, limits: Mapping[str, float]) -> dict[str, float]:
    """The largest f-number that each limit allows."""
    most = {
        "largest f-number": limits["largest f-number"],
        "diffraction": limits["diffraction"]
        * task.pitch
        / airy_diameter(task.wavelength, 1.0),
    }
    if task.light is not None:
        most["noise"] = task.light.largest_f_number(limits["noise"])
    return most


def _products(task: RigTask, limits: Mapping[str, float]) -> dict[str, float]:
    """The largest fx * baseline that each limit allows."""
    near, far = task.depth_range
    return {
        "disparities": (limits["disparities"] - EXTRA_DISPARITIES)
        / (1 / near - 1 / far),
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
    return (
        float(depth_error(task.depth_range[1], 1.0, 1.0, task.disparity_error_px))
        / limits["depth error"]
    )


def _best(task: RigTask, region: _Region) -> RigChoice:
    longest, (needed, most) = region.fx[1], region.product
    if task.depth_error is None:
        product = min(most, longest * region.baseline[1])
        baseline = max(region.baseline[0], product / longest)
    else:
        baseline = max(region.baseline[0], needed / longest)
    fx = min(longest, most / baseline)
    sharpest = fx * task.pitch * math.sqrt(task.defocus / task.wavelength)
    f_number = min(
        max(sharpest, region.f_number[0], region.spread * fx**2), region.f_number[1]
    )
    return RigChoice(task, baseline, fx, f_number)


def _objective(task: RigTask, best: RigChoice) -> float:
    return (
        best.baseline
        if task.depth_error is not None
        else float(best.depth_error(task.depth_range[1]))
    )


def _feasible(
    task: RigTask, region: _Region, best: RigChoice
) -> dict[str, tuple[float, float]]:
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
        "fov_x_deg": (
            optics.fov_x_deg(task.width, fx[1]),
            optics.fov_x_deg(task.width, fx[0]),
        ),
        "f_number": (
            max(region.f_number[0], region.spread * fx[0] ** 2),
            region.f_number[1],
        ),
        "focus_distance": focus,
    }


def _loosened(
    limits: Mapping[str, float], names: tuple[str, ...], factor: float
) -> dict[str, float]:
    return {
        name: value * (factor if name in _UPPER else 1 / factor)
        if name in names
        else value
        for name, value in limits.items()
    }


def _binding(task: RigTask, limits: Mapping[str, float]) -> dict[str, float]:
    """The relative gain of the objective by each limit that, loosened by `_TRIAL`, improves it."""
    now = _objective(task, _best(task, _region(task, limits)))
    gains = {}
    for name in limits:
        other = _region(task, _loosened(limits, (name,), _TRIAL))
        gains[name] = 1 - _objective(task, _best(task, other)) / now
    return dict(
        sorted(
            ((n, g) for n, g in gains.items() if g > 1e-9), key=lambda pair: -pair[1]
        )
    )


def _changes(task: RigTask, limits: Mapping[str, float]) -> list[dict[str, float]]:
    """Every smallest set of limits whose loosening makes the task feasible, each loosened as little as possible."""
    for size in range(1, len(limits) + 1):
        found = []
        for names in combinations(limits, size):
            needed = _loosened(limits, names, _LOOSEST)
            if not _region(task, needed).feasible:
                continue
            for each in (names, *((name,) for name in names if size > 1)):
                needed = _tightened(task, limits, needed, each)
            change = _in_task_units(task, {name: needed[name] for name in names})
            if "disparities" in change:
                change["disparities"] = math.ceil(change["disparities"])
            found.append(change)
        if found:
            return found
    return []


def _tightened(
    task: RigTask,
    limits: Mapping[str, float],
    loose: Mapping[str, float],
    names: tuple[str, ...],
) -> dict[str, float]:
    """Feasible limits between `limits` and `loose` ones, of which the named ones deviate from `limits` the least."""
    low, high = 0.0, math.log(_LOOSEST)
    tightened = dict(loose)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        trial = {
            **loose,
            **{
                name: _loosened(limits, names, math.exp(middle))[name] for name in names
            },
        }
        if _region(task, trial).feasible:
            high, tightened = middle, trial
        else:
            low = middle
    return tightened


def _in_task_units(task: RigTask, limits: Mapping[str, float]) -> dict[str, float]:
    """Limits as the task has them: fx as a field of view in degrees or a focal length in millimetres."""

    def shown(fx: float) -> float:
        if task.fov_x_deg is not None:
            return optics.fov_x_deg(task.width, fx)
        return 1e3 * optics.focal_length(task.focus, fx * task.pitch)

    return {
        name: shown(value) if name.endswith("focal length") else value
        for name, value in limits.items()
    }


def _reasons(task: RigTask, limits: Mapping[str, float], region: _Region) -> list[str]:
    """What the limits need and what they allow, a sentence for each conflict."""
    stops, products = _f_numbers(task, limits), _products(task, limits)
    stop, room = (
        min(stops, key=lambda name: stops[name]),
        min(products, key=lambda name: products[name]),
    )
    (shortest, sharp), (needed, most), (near, far) = (
        region.fx,
        region.product,
        task.depth_range,
    )
    allowed_stop = f"{_SUBJECTS[stop]} allows at most f/{stops[stop]:.3g}"
    allowed_disparity = f"{_SUBJECTS[room]} allows at most {most / near:.4g} px"
    reasons = []
    if region.f_number[0] > region.f_number[1]:
        reasons.append(
            f"the smallest f-number is f/{region.f_number[0]:.3g}, and {allowed_stop}"
        )
    elif shortest > sharp:
        number = region.spread * shortest**2
        needs = f"a blur circle of at most {task.blur_px:g} px from {near:g} to {far:g} m needs f/{number:.3g} or more"
        reasons.append(
            f"{needs}, even with the shortest focal length, and {allowed_stop}"
        )
    if needed > 0:
        error = f"a depth error of {1e3 * limits['depth error']:.3g} mm at {far:g} m"
        longest, baseline = max(sharp, shortest), region.baseline[1]
        if needed > most:
            reasons.append(
                f"{error} needs a disparity of {needed / near:.4g} px at {near:g} m, and {allowed_disparity}"
            )
        if longest * baseline < needed:
            length = 1e3 * optics.focal_length(task.focus, longest * task.pitch)
            needs = f"{error} needs a baseline of {needed / longest:.3g} m with the longest usable focal length"
            reasons.append(
                f"{needs}, {length:.3g} mm, and the largest baseline is {baseline:g} m"
            )
    if shortest * region.baseline[0] > most:
        least = shortest * region.baseline[0] / near
        gives = f"the smallest baseline and the shortest focal length give a disparity of {least:.4g} px at {near:g} m"
        reasons.append(f"{gives}, and {allowed_disparity}")
    return reasons
