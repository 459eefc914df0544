"""Agreement of two leaderboards: rank correlation of their methods, with bootstrap intervals over samples."""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # imports scipy.stats at its first use, which takes 0.7 s
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.scoring.board import Board
from twinlens.scoring.board_file import read_board
from twinlens.scoring.metrics import find_metric
from twinlens.seeds import generator

Ranks = NDArray[np.float64]
LEVEL = 0.95


@dataclass(frozen=True)
class CorrelationInterval:
    """A correlation with the limits of its 95 % interval; NaN where the data do not determine it."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        if math.isnan(self.value):
            return "undefined: all methods tie, or a board has one sample"
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"


@dataclass(frozen=True)
class Move:
    """The mean ranks of one method on both boards; rank 1 is the best."""

    method: str
    rank_a: float
    rank_b: float


@dataclass(frozen=True)
class Agreement:
    """How alike two boards rank the methods that both have.

    tau, rho: Kendall's tau-b and Spearman's rho of the methods' mean ranks over samples, with intervals from resampling
    the samples of both boards. reliability_a, reliability_b: tau-b between two random halves of the samples of one
    board, mean and 2.5 to 97.5 percentiles; they limit the agreement of two boards. samples_a, samples_b: number of
    samples used. moves: every method, the largest difference of mean ranks first.
    """

    protocol: str
    region: str
    metric: str
    samples_a: int
    samples_b: int
    tau: CorrelationInterval
    rho: CorrelationInterval
    reliability_a: CorrelationInterval
    reliability_b: CorrelationInterval
    moves: tuple[Move, ...]


def agreement(
    board_a: Board | str | os.PathLike[str],
    board_b: Board | str | os.PathLike[str],
    *,
    protocol: str | None = None,
    region: str = "nonocc",
    metric: str | None = None,
    resamples: int = 1000,
    seed: int = 0,
) -> Agreement:
    """Compare the rankings of two boards, or of two board.json files or their folders.

    A method's rank on a board is the mean of its ranks on the samples, see `sample_ranks`.

    protocol: by default the first one that both boards have. metric: by default the protocol's headline. resamples:
    number of bootstrap resamples, and of random halves.

    Raises InputError for fewer than three methods in common, no protocol in common, or no sample left.

    References: Kendall, "The treatment of ties in ranking problems", Biometrika 33 (1945); Efron and Tibshirani, "An
    Introduction to the Bootstrap" (1993), chapter 13.
    """
    if resamples < 1:
        raise InputError(f"resamples is {resamples}: expected 1 or more")
    boards = [board if isinstance(board, Board) else read_board(board) for board in (board_a, board_b)]
    shared = [name for name in boards[0].protocols if name in boards[1].protocols]
    if protocol is None and not shared:
        names = "; ".join(", ".join(board.protocols) for board in boards)
        raise InputError(f"the boards share no protocol: {names}")
    protocol = shared[0] if protocol is None else protocol
    for board in boards:
        _, chosen = board.rules(protocol, region, metric, "both boards")
    methods = tuple(name for name in boards[0].methods if name in boards[1].methods)
    if len(methods) < 3:
        count = f"{len(methods)} method" + "s" * (len(methods) != 1)
        raise InputError(f"the boards share {count}: a comparison of rankings needs 3 or more")
    a, b = (sample_ranks(board, methods, protocol, region, chosen.name) for board in boards)
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    rng, tau, rho = generator(seed), scipy.stats.kendalltau, scipy.stats.spearmanr
    drawn = [
        [ranks[rng.integers(len(ranks), size=len(ranks))].mean(axis=0) for ranks in (a, b)] for _ in range(resamples)
    ]
    moves = [Move(m, float(x), float(y)) for m, x, y in zip(methods, mean_a, mean_b, strict=True)]
    return Agreement(
        protocol,
        region,
        chosen.name,
        len(a),
        len(b),
        _interval(_correlation(tau, mean_a, mean_b), [_correlation(tau, x, y) for x, y in drawn]),
        _interval(_correlation(rho, mean_a, mean_b), [_correlation(rho, x, y) for x, y in drawn]),
        _reliability(a, resamples, rng),
        _reliability(b, resamples, rng),
        tuple(sorted(moves, key=lambda move: -abs(move.rank_a - move.rank_b))),
    )


def sample_ranks(board: Board, methods: Sequence[str], protocol: str, region: str, metric: str) -> Ranks:
    """Ranks (samples, methods) of the methods on each sample; 1 is the best.

    Ties share their mean rank, failed methods the last ranks. Samples on which one of the methods was not run, or
    without pixels in the region, are left out. Raises InputError if none remains.
    """
    sign = 1.0 if find_metric(metric).lower_is_better else -1.0
    entries = {(e.sample, e.method): e for e in board.entries if e.protocol == protocol}
    rows = []
    for sample in board.samples:
        row = [entries.get((sample, method)) for method in methods]
        present = [entry for entry in row if entry is not None]
        if len(present) == len(methods) and any(entry.evaluated(region) for entry in present):
            rows.append([sign * entry.value(region, metric) for entry in present])
    if not rows:
        raise InputError(f"{board.title}: no sample has scores of all {len(methods)} shared methods in {region!r}")
    values = np.asarray(rows)
    return np.asarray(scipy.stats.rankdata(np.where(np.isnan(values), np.inf, values), axis=1))


def _reliability(ranks: Ranks, splits: int, rng: np.random.Generator) -> CorrelationInterval:
    if len(ranks) < 2:
        return CorrelationInterval(math.nan, math.nan, math.nan)
    halves = (np.array_split(rng.permutation(len(ranks)), 2) for _ in range(splits))
    tau = scipy.stats.kendalltau
    taus = [_correlation(tau, ranks[first].mean(axis=0), ranks[second].mean(axis=0)) for first, second in halves]
    return _interval(float(np.nanmean(taus)) if not np.isnan(taus).all() else math.nan, taus)


def _interval(value: float, values: Sequence[float]) -> CorrelationInterval:
    if np.isnan(values).all():
        return CorrelationInterval(value, math.nan, math.nan)
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.nanpercentile(values, (tail, 100.0 - tail))  # without resamples in which all mean ranks are equal
    return CorrelationInterval(value, float(low), float(high))


def _correlation(function: Callable[[Ranks, Ranks], Any], x: Ranks, y: Ranks) -> float:
    x, y = np.round(x, 9), np.round(y, 9)  # tied mean ranks may differ in the last bit
    return math.nan if np.ptp(x) == 0 or np.ptp(y) == 0 else float(function(x, y).statistic)
