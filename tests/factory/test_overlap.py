"""The closed form of the overlap of two views, and rigs that no scene of a family suits."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.errors import InputError
from twinlens.factory import read_recipe
from twinlens.factory.overlap import _FARTHER, _FARTHER_ELSEWHERE, largest_overlap
from twinlens.factory.produce import check_draws
from twinlens.families import FAMILIES, random_scene
from twinlens.geometry import rigid
from twinlens.scenes.placement import rotation

RECIPE = """
seed = 5
count = 2
families = ["{family}"]
width = 32
height = 24
spp = 1
denoise = false
[rig]
{rig}
{more}
"""


def recipe_of(folder, rig, family="cards", more=""):
    file = folder / "recipe.toml"
    file.write_text(RECIPE.format(family=family, rig=rig, more=more))
    return read_recipe(file)


@pytest.mark.parametrize("baseline", [0.5, 4.0, 9.0, 30.0])
def test_parallel_views_have_in_common_what_the_farthest_plane_shows(baseline):
    # At z the left view is 2 z tan(fov / 2) wide, and all of it but the baseline is in the right one.
    camera = tl.Camera.from_fov(320, 240, 60)
    width = 2 * 8.0 * np.tan(np.radians(30))
    expected = max(0.0, 1 - baseline / width)
    share = largest_overlap(tl.Rig.stereo(camera, baseline), 1, farthest=8.0)
    # Rays are as far apart as 1/24 of the view; at its corners, 8 m of a ray are 6.5 m of depth.
    assert share <= expected + 1 / 24
    assert share >= max(0.0, 1 - baseline / (width * 0.8)) - 1 / 24


def test_views_back_to_back_have_nothing_in_common_and_equal_ones_all():
    camera = tl.Camera.from_fov(320, 240, 60)
    away = rigid(rotation([0, 1, 0], 180.0)[:3, :3], [0.1, 0.0, 0.0])
    assert largest_overlap(tl.Rig([camera, camera], [np.eye(4), away]), 1, 10.0) == 0
    assert largest_overlap(tl.Rig.stereo(camera, 1e-6), 1, 10.0) == 1


def test_verged_views_are_measured_where_their_axes_cross():
    camera = tl.Camera.from_fov(320, 240, 20)
    left = rigid(rotation([0, 1, 0], 45.0)[:3, :3], [-1.0, 0.0, 0.0])
    right = rigid(rotation([0, 1, 0], -45.0)[:3, :3], [1.0, 0.0, 0.0])
    share = largest_overlap(tl.Rig([camera, camera], [left, right]), 1, 10.0)
    assert share > 0.99


@pytest.mark.parametrize(
    ("rig", "more"),
    [
        ("baseline = 120", ""),
        ("baseline = { uniform = [60, 120] }", ""),
        ("baseline = 0.12", "[scene]\ndepth_range = [0.001, 0.004]"),
        ('layout = "line"\ncount = 3\nspacing = 65', ""),
        (
            'layout = "cameras"\n[[rig.cameras]]\n[[rig.cameras]]\ntranslate = [0.1, 0, 0]\neuler_deg = [0, 180, 0]',
            "",
        ),
    ],
)
def test_a_rig_that_no_scene_suits_is_refused_before_one_is_composed(
    tmp_path, monkeypatch, rig, more
):
    recipe = recipe_of(tmp_path, rig, more=more)
    monkeypatch.setattr("twinlens.factory.produce.random_scene", pytest.fail)
    with pytest.raises(
        InputError, match=r"recipe.toml: rig: cameras 0 and 1 are .* in metres"
    ):
        check_draws(recipe, 0)


@pytest.mark.parametrize(
    ("rig", "more"),
    [
        ("fov_x_deg = 0.9", ""),  # the baseline is the scene's
        ("baseline = 3", ""),
        ("baseline = 30", "[scene]\ndepth_range = [20, 100]"),
        ("baseline = 30", "[gates]\nvisible = 0"),
        ('layout = "toed_in"\nbaseline = 3', ""),
        ("baseline = 120\nposition = [0, -400, 1]\nlook_at = [0, 0, 1]", ""),
    ],
)
def test_rigs_that_may_suit_a_scene_are_not_refused(tmp_path, rig, more):
    check_draws(recipe_of(tmp_path, rig, more=more), 0)


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_no_picture_of_a_family_is_deeper_than_it_says(family):
    """Of the scenes' own pictures, whose depths are measured in a z-buffer; and of wider ones, as rigs have them."""
    deepest = FAMILIES[family].farthest
    for seed in range(500, 508):
        scene = random_scene(family, seed)
        assert scene.depth_range[1] <= deepest
        for fov_deg, factor in ((65, _FARTHER), (95, _FARTHER_ELSEWHERE)):
            camera = tl.Camera.from_fov(64, 48, fov_deg)
            rig = tl.Rig.stereo(camera, 0.1, scene.world_from_left)
            truth = tl.ground_truth(scene, rig)[0]
            distance = np.linalg.norm(
                truth.position - scene.world_from_left[:3, 3], axis=-1
            )
            assert (distance[truth.hit] <= factor * deepest).mean() > 0.95
