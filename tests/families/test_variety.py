"""Scenes of a family differ widely: in content, view, light and disparities; walls stay behind what is before them."""

import numpy as np
import pytest

from tests.families.families_checks import bare_scene, copies
from twinlens.families import FAMILIES
from twinlens.families.composition import Composition
from twinlens.families.lighting import KINDS
from twinlens.geometry import transform_points

SEEDS = range(6)


def spread(values):
    """The largest over the smallest value."""
    return max(values) / min(values)


@pytest.mark.parametrize("family", FAMILIES)
def test_largest_disparities_are_spread_from_three_to_twenty_seven_per_cent(family):
    shares = []
    for seed in SEEDS:
        scene = bare_scene(family, seed)
        near, _ = scene.depth_range
        width = 2 * near * np.tan(np.radians(scene.fov_x_deg) / 2)
        shares.append(scene.baseline / width)
    assert min(shares) >= 0.03 - 1e-9
    assert max(shares) <= 0.27 + 1e-9
    assert spread(shares) > 2


@pytest.mark.parametrize("family", ["tabletop", "flying", "cards"])
def test_numbers_of_objects_are_spread(family):
    assert spread([len(bare_scene(family, seed).objects) for seed in SEEDS]) > 1.6


@pytest.mark.parametrize("family", FAMILIES)
def test_some_cameras_are_held_by_hand_and_most_are_level(family):
    rolls = []
    for seed in SEEDS:
        right = bare_scene(family, seed).world_from_left[:3, 0]
        rolls.append(np.degrees(np.arcsin(abs(right[2]))))
    assert np.median(rolls) < 3
    assert max(rolls) <= 20.5


def turned(scene, name):
    """The normal (3,) of a flat object, towards the camera, and its distance from the origin along it."""
    (wall,) = (item for item in scene.objects if item.name == name)
    points = transform_points(wall.world_from_object, wall.shape.vertices)
    normal = np.asarray(wall.shape.normals)[0]
    return normal, float(points[0] @ normal)


@pytest.mark.parametrize(
    ("family", "name"),
    [("tabletop", "wall"), ("flying", "backdrop"), ("cards", "wall")],
)
def test_walls_are_turned_widely_and_everything_is_in_front_of_them(family, name):
    angles = []
    for seed in SEEDS:
        scene = bare_scene(family, seed)
        if not any(item.name == name for item in scene.objects):
            continue
        normal, distance = turned(scene, name)
        forward = scene.world_from_left[:3, 2]
        level = forward * [1, 1, 0] / np.hypot(*forward[:2])
        angles.append(np.degrees(np.arccos(np.clip(-normal @ level, -1, 1))))
        for item in scene.objects:
            is_surface = item.name in (name, "table", "floor")
            if is_surface or item.emitter is not None:
                continue
            for points, _ in copies(item):
                assert (points @ normal).min() > distance, (seed, item.name)
    assert min(angles) < 10
    assert max(angles) > 22


def test_all_kinds_of_light_are_drawn_and_their_shares_add_up():
    names, shares = zip(*KINDS, strict=True)
    assert len(set(names)) == len(names)
    assert sum(shares) == pytest.approx(1)
    lit = [bare_scene("cards", seed) for seed in range(16)]
    lamps = {
        frozenset(item.name for item in scene.objects if item.emitter) for scene in lit
    }
    # Lamps alone tell three groups apart: key and fill, one key light, the sun or none.
    assert len(lamps) >= 3


def test_a_wall_is_never_nearer_in_the_picture_than_its_limit():
    """Where a plane at the largest yaw begins, by intersecting the rays of both edges of the picture with it."""
    for seed in range(40):
        scene = Composition(
            "x", np.random.SeedSequence(seed), None, None, (1, 1), 4 / 3, 80
        )
        scene.look(np.zeros(3), np.array([0.0, 1.0, 0.0]), 60.0)
        half, ratio = np.tan(np.radians(30)), 4.0
        slope = np.tan(scene.yaw(ratio))
        # Depth z of the plane z = 1 + x slope along the ray x = t z.
        ends = [1 / (1 - t * slope) for t in (-half, half)]
        assert min(ends) / max(ends) >= 1.4 / ratio - 1e-9
