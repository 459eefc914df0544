from itertools import product

import pytest
from scipy import stats

from twinlens.factory import plan, recipe_from_table

BASE = {"seed": 5, "count": 10, "scenes": ["cards", "staircase"]}


def recipe(**changes):
    return recipe_from_table({**BASE, **changes})


def drawn(of, indices=range(12)):
    return [plan(of, index).drawn for index in indices]


def test_a_sample_depends_on_recipe_seed_and_index_alone():
    some = {"rig": {"baseline": {"uniform": [0.05, 0.2]}}, "spp": {"integers": [1, 9]}}
    assert [plan(recipe(**some), i) for i in (3, 7)] == [
        plan(recipe(**some, count=999), i) for i in (3, 7)
    ]
    assert plan(recipe(**some), 7) != plan(recipe(**some, seed=6), 7)


def test_a_quantity_more_leaves_the_others_as_they_were():
    first = {"rig": {"baseline": {"uniform": [0.05, 0.2]}}}
    more = {
        "rig": {"fov_x_deg": {"uniform": [40, 60]}, **first["rig"]},
        "spp": {"integers": [1, 9]},
    }
    for before, after in zip(
        drawn(recipe(**first)), drawn(recipe(**more)), strict=True
    ):
        assert before["rig"]["baseline"] == after["rig"]["baseline"]
    assert [plan(recipe(**first), i).seed for i in range(5)] == [
        plan(recipe(**more), i).seed for i in range(5)
    ]


def test_quantities_do_not_move_together():
    of = recipe(
        rig={"baseline": {"uniform": [0.1, 1.0]}, "fov_x_deg": {"uniform": [30, 60]}}
    )
    pairs = [
        (d["rig"]["baseline"], d["rig"]["fov_x_deg"]) for d in drawn(of, range(300))
    ]
    assert abs(stats.pearsonr(*zip(*pairs, strict=True)).statistic) < 0.2


def test_another_attempt_draws_anew_but_keeps_scene_sweep_and_split():
    of = recipe(
        rig={"baseline": {"uniform": [0.05, 0.2]}},
        spp={"sweep": [1, 2]},
        splits={"train": 0.5, "test": 0.5},
    )
    first, second = plan(of, 3), plan(of, 3, attempt=1)
    assert first.drawn["rig"] != second.drawn["rig"]
    assert first.seed != second.seed
    same = ("scene", "split", "name")
    assert [getattr(first, key) for key in same] == [
        getattr(second, key) for key in same
    ]
    assert first.drawn["spp"] == second.drawn["spp"]


def test_scenes_and_sweeps_make_a_full_factorial_and_begin_again():
    of = recipe(
        spp={"sweep": [1, 2, 3]},
        lenses=[{"kind": "thin", "aperture_mm": {"sweep": [0, 4]}}],
    )
    cells = [
        (plan(of, i).scene, d["spp"], d["lenses"][0]["aperture_mm"])
        for i, d in enumerate(drawn(of, range(24)))
    ]
    assert set(cells[:12]) == set(product(["cards", "staircase"], [1, 2, 3], [0, 4]))
    assert cells[12:] == cells[:12]
    assert cells[0][0] != cells[1][0]


@pytest.mark.parametrize(
    "changes", [{}, {"weights": [3, 1]}, {"spp": {"sweep": [1, 2, 3]}}]
)
def test_a_value_per_scene_follows_the_scene(changes):
    of = recipe(rig={"baseline": {"per_scene": [0.07, 0.17]}}, **changes)
    seen = {
        (plan(of, i).scene, plan(of, i).drawn["rig"]["baseline"]) for i in range(40)
    }
    assert seen == {("cards", 0.07), ("staircase", 0.17)}


def test_weights_say_how_often_a_scene_comes():
    of = recipe(weights=[3, 1])
    count = sum(plan(of, i).scene == "cards" for i in range(1000))
    assert stats.binomtest(count, 1000, 0.75).pvalue > 0.001


def test_splits_have_their_shares_and_stay_when_the_count_grows():
    shares = {"train": 0.8, "val": 0.15, "test": 0.05}
    large, small = recipe(splits=shares), recipe(splits=shares, count=7)
    splits = [plan(large, i).split for i in range(2000)]
    seen = [splits.count(name) for name in shares]
    assert (
        stats.chisquare(seen, [2000 * share for share in shares.values()]).pvalue
        > 0.001
    )
    assert splits[:50] == [plan(small, i).split for i in range(50)]
    assert plan(recipe(), 0).split is None
