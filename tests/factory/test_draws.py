import numpy as np
import pytest
from scipy import stats

from twinlens.errors import InputError
from twinlens.factory.draws import corners, leaves, resolve, template
from twinlens.seeds import generator

COUNT = 4000


def read(value, place="rig.baseline"):
    return template(value, "recipe.toml", place)


def draws(value, count=COUNT):
    leaf = read(value)
    return [leaf.distribution.draw(generator(1, "draw", i)) for i in range(count)]


CASES = {
    "uniform": ({"uniform": [0.5, 2.0]}, stats.uniform(0.5, 1.5)),
    "log_uniform": ({"log_uniform": [0.5, 50.0]}, stats.loguniform(0.5, 50.0)),
    "normal": (
        {"normal": [3.0, 2.0], "clip": [2.0, 8.0]},
        stats.truncnorm(-0.5, 2.5, 3.0, 2.0),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_values_follow_the_distribution_that_scipy_has_under_that_name(name):
    value, law = CASES[name]
    assert stats.kstest(draws(value), law.cdf).pvalue > 0.001


def test_whole_numbers_come_equally_often_ends_included():
    values, counts = np.unique(draws({"integers": [3, 6]}), return_counts=True)
    assert values.tolist() == [3, 4, 5, 6]
    assert stats.chisquare(counts).pvalue > 0.001
    assert all(isinstance(value, int) for value in draws({"integers": [3, 6]}, 3))


def test_choices_come_by_their_weights():
    drawn = draws({"choice": ["a", "b", "c"], "weights": [1, 0, 3]})
    counts = [drawn.count(value) for value in "abc"]
    assert counts[1] == 0
    assert stats.chisquare(counts[::2], [COUNT / 4, 3 * COUNT / 4]).pvalue > 0.001


def test_ends_are_never_passed():
    for value, (low, high) in (
        ({"log_uniform": [0.1, 0.3]}, (0.1, 0.3)),
        ({"normal": [0, 1], "clip": [4, 9]}, (4, 9)),
        ({"uniform": [2, 2]}, (2, 2)),
    ):
        drawn = draws(value, 500)
        assert low <= min(drawn) <= max(drawn) <= high


def test_a_template_is_resolved_leaf_by_leaf():
    tree = read({"a": {"uniform": [1, 2]}, "b": [{"sweep": [7, 8]}, "text"], "c": True})
    assert [leaf.key for leaf in leaves(tree)] == [
        "rig.baseline.a",
        "rig.baseline.b[0]",
    ]
    assert resolve(tree, lambda leaf: leaf.distribution.kind) == {
        "a": "uniform",
        "b": ["sweep", "text"],
        "c": True,
    }


def test_corners_show_every_end_and_every_choice():
    seen = list(corners(read({"a": {"uniform": [1, 2]}, "b": {"sweep": [7, 8, 9]}})))
    assert seen[0] == {"a": 1, "b": 7}
    assert {table["a"] for table in seen} == {1, 2}
    assert {table["b"] for table in seen} == {7, 8, 9}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (
            {"uniform": [2, 1]},
            r"recipe.toml: rig.baseline.uniform: must be \[low, high\] with low <= high",
        ),
        ({"uniform": [1, 2], "wieghts": [1]}, "rig.baseline: unknown key 'wieghts'"),
        ({"log_uniform": [0, 2]}, r"rig.baseline.log_uniform\[0\]: must be > 0"),
        ({"normal": [0, 0], "clip": [0, 1]}, "standard deviation > 0"),
        ({"normal": [0, 1], "clip": [40, 50]}, "excludes nearly all of a normal"),
        (
            {"choice": [1, 2], "weights": [1]},
            "rig.baseline: weights: must have length 2, got .1",
        ),
        ({"choice": [{"uniform": [1, 2]}]}, "must be constants, not distributions"),
        ({"uniform": [-1.7e308, 1.7e308]}, "with low <= high"),
    ],
)
def test_mistakes_are_named_by_their_place(value, message):
    with pytest.raises(InputError, match=message):
        read(value)


def test_a_recipe_nested_too_deep_is_refused():
    value = 1
    for _ in range(50):
        value = [value]
    with pytest.raises(InputError, match="nested more than"):
        read(value)
