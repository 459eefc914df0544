"""Confidence measures: maps (H, W) float32 of a cost volume, higher where the winner is more probably right.

A volume is (H, W, D), as `StereoMatcher.cost_volume` returns it; +inf is a candidate without a partner. c1 is the
lowest cost of a pixel, at d1; of equal costs the smallest disparity is d1. A rival is two or more disparities from d1.
Sources: Hu and Mordohai, "A quantitative evaluation of confidence measures for stereo vision", PAMI 34(11), 2012; Poggi
et al., "On the confidence of stereo matching in a deep-learning era", PAMI 44(9), 2022. docs/methods.md lists what
differs.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_known
from twinlens.matching.images import Confidence

AMBIGUITY_STEPS = np.arange(0.0, 0.7, 0.01).astype(np.float32)
AMBIGUITY_PERCENT = 1.0
LEAST_DIFFERENCE = 1e-3
"""What `left_right` adds to its denominator, which is 0 for most right matches; a part of the volume's cost range."""


def beside(
    costs: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The costs of the candidates before and after each of (..., D); +inf beyond the ends."""
    end = np.full((*costs.shape[:-1], 1), np.inf)
    before = np.concatenate([end, costs[..., :-1]], axis=-1)
    after = np.concatenate([costs[..., 1:], end], axis=-1)
    return before, after


def rivals(
    costs: NDArray[np.float64], winner: NDArray[np.intp], *, minima: bool = True
) -> NDArray[np.bool_]:
    """Which of the candidates (..., D) are rivals of the winner (...), an index: two or more from it, local minima."""
    far: NDArray[np.bool_] = np.abs(np.arange(costs.shape[-1]) - winner[..., None]) >= 2
    before, after = beside(costs)
    return far & (costs <= before) & (costs <= after) if minima else far


@dataclass(frozen=True)
class _Pixels:
    """Pixels with their costs (..., D), of a volume whose finite costs span `low` to `high`."""

    costs: NDArray[np.float64]
    low: float
    high: float

    @property
    def winner(self) -> NDArray[np.intp]:
        return np.asarray(np.argmin(self.costs, axis=-1))

    @property
    def lowest(self) -> NDArray[np.float64]:
        return np.asarray(np.min(self.costs, axis=-1))

    def rival(self, *, minima: bool) -> NDArray[np.float64]:
        """The lowest cost of a rival; +inf if there is none."""
        is_rival = rivals(self.costs, self.winner, minima=minima)
        return np.asarray(np.min(self.costs, axis=-1, where=is_rival, initial=np.inf))


def _peak_ratio(pixels: _Pixels) -> NDArray[Any]:
    """1 - c1 / c2, with c2 the lowest local minimum of a rival; 1 without one. c2 / c1 has the same order."""
    # Costs of similarities may be below 0 by rounding.
    lowest, rival = np.maximum(pixels.lowest, 0.0), pixels.rival(minima=True)
    divides = np.isfinite(rival) & (rival > 0)
    # Without a rival the ratio is 0, and two costs of 0 have the ratio 1.
    ratio = np.where(np.isfinite(rival), 1.0, 0.0)
    np.divide(lowest, rival, out=ratio, where=divides)
    return 1.0 - ratio


def _curvature(pixels: _Pixels) -> NDArray[Any]:
    """c(d1 - 1) - 2 c1 + c(d1 + 1); at an end of the range the only neighbour counts twice."""
    place = pixels.winner[..., None]
    all_before, all_after = beside(pixels.costs)
    before = np.take_along_axis(all_before, place, axis=-1)[..., 0]
    after = np.take_along_axis(all_after, place, axis=-1)[..., 0]
    first = np.where(np.isfinite(before), before, after)
    last = np.where(np.isfinite(after), after, before)
    bend = first + last - 2.0 * pixels.lowest
    return np.where(np.isfinite(bend), bend, 0.0)


def _left_right(pixels: _Pixels, of_right: NDArray[np.float64]) -> NDArray[Any]:
    """(c2 - c1) / (c1 - c_right + 0.001 range), with c2 the lowest cost of a rival, or the range's end without one.

    c_right: the lowest cost of the matched right pixel over all its left candidates.
    """
    rival = pixels.rival(minima=False)
    margin = np.where(np.isfinite(rival), rival, pixels.high) - pixels.lowest
    # 0 if no other left pixel matches the right pixel better.
    inconsistency = pixels.lowest - of_right
    return margin / (inconsistency + LEAST_DIFFERENCE * (pixels.high - pixels.low))


def _entropy(pixels: _Pixels) -> NDArray[Any]:
    """-ln(H / ln D), with the entropy H of p(d) = exp(-c(d)) / sum exp(-c); +inf has p = 0."""
    # Relative to the lowest cost, so that no exponential underflows to 0 for all candidates.
    weights = np.exp(pixels.lowest[..., None] - pixels.costs)
    share = weights / weights.sum(axis=-1, keepdims=True)
    entropy = -np.sum(share * np.log(np.where(share > 0, share, 1.0)), axis=-1)
    largest_entropy = np.log(max(share.shape[-1], 2))
    least_entropy = np.finfo(float).tiny
    # The inverse of this share overflows for a certain pixel, whose entropy is 0.
    share_of_largest = np.maximum(entropy, least_entropy) / largest_entropy
    return np.asarray(-np.log(share_of_largest))


CONFIDENCES: dict[str, str] = {
    "peak_ratio": "1 - lowest cost / second-lowest minimum",
    "curvature": "of the costs around the lowest",
    "left_right": "distance to the rival, over the difference to the lowest cost of the matched right pixel",
    "entropy": "-ln of the entropy of exp(-cost), normalised to a sum of 1, over that of equal costs",
    "ambiguity": "1 - the number of candidates near the lowest cost, integrated over distances and normalised",
}


_OF_COSTS = {"peak_ratio": _peak_ratio, "curvature": _curvature, "entropy": _entropy}


def confidence_map(
    volume: NDArray[np.floating[Any]], measure: str, min_disparity: int = 0
) -> Confidence:
    """The confidence (H, W) by the measure, a name of `CONFIDENCES`; min_disparity is the disparity of candidate 0.

    It is 0 where there is no candidate, and everywhere if all costs are equal.

    peak_ratio : 1 - c1 / c2 = 1 - 1 / PKR, in [0, 1]; c2 is the second-lowest local minimum.
    curvature : CUR, c(d1 - 1) - 2 c1 + c(d1 + 1), in the unit of the cost.
    left_right : (c2 - c1) / (c1 - c_right + 0.001 range). c2 is the lowest cost of a rival (LRD has the second-lowest
        of all costs), c_right the lowest cost of the matched right pixel, and range that of all costs.
    entropy : -ln(-NEM / ln D), with the negative entropy NEM = sum p ln p of p(d) = exp(-c(d)) / sum exp(-c). It has
        the order of NEM, and depends on the unit of the cost.
    ambiguity : Pandora's confidence from ambiguity, in [0, 1]. With all costs of the volume normalised to 0..1, the
        number of candidates with c <= c1 + eta, summed over eta = 0, 0.01, ... 0.69; clipped to its 1 % and 99 %
        percentiles, normalised, and subtracted from 1. A candidate without a partner counts as near.
        Source: Sarrazin et al., "Ambiguity concept in stereo matching pipeline", ISPRS Archives XLIII-B2, 2021.

    Raises InputError for an unknown measure, and for a volume that is not (H, W, D).
    """
    check_known("confidence", measure, CONFIDENCES)
    if volume.ndim != 3 or 0 in volume.shape:
        raise InputError(
            f"a cost volume has shape {volume.shape}; expected (height, width, disparities)"
        )
    finite = np.isfinite(volume)
    low = float(np.min(volume, where=finite, initial=np.inf))
    high = float(np.max(volume, where=finite, initial=-np.inf))
    if not low < high:
        return np.zeros(volume.shape[:2], np.float32)
    if measure == "ambiguity":
        return _ambiguity(volume.astype(np.float32, copy=False), low, high)
    result = np.zeros(volume.shape[:2], np.float32)
    for y, row in enumerate(volume):
        candidates = np.isfinite(row).any(axis=-1)
        pixels = _Pixels(row[candidates].astype(np.float64), low, high)
        if measure == "left_right":
            partners = np.flatnonzero(candidates) - min_disparity - pixels.winner
            of_right = _right_lowest(row, min_disparity)[partners]
            result[y, candidates] = _left_right(pixels, of_right)
        else:
            result[y, candidates] = _OF_COSTS[measure](pixels)
    return result


def _right_lowest(row: NDArray[Any], min_disparity: int) -> NDArray[np.float64]:
    """(W,): of each right pixel of a row the lowest cost; the left pixel of candidate j is min_disparity + j beyond."""
    width, depth = row.shape
    lowest = np.full(width, np.inf)
    for j in range(depth):
        shift = min_disparity + j
        first, last = max(0, -shift), min(width, width - shift)
        if first < last:
            lowest[first:last] = np.minimum(
                lowest[first:last], row[first + shift : last + shift, j]
            )
    return lowest


def _ambiguity(volume: NDArray[np.float32], low: float, high: float) -> Confidence:
    from twinlens.matching.kernels.winners import near_counts

    # In float32 and in this order, as Pandora computes it: costs at a step's bound are frequent.
    span = np.float32(high) - np.float32(low)
    counts = np.empty(volume.shape[:2], np.float32)
    for y, row in enumerate(volume):
        near_counts((row - np.float32(low)) / span, AMBIGUITY_STEPS, counts[y])
    # Outliers of both ends are clipped, and the rest is normalised to 0..1.
    lower = np.percentile(counts, AMBIGUITY_PERCENT)
    upper = np.percentile(counts, 100.0 - AMBIGUITY_PERCENT)
    clipped = np.clip(counts, lower, upper, dtype=np.float32)
    least, most = clipped.min(), clipped.max()
    if least == most:
        return np.zeros(counts.shape, np.float32)
    return np.asarray(1 - (clipped - least) / (most - least), np.float32)
