"""Groups of samples by recorded values, and differences of two groups with their intervals."""

import csv
import io
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from twinlens.errors import InputError
from twinlens.scoring import (
    Board,
    Entry,
    board_csv,
    compare_groups,
    comparison_table,
    groupings,
    groups_by,
)
from twinlens.scoring.board import MatchFailure
from twinlens.scoring.board_file import board_from_json, board_to_json
from twinlens.scoring.evaluate import RegionScores
from twinlens.scoring.grouping import MAX_GROUPS, Comparison, Difference
from twinlens.scoring.intervals import Interval, bootstrap, mean, mean_of_units

PROTOCOL, METRIC = "middlebury-v3", "totbad2.0"


def entry(method, sample, value):
    failure = MatchFailure("crash", "no") if value is None else None
    regions = {}
    if value is not None:
        regions["all"] = RegionScores(100, 100, 100, {METRIC: value})
    return Entry(
        method, method, sample, "", PROTOCOL, 10, 10, 8, None, failure, regions
    )


def board_of(samples):
    """A board of one method from (name, scene, recorded values, score)."""
    return Board(
        entries=tuple(entry("m", name, score) for name, _, _, score in samples),
        scenes={name: scene for name, scene, _, _ in samples},
        recorded={name: recorded for name, _, recorded, _ in samples},
    )


def two_lenses(first, second, same_scenes=True):
    """A sample of each lens in every scene, or each sample in a scene of its own."""
    samples = []
    for lens, scores in (("f/1.4", first), ("f/4", second)):
        for k, score in enumerate(scores):
            scene = f"{k}" if same_scenes else f"{k} {lens}"
            samples.append((f"{k} · {lens}", scene, {"lens": lens}, score))
    return board_of(samples)


@pytest.mark.parametrize("missing", ["f/1.4", "f/4"])
def test_a_method_without_results_in_a_group_has_a_dash_there(missing):
    """As of a board that has scores of an earlier dataset too."""
    board = two_lenses([10, 20, 30], [5, 15, 25])
    others = [name for name in board.samples if not name.endswith(missing)]
    more = [entry("other", name, 8) for name in others]
    board = replace(board, entries=(*board.entries, *more))
    groups = groups_by(board, "lens")
    comparison = compare_groups(board, PROTOCOL, "all", groups)
    table = comparison_table(board, PROTOCOL, "all", groups, comparison)
    columns = {
        str(column.header): list(map(str, column.cells)) for column in table.columns
    }
    row = columns["method"].index("other")
    values = {lens: columns[lens][row] for lens in groups}
    assert values.pop(missing) == "–"
    assert [*values.values()] == ["8.00"]


def difference_of(board):
    groups = groups_by(board, "lens")
    comparison = compare_groups(board, PROTOCOL, "all", groups)
    return comparison.differences["f/4"]["m"]


def test_a_paired_difference_has_the_interval_of_the_t_test():
    random = np.random.default_rng(1)
    difficulty = random.uniform(10, 90, 40)
    first = difficulty + random.normal(0, 1, 40)
    second = difficulty + 2 + random.normal(0, 1, 40)
    result = difference_of(two_lenses(first, second))
    exact = stats.ttest_rel(second, first).confidence_interval(0.95)
    assert result.paired
    assert result.interval.units == 40
    assert result.interval.value == pytest.approx(np.mean(second - first))
    width = exact.high - exact.low
    # 2.5 % quantiles of 1000 draws have a standard error of 3 % of the width.
    assert result.interval.low == pytest.approx(exact.low, abs=0.1 * width)
    assert result.interval.high == pytest.approx(exact.high, abs=0.1 * width)


def test_a_difference_over_other_scenes_has_the_interval_of_the_t_test_of_two_samples():
    random = np.random.default_rng(2)
    first, second = random.normal(20, 5, 30), random.normal(30, 3, 30)
    result = difference_of(two_lenses(first, second, same_scenes=False))
    exact = stats.ttest_ind(second, first, equal_var=False).confidence_interval(0.95)
    assert not result.paired
    assert result.interval.value == pytest.approx(second.mean() - first.mean())
    width = exact.high - exact.low
    assert result.interval.low == pytest.approx(exact.low, abs=0.1 * width)
    assert result.interval.high == pytest.approx(exact.high, abs=0.1 * width)


def test_what_scenes_differ_in_cancels():
    first = [10.0, 80.0, 30.0, 55.0, 5.0, 61.0]
    second = [score + 1.5 for score in first]
    interval = difference_of(two_lenses(first, second)).interval
    assert (interval.low, interval.value, interval.high) == (1.5, 1.5, 1.5)


def test_samples_of_one_scene_do_not_count_as_scenes():
    """Ten views of each of three scenes have the interval of three scenes."""
    samples = []
    for scene, shift in (("x", 0.0), ("y", 1.0), ("z", 5.0)):
        for view in range(10):
            base = {"lens": "a"}, 10.0 + view
            other = {"lens": "b"}, 10.0 + view + shift
            samples.append((f"{scene}{view}a", scene, *base))
            samples.append((f"{scene}{view}b", scene, *other))
    comparison = compare_groups(
        board_of(samples), PROTOCOL, "all", groups_by(board_of(samples), "lens")
    )
    interval = comparison.differences["b"]["m"].interval
    assert (interval.low, interval.value, interval.high) == (0.0, 2.0, 5.0)
    assert interval.units == 3


def test_the_fast_interval_of_a_mean_is_that_of_the_bootstrap():
    units = [[1.0, 2.0], [4.0], [9.0, 3.0, 3.0], [0.5]]
    fast, slow = mean_of_units(units), bootstrap(mean, units)
    assert fast.value == pytest.approx(slow.value)
    assert (fast.low, fast.high) == pytest.approx((slow.low, slow.high))


@pytest.mark.parametrize("scores", [[1.0], [1.0, None], [1.0, math.inf]])
def test_no_interval_without_means_of_two_scenes(scores):
    interval = difference_of(two_lenses([2.0] * len(scores), scores)).interval
    assert math.isnan(interval.low)
    assert math.isnan(interval.high)
    assert math.isnan(interval.value) == (len(scores) > 1)


def of_groups(first, second):
    """The difference of two groups of samples, each (scene, score)."""
    samples = []
    for lens, group in (("f/1.4", first), ("f/4", second)):
        for scene, score in group:
            samples.append((f"{scene} {lens}", scene, {"lens": lens}, score))
    return difference_of(board_of(samples))


def test_one_shared_scene_of_several_makes_no_pair():
    first = [("1", 60.0), ("2", 90.0)]
    second = [("1", 70.0), ("3", 20.0), ("4", 30.0), ("5", 30.0)]
    result = of_groups(first, second)
    assert (result.paired, result.basis) == (False, "unpaired, 2 scenes")
    assert result.interval.value == pytest.approx(37.5 - 75.0)
    assert result.interval.low < result.interval.value < result.interval.high


@pytest.mark.parametrize(
    ("first", "second", "basis"),
    [
        ("a", "a", "paired, 1 scene"),
        ("a", "ab", "unpaired, 1 scene"),
        ("ab", "ab", "paired, 2 scenes"),
        ("abc", "bcd", "paired, 2 of 4 scenes"),
        ("ab", "cd", "unpaired, 2 scenes"),
        ("ab", "bcdef", "unpaired, 2 scenes"),
    ],
)
def test_the_basis_says_how_many_scenes_of_all_are_paired(first, second, basis):
    groups = [[(scene, 1.0) for scene in scenes] for scenes in (first, second)]
    assert of_groups(*groups).basis == basis


def test_of_equally_many_bases_the_first_methods_is_said():
    unpaired = Difference(Interval(1.0, 0.0, 2.0, 3), False, 6)
    paired = replace(unpaired, paired=True)
    for pair in ((paired, unpaired), (unpaired, paired)):
        methods = dict(zip("ab", pair, strict=True))
        assert Comparison("", {}, {"g": methods}).basis("g") == pair[0].basis


def values(name, *of_samples):
    recorded = [{} if value is None else {name: value} for value in of_samples]
    return board_of([(str(k), str(k), each, 1.0) for k, each in enumerate(recorded)])


def test_texts_and_few_numbers_are_groups_of_their_own():
    assert groups_by(values("lens", "f/4", "f/1.4", "f/4"), "lens") == {
        "f/4": ("0", "2"),
        "f/1.4": ("1",),
    }
    numbers = values("spp", 16.0, 4.0, 16.0, 4.0, 4.0)
    assert [*groups_by(numbers, "spp")] == ["4", "16"]


def test_many_numbers_are_three_ranges():
    board = values("rig.baseline", *np.linspace(0.05, 0.16, 12).tolist())
    groups = groups_by(board, "rig.baseline")
    assert [*groups] == ["0.05 to 0.08", "0.09 to 0.12", "0.13 to 0.16"]
    assert [len(samples) for samples in groups.values()] == [4, 4, 4]


@pytest.mark.parametrize("kind", [int, np.int64, np.float32, float])
def test_numbers_of_any_type_make_groups(kind):
    board = values("level", kind(1), kind(2), kind(1))
    assert groups_by(board, "level") == {"1": ("0", "2"), "2": ("1",)}


@pytest.mark.parametrize(
    "numbers",
    [
        1000 + np.arange(9) / 10,
        0.1 + np.arange(9) * 1e-9,
        1e6 + np.arange(7) / 1e3,
        [1.0000001, 1.0000002, 1.0000003],
        [np.nextafter(1, 2), 1.0],
        -1000 - np.arange(9) / 10,
    ],
)
def test_titles_have_the_digits_that_tell_groups_apart(numbers):
    groups = groups_by(values("rig.x", *map(float, numbers)), "rig.x")
    assert len(groups) == min(3, len(numbers))
    ends = [end for title in groups for end in title.split(" to ")]
    assert len(set(ends)) == len(ends)


def test_samples_without_the_value_are_the_last_group():
    board = values("lens", None, "f/2", None)
    assert groups_by(board, "lens") == {"f/2": ("1",), "not recorded": ("0", "2")}


@pytest.mark.parametrize(
    ("board", "name", "message"),
    [
        (values("lens", "f/2", "f/4"), "lense", "did you mean 'lens'"),
        (values("lens", "f/2", "f/2"), "lens", "one group of the samples"),
        (
            values("id", *map(str, range(MAX_GROUPS + 1))),
            "id",
            f"expected 2 to {MAX_GROUPS}",
        ),
    ],
)
def test_what_makes_no_groups_is_refused(board, name, message):
    with pytest.raises(InputError, match=message):
        groups_by(board, name)


def test_of_values_that_make_the_same_groups_the_first_is_listed():
    samples = [
        ("0", "s", {"lens": "f/2", "lens_number": 0.0, "family": "room"}, 1.0),
        ("1", "s", {"lens": "f/4", "lens_number": 1.0, "family": "room"}, 1.0),
        ("2", "t", {"lens": "f/2", "lens_number": 0.0, "family": "room"}, 1.0),
    ]
    assert [*groupings(board_of(samples))] == ["lens", "scene"]


def test_recorded_values_are_in_the_file_and_the_csv():
    board = two_lenses([1.0, 2.0], [3.0, 4.0])
    again = board_from_json(board_to_json(board))
    assert again.recorded == board.recorded
    rows = [*csv.DictReader(io.StringIO(board_csv(board)))]
    assert [row["lens"] for row in rows] == ["f/1.4", "f/1.4", "f/4", "f/4"]
    assert [row["scene"] for row in rows] == ["0", "1", "0", "1"]


def test_a_sample_that_an_earlier_version_named_otherwise_is_refused():
    old = "0 · lens 5 mm at 1.5 m"
    board = Board(entries=(replace(entry("m", old, 1.0), sample_sha256="a"),))
    board.check_sample("0 · f/4", "b")
    with pytest.raises(InputError, match="use another folder"):
        board.check_sample("0 · f/1.4", "a")
