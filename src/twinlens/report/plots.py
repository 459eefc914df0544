"""Figures of studies, of agreement, and of a dataset's pairs, in colours readable with colour vision deficiencies.

They depend on their data only and use no global matplotlib state: the same data gives the same bytes.
"""

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure as Sheet
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from twinlens.errors import InputError, check_known
from twinlens.scoring.agreement import Agreement
from twinlens.scoring.pair_statistics import STATISTICS
from twinlens.studies import Figure, Table, mean_of

THEORY = "theory"  # the value of `by` that marks a prediction
PALETTE = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
    "#7A5195",
    "#8C6D31",
    "#4D4D4D",
    "#882255",
)
"""The colours of Okabe and Ito (Color Universal Design, 2008) without yellow, and four more."""
_MARKERS = "osD^vP>X<*"
RC_PARAMS = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "svg.hashsalt": "twinlens",
    "svg.fonttype": "path",
}
_GREY = "#444444"
DPI = 150
_PANEL_INCHES = ((6.4, 3.8), (4.9, 3.4), (3.6, 3.1))
"""Width and height of a panel, with one, two or three in a row."""
_LEGEND_INCHES = 0.9
_STRIP = 0.35  # height of the residuals, relative to their panel
_LEGEND_COLUMNS, _PAIR_COLUMNS = 6, 3
_MOST_BANDS = 6  # with more lines bands would overlap: intervals are drawn as bars
_PREDICTED: dict[str, Any] = {"color": _GREY, "linestyle": "--", "linewidth": 1.2}
_RING: dict[str, Any] = {
    "marker": "o",
    "markersize": 10,
    "fillstyle": "none",
    "markeredgewidth": 1.4,
}
_PLAIN: dict[str, Any] = {"color": PALETTE[0], "marker": "o"}
_TICK_DISTANCE = 0.065  # of two ticks at least, relative to the axis
_CHARACTER = 0.024  # width of a character of a tick's label, relative to the axis of the narrowest panel


def draw(figure: Figure, table: Table) -> Sheet:
    """The figure as a matplotlib object. Raises InputError for an unknown column, or without rows to draw."""
    rows = table.where(**figure.where)
    if not len(rows):
        raise InputError(
            f"figure {figure.name!r}: the table has no rows with {dict(figure.where)}"
        )
    check_known("kind of figure", figure.kind, _Panel.KINDS)
    with matplotlib.rc_context(RC_PARAMS):
        return _sheet(figure, list(_groups(rows, figure.panel)))


def encode(sheet: Sheet, kind: str) -> bytes:
    """The figure as `kind` "png" or "svg", without a date."""
    data = io.BytesIO()
    dpi: Any = DPI
    metadata: dict[str, Any] = {"Software": "twinlens"}
    if kind == "svg":
        dpi, metadata = "figure", {"Date": None, "Creator": "twinlens"}
    with matplotlib.rc_context(RC_PARAMS):
        sheet.savefig(data, format=kind, dpi=dpi, metadata=metadata)
    return data.getvalue()


def _sheet(figure: Figure, panels: Sequence[tuple[Any, Table]]) -> Sheet:
    """All panels in rows of one, two or three, each with a strip of residuals below it if the figure has some."""
    columns = 2 if len(panels) in (2, 4) else min(len(panels), 3)
    lines = math.ceil(len(panels) / columns)
    width, height = _PANEL_INCHES[columns - 1]
    strip = _STRIP if figure.residual_of else 0.0
    size = columns * width, lines * height * (1 + strip) + _LEGEND_INCHES
    sheet = Sheet(figsize=size, layout="constrained")
    heights = (1.0, strip) * lines if strip else (1.0,) * lines
    grid = sheet.add_gridspec(len(heights), columns, height_ratios=heights)
    styles = _line_styles(figure, panels)
    for number, (name, rows) in enumerate(panels):
        line, column = divmod(number, columns)
        axes = sheet.add_subplot(grid[line * (2 if strip else 1), column])
        panel = _Panel(axes, figure, rows, name, styles)
        if panel.draw() and strip:
            axes.tick_params(labelbottom=False)
            axes.set_xlabel("")
            below = sheet.add_subplot(grid[2 * line + 1, column], sharex=axes)
            panel.draw_residuals(below)
    sheet.suptitle(figure.title, fontsize=11.5, fontweight="bold", x=0.012, ha="left")
    _draw_legend(sheet, figure, panels[0][1])
    return sheet


def _draw_legend(sheet: Sheet, figure: Figure, rows: Table) -> None:
    """One legend below all panels."""
    handles: dict[str, Any] = {}
    for axes in sheet.axes:
        drawn, texts = axes.get_legend_handles_labels()
        handles |= dict(zip(texts, drawn, strict=True))
    for name in figure.also:
        handles[rows.column(name).text] = Line2D([], [], **_PREDICTED)
    if figure.best:
        ring = Line2D([], [], color=_GREY, linestyle="", **_RING)
        handles[f"the {figure.best}"] = ring
    if handles:
        sheet.legend(
            handles.values(),
            handles.keys(),
            loc="outside lower center",
            frameon=False,
            ncols=min(len(handles), _LEGEND_COLUMNS),
        )


def _line_styles(
    figure: Figure, panels: Sequence[tuple[Any, Table]]
) -> Mapping[Any, Mapping[str, Any]]:
    """Colour and marker of each line, the same in every panel."""
    if not figure.by:
        return {}
    names: dict[Any, None] = {}
    for _, rows in panels:
        names |= dict.fromkeys(rows.values(figure.by))
    names.pop(THEORY, None)
    styles: dict[Any, Mapping[str, Any]] = {
        THEORY: {"color": "black", "marker": "", "linestyle": "--"}
    }
    for number, name in enumerate(names):
        styles[name] = {
            "color": PALETTE[number % len(PALETTE)],
            "marker": _MARKERS[number % len(_MARKERS)],
            "linestyle": ("-", "--", ":")[number // len(PALETTE) % 3],
        }
    return styles


def agreement_figure(
    agreement: Agreement, names: tuple[str, str], kind: str = "png"
) -> bytes:
    """One line per method, from its mean rank on the first board to that on the second, as PNG or SVG; rank 1 on top.

    names: what to call the boards. The methods that move most are coloured.
    """
    methods = len(agreement.moves)
    with matplotlib.rc_context(RC_PARAMS):
        sheet = Sheet(figsize=(6.4, 0.22 * methods + 1.6), layout="constrained")
        axes = sheet.subplots()
        _draw_moves(axes, agreement)
        ranks_a = [(move.rank_a, move.method) for move in agreement.moves]
        ranks_b = [(move.rank_b, move.method) for move in agreement.moves]
        # Labels in equal steps, so that methods of nearly the same rank stay legible.
        for place, (rank, method) in enumerate(sorted(ranks_a), start=1):
            _label(axes, f"{method}  {rank:.1f}", (0, rank), (-0.16, place), "right")
        for place, (rank, method) in enumerate(sorted(ranks_b), start=1):
            _label(axes, f"{rank:.1f}  {method}", (1, rank), (1.16, place), "left")
        axes.set(
            xlim=(-1.1, 2.1),
            ylim=(methods + 0.7, 0.3),
            xticks=(0, 1),
            xticklabels=names,
            yticks=[],
        )
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        title = f"mean rank by {agreement.metric}, {agreement.region}; Kendall's tau-b {agreement.tau}"
        axes.set_title(title, fontsize=9, pad=12)
        return encode(sheet, kind)


def _draw_moves(axes: Any, agreement: Agreement) -> None:
    """A line for each method; the three that move most are coloured."""
    colours = {
        move.method: colour
        for move, colour in zip(agreement.moves, PALETTE[:3], strict=False)
    }
    for move in agreement.moves:
        axes.plot(
            (0, 1),
            (move.rank_a, move.rank_b),
            "o-",
            color=colours.get(move.method, "#9AA5B1"),
            markersize=3,
            zorder=3 if move.method in colours else 2,
        )


def _label(
    axes: Any,
    text: str,
    point: tuple[float, float],
    place: tuple[float, float],
    align: str,
) -> None:
    """A text at `place` with a thin line to its point."""
    axes.annotate(
        text,
        point,
        place,
        ha=align,
        va="center",
        fontsize=8,
        arrowprops={"arrowstyle": "-", "color": "#C9D1D9", "linewidth": 0.6},
    )


def pair_figure(rows: Sequence[Mapping[str, float]], kind: str = "png") -> bytes:
    """One axis per statistic, as PNG or SVG: real pairs as a bar from 10 % to 90 % with their median; a dot per row."""
    names = [
        name for name in STATISTICS if any(not math.isnan(row[name]) for row in rows)
    ]
    lines = math.ceil(len(names) / _PAIR_COLUMNS)
    with matplotlib.rc_context(RC_PARAMS):
        sheet = Sheet(figsize=(9.0, 0.85 * lines + 0.5), layout="constrained")
        panels = sheet.subplots(lines, _PAIR_COLUMNS, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=False):
            _draw_statistic(axes, name, [row[name] for row in rows])
        for axes in panels[len(names) :]:
            axes.set_axis_off()
        title = "Dots: pairs. Bars: 10 % to 90 % of 24 real pairs, line: their median."
        sheet.suptitle(title, fontsize=9)
        return encode(sheet, kind)


def _draw_statistic(axes: Any, name: str, values: Sequence[float]) -> None:
    statistic = STATISTICS[name]
    median, low, high = statistic.real
    if not math.isnan(low):
        bar = {"color": "#C9D1D9", "linewidth": 9, "solid_capstyle": "butt"}
        axes.plot((low, high), (0, 0), **bar)
    axes.plot(median, 0, "|", color="#444444", markersize=14, markeredgewidth=2)
    dots = {"color": PALETTE[0], "alpha": 0.6, "markersize": 4}
    axes.plot(values, [0] * len(values), "o", **dots)
    title = f"{name} {statistic.unit}".strip()
    axes.set_title(title, fontsize=8, fontweight="normal", loc="left", pad=2)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.tick_params(labelsize=7)
    axes.margins(x=0.08)


@dataclass(frozen=True)
class _Panel:
    """One panel: `rows` are its data, `name` is its value of `figure.panel`."""

    KINDS = ("line", "scatter", "heatmap")

    axes: Any
    figure: Figure
    rows: Table
    name: Any
    styles: Mapping[Any, Mapping[str, Any]]

    def draw(self) -> bool:
        """Draw and label the values; without any, a text instead of scales, and False."""
        axes, figure, rows = self.axes, self.figure, self.rows
        label = figure.x_of.get(self.name, rows.column(figure.x).label)
        axes.set(xlabel=label, ylabel=rows.column(figure.y).label)
        if figure.panel:
            axes.set_title(self._title())
        if not np.isfinite(rows.numbers(figure.z or figure.y)).any():
            axes.set(xticks=[], yticks=[])
            centre = {"ha": "center", "va": "center", "transform": axes.transAxes}
            axes.text(0.5, 0.5, "nothing measured", color=_GREY, **centre)
            return False
        if figure.kind == "heatmap":
            self._draw_heatmap()
            return True
        draw_group = self._draw_line if figure.kind == "line" else self._draw_points
        for name, part in _groups(rows, figure.by):
            draw_group(name, part, self.styles.get(name, _PLAIN))
        self._scale_axes()
        return True

    def _title(self) -> str:
        if isinstance(self.name, str):
            return self.name
        column = self.rows.column(self.figure.panel)
        return f"{column.text} {self.name:.4g} {column.unit}".strip()

    def _draw_line(self, name: Any, part: Table, style: Mapping[str, Any]) -> None:
        axes, figure = self.axes, self.figure
        places = sorted({float(x) for x in part.numbers(figure.x)})
        cells = [part.where(**{figure.x: x}) for x in places]
        means = [mean_of(cell, figure.y) for cell in cells]
        values = np.array([mean.value for mean in means])
        axes.plot(
            places,
            values,
            label=_text(name) or None,
            markersize=4,
            linewidth=1.6,
            **style,
        )
        for column in figure.also:
            dashed = {"linestyle": "--", "linewidth": 1.2, "color": style["color"]}
            axes.plot(places, [mean_of(cell, column).value for cell in cells], **dashed)
        if name != THEORY and all(math.isfinite(mean.low) for mean in means):
            ends = places, [mean.low for mean in means], [mean.high for mean in means]
            if len(self.styles) > _MOST_BANDS:
                axes.vlines(*ends, color=style["color"], alpha=0.4, linewidth=1.0)
            else:
                axes.fill_between(*ends, color=style["color"], alpha=0.12, linewidth=0)
        if figure.best and np.isfinite(values).any():
            best = np.nanargmin if figure.best == "least" else np.nanargmax
            ringed = int(best(values))
            axes.plot(places[ringed], values[ringed], color=style["color"], **_RING)

    def _draw_points(self, name: Any, part: Table, style: Mapping[str, Any]) -> None:
        x, y = part.numbers(self.figure.x), part.numbers(self.figure.y)
        order = np.argsort(x, kind="stable")
        if name == THEORY:
            self.axes.plot(x[order], y[order], label=THEORY, **style)
            return
        points = {**style, "linestyle": "", "markersize": 4.5, "alpha": 0.75}
        default = "measured" if self.figure.also else None
        self.axes.plot(x, y, label=_text(name) or default, **points)
        for column in self.figure.also:
            predicted = {**_PREDICTED, "color": style["color"]} if name else _PREDICTED
            self.axes.plot(x[order], part.numbers(column)[order], **predicted)

    def _draw_heatmap(self) -> None:
        axes, figure, rows = self.axes, self.figure, self.rows
        across = np.unique(rows.numbers(figure.x))
        down = np.unique(rows.numbers(figure.y))
        means = np.full((down.size, across.size), np.nan)
        for (x, y), part in rows.groups(figure.x, figure.y):
            line = np.searchsorted(down, float(y))
            column = np.searchsorted(across, float(x))
            means[line, column] = mean_of(part, figure.z).value
        image = axes.imshow(means, origin="lower", aspect="auto", cmap="cividis")
        axes.set_xticks(range(across.size), [f"{x:.3g}" for x in across])
        axes.set_yticks(range(down.size), [f"{y:.3g}" for y in down])
        middle = float(np.nanmean([np.nanmin(means), np.nanmax(means)]))
        for i, j in np.argwhere(np.isfinite(means)):
            axes.text(j, i, f"{means[i, j]:.3g}", ha="center", va="center", fontsize=8,
                      color="white" if means[i, j] < middle else "black")  # fmt: skip
        axes.figure.colorbar(image, ax=axes, label=rows.column(figure.z).label)

    def draw_residuals(self, axes: Any) -> None:
        """measured / predicted - 1, in percent."""
        figure = self.figure
        for name, part in _groups(self.rows, figure.by):
            if name == THEORY:
                continue
            share = part.numbers(figure.y) / part.numbers(figure.residual_of) - 1
            points = {
                **self.styles.get(name, _PLAIN),
                "linestyle": "",
                "markersize": 3,
                "alpha": 0.7,
            }
            axes.plot(part.numbers(figure.x), 100 * share, **points)
        axes.axhline(0, color="black", linewidth=0.8)
        axes.set(xlabel=self.rows.column(figure.x).label, ylabel="residual (%)")
        axes.grid(True, color="#DDDDDD", linewidth=0.6)

    def _scale_axes(self) -> None:
        axes, figure, rows = self.axes, self.figure, self.rows
        x, y = rows.numbers(figure.x), rows.numbers(figure.y)
        if figure.log_x and _positive(x).size:
            ticks = _separate_ticks(np.unique(_positive(x)).tolist())
            axes.set_xscale("log")
            axes.set_xticks(ticks, [_tick_label(tick) for tick in ticks])
            axes.set_xticks([], minor=True)
        drawn = (figure.y, *figure.also)
        if figure.log_y and any(_positive(rows.numbers(name)).size for name in drawn):
            self._scale_y_logarithmically()
        elif y[np.isfinite(y)].min(initial=0.0) >= 0:
            axes.set_ylim(bottom=0)
        axes.grid(True, color="#DDDDDD", linewidth=0.6)
        axes.set_axisbelow(True)
        for column, text in figure.marks:
            self._draw_mark(column, text)

    def _scale_y_logarithmically(self) -> None:
        """Ticks at 1, 2, 5, 10, ... for up to 2.5 decades, otherwise at whole decades."""
        axes = self.axes
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        steps = (1.0, 2.0, 5.0) if math.log10(high / low) < 2.5 else (1.0,)
        axes.yaxis.set_major_locator(LogLocator(subs=steps, numticks=20))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())

    def _draw_mark(self, column: str, text: str) -> None:
        """A labelled vertical line at the mean of a column, at the end of the axis that the curves leave free."""
        axes = self.axes
        values = self.rows.numbers(column)
        values = values[np.isfinite(values)]
        if not values.size:
            return
        place = float(values.mean())
        if axes.get_xscale() == "log":
            place = float(np.exp(np.log(values).mean()))
        height, side = (0.02, "bottom")
        if self.figure.best == "least":
            height, side = (0.98, "top")
        axes.axvline(place, color=_GREY, linestyle=":", linewidth=1.2)
        axes.annotate(
            text,
            (place, height),
            xytext=(-2, 0),
            xycoords=axes.get_xaxis_transform(),
            textcoords="offset points",
            ha="right",
            va=side,
            rotation=90,
            fontsize=7.5,
            color=_GREY,
        )


def _tick_label(value: float) -> str:
    return f"{value:.3g}"


def _separate_ticks(places: Sequence[float]) -> list[float]:
    """The places on a logarithmic axis, increasing, without those too close to the previous tick or to its label."""
    whole = math.log(places[-1] / places[0])
    ticks: list[float] = []
    for place in places:
        if ticks:
            characters = len(_tick_label(ticks[-1]) + _tick_label(place)) / 2
            least = max(_TICK_DISTANCE, _CHARACTER * (characters + 0.5))
            if math.log(place / ticks[-1]) < least * whole:
                continue
        ticks.append(place)
    return ticks


def _groups(rows: Table, column: str) -> Iterator[tuple[Any, Table]]:
    """The rows by their value of the column; without a column, all rows under ""."""
    if not column:
        yield "", rows
        return
    for (value,), part in rows.groups(column):
        yield value, part


def _positive(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The values that a logarithmic axis can show."""
    return values[np.isfinite(values) & (values > 0)]


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
