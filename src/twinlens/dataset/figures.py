"""The two figures of a dataset's card: a contact sheet of left images, and the distributions of the truth.

The same dataset gives the same bytes with the same versions of Pillow and matplotlib; neither file contains a date.
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
_MISSING = "#c8c8c8"
_TEXT, _FILL, _AXES = "#1b2a3a", "#3b7dd8", "#6b7785"
_LOG_ABOVE = 8.0  # ratio of maximum to minimum depth
_GRIDS = ((1, 1), (1, 1), (1, 2), (1, 3), (2, 2))
"""Rows and columns by number of panels."""


@dataclass(frozen=True)
class Panel:
    """A histogram over several distributions, each given by its quantiles and of weight one."""

    xlabel: str
    ylabel: str
    many: list[list[float]]
    log_above: float = np.inf
    """Ratio of maximum to minimum above which the axis is logarithmic."""


def tile(image: NDArray[Any]) -> Image.Image:
    """A uint8 or uint16 image (H, W[, 3]) scaled to a width of 160 pixels."""
    eight = image if image.dtype == np.uint8 else (image >> 8).astype(np.uint8)
    picture = Image.fromarray(eight).convert("RGB").reduce(max(1, image.shape[1] // (3 * _TILE_WIDTH)))
    height = max(round(_TILE_WIDTH * image.shape[0] / image.shape[1]), 1)
    return picture.resize((_TILE_WIDTH, height), Image.Resampling.LANCZOS)


def contact_sheet(tiles: Sequence[Image.Image | None], columns: int = 8) -> Image.Image:
    """Tiles in rows, padded to the size of the first; None leaves a place grey. Raises InputError without tiles."""
    sizes = [each.size for each in tiles if each is not None]
    if not sizes:
        raise InputError("a contact sheet needs one or more images")
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    width, height = sizes[0]
    sheet = Image.new("RGB", (columns * (width + _GAP) + _GAP, rows * (height + _GAP) + _GAP), "white")
    for i, each in enumerate(tiles):
        missing = Image.new("RGB", (width, height), _MISSING)
        padded = missing if each is None else ImageOps.pad(each, (width, height), color="white")
        sheet.paste(padded, (_GAP + i % columns * (width + _GAP), _GAP + i // columns * (height + _GAP)))
    return sheet


def statistics_figure(many: Sequence[Statistics]) -> bytes:
    """A PNG of the distributions of disparity, depth, blur circle and occluded pixels; all samples weigh the same.

    Quantities that no sample has are left out: disparity of single cameras, blur of pinholes.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = panels(many)
    rows, columns = _GRIDS[len(drawn)]
    figure = Figure(figsize=(9.0, 2.8 * rows), dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    if not drawn:
        figure.text(0.5, 0.5, "no sample has truth", ha="center", color=_AXES)
    else:
        for panel, axes in zip(drawn, figure.subplots(rows, columns, squeeze=False).ravel(), strict=True):
            _draw(axes, panel)
    stream = io.BytesIO()
    canvas.print_png(stream, metadata={"Software": None})
    return stream.getvalue()


def panels(many: Sequence[Statistics]) -> list[Panel]:
    """The panels of the figure that have data."""
    share = "share of the pixels (%)"
    known = [each for each in many if "disparity" in each]
    blurs = [blur for each in known for blur in each["blur_px"] if blur and blur[-1] > 0]
    occluded = [100 * each["occluded"] for each in known if each["cameras"] > 1]
    every = (
        Panel("disparity (px)", share, [each["disparity"] for each in known if each["disparity"]]),
        Panel("depth (m)", share, [each["depth"] for each in known if each["depth"]], _LOG_ABOVE),
        Panel("blur circle diameter (px)", share, blurs),
        Panel("pixels visible in one view only (%)", "share of samples (%)", [[value, value] for value in occluded]),
    )
    return [panel for panel in every if panel.many]


def _draw(axes: Any, panel: Panel) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_xlabel(panel.xlabel, color=_TEXT)
    axes.set_ylabel(panel.ylabel, color=_TEXT, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_AXES)
    axes.tick_params(colors=_AXES, labelsize=8)
    low, high = min(each[0] for each in panel.many), max(each[-1] for each in panel.many)
    logarithmic = low > 0 and high > panel.log_above * low
    if high - low < 1e-9 * max(abs(low), abs(high), 1.0):
        low, high = low - 0.5, high + 0.5
    edges = (np.geomspace if logarithmic else np.linspace)(low, high, _BINS + 1)
    axes.stairs(100 * mixed_counts(edges, panel.many) / len(panel.many), edges, fill=True, color=_FILL)
    if logarithmic:  # plain numbers at 1, 2, 5 of each decade, or at 1 only over many decades
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 1000 * low else (1.0,)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlim(edges[0], edges[-1])
