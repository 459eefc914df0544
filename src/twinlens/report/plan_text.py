"""A planned rig as text: the best choice, its errors over depth, the limits; or why the task is infeasible."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinlens.geometry import Float
from twinlens.optics.planning import RigPlan
from twinlens.optics.rig_task import RigChoice

_DEPTHS = 5


@dataclass(frozen=True)
class _Display:
    """How a limit is printed: its label, and its value times `factor` with the unit."""

    label: str
    factor: float = 1
    unit: str = ""


_LIMITS = {
    "depth error": _Display("depth error", 1e3, "mm"),
    "blur": _Display("blur circle", unit="px"),
    "diffraction": _Display("Airy disk", unit="px"),
    "noise": _Display("longest exposure", 1e3, "ms"),
    "overlap": _Display("overlap", 100, "%"),
    "disparities": _Display("disparities"),
    "smallest baseline": _Display("smallest baseline", 1e3, "mm"),
    "largest baseline": _Display("largest baseline", 1e3, "mm"),
    "shortest focal length": _Display("shortest focal length", unit="mm"),
    "longest focal length": _Display("longest focal length", unit="mm"),
    "smallest f-number": _Display("smallest f-number"),
    "largest f-number": _Display("largest f-number"),
}
_FIELDS_OF_VIEW = {
    "shortest focal length": _Display("largest field of view", unit="degrees"),
    "longest focal length": _Display("smallest field of view", unit="degrees"),
}
"""Of a task that has fields of view instead of focal lengths."""
_LABELS_OF_USED = {"noise": "needed exposure"}
"""Where what a rig needs is not the limit itself: the exposure that its least signal-to-noise ratio needs."""
_RANGES = {
    "baseline": _Display("baseline", 1e3, "mm"),
    "focal_length_mm": _Display("focal length", unit="mm"),
    "f_number": _Display("f-number"),
    "focus_distance": _Display("focus distance", unit="m"),
}
_ROWS = (
    ("depth error",), ("blur",), ("diffraction",), ("noise",), ("overlap",), ("disparities",),
    ("smallest baseline", "largest baseline"), ("shortest focal length", "longest focal length"),
    ("smallest f-number", "largest f-number"),
)  # fmt: skip


def plan_text(plan: RigPlan) -> str:
    """The plan in lines, as `twinlens plan` prints it."""
    return "\n".join(
        _infeasible_lines(plan) if plan.best is None else _lines(plan, plan.best)
    )


def even_depths(best: RigChoice) -> Float:
    """Depths at equal steps of disparity, the nearest first."""
    near, far = best.task.depth_range
    return np.asarray(1 / np.linspace(1 / near, 1 / far, _DEPTHS))


def _lines(plan: RigPlan, best: RigChoice) -> list[str]:
    goal = "depth error"
    if plan.task.depth_error is not None:
        goal = "baseline that meets the tolerated depth error"
    facts = [f"  {name:<18}{text}" for name, text in _facts(best).items()]
    limits = [_limit_line(plan, *names) for names in _ROWS if names[0] in plan.limits]
    return [
        f"Best rig: the smallest {goal}",
        *facts,
        "",
        f"  {'depth':>8}{'disparity':>12}{'depth error':>14}{'blur circle':>14}{'overlap':>10}",
        *(_depth_line(best, depth) for depth in even_depths(best)),
        "",
        f"  {'limit':<16}{'used':>14}  allowed",
        *limits,
        "",
        f"  Feasible: {', '.join(_range_texts(plan))}",
    ]


def _facts(best: RigChoice) -> dict[str, str]:
    """The quantities of the best rig, by their names."""
    task = best.task
    near, far = best.depth_of_field
    end = "infinity" if far == math.inf else f"{far:.3g} m"
    least, count = best.search
    distance, limit = best.smallest_distance
    million_costs = task.width * task.height * count / 1e6
    facts = {
        "baseline": f"{1e3 * best.baseline:.4g} mm",
        "focal length": f"{1e3 * best.focal_length:.4g} mm, fx {best.fx:.5g} px, field of view {best.fov_x_deg:.4g} "
        "degrees",
        "aperture": f"f/{best.f_number:.3g}, {1e3 * best.aperture_diameter:.3g} mm",
        "focus": f"{best.focus_distance:.4g} m; blur circle <= {task.blur_px:g} px from {near:.3g} m to {end}; "
        f"hyperfocal distance {best.hyperfocal_distance:.3g} m",
        "disparities": f"match --min-disparity {least} --num-disparities {count}; {million_costs:.3g} million costs",
        "smallest distance": f"{distance:.3g} m, limited by {_LIMITS[limit].label}",
    }
    if best.exposure is not None:
        facts["exposure"] = (
            f"{1e3 * best.exposure:.3g} ms, the longest allowed that does not saturate; signal-to-noise ratio of "
            f"mid-grey {best.snr:.3g}"
        )
    return facts


def _depth_line(best: RigChoice, depth: float) -> str:
    cells = (
        (f"{depth:.3g} m", 8),
        (f"{best.disparity(depth):.1f} px", 12),
        (f"{1e3 * best.depth_error(depth):.3g} mm", 14),
        (f"{best.blur_px(depth):.2f} px", 14),
        (f"{100 * best.overlap(depth):.0f} %", 10),
    )
    return "  " + "".join(f"{text:>{width}}" for text, width in cells)


def _range_texts(plan: RigPlan) -> list[str]:
    texts = []
    for name, display in _RANGES.items():
        low, high = (f"{display.factor * end:.4g}" for end in plan.feasible[name])
        span = low if low == high else f"{low} to {high}"
        texts.append(f"{display.label} {span} {display.unit}".rstrip())
    return texts


def _limit_line(plan: RigPlan, *names: str) -> str:
    """The row of a limit, or of the two ends of a range."""
    label, used = _value(plan, names[0], plan.used[names[0]])
    label = _LABELS_OF_USED.get(names[0], label)
    for superlative in ("smallest ", "largest ", "shortest "):
        label = label.removeprefix(superlative)
    notes = [_binding_note(plan, name, names) for name in names if name in plan.binding]
    allowed = _allowed(plan, names)
    return f"  {label:<16}{used:>14}  {allowed:<22}{' '.join(notes)}".rstrip()


def _allowed(plan: RigPlan, names: Sequence[str]) -> str:
    """The limit, or the range between two limits, in words."""
    bounds = [
        (plan.limits[name], _value(plan, name, plan.limits[name])[1]) for name in names
    ]
    low, high = min(bounds), max(bounds)
    if len(names) == 1:
        return f"{'at least' if names[0] == 'overlap' else 'at most'} {low[1]}"
    if low == high:
        return f"fixed at {low[1]}"
    return f"{low[1].split()[0]} to {high[1]}"


def _binding_note(plan: RigPlan, name: str, names: Sequence[str]) -> str:
    gain = plan.binding[name]
    subject = f"{_display(plan, name).label} binds" if len(names) > 1 else "binds"
    return f"{subject}: 10 % looser gives {100 * gain:.1f} % less {plan.objective}"


_CHANGES = {1: "the change", 2: "both changes"}


def _infeasible_lines(plan: RigPlan) -> list[str]:
    lines = [
        "Infeasible: no baseline, focal length and f-number meet all limits.",
        *(f"  {reason}" for reason in plan.reasons),
        "",
        f"Feasible with {_CHANGES.get(len(plan.changes[0]), 'all changes')} of one line:",
    ]
    for change in plan.changes:
        parts = []
        for name, value in change.items():
            label, needed = _value(plan, name, value, outwards=True)
            limit = _value(plan, name, plan.limits[name])[1]
            parts.append(f"{label} {needed} instead of {limit}")
        lines.append(f"  {' and '.join(parts)}")
    return lines


def _display(plan: RigPlan, name: str) -> _Display:
    if plan.task.fov_x_deg is not None and name in _FIELDS_OF_VIEW:
        return _FIELDS_OF_VIEW[name]
    return _LIMITS[name]


def _value(
    plan: RigPlan, name: str, value: float, outwards: bool = False
) -> tuple[str, str]:
    """The label and the value of a limit; with `outwards` rounded to the looser side."""
    display = _display(plan, name)
    number = display.factor * value
    if outwards and number:
        step = 10.0 ** (math.floor(math.log10(number)) - 2)
        round_off = math.floor if plan.limits[name] > value else math.ceil
        number = step * round_off(number / step)
    if name == "disparities":
        number = math.ceil(number - 1e-9)
    return display.label, f"{number:.4g} {display.unit}".rstrip()
