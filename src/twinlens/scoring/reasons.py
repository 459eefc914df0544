"""`reason_of`: why the estimate of a pixel is right or wrong. A board's page computes the same (report/page/why.js)."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.matching import CostCurve, grey
from twinlens.matching.images import extended
from twinlens.scoring.regions import occluded
from twinlens.scoring.samples import Pair

LIMITS = {
    "right_px": 2.0, "jump_px": 2.0, "other_surface": 0.05, "other_depth": 0.25, "saturated": 0.25,
    "saturated_level": 254 / 255, "no_texture": 4.0, "repeated": 0.8, "blur": 2.0,
}  # fmt: skip
"""Pixels, shares of the window, a share of the largest level, grey levels of 0..255, a correlation, and a ratio; the
page's script reads them."""


class Reason(NamedTuple):
    """kind: unknown, right, range, occluded, saturation, discontinuity, texture, repetition, blur or other."""

    kind: str
    text: str


def reason_of(pair: Pair, curve: CostCurve, estimate: float | None = None) -> Reason:
    """The first reason that holds, in the order of docs/benchmark.md, for an estimate at the curve's pixel.

    estimate: in pixels, +inf if there is none; by default the curve's `disparity`. Windows are those of its matcher.
    """
    at, r = (curve.v, curve.u), curve.matcher.window // 2
    d, found = float(pair.disp0[at]), curve.disparity if estimate is None else estimate
    if not math.isfinite(d):
        return Reason("unknown", "The truth is unknown here.")
    off, low, high = found - d, int(curve.disparities[0]), int(curve.disparities[-1])
    if abs(off) <= LIMITS["right_px"]:
        return Reason("right", f"Right: {abs(off):.2f} px from the truth.")
    known = math.isfinite(found)
    wrong = (
        f"Wrong by {'+' if off > 0 else '−'}{abs(off):.1f} px"
        if known
        else "No estimate"
    )

    def say(kind: str, text: str) -> Reason:
        return Reason(kind, f"{wrong}: {text}.")

    if not low - 0.5 <= d <= high + 0.5:
        return say(
            "range",
            f"the true disparity {d:.1f} is outside the searched range {low} to {high}",
        )
    if pair.mask0_nonocc is not None and occluded(pair.mask0_nonocc)[at]:
        return say(
            "occluded",
            "the point is occluded, that is hidden from the right camera or outside its image",
        )
    top = float(np.iinfo(pair.im0.dtype).max)
    left, right = (255.0 / top * grey(image) for image in (pair.im0, pair.im1))
    here, there = (
        _Window(left, curve.u, curve.v, r),
        _Window(right, _rounded(curve.u - d), curve.v, r),
    )
    saturated = max(
        float(np.mean(w.pixels > 255 * LIMITS["saturated_level"] - 1e-6))
        for w in (here, there)
    )
    if saturated >= LIMITS["saturated"]:
        return say(
            "saturation", f"{_rounded(100 * saturated)}% of the window is saturated"
        )
    near = pair.disp0[
        max(0, curve.v - r) : curve.v + r + 1, max(0, curve.u - r) : curve.u + r + 1
    ]
    near = near[np.isfinite(near)].astype(np.float64)
    jumps = np.abs(near - d) >= LIMITS["jump_px"]
    other = float(np.mean(jumps))
    depths = f"discontinuity: {_rounded(100 * other)}% of the window has another depth"
    if (
        known
        and np.mean(jumps & (np.abs(near - found) <= 1)) >= LIMITS["other_surface"]
    ):
        return say("discontinuity", f"{depths}, and the estimate is of that surface")
    level = math.sqrt(here.texture)
    if level < LIMITS["no_texture"]:
        return say(
            "texture",
            f"the window has no texture (RMS difference of neighbours {level:.1f} grey levels)",
        )
    shifts = {math.floor(off), math.ceil(off)} if known else set()
    places = [
        curve.u - s for s in shifts if abs(s) >= 2 and 0 <= curve.u - s < left.shape[1]
    ]
    alike = max(
        (
            _correlation(here.pixels, _Window(left, u, curve.v, r).pixels)
            for u in places
        ),
        default=-1.0,
    )
    if alike >= LIMITS["repeated"]:
        return say(
            "repetition",
            f"the texture repeats after {_rounded(abs(off))} px (correlation {alike:.2f})",
        )
    if other >= LIMITS["other_depth"]:
        return say("discontinuity", depths)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.divide(here.sharpness, there.sharpness)
        blurred = max(ratio, 1 / ratio) >= LIMITS["blur"]
    if blurred:
        sides = ("right", "left") if ratio > 1 else ("left", "right")
        return say(
            "blur", f"the {sides[0]} window is more blurred than the {sides[1]} one"
        )
    if other >= LIMITS["other_surface"]:
        return say("discontinuity", depths)
    costs = (
        f"; the cost is {_cost(curve, found)} at the estimate and {_cost(curve, d)} at the truth"
        if known
        else ""
    )
    return say("other", f"no known cause{costs}")


class _Window:
    """The window of radius r around (u, v), grey levels 0..255; edge pixels repeat."""

    def __init__(self, image: Float, u: int, v: int, r: int) -> None:
        wide = extended(image, (v - r, v + r + 1), (u - r, u + r + 2))
        self.pixels: Float = wide[:, :-1]
        self.texture = float(np.mean(np.diff(wide, axis=1) ** 2))

    @property
    def sharpness(self) -> np.float64:
        """The mean square of horizontal differences over the variance: blur lowers it, gain does not change it."""
        return np.float64(self.texture) / np.var(self.pixels)


def _correlation(a: NDArray[Any], b: NDArray[Any]) -> float:
    return (
        0.0
        if np.ptp(a) == 0 or np.ptp(b) == 0
        else float(np.corrcoef(a.ravel(), b.ravel())[0, 1])
    )


def _rounded(value: float) -> int:
    """Halves upwards, as in the page's script."""
    return math.floor(value + 0.5)


def _cost(curve: CostCurve, disparity: float) -> str:
    nearest = np.clip(
        _rounded(disparity - curve.disparities[0]), 0, len(curve.costs) - 1
    )
    return f"{curve.costs[nearest]:.3g}"
