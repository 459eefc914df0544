"""Figures of a study's table, as PNG and SVG: legible, labelled with units, safe for colour-blind readers.

They are drawn of the table alone (what the CSV says), with matplotlib's objects and no global state: the same table
gives the same bytes.
"""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Sheet
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from twinlens.errors import InputError, unknown
from twinlens.studies import Figure, Table, mean_of

THEORY = "theory"
"""The value of `by` that is a prediction, not a measurement."""
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7A5195", "#8C6D31", "#4D4D4D", "#A6761D")
"""Okabe and Ito's colours (Color Universal Design, 2008) but for their yellow, and four darker ones."""
_MARKERS = "osD^vP>X<*"
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "svg.hashsalt": "twinlens",
    "svg.fonttype": "path",
}
_PANEL_INCHES = (4.2, 3.1)
_PANELS_A_ROW = 3
_DPI = 150
_MOST_TICKS = 9


def draw(figure: Figure, table: Table) -> Sheet:
    """The figure as matplotlib has it.

    Raises InputError for a column that the table lacks, and where the figure's rows are none.
    """
    rows = table.where(**figure.where)
    if not len(rows):
        raise InputError(f"figure {figure.name!r}: the table has no rows with {dict(figure.where)}")
    if figure.kind not in _KINDS:
        raise unknown("kind of figure", figure.kind, _KINDS)
    panels = [(key[0], part) for key, part in rows.groups(figure.panel)] if figure.panel else [("", rows)]
    with matplotlib.rc_context(_STYLE):
        return _sheet(figure, panels)


def encode(sheet: Sheet, kind: str) -> bytes:
    """The bytes of the figure, `kind` "png" or "svg", with no date in them."""
    data = io.BytesIO()
    with matplotlib.rc_context(_STYLE):
        if kind == "svg":
            FigureCanvasSVG(sheet).print_svg(data, metadata={"Date": None, "Creator": "twinlens"})
        else:
            FigureCanvasAgg(sheet)
            sheet.savefig(data, format="png", dpi=_DPI, metadata={"Software": "twinlens"})
    return data.getvalue()


def _sheet(figure: Figure, panels: Sequence[tuple[Any, Table]]) -> Sheet:
    columns = 2 if len(panels) == 4 else min(len(panels), _PANELS_A_ROW)
    lines = math.ceil(len(panels) / columns)
    strip = 0.35 if figure.residual_of else 0.0
    width, height = _PANEL_INCHES
    legend = 1.5 if figure.by else 0.4
    sheet = Sheet(figsize=(columns * width + legend, lines * height * (1 + strip) + 0.5), layout="constrained")
    heights = [ratio for _ in range(lines) for ratio in ((1.0, strip) if strip else (1.0,))]
    grid = sheet.add_gridspec(len(heights), columns, height_ratios=heights)
    looks = _looks(figure, panels)
    first = None
    for k, (title, rows) in enumerate(panels):
        line, column = divmod(k, columns)
        axes = sheet.add_subplot(grid[line * (2 if strip else 1), column])
        _KINDS[figure.kind](sheet, axes, figure, rows, looks)
        _label(axes, figure, rows, title)
        first = first or axes
        if strip:
            axes.tick_params(labelbottom=False)
            axes.set_xlabel("")
            _residuals(sheet.add_subplot(grid[2 * line + 1, column], sharex=axes), figure, rows, looks)
    sheet.suptitle(figure.title, fontsize=12, fontweight="bold", x=0.01, ha="left")
    handles = {
        text: handle for axes in sheet.axes for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    for name in figure.also:
        handles[panels[0][1].column(name).text] = Line2D([], [], color="#444444", linestyle="--", linewidth=1.2)
    if handles:
        sheet.legend(handles.values(), handles.keys(), loc="outside right center", frameon=False)
    return sheet


def _looks(figure: Figure, panels: Sequence[tuple[Any, Table]]) -> dict[Any, dict[str, Any]]:
    """Colour and marker of each line: the same value looks the same in every panel."""
    if not figure.by:
        return {}
    names = list(dict.fromkeys(value for _, rows in panels for value in rows.values(figure.by)))
    measured = [name for name in names if name != THEORY]
    looks = {
        name: {"color": PALETTE[k % len(PALETTE)], "marker": _MARKERS[k % len(_MARKERS)],
               "linestyle": ("-", "--", ":")[k // len(PALETTE) % 3]}
        for k, name in enumerate(measured)
    }  # fmt: skip
    return looks | {THEORY: {"color": "black", "marker": "", "linestyle": "--"}}


def _label(axes: Any, figure: Figure, rows: Table, name: Any) -> None:
    axes.set_xlabel(rows.column(figure.x).label)
    axes.set_ylabel(rows.column(figure.y).label)
    if figure.panel:
        column = rows.column(figure.panel)
        axes.set_title(f"{column.text} {_text(name)} {column.unit}".strip() if not isinstance(name, str) else name)
    if figure.kind == "heatmap":
        return
    if figure.log_x:
        axes.set_xscale("log")
        _plain_ticks(axes.xaxis, rows.numbers(figure.x))
    if figure.log_y:
        axes.set_yscale("log")
    axes.grid(True, color="#DDDDDD", linewidth=0.6)
    axes.set_axisbelow(True)
    for column_name, text in figure.marks:
        places = rows.numbers(column_name)
        places = places[np.isfinite(places)]
        if places.size:
            axes.axvline(float(places.mean()), color="#444444", linestyle=":", linewidth=1.2)
            axes.annotate(
                text, (float(places.mean()), 0.98), xycoords=axes.get_xaxis_transform(), rotation=90, fontsize=7.5,
                va="top", ha="right", color="#444444",
            )  # fmt: skip


def _plain_ticks(axis: Any, values: NDArray[np.float64]) -> None:
    """Ticks at the values themselves, as 1.4 and not as 10^0, where they are few."""
    ticks = np.unique(values[values > 0])
    if ticks.size > _MOST_TICKS:
        ticks = ticks[:: math.ceil(ticks.size / _MOST_TICKS)]
    axis.set_ticks(ticks, [f"{tick:.3g}" for tick in ticks])
    axis.set_ticks([], minor=True)


def _lines(sheet: Sheet, axes: Any, figure: Figure, rows: Table, looks: Mapping[Any, dict[str, Any]]) -> None:
    for name, part in _by(figure, rows):
        places = sorted({float(x) for x in part.numbers(figure.x)})
        means = [mean_of(part.where(_near(figure.x, x)), figure.y) for x in places]
        look = looks.get(name, {"color": PALETTE[0], "marker": "o"})
        axes.plot(
            places, [mean.value for mean in means], label=_text(name) or None, markersize=4, linewidth=1.6, **look,
        )  # fmt: skip
        for column in figure.also:
            other = [mean_of(part.where(_near(figure.x, x)), column).value for x in places]
            axes.plot(places, other, linestyle="--", linewidth=1.2, color=look["color"])
        if name != THEORY and all(math.isfinite(mean.low) for mean in means):
            low, high = [mean.low for mean in means], [mean.high for mean in means]
            axes.fill_between(places, low, high, color=look["color"], alpha=0.15, linewidth=0)


def _points(sheet: Sheet, axes: Any, figure: Figure, rows: Table, looks: Mapping[Any, dict[str, Any]]) -> None:
    for name, part in _by(figure, rows):
        look = looks.get(name, {"color": PALETTE[0], "marker": "o"})
        x, y = part.numbers(figure.x), part.numbers(figure.y)
        if name == THEORY:
            order = np.argsort(x)
            axes.plot(x[order], y[order], label=THEORY, **look)
        else:
            axes.plot(x, y, label=_text(name) or None, **{**look, "linestyle": "", "markersize": 3.5, "alpha": 0.7})
            order = np.argsort(x)
            for column in figure.also:
                axes.plot(x[order], part.numbers(column)[order], linestyle="--", linewidth=1.2, color=look["color"])


def _heat(sheet: Sheet, axes: Any, figure: Figure, rows: Table, looks: Mapping[Any, dict[str, Any]]) -> None:
    across, down = np.unique(rows.numbers(figure.x)), np.unique(rows.numbers(figure.y))
    means = np.full((down.size, across.size), np.nan)
    for (x, y), part in rows.groups(figure.x, figure.y):
        means[np.searchsorted(down, float(y)), np.searchsorted(across, float(x))] = mean_of(part, figure.z).value
    image = axes.imshow(means, origin="lower", aspect="auto", cmap="cividis")
    axes.set_xticks(range(across.size), [f"{x:.3g}" for x in across])
    axes.set_yticks(range(down.size), [f"{y:.3g}" for y in down])
    middle = float(np.nanmean([np.nanmin(means), np.nanmax(means)]))
    for i, j in np.argwhere(np.isfinite(means)):
        axes.text(j, i, f"{means[i, j]:.3g}", ha="center", va="center", fontsize=7.5,
                  color="white" if means[i, j] < middle else "black")  # fmt: skip
    sheet.colorbar(image, ax=axes, label=rows.column(figure.z).label)


def _residuals(axes: Any, figure: Figure, rows: Table, looks: Mapping[Any, dict[str, Any]]) -> None:
    for name, part in _by(figure, rows):
        if name == THEORY:
            continue
        look = looks.get(name, {"color": PALETTE[0], "marker": "o"})
        share = part.numbers(figure.y) / part.numbers(figure.residual_of) - 1
        axes.plot(part.numbers(figure.x), 100 * share, **{**look, "linestyle": "", "markersize": 3, "alpha": 0.7})
    axes.axhline(0, color="black", linewidth=0.8)
    axes.set_xlabel(rows.column(figure.x).label)
    axes.set_ylabel("residual (%)")
    axes.grid(True, color="#DDDDDD", linewidth=0.6)


def _by(figure: Figure, rows: Table) -> list[tuple[Any, Table]]:
    return [(key[0], part) for key, part in rows.groups(figure.by)] if figure.by else [("", rows)]


def _near(name: str, value: float) -> Any:
    return lambda row: float(row[name]) == value


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"


_KINDS = {"line": _lines, "scatter": _points, "heatmap": _heat}
