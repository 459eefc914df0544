"""What a study is: `measure` makes rows from a Setup, `conclude` findings from their Table; Figures draw the Table."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_int, unknown
from twinlens.studies.table import (
    Column,
    Interval,
    Row,
    Table,
    Value,
    brief,
    log_slope,
    over_scenes,
    paired_difference,
)

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Setup:
    """The input of a study.

    scenes: names or files, as for `load_scene`. methods: as for `matching.parse_method`. seeds: one repetition each.
    spp: samples per pixel. progress: called with the fraction done and a label.

    Raises InputError without seeds, for repeated entries, and for images smaller than 64x48.
    """

    scenes: tuple[str, ...]
    methods: tuple[str, ...]
    seeds: tuple[int, ...]
    width: int = 320
    height: int = 240
    spp: int = 16
    progress: Progress = lambda fraction, label: None

    def __post_init__(self) -> None:
        if not self.seeds:
            raise InputError("a study needs at least one seed")
        for name in ("scenes", "methods", "seeds"):
            values = getattr(self, name)
            if len(set(values)) < len(values):
                raise InputError(
                    f"{name} of a study must be distinct, got {', '.join(map(str, values))}"
                )
        for name, least in (("width", 64), ("height", 48), ("spp", 1)):
            check_int(f"{name} of a study", getattr(self, name), least)


def sweep(setup: Setup, *values: Sequence[Any]) -> Iterator[tuple[Any, ...]]:
    """Every (scene, *values) of a grid, scene by scene, or every (*values) without scenes; reports the progress."""
    grid = list(itertools.product(*([setup.scenes] if setup.scenes else []), *values))
    for done, place in enumerate(grid):
        setup.progress(done / len(grid), " ".join(str(value) for value in place))
        yield place


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
        return self.decided and not (
            "{}" in self.text + self.result and math.isnan(self.measured.value)
        )

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
    """The claim that a difference is positive; it holds if the whole interval is. Its word is `above` or `below`.

    >>> finding = compared("SSD has fewer wrong pixels than SAD", Interval(-2, -3, -1, 9), "fewer", "more", "than SAD")
    >>> finding.holds, finding.sentence.partition(". ")[2]
    (False, 'Measured: 2 percentage points [1, 3] more than SAD')
    """
    size, word = difference, above
    if difference.value < 0:
        size, word = (
            Interval(
                -difference.value, -difference.high, -difference.low, difference.units
            ),
            below,
        )
    return Finding(
        claim,
        size,
        is_above(difference),
        unit,
        answer=answer,
        result=f"{{}} {word} {rest}".strip(),
    )


def fewer_wrong(
    claim: str, rows: Table, best: Value, other: Value, rest: str, *, answer: str = ""
) -> Finding:
    """`compared`: the claim that the matcher `best` has fewer wrong pixels (totbad2) than the matcher `other`."""
    margin = paired_difference(rows, "totbad2", "method", other, best)
    return compared(claim, margin, "fewer", "more", rest, answer=answer)


def predicted(
    text: str, measured: Interval, expected: float, tolerance: float, unit: str = ""
) -> Finding:
    """The claim that a value equals a prediction; it holds within the relative tolerance."""
    return Finding(
        text,
        measured,
        abs(measured.value / expected - 1) <= tolerance,
        unit,
        expected,
        tolerance,
    )


def power_law(
    text: str,
    rows: Table,
    x: str,
    y: str,
    expected: float,
    tolerance: float,
    each: Sequence[str] = (),
) -> Finding:
    """`predicted`: the exponent p of y ~ x^p, fitted for each scene, seed, and value of the columns `each`."""
    slope = log_slope(x, y)
    measured = over_scenes(
        rows, lambda unit: [slope(part) for _, part in unit.groups(*each)]
    )
    return predicted(text, measured, expected, tolerance)


def open_claim(text: str) -> Finding:
    """A claim that the chosen methods or scenes cannot decide, and that has no number."""
    return Finding(
        text, Interval(math.nan, math.nan, math.nan), holds=False, decided=False
    )


def is_above(measured: Interval, floor: float = 0.0) -> bool:
    """Whether a value and its interval, if it has one, are above the floor."""
    return measured.value > floor and not measured.low <= floor


@dataclass(frozen=True)
class Figure:
    """A plot of the table: the mean of `y` against `x`, one line per value of `by`, one panel per value of `panel`.

    kind: "line" (means with bootstrap bands), "scatter" (a point per row), "heatmap" (mean of `z` over x and y).
    where: keep rows with these values. residual_of: a column of predictions; a strip below the plot shows
    measured / predicted - 1. also: columns drawn dashed in the colour of y. marks: (column, label), a vertical line at
    the column's mean, geometric for a logarithmic axis. best: "least" or "most", the point of each line to ring. x_of:
    labels of the x axis of single panels. Rows whose `by` is "theory" are drawn as a black dashed line.
    """

    name: str
    title: str
    x: str
    y: str
    by: str = ""
    panel: str = ""
    kind: str = "line"
    z: str = ""
    log_x: bool = False
    log_y: bool = False
    where: Mapping[str, object] = field(default_factory=dict)
    residual_of: str = ""
    also: tuple[str, ...] = ()
    marks: tuple[tuple[str, str], ...] = ()
    best: str = ""
    x_of: Mapping[str, str] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of all columns that are drawn."""
        named = (
            self.x,
            self.y,
            self.by,
            self.panel,
            self.z,
            self.residual_of,
            *self.where,
            *self.also,
        )
        return tuple(
            name for name in (*named, *(column for column, _ in self.marks)) if name
        )


@dataclass(frozen=True, eq=False)
class Picture:
    """Captioned images side by side, uint8 (H, W) or (H, W, 3), `columns` in a row."""

    name: str
    title: str
    images: tuple[NDArray[np.uint8], ...]
    captions: tuple[str, ...]
    columns: int = 6


@dataclass(frozen=True)
class Measured:
    """The output of `measure`: rows, which may omit columns, notes for study.json, and remarks for it and the page."""

    rows: Sequence[Row]
    pictures: tuple[Picture, ...] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    remarks: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """A sweep of one physical quantity.

    columns: of its table, besides "scene" and "seed", which every table has. conclude: called with the whole table, and
    with the rows of each seed alone. defaults: the Setup where nothing else is chosen.
    """

    name: str
    question: str
    columns: tuple[Column, ...]
    measure: Callable[[Setup], Measured]
    conclude: Callable[[Table], Sequence[Finding]]
    figures: tuple[Figure, ...]
    defaults: Setup

    def __post_init__(self) -> None:
        known = [column.name for column in self.all_columns]
        for figure in self.figures:
            for name in sorted(set(figure.columns).difference(known)):
                raise InputError(
                    f"the figure {figure.name!r}: {unknown('column', name, known)}"
                )

    @property
    def all_columns(self) -> tuple[Column, ...]:
        """The table's columns, "scene" and "seed" first."""
        return (Column("scene", "", "scene"), Column("seed", "", "seed"), *self.columns)


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
            return "no verdict: " + (
                "not measured" if math.isnan(finding.measured.value) else "not decided"
            )
        parts = ["holds" if finding.holds else "does not hold"]
        if finding.expected is not None:
            within = (
                ""
                if finding.tolerance is None
                else f" within {100 * finding.tolerance:.3g} %"
            )
            parts.append(
                f"expected {brief(finding.expected)} {finding.unit}".strip() + within
            )
        return "; ".join(
            [*parts, f"{self.supporting} of {self.seeds} seeds support it"]
        )


@dataclass(frozen=True, eq=False)
class Result:
    """A completed study."""

    study: Study
    setup: Setup
    table: Table
    findings: tuple[SeedSupport, ...]
    pictures: tuple[Picture, ...]
    protocol: Mapping[str, Any]
    remarks: Mapping[str, str] = field(default_factory=dict)
