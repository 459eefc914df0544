"""A figure of cost curves: for each method the costs of a pixel, and its window beside those of three candidates."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
    pixels, +inf if unknown. The candidates are the true disparity, the winner, and the rival; an unknown true disparity
    has no column.
    """
    with matplotlib.rc_context(RC_PARAMS):
        size = _WIDTH, _ROW_HEIGHT * len(curves) + 0.6
        sheet = Sheet(figsize=size, layout="constrained")
        has_truth = bool(np.isfinite(true_disparity))
        windows = 4 if has_truth else 3
        ratios = (4.6, *[1] * windows)
        axes = sheet.subplots(
            len(curves), 1 + windows, squeeze=False, width_ratios=ratios
        )
        left, right = (rgb8(image) for image in images)
        for row, (name, curve) in zip(axes, curves.items(), strict=True):
            candidates = _candidates(curve, true_disparity if has_truth else None)
            _draw_curve(row[0], name, curve, candidates)
            _draw_window(row[1], left, curve, 0.0, "left window", "#666666")
            for cell, candidate in zip(row[2:], candidates, strict=True):
                if not candidate.is_drawn:
                    cell.set_axis_off()
                    continue
                shift = round(float(candidate.disparity))
                text, colour = candidate.name, candidate.colour
                _draw_window(cell, right, curve, shift, text, colour)
        truth = "truth unknown"
        if has_truth:
            truth = f"true disparity {true_disparity:.2f} px"
        first = next(iter(curves.values()))
        title = f"Costs of pixel ({first.u}, {first.v}), {truth}"
        sheet.suptitle(title, fontsize=11, fontweight="bold", x=0.012, ha="left")
        axes[-1, 0].set_xlabel("disparity (px)")
        return encode(sheet, kind)


@dataclass(frozen=True)
class _Candidate:
    """A disparity to mark; None or not finite if it is unknown."""

    name: str
    disparity: Any
    colour: str
    line: str

    @property
    def is_drawn(self) -> bool:
        return self.disparity is not None and bool(np.isfinite(self.disparity))


def _candidates(curve: CostCurve, true_disparity: float | None) -> list[_Candidate]:
    """The disparities to mark, one for each window of the right image; None leaves out the true one."""
    candidates = [
        _Candidate("winner", curve.disparity, WINNER, "--"),
        _Candidate("rival", curve.rival, RIVAL, ":"),
    ]
    if true_disparity is None:
        return candidates
    return [_Candidate("true", true_disparity, TRUE, "-"), *candidates]


def _draw_curve(
    axes: Any, name: str, curve: CostCurve, candidates: Sequence[_Candidate]
) -> None:
    finite = np.isfinite(curve.costs)
    style = {"color": "#555555", "marker": ".", "markersize": 3, "linewidth": 1.1}
    axes.plot(curve.disparities[finite], curve.costs[finite], **style)
    for candidate in candidates:
        if candidate.is_drawn:
            axes.axvline(
                candidate.disparity,
                color=candidate.colour,
                linestyle=candidate.line,
                linewidth=1.4,
                label=f"{candidate.name} {candidate.disparity:.4g}",
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
    u, v = curve.u - disparity, curve.v
    radius = curve.matcher.window // 2
    axes.set_facecolor("#D0D4D9")
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(image, extent=extent, interpolation="nearest")
    corner, side = (u - radius - 0.5, v - radius - 0.5), 2 * radius + 1
    frame = Rectangle(corner, side, side, fill=False, edgecolor=colour, linewidth=1.6)
    axes.add_patch(frame)
    reach = radius + _CONTEXT + 0.5
    axes.set(xlim=(u - reach, u + reach), ylim=(v + reach, v - reach))
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    axes.set_title(text, fontsize=8, fontweight="normal", color=colour)
