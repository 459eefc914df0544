"""Agreement of two leaderboards, beside SciPy, definitions pair by pair, and rankings with a known answer."""

import json
import math

import numpy as np
import pytest
from scipy import stats

from twinlens.cli import run
from twinlens.errors import InputError
from twinlens.scoring import PROTOCOLS, Board, Entry, agreement
from twinlens.scoring.agreement import sample_ranks
from twinlens.scoring.board import MatchFailure
from twinlens.scoring.board_file import write_board
from twinlens.scoring.evaluate import RegionScores

METRICS = PROTOCOLS["middlebury-v3"].metrics
HEADLINE = PROTOCOLS["middlebury-v3"].headline


def entry(method, sample, value, failure=None):
    scores = RegionScores(
        100, 100, 100, dict.fromkeys(METRICS, 0.0) | {HEADLINE: value}
    )
    regions = {} if failure else {"nonocc": scores}
    return Entry(
        method,
        method,
        sample,
        "0" * 64,
        "middlebury-v3",
        10,
        10,
        16,
        0.1,
        failure,
        regions,
    )


def board(values, title="board", scenes=None):
    """values: (samples, methods); NaN is a failure. scenes: the scene of each sample, by default its own."""
    crash = MatchFailure("crash", "it failed")
    return Board(
        title,
        tuple(
            entry(f"m{j}", f"s{i}", value, crash if math.isnan(value) else None)
            for i, row in enumerate(values)
            for j, value in enumerate(row)
        ),
        scenes={
            f"s{i}": str(scene)
            for i, scene in enumerate([] if scenes is None else scenes)
        },
    )


def clustered(seed, scenes, views, methods=6, spread=2.0):
    """(samples, methods) of scenes whose views differ little, and the scene of each sample."""
    rng = np.random.default_rng(seed)
    of_scenes = (
        np.arange(methods) + 20 + spread * rng.standard_normal((scenes, methods))
    )
    values = np.repeat(of_scenes, views, axis=0) + 0.1 * rng.standard_normal(
        (scenes * views, methods)
    )
    return values, np.repeat(np.arange(scenes), views).tolist()


def noisy(seed, samples=12, methods=8, noise=1.0):
    rng = np.random.default_rng(seed)
    return np.abs(
        np.arange(methods) + 5 + noise * rng.standard_normal((samples, methods))
    )


def test_tau_and_rho_equal_scipys_with_ties():
    """Coarse values tie often, within a sample and between mean ranks."""
    for seed in range(20):
        a, b = (np.round(noisy(seed + offset, 3, 7, 3.0)) for offset in (0, 100))
        result = agreement(board(a), board(b), resamples=2)
        means = [
            np.mean([stats.rankdata(row) for row in values], axis=0)
            for values in (a, b)
        ]
        assert result.tau.value == pytest.approx(
            stats.kendalltau(*means).statistic, abs=1e-12
        )
        assert result.rho.value == pytest.approx(
            stats.spearmanr(*means).statistic, abs=1e-12
        )


def test_a_board_agrees_with_itself_and_is_opposite_to_its_reverse():
    a = noisy(1, noise=0.0)
    assert agreement(board(a), board(a), resamples=5).tau.value == pytest.approx(1.0)
    opposite = agreement(board(a), board(a[:, ::-1]), resamples=5)
    assert opposite.tau.value == pytest.approx(-1.0)
    assert str(opposite.reliability_a) == "1.00 (1.00 to 1.00)"
    first = opposite.moves[0]
    assert (first.method, first.rank_a, first.rank_b) == ("m0", 1.0, 8.0)


@pytest.mark.slow
def test_the_bootstrap_covers_the_long_run_value():
    """95 % intervals from 16 samples contain the tau of 4000 samples in most of 40 repetitions."""
    order = [2, 0, 5, 1, 3, 7, 4, 6]
    truth = agreement(
        board(noisy(0, 4000)), board(noisy(1, 4000)[:, order]), resamples=1
    ).tau.value
    covered = 0
    for seed in range(40):
        a, b = noisy(1000 + 2 * seed, 16), noisy(1001 + 2 * seed, 16)[:, order]
        tau = agreement(board(a), board(b), resamples=200, seed=seed).tau
        covered += tau.low <= truth <= tau.high
    assert covered >= 33  # Binomial(40, 0.95) is below 33 with probability 0.003


def test_the_interval_is_that_of_scipys_bootstrap_of_scenes():
    """SciPy resamples indices of the scenes of one board; the other one has too few scenes to be resampled."""
    values, scenes = clustered(7, 8, 3)
    fixed = board(noisy(6, 1, 6))
    interval = agreement(board(values, scenes=scenes), fixed, resamples=1000).tau
    ranks, other = stats.rankdata(values, axis=1), stats.rankdata(noisy(6, 1, 6)[0])

    def tau(chosen):
        rows = np.concatenate(
            [np.flatnonzero(np.array(scenes) == scene) for scene in chosen]
        )
        return stats.kendalltau(ranks[rows].mean(axis=0).round(9), other).statistic

    limits = stats.bootstrap(
        (np.arange(8),),
        tau,
        n_resamples=1000,
        vectorized=False,
        method="percentile",
        rng=np.random.default_rng(1),
    ).confidence_interval
    step = 2 / 15  # of tau, for six methods
    assert interval.low == pytest.approx(limits.low, abs=step + 1e-9)
    assert interval.high == pytest.approx(limits.high, abs=step + 1e-9)


def test_copies_of_a_scenes_images_add_no_information():
    """Four copies of each sample give the interval and the halves of one, if the board has their scenes."""
    values, others = clustered(1, 8, 1)[0], board(clustered(2, 8, 1)[0])
    once = agreement(board(values, scenes=range(8)), others, resamples=300)
    repeated = np.repeat(values, 4, axis=0)
    copied = agreement(
        board(repeated, scenes=np.repeat(range(8), 4)), others, resamples=300
    )
    assert (copied.samples_a, copied.scenes_a) == (32, 8)
    assert (copied.tau, copied.rho, copied.reliability_a) == (
        once.tau,
        once.rho,
        once.reliability_a,
    )
    assert (
        agreement(board(repeated), others, resamples=300).reliability_a.low
        > once.reliability_a.low
    )


def test_without_recorded_scenes_the_lenses_of_a_view_are_one_scene():
    names = [
        f"{view} · {lens}"
        for view in range(5)
        for lens in ("pinhole", "lens 10 mm at 1 m")
    ]
    values = noisy(3, 10)
    plain = Board(
        "b",
        tuple(
            entry(f"m{j}", names[i], v)
            for i, row in enumerate(values)
            for j, v in enumerate(row)
        ),
    )
    result = agreement(plain, plain, resamples=5)
    assert (result.samples_a, result.scenes_a) == (10, 5)


def test_boards_of_few_scenes_have_no_interval():
    """A board of fewer than four scenes is not resampled; the notes say so."""
    few, many = board(noisy(0, 12), scenes=[0, 1, 2] * 4), board(noisy(1, 12))
    both = agreement(few, few, resamples=100)
    assert str(both.tau) == "1.00 (-)"
    assert str(both.reliability_a) == "-"
    assert len(both.notes(("a", "b"))) == 2
    one = agreement(few, many, resamples=100)
    assert one.tau.low <= one.tau.value <= one.tau.high
    assert "fewer than 4 scenes" in one.notes(("a", "b"))[0]
    assert agreement(many, many, resamples=100).notes(("a", "b")) == []


def test_split_half_reliability_grows_with_less_noise():
    clean, rough = (
        agreement(board(noisy(3, 20, noise=n)), board(noisy(4)), resamples=100)
        for n in (0.5, 8.0)
    )
    assert clean.reliability_a.value > 0.9 > rough.reliability_a.value


def test_failures_share_the_last_rank_and_missing_samples_are_left_out():
    values = noisy(0, 3, 4, noise=0.0)
    values[0, 0] = values[0, 1] = math.nan
    a = board(values)
    ranks = sample_ranks(
        a, ("m0", "m1", "m2", "m3"), "middlebury-v3", "nonocc", HEADLINE
    )
    assert ranks[0].tolist() == [[3.5, 3.5, 1.0, 2.0]]
    fewer = a.without(lambda e: (e.method, e.sample) == ("m3", "s1"))
    assert agreement(fewer, a, resamples=1).samples_a == 2


def test_resamples_without_an_order_are_left_out():
    """Scenes that rank in opposite order, drawn equally often, tie all methods."""
    opposite = board(
        np.array([[1.0, 2, 3], [3.0, 2, 1], [1.0, 2, 3], [3.0, 2, 1], [1.0, 2, 3]])
    )
    result = agreement(
        opposite, board(np.array([[1.0, 2, 3], [1.0, 3, 2]])), resamples=200
    )
    assert -1 <= result.tau.low <= result.tau.value <= result.tau.high <= 1
    never = agreement(board(np.array([[1.0, 1, 1]])), opposite, resamples=3)
    assert math.isnan(never.tau.value)
    assert math.isnan(never.tau.low)
    assert never.notes(("a", "b"))[-1] == "no correlation: all methods of a board tie"


def test_the_seed_decides_the_interval():
    a, b = board(noisy(1, noise=4.0)), board(noisy(2, noise=4.0))
    first, again, other = (
        agreement(a, b, resamples=50, seed=seed) for seed in (1, 1, 2)
    )
    assert first == again
    assert first.tau != other.tau


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"region": "near"}, "region on both boards 'near'"),
        ({"protocol": "eth3d"}, "protocol on both boards 'eth3d'"),
        ({"metric": "badd2.0"}, "metric 'badd2.0'"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        agreement(board(noisy(0)), board(noisy(1)), **change)


def test_the_command_prints_and_draws(tmp_path, capsys):
    a, b, one = (tmp_path / name for name in ("a", "b.json", "one.json"))
    write_board(board(noisy(0)), a / "board.json")
    write_board(board(noisy(1)), b)
    write_board(board(noisy(0, 1)), one)
    result = agreement(str(a), b, resamples=5)
    assert result == agreement(board(noisy(0)), board(noisy(1)), resamples=5)
    figure = tmp_path / "agree.svg"
    assert run(["agree", str(a), str(b), "-o", str(figure)]) == 0
    text = capsys.readouterr().out
    assert "Kendall's tau-b" in text
    assert figure.read_text().startswith("<?xml")
    assert run(["agree", str(one), str(one), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["samples_a"], document["tau"]["low"]) == (1, None)
