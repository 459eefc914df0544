"""`evaluate`: one disparity map against one truth, by one protocol, over named regions. Knows no file and no method."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinlens.dataset import Calibration
from twinlens.errors import InputError
from twinlens.scoring.checks import Disparity, Mask, disparity_map, mask_of
from twinlens.scoring.cloud import point_errors
from twinlens.scoring.protocols import Estimate, Pixels, Protocol, Range, find_protocol

RESERVED = ("all", "nonocc")


@dataclass(frozen=True)
class RegionScores(Mapping[str, float]):
    """The metrics of one region, read like a dict: `scores.all["bad2.0"]`. With the counts they were divided by.

    Percentages are 0 to 100, errors in pixels; NaN where a metric has no pixel to speak of.
    image: pixels of the truth. evaluated: of these, inside the region and with known truth. estimated: of these, with
    an estimate of the method's own.
    """

    region: str
    metrics: Mapping[str, float]
    image: int
    evaluated: int
    estimated: int

    def __getitem__(self, name: str) -> float:
        return self.metrics[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.metrics)

    def __len__(self) -> int:
        return len(self.metrics)


@dataclass(frozen=True)
class Scores:
    """What `evaluate` answers: the scores of every region, and the protocol and range they were made by."""

    protocol: Protocol
    regions: Mapping[str, RegionScores]
    allowed: Range
    upsampled: int
    rounded: bool

    @property
    def all(self) -> RegionScores:
        """Every pixel with known truth."""
        return self.regions["all"]

    @property
    def nonocc(self) -> RegionScores:
        """Pixels with known truth that both cameras see; InputError if no mask_nonocc was given."""
        if "nonocc" not in self.regions:
            raise InputError("no scores for region 'nonocc': evaluate(..., mask_nonocc=mask) makes them")
        return self.regions["nonocc"]


def evaluate(
    disp: ArrayLike,
    gt: ArrayLike,
    mask_nonocc: ArrayLike | None = None,
    ndisp: float | None = None,
    *,
    protocol: str | Protocol = "middlebury-v3",
    regions: Mapping[str, ArrayLike] | None = None,
    round_disparity: bool = False,
    min_disparity: float = 0.0,
    calibration: Calibration | None = None,
) -> Scores:
    """Score a disparity map against the truth.

    Parameters
    ----------
    disp
        (H, W) estimate in pixels, +inf where the method does not know. Under Middlebury v3 also (H/2, W/2) or
        (H/4, W/4): then each value is scaled up and repeated, as its evaluator does.
    gt
        (H, W) truth in pixels, +inf where unknown; unknown truth is never evaluated.
    mask_nonocc
        (H, W) bool, or uint8 where only 255 counts. Without it there is no `nonocc` region.
    ndisp
        The number of disparities at the resolution of `disp`; Middlebury v3 clips estimates to [0, ndisp]. None: no
        upper limit.
    protocol
        A name in `PROTOCOLS`, or a `Protocol`.
    regions
        More regions: name -> (H, W) mask, bool or uint8.
    round_disparity
        Round estimates to whole pixels (halves away from zero) after clipping, as Middlebury v3 does for methods that
        answer in integers when the truth is of higher resolution than the map.
    min_disparity
        The smallest disparity that can occur, for rigs with doffs != 0; clipping is then to
        [min_disparity, min_disparity + ndisp].
    calibration
        The pair's; needed by the protocol "points", whose errors are in metres, and used by no other.

    Errors are differences in float64 of the values given, so a threshold is compared without a further rounding.

    Raises
    ------
    InputError
        NaN or -inf anywhere, sizes that do not fit, a bad mask, an unknown protocol, a region named twice.

    >>> scores = evaluate([[3.0, 5.5, np.inf]], [[3.0, 4.0, 7.0]])
    >>> scores.all["bad1.0"], scores.all["totbad1.0"], scores.all["avgerr"], scores.all.evaluated
    (33.333333333333336, 66.66666666666667, 0.75, 3)
    """
    rules = find_protocol(protocol)
    if rules.needs_calibration and calibration is None:
        raise InputError(f"{rules.title} needs the pair's calibration: evaluate(..., calibration=...)")
    truth, estimate = disparity_map("gt", gt), disparity_map("disp", disp)
    scale = _scale(estimate.shape, truth.shape, rules)
    allowed = _range(ndisp, min_disparity, scale)
    prepared = rules.prepare(_upsample(estimate, scale), allowed)
    if round_disparity:
        prepared = Estimate(_round_half_away(prepared.disp), prepared.given)
    masks = _masks(truth, mask_nonocc, regions or {})
    scored = {name: _score(rules, name, prepared, truth, mask, calibration) for name, mask in masks.items()}
    return Scores(rules, scored, allowed, scale, round_disparity)


def _scale(found: tuple[int, ...], wanted: tuple[int, ...], rules: Protocol) -> int:
    """How many times the truth is larger than the estimate, in both directions alike."""
    for scale in rules.upsampling:
        if tuple(scale * n for n in found) == wanted:
            return scale
    whole = [scale for scale in rules.upsampling if all(n % scale == 0 for n in wanted)]
    allowed = " or ".join(str(tuple(n // scale for n in wanted)) for scale in whole)
    raise InputError(f"disp has shape {found}: {rules.title} expects {allowed} for a truth of {wanted}")


def _range(ndisp: float | None, min_disparity: float, scale: int) -> Range:
    if ndisp is not None and not (math.isfinite(ndisp) and ndisp > 0):
        raise InputError(f"ndisp is {ndisp}: expected a positive number of disparities")
    if not math.isfinite(min_disparity):
        raise InputError(f"min_disparity is {min_disparity}: expected a finite number of pixels")
    return Range(scale * min_disparity, math.inf if ndisp is None else scale * (min_disparity + ndisp))


def _upsample(disp: Disparity, scale: int) -> Disparity:
    if scale == 1:
        return disp
    repeated: Disparity = np.repeat(np.repeat(disp, scale, axis=0), scale, axis=1) * disp.dtype.type(scale)
    return repeated


def _round_half_away(disp: Disparity) -> Disparity:
    """C's round(): 0.5 -> 1, 1.5 -> 2, 2.5 -> 3; numpy's own rounds halves to even."""
    wide = disp.astype(np.float64)
    rounded: Disparity = np.copysign(np.floor(np.abs(wide) + 0.5), wide).astype(disp.dtype)
    return rounded


def _masks(truth: Disparity, nonocc: ArrayLike | None, regions: Mapping[str, ArrayLike]) -> dict[str, Mask]:
    taken = [name for name in regions if name in RESERVED]
    if taken:
        raise InputError(f"region {taken[0]!r} is made by evaluate itself: give it as mask_nonocc, or another name")
    masks: dict[str, Mask] = {"all": np.ones(truth.shape, np.bool_)}
    if nonocc is not None:
        masks["nonocc"] = mask_of("mask_nonocc", nonocc, truth.shape)
    return masks | {name: mask_of(f"region {name!r}", mask, truth.shape) for name, mask in regions.items()}


def _score(
    rules: Protocol, region: str, estimate: Estimate, truth: Disparity, mask: Mask, calibration: Calibration | None
) -> RegionScores:
    chosen = mask & np.isfinite(truth)
    true, found = truth[chosen].astype(np.float64), estimate.disp[chosen].astype(np.float64)
    metres = None
    if rules.needs_calibration and calibration is not None:
        metres = point_errors(found, true, np.argwhere(chosen), calibration)
    pixels = Pixels(np.abs(found - true), true, estimate.given[chosen], metres)
    return RegionScores(region, rules.measure(pixels), truth.size, true.size, int(np.count_nonzero(pixels.given)))
