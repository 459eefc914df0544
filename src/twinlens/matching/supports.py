"""The support regions by name: over which pixels costs are aggregated, and with which weights.

A support turns a strip of a cost volume into the strip of aggregated costs. Supports that select or weight single
pixels take pixel costs, and block_size is the size of their region; the others take costs of whole windows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.matching.box import Volume
from twinlens.matching.contract import RangeMatcher
from twinlens.matching.images import extended
from twinlens.settings import Setting

UNCERTAINTY = 0.05
"""Pixels: standard deviation of the disparity for which an adaptive window is large enough."""


@dataclass(frozen=True, kw_only=True)
class SupportOptions(RangeMatcher):
    """The options of a matcher that its support reads, beside the side of its window."""

    contrast: Annotated[
        float,
        Setting(
            "Support cross: difference in grey levels of 0..255 at which an arm ends.",
            least=0,
        ),
    ] = 20.0
    gamma_similar: Annotated[
        float,
        Setting(
            "Support weighted: grey levels over which a weight falls to 1/e.", above=0
        ),
    ] = 12.0
    gamma_near: Annotated[
        float,
        Setting("Support weighted: pixels over which a weight falls to 1/e.", above=0),
    ] = 12.0
    epsilon: Annotated[
        float,
        Setting(
            "Support guided: variance below which the filter smooths, of grey levels in 0..1.",
            above=0,
        ),
    ] = 1e-4
    noise: Annotated[
        float,
        Setting(
            "Support adaptive: standard deviation of the image noise, in grey levels of 0..255.",
            least=0,
        ),
    ] = 2.0


@dataclass(frozen=True)
class Strip:
    """The input of a support: a strip of a cost volume, to be aggregated into the rows start..stop of the image.

    volumes: one for each of the support's windows, the widest first; `first` is the first row of each. left, right:
    both images as levels 0..255. low: the first disparity. side: that of the support's window, in pixels. growth: see
    `Cost`.
    """

    volumes: tuple[Volume, ...]
    first: int
    start: int
    stop: int
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    low: int
    side: int
    growth: int
    options: SupportOptions

    @property
    def top(self) -> int:
        """The row of the volumes that is row `start` of the image."""
        return self.start - self.first

    @property
    def rows(self) -> slice:
        """The rows of the image that the volumes cover."""
        return slice(self.first, self.first + len(self.volumes[0]))

    def empty(self) -> Volume:
        """An array for the result."""
        return np.empty((self.stop - self.start, *self.volumes[0].shape[1:]))


@dataclass(frozen=True)
class Support:
    """A support region. Without `aggregate`, the costs are used unchanged.

    halo: how many rows above and below a pixel it reads, in radii of the window. pixelwise: it aggregates costs of
    pixels, not of windows. masked: candidates without a partner have the cost +inf, not that of edge-continued images.
    windows(side): the sides of the windows, the widest first. parts: the number of windows whose costs it adds up.
    integer_sums: it adds up costs in uint32 where that holds sums over the window. strip: rows aggregated at a time.
    """

    aggregate: Callable[[Strip], Volume] | None = None
    halo: int = 0
    pixelwise: bool = False
    masked: bool = False
    windows: Callable[[int], tuple[int, ...]] = lambda side: (side,)
    parts: int = 1
    integer_sums: bool = False
    strip: int = 16


def family(side: int) -> tuple[int, ...]:
    """The sizes of an adaptive window: the side, three quarters and one half of it; odd, and at least 5.

    The sub-windows of a window of 5 have a side of 3; smaller ones hardly distinguish candidates.

    >>> family(21)
    (21, 15, 11)
    """
    least = min(side, 5)
    sizes = {max(2 * int(part * side // 2) + 1, least) for part in (1, 0.75, 0.5)}
    return tuple(sorted(sizes, reverse=True))


def quarter(side: int) -> int:
    """The sub-window of an adaptive window: of half the side, odd."""
    return 2 * (side // 4) + 1


def _shiftable(strip: Strip) -> Volume:
    """The best of all windows that contain the pixel. Bobick and Intille, "Large occlusion stereo", IJCV 1999.

    The windows that contain a pixel are those centred in the window around it, so this is a minimum filter.
    """
    out = strip.empty()
    volume, radius = strip.volumes[0], strip.side // 2
    width, depth = volume.shape[1:]
    inside = slice(radius, radius + width)
    for y in range(len(out)):
        centre = strip.top + y
        lowest = np.full((width + 2 * radius, depth), np.inf)
        rows = volume[max(0, centre - radius) : centre + radius + 1]
        rows.min(axis=0, out=lowest[inside])
        # The minimum over `reach` columns of two halves that overlap: the reach doubles until it is the side.
        reach = 1
        while reach < strip.side:
            step = min(reach, strip.side - reach)
            lowest = np.minimum(lowest[:-step], lowest[step:])
            reach += step
        out[y] = lowest
    return out


def window_sizes(
    image: NDArray[Any], sides: tuple[int, ...], noise: float
) -> NDArray[np.int64]:
    """(H, W): the index in `sides` (the widest first) of the window at each pixel of an image in grey levels.

    Noise of standard deviation s in both images gives a window's disparity the variance 2 s^2 / sum Ix^2, with the
    horizontal derivatives Ix in it (central differences): Okutomi and Kanade, "A locally adaptive window for signal
    matching", IJCV 1992. The smallest window with a standard deviation below `UNCERTAINTY` is taken, or the widest.
    """
    derivative: NDArray[np.float64] = np.zeros(image.shape)
    if image.shape[1] > 1:
        derivative = np.gradient(image.astype(np.float64), axis=1)
    squares = np.square(derivative)
    needed = 2.0 * noise**2 / UNCERTAINTY**2
    sizes = np.zeros(image.shape, np.int64)
    for index, side in enumerate(sides):
        # Squared grey levels are multiples of 1/4; rounded to these, sums do not depend on where a strip begins.
        energy = ndimage.uniform_filter(squares, side, mode="nearest") * side**2
        sizes[np.rint(4 * energy) >= 4 * needed] = index
    return sizes


def _adaptive(strip: Strip) -> Volume:
    """A window that adapts its size to the texture and its shape to edges.

    Size: at each pixel the smallest of three with enough signal for the noise (`window_sizes`). Shape: five
    sub-windows, after Hirschmueller, Innocent and Garibaldi, "Real-time correlation-based stereo vision with reduced
    border errors", IJCV 2002: the one around the pixel and the best two of the four around it, which gives one of six
    shapes for each candidate.
    """
    from twinlens.matching.kernels.supports import best_quarters

    sides = family(strip.side)
    # The sizes depend on the texture in the widest window, so some rows around the strip are needed.
    first = max(0, strip.start - strip.side)
    surroundings = strip.left[first : strip.stop + strip.side]
    sizes = window_sizes(surroundings, sides, strip.options.noise)
    sizes = sizes[strip.start - first :]
    out = strip.empty()
    for index, (side, volume) in enumerate(zip(sides, strip.volumes, strict=True)):
        # Costs of smaller windows are scaled to the pixels of the widest, so that all sizes have one range of costs.
        ratio = quarter(sides[0]) / quarter(side)
        scale = ratio ** (2 * strip.growth)
        step = side // 2 - quarter(side) // 2
        best_quarters(volume, step, strip.top, sizes, index, scale, out)
    return out


def _cross(strip: Strip) -> Volume:
    """The cross-shaped region of pixels similar to the left image's, with arms of at most side // 2.

    Source: Zhang, Lu and Lafruit, "Cross-based local stereo matching using orthogonal integral images", 2009.
    """
    from twinlens.matching.kernels.supports import cross_arms, cross_means

    image, out = strip.left[strip.rows], strip.empty()
    arms = np.zeros((4, *image.shape), np.int32)
    contrast = min(int(strip.options.contrast), 255)
    cross_arms(image, contrast, strip.side // 2, arms)
    cross_means(strip.volumes[0], arms, strip.top, out)
    return out


def _weighted(strip: Strip) -> Volume:
    """The mean of costs weighted by similarity and proximity to the centre, in both windows, on grey levels.

    A weight is exp(-(difference / gamma_similar + distance / gamma_near)). Source: Yoon and Kweon, "Adaptive
    support-weight approach for correspondence search", PAMI 28(4), 2006.
    """
    from twinlens.matching.kernels.supports import adaptive_weights

    options, radius = strip.options, strip.side // 2
    width, depth = strip.volumes[0].shape[1:]
    # Reversed, the right image has candidate 0 of the first column at width - 1, and later candidates after it.
    largest = strip.low + depth - 1
    columns = -largest, width - strip.low
    right = extended(strip.right, (strip.rows.start, strip.rows.stop), columns)
    offsets = np.arange(-radius, radius + 1)
    distances = np.hypot(offsets[:, None], offsets[None, :])
    # The weights of both windows are multiplied; their distances to the centre are equal, hence the factor of 2.
    nearness = np.exp(-2.0 * distances / options.gamma_near)
    similar = np.exp(-np.arange(256) / options.gamma_similar)
    out = strip.empty()
    adaptive_weights(
        strip.volumes[0],
        np.ascontiguousarray(strip.left[strip.rows]),
        right[:, ::-1].copy(),
        width - 1,
        nearness,
        similar,
        radius,
        strip.top,
        out,
    )
    return out


def _guided(strip: Strip) -> Volume:
    """The costs smoothed by a guided filter, with the left grey image as the guide.

    Source: Hosni et al., "Fast cost-volume filtering for visual correspondence and beyond", PAMI 35(2), 2013.
    """
    radius, volume, first = strip.side // 2, strip.volumes[0], strip.first
    guide = strip.left[strip.rows, :, None] / 255.0
    # The line of a window is needed wherever the window contains a pixel of the result.
    start = max(first, strip.start - radius)
    stop = min(first + len(guide), strip.stop + radius)

    def means(array: Volume) -> Volume:
        return _means(array, first, start, stop, radius)

    # In each window the line slope * guide + intercept that fits the costs best, regularised by epsilon.
    mean_guide, mean_cost = means(guide), means(volume)
    variance = np.maximum(means(guide**2) - mean_guide**2, 0.0)
    covariance = means(volume * guide) - mean_guide * mean_cost
    slope = covariance / (variance + strip.options.epsilon)
    intercept = mean_cost - slope * mean_guide
    # A pixel takes the mean of the lines of all windows that contain it.
    slope = _means(slope, start, strip.start, strip.stop, radius)
    intercept = _means(intercept, start, strip.start, strip.stop, radius)
    return np.asarray(slope * guide[strip.top : strip.top + len(slope)] + intercept)


def _means(volume: Volume, first: int, start: int, stop: int, radius: int) -> Volume:
    """The rows start..stop of the volume's means over windows that end at the image's edges."""
    from twinlens.matching.kernels.supports import clipped_means

    out = np.empty((stop - start, *volume.shape[1:]))
    clipped_means(volume, radius, start - first, out)
    return out


SUPPORTS: dict[str, Support] = {
    "fixed": Support(),
    "shiftable": Support(_shiftable, halo=1, masked=True),
    "adaptive": Support(
        _adaptive,
        halo=1,
        windows=lambda side: tuple(map(quarter, family(side))),
        parts=3,
    ),
    "cross": Support(_cross, halo=1, pixelwise=True, integer_sums=True, strip=32),
    "weighted": Support(_weighted, halo=1, pixelwise=True),
    "guided": Support(_guided, halo=2, pixelwise=True),
}
