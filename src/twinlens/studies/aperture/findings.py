"""Findings of the study `aperture`: the best f-numbers of matchers compared with the two theories."""

import math
from typing import NamedTuple

import numpy as np

from twinlens.studies.aperture.theory import F_NUMBERS, MODES
from twinlens.studies.model import Finding, is_above, predicted
from twinlens.studies.table import Interval, Table, brief, log_parabola_minimum, log_slope, over_scenes

ALLOWED_STOPS = 1.5
"""Largest distance between the f-numbers of theory and matcher. There the Cramer-Rao bound, (N/N0 + N0/N) / 2 of its
minimum, is 1.14; for wrong pixels the same limit is a convention."""
PATHS_ALLOWED = 0.5
"""Largest ratio of rendering noise to sensor noise; it increases the total noise by 12 %."""
_LAW_FROM, _LAW_TO = 2.8, 16.0


class Aim(NamedTuple):
    """A column of errors, and the column of the f-number that theory predicts for them."""

    errors: str
    theory: str

    def mean_at(self, rows: Table, f_number: float) -> float:
        return float(rows.where(f_number=f_number).numbers(self.errors).mean())

    def best(self, rows: Table) -> float:
        return min(F_NUMBERS, key=lambda number: self.mean_at(rows, number))

    def stops_from_theory(self, unit: Table) -> float:
        """The distance in stops of the best f-number of one scene and seed from theory's; positive if narrower."""
        errors = np.array([self.mean_at(unit, number) for number in F_NUMBERS])
        return 2.0 * math.log2(log_parabola_minimum(np.array(F_NUMBERS), errors) / float(unit.numbers(self.theory)[0]))

    def range(self, rows: Table) -> str:
        numbers = rows.numbers(self.theory)
        return f"f/{numbers.min():.2g} to f/{numbers.max():.2g}"


WRONG = Aim("totbad2", "theory_best_wrong")
MEDIAN = Aim("a50", "theory_best")


def conclude(table: Table) -> list[Finding]:
    """The square law of light; best f-numbers for wrong pixels and median error against theory; rendering noise."""
    without, with_diffraction = (
        {mode: table.where(exposure=mode, diffraction=each) for mode in MODES} for each in ("without", "with")
    )
    fall = log_slope("f_number", "level")
    bright = without[MODES[0]].where(lambda row: _LAW_FROM <= float(row["f_number"]) <= _LAW_TO)  # not saturated
    law = "At a fixed exposure the mean level is proportional to A^p with p = {}"
    findings = [predicted(law, over_scenes(bright, lambda unit: -fall(unit)), 2.0, 0.01)]
    for mode, rows in with_diffraction.items():
        findings += [_optimum(rows.where(method=method), f"{method}, {mode}") for method in rows.values("method")]
    findings += [_medians(rows, mode) for mode, rows in with_diffraction.items()]
    for mode, rows in without.items():
        ratio = over_scenes(rows, lambda unit: unit.numbers("path_noise").mean())
        text = (
            f"At {mode}, the rendering noise is less than {PATHS_ALLOWED} of the sensor noise, averaged over the sweep"
        )
        holds = ratio.value < PATHS_ALLOWED and not ratio.high >= PATHS_ALLOWED
        findings.append(Finding(text, ratio, holds, result="{} times the sensor noise"))
    return findings


def _optimum(rows: Table, label: str) -> Finding:
    """The distance between the f-numbers of fewest wrong pixels of matcher and theory."""
    best = WRONG.best(rows)
    end = ", an end of the sweep" if best in (F_NUMBERS[0], F_NUMBERS[-1]) else ""
    cost, near = cost_over_best(rows, WRONG).value, is_near(rows, WRONG)
    flat = "; the curve is too flat compared with its noise to decide" if near is None else ""
    return Finding(
        f"{label}: in every scene the f-number with the fewest wrong pixels is within {ALLOWED_STOPS} stops of theory",
        over_scenes(rows, WRONG.stops_from_theory), bool(near), "stops", decided=near is not None,
        result=f"fewest at f/{best:g}{end}; theory {WRONG.range(rows)}; mean distance {{}} (positive: narrower); "
        f"theory's f-number has {brief(abs(cost))} percentage points {'fewer' if cost < 0 else 'more'} wrong "
        f"pixels{flat}",
    )  # fmt: skip


def _medians(rows: Table, mode: str) -> Finding:
    """The distance between the f-numbers of least median error of matchers and Cramer-Rao bound."""
    near = {str(method): is_near(rows.where(method=method), MEDIAN) for method in rows.values("method")}
    verdicts = [
        f"{words} for {', '.join(methods)}"
        for words, verdict in (("within", True), ("outside in some scene", False), ("too flat to decide", None))
        if (methods := [method for method, found in near.items() if found is verdict])
    ]
    decided = [found for found in near.values() if found is not None]
    distance = over_scenes(rows, lambda unit: [MEDIAN.stops_from_theory(part) for _, part in unit.groups("method")])
    return Finding(
        f"At {mode}, for every matcher and scene, the f-number with the least median error is within {ALLOWED_STOPS} "
        "stops of the Cramer-Rao bound's",
        distance, bool(decided) and all(decided), "stops", decided=bool(decided),
        result=f"bound {MEDIAN.range(rows)}; mean distance {{}} (positive: narrower); {'; '.join(verdicts)}",
    )  # fmt: skip


def is_near(rows: Table, aim: Aim) -> bool | None:
    """Whether a matcher's best f-number is within ALLOWED_STOPS of theory's in each scene.

    None if undecided: the errors two stops from the best f-number exceed the least by no more than noise, and so does
    theory's f-number in the scenes where it is far.
    """
    stops = {scene: over_scenes(rows.where(scene=scene), aim.stops_from_theory).value for scene in rows.values("scene")}
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
        best = aim.best(others if len(others) else unit)
        at = F_NUMBERS.index(best)
        places = [F_NUMBERS[k] for k in (at - steps, at + steps) if 0 <= k < len(F_NUMBERS)]
        if not steps:
            places = [min(F_NUMBERS, key=lambda number: abs(math.log(number / theory)))]
        return min(aim.mean_at(unit, number) for number in places) - aim.mean_at(unit, best)

    return over_scenes(rows, cost)
