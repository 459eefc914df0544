"""Scores of networks and hand-made costs: bad2.0 of the pixels that both views see, for each pair."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from twinlens.dataset.files import write_file
from twinlens.matching import parse_method
from twinlens.scoring import Pair, evaluate
from twinlens.scoring.samples import fingerprint

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


def kept(
    methods: Iterable[str], pairs: Sequence[Pair], file: Path
) -> dict[str, list[float]]:
    """bad2.0 of each pair by each method. Scores that the file has of the same pairs are not made again."""
    fingerprints = [fingerprint(pair) for pair in pairs]
    stored = json.loads(file.read_text()) if file.exists() else {}
    scores = stored["scores"] if stored.get("pairs") == fingerprints else {}
    found = {}
    for method in methods:
        spec = parse_method(method).spec
        if spec not in scores:
            scores[spec] = bad2(method, pairs)
            write_file(
                file, json.dumps({"pairs": fingerprints, "scores": scores}).encode()
            )
            print(f"{file.stem}: {method}: {np.mean(scores[spec]):.2f}", flush=True)
        found[method] = scores[spec]
    return found


def method_of(file: Path, base: str, **options: object) -> str:
    """The method that matches with a network's descriptors and the optimisation and support of `base`."""
    return f"{base}:cost=onnx:{file}," + ",".join(
        f"{name}={value}" for name, value in options.items()
    )


def interval(differences: np.ndarray, number: int = 1) -> tuple[float, float]:
    """Bootstrap interval of the mean of differences (seeds, pairs), both resampled.

    The quantiles are those of 95 % for `number` intervals together (Bonferroni). The coverage is lower with few seeds:
    no resample is outside the range of theirs.
    """
    random = np.random.default_rng(0)
    seeds, pairs = differences.shape
    rows = random.integers(seeds, size=(RESAMPLES, seeds, 1))
    columns = random.integers(pairs, size=(RESAMPLES, 1, pairs))
    means = differences[rows, columns].mean(axis=(1, 2))
    low, high = np.quantile(means, [0.025 / number, 1 - 0.025 / number])
    return float(low), float(high)
