"""Axes of study figures: labels with units, ticks, panel titles, marks."""

import math
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from twinlens.studies import Figure, Table

_TICK_DISTANCE = 0.065
"""Minimum distance of two ticks, relative to the axis."""
_MARK = "#444444"


def label_axes(axes: Any, figure: Figure, rows: Table, name: Any) -> None:
    """Set labels, scales, grid and marks of one panel; rows: its data, name: its value of `figure.panel`."""
    _name_axes(axes, figure, rows, name)
    if figure.kind == "heatmap":
        return
    if figure.log_x and _any_positive(rows, figure.x):
        axes.set_xscale("log")
        _ticks_at(axes.xaxis, rows.numbers(figure.x))
    if figure.log_y and _any_positive(rows, figure.y, *figure.also):
        axes.set_yscale("log")
        _plain_log(axes)
    else:
        _from_zero(axes, rows.numbers(figure.y))
    axes.grid(True, color="#DDDDDD", linewidth=0.6)
    axes.set_axisbelow(True)
    for column, text in figure.marks:
        _mark(axes, rows.numbers(column), text, at_top=figure.best == "least")


def label_empty(axes: Any, figure: Figure, rows: Table, name: Any) -> None:
    """Label a panel without measured values: text instead of scales."""
    _name_axes(axes, figure, rows, name)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.text(0.5, 0.5, "nothing measured", transform=axes.transAxes, ha="center", va="center", color=_MARK)


def _name_axes(axes: Any, figure: Figure, rows: Table, name: Any) -> None:
    axes.set_xlabel(figure.x_of.get(name, rows.column(figure.x).label))
    axes.set_ylabel(rows.column(figure.y).label)
    if figure.panel:
        axes.set_title(_panel_title(rows, figure.panel, name))


def _panel_title(rows: Table, panel: str, name: Any) -> str:
    column = rows.column(panel)
    return name if isinstance(name, str) else f"{column.text} {name:.4g} {column.unit}".strip()


def _any_positive(rows: Table, *columns: str) -> bool:
    """Whether a logarithmic axis can show any of the values."""
    values = np.concatenate([rows.numbers(column) for column in columns])
    return bool((np.isfinite(values) & (values > 0)).any())


def _from_zero(axes: Any, values: NDArray[np.float64]) -> None:
    """Start the axis at 0 if no value is negative."""
    known = values[np.isfinite(values)]
    if known.size and known.min() >= 0:
        axes.set_ylim(bottom=0)


def _ticks_at(axis: Any, values: NDArray[np.float64]) -> None:
    """Ticks at the values themselves, as decimal numbers, without those too close to the previous tick."""
    places = np.unique(values[np.isfinite(values) & (values > 0)])
    distance = _TICK_DISTANCE * math.log(places[-1] / places[0])
    ticks: list[float] = []
    for place in places:
        if not ticks or math.log(place / ticks[-1]) >= distance:
            ticks.append(float(place))
    axis.set_ticks(ticks, [f"{tick:.3g}" for tick in ticks])
    axis.set_ticks([], minor=True)


def _plain_log(axes: Any) -> None:
    """Decimal ticks: 1, 2, 5, 10, ... for up to 2.5 decades, else whole decades."""
    low, high = axes.get_ylim()
    few = math.log10(high / low) < 2.5
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=20))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _mark(axes: Any, places: NDArray[np.float64], text: str, at_top: bool) -> None:
    """A labelled vertical line at the mean of the places (the geometric mean on a logarithmic axis)."""
    places = places[np.isfinite(places)]
    if not places.size:
        return
    place = float(np.exp(np.log(places).mean()) if axes.get_xscale() == "log" else places.mean())
    axes.axvline(place, color=_MARK, linestyle=":", linewidth=1.2)
    height, side = (0.98, "top") if at_top else (0.02, "bottom")
    axes.annotate(
        text, (place, height), xycoords=axes.get_xaxis_transform(), xytext=(-2, 0), textcoords="offset points",
        rotation=90, fontsize=7.5, va=side, ha="right", color=_MARK,
    )  # fmt: skip
