"""`[camera]` in recipes, and `camera` in rigs: presets, sensor formats and focal lengths in millimetres."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from twinlens.camera.presets import CAMERAS
from twinlens.errors import InputError
from twinlens.factory import default_rig, plan
from twinlens.factory.recipe import recipe_from_table
from twinlens.factory.settings import RecipeSettings
from twinlens.scenes import Scene, rig_from_table
from twinlens.schema import read

SCENE = Scene("stage", (), {}, np.eye(4), (1.0, 3.0), baseline=0.25)
BASE = {"seed": 1, "count": 3, "scenes": ["cards"]}


def rig_of(table, index=0, own=None):
    """The settings and the rig of a sample of a recipe; `own` is the rig's table of its scene.toml."""
    spec = plan(recipe_from_table(BASE | table), index)
    settings = read(RecipeSettings, spec.drawn, "recipe.toml")
    return settings, settings.rig_of(SCENE, own, Path("recipe.toml"), Path)


def test_a_preset_sets_the_pair_and_the_size_of_its_images():
    settings, rig = rig_of({"camera": {"preset": "realsense-d435"}})
    assert (settings.width, settings.height) == (1280, 800)
    assert rig.cameras[0] == rig.cameras[1]
    assert rig.baseline() == pytest.approx(0.05)
    assert rig.cameras[0].fx == pytest.approx(1.93e3 / 3.0)
    assert rig.cameras[0].pixel_pitch_um == 3.0
    assert rig.is_rectified()


def test_a_smaller_width_bins_and_the_rig_may_change_the_baseline():
    settings, rig = rig_of(
        {"width": 320, "camera": {"preset": "realsense-d435"}, "rig": {"baseline": 0.2}}
    )
    assert (settings.width, settings.height) == (320, 200)
    assert rig.cameras[0].fov_x_deg == pytest.approx(
        CAMERAS["realsense-d435"].camera.fov_x_deg
    )
    assert rig.baseline() == pytest.approx(0.2)


OWN = {
    "layout": "toed_in",
    "distance": 2.0,
    "baseline": 0.4,
    "fx": 80.0,
    "cameras": [{}, {"cx": 5.0, "fx": 90.0}],
}


def test_a_camera_replaces_that_of_the_rig_of_its_scene():
    camera = {"preset": "realsense-d435"}
    by_recipe = rig_of({"width": 320, "height": 200, "camera": camera}, own=OWN)[1]
    own = dataclasses.replace(SCENE, rig=OWN)
    by_option = default_rig(own, 320, 200, intrinsics={"camera": camera})
    for rig in (by_recipe, by_option):
        assert rig.cameras[0].fx == pytest.approx(1.93e3 / 12)
        assert rig.cameras[0] == rig.cameras[1]
        assert rig.baseline() == pytest.approx(0.05)
        assert not rig.is_rectified()
    # A camera without a pair keeps the baseline.
    alone = rig_of({"camera": {"fx": 300.0}}, own=OWN)[1]
    assert alone.baseline() == pytest.approx(0.4)
    assert alone.cameras[1].fx == 300.0


@pytest.mark.parametrize(("camera", "fx", "pitch"), [
    ({"sensor_width_mm": "2/3", "focal_length_mm": 8}, 8 / 8.8 * 320, 8800 / 320),
    ({"pixel_pitch_um": 3.45, "focal_length_mm": 8}, 8e3 / 3.45, 3.45),
    ({"preset": "realsense-d435", "focal_length_mm": 3.86}, 3.86e3 / 12, 12.0),
    ({"preset": "realsense-d435", "fx": 300}, 300.0, 12.0),
])  # fmt: skip
def test_focal_lengths_and_pixels_in_millimetres(camera, fx, pitch):
    _, rig = rig_of({"width": 320, "height": 180, "camera": camera})
    assert rig.cameras[1].fx == rig.cameras[1].fy == pytest.approx(fx)
    assert rig.cameras[1].pixel_pitch_um == pytest.approx(pitch)


def test_every_value_may_be_drawn():
    table = {"camera": {"preset": {"sweep": ["mer-pancam", "oak-d"]}}}
    sizes = [rig_of(table, i)[0] for i in (0, 1)]
    assert [(size.width, size.height) for size in sizes] == [(1024, 1024), (1280, 800)]


def test_a_rig_names_a_camera_and_its_keys_change_it():
    rig = rig_from_table(
        {"camera": {"preset": "mer-pancam", "width": 256}}, SCENE, 640, 480
    )
    assert (rig.cameras[0].width, rig.cameras[0].height) == (256, 256)
    assert rig.baseline() == pytest.approx(0.3)
    table = {
        "layout": "line",
        "count": 3,
        "camera": {"preset": "mer-pancam"},
        "cameras": [{}, {"fov_x_deg": 30}, {}],
    }
    rig = rig_from_table(table, SCENE, 640, 480)
    assert rig.baseline() == pytest.approx(0.3)
    assert rig.cameras[1].fov_x_deg == pytest.approx(30)


@pytest.mark.parametrize(("table", "message"), [
    ({"camera": {"preset": "realsense"}}, r"camera\.preset: unknown camera 'realsense'; did you mean 'realsense-d435'"),
    ({"camera": {"focal_length_mm": 8}}, "focal_length_mm needs the size of a pixel"),
    ({"camera": {"focal_length_mm": 8, "fx": 8}}, "camera: 'fx' and 'focal_length_mm' both set the focal length"),
    ({"camera": {"preset": "mer-pancam", "width": 8}}, r"are not in \[camera\]"),
    ({"camera": {"preset": "realsense-d435"}, "width": 320, "height": 240}, "sensor has 200 rows at a width of 320"),
    ({"camera": {"sensor_width_mm": "3/2"}}, "unknown sensor format '3/2'"),
])  # fmt: skip
def test_mistakes_are_named(table, message):
    with pytest.raises(InputError, match=message) as caught:
        recipe_from_table(BASE | table)
    assert str(caught.value).startswith("recipe.toml: ")
    assert "\n" not in str(caught.value)


def test_camera_and_rig_do_not_set_the_same():
    camera = {"focal_length_mm": 8, "pixel_pitch_um": 3}
    both = "camera.focal_length_mm and rig.fx exclude each other"
    with pytest.raises(InputError, match=both):
        rig_of({"camera": camera, "rig": {"fx": 700}})
