"""`score_confidences`: all confidence measures of a matcher on one pair."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.matching import CONFIDENCES, StereoMatcher, confidence_map
from twinlens.matching.contract import check_image_size
from twinlens.scoring.evaluate import RegionScores, evaluate
from twinlens.scoring.samples import Pair


@dataclass(frozen=True)
class ConfidenceScores:
    """The measures of `matching.CONFIDENCES` by name: `maps` (H, W), and Middlebury v3's `scores` with each.

    errors: (H, W) |estimate - truth| in pixels, +inf where either is unknown. The scores are of pixels visible in both
    views, or of all if the pair has no mask; a pair without truth has none. estimates: pixels with an estimate.
    """

    errors: NDArray[np.float64]
    maps: Mapping[str, NDArray[np.float32]]
    scores: Mapping[str, RegionScores]
    estimates: int = 0


def score_confidences(pair: Pair, matcher: Any) -> ConfidenceScores:
    """Match the pair and score all confidence measures of the matcher's cost volume.

    Raises InputError unless it is a `StereoMatcher`, the only one with a cost volume, and if there is nothing to score.
    """
    if not isinstance(matcher, StereoMatcher):
        raise InputError(
            "this method has no cost volume; use a method of twinlens, such as zncc or sgm"
        )
    check_image_size(matcher, pair.shape)
    disparity = matcher.match(pair.im0, pair.im1)
    volume = matcher.cost_volume(pair.im0, pair.im1)
    has_both = np.isfinite(pair.truth) & np.isfinite(disparity)
    errors = np.full(disparity.shape, np.inf)
    errors[has_both] = np.abs(disparity[has_both] - pair.truth[has_both])
    maps = {
        name: confidence_map(volume, name, matcher.min_disparity)
        for name in CONFIDENCES
    }
    scores: dict[str, RegionScores] = {}
    estimates = int(np.count_nonzero(np.isfinite(disparity)))
    if pair.disp0 is None:
        return ConfidenceScores(errors, maps, scores, estimates)
    for name, confidence in maps.items():
        regions = evaluate(
            disparity, pair.truth, pair.mask0_nonocc, pair.ndisp,
            min_disparity=pair.min_disparity, confidence=confidence,
        )  # fmt: skip
        scores[name] = regions.all if pair.mask0_nonocc is None else regions.nonocc
        if not scores[name].estimated:
            raise InputError(
                f"{pair.name}: no pixel has a true disparity and an estimate"
            )
    return ConfidenceScores(errors, maps, scores, estimates)
