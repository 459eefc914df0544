"""Signs that a disparity map is right but written wrongly: scaled, negated, flipped, of the other view, and so on.

Such a map scores as if the method were bad. Each hypothesis undoes one mistake. It is stated only if it removes more
than half of the errors, of the map as it is and of the best constant map, so that bad maps raise no doubt. Scores do
not use it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.scoring.metrics import Disparity, Mask

_ROWS = 64
"""About so many rows are examined."""
_LEAST_PIXELS = 200
_GOOD_ENOUGH = 0.9
_LEAST_GOOD, _LEAST_GAIN = 0.5, 0.1
_MOST_ERRORS_LEFT = 0.5
_TIGHTEST, _WIDEST, _TOLERANCE_OF_RANGE = 0.5, 2.0, 0.1
_FILL_SHARE, _FILL_ERROR = 0.01, 1.0
_END_SHARE = 0.05
_LEAST_FEATURES = 20
_FACTORS = {
    16.0: "values look scaled by 16: divide by 16, as cv2.StereoSGBM and StereoBM return 16 times the disparity",
    -16.0: "values look scaled by -16: divide by 16 and change the sign, the disparity is u_left - u_right",
    256.0: "values look scaled by 256: divide by 256, as PNG maps hold 256 times the disparity",
    1
    / 16: "values look divided by 16: multiply by 16 (a PNG map holds 256 times the disparity, not 16)",
    1 / 256: "values look divided by 256: multiply by 256",
    0.5: "values look halved: multiply by 2, as for a map that was computed at half size",
    0.25: "values look divided by 4: multiply by 4, as for a map that was computed at quarter size",
    2.0: "values look doubled: divide by 2, as for a map that was reduced to half size",
    -1.0: "values have the wrong sign: the disparity is u_left - u_right",
}
"""What to say of values that are the disparity times a factor."""
_NOT_PIXELS = "values look proportional to the disparity, but not in pixels: undo their normalisation"
_UNLIKE_ONE = (0.75, 1.33)
_ALLOWANCE = 0.02
"""By so much a fitted factor must be better than a known one."""


@dataclass(frozen=True)
class _Seen:
    """The rows of a map and of the truth that are examined, (R, W) float64: NaN where unknown or not compared.

    low, last : the ends of the search; `last` is +inf if it is not known.
    """

    estimate: Float
    truth: Float
    low: float
    last: float

    @property
    def tolerance(self) -> float:
        """Largest error of a good pixel, px: a tenth of the range of the truth, from 0.5 to 2."""
        low, high = np.nanquantile(self.truth, (0.05, 0.95))
        return float(np.clip(_TOLERANCE_OF_RANGE * (high - low), _TIGHTEST, _WIDEST))

    def good(self, estimate: Float, truth: Float | None = None) -> float:
        """Share of good pixels among those that are compared; 0 where these are few."""
        errors = np.abs(estimate - (self.truth if truth is None else truth))
        count = np.count_nonzero(~np.isnan(errors))
        if count < _LEAST_PIXELS:
            return 0.0
        return float(np.count_nonzero(errors <= self.tolerance) / count)

    @property
    def good_of_constant(self) -> float:
        """Share of good pixels of the best constant map."""
        sorted_truth = np.sort(self.truth[~np.isnan(self.truth)])
        ends = np.searchsorted(
            sorted_truth, sorted_truth + 2 * self.tolerance, side="right"
        )
        return float((ends - np.arange(sorted_truth.size)).max() / sorted_truth.size)

    @property
    def is_beyond_search(self) -> bool:
        """Whether most values are beyond the search, which no valid map is."""
        finite = self.estimate[~np.isnan(self.estimate)]
        outside = (finite < self.low - 1) | (finite > self.last + 1)
        return bool(np.mean(outside) > 0.5)


def mistake_of(
    estimate: Disparity,
    truth: Disparity,
    mask: Mask | None,
    low: float,
    last: float,
    doffs: float = 0.0,
) -> str:
    """What is probably wrong with a map, in one line; empty for most.

    estimate, truth : (H, W) in pixels, +inf unknown. mask : (H, W) of the pixels that both cameras see, if known.
    low, last : the ends of the search. doffs : disparity at infinity is -doffs.
    """
    if not np.isfinite(estimate).any():
        return "the map has no estimate: all of its values are +inf"
    fill = _fill_value(estimate, truth, low)
    values = np.where(np.isfinite(estimate), estimate, np.nan).astype(np.float64)
    if fill is not None:
        values[values == fill] = np.nan
    true = np.where(np.isfinite(truth), truth, np.nan).astype(np.float64)
    if mask is not None:
        true[~mask] = np.nan
    if fill == 16 * (low - 1):  # the mark of OpenCV's matchers, before it is divided
        return _FACTORS[16.0]
    doubt = _mistake(values, true, low, last, doffs)
    if doubt or fill is None:
        return doubt
    return f"many values are {fill:g}, which no pixel can have: mark unknown disparities as +inf"


def doubt_of_search(estimate: Disparity, low: float, last: float) -> str:
    """Whether a search looks too short, in one line, for a map without truth; empty for most.

    Matchers choose the end of the range for what lies beyond it, or any value. A range that reaches beyond the nearest
    surface has few estimates at its last disparity. Its first one counts only if it is not 0: there are far things.

    estimate : (H, W) in pixels, +inf unknown. low, last : the ends of the search.
    """
    finite = estimate[np.isfinite(estimate)]
    if not finite.size or last <= low:
        return ""
    ends = {"last": (last, finite >= last - 0.5)}
    if low != 0:
        ends["first"] = (low, finite <= low + 0.5)
    for name, (end, is_there) in ends.items():
        if np.mean(is_there) > _END_SHARE:
            option = "--num-disparities" if name == "last" else "--min-disparity"
            return (
                f"over {_END_SHARE:.0%} of the estimates are at the {name} disparity of the search, {end:g} px: the "
                f"range is probably too small; extend it with {option}"
            )
    return ""


def doubt_of_order(disparities: Float, low: float) -> str:
    """Whether left and right images look exchanged, in one line; empty for most pairs.

    disparities : (N,) of matching features, which were searched on both sides. low : the smallest disparity searched.
    Points in front of a rectified pair have disparities of one sign; those of an exchanged pair have the other.
    """
    if len(disparities) < _LEAST_FEATURES:
        return ""
    smallest, largest = np.quantile(disparities, (0.05, 0.95))
    if largest > min(low, 0.0) - 0.5:
        return ""
    return (
        f"left and right are probably exchanged: points of the images match at {smallest:.0f} to {largest:.0f} px, and "
        f"disparities from {low:g} px are searched; exchange im0 and im1, or set --min-disparity"
    )


def _fill_value(estimate: Disparity, truth: Disparity, low: float) -> float | None:
    """The value with which some programs mark unknown disparities: extreme, impossible, and that of many pixels."""
    fill = _frequent_end(estimate, low)
    return None if fill is None or _occurs(fill, estimate, truth) else fill


def _occurs(value: float, estimate: Disparity, truth: Disparity) -> bool:
    """Whether the truth has the value, which then is a disparity, or most estimates of this value are right."""
    finite = truth[np.isfinite(truth)]
    if finite.size and finite.min() <= value <= finite.max():
        return True
    there = truth[(estimate == value) & np.isfinite(truth)]
    is_right = np.abs(there - value) <= _FILL_ERROR
    return bool(there.size and np.mean(is_right) >= _GOOD_ENOUGH)


def _frequent_end(estimate: Disparity, low: float) -> float | None:
    """The smallest or largest value of a map if many pixels have it, outside the search or the image's width."""
    finite = estimate[np.isfinite(estimate)]
    outside = finite[(finite < low) | (finite >= estimate.shape[1])]
    if outside.size <= _FILL_SHARE * estimate.size:
        return None
    numbers, counts = np.unique(outside, return_counts=True)
    most = int(counts.argmax())
    is_extreme = numbers[most] in (finite.min(), finite.max())
    is_fill = is_extreme and counts[most] > _FILL_SHARE * estimate.size
    return float(numbers[most]) if is_fill and counts[most] < finite.size else None


def _mistake(values: Float, true: Float, low: float, last: float, doffs: float) -> str:
    """The hypothesis that explains most errors, if it explains enough; empty otherwise."""
    rows = slice(None, None, max(1, len(true) // _ROWS))
    seen = _Seen(values[rows], true[rows], low, last)
    compared = ~np.isnan(seen.estimate) & ~np.isnan(seen.truth)
    if np.count_nonzero(~np.isnan(seen.truth)) < _LEAST_PIXELS:
        return ""
    plain = seen.good(seen.estimate)
    if plain >= _GOOD_ENOUGH:
        return ""
    constant = seen.good_of_constant
    best, doubt = 0.0, ""
    candidates = [*_moved(values, true, rows, seen)]
    # A constant map says nothing about its scale.
    varies = compared.any() and np.ptp(seen.estimate[compared]) > 0
    if varies:
        candidates += _rescaled(seen, compared, doffs)
    for text, share, is_named in candidates:
        to_beat = plain if is_named and seen.is_beyond_search else max(plain, constant)
        explains = (
            share >= _LEAST_GOOD
            and share - plain >= _LEAST_GAIN
            and 1 - share < _MOST_ERRORS_LEFT * (1 - to_beat)
        )
        if explains and share > best:
            best, doubt = share, text
    return doubt


_Candidate = tuple[str, float, bool]
"""What to say, the share of good pixels, and whether the values are undone by a known factor."""


def _rescaled(
    seen: _Seen, compared: NDArray[np.bool_], doffs: float
) -> Iterator[_Candidate]:
    """Hypotheses about the values: known factors first, so that a fitted one has to be better."""
    for factor, text in _FACTORS.items():
        yield text, seen.good(seen.estimate / factor), True
    for shift, name in ((seen.low, "the smallest disparity"), (doffs, "doffs")):
        for sign, remedy in ((1, "subtract"), (-1, "add")):
            if abs(shift) > 2 * seen.tolerance:
                text = f"values look shifted by {name}: {remedy} {shift:g}"
                yield text, seen.good(seen.estimate - sign * shift), False
    values, true = seen.estimate[compared], seen.truth[compared]
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = float(np.median(values / true))
        if factor > 0 and not _UNLIKE_ONE[0] < factor < _UNLIKE_ONE[1]:
            share = seen.good(seen.estimate / factor)
            yield _NOT_PIXELS, share - _ALLOWANCE, False
        # Depth times disparity, from which doffs is taken, is the same at all pixels.
        product = float(np.median(values * (true + doffs)))
        depth = np.where(seen.estimate > 0, product / seen.estimate - doffs, np.nan)
        text = "values look like depth: convert them to disparity, fx * baseline / depth - doffs"
        yield text, seen.good(depth) if product > 0 else 0.0, False


def _moved(
    values: Float, true: Float, rows: slice, seen: _Seen
) -> Iterator[_Candidate]:
    """Hypotheses about places: flipped and transposed maps, and the map of the right view."""
    flips = {
        "the map looks mirrored left to right": values[:, ::-1],
        "the map looks upside down: its first row is the top one": values[::-1],
        "the map looks rotated by 180 degrees": values[::-1, ::-1],
    }
    if values.shape[0] == values.shape[1]:
        flips["the map looks transposed: its axes are [row, column]"] = values.T
    for text, moved in flips.items():
        yield text, seen.good(moved[rows]), False
    of_right = _right_view(true[rows])
    text = "the map looks like that of the right view: return the disparity of the left image's pixels"
    for sign in (1, -1):
        yield text, seen.good(sign * seen.estimate, of_right), False


def _right_view(true: Float) -> Float:
    """The disparities (R, W) of the right view's pixels, from those of the left's; NaN where none is known."""
    rows, columns = np.nonzero(~np.isnan(true))
    disparities = true[rows, columns]
    targets = np.rint(columns - disparities).astype(np.int64)
    inside = (targets >= 0) & (targets < true.shape[1])
    # The nearest surface, of the largest disparity, hides the others.
    nearest = np.full(true.shape, -np.inf)
    np.maximum.at(nearest, (rows[inside], targets[inside]), disparities[inside])
    return np.where(np.isfinite(nearest), nearest, np.nan)
