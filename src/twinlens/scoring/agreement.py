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
        notes = [
            f"no interval contains the uncertainty of {name}, {lacks}" for name in few
        ]
        if math.isnan(self.tau.value):
            notes.append("no correlation: all methods of a board tie")
        return notes


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
    boards = [_titled(board_a), _titled(board_b)]
    protocol = _shared_protocol(boards) if protocol is None else protocol
    for _, board in boards:
        _, chosen = board.rules(protocol, region, metric, "both boards")
    methods = _shared_methods(boards)
    ranks = []
    for title, board in boards:
        with located(title):
            ranks.append(sample_ranks(board, methods, protocol, region, chosen.name))
    a, b = ranks
    rng = generator(seed)
    drawn = _resamples(a, b, resamples, rng)
    return Agreement(
        protocol=protocol,
        region=region,
        metric=chosen.name,
        samples_a=sum(map(len, a)),
        samples_b=sum(map(len, b)),
        scenes_a=len(a),
        scenes_b=len(b),
        tau=_correlated(scipy.stats.kendalltau, a, b, drawn),
        rho=_correlated(scipy.stats.spearmanr, a, b, drawn),
        reliability_a=_reliability(a, resamples, rng),
        reliability_b=_reliability(b, resamples, rng),
        moves=_moves(methods, _mean(a), _mean(b)),
    )


def _moves(methods: Sequence[str], mean_a: Ranks, mean_b: Ranks) -> tuple[Move, ...]:
    """The mean ranks of every method, the largest difference first."""
    moves = [
        Move(method, float(rank_a), float(rank_b))
        for method, rank_a, rank_b in zip(methods, mean_a, mean_b, strict=True)
    ]
    return tuple(sorted(moves, key=lambda move: -abs(move.rank_a - move.rank_b)))


def _resamples(
    a: Sequence[Ranks], b: Sequence[Ranks], count: int, rng: np.random.Generator
) -> list[tuple[Ranks, Ranks]]:
    """Mean ranks of both boards for `count` draws of their scenes; none if neither has enough scenes to draw."""
    if max(len(a), len(b)) < LEAST_SCENES:
        return []
    return [(_resampled(a, rng), _resampled(b, rng)) for _ in range(count)]


def _correlated(
    correlation: Callable[..., Any],
    a: Sequence[Ranks],
    b: Sequence[Ranks],
    drawn: Sequence[tuple[Ranks, Ranks]],
) -> CorrelationInterval:
    """The correlation of the mean ranks of two boards, with the interval of those of the resamples."""
    values = [_correlation(correlation, *means) for means in drawn]
    return _interval(_correlation(correlation, _mean(a), _mean(b)), values)


def _titled(board: Board | str | os.PathLike[str]) -> tuple[str, Board]:
    """(title or path, board). Raises InputError for an empty board."""
    title = board.title if isinstance(board, Board) else str(board)
    loaded = board if isinstance(board, Board) else read_board(board)
    if not loaded.entries:
        raise InputError(f"{title}: has no entries; run `twinlens benchmark` into it")
    return title, loaded


def _shared_protocol(boards: Sequence[tuple[str, Board]]) -> str:
    (_, board_a), (_, board_b) = boards
    for name in board_a.protocols:
        if name in board_b.protocols:
            return name
    listed = "; ".join(", ".join(board.protocols) for _, board in boards)
    raise InputError(f"the boards share no protocol: {listed}")


def _shared_methods(boards: Sequence[tuple[str, Board]]) -> tuple[str, ...]:
    (_, board_a), (_, board_b) = boards
    methods = tuple(name for name in board_a.methods if name in board_b.methods)
    if len(methods) < 3:
        count = f"{len(methods)} method" + "s" * (len(methods) != 1)
        raise InputError(
            f"the boards share {count}: a comparison of rankings needs 3 or more"
        )
    return methods


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
        complete = len(present) == len(methods)
        if complete and any(entry.evaluated(region) for entry in present):
            values = [sign * entry.value(region, metric) for entry in present]
            scenes.setdefault(board.scene(sample), []).append(values)
    if not scenes:
        raise InputError(
            f"no sample has scores of all {len(methods)} shared methods in {region!r}"
        )
    ranks = []
    for rows in scenes.values():
        # A failed method has no value: as +inf it shares the last rank with other failed ones.
        scores = np.where(np.isnan(rows), np.inf, rows)
        ranks.append(scipy.stats.rankdata(scores, axis=1))
    return ranks


def _mean(scenes: Iterable[Ranks]) -> Ranks:
    """Mean ranks (methods,) over all samples of the scenes."""
    return np.asarray(np.concatenate([*scenes]).mean(axis=0))


def _resampled(scenes: Sequence[Ranks], rng: np.random.Generator) -> Ranks:
    """Mean ranks of as many scenes, drawn with replacement; of the scenes themselves if they are too few."""
    count = len(scenes)
    if count < LEAST_SCENES:
        return _mean(scenes)
    return _mean(scenes[i] for i in rng.integers(count, size=count))


def _reliability(
    scenes: Sequence[Ranks], splits: int, rng: np.random.Generator
) -> CorrelationInterval:
    if len(scenes) < LEAST_SCENES:
        return CorrelationInterval(math.nan, math.nan, math.nan)
    taus = []
    for _ in range(splits):
        first, second = np.array_split(rng.permutation(len(scenes)), 2)
        means = _mean(scenes[i] for i in first), _mean(scenes[i] for i in second)
        taus.append(_correlation(scipy.stats.kendalltau, *means))
    mean = math.nan if np.isnan(taus).all() else float(np.nanmean(taus))
    return _interval(mean, taus)


def _interval(value: float, values: Sequence[float]) -> CorrelationInterval:
    if np.isnan(values).all():
        return CorrelationInterval(value, math.nan, math.nan)
    tail = 50.0 * (1.0 - LEVEL)
    # Resamples in which all mean ranks are equal have no correlation and are left out.
    low, high = np.nanpercentile(values, (tail, 100.0 - tail))
    return CorrelationInterval(value, float(low), float(high))


def _correlation(function: Callable[[Ranks, Ranks], Any], x: Ranks, y: Ranks) -> float:
    x, y = np.round(x, 9), np.round(y, 9)  # tied mean ranks may differ in the last bit
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return math.nan
    return float(function(x, y).statistic)
