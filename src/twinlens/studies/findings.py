"""Findings: a claim, the measurement that tests it, and the verdict; helpers that make the usual kinds of claims."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from twinlens.studies.intervals import (
    Interval,
    brief,
    is_above,
    log_slope,
    over_scenes,
    paired_difference,
)
from twinlens.studies.table import Table, Value

_UNMEASURED = Interval(math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Finding:
    """A claim, the measurement that tests it, and whether the claim holds.

    text: the claim, without its full stop. result: the measurement in words. measured: the number, in `unit`, that
    replaces one {} in text or result. expected: the predicted value and its relative `tolerance`. answer: which of
    several alternatives was found; a seed supports the finding if its own answer is the same. decided: False for an
    open claim.
    """

    text: str
    measured: Interval
    holds: bool
    unit: str = ""
    expected: float | None = None
    tolerance: float | None = None
    answer: str = ""
    decided: bool = True
    result: str = ""

    @property
    def has_verdict(self) -> bool:
        """Whether the claim was decided; it is open where its number could not be measured (NaN)."""
        needs_number = "{}" in self.text + self.result
        return self.decided and not (needs_number and math.isnan(self.measured.value))

    @property
    def template(self) -> str:
        """The claim and the result, with {} for the number."""
        return f"{self.text}. Measured: {self.result}" if self.result else self.text

    @property
    def sentence(self) -> str:
        """The claim and the result with the number, without the last full stop."""
        return self.template.replace("{}", self.measured.format(self.unit), 1)


def compared(
    claim: str, difference: Interval, above: str, below: str, rest: str, *, unit: str = "percentage points",
    answer: str = "",
) -> Finding:  # fmt: skip
    """The claim that a difference is positive; it holds if the whole interval is.

    The result states the size of the difference, followed by the word `above` if it is positive or `below` if it is
    negative, and by `rest`.

    >>> finding = compared("SSD has fewer wrong pixels than SAD", Interval(-2, -3, -1, 9), "fewer", "more", "than SAD")
    >>> finding.holds, finding.sentence.partition(". ")[2]
    (False, 'Measured: 2 percentage points [1, 3] more than SAD')
    """
    is_negative = difference.value < 0
    size = -difference if is_negative else difference
    word = below if is_negative else above
    return Finding(
        claim,
        size,
        is_above(difference),
        unit,
        answer=answer,
        result=f"{{}} {word} {rest}".strip(),
    )


def fewer_wrong(
    claim: str, rows: Table, best: Value, rival: Value, rest: str, *, answer: str = ""
) -> Finding:
    """`compared`: the claim that the matcher `best` has fewer wrong pixels (totbad2) than the matcher `rival`."""
    margin = paired_difference(rows, "totbad2", "method", rival, best)
    return compared(claim, margin, "fewer", "more", rest, answer=answer)


def predicted(
    text: str, measured: Interval, expected: float, tolerance: float, unit: str = ""
) -> Finding:
    """The claim that a value equals a prediction; it holds within the relative tolerance."""
    holds = abs(measured.value / expected - 1) <= tolerance
    return Finding(text, measured, holds, unit, expected, tolerance)


def power_law(
    text: str,
    rows: Table,
    x: str,
    y: str,
    expected: float,
    tolerance: float,
    by: Sequence[str] = (),
) -> Finding:
    """`predicted`: the exponent p of y ~ x^p, fitted for each scene, seed, and value of the columns `by`."""
    slope = log_slope(x, y)
    measured = over_scenes(
        rows, lambda unit: [slope(part) for _, part in unit.groups(*by)]
    )
    return predicted(text, measured, expected, tolerance)


def open_claim(text: str) -> Finding:
    """A claim that the chosen methods or scenes cannot decide, and that has no number."""
    return Finding(text, _UNMEASURED, holds=False, decided=False)


@dataclass(frozen=True, eq=False)
class SeedSupport:
    """A finding from all rows, and how many of the seeds support it when each is evaluated alone."""

    finding: Finding
    supporting: int
    seeds: int

    @property
    def verdict(self) -> str:
        """The verdict in words, with the expected value and the number of supporting seeds."""
        finding = self.finding
        if not finding.has_verdict:
            is_measured = not math.isnan(finding.measured.value)
            return f"no verdict: {'not decided' if is_measured else 'not measured'}"
        parts = ["holds" if finding.holds else "does not hold"]
        if finding.expected is not None:
            expected = f"expected {brief(finding.expected)} {finding.unit}".strip()
            if finding.tolerance is not None:
                expected += f" within {100 * finding.tolerance:.3g} %"
            parts.append(expected)
        parts.append(f"{self.supporting} of {self.seeds} seeds support it")
        return "; ".join(parts)
