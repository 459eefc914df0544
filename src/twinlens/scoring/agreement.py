"""Agreement of two leaderboards: rank correlation of their methods, with bootstrap intervals over scenes."""

import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # imports scipy.stats at its first use, which takes 0.7 s
from numpy.typing import NDArray

from twinlens.errors import InputError, located
from twinlens.scoring.board import Board
from twinlens.scoring.board_file import read_board
from twinlens.scoring.metrics import find_metric
from twinlens.seeds import generator

Ranks = NDArray[np.float64]
LEVEL = 0.95
LEAST_SCENES = 4
"""A board of fewer scenes is not resampled: its intervals would be too narrow."""


@dataclass(frozen=True)
class CorrelationInterval:
    """A correlation with the limits of its 95 % interval; NaN where the data do not determine it."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        if math.isnan(self.value):
            return "-"
        limits = "-" if math.isnan(self.low) else f"{self.low:.2f} to {self.high:.2f}"
        return f"{self.value:.2f} ({limits})"


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
    the scenes of both boards. A board of fewer than `LEAST_SCENES` is not resampled: the intervals do not contain its
    uncertainty. reliability_a, reliability_b: tau-b between two random halves of the scenes of one board, mean and 2.5
    to 97.5 percentiles: the agreement of boards with half the scenes. samples_a, scenes_a, ...: number of samples used,
    and of their scenes. moves: every method, the largest difference of mean ranks first.
    """

    protocol: str
    region: str
    metric: str
    samples_a: int
    samples_b: int
    scenes_a: int
    scenes_b: int
    tau: CorrelationInterval
    rho: CorrelationInterval
    reliability_a: CorrelationInterval
    reliability_b: CorrelationInterval
    moves: tuple[Move, ...]

    def notes(self, names: tuple[str, str]) -> list[str]:
        """Why values are undefined, and what the intervals do not contain; names: what to call the boards."""
        scenes = zip(names, (self.scenes_a, self.scenes_b), strict=True)
        few = [name for name, count in scenes if count < LEAST_SCENES]
        lacks = f"which has fewer than {LEAST_SCENES} scenes"
        found = [
            f"no interval contains the uncertainty of {name}, {lacks}" for name in few
        ]
        return [
            *found,
            *(
                ["no correlation: all methods of a board tie"]
                if math.isnan(self.tau.value)
                else []
            ),
        ]


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

    A method's rank on a board is the mean of its ranks on the samples, see `sample_ranks`. Samples of one scene, such
    as its views and lenses, show the same surfaces and are not independent: scenes are resampled and split, each with
    all of its samples.

    protocol: by default the first one that both boards have. metric: by default the protocol's headline. resamples:
    number of bootstrap resamples, and of random halves.

    Raises InputError for an empty board, fewer than three methods in common, no protocol in common, or no sample left.

    References: Kendall, "The treatment of ties in ranking problems", Biometrika 33 (1945); Efron and Tibshirani, "An
    Introduction to the Bootstrap" (1993), chapter 13; resampling of clusters: Davison and Hinkley, "Bootstrap Methods
    and their Application" (1997), section 3.8.
    """
    if resamples < 1:
        raise InputError(f"resamples is {resamples}: expected 1 or more")
    boards = [
        board if isinstance(board, Board) else read_board(board)
        for board in (board_a, board_b)
    ]
    names = [
        board.title if isinstance(board, Board) else str(board)
        for board in (board_a, board_b)
    ]
    for name, board in zip(names, boards, strict=True):
        if not board.entries:
            raise InputError(
                f"{name}: has no entries; run `twinlens benchmark` into it"
            )
    shared = [name for name in boards[0].protocols if name in boards[1].protocols]
    if protocol is None and not shared:
        has = "; ".join(", ".join(board.protocols) for board in boards)
        raise InputError(f"the boards share no protocol: {has}")
    protocol = shared[0] if protocol is None else protocol
    for board in boards:
        _, chosen = board.rules(protocol, region, metric, "both boards")
    methods = tuple(name for name in boards[0].methods if name in boards[1].methods)
    if len(methods) < 3:
        count = f"{len(methods)} method" + "s" * (len(methods) != 1)
        raise InputError(
            f"the boards share {count}: a comparison of rankings needs 3 or more"
        )
    ranks = []
    for name, board in zip(names, boards, strict=True):
        with located(name):
            ranks.append(sample_ranks(board, methods, protocol, region, chosen.name))
    (a, b), (mean_a, mean_b) = ranks, map(_mean, ranks)
    rng, tau, rho = generator(seed), scipy.stats.kendalltau, scipy.stats.spearmanr
    varies = max(len(a), len(b)) >= LEAST_SCENES
    drawn = [
        [_resampled(a, rng), _resampled(b, rng)]
        for _ in range(resamples if varies else 0)
    ]
    moves = [
        Move(m, float(x), float(y))
        for m, x, y in zip(methods, mean_a, mean_b, strict=True)
    ]
    return Agreement(
        protocol,
        region,
        chosen.name,
        sum(map(len, a)),
        sum(map(len, b)),
        len(a),
        len(b),
        _interval(
            _correlation(tau, mean_a, mean_b),
            [_correlation(tau, x, y) for x, y in drawn],
        ),
        _interval(
            _correlation(rho, mean_a, mean_b),
            [_correlation(rho, x, y) for x, y in drawn],
        ),
        _reliability(a, resamples, rng),
        _reliability(b, resamples, rng),
        tuple(sorted(moves, key=lambda move: -abs(move.rank_a - move.rank_b))),
    )


def sample_ranks(
    board: Board, methods: Sequence[str], protocol: str, region: str, metric: str
) -> list[Ranks]:
    """For each scene of the board, the ranks of the methods on its samples, (samples, methods); 1 is the best.

    Ties share their mean rank, failed methods the last ranks. Samples on which one of the methods was not run, or
    without pixels in the region, are left out. Raises InputError if none remains.
    """
    sign = 1.0 if find_metric(metric).lower_is_better else -1.0
    entries = {(e.sample, e.method): e for e in board.entries if e.protocol == protocol}
    scenes: dict[str, list[list[float]]] = {}
    for sample in board.samples:
        row = [entries.get((sample, method)) for method in methods]
        present = [entry for entry in row if entry is not None]
        if len(present) == len(methods) and any(
            entry.evaluated(region) for entry in present
        ):
            scenes.setdefault(board.scene(sample), []).append(
                [sign * e.value(region, metric) for e in present]
            )
    if not scenes:
        raise InputError(
            f"no sample has scores of all {len(methods)} shared methods in {region!r}"
        )
    values = map(np.asarray, scenes.values())
    return [
        scipy.stats.rankdata(np.where(np.isnan(rows), np.inf, rows), axis=1)
        for rows in values
    ]


def _mean(scenes: Iterable[Ranks]) -> Ranks:
    """Mean ranks (methods,) over all samples of the scenes."""
    return np.asarray(np.concatenate([*scenes]).mean(axis=0))


def _resampled(scenes: Sequence[Ranks], rng: np.random.Generator) -> Ranks:
    """Mean ranks of as many scenes, drawn with replacement; of the scenes themselves if they are too few."""
    count = len(scenes)
    return _mean(
        scenes[i]
        for i in (
            rng.integers(count, size=count) if count >= LEAST_SCENES else range(count)
        )
    )


def _reliability(
    scenes: Sequence[Ranks], splits: int, rng: np.random.Generator
) -> CorrelationInterval:
    if len(scenes) < LEAST_SCENES:
        return CorrelationInterval(math.nan, math.nan, math.nan)
    halves = (np.array_split(rng.permutation(len(scenes)), 2) for _ in range(splits))
    pairs = ([_mean(scenes[i] for i in half) for half in both] for both in halves)
    taus = [_correlation(scipy.stats.kendalltau, *pair) for pair in pairs]
    return _interval(
        float(np.nanmean(taus)) if not np.isnan(taus).all() else math.nan, taus
    )


def _interval(value: float, values: Sequence[float]) -> CorrelationInterval:
    if np.isnan(values).all():
        return CorrelationInterval(value, math.nan, math.nan)
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.nanpercentile(
        values, (tail, 100.0 - tail)
    )  # without resamples in which all mean ranks are equal
    return CorrelationInterval(value, float(low), float(high))


def _correlation(function: Callable[[Ranks, Ranks], Any], x: Ranks, y: Ranks) -> float:
    x, y = np.round(x, 9), np.round(y, 9)  # tied mean ranks may differ in the last bit
    return (
        math.nan
        if np.ptp(x) == 0 or np.ptp(y) == 0
        else float(function(x, y).statistic)
    )
