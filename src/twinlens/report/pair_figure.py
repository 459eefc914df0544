"""The figure of `pair_statistics`: each pair of a dataset beside the range of real pairs."""

import math
from collections.abc import Mapping, Sequence

import matplotlib
from matplotlib.figure import Figure

from twinlens.report.plots import PALETTE, RC_PARAMS, encode
from twinlens.scoring.pair_statistics import STATISTICS

_COLUMNS = 3


def pair_figure(rows: Sequence[Mapping[str, float]], kind: str = "png") -> bytes:
    """One axis a statistic, as PNG or SVG: real pairs as a bar from 10 % to 90 % with their median, a dot for a row."""
    names = [name for name in STATISTICS if any(not math.isnan(row[name]) for row in rows)]
    lines = -(-len(names) // _COLUMNS)
    with matplotlib.rc_context(RC_PARAMS):
        sheet = Figure(figsize=(9.0, 0.85 * lines + 0.5), layout="constrained")
        panels = sheet.subplots(lines, _COLUMNS, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=False):
            median, low, high = STATISTICS[name].real
            if not math.isnan(low):
                axes.plot((low, high), (0, 0), color="#C9D1D9", linewidth=9, solid_capstyle="butt")
            axes.plot(median, 0, "|", color="#444444", markersize=14, markeredgewidth=2)
            values = [row[name] for row in rows]
            axes.plot(values, [0] * len(values), "o", color=PALETTE[0], alpha=0.6, markersize=4)
            axes.set_title(
                f"{name} {STATISTICS[name].unit}".strip(), fontsize=8, fontweight="normal", loc="left", pad=2
            )
            axes.set_yticks([])
            axes.spines["left"].set_visible(False)
            axes.tick_params(labelsize=7)
            axes.margins(x=0.08)
        for axes in panels[len(names) :]:
            axes.set_axis_off()
        sheet.suptitle("Dots: pairs. Bars: 10 % to 90 % of 24 real pairs, line: their median.", fontsize=9)
        return encode(sheet, kind)
