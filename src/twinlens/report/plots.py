"""Figures of a study's table, as PNG and SVG, in colours readable with colour vision deficiencies.

They depend on the table only and use no global matplotlib state: the same table gives the same bytes.
"""

import io
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Sheet
from matplotlib.lines import Line2D

from twinlens.errors import InputError, unknown
from twinlens.report.axes import label_axes, label_empty
from twinlens.studies import Figure, Table, mean_of

THEORY = "theory"
"""The value of `by` that marks a prediction."""
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7A5195", "#8C6D31", "#4D4D4D", "#882255")
"""The colours of Okabe and Ito (Color Universal Design, 2008) without yellow, and four more."""
_MARKERS = "osD^vP>X<*"
_RC_PARAMS = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "svg.hashsalt": "twinlens",
    "svg.fonttype": "path",
}
DPI = 150
_PANEL_INCHES = ((6.4, 3.8), (4.9, 3.4), (3.6, 3.1))
"""Width and height of a panel, with one, two or three in a row."""
_STRIP = 0.35
_LEGEND_COLUMNS = 6
_MOST_BANDS = 6
"""Intervals of more lines are drawn as bars, because bands would overlap."""
_PREDICTED: dict[str, Any] = {"color": "#444444", "linestyle": "--", "linewidth": 1.2}
_LineStyles = Mapping[Any, Mapping[str, Any]]


def draw(figure: Figure, table: Table) -> Sheet:
    """The figure as a matplotlib object. Raises InputError for an unknown column, or without rows to draw."""
    rows = table.where(**figure.where)
    if not len(rows):
        raise InputError(f"figure {figure.name!r}: the table has no rows with {dict(figure.where)}")
    if figure.kind not in _KINDS:
        raise unknown("kind of figure", figure.kind, _KINDS)
    panels = [(key[0], part) for key, part in rows.groups(figure.panel)] if figure.panel else [("", rows)]
    with matplotlib.rc_context(_RC_PARAMS):
        return _sheet(figure, panels)


def encode(sheet: Sheet, kind: str) -> bytes:
    """The figure as `kind` "png" or "svg", without a date."""
    data = io.BytesIO()
    with matplotlib.rc_context(_RC_PARAMS):
        if kind == "svg":
            FigureCanvasSVG(sheet).print_svg(data, metadata={"Date": None, "Creator": "twinlens"})
        else:
            FigureCanvasAgg(sheet)
            sheet.savefig(data, format="png", dpi=DPI, metadata={"Software": "twinlens"})
    return data.getvalue()


def _sheet(figure: Figure, panels: Sequence[tuple[Any, Table]]) -> Sheet:
    columns = 2 if len(panels) in (2, 4) else min(len(panels), 3)
    lines = math.ceil(len(panels) / columns)
    width, height = _PANEL_INCHES[columns - 1]
    strip = _STRIP if figure.residual_of else 0.0
    sheet = Sheet(figsize=(columns * width, lines * height * (1 + strip) + 0.9), layout="constrained")
    heights = [ratio for _ in range(lines) for ratio in ((1.0, strip) if strip else (1.0,))]
    grid = sheet.add_gridspec(len(heights), columns, height_ratios=heights)
    styles = _line_styles(figure, panels)
    for k, (title, rows) in enumerate(panels):
        line, column = divmod(k, columns)
        axes = sheet.add_subplot(grid[line * (2 if strip else 1), column])
        if not np.isfinite(rows.numbers(figure.z or figure.y)).any():
            label_empty(axes, figure, rows, title)
            continue
        _KINDS[figure.kind](sheet, axes, figure, rows, styles)
        label_axes(axes, figure, rows, title)
        if strip:
            axes.tick_params(labelbottom=False)
            axes.set_xlabel("")
            _residuals(sheet.add_subplot(grid[2 * line + 1, column], sharex=axes), figure, rows, styles)
    sheet.suptitle(figure.title, fontsize=11.5, fontweight="bold", x=0.012, ha="left")
    _legend(sheet, figure, panels[0][1])
    return sheet


def _legend(sheet: Sheet, figure: Figure, rows: Table) -> None:
    handles = {
        text: handle for axes in sheet.axes for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    for name in figure.also:
        handles[rows.column(name).text] = Line2D([], [], **_PREDICTED)
    if figure.best:
        handles[f"the {figure.best}"] = Line2D([], [], color="#444444", linestyle="", **_RING)
    if handles:
        sheet.legend(
            handles.values(), handles.keys(), loc="outside lower center", frameon=False,
            ncols=min(len(handles), _LEGEND_COLUMNS),
        )  # fmt: skip


def _line_styles(figure: Figure, panels: Sequence[tuple[Any, Table]]) -> _LineStyles:
    """Colour and marker of each line, the same in every panel."""
    if not figure.by:
        return {}
    names = list(dict.fromkeys(value for _, rows in panels for value in rows.values(figure.by)))
    measured = [name for name in names if name != THEORY]
    styles = {
        name: {"color": PALETTE[k % len(PALETTE)], "marker": _MARKERS[k % len(_MARKERS)],
               "linestyle": ("-", "--", ":")[k // len(PALETTE) % 3]}
        for k, name in enumerate(measured)
    }  # fmt: skip
    return styles | {THEORY: {"color": "black", "marker": "", "linestyle": "--"}}


_RING: dict[str, Any] = {"marker": "o", "markersize": 10, "fillstyle": "none", "markeredgewidth": 1.4}
_PLAIN: dict[str, Any] = {"color": PALETTE[0], "marker": "o"}


def _lines(sheet: Sheet, axes: Any, figure: Figure, rows: Table, styles: _LineStyles) -> None:
    for name, part in _by(figure, rows):
        places = sorted({float(x) for x in part.numbers(figure.x)})
        cells = [part.where(_equals(figure.x, x)) for x in places]
        means = [mean_of(cell, figure.y) for cell in cells]
        values = np.array([mean.value for mean in means])
        style = styles.get(name, _PLAIN)
        axes.plot(places, values, label=_text(name) or None, markersize=4, linewidth=1.6, **style)
        for column in figure.also:
            other = [mean_of(cell, column).value for cell in cells]
            axes.plot(places, other, linestyle="--", linewidth=1.2, color=style["color"])
        if name != THEORY and all(math.isfinite(mean.low) for mean in means):
            low, high = [mean.low for mean in means], [mean.high for mean in means]
            if len(styles) > _MOST_BANDS:
                axes.vlines(places, low, high, color=style["color"], alpha=0.4, linewidth=1.0)
            else:
                axes.fill_between(places, low, high, color=style["color"], alpha=0.12, linewidth=0)
        if figure.best and np.isfinite(values).any():
            k = int(np.nanargmin(values) if figure.best == "least" else np.nanargmax(values))
            axes.plot(places[k], values[k], color=style["color"], **_RING)


def _points(sheet: Sheet, axes: Any, figure: Figure, rows: Table, styles: _LineStyles) -> None:
    for name, part in _by(figure, rows):
        style = styles.get(name, _PLAIN)
        x, y = part.numbers(figure.x), part.numbers(figure.y)
        order = np.argsort(x, kind="stable")
        if name == THEORY:
            axes.plot(x[order], y[order], label=THEORY, **style)
            continue
        points = {**style, "linestyle": "", "markersize": 4.5, "alpha": 0.75}
        axes.plot(x, y, label=_text(name) or ("measured" if figure.also else None), **points)
        for column in figure.also:
            predicted = {**_PREDICTED, "color": style["color"]} if name else _PREDICTED
            axes.plot(x[order], part.numbers(column)[order], **predicted)


def _heat(sheet: Sheet, axes: Any, figure: Figure, rows: Table, styles: _LineStyles) -> None:
    across, down = np.unique(rows.numbers(figure.x)), np.unique(rows.numbers(figure.y))
    means = np.full((down.size, across.size), np.nan)
    for (x, y), part in rows.groups(figure.x, figure.y):
        place = np.searchsorted(down, float(y)), np.searchsorted(across, float(x))
        means[place] = mean_of(part, figure.z).value
    image = axes.imshow(means, origin="lower", aspect="auto", cmap="cividis")
    axes.set_xticks(range(across.size), [f"{x:.3g}" for x in across])
    axes.set_yticks(range(down.size), [f"{y:.3g}" for y in down])
    middle = float(np.nanmean([np.nanmin(means), np.nanmax(means)]))
    for i, j in np.argwhere(np.isfinite(means)):
        axes.text(j, i, f"{means[i, j]:.3g}", ha="center", va="center", fontsize=8,
                  color="white" if means[i, j] < middle else "black")  # fmt: skip
    sheet.colorbar(image, ax=axes, label=rows.column(figure.z).label)


def _residuals(axes: Any, figure: Figure, rows: Table, styles: _LineStyles) -> None:
    for name, part in _by(figure, rows):
        if name == THEORY:
            continue
        share = part.numbers(figure.y) / part.numbers(figure.residual_of) - 1
        points = {**styles.get(name, _PLAIN), "linestyle": "", "markersize": 3, "alpha": 0.7}
        axes.plot(part.numbers(figure.x), 100 * share, **points)
    axes.axhline(0, color="black", linewidth=0.8)
    axes.set_xlabel(rows.column(figure.x).label)
    axes.set_ylabel("residual (%)")
    axes.grid(True, color="#DDDDDD", linewidth=0.6)


def _by(figure: Figure, rows: Table) -> list[tuple[Any, Table]]:
    return [(key[0], part) for key, part in rows.groups(figure.by)] if figure.by else [("", rows)]


def _equals(name: str, value: float) -> Callable[[Mapping[str, Any]], bool]:
    return lambda row: float(row[name]) == value


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"


_KINDS = {"line": _lines, "scatter": _points, "heatmap": _heat}
