"""Coverage of the intervals on known distributions."""

import math

import numpy as np
import pytest

from twinlens.scoring.intervals import bootstrap, mean
from twinlens.studies import Column, Table, mean_of, paired_difference
from twinlens.studies.intervals import log_slope

COLUMNS = tuple(Column(name, "", name) for name in ("scene", "seed", "kind", "value"))
TRIALS = 200


def make(rows):
    return Table(
        COLUMNS,
        tuple(
            dict(zip(("scene", "seed", "kind", "value"), row, strict=True))
            for row in rows
        ),
    )


def coverage(draw, truth, units, seed):
    """The share of trials whose interval contains the truth."""
    random = np.random.default_rng(seed)
    intervals = [
        bootstrap(mean, draw(random, units)[:, None], seed=trial)
        for trial in range(TRIALS)
    ]
    return np.mean([interval.low <= truth <= interval.high for interval in intervals])


@pytest.mark.parametrize(
    ("draw", "truth"),
    [
        (lambda random, n: random.normal(3.0, 2.0, n), 3.0),
        pytest.param(
            lambda random, n: random.uniform(0.0, 1.0, n), 0.5, marks=pytest.mark.slow
        ),
    ],
    ids=["normal", "uniform"],
)
def test_intervals_of_ten_units_have_nominal_coverage(draw, truth):
    # Two standard deviations of 95 % in 200 trials are 3 %; ten units leave the percentile method two points short.
    assert 0.89 <= coverage(draw, truth, 10, 1) <= 0.99


def test_the_range_of_three_units_covers_the_mean_three_times_in_four():
    share = coverage(lambda random, n: random.normal(0.0, 1.0, n), 0.0, 3, 2)
    assert abs(share - 0.75) < 3 * math.sqrt(0.75 * 0.25 / TRIALS)


def test_seeds_of_one_scene_are_not_counted_as_scenes():
    """The interval spans the differences between scenes, however many seeds agree."""
    many = make(
        [
            (scene, seed, "a", value)
            for scene, value in (("x", 0.0), ("y", 1.0), ("z", 2.0))
            for seed in range(10)
        ]
    )
    few = make(
        [
            (scene, 0, "a", value)
            for scene, value in (("x", 0.0), ("y", 1.0), ("z", 2.0))
        ]
    )
    assert mean_of(many, "value") == mean_of(few, "value")
    assert (mean_of(many, "value").low, mean_of(many, "value").high) == (0.0, 2.0)


def test_fewer_than_five_units_give_a_range():
    few, enough = (bootstrap(mean, [[float(k)] for k in range(n)]) for n in (3, 5))
    assert few.format("px") == "1 px (range of 3: 0 to 2)"
    assert enough.format("px").startswith("2 px [")


def test_nan_is_ignored():
    assert math.isnan(bootstrap(mean, [[math.nan]]).value)
    assert bootstrap(mean, [[1.0, math.nan], [3.0]]).value == 2.0


def test_paired_differences_cancel_differences_between_scenes():
    rows = [
        (scene, 0, kind, base + (kind == "b"))
        for scene, base in (("x", 0.0), ("y", 50.0))
        for kind in "ab"
    ]
    interval = paired_difference(make(rows), "value", "kind", "b", "a")
    assert (interval.low, interval.value, interval.high) == (1.0, 1.0, 1.0)


def test_log_slope_of_powers():
    rows = make([(k, 0, "a", 3.0 * (k + 1.0) ** -1.7) for k in range(5)])
    grown = Table(
        rows.columns, tuple({**row, "scene": row["scene"] + 1.0} for row in rows)
    )
    assert log_slope("scene", "value")(grown) == pytest.approx(-1.7)
    assert math.isnan(log_slope("seed", "value")(grown))
