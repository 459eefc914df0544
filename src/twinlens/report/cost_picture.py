"""A figure of cost curves: for each method the costs of a pixel, and its window beside those of three candidates."""

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure as Sheet
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from twinlens.dataset.pictures import rgb8
from twinlens.matching import CostCurve
from twinlens.report.plots import PALETTE, RC_PARAMS, encode

TRUE, WINNER, RIVAL = "#222222", PALETTE[0], PALETTE[1]
_CONTEXT = 6  # pixels shown around a window
_ROW_HEIGHT, _WIDTH = 1.9, 10.5  # inches: of a method's row, and of the figure


def cost_picture(
    images: tuple[NDArray[Any], NDArray[Any]],
    curves: Mapping[str, CostCurve],
    true_disparity: float = np.inf,
    kind: str = "png",
) -> bytes:
    """One row per method, as PNG or SVG: its curve, the left window, and the right windows of three candidates.

    images: uint8 or uint16 (H, W[, 3]), left and right. curves: of `cost_curve`, of one pixel. true_disparity: in
    pixels, +inf if unknown. The candidates are the true disparity, the winner, and the rival.
    """
    with matplotlib.rc_context(RC_PARAMS):
        sheet = Sheet(
            figsize=(_WIDTH, _ROW_HEIGHT * len(curves) + 0.6), layout="constrained"
        )
        axes = sheet.subplots(
            len(curves), 5, squeeze=False, width_ratios=(4.6, 1, 1, 1, 1)
        )
        for row, (name, curve) in zip(axes, curves.items(), strict=True):
            marks = {
                "true": (true_disparity, TRUE),
                "winner": (curve.disparity, WINNER),
                "rival": (curve.rival, RIVAL),
            }
            _draw_curve(row[0], name, curve, marks)
            _draw_window(row[1], rgb8(images[0]), curve, 0.0, "left window", "#666666")
            for cell, (text, (disparity, colour)) in zip(
                row[2:], marks.items(), strict=True
            ):
                if disparity is None or not np.isfinite(disparity):
                    cell.set_axis_off()
                    continue
                _draw_window(
                    cell, rgb8(images[1]), curve, round(float(disparity)), text, colour
                )
        first = next(iter(curves.values()))
        known = (
            f", true disparity {true_disparity:.2f} px"
            if np.isfinite(true_disparity)
            else ", truth unknown"
        )
        sheet.suptitle(
            f"Costs of pixel ({first.u}, {first.v}){known}",
            fontsize=11,
            fontweight="bold",
            x=0.012,
            ha="left",
        )
        axes[-1, 0].set_xlabel("disparity (px)")
        return encode(sheet, kind)


def _draw_curve(
    axes: Any, name: str, curve: CostCurve, marks: Mapping[str, tuple[Any, str]]
) -> None:
    known = np.isfinite(curve.costs)
    axes.plot(
        curve.disparities[known],
        curve.costs[known],
        color="#555555",
        marker=".",
        markersize=3,
        linewidth=1.1,
    )
    for text, (disparity, colour) in marks.items():
        if disparity is not None and np.isfinite(disparity):
            style = "-" if text == "true" else "--" if text == "winner" else ":"
            axes.axvline(
                disparity,
                color=colour,
                linestyle=style,
                linewidth=1.4,
                label=f"{text} {disparity:.4g}",
            )
    axes.set_ylabel("cost")
    axes.set_title(name, loc="left", fontsize=9)
    axes.margins(x=0.02)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            fontsize=7,
            frameon=False,
            ncols=3,
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            borderpad=0,
        )


def _draw_window(
    axes: Any,
    image: NDArray[np.uint8],
    curve: CostCurve,
    disparity: float,
    text: str,
    colour: str,
) -> None:
    """The matcher's window around (u - disparity, v), with a frame, and pixels around it; grey outside the image."""
    height, width = image.shape[:2]
    u, radius = curve.u - disparity, curve.matcher.window // 2
    reach, side = radius + _CONTEXT, 2 * radius + 1
    axes.set_facecolor("#D0D4D9")
    axes.imshow(
        image, extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="nearest"
    )
    axes.add_patch(
        Rectangle(
            (u - radius - 0.5, curve.v - radius - 0.5),
            side,
            side,
            fill=False,
            edgecolor=colour,
            linewidth=1.6,
        )
    )
    axes.set(
        xlim=(u - reach - 0.5, u + reach + 0.5),
        ylim=(curve.v + reach + 0.5, curve.v - reach - 0.5),
    )
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    axes.set_title(text, fontsize=8, fontweight="normal", color=colour)
