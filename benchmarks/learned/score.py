"""Scores of networks and of hand-made costs: bad2.0 of the pixels that both views see, per pair."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twinlens.matching import parse_method
from twinlens.scoring import Pair, evaluate

RESAMPLES = 2000


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


def interval(differences: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """95 % bootstrap interval of the mean of differences (seeds, pairs), both resampled."""
    random = np.random.default_rng(seed)
    seeds, pairs = differences.shape
    rows = random.integers(seeds, size=(RESAMPLES, seeds, 1))
    columns = random.integers(pairs, size=(RESAMPLES, 1, pairs))
    means = differences[rows, columns].mean(axis=(1, 2))
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)
