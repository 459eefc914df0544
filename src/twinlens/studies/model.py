"""What a study is: `measure` makes rows from a Setup, `conclude` findings from their Table; Figures draw the Table."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_int, unknown
from twinlens.studies.findings import Finding, SeedSupport
from twinlens.studies.table import Column, Row, Table

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
                text = ", ".join(map(str, values))
                raise InputError(f"{name} of a study must be distinct, got {text}")
        for name, least in (("width", 64), ("height", 48), ("spp", 1)):
            check_int(f"{name} of a study", getattr(self, name), least)


def sweep(setup: Setup, *values: Sequence[Any]) -> Iterator[tuple[Any, ...]]:
    """Every (scene, *values) of a grid, scene by scene, or every (*values) without scenes; reports the progress."""
    axes = [setup.scenes, *values] if setup.scenes else values
    grid = list(itertools.product(*axes))
    for done, point in enumerate(grid):
        setup.progress(done / len(grid), " ".join(map(_label, point)))
        yield point


def _label(value: Any) -> str:
    """A value of a grid as the progress names it; the parts of a tuple one after another."""
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


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
        axes = (self.x, self.y, self.by, self.panel, self.z, self.residual_of)
        marked = (column for column, _ in self.marks)
        names = (*axes, *self.where, *self.also, *marked)
        return tuple(name for name in names if name)


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
    with the rows of each seed alone. defaults: the Setup where nothing else is chosen. law: a paragraph on the physics
    that is tested. docs, lesson: a page of the documentation and a script of the course, from the root of the source.

    Raises InputError if a figure draws a column that the table does not have.
    """

    name: str
    question: str
    columns: tuple[Column, ...]
    measure: Callable[[Setup], Measured]
    conclude: Callable[[Table], Sequence[Finding]]
    figures: tuple[Figure, ...]
    defaults: Setup
    law: str = ""
    docs: str = ""
    lesson: str = ""

    def __post_init__(self) -> None:
        names = [column.name for column in self.all_columns]
        for figure in self.figures:
            for name in sorted(set(figure.columns).difference(names)):
                raise InputError(
                    f"the figure {figure.name!r}: {unknown('column', name, names)}"
                )

    @property
    def all_columns(self) -> tuple[Column, ...]:
        """The table's columns, "scene" and "seed" first."""
        return (Column("scene", "", "scene"), Column("seed", "", "seed"), *self.columns)


@dataclass(frozen=True, eq=False)
class Result:
    """A completed study. seconds: that it took to measure."""

    study: Study
    setup: Setup
    table: Table
    findings: tuple[SeedSupport, ...]
    pictures: tuple[Picture, ...]
    protocol: Mapping[str, Any]
    remarks: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
