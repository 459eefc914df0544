"""Findings: a claim, the measurement that tests it, and the verdict; helpers that make the usual kinds of claims.

A verdict follows from the interval alone: the claim holds, or does not, where the interval is on one side of the
claim's limits, and is not decided where it contains one. What sample a claim needs is declared with the claim.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from twinlens.errors import counted
from twinlens.scoring.intervals import Interval, brief
from twinlens.studies.intervals import log_slope, over_scenes, paired_difference
from twinlens.studies.table import Table, Value

HOLDS, FAILS, OPEN = "holds", "does not hold", "not decided"
BLOCK_PIXELS = 9 * 9  # of the usual block; overlapping blocks are not independent
MOST_UNITS = 100  # of seeds or scenes that are recommended
_UNMEASURED = Interval(math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Needs:
    """The least sample on which a claim is tested, declared with the claim before anything is measured.

    units: scenes, or seeds of the only scene. pixels: of an image. region_pixels: of the smallest region of an image.
    """

    units: int = 3
    pixels: int = 0
    region_pixels: int = 0


ANY_SAMPLE = Needs(units=0)
REPEATED = Needs()
"""An interval of three units contains the true median with a probability of 3/4; one of two with 1/2."""
SHARES = Needs(pixels=400 * BLOCK_PIXELS)
"""Of shares of wrong pixels: the standard error of a share of 400 independent blocks is at most 2.5 %."""
REGIONS = Needs(region_pixels=30 * BLOCK_PIXELS)
"""Of the mean over a region: with 30 independent blocks it is nearly normally distributed."""


@dataclass(frozen=True)
class Finding:
    """A claim, the measurement that tests it, and whether the claim holds.

    text: the claim, without its full stop. result: the measurement in words. measured: the number, in `unit`, that
    replaces one {} in text or result. holds: whether the claim is true of the number. limits: the values of the number
    between which the claim is true or false; it is not decided if the interval contains one. expected: the predicted
    value and its relative `tolerance`. answer: which of several alternatives was found; a seed supports the finding if
    its own answer is the same. decided: False for an open claim. needs: the least sample on which it is tested.
    region_pixels: of the smallest region that was evaluated.
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
    limits: tuple[float, ...] = ()
    needs: Needs = ANY_SAMPLE
    region_pixels: float = math.inf

    @property
    def is_measured(self) -> bool:
        """Whether the claim has its number, or has none to measure."""
        needs_number = "{}" in self.text + self.result
        return not (needs_number and math.isnan(self.measured.value))

    @property
    def has_verdict(self) -> bool:
        """Whether the measurement decides the claim, if its sample suffices."""
        return self.decided and self.is_measured and self.open_limit is None

    @property
    def open_limit(self) -> float | None:
        """The limit in the interval that is nearest to the number; None if the interval contains no limit."""
        inside = [limit for limit in self.limits if self.measured.contains(limit)]
        distance = {limit: abs(limit - self.measured.value) for limit in inside}
        return min(inside, key=lambda limit: distance[limit], default=None)

    @property
    def unit_name(self) -> str:
        """What the interval resamples: "seed" or "scene"."""
        return "seed" if self.measured.scene else "scene"

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
    answer: str = "", needs: Needs = REPEATED, region_pixels: float = math.inf,
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
        difference.value > 0,
        unit,
        answer=answer,
        result=f"{{}} {word} {rest}".strip(),
        limits=(0.0,),
        needs=needs,
        region_pixels=region_pixels,
    )


def fewer_wrong(
    claim: str, rows: Table, best: Value, rival: Value, rest: str, *, answer: str = "",
    needs: Needs = SHARES, region_pixels: float = math.inf,
) -> Finding:  # fmt: skip
    """`compared`: the claim that the matcher `best` has fewer wrong pixels (totbad2) than the matcher `rival`."""
    margin = paired_difference(rows, "totbad2", "method", rival, best)
    return compared(
        claim, margin, "fewer", "more", rest, answer=answer, needs=needs, region_pixels=region_pixels
    )  # fmt: skip


def bounded(
    text: str, measured: Interval, low: float, high: float, unit: str = "", *, result: str = "",
    needs: Needs = REPEATED, region_pixels: float = math.inf,
) -> Finding:  # fmt: skip
    """The claim that a value is between low and high, one of which may be infinite.

    >>> share = Interval(0.8, 0.4, 1.2, 9)
    >>> bounded("The share is below 1: {}", share, -math.inf, 1.0).has_verdict
    False
    """
    limits = tuple(limit for limit in (low, high) if math.isfinite(limit))
    return Finding(
        text, measured, low < measured.value < high, unit, result=result, limits=limits, needs=needs,
        region_pixels=region_pixels,
    )  # fmt: skip


def predicted(
    text: str, measured: Interval, expected: float, tolerance: float, unit: str = "", *, needs: Needs = REPEATED,
) -> Finding:  # fmt: skip
    """The claim that a value equals a prediction; it holds if the whole interval is within the relative tolerance."""
    holds = abs(measured.value / expected - 1) <= tolerance
    limits = (expected * (1 - tolerance), expected * (1 + tolerance))
    return Finding(
        text, measured, holds, unit, expected, tolerance, limits=limits, needs=needs
    )


def power_law(
    text: str, rows: Table, x: str, y: str, expected: float, tolerance: float, by: Sequence[str] = (), *,
    needs: Needs = REPEATED,
) -> Finding:  # fmt: skip
    """`predicted`: the exponent p of y ~ x^p, fitted for each scene, seed, and value of the columns `by`."""
    slope = log_slope(x, y)
    measured = over_scenes(
        rows, lambda unit: [slope(part) for _, part in unit.groups(*by)]
    )
    return predicted(text, measured, expected, tolerance, needs=needs)


def open_claim(text: str) -> Finding:
    """A claim that the chosen methods or scenes cannot decide, and that has no number."""
    return Finding(text, _UNMEASURED, holds=False, decided=False)


@dataclass(frozen=True)
class Shortage:
    """What a claim lacks. quantity: "seed", "scene" or "pixel" (of an image). text: as a part of a sentence."""

    quantity: str
    needed: int
    text: str


def shortages(
    finding: Finding, image_pixels: int, seeds: int = 0
) -> tuple[Shortage, ...]:
    """What the sample of a finding lacks of what its claim needs; empty if it suffices.

    seeds: of the study, which are the units of a claim about one scene that could not be measured.
    """
    needs, units = finding.needs, finding.measured.units
    if not units and finding.measured.scene:
        units = seeds
    lacking = []
    if 0 < units < needs.units:
        name = finding.unit_name
        text = f"{counted(needs.units, name)} (has {units})"
        lacking.append(Shortage(name, needs.units, text))
    if image_pixels < needs.pixels:
        text = f"images of {needs.pixels} pixels (has {image_pixels})"
        lacking.append(Shortage("pixel", needs.pixels, text))
    if finding.region_pixels < needs.region_pixels:
        share = max(finding.region_pixels, 1) / image_pixels
        text = f"{needs.region_pixels} pixels in its smallest region (has {finding.region_pixels:.0f})"
        lacking.append(Shortage("pixel", math.ceil(needs.region_pixels / share), text))
    return tuple(lacking)


def units_to_decide(finding: Finding) -> int | None:
    """About how many units would move the interval off its limit, if the number stays; None if over MOST_UNITS.

    The width of an interval is proportional to 1 / sqrt(units).
    """
    limit, measured = finding.open_limit, finding.measured
    if limit is None or measured.value == limit:
        return None
    end = measured.low if limit < measured.value else measured.high
    ratio = (end - measured.value) / (limit - measured.value)
    units = math.floor(measured.units * ratio**2) + 1
    return units if units <= MOST_UNITS else None


@dataclass(frozen=True, eq=False)
class SeedSupport:
    """A finding from all rows, and how many of the seeds support it when each is evaluated alone.

    lacking: what its sample lacks. place: the only scene on which a claim about scenes was tested.
    """

    finding: Finding
    supporting: int
    seeds: int
    lacking: tuple[Shortage, ...] = ()
    place: str = ""

    @property
    def state(self) -> str:
        """HOLDS, FAILS or OPEN."""
        if self.lacking or not self.finding.has_verdict:
            return OPEN
        return HOLDS if self.finding.holds else FAILS

    @property
    def verdict(self) -> str:
        """The verdict in words, with the expected value and the number of supporting seeds, or why there is none."""
        finding = self.finding
        if self.state == OPEN:
            return f"{OPEN}: {self._reason()}"
        parts = [f"{self.state} on {self.place}" if self.place else self.state]
        if finding.expected is not None:
            expected = f"expected {brief(finding.expected)} {finding.unit}".strip()
            if finding.tolerance is not None:
                expected += f" within {100 * finding.tolerance:.3g} %"
            parts.append(expected)
        verb = "supports" if self.seeds == 1 else "support"
        parts.append(f"{self.supporting} of {counted(self.seeds, 'seed')} {verb} it")
        return "; ".join(parts)

    def _reason(self) -> str:
        finding = self.finding
        if self.lacking:
            return "needs " + " and ".join(shortage.text for shortage in self.lacking)
        if not finding.is_measured:
            return "not measured"
        if finding.open_limit is None:
            return "the measurement is open"
        name, units = finding.unit_name, units_to_decide(finding)
        more = (
            f"about {counted(units, name)}" if units else f"over {MOST_UNITS} {name}s"
        )
        return f"the interval contains the limit {brief(finding.open_limit)}; {more} would decide it"
