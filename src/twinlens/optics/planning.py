"""The best stereo rig for a task, all feasible ones, and the limits that bind; the formulas are those of `rig_task`.

Every limit bounds the focal length fx, the baseline B, the f-number N, the product fx B, or N / fx^2. The feasible set
and the best choice thus have closed forms. They are exact: a choice that a limit fixes meets it to the last digits, and
the whole plan takes 0.3 ms, or up to 20 ms where the changes that would help an infeasible task are searched. The tests
compare the closed forms with a search over a grid of (fx, B, N), which is within 1 % of them.
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

Limits = Mapping[str, float]
"""Values of limits by the names in `LIMITS`."""

_UPPER = (
    "depth error",
    "blur",
    "diffraction",
    "noise",
    "disparities",
    "largest baseline",
    "longest focal length",
    "largest f-number",
)
_LOWER = (
    "overlap",
    "smallest baseline",
    "shortest focal length",
    "smallest f-number",
)
LIMITS = (*_UPPER, *_LOWER)
"""The limits of a task, by the names in a plan. "noise" is the longest exposure."""

_TRIAL = 1.1  # a limit binds if loosening it by this factor improves the best choice
_LEAST_GAIN = 1e-9
_LOOSEST = 1e30
_HALVINGS = 64  # of log(_LOOSEST): more than the digits of a float


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

    Raises InputError unless `task` is a RigTask. An infeasible task is no error: see `RigPlan.reasons`.

    >>> task = RigTask(1280, 960, 3.45, (0.5, 3.0), fov_x_deg=60, depth_error=0.01, max_disparities=400)
    >>> best = plan_rig(task).best
    >>> round(best.baseline, 4), round(float(best.depth_error(3.0)), 6)
    (0.0812, 0.01)
    """
    if not isinstance(task, RigTask):
        raise InputError(f"plan_rig needs a RigTask, got {format_value(task)}")
    limits = _limits(task)
    region = _region(task, limits)
    if not region.is_feasible:
        return RigPlan(
            task,
            best=None,
            limits=_in_task_units(task, limits),
            used={},
            feasible={},
            binding={},
            reasons=tuple(_reasons(task, limits, region)),
            changes=tuple(_changes(task, limits)),
        )
    best = _best(task, region)
    return RigPlan(
        task,
        best=best,
        limits=_in_task_units(task, limits),
        used=_in_task_units(task, _used(best, limits)),
        feasible=_feasible(task, region, best),
        binding=_binding(task, limits),
        reasons=(),
        changes=(),
    )


def _limits(task: RigTask) -> dict[str, float]:
    """Every limit that the task has; focal lengths as fx in pixels, noise as the longest exposure."""
    shortest, longest = _fx_ends(task)
    smallest_baseline, largest_baseline = task.ends("baseline")
    smallest_f_number, largest_f_number = task.ends("f_number")
    limits = {
        "blur": task.blur_px,
        "diffraction": task.airy_px,
        "overlap": task.overlap,
        "disparities": task.max_disparities,
        "smallest baseline": smallest_baseline,
        "largest baseline": largest_baseline,
        "shortest focal length": shortest,
        "longest focal length": longest,
        "smallest f-number": smallest_f_number,
        "largest f-number": largest_f_number,
    }
    if task.depth_error is not None:
        limits = {"depth error": task.depth_error, **limits}
    if task.light is not None:
        limits["noise"] = task.light.longest_exposure
    return limits


def _fx_ends(task: RigTask) -> tuple[float, float]:
    """The shortest and the longest fx, pixels, of the task's fields of view or focal lengths."""
    if task.fov_x_deg is not None:
        narrowest, widest = task.ends("fov_x_deg")
        shortest = optics.fx_from_fov(task.width, widest)
        return shortest, optics.fx_from_fov(task.width, narrowest)
    shortest, longest = (
        _film_distance(1e-3 * length, task.focus) / task.pitch
        for length in task.ends("focal_length_mm")
    )
    return shortest, longest


def _film_distance(focal_length: float, focus_distance: float) -> float:
    """v of the thin-lens equation 1/f = 1/v + 1/focus_distance."""
    return 1 / (1 / focal_length - 1 / focus_distance)


def _used(best: RigChoice, limits: Limits) -> dict[str, float]:
    """What a choice needs of each limit, as `_limits`."""
    task = best.task
    used = {
        "depth error": float(best.depth_error(task.depth_range[1])),
        "blur": float(best.blur_px(task.depth_range).max()),
        "diffraction": best.airy_px,
        "overlap": float(best.overlap(task.depth_range[0])),
        # The limit allows for whole numbers at both ends wherever they fall; this rig's may need one fewer.
        "disparities": float(best.search[1]),
        "smallest baseline": best.baseline,
        "largest baseline": best.baseline,
        "shortest focal length": best.fx,
        "longest focal length": best.fx,
        "smallest f-number": best.f_number,
        "largest f-number": best.f_number,
    }
    if task.light is not None:
        # The f-number of an exposure of t seconds is proportional to sqrt(t).
        used["noise"] = (best.f_number / task.light.largest_f_number(1.0)) ** 2
    return {name: used[name] for name in limits}


@dataclass(frozen=True)
class _Region:
    """The feasible set: ranges of fx, B, N and fx B, and N >= spread fx^2, which is the blur limit."""

    fx: tuple[float, float]
    baseline: tuple[float, float]
    f_number: tuple[float, float]
    product: tuple[float, float]
    spread: float

    @property
    def is_feasible(self) -> bool:
        ranges = (self.fx, self.f_number, self.product)
        if any(least > most for least, most in ranges):
            return False
        least_product = self.fx[0] * self.baseline[0]
        most_product = self.fx[1] * self.baseline[1]
        return least_product <= self.product[1] and most_product >= self.product[0]


def _region(task: RigTask, limits: Limits) -> _Region:
    # c = A fx |1/z - k| with A = fx p / N is at most the blur limit where N >= p |1/z - k| / limit fx^2.
    spread = task.pitch * task.defocus / limits["blur"]
    largest_f_number = min(_f_numbers(task, limits).values())
    longest_sharp = math.sqrt(largest_f_number / spread)
    return _Region(
        fx=(
            limits["shortest focal length"],
            min(limits["longest focal length"], longest_sharp),
        ),
        baseline=(limits["smallest baseline"], limits["largest baseline"]),
        f_number=(limits["smallest f-number"], largest_f_number),
        product=(_needed_product(task, limits), min(_products(task, limits).values())),
        spread=spread,
    )


def _f_numbers(task: RigTask, limits: Limits) -> dict[str, float]:
    """The largest f-number that each limit allows."""
    largest_airy = limits["diffraction"] * task.pitch
    f_numbers = {
        "largest f-number": limits["largest f-number"],
        "diffraction": largest_airy / airy_diameter(task.wavelength, 1.0),
    }
    if task.light is not None:
        f_numbers["noise"] = task.light.largest_f_number(limits["noise"])
    return f_numbers


def _products(task: RigTask, limits: Limits) -> dict[str, float]:
    """The largest fx B that each limit allows.

    The disparity at depth z is fx B / z. From far to near it changes by fx B (1/near - 1/far), which is searched; at
    the near end it is the width that the two images do not share.
    """
    near, far = task.depth_range
    searched = limits["disparities"] - EXTRA_DISPARITIES
    return {
        "disparities": searched / (1 / near - 1 / far),
        "overlap": (1 - limits["overlap"]) * task.width * near,
    }


def _needed_product(task: RigTask, limits: Limits) -> float:
    """The smallest fx B that meets the tolerated depth error, z^2 e / (fx B) for an error of disparity e."""
    if "depth error" not in limits:
        return 0.0
    far = task.depth_range[1]
    error_at_unit_product = float(depth_error(far, 1.0, 1.0, task.disparity_error_px))
    return error_at_unit_product / limits["depth error"]


def _best(task: RigTask, region: _Region) -> RigChoice:
    """The best choice of a feasible region, as `plan_rig` defines it.

    The longest fx comes first: it allows the smallest baseline for a product, and the largest product for a baseline.
    """
    longest = region.fx[1]
    needed, most = region.product
    if task.depth_error is None:
        needed = min(most, longest * region.baseline[1])
    baseline = max(region.baseline[0], needed / longest)
    fx = min(longest, most / baseline)
    # c^2 + (lambda N / p)^2 with c = K / N, K = fx^2 p defocus, has the derivative 0 at N^2 = K p / lambda.
    sharpest = fx * task.pitch * math.sqrt(task.defocus / task.wavelength)
    least_f_number = max(region.f_number[0], region.spread * fx**2)
    f_number = min(max(sharpest, least_f_number), region.f_number[1])
    return RigChoice(task, baseline, fx, f_number)


def _objective(task: RigTask, best: RigChoice) -> float:
    if task.depth_error is not None:
        return best.baseline
    return float(best.depth_error(task.depth_range[1]))


def _feasible(
    task: RigTask, region: _Region, best: RigChoice
) -> dict[str, tuple[float, float]]:
    """The ranges of `RigPlan.feasible`."""
    shortest, longest = region.fx
    smallest, largest = region.baseline
    needed, most = region.product
    fx = max(shortest, needed / largest), min(longest, most / smallest)
    lengths = [1e3 * optics.focal_length(task.focus, end * task.pitch) for end in fx]
    views = [optics.fov_x_deg(task.width, end) for end in fx]
    return {
        "baseline": (max(smallest, needed / longest), min(largest, most / shortest)),
        "focal_length_mm": (lengths[0], lengths[1]),
        "fov_x_deg": (views[1], views[0]),
        "f_number": (
            max(region.f_number[0], region.spread * fx[0] ** 2),
            region.f_number[1],
        ),
        "focus_distance": _focus_range(best),
    }


def _focus_range(best: RigChoice) -> tuple[float, float]:
    """The focus distances that keep both ends of the depth range within the blur limit."""
    task = best.task
    if task.focus_distance is not None:
        return task.focus_distance, task.focus_distance
    near, far = task.depth_range
    # |1/z - k| A fx <= limit for the vergence k of the focus.
    margin = task.blur_px / (best.aperture_diameter * best.fx)
    least_vergence = 1 / near - margin
    most_vergence = 1 / far + margin
    farthest = 1 / least_vergence if least_vergence > 0 else math.inf
    return 1 / most_vergence, farthest


def _binding(task: RigTask, limits: Limits) -> dict[str, float]:
    """The relative gain of the objective by each limit that, loosened by `_TRIAL`, improves it; largest first."""
    now = _objective(task, _best(task, _region(task, limits)))
    gains = {}
    for name in limits:
        looser = _region(task, _loosened(limits, (name,), _TRIAL))
        gain = 1 - _objective(task, _best(task, looser)) / now
        if gain > _LEAST_GAIN:
            gains[name] = gain
    ranked = sorted(gains, key=lambda name: -gains[name])
    return {name: gains[name] for name in ranked}


def _changes(task: RigTask, limits: Limits) -> list[dict[str, float]]:
    """Every smallest set of limits whose loosening makes the task feasible, each loosened as little as possible."""
    for size in range(1, len(limits) + 1):
        changes = [
            _least_change(task, limits, names)
            for names in combinations(limits, size)
            if _region(task, _loosened(limits, names, _LOOSEST)).is_feasible
        ]
        if changes:
            return changes
    return []


def _least_change(
    task: RigTask, limits: Limits, names: tuple[str, ...]
) -> dict[str, float]:
    """The values of these limits that make the task feasible, first by a common factor, then each on its own."""
    needed = _tightened(task, limits, _loosened(limits, names, _LOOSEST), names)
    if len(names) > 1:
        for name in names:
            needed = _tightened(task, limits, needed, (name,))
    change = _in_task_units(task, {name: needed[name] for name in names})
    if "disparities" in change:
        change["disparities"] = math.ceil(change["disparities"])
    return change


def _loosened(
    limits: Limits, names: tuple[str, ...], factor: float
) -> dict[str, float]:
    """The limits with those of these names multiplied, or divided, by the factor."""
    loosened = dict(limits)
    for name in names:
        loosened[name] *= factor if name in _UPPER else 1 / factor
    return loosened


def _tightened(
    task: RigTask, limits: Limits, loose: Limits, names: tuple[str, ...]
) -> dict[str, float]:
    """Feasible limits between `limits` and `loose` ones, of which the named ones deviate from `limits` the least.

    A bisection of the logarithm of their common factor.
    """
    low, high = 0.0, math.log(_LOOSEST)
    tightened = dict(loose)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        changed = _loosened(limits, names, math.exp(middle))
        trial = {**loose, **{name: changed[name] for name in names}}
        if _region(task, trial).is_feasible:
            high, tightened = middle, trial
        else:
            low = middle
    return tightened


def _in_task_units(task: RigTask, limits: Limits) -> dict[str, float]:
    """Limits as the task has them: fx as a field of view in degrees or a focal length in millimetres."""
    converted = dict(limits)
    for name, value in limits.items():
        if name.endswith("focal length"):
            converted[name] = (
                _focal_length_mm(task, value)
                if task.fov_x_deg is None
                else optics.fov_x_deg(task.width, value)
            )
    return converted


def _focal_length_mm(task: RigTask, fx: float) -> float:
    return 1e3 * optics.focal_length(task.focus, fx * task.pitch)


_SUBJECTS = {
    "diffraction": "diffraction",
    "noise": "the light",
    "largest f-number": "the lens",
    "overlap": "the overlap",
    "disparities": "the matcher",
}
"""How a sentence names the limit that allows the least."""


def _reasons(task: RigTask, limits: Limits, region: _Region) -> list[str]:
    """What the limits need and what they allow, a sentence for each conflict."""
    reasons = [
        _f_number_conflict(task, limits, region),
        _depth_error_and_disparity_conflict(task, limits, region),
        _depth_error_and_baseline_conflict(task, limits, region),
        _smallest_product_conflict(task, limits, region),
    ]
    return [reason for reason in reasons if reason]


def _f_number_conflict(task: RigTask, limits: Limits, region: _Region) -> str:
    smallest, largest = region.f_number
    shortest, longest_sharp = region.fx
    subject = _tightest(_f_numbers(task, limits))
    allowed = f"{subject} allows at most f/{largest:.3g}"
    if smallest > largest:
        return f"the smallest f-number is f/{smallest:.3g}, and {allowed}"
    if shortest <= longest_sharp:
        return ""
    near, far = task.depth_range
    return (
        f"a blur circle of at most {task.blur_px:g} px from {near:g} to {far:g} m needs "
        f"f/{region.spread * shortest**2:.3g} or more, even with the shortest focal length, and {allowed}"
    )


def _depth_error_and_disparity_conflict(
    task: RigTask, limits: Limits, region: _Region
) -> str:
    needed, most = region.product
    if needed <= most:
        return ""
    near = task.depth_range[0]
    return (
        f"{_depth_error_text(task, limits)} needs a disparity of {needed / near:.4g} px at {near:g} m, and "
        f"{_allowed_disparity(task, limits, region)}"
    )


def _depth_error_and_baseline_conflict(
    task: RigTask, limits: Limits, region: _Region
) -> str:
    needed = region.product[0]
    longest = max(region.fx)
    largest = region.baseline[1]
    if longest * largest >= needed:
        return ""
    return (
        f"{_depth_error_text(task, limits)} needs a baseline of {needed / longest:.3g} m with the longest usable "
        f"focal length, {_focal_length_mm(task, longest):.3g} mm, and the largest baseline is {largest:g} m"
    )


def _smallest_product_conflict(task: RigTask, limits: Limits, region: _Region) -> str:
    least = region.fx[0] * region.baseline[0]
    if least <= region.product[1]:
        return ""
    near = task.depth_range[0]
    return (
        f"the smallest baseline and the shortest focal length give a disparity of {least / near:.4g} px at {near:g} m, "
        f"and {_allowed_disparity(task, limits, region)}"
    )


def _depth_error_text(task: RigTask, limits: Limits) -> str:
    error_mm = 1e3 * limits["depth error"]
    return f"a depth error of {error_mm:.3g} mm at {task.depth_range[1]:g} m"


def _allowed_disparity(task: RigTask, limits: Limits, region: _Region) -> str:
    subject = _tightest(_products(task, limits))
    disparity = region.product[1] / task.depth_range[0]
    return f"{subject} allows at most {disparity:.4g} px"


def _tightest(allowed: Mapping[str, float]) -> str:
    return _SUBJECTS[min(allowed, key=lambda name: allowed[name])]
