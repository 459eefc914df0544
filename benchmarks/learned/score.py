"""Scores of networks and of hand-made costs: bad2.0 of the pixels that both views see, per pair."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twinlens.matching import parse_method
from twinlens.scoring import Pair, evaluate

RESAMPLES = 20_000


def bad2(method: str, pairs: Sequence[Pair]) -> list[float]:
    """bad2.0 in percent of each pair, region nonocc, by the rules of Middlebury v3."""
    spec = parse_method(method)
    scores = []
    for pair in pairs:
        disparity = spec.match(pair.im0, pair.im1, **pair.search)
        result = evaluate(
            disparity, pair.disp0, pair.mask0_nonocc, pair.ndisp, min_disparity=pair.min_disparity,
            calibration=pair.calibration,
        )  # fmt: skip
        scores.append(result.nonocc["totbad2.0"])
    return scores


def network(file: Path, base: str = "sad", **options: object) -> str:
    """The method that matches with a network: windows for the base `sad`, semi-global for `sgm`."""
    return f"{base}:cost=onnx:{file}," + ",".join(f"{name}={value}" for name, value in options.items())


def interval(differences: np.ndarray, number: int = 1) -> tuple[float, float]:
    """Bootstrap interval of the mean of differences (seeds, pairs), both resampled.

    95 % for `number` intervals together (Bonferroni). With few seeds it is too narrow.
    """
    random = np.random.default_rng(0)
    seeds, pairs = differences.shape
    rows = random.integers(seeds, size=(RESAMPLES, seeds, 1))
    columns = random.integers(pairs, size=(RESAMPLES, 1, pairs))
    means = differences[rows, columns].mean(axis=(1, 2))
    low, high = np.quantile(means, [0.025 / number, 1 - 0.025 / number])
    return float(low), float(high)
