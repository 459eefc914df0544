"""What the study `aperture` concludes: the f-numbers that matchers do best at, beside those of the theories."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twinlens.studies.aperture_shots import F_NUMBERS, MODES
from twinlens.studies.aperture_theory import best_f_number
from twinlens.studies.bootstrap import Interval, brief, log_slope, over_scenes
from twinlens.studies.model import Finding, agrees, is_above
from twinlens.studies.table import Table

ALLOWED_STOPS = 1.5
"""How far theory's f-number may lie from a matcher's.

There the Cramer-Rao bound, (N/N0 + N0/N) / 2 of its least, is 1.14. Of wrong pixels no such law is known: for them it
is a convention, taken over from the bound.
"""
PATHS_ALLOWED = 0.5
"""Noise of the light paths over the sensor's: of the pictures' variance it is a fifth then, and noise 12 % more."""
_LAW_FROM, _LAW_TO = 2.8, 16.0


@dataclass(frozen=True)
class Aim:
    """What a matcher is best at: the column of its errors, and that of theory's f-number for just these."""

    errors: str
    theory: str


WRONG = Aim("totbad2", "theory_best_wrong")
MEDIAN = Aim("a50", "theory_best")


def conclude(table: Table) -> list[Finding]:
    """The square law of light; the best f-numbers beside theory's, of wrong pixels and of the median error."""
    findings = [_square_law(table)]
    for mode in MODES:
        rows = table.where(exposure=mode, diffraction="with")
        findings += [optimum(rows.where(method=method), f"{method}, at {mode}") for method in rows.values("method")]
    findings += [_medians(table.where(exposure=mode, diffraction="with"), mode) for mode in MODES]
    return findings + [_whose_noise(table.where(exposure=mode, diffraction="without"), mode) for mode in MODES]


def optimum(rows: Table, text: str) -> Finding:
    """How far the f-number of the fewest wrong pixels lies from theory's, scene by scene; judged by `is_near`."""
    distance = over_scenes(rows, lambda unit: _stops_from_theory(unit, WRONG))
    best = best_of(rows, WRONG)
    where = f"f/{best:g}" + (", the end of the sweep" if best in (F_NUMBERS[0], F_NUMBERS[-1]) else "")
    cost = cost_over_best(rows, _of_theory, WRONG)
    said = (
        f"{text}, has the fewest wrong pixels at {where}, in the mean {{}} (above 0: narrower) from theory's "
        f"{_range(rows, WRONG)}, scene by scene; theory's cost {brief(cost.value)} percent points more; "
    )
    near = is_near(rows, WRONG)
    if near is None:
        said += "its basin is flatter than its noise: it does not decide"
        return Finding(said, distance, False, "stops", asked=False)
    return Finding(f"{said}{ALLOWED_STOPS} stops to either side are allowed in each scene", distance, near, "stops")


def _medians(rows: Table, mode: str) -> Finding:
    """How far the f-number of the least median error lies from the Cramer-Rao bound's, over all matchers.

    Judged by `is_near`, matcher by matcher.
    """

    def distance(unit: Table) -> list[float]:
        return [_stops_from_theory(part, MEDIAN) for _, part in unit.groups("method")]

    near = {str(method): is_near(rows.where(method=method), MEDIAN) for method in rows.values("method")}
    said = [
        f"{words} for {', '.join(methods)}"
        for words, verdict in (("it is", True), ("in some scene it is not", False), ("flatter than noise it is", None))
        if (methods := [method for method, found in near.items() if found is verdict])
    ]
    text = (
        f"The median error, which the Cramer-Rao bound is of, is least, at {mode} and in the mean of {len(near)} "
        f"matchers, {{}} (above 0: narrower) from the bound's {_range(rows, MEDIAN)}; "
        f"within {ALLOWED_STOPS} stops {', '.join(said)}"
    )
    decided = [found for found in near.values() if found is not None]
    return Finding(text, over_scenes(rows, distance), bool(decided) and all(decided), "stops", asked=bool(decided))


def _whose_noise(rows: Table, mode: str) -> Finding:
    """Whether the noise in the pictures is the camera's, in the mean of the sweep: the ratio with its interval."""
    ratio = over_scenes(rows, lambda unit: unit.numbers("path_noise").mean())
    text = (
        f"The noise of the pictures is the camera's: at {mode} the light paths leave at most {{}} times the sensor's, "
        f"in the mean of the sweep, where {PATHS_ALLOWED}, in every part of the interval, is allowed; the more it is, "
        "the more wrong pixels tell of the renderer"
    )
    return Finding(text, ratio, ratio.value < PATHS_ALLOWED and not ratio.high >= PATHS_ALLOWED)


def is_near(rows: Table, aim: Aim) -> bool | None:
    """Whether a matcher's best f-number is theory's in each scene, within the allowance.

    None where it does not tell: where two stops beside the best cost no more than noise does, nor theory's f-number
    in the scenes where it is far.
    """
    far = _far(rows, aim)
    if far and is_above(cost_over_best(rows.where(scene=far), _of_theory, aim)):
        return False
    return not far if is_above(cost_over_best(rows, _two_stops_beside, aim)) else None


def _range(rows: Table, aim: Aim) -> str:
    numbers = rows.numbers(aim.theory)
    return f"f/{numbers.min():.2g} to f/{numbers.max():.2g}"


def _far(rows: Table, aim: Aim) -> list[object]:
    """The scenes where a matcher's best f-number is farther from theory's than is allowed."""
    stops = {scene: over_scenes(rows.where(scene=scene), lambda unit: _stops_from_theory(unit, aim)).value
             for scene in rows.values("scene")}  # fmt: skip
    return [scene for scene, distance in stops.items() if abs(distance) > ALLOWED_STOPS]


def best_of(rows: Table, aim: Aim) -> float:
    """The f-number of the least error in the mean."""
    return min(F_NUMBERS, key=lambda number: _mean_at(rows, number, aim))


def cost_over_best(rows: Table, places: Callable[[int, Table, Aim], list[int]], aim: Aim) -> Interval:
    """How much more error the cheapest of some places of the sweep has than the best one, over scenes.

    The best is each scene's own, found on its other seeds (where one seed is all, on that): of mere noise, what is best
    under one seed is no better under another. places: from the best one's place and a scene and seed's rows.
    """

    def cost(unit: Table) -> float:
        own = unit.rows[0]
        others = rows.where(lambda row: row["seed"] != own["seed"], scene=own["scene"])
        at = F_NUMBERS.index(best_of(others if len(others) else unit, aim))
        there = min(_mean_at(unit, F_NUMBERS[k], aim) for k in places(at, unit, aim))
        return there - _mean_at(unit, F_NUMBERS[at], aim)

    return over_scenes(rows, cost)


def _two_stops_beside(at: int, unit: Table, aim: Aim) -> list[int]:
    return [k for k in (at - 2, at + 2) if 0 <= k < len(F_NUMBERS)]


def _of_theory(at: int, unit: Table, aim: Aim) -> list[int]:
    theory = float(unit.numbers(aim.theory)[0])
    return [min(range(len(F_NUMBERS)), key=lambda k: abs(math.log(F_NUMBERS[k] / theory)))]


def _mean_at(rows: Table, f_number: float, aim: Aim) -> float:
    return float(rows.where(f_number=f_number).numbers(aim.errors).mean())


def _stops_from_theory(unit: Table, aim: Aim) -> float:
    """Of the best f-number of one scene and seed, positive where it is narrower."""
    errors = np.array([_mean_at(unit, number, aim) for number in F_NUMBERS])
    best = best_f_number(np.array(F_NUMBERS), errors)
    return 2.0 * math.log2(best / float(unit.numbers(aim.theory)[0]))


def _square_law(table: Table) -> Finding:
    """Mean level against A, at the fixed exposure, where nothing burns out: the exponent."""
    rows = table.where(exposure=MODES[0], diffraction="without")
    rows = rows.where(lambda row: _LAW_FROM <= float(row["f_number"]) <= _LAW_TO)
    fall = log_slope("f_number", "level")
    slope = over_scenes(rows, lambda unit: -fall(unit))
    text = "At a fixed exposure the picture's mean level grows as A^p, p = {}"
    return Finding(text, slope, agrees(slope, 2.0, 0.01), "", 2.0, 0.01)
