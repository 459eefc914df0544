"""What a study is: a question, a way to measure, what is concluded of the table, and which figures are drawn of it.

    Setup -> measure -> Table (the CSV) -> conclude -> Findings
                          |--------------> Figures (drawn by the report room, of the CSV alone)

A `Study` is data and two functions; `STUDIES` lists those that come along, `run_study` runs one.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, unknown
from twinlens.studies.bootstrap import Interval
from twinlens.studies.table import Column, Row, Table, Value

Progress = Callable[[float, str], None]
LEAST_SIZE = (64, 48)
"""Width and height in pixels below which windows leave nothing of a photograph to measure."""


@dataclass(frozen=True)
class Setup:
    """What a study is run on.

    scenes: names or files, as `load_scene` takes them. methods: as `matching.parse_method` reads them. seeds: one
    repetition each, of every random draw. width, height, spp: of the photographs. progress: told the fraction done.
    """

    scenes: tuple[str, ...]
    methods: tuple[str, ...]
    seeds: tuple[int, ...]
    width: int = 320
    height: int = 240
    spp: int = 32
    progress: Progress = lambda fraction, now: None

    def __post_init__(self) -> None:
        if not self.seeds:
            raise InputError("a study needs one seed at least")
        for name in ("scenes", "methods", "seeds"):
            values = getattr(self, name)
            double = next((value for value in values if values.count(value) > 1), None)
            if double is not None:
                raise InputError(f"a study's {name} name {double!r} twice")
        for name in ("width", "height", "spp"):
            if not (isinstance(getattr(self, name), int) and getattr(self, name) > 0):
                raise InputError(f"a study's {name} must be a positive whole number, got {getattr(self, name)!r}")
        if self.width < LEAST_SIZE[0] or self.height < LEAST_SIZE[1]:
            least = "{}x{}".format(*LEAST_SIZE)
            raise InputError(f"a study's photographs must be {least} or larger, got {self.width}x{self.height}")


@dataclass(frozen=True)
class Finding:
    """One conclusion: what was claimed or asked, what was measured, and whether it holds.

    text: a sentence without its full stop, with {} where the measured number stands. measured: the number with its
    interval, in `unit`. holds: whether the measurement bears the sentence out. expected: what theory says, if it does,
    and within which `tolerance` (relative). answer: what was found where the sentence names one of several, as a
    matcher; a seed bears the finding out only if it gives the same answer. asked: False where the chosen methods or
    scenes leave the question open.
    """

    text: str
    measured: Interval
    holds: bool
    unit: str = ""
    expected: float | None = None
    tolerance: float | None = None
    answer: str = ""
    asked: bool = True

    @property
    def has_verdict(self) -> bool:
        """Whether it was asked, and measured: a number that the sentence names is NaN where no rows tell it."""
        return self.asked and not ("{}" in self.text and math.isnan(self.measured.value))

    @property
    def sentence(self) -> str:
        """The text with the number in its place."""
        return self.text.replace("{}", self.measured.said(self.unit), 1)


def agrees(measured: Interval, expected: float, tolerance: float) -> bool:
    """Whether a measured value is within the relative tolerance of what theory expects."""
    return abs(measured.value / expected - 1) <= tolerance


def is_above(measured: Interval, floor: float = 0.0) -> bool:
    """Whether a value is above the floor, and its interval, where there is one, too."""
    return measured.value > floor and not measured.low <= floor


@dataclass(frozen=True)
class Figure:
    """A plot of the table: the mean of `y` against `x`, a line for each value of `by`, a panel for each of `panel`.

    kind: "line" (means with bootstrap bands), "scatter" (every row a point), "heatmap" (mean of `z` over x and y).
    where: only rows with these values; rows whose `by` is "theory" are drawn as a black dashed line. residual_of: the
    column with the prediction; a strip below shows measured / predicted - 1. also: columns drawn in the same colour as
    y, dashed and without marks (a bound, a prediction). marks: (column, label): a vertical line at the column's mean,
    the geometric one where x is logarithmic.
    best: "least" or "most": the point of each line that is ringed. x_of: what the x axis says in the panel of this
    value, where that differs.
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
        """The names of all columns that it draws from."""
        named = (self.x, self.y, self.by, self.panel, self.z, self.residual_of, *self.where, *self.also)
        return tuple(name for name in (*named, *(column for column, _ in self.marks)) if name)


@dataclass(frozen=True, eq=False)
class Picture:
    """Images side by side, each with its caption: uint8 (H, W) or (H, W, 3). What no table can show."""

    name: str
    title: str
    images: tuple[NDArray[np.uint8], ...]
    captions: tuple[str, ...]
    columns: int = 6


@dataclass(frozen=True)
class Measured:
    """What `measure` gives: the rows, pictures, notes for the protocol's JSON, and remarks that the page says too."""

    rows: Sequence[Row]
    pictures: tuple[Picture, ...] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    remarks: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """A sweep of one physical quantity.

    Parameters
    ----------
    name, question : what it is called, and what it asks, in a sentence.
    columns : of its table, besides "scene" and "seed", which every table has.
    measure : Setup -> Measured.
    conclude : Table -> findings; called with the whole table, and with each seed's rows alone.
    figures : drawn of the CSV.
    defaults : the Setup it is run on unless told otherwise.
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
            for name in figure.columns:
                if name not in known:
                    raise InputError(f"the figure {figure.name!r}: {unknown('column', name, known)}")

    @property
    def all_columns(self) -> tuple[Column, ...]:
        """The table's columns, "scene" and "seed" first."""
        return (Column("scene", "", "scene"), Column("seed", "", "seed"), *self.columns)


@dataclass(frozen=True, eq=False)
class Stands:
    """A finding of all rows, and for how many of the seeds it holds when each is looked at alone."""

    finding: Finding
    seeds: int
    of: int


@dataclass(frozen=True, eq=False)
class Result:
    """A study that was run: its table, what was found, and everything a page or a protocol says of it."""

    study: Study
    setup: Setup
    table: Table
    findings: tuple[Stands, ...]
    pictures: tuple[Picture, ...]
    protocol: Mapping[str, Any]
    remarks: Mapping[str, str] = field(default_factory=dict)


def sweep(setup: Setup, *values: Sequence[Value]) -> Iterator[tuple[Any, ...]]:
    """Every (scene, *values) of a grid, scene by scene, telling the progress before each."""
    grid: list[tuple[Any, ...]] = [(scene,) for scene in setup.scenes]
    for axis in values:
        grid = [(*place, value) for place in grid for value in axis]
    for done, place in enumerate(grid):
        setup.progress(done / len(grid), " ".join(str(value) for value in place))
        yield place
