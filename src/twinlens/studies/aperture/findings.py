"""Findings of the study `aperture`: the best f-numbers of matchers compared with the two theories."""

import math
from dataclasses import dataclass

import numpy as np

from twinlens.studies.aperture.shots import F_NUMBERS, MODES
from twinlens.studies.aperture.theory import best_f_number
from twinlens.studies.bootstrap import Interval, brief, log_slope, over_scenes
from twinlens.studies.model import Finding, is_above, predicted
from twinlens.studies.table import Table

ALLOWED_STOPS = 1.5
"""Largest distance between the f-numbers of theory and matcher. There the Cramer-Rao bound, (N/N0 + N0/N) / 2 of its
minimum, is 1.14; for wrong pixels the same limit is a convention."""
PATHS_ALLOWED = 0.5
"""Largest ratio of rendering noise to sensor noise; it increases the total noise by 12 %."""
_LAW_FROM, _LAW_TO = 2.8, 16.0


@dataclass(frozen=True)
class Aim:
    """A column of errors, and the column of the f-number that theory predicts for them."""

    errors: str
    theory: str


WRONG = Aim("totbad2", "theory_best_wrong")
MEDIAN = Aim("a50", "theory_best")


def conclude(table: Table) -> list[Finding]:
    """The square law of light; best f-numbers for wrong pixels and median error against theory; rendering noise."""
    findings = [_square_law(table)]
    for mode in MODES:
        rows = table.where(exposure=mode, diffraction="with")
        findings += [_optimum(rows.where(method=method), f"{method}, {mode}") for method in rows.values("method")]
    findings += [_medians(table.where(exposure=mode, diffraction="with"), mode) for mode in MODES]
    return findings + [_rendering_noise(table.where(exposure=mode, diffraction="without"), mode) for mode in MODES]


def _optimum(rows: Table, label: str) -> Finding:
    """The distance between the f-numbers of fewest wrong pixels of matcher and theory."""
    distance = over_scenes(rows, lambda unit: _stops_from_theory(unit, WRONG))
    best = _best_of(rows, WRONG)
    end = ", an end of the sweep" if best in (F_NUMBERS[0], F_NUMBERS[-1]) else ""
    cost = cost_over_best(rows, WRONG)
    near = is_near(rows, WRONG)
    flat = "; the curve is too flat compared with its noise to decide" if near is None else ""
    return Finding(
        f"{label}: in every scene the f-number with the fewest wrong pixels is within {ALLOWED_STOPS} stops of theory",
        distance, bool(near), "stops", decided=near is not None,
        result=f"fewest at f/{best:g}{end}; theory {_range(rows, WRONG)}; mean distance {{}} (positive: narrower); "
        f"theory's f-number has {brief(abs(cost.value))} percentage points {'fewer' if cost.value < 0 else 'more'} "
        f"wrong pixels{flat}",
    )  # fmt: skip


def _medians(rows: Table, mode: str) -> Finding:
    """The distance between the f-numbers of least median error of matchers and Cramer-Rao bound."""

    def distance(unit: Table) -> list[float]:
        return [_stops_from_theory(part, MEDIAN) for _, part in unit.groups("method")]

    near = {str(method): is_near(rows.where(method=method), MEDIAN) for method in rows.values("method")}
    verdicts = [
        f"{words} for {', '.join(methods)}"
        for words, verdict in (("within", True), ("outside in some scene", False), ("too flat to decide", None))
        if (methods := [method for method, found in near.items() if found is verdict])
    ]
    decided = [found for found in near.values() if found is not None]
    return Finding(
        f"At {mode}, for every matcher and scene, the f-number with the least median error is within {ALLOWED_STOPS} "
        "stops of the Cramer-Rao bound's",
        over_scenes(rows, distance), bool(decided) and all(decided), "stops", decided=bool(decided),
        result=f"bound {_range(rows, MEDIAN)}; mean distance {{}} (positive: narrower); {'; '.join(verdicts)}",
    )  # fmt: skip


def _rendering_noise(rows: Table, mode: str) -> Finding:
    """Whether sensor noise dominates rendering noise: the ratio, averaged over the sweep."""
    ratio = over_scenes(rows, lambda unit: unit.numbers("path_noise").mean())
    text = f"At {mode}, the rendering noise is less than {PATHS_ALLOWED} of the sensor noise, averaged over the sweep"
    holds = ratio.value < PATHS_ALLOWED and not ratio.high >= PATHS_ALLOWED
    return Finding(text, ratio, holds, result="{} times the sensor noise")


def is_near(rows: Table, aim: Aim) -> bool | None:
    """Whether a matcher's best f-number is within ALLOWED_STOPS of theory's in each scene.

    None if undecided: the errors two stops from the best f-number exceed the least by no more than noise, and so does
    theory's f-number in the scenes where it is far.
    """
    stops = {scene: over_scenes(rows.where(scene=scene), lambda unit: _stops_from_theory(unit, aim)).value
             for scene in rows.values("scene")}  # fmt: skip
    far = [scene for scene, distance in stops.items() if abs(distance) > ALLOWED_STOPS]
    if far and is_above(cost_over_best(rows.where(scene=far), aim)):
        return False
    return not far if is_above(cost_over_best(rows, aim, steps=2)) else None


def cost_over_best(rows: Table, aim: Aim, steps: int = 0) -> Interval:
    """The additional error, over scenes, of theory's f-number, or of the better one `steps` steps from the best one.

    The best f-number is cross-validated: found on the scene's other seeds, if there are any.
    """

    def cost(unit: Table) -> float:
        own, theory = unit.rows[0], float(unit.numbers(aim.theory)[0])
        others = rows.where(lambda row: row["seed"] != own["seed"], scene=own["scene"])
        best = _best_of(others if len(others) else unit, aim)
        at = F_NUMBERS.index(best)
        places = [F_NUMBERS[k] for k in (at - steps, at + steps) if 0 <= k < len(F_NUMBERS)]
        if not steps:
            places = [min(F_NUMBERS, key=lambda number: abs(math.log(number / theory)))]
        return min(_mean_at(unit, number, aim) for number in places) - _mean_at(unit, best, aim)

    return over_scenes(rows, cost)


def _range(rows: Table, aim: Aim) -> str:
    numbers = rows.numbers(aim.theory)
    return f"f/{numbers.min():.2g} to f/{numbers.max():.2g}"


def _best_of(rows: Table, aim: Aim) -> float:
    return min(F_NUMBERS, key=lambda number: _mean_at(rows, number, aim))


def _mean_at(rows: Table, f_number: float, aim: Aim) -> float:
    return float(rows.where(f_number=f_number).numbers(aim.errors).mean())


def _stops_from_theory(unit: Table, aim: Aim) -> float:
    """The distance in stops of the best f-number of one scene and seed from theory's; positive if narrower."""
    errors = np.array([_mean_at(unit, number, aim) for number in F_NUMBERS])
    best = best_f_number(np.array(F_NUMBERS), errors)
    return 2.0 * math.log2(best / float(unit.numbers(aim.theory)[0]))


def _square_law(table: Table) -> Finding:
    """The exponent of the mean level in A at the fixed exposure, at f-numbers without saturation."""
    rows = table.where(exposure=MODES[0], diffraction="without")
    rows = rows.where(lambda row: _LAW_FROM <= float(row["f_number"]) <= _LAW_TO)
    fall = log_slope("f_number", "level")
    slope = over_scenes(rows, lambda unit: -fall(unit))
    return predicted("At a fixed exposure the mean level is proportional to A^p with p = {}", slope, 2.0, 0.01)
