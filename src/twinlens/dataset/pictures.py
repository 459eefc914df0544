"""Pictures to look at: 8-bit colours, false colours of maps, contact sheets, and the figure of a dataset's card."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageOps

from twinlens.dataset.statistics import Statistics, distributions, mixed_counts
from twinlens.errors import InputError, check_known

NO_TRUTH = (196, 200, 206)  # light grey: viridis, magma and berlin contain no greys
_TILE_WIDTH, _GAP = 160, 4
_BINS = 60
_LABELS, _FILL, _AXES = "#1b2a3a", "#3b7dd8", "#6b7785"
_LOG_ABOVE = 8.0  # ratio of maximum to minimum depth
_GRIDS = ((1, 1), (1, 1), (1, 2), (1, 3), (2, 2))
"""Rows and columns by number of panels."""


def rgb8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """A uint8 or uint16 image (H, W[, 3]) as uint8 (H, W, 3)."""
    eight = (
        (image >> 8).astype(np.uint8)
        if image.dtype == np.uint16
        else image.astype(np.uint8)
    )
    return np.repeat(eight[..., None], 3, axis=2) if eight.ndim == 2 else eight


def colourise(
    values: ArrayLike,
    low: float,
    high: float,
    colormap: str = "viridis",
    unknown_colour: Sequence[int] = NO_TRUTH,
) -> NDArray[np.uint8]:
    """(H, W) numbers as a uint8 (H, W, 3) sRGB image; the colormap spans [low, high], values outside saturate.

    Values that are not finite get `unknown_colour`. Raises InputError unless `colormap` is one of matplotlib's, and
    low < high.

    >>> colourise([[0.0, 1.0, np.inf]], 0, 1).tolist()
    [[[68, 1, 84], [253, 231, 37], [196, 200, 206]]]
    """
    import matplotlib

    check_known("colormap", colormap, matplotlib.colormaps)
    if not low < high:
        raise InputError(f"the colour range is [{low}, {high}]: expected low < high")
    numbers = np.asarray(values, np.float64)
    finite = np.isfinite(numbers)
    share = (np.where(finite, numbers, low) - low) / (high - low)
    colours = matplotlib.colormaps[colormap](
        np.rint(np.clip(share, 0, 1) * 255).astype(np.intp)
    )
    return np.where(
        finite[..., None], np.rint(255 * colours[..., :3]), unknown_colour
    ).astype(np.uint8)


def disparity_limits(disparity: ArrayLike, matcher: object) -> tuple[float, float]:
    """(low, high) for the colours of a disparity map, at least 1 apart.

    The matcher's search range, or the range of the map if the matcher has none or searches one disparity.
    """
    values = np.asarray(disparity)
    finite = values[np.isfinite(values)]
    low, high = (
        (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    )
    first = getattr(matcher, "min_disparity", None)
    count = getattr(matcher, "num_disparities", None)
    if first is not None and count is not None and count > 1:
        low, high = float(first), float(first + count - 1)
    return low, max(high, low + 1.0)


def tile(image: NDArray[Any]) -> Image.Image:
    """A uint8 or uint16 image (H, W[, 3]) scaled to a width of 160 pixels."""
    picture = Image.fromarray(rgb8(image)).reduce(
        max(1, image.shape[1] // (3 * _TILE_WIDTH))
    )
    height = max(round(_TILE_WIDTH * image.shape[0] / image.shape[1]), 1)
    return picture.resize((_TILE_WIDTH, height), Image.Resampling.LANCZOS)


def contact_sheet(tiles: Sequence[Image.Image], columns: int = 8) -> Image.Image:
    """Tiles in rows, padded to the size of the first. Raises InputError without tiles."""
    from skimage.util import montage

    if not tiles:
        raise InputError("a contact sheet needs one or more images")
    columns = min(columns, len(tiles))
    padded = [ImageOps.pad(picture, tiles[0].size, color="white") for picture in tiles]
    grid = {
        "grid_shape": (-(-len(tiles) // columns), columns),
        "padding_width": _GAP,
        "fill": (255, 255, 255),
    }
    images = np.stack([np.asarray(picture) for picture in padded])
    return Image.fromarray(montage(images, channel_axis=-1, **grid))


@dataclass(frozen=True)
class Panel:
    """A histogram over distributions of weight one.

    quantiles : of each distribution.
    log_above : the ratio of maximum to minimum above which the axis is logarithmic.
    """

    xlabel: str
    ylabel: str
    quantiles: list[list[float]]
    log_above: float = np.inf


def statistics_figure(many: Sequence[Statistics]) -> bytes:
    """A PNG of the distributions of disparity, depth, blur circle and occluded pixels; all samples weigh the same.

    Quantities that no sample has are left out: disparity of single cameras, blur of pinholes.
    """
    from matplotlib.figure import Figure

    drawn = panels(many)
    rows, columns = _GRIDS[len(drawn)]
    figure = Figure(figsize=(9.0, 2.8 * rows), dpi=110, layout="constrained")
    if drawn:
        subplots = figure.subplots(rows, columns, squeeze=False).ravel()
        for panel, axes in zip(drawn, subplots, strict=True):
            _draw(axes, panel)
    else:
        figure.text(0.5, 0.5, "no sample has truth", ha="center", color=_AXES)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def panels(many: Sequence[Statistics]) -> list[Panel]:
    """The panels of the figure that have data."""
    share = "share of the pixels (%)"
    disparities, depths, blurs = distributions(many)
    # A sample is one value, so its distribution has two equal quantiles.
    occluded = [
        2 * [100 * sample["occluded"]]
        for sample in many
        if "disparity" in sample and sample["cameras"] > 1
    ]
    drawn = (
        Panel("disparity (px)", share, disparities),
        Panel("depth (m)", share, depths, _LOG_ABOVE),
        Panel("blur circle diameter (px)", share, blurs),
        Panel("pixels visible in one view only (%)", "share of samples (%)", occluded),
    )
    return [panel for panel in drawn if panel.quantiles]


def _draw(axes: Any, panel: Panel) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_xlabel(panel.xlabel, color=_LABELS)
    axes.set_ylabel(panel.ylabel, color=_LABELS, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_AXES)
    axes.tick_params(colors=_AXES, labelsize=8)
    low = min(levels[0] for levels in panel.quantiles)
    high = max(levels[-1] for levels in panel.quantiles)
    logarithmic = low > 0 and high > panel.log_above * low
    if high - low < 1e-9 * max(abs(low), abs(high), 1.0):
        low, high = low - 0.5, high + 0.5
    edges = (np.geomspace if logarithmic else np.linspace)(low, high, _BINS + 1)
    shares = mixed_counts(edges, panel.quantiles) / len(panel.quantiles)
    axes.stairs(100 * shares, edges, fill=True, color=_FILL)
    if logarithmic:
        # Plain numbers at 1, 2, 5 of each decade, or at 1 only over many decades.
        steps = (1.0, 2.0, 5.0) if high < 1000 * low else (1.0,)
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=steps))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlim(edges[0], edges[-1])
