"""The two pictures of a dataset's card: a sheet of its left images, and the distributions of its truth.

The same dataset gives the same bytes with the same versions of Pillow and matplotlib; neither file holds a date.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from twinlens.dataset.quantities import Statistics, mixed_counts
from twinlens.errors import InputError

TILES = 64
_TILE_WIDTH, _GAP = 160, 4
_BINS = 60
_INK, _FILL, _QUIET = "#1b2a3a", "#3b7dd8", "#6b7785"
_WIDE = 8.0  # depths that span so many times the least are drawn on a logarithmic axis
_GRIDS = ((1, 1), (1, 1), (1, 2), (1, 3), (2, 2))
"""Rows and columns of so many panels."""


@dataclass(frozen=True)
class Panel:
    """A histogram of distributions, each given by its quantiles and of weight one."""

    xlabel: str
    ylabel: str
    many: list[list[float]]
    wide: float = np.inf
    """How many times the least the most may be until the axis is logarithmic."""


def tile(image: NDArray[Any]) -> Image.Image:
    """A picture 160 pixels wide of an image, uint8 or uint16 (H, W[, 3])."""
    eight = image if image.dtype == np.uint8 else (image >> 8).astype(np.uint8)
    picture = Image.fromarray(eight).convert("RGB").reduce(max(1, image.shape[1] // (3 * _TILE_WIDTH)))
    height = max(round(_TILE_WIDTH * image.shape[0] / image.shape[1]), 1)
    return picture.resize((_TILE_WIDTH, height), Image.Resampling.LANCZOS)


def contact_sheet(tiles: Sequence[Image.Image], columns: int = 8) -> bytes:
    """A JPEG of the tiles in rows, each as high as the first: others are fitted into it.

    Raises InputError when there is none.
    """
    if not tiles:
        raise InputError("a sheet needs one image or more")
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    width, height = tiles[0].size
    sheet = Image.new("RGB", (columns * (width + _GAP) + _GAP, rows * (height + _GAP) + _GAP), "white")
    for i, each in enumerate(tiles):
        fitted = ImageOps.pad(each, (width, height), color="white")
        sheet.paste(fitted, (_GAP + i % columns * (width + _GAP), _GAP + i // columns * (height + _GAP)))
    stream = io.BytesIO()
    sheet.save(stream, "JPEG", quality=88)
    return stream.getvalue()


def statistics_figure(many: Sequence[Statistics]) -> bytes:
    """A PNG of what the samples hold, each of the same weight: disparity, depth, blur circle, occluded pixels.

    What none of them has is left out: a disparity, where each has one camera; blur, where all are photographed through
    pinholes. Where nothing is left, the picture says so.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    there = panels(many)
    rows, columns = _GRIDS[len(there)]
    figure = Figure(figsize=(9.0, 2.8 * rows), dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    for panel, axes in zip(there, figure.subplots(rows, columns, squeeze=False).ravel() if there else (), strict=True):
        _draw(axes, panel)
    if not there:
        figure.text(0.5, 0.5, "no sample has a truth to draw", ha="center", color=_QUIET)
    stream = io.BytesIO()
    canvas.print_png(stream, metadata={"Software": None})
    return stream.getvalue()


def panels(many: Sequence[Statistics]) -> list[Panel]:
    """The panels of the figure that have anything to show."""
    share = "share of the pixels (%)"
    known = [each for each in many if "disparity" in each]
    blurs = [blur for each in known for blur in each["blur_px"]]
    hidden = [100 * each["occluded"] for each in known if each["cameras"] > 1]
    every = (
        Panel("disparity (px)", share, [each["disparity"] for each in known if each["disparity"]]),
        Panel("depth (m)", share, [each["depth"] for each in known if each["depth"]], wide=_WIDE),
        Panel("blur circle's diameter (px)", share, [blur for blur in blurs if blur and blur[-1] > 0]),
        Panel("pixels that one view alone sees (%)", "share of samples (%)", [[value, value] for value in hidden]),
    )
    return [panel for panel in every if panel.many]


def _draw(axes: Any, panel: Panel) -> None:
    many = panel.many
    axes.set_xlabel(panel.xlabel, color=_INK)
    axes.set_ylabel(panel.ylabel, color=_INK, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_QUIET)
    axes.tick_params(colors=_QUIET, labelsize=8)
    low, high = min(each[0] for each in many), max(each[-1] for each in many)
    logarithmic = low > 0 and high > panel.wide * low
    edges = _edges(low, high, logarithmic)
    axes.stairs(100 * mixed_counts(edges, many) / len(many), edges, fill=True, color=_FILL)
    if logarithmic:
        _log_scale(axes, decades=np.log10(high / low))
    axes.set_xlim(edges[0], edges[-1])


def _log_scale(axes: Any, decades: float) -> None:
    """A logarithmic x axis with plain numbers at 1, 2, 5 of each decade, or at 1 alone where there are many."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 3 else (1.0,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())


def _edges(low: float, high: float, logarithmic: bool) -> NDArray[np.float64]:
    if logarithmic:
        return np.geomspace(low, high, _BINS + 1)
    if high - low < 1e-9 * max(abs(low), abs(high), 1.0):
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, _BINS + 1)
