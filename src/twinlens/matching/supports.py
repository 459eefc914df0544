"""The support regions by name: over which pixels costs are aggregated, and with which weights.

A support turns a strip of a cost volume into the strip of aggregated costs. Supports that select or weight single
pixels take pixel costs, and block_size is the size of their region; the others take costs of whole windows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.matching.box import Volume
from twinlens.matching.costs import find_cost
from twinlens.matching.images import extended

if TYPE_CHECKING:
    from twinlens.matching.matcher import StereoMatcher


@dataclass(frozen=True)
class Strip:
    """The input of a support: a strip of a cost volume, to be aggregated into the rows start..stop of the image.

    volumes: one for each of the support's windows, the widest first; `first` is the first row of each. left, right:
    both images as levels 0..255. low: the first disparity.
    """

    volumes: tuple[Volume, ...]
    first: int
    start: int
    stop: int
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    low: int
    matcher: "StereoMatcher"

    @property
    def side(self) -> int:
        return self.matcher.block_size

    @property
    def top(self) -> int:
        return self.start - self.first

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + len(self.volumes[0]))

    def empty(self) -> Volume:
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
    """
    least = min(side, 5)
    return tuple(
        sorted(
            {max(2 * int(part * side // 2) + 1, least) for part in (1, 0.75, 0.5)},
            reverse=True,
        )
    )


def quarter(side: int) -> int:
    """The sub-window of an adaptive window: of half the side, odd."""
    return 2 * (side // 4) + 1


def _shiftable(strip: Strip) -> Volume:
    """The best of all windows that contain the pixel. Bobick and Intille, "Large occlusion stereo", IJCV 1999."""
    out, volume, radius = strip.empty(), strip.volumes[0], strip.side // 2
    columns = slice(radius, radius + volume.shape[1])
    for y, here in enumerate(out, strip.top):
        lowest = np.full((len(here) + 2 * radius, volume.shape[2]), np.inf)
        volume[max(0, y - radius) : y + radius + 1].min(axis=0, out=lowest[columns])
        reach = 1  # columns whose minimum is taken; it doubles
        while reach < strip.side:
            step = min(reach, strip.side - reach)
            lowest, reach = np.minimum(lowest[:-step], lowest[step:]), reach + step
        here[:] = lowest
    return out


UNCERTAINTY = 0.05  # pixels: standard deviation of the disparity for which an adaptive window is large enough


def window_sizes(
    image: NDArray[Any], sides: tuple[int, ...], noise: float
) -> NDArray[np.int64]:
    """(H, W): the index in `sides` (the widest first) of the window at each pixel of an image in grey levels.

    Noise of standard deviation s in both images gives a window's disparity the variance 2 s^2 / sum Ix^2, with the
    horizontal derivatives Ix in it (central differences): Okutomi and Kanade, "A locally adaptive window for signal
    matching", IJCV 1992. The smallest window with a standard deviation below `UNCERTAINTY` is taken, or the widest.
    """
    squares = np.square(
        np.gradient(image.astype(np.float64), axis=1)
        if image.shape[1] > 1
        else np.zeros(image.shape)
    )
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
    rows = slice(max(0, strip.start - strip.side), strip.stop + strip.side)
    sizes = window_sizes(strip.left[rows], sides, strip.matcher.noise)[
        strip.start - rows.start :
    ]
    out = strip.empty()
    for index, (side, volume) in enumerate(zip(sides, strip.volumes, strict=True)):
        scale = (quarter(sides[0]) / quarter(side)) ** (
            2 * find_cost(strip.matcher.cost).growth
        )
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
    cross_arms(image, min(int(strip.matcher.contrast), 255), strip.side // 2, arms)
    cross_means(strip.volumes[0], arms, strip.top, out)
    return out


def _weighted(strip: Strip) -> Volume:
    """Yoon and Kweon, "Adaptive support-weight approach for correspondence search", PAMI 2006, on grey levels."""
    from twinlens.matching.kernels.supports import adaptive_weights

    radius, width, depth = (
        strip.side // 2,
        strip.left.shape[1],
        strip.volumes[0].shape[2],
    )
    last = strip.low + depth - 1
    right = extended(
        strip.right, (strip.rows.start, strip.rows.stop), (-last, width - strip.low)
    )[:, ::-1].copy()
    offsets = np.arange(-radius, radius + 1)
    distances = np.hypot(offsets[:, None], offsets[None, :])
    nearness = np.exp(-2.0 * distances / strip.matcher.gamma_near)  # of both windows
    similar = np.exp(-np.arange(256) / strip.matcher.gamma_similar)
    out = strip.empty()
    left = np.ascontiguousarray(strip.left[strip.rows])
    adaptive_weights(
        strip.volumes[0],
        left,
        right,
        width - 1,
        nearness,
        similar,
        radius,
        strip.top,
        out,
    )
    return out


def _guided(strip: Strip) -> Volume:
    """Hosni et al., "Fast cost-volume filtering for visual correspondence and beyond", PAMI 2013, with a grey guide."""
    radius, volume, first = strip.side // 2, strip.volumes[0], strip.first
    guide = strip.left[strip.rows, :, None] / 255.0
    start, stop = (
        max(first, strip.start - radius),
        min(first + len(guide), strip.stop + radius),
    )
    arrays = guide, guide**2, volume, volume * guide
    mean_guide, mean_square, cost, product = (
        _means(array, first, start, stop, radius) for array in arrays
    )
    variance = np.maximum(mean_square - mean_guide**2, 0.0)
    slope = (product - mean_guide * cost) / (variance + strip.matcher.epsilon)
    lines = slope, cost - slope * mean_guide
    slope, intercept = (
        _means(array, start, strip.start, strip.stop, radius) for array in lines
    )
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
