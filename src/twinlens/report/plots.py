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
_PANEL_INCHES = (
    (6.4, 3.8),
    (4.9, 3.4),
    (3.6, 3.1),
)  # width and height, with one, two or three in a row
_STRIP, _LEGEND_COLUMNS, _PAIR_COLUMNS = 0.35, 6, 3
_MOST_BANDS = (
    6  # intervals of more lines are drawn as bars, because bands would overlap
)
_PREDICTED: dict[str, Any] = {"color": _GREY, "linestyle": "--", "linewidth": 1.2}
_RING: dict[str, Any] = {
    "marker": "o",
    "markersize": 10,
    "fillstyle": "none",
    "markeredgewidth": 1.4,
}
_PLAIN: dict[str, Any] = {"color": PALETTE[0], "marker": "o"}
_TICK_DISTANCE = 0.065  # of two ticks at least, relative to the axis


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
    metadata = (
        {"Date": None, "Creator": "twinlens"}
        if kind == "svg"
        else {"Software": "twinlens"}
    )
    with matplotlib.rc_context(RC_PARAMS):
        sheet.savefig(
            data, format=kind, dpi="figure" if kind == "svg" else DPI, metadata=metadata
        )
    return data.getvalue()


def _sheet(figure: Figure, panels: Sequence[tuple[Any, Table]]) -> Sheet:
    columns = 2 if len(panels) in (2, 4) else min(len(panels), 3)
    lines = math.ceil(len(panels) / columns)
    width, height = _PANEL_INCHES[columns - 1]
    strip = _STRIP if figure.residual_of else 0.0
    sheet = Sheet(
        figsize=(columns * width, lines * height * (1 + strip) + 0.9),
        layout="constrained",
    )
    heights = [
        ratio for _ in range(lines) for ratio in ((1.0, strip) if strip else (1.0,))
    ]
    grid = sheet.add_gridspec(len(heights), columns, height_ratios=heights)
    styles = _line_styles(figure, panels)
    for k, (name, rows) in enumerate(panels):
        line, column = divmod(k, columns)
        axes = sheet.add_subplot(grid[line * (2 if strip else 1), column])
        panel = _Panel(axes, figure, rows, name, styles)
        if panel.draw() and strip:
            axes.tick_params(labelbottom=False)
            axes.set_xlabel("")
            panel.draw_residuals(
                sheet.add_subplot(grid[2 * line + 1, column], sharex=axes)
            )
    sheet.suptitle(figure.title, fontsize=11.5, fontweight="bold", x=0.012, ha="left")
    handles = {
        text: handle
        for axes in sheet.axes
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    handles |= {
        panels[0][1].column(name).text: Line2D([], [], **_PREDICTED)
        for name in figure.also
    }
    if figure.best:
        handles[f"the {figure.best}"] = Line2D(
            [], [], color=_GREY, linestyle="", **_RING
        )
    if handles:
        sheet.legend(
            handles.values(), handles.keys(), loc="outside lower center", frameon=False,
            ncols=min(len(handles), _LEGEND_COLUMNS),
        )  # fmt: skip
    return sheet


def _line_styles(
    figure: Figure, panels: Sequence[tuple[Any, Table]]
) -> Mapping[Any, Mapping[str, Any]]:
    """Colour and marker of each line, the same in every panel."""
    if not figure.by:
        return {}
    names = dict.fromkeys(
        value
        for _, rows in panels
        for value in rows.values(figure.by)
        if value != THEORY
    )
    styles = {
        name: {"color": PALETTE[k % len(PALETTE)], "marker": _MARKERS[k % len(_MARKERS)],
               "linestyle": ("-", "--", ":")[k // len(PALETTE) % 3]}
        for k, name in enumerate(names)
    }  # fmt: skip
    return styles | {THEORY: {"color": "black", "marker": "", "linestyle": "--"}}


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
        largest = [m.method for m in agreement.moves[: min(3, methods)]]
        for move in agreement.moves:
            marked = move.method in largest
            colour = PALETTE[largest.index(move.method)] if marked else "#9AA5B1"
            axes.plot(
                (0, 1),
                (move.rank_a, move.rank_b),
                "o-",
                color=colour,
                markersize=3,
                zorder=2 + marked,
            )
        for side, align in ((0, "right"), (1, "left")):
            ranked = sorted(
                (m.rank_b if side else m.rank_a, m.method) for m in agreement.moves
            )
            # Labels in equal steps, so that methods of nearly the same rank stay legible.
            for place, (rank, method) in enumerate(ranked, start=1):
                axes.annotate(
                    f"{rank:.1f}  {method}" if side else f"{method}  {rank:.1f}", (side, rank),
                    (1.16 if side else -0.16, place), ha=align, va="center", fontsize=8,
                    arrowprops={"arrowstyle": "-", "color": "#C9D1D9", "linewidth": 0.6},
                )  # fmt: skip
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


def pair_figure(rows: Sequence[Mapping[str, float]], kind: str = "png") -> bytes:
    """One axis per statistic, as PNG or SVG: real pairs as a bar from 10 % to 90 % with their median; a dot per row."""
    names = [
        name for name in STATISTICS if any(not math.isnan(row[name]) for row in rows)
    ]
    lines = -(-len(names) // _PAIR_COLUMNS)
    with matplotlib.rc_context(RC_PARAMS):
        sheet = Sheet(figsize=(9.0, 0.85 * lines + 0.5), layout="constrained")
        panels = sheet.subplots(lines, _PAIR_COLUMNS, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=False):
            median, low, high = STATISTICS[name].real
            if not math.isnan(low):
                axes.plot(
                    (low, high),
                    (0, 0),
                    color="#C9D1D9",
                    linewidth=9,
                    solid_capstyle="butt",
                )
            axes.plot(median, 0, "|", color="#444444", markersize=14, markeredgewidth=2)
            values = [row[name] for row in rows]
            axes.plot(
                values,
                [0] * len(values),
                "o",
                color=PALETTE[0],
                alpha=0.6,
                markersize=4,
            )
            title = f"{name} {STATISTICS[name].unit}".strip()
            axes.set_title(title, fontsize=8, fontweight="normal", loc="left", pad=2)
            axes.set_yticks([])
            axes.spines["left"].set_visible(False)
            axes.tick_params(labelsize=7)
            axes.margins(x=0.08)
        for axes in panels[len(names) :]:
            axes.set_axis_off()
        sheet.suptitle(
            "Dots: pairs. Bars: 10 % to 90 % of 24 real pairs, line: their median.",
            fontsize=9,
        )
        return encode(sheet, kind)


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
        axes.set(
            xlabel=figure.x_of.get(self.name, rows.column(figure.x).label),
            ylabel=rows.column(figure.y).label,
        )
        if figure.panel:
            column = rows.column(figure.panel)
            is_text = isinstance(self.name, str)
            axes.set_title(
                self.name
                if is_text
                else f"{column.text} {self.name:.4g} {column.unit}".strip()
            )
        if not np.isfinite(rows.numbers(figure.z or figure.y)).any():
            axes.set(xticks=[], yticks=[])
            axes.text(
                0.5,
                0.5,
                "nothing measured",
                transform=axes.transAxes,
                ha="center",
                va="center",
                color=_GREY,
            )
            return False
        if figure.kind == "heatmap":
            self._draw_heatmap()
            return True
        draw_group = self._draw_line if figure.kind == "line" else self._draw_points
        for name, part in _groups(rows, figure.by):
            draw_group(name, part, self.styles.get(name, _PLAIN))
        self._scale_axes()
        return True

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
            other = [mean_of(cell, column).value for cell in cells]
            axes.plot(
                places, other, linestyle="--", linewidth=1.2, color=style["color"]
            )
        if name != THEORY and all(math.isfinite(mean.low) for mean in means):
            ends = places, [mean.low for mean in means], [mean.high for mean in means]
            if len(self.styles) > _MOST_BANDS:
                axes.vlines(*ends, color=style["color"], alpha=0.4, linewidth=1.0)
            else:
                axes.fill_between(*ends, color=style["color"], alpha=0.12, linewidth=0)
        if figure.best and np.isfinite(values).any():
            k = int(
                np.nanargmin(values) if figure.best == "least" else np.nanargmax(values)
            )
            axes.plot(places[k], values[k], color=style["color"], **_RING)

    def _draw_points(self, name: Any, part: Table, style: Mapping[str, Any]) -> None:
        x, y = part.numbers(self.figure.x), part.numbers(self.figure.y)
        order = np.argsort(x, kind="stable")
        if name == THEORY:
            self.axes.plot(x[order], y[order], label=THEORY, **style)
            return
        points = {**style, "linestyle": "", "markersize": 4.5, "alpha": 0.75}
        self.axes.plot(
            x,
            y,
            label=_text(name) or ("measured" if self.figure.also else None),
            **points,
        )
        for column in self.figure.also:
            predicted = {**_PREDICTED, "color": style["color"]} if name else _PREDICTED
            self.axes.plot(x[order], part.numbers(column)[order], **predicted)

    def _draw_heatmap(self) -> None:
        axes, figure, rows = self.axes, self.figure, self.rows
        across, down = (
            np.unique(rows.numbers(figure.x)),
            np.unique(rows.numbers(figure.y)),
        )
        means = np.full((down.size, across.size), np.nan)
        for (x, y), part in rows.groups(figure.x, figure.y):
            means[
                np.searchsorted(down, float(y)), np.searchsorted(across, float(x))
            ] = mean_of(part, figure.z).value
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
        for name, part in _groups(self.rows, self.figure.by):
            if name != THEORY:
                share = (
                    part.numbers(self.figure.y) / part.numbers(self.figure.residual_of)
                    - 1
                )
                points = {
                    **self.styles.get(name, _PLAIN),
                    "linestyle": "",
                    "markersize": 3,
                    "alpha": 0.7,
                }
                axes.plot(part.numbers(self.figure.x), 100 * share, **points)
        axes.axhline(0, color="black", linewidth=0.8)
        axes.set(xlabel=self.rows.column(self.figure.x).label, ylabel="residual (%)")
        axes.grid(True, color="#DDDDDD", linewidth=0.6)

    def _scale_axes(self) -> None:
        axes, figure, rows = self.axes, self.figure, self.rows
        x, y = rows.numbers(figure.x), rows.numbers(figure.y)
        if figure.log_x and _positive(x).size:
            axes.set_xscale("log")
            ticks: list[float] = []
            places = np.unique(_positive(x)).tolist()
            for place in places:  # without those too close to the previous tick
                if not ticks or math.log(
                    place / ticks[-1]
                ) >= _TICK_DISTANCE * math.log(places[-1] / places[0]):
                    ticks.append(place)
            axes.set_xticks(ticks, [f"{tick:.3g}" for tick in ticks])
            axes.set_xticks([], minor=True)
        if figure.log_y and any(
            _positive(rows.numbers(column)).size for column in (figure.y, *figure.also)
        ):
            axes.set_yscale("log")
            low, high = axes.get_ylim()
            few = (
                math.log10(high / low) < 2.5
            )  # 1, 2, 5, 10, ... for up to 2.5 decades, else whole decades
            axes.yaxis.set_major_locator(
                LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=20)
            )
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
        elif y[np.isfinite(y)].min(initial=0.0) >= 0:
            axes.set_ylim(bottom=0)
        axes.grid(True, color="#DDDDDD", linewidth=0.6)
        axes.set_axisbelow(True)
        height, side = (0.98, "top") if figure.best == "least" else (0.02, "bottom")
        for column, text in figure.marks:
            marked = rows.numbers(column)
            marked = marked[np.isfinite(marked)]
            if marked.size:
                place = float(
                    np.exp(np.log(marked).mean())
                    if axes.get_xscale() == "log"
                    else marked.mean()
                )
                axes.axvline(place, color=_GREY, linestyle=":", linewidth=1.2)
                axes.annotate(
                    text, (place, height), xycoords=axes.get_xaxis_transform(), xytext=(-2, 0), va=side, ha="right",
                    textcoords="offset points", rotation=90, fontsize=7.5, color=_GREY,
                )  # fmt: skip


def _groups(rows: Table, column: str) -> Iterator[tuple[Any, Table]]:
    """The rows by their value of the column; without a column, all rows under ""."""
    yield from (
        ((value, part) for (value,), part in rows.groups(column))
        if column
        else [("", rows)]
    )


def _positive(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The values that a logarithmic axis can show."""
    return values[np.isfinite(values) & (values > 0)]


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
