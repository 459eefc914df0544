"""`reason_of`: why the estimate of a pixel is right or wrong. A board's page computes the same (report/page/why.js)."""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.matching import CostCurve, cost_curve, grey
from twinlens.matching.images import extended
from twinlens.scoring.consistency import mirrored
from twinlens.scoring.protocols import AGREE_PX
from twinlens.scoring.regions import occluded
from twinlens.scoring.samples import Pair

LIMITS = {
    "right_px": 2.0, "jump_px": 2.0, "other_surface": 0.05, "other_depth": 0.25, "saturated": 0.25,
    "saturated_level": 254 / 255, "no_texture": 4.0, "repeated": 0.8, "blur": 2.0, "close": 0.1,
}  # fmt: skip
"""Pixels, shares of the window, a share of the largest level, grey levels of 0..255, a correlation, a ratio, and a
share of the way from the lowest to the median cost; the page's script reads them."""


class Reason(NamedTuple):
    """kind: unknown, right, range, occluded, saturation, discontinuity, texture, repetition, blur or other.

    Of a pair without truth: texture, range, repetition, occluded, ambiguous, unmatched, other or none.
    """

    kind: str
    text: str


def reason_of(pair: Pair, curve: CostCurve, estimate: float | None = None) -> Reason:
    """The first reason that holds, in the order of docs/benchmark.md, for an estimate at the curve's pixel.

    estimate: in pixels, +inf if there is none; by default the curve's `disparity`. Windows are those of its matcher.
    For a pair without truth: `likely_cause`, the likely cause of an error.
    """
    if pair.disp0 is None:
        return likely_cause(pair, curve, estimate)
    truth = float(pair.truth[curve.v, curve.u])
    disparity = curve.disparity if estimate is None else estimate
    if not math.isfinite(truth):
        return Reason("unknown", "The truth is unknown here.")
    error = disparity - truth
    if abs(error) <= LIMITS["right_px"]:
        return Reason("right", f"Right: {abs(error):.2f} px from the truth.")
    wrong = "No estimate"
    if math.isfinite(disparity):
        wrong = f"Wrong by {'+' if error > 0 else '−'}{abs(error):.1f} px"
    case = _Case(pair, curve, truth, disparity)
    for cause in _CAUSES:
        reason = cause(case)
        if reason is not None:
            return Reason(reason.kind, f"{wrong}: {reason.text}.")
    costs = ""
    if math.isfinite(disparity):
        at_estimate, at_truth = _cost(curve, disparity), _cost(curve, truth)
        costs = (
            f"; the cost is {at_estimate} at the estimate and {at_truth} at the truth"
        )
    return Reason("other", f"{wrong}: no known cause{costs}.")


def likely_cause(pair: Pair, curve: CostCurve, estimate: float | None = None) -> Reason:
    """What may be wrong with an estimate, without truth: whether there is a sign of trouble, and its likely cause.

    Arguments as for `reason_of`. The signs: no estimate, one at an end of the range, a right map that disagrees, a
    second minimum that costs nearly as little. Of the causes the first that holds is named, in the order of
    docs/real_pairs.md.
    """
    disparity = curve.disparity if estimate is None else estimate
    if curve.winner is None:
        return Reason("unmatched", "No candidate has a match in the right image.")
    doubt = _Doubt(pair, curve, disparity)
    if not doubt.has_sign:
        return Reason("none", "No sign of trouble, which is no proof.")
    start = "Doubtful" if doubt.has_estimate else "No estimate"
    for cause in _LIKELY_CAUSES:
        reason = cause(doubt)
        if reason is not None:
            return Reason(reason.kind, f"{start}: {reason.text}.")
    return Reason("other", f"{start}: no known cause.")


class _Doubt:
    """An estimate without truth: the signs that it may be wrong, and what its windows look like."""

    def __init__(self, pair: Pair, curve: CostCurve, disparity: float) -> None:
        self.pair = pair
        self.curve = curve
        self.disparity = disparity
        self.has_estimate = math.isfinite(disparity)
        self.low, self.high = int(curve.disparities[0]), int(curve.disparities[-1])

    @property
    def has_sign(self) -> bool:
        """Whether anything speaks against the estimate."""
        if not self.has_estimate or self.at_end or self.is_close:
            return True
        return not abs(self.disparity - self.of_right) <= AGREE_PX

    @property
    def at_end(self) -> bool:
        """Whether the estimate, or else the winner, is the first or the last candidate."""
        chosen = self.curve.winner
        if self.has_estimate:
            chosen = _rounded(self.disparity)
        return chosen is not None and not self.low < chosen < self.high

    @property
    def is_close(self) -> bool:
        """Whether the rival's cost is near the lowest one, on the scale from the lowest to the median cost."""
        if self.curve.rival is None:
            return False
        finite = self.curve.costs[np.isfinite(self.curve.costs)]
        lowest, middle = float(finite.min()), float(np.median(finite))
        rival = self.curve.cost_at(self.curve.rival)
        return rival - lowest <= LIMITS["close"] * (middle - lowest)

    @property
    def period(self) -> int:
        """From the winner to the rival, pixels; 0 without a rival."""
        winner, rival = self.curve.winner, self.curve.rival
        return 0 if winner is None or rival is None else rival - winner

    @property
    def match(self) -> int:
        """The column of the estimate's match in the right image."""
        return self.curve.u - _rounded(self.disparity)

    @functools.cached_property
    def of_right(self) -> float:
        """What the curve's matcher finds for the matched pixel of the right image; NaN without a match there."""
        if not self.has_estimate or not 0 <= self.match < self.pair.shape[1]:
            return math.nan
        views = mirrored(self.pair)
        column = self.pair.shape[1] - 1 - self.match
        matchers = {"right": self.curve.matcher}
        curves = cost_curve(views.im0, views.im1, column, self.curve.v, matchers)
        return curves["right"].disparity

    def left_window(self, shift: int = 0) -> "_Window":
        """The matcher's window in the left image, `shift` pixels to the left of the pixel."""
        scale = 255.0 / float(np.iinfo(self.pair.im0.dtype).max)
        radius = self.curve.matcher.window // 2
        image = scale * grey(self.pair.im0)
        return _Window(image, self.curve.u - shift, self.curve.v, radius)


def _likely_texture(doubt: _Doubt) -> Reason | None:
    return _texture_reason(doubt.left_window())


def _likely_range(doubt: _Doubt) -> Reason | None:
    if not doubt.at_end:
        return None
    searched = f"{doubt.low} to {doubt.high}"
    text = f"the disparity is at an end of the searched range {searched}, so the true one may be outside"
    return Reason("range", text)


def _likely_repetition(doubt: _Doubt) -> Reason | None:
    """The rival costs nearly as little, and the left window is like the one that far away in the left image."""
    if not doubt.is_close:
        return None
    here, there = doubt.left_window(), doubt.left_window(doubt.period)
    correlation = _correlation(here.pixels, there.pixels)
    if correlation < LIMITS["repeated"]:
        return None
    distance = f"{abs(doubt.period)} px (correlation {correlation:.2f})"
    text = f"the texture repeats after {distance}, where the cost is nearly as low"
    return Reason("repetition", text)


def _likely_occlusion(doubt: _Doubt) -> Reason | None:
    if not doubt.has_estimate:
        return None
    if doubt.match < 0:
        return Reason("occluded", "its match is outside the right image")
    if not math.isfinite(doubt.of_right):
        return Reason("occluded", "the right map has no estimate at its match")
    gap = abs(doubt.disparity - doubt.of_right)
    if gap <= AGREE_PX:
        return None
    text = f"the right map differs by {gap:.1f} px at its match; the point may be hidden from the right camera"
    return Reason("occluded", text)


def _likely_ambiguity(doubt: _Doubt) -> Reason | None:
    if not doubt.is_close:
        return None
    return Reason("ambiguous", f"{abs(doubt.period)} px away the cost is nearly as low")


_LIKELY_CAUSES: tuple[Callable[[_Doubt], Reason | None], ...] = (
    _likely_texture,
    _likely_range,
    _likely_repetition,
    _likely_occlusion,
    _likely_ambiguity,
)
"""The likely causes of a sign of trouble, in the order in which they are tried."""


class _Case:
    """A wrong estimate with the windows of its matcher: at the pixel, and at its true match in the right image."""

    def __init__(
        self, pair: Pair, curve: CostCurve, truth: float, disparity: float
    ) -> None:
        self.pair = pair
        self.curve = curve
        self.truth = truth
        self.disparity = disparity
        self.known = math.isfinite(disparity)
        self.radius = curve.matcher.window // 2
        top = float(np.iinfo(pair.im0.dtype).max)
        self.left_image = 255.0 / top * grey(pair.im0)
        right_image = 255.0 / top * grey(pair.im1)
        self.left = self.left_window(curve.u)
        matched = _rounded(curve.u - truth)
        self.right = _Window(right_image, matched, curve.v, self.radius)

    def left_window(self, u: int) -> "_Window":
        """The left image's window at column u of the row."""
        return _Window(self.left_image, u, self.curve.v, self.radius)

    @functools.cached_property
    def surroundings(self) -> Float:
        """The known true disparities in the window."""
        u, v, radius = self.curve.u, self.curve.v, self.radius
        rows = slice(max(0, v - radius), v + radius + 1)
        columns = slice(max(0, u - radius), u + radius + 1)
        disparities = self.pair.truth[rows, columns]
        return disparities[np.isfinite(disparities)].astype(np.float64)

    @functools.cached_property
    def other_surface(self) -> NDArray[np.bool_]:
        """Which of the surroundings are beyond a depth jump."""
        return np.abs(self.surroundings - self.truth) >= LIMITS["jump_px"]

    @property
    def other_share(self) -> float:
        """The share of the surroundings beyond a depth jump."""
        return float(np.mean(self.other_surface))

    @property
    def depths(self) -> str:
        """What a reason says of the other depths in the window."""
        share = _rounded(100 * self.other_share)
        return f"discontinuity: {share}% of the window has another depth"


def _outside_range(case: _Case) -> Reason | None:
    low, high = int(case.curve.disparities[0]), int(case.curve.disparities[-1])
    if low - 0.5 <= case.truth <= high + 0.5:
        return None
    text = f"the true disparity {case.truth:.1f} is outside the searched range {low} to {high}"
    return Reason("range", text)


def _occlusion(case: _Case) -> Reason | None:
    mask = case.pair.mask0_nonocc
    if mask is None or not occluded(mask)[case.curve.v, case.curve.u]:
        return None
    text = "the point is occluded, that is hidden from the right camera or outside its image"
    return Reason("occluded", text)


def _saturation(case: _Case) -> Reason | None:
    level = 255 * LIMITS["saturated_level"] - 1e-6
    shares = [
        float(np.mean(window.pixels > level)) for window in (case.left, case.right)
    ]
    saturated = max(shares)
    if saturated < LIMITS["saturated"]:
        return None
    percent = _rounded(100 * saturated)
    return Reason("saturation", f"{percent}% of the window is saturated")


def _estimate_of_other_surface(case: _Case) -> Reason | None:
    agrees = np.abs(case.surroundings - case.disparity) <= 1
    agreeing = float(np.mean(case.other_surface & agrees))
    if not case.known or agreeing < LIMITS["other_surface"]:
        return None
    text = f"{case.depths}, and the estimate is of that surface"
    return Reason("discontinuity", text)


def _no_texture(case: _Case) -> Reason | None:
    return _texture_reason(case.left)


def _texture_reason(window: "_Window") -> Reason | None:
    level = math.sqrt(window.texture)
    if level >= LIMITS["no_texture"]:
        return None
    difference = f"RMS difference of neighbours {level:.1f} grey levels"
    return Reason("texture", f"the window has no texture ({difference})")


def _repetition(case: _Case) -> Reason | None:
    """The left window is like the one that the estimate's window would have in the left image, `error` px away."""
    if not case.known:
        return None
    error = case.disparity - case.truth
    width = case.left_image.shape[1]
    correlation = -1.0
    for shift in {math.floor(error), math.ceil(error)}:
        u = case.curve.u - shift
        if abs(shift) >= 2 and 0 <= u < width:
            window = case.left_window(u)
            correlation = max(
                correlation, _correlation(case.left.pixels, window.pixels)
            )
    if correlation < LIMITS["repeated"]:
        return None
    text = f"the texture repeats after {_rounded(abs(error))} px (correlation {correlation:.2f})"
    return Reason("repetition", text)


def _many_other_depths(case: _Case) -> Reason | None:
    if case.other_share < LIMITS["other_depth"]:
        return None
    return Reason("discontinuity", case.depths)


def _blur(case: _Case) -> Reason | None:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.divide(case.left.sharpness, case.right.sharpness)
        blurred = max(ratio, 1 / ratio) >= LIMITS["blur"]
    if not blurred:
        return None
    softer, sharper = ("right", "left") if ratio > 1 else ("left", "right")
    return Reason("blur", f"the {softer} window is more blurred than the {sharper} one")


def _some_other_depths(case: _Case) -> Reason | None:
    if case.other_share < LIMITS["other_surface"]:
        return None
    return Reason("discontinuity", case.depths)


_CAUSES: tuple[Callable[[_Case], Reason | None], ...] = (
    _outside_range,
    _occlusion,
    _saturation,
    _estimate_of_other_surface,
    _no_texture,
    _repetition,
    _many_other_depths,
    _blur,
    _some_other_depths,
)
"""The possible causes of an error, in the order in which they are tried."""


class _Window:
    """The window of a radius around (u, v), grey levels 0..255; edge pixels repeat."""

    def __init__(self, image: Float, u: int, v: int, radius: int) -> None:
        rows = v - radius, v + radius + 1
        columns = u - radius, u + radius + 2  # one more, for the differences
        wide = extended(image, rows, columns)
        self.pixels: Float = wide[:, :-1]
        self.texture = float(np.mean(np.diff(wide, axis=1) ** 2))

    @property
    def sharpness(self) -> np.float64:
        """The mean square of horizontal differences over the variance: blur lowers it, gain does not change it."""
        return np.float64(self.texture) / np.var(self.pixels)


def _correlation(a: NDArray[Any], b: NDArray[Any]) -> float:
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def _rounded(value: float) -> int:
    """Halves upwards, as in the page's script."""
    return math.floor(value + 0.5)


def _cost(curve: CostCurve, disparity: float) -> str:
    place = _rounded(disparity - curve.disparities[0])
    nearest = np.clip(place, 0, len(curve.costs) - 1)
    return f"{curve.costs[nearest]:.3g}"
