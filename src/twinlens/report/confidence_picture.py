"""A figure of confidence measures: their maps beside the error, and their sparsification curves."""

import math
from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure as Sheet
from numpy.typing import NDArray

from twinlens.dataset.pictures import colourise, rgb8
from twinlens.report.plots import PALETTE, RC_PARAMS, encode
from twinlens.scoring.confidences import ConfidenceScores
from twinlens.scoring.evaluate import RegionScores
from twinlens.scoring.sparsification import DENSITIES

_ERROR_PX = 4.0  # end of the colours of errors
_PERCENT = (2, 98)  # ends of the colours of a confidence, percentiles


def confidence_picture(
    image: NDArray[Any], scored: ConfidenceScores, title: str, kind: str = "png"
) -> bytes:
    """The left image, the errors, each confidence map, and the sparsification curves, as PNG or SVG.

    Without scores, of a pair without truth, there are neither errors nor curves.
    """
    pictures = _pictures(image, scored)
    columns = math.ceil(len(pictures) / 2)
    height = 2.7 * image.shape[0] / image.shape[1] + 0.35
    with matplotlib.rc_context(RC_PARAMS):
        ratios = (height, height, 3.0) if scored.scores else (height, height)
        size = 2.7 * columns + 0.3, sum(ratios) + 0.4
        sheet = Sheet(figsize=size, layout="constrained")
        grid = sheet.add_gridspec(len(ratios), columns, height_ratios=ratios)
        for number, (name, picture) in enumerate(pictures.items()):
            axes = sheet.add_subplot(grid[divmod(number, columns)])
            axes.imshow(picture)
            axes.set_axis_off()
            axes.set_title(name, fontsize=8.5, loc="left", pad=3)
        if scored.scores:
            _draw_curves(sheet.add_subplot(grid[2, :]), scored.scores)
        sheet.suptitle(title, fontsize=11, fontweight="bold", x=0.012, ha="left")
        return encode(sheet, kind)


def _pictures(
    image: NDArray[Any], scored: ConfidenceScores
) -> dict[str, NDArray[np.uint8]]:
    """The left image, the errors and the confidence maps, by their captions."""
    pictures = {"left image": rgb8(image)}
    if scored.scores:
        errors = colourise(scored.errors, 0, _ERROR_PX, "magma")
        pictures[f"error, 0 to {_ERROR_PX:g} px"] = errors
    for name, confidence in scored.maps.items():
        low, high = np.percentile(confidence, _PERCENT)
        pictures[name] = colourise(confidence, low, high if high > low else low + 1)
    return pictures


def _draw_curves(axes: Any, scores: Mapping[str, RegionScores]) -> None:
    shares = 100 * np.array(DENSITIES)
    first = next(iter(scores.values()))
    for colour, (name, region) in zip(PALETTE, scores.items(), strict=False):
        label = f"{name}, area {region['auc2.0']:.2f} %"
        axes.plot(
            shares, region.sparsification, color=colour, linewidth=1.6, label=label
        )
    rate = first.sparsification[-1] / 100
    best = 100 * np.maximum(0, 1 - (1 - rate) / np.array(DENSITIES))
    label = f"lowest possible, area {first['auc2.0_opt']:.2f} %"
    axes.plot(shares, best, color="#444444", linestyle="--", linewidth=1.2, label=label)
    axes.set(
        xlabel="most confident pixels (%)",
        ylabel="errors above 2 px (%)",
        xlim=(0, 100),
    )
    axes.set_ylim(bottom=0)
    axes.grid(True, color="#DDDDDD", linewidth=0.6)
    axes.legend(fontsize=8, frameon=False, loc="upper left")
