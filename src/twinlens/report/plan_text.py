"""A planned rig as text: the best choice, its errors over depth, the limits; or why the task is infeasible."""

import math

import numpy as np

from twinlens.geometry import Float
from twinlens.optics.planning import RigPlan
from twinlens.optics.rig_task import RigChoice

_DEPTHS = 5
_Shown = tuple[
    str, float, str
]  # the name of a limit, the factor of its unit, and the unit
_LIMITS: dict[str, _Shown] = {
    "depth error": ("depth error", 1e3, "mm"),
    "blur": ("blur circle", 1, "px"),
    "diffraction": ("Airy disk", 1, "px"),
    "noise": ("exposure", 1e3, "ms"),
    "overlap": ("overlap", 100, "%"),
    "disparities": ("disparities", 1, ""),
    "smallest baseline": ("smallest baseline", 1e3, "mm"),
    "largest baseline": ("largest baseline", 1e3, "mm"),
    "shortest focal length": ("shortest focal length", 1, "mm"),
    "longest focal length": ("longest focal length", 1, "mm"),
    "smallest f-number": ("smallest f-number", 1, ""),
    "largest f-number": ("largest f-number", 1, ""),
}
_FIELDS_OF_VIEW: dict[str, _Shown] = {
    "shortest focal length": ("largest field of view", 1, "degrees"),
    "longest focal length": ("smallest field of view", 1, "degrees"),
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
    task, (near, far) = plan.task, best.depth_of_field
    least, count = best.search
    distance, limit = best.smallest_distance
    until = "infinity" if far == math.inf else f"{far:.3g} m"
    goal = (
        "depth error"
        if task.depth_error is None
        else "baseline that meets the tolerated depth error"
    )
    facts = {
        "baseline": f"{1e3 * best.baseline:.4g} mm",
        "focal length": f"{1e3 * best.focal_length:.4g} mm, fx {best.fx:.5g} px, field of view {best.fov_x_deg:.4g} "
        "degrees",
        "aperture": f"f/{best.f_number:.3g}, {1e3 * best.aperture_diameter:.3g} mm",
        "focus": f"{best.focus_distance:.4g} m; blur circle <= {task.blur_px:g} px from {near:.3g} m to {until}; "
        f"hyperfocal distance {best.hyperfocal_distance:.3g} m",
        "disparities": f"match --min-disparity {least} --num-disparities {count}; "
        f"{task.width * task.height * count / 1e6:.3g} million costs",
        "smallest distance": f"{distance:.3g} m, limited by {_LIMITS[limit][0]}",
    }
    if best.exposure is not None:
        facts["exposure"] = (
            f"{1e3 * best.exposure:.3g} ms, signal-to-noise ratio of mid-grey {best.snr:.3g}"
        )
    lines = [
        f"Best rig: the smallest {goal}",
        *(f"  {name:<18}{text}" for name, text in facts.items()),
    ]
    lines += [
        "",
        f"  {'depth':>8}{'disparity':>12}{'depth error':>14}{'blur circle':>14}{'overlap':>10}",
    ]
    for z in even_depths(best):
        error, blur = f"{1e3 * best.depth_error(z):.3g} mm", f"{best.blur_px(z):.2f} px"
        disparity, overlap = (
            f"{best.disparity(z):.1f} px",
            f"{100 * best.overlap(z):.0f} %",
        )
        lines.append(
            f"  {f'{z:.3g} m':>8}{disparity:>12}{error:>14}{blur:>14}{overlap:>10}"
        )
    lines += ["", f"  {'limit':<16}{'used':>14}  allowed"]
    lines += [_limit_line(plan, *names) for names in _ROWS if names[0] in plan.limits]
    spans = (
        ("baseline", "baseline", 1e3, "mm"), ("focal_length_mm", "focal length", 1, "mm"),
        ("f_number", "f-number", 1, ""), ("focus_distance", "focus distance", 1, "m"),
    )  # fmt: skip
    texts = []
    for name, label, factor, unit in spans:
        low, high = (f"{factor * end:.4g}" for end in plan.feasible[name])
        texts.append(
            f"{label} {low if low == high else f'{low} to {high}'} {unit}".rstrip()
        )
    return [*lines, "", f"  Feasible: {', '.join(texts)}"]


def _limit_line(plan: RigPlan, *names: str) -> str:
    """The row of a limit, or of the two ends of a range."""
    label, used = _value(plan, names[0], plan.used[names[0]])
    bounds = sorted(
        (plan.limits[name], _value(plan, name, plan.limits[name])[1]) for name in names
    )
    allowed = f"{bounds[0][1].split()[0]} to {bounds[-1][1]}"
    if bounds[0] == bounds[-1]:
        allowed = f"fixed at {bounds[0][1]}"
    if len(names) == 1:
        allowed = f"{'at least' if names[0] == 'overlap' else 'at most'} {bounds[0][1]}"
    notes = []
    for name in names:
        if gain := plan.binding.get(name):
            which = (
                f"{_value(plan, name, gain)[0]} binds" if len(names) > 1 else "binds"
            )
            notes.append(
                f"{which}: 10 % looser gives {100 * gain:.1f} % less {plan.objective}"
            )
    label = (
        label.removeprefix("smallest ")
        .removeprefix("largest ")
        .removeprefix("shortest ")
    )
    return f"  {label:<16}{used:>14}  {allowed:<22}{' '.join(notes)}".rstrip()


def _infeasible_lines(plan: RigPlan) -> list[str]:
    lines = [
        "Infeasible: no baseline, focal length and f-number meet all limits.",
        *(f"  {r}" for r in plan.reasons),
    ]
    each = (
        "both changes"
        if len(plan.changes[0]) == 2
        else "all changes"
        if len(plan.changes[0]) > 2
        else "the change"
    )
    lines += ["", f"Feasible with {each} of one line:"]
    for change in plan.changes:
        parts = []
        for name, value in change.items():
            label, needed = _value(plan, name, value, outwards=True)
            parts.append(
                f"{label} {needed} instead of {_value(plan, name, plan.limits[name])[1]}"
            )
        lines.append(f"  {' and '.join(parts)}")
    return lines


def _value(
    plan: RigPlan, name: str, value: float, outwards: bool = False
) -> tuple[str, str]:
    """The label and the value of a limit; with `outwards` rounded to the looser side."""
    label, factor, unit = (
        _FIELDS_OF_VIEW if plan.task.fov_x_deg is not None else {}
    ).get(name, _LIMITS[name])
    number = factor * value
    if outwards and number:
        step = 10.0 ** (math.floor(math.log10(number)) - 2)
        number = step * (math.floor if plan.limits[name] > value else math.ceil)(
            number / step
        )
    if name == "disparities":
        number = math.ceil(number - 1e-9)
    return label, f"{number:.4g} {unit}".rstrip()
