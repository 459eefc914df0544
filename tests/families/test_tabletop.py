"""Still lifes: no bodies intersect and none floats, by checks independent of the placement code."""

import numpy as np
import pytest

from tests.families.families_checks import (
    bare_scene,
    bodies,
    camera_inside,
    floating,
    intersecting,
    plain_name,
    table_height,
)
from twinlens.families.kinds import KINDS

QUICK = (0, 136)  # 136: a pebble overhangs the box below it, next to a taller vase
ALL = sorted({*range(200)} - {*QUICK})


def scene_of(seed):
    return bare_scene("tabletop", seed)


@pytest.mark.parametrize(
    "seeds",
    [QUICK, *(pytest.param(ALL[i::4], marks=pytest.mark.slow) for i in range(4))],
    ids=["quick", "0", "1", "2", "3"],
)
def test_bodies_rest_on_the_table_or_on_each_other_without_intersections(seeds):
    for seed in seeds:
        scene = scene_of(seed)
        assert intersecting(scene) == [], seed
        assert floating(scene, table_height(scene)) == [], seed
        assert camera_inside(scene) == [], seed


def test_the_checks_find_floating_and_intersecting_bodies():
    """The checks themselves fail for a lifted body, and for one moved into its neighbour."""
    scene = scene_of(2)
    kinds = [item for item in scene.objects if plain_name(item.name) in KINDS]
    first, second = kinds[:2]
    lifted = np.array(first.world_from_object)
    lifted[2, 3] += 0.02
    pushed = np.array(second.world_from_object)
    pushed[:3, 3] = first.world_from_object[:3, 3] + [0.01, 0, 0]
    lifted_scene = scene.with_poses({first.name: lifted})
    assert first.name in floating(lifted_scene, table_height(scene))
    assert intersecting(scene.with_poses({second.name: pushed}))


def test_some_bodies_are_stacked():
    heights = [
        vertices[:, 2].min()
        for seed in (2, 5)
        for vertices, _ in bodies(scene_of(seed)).values()
    ]
    assert max(heights) > 0.01
