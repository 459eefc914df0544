"""Sensor widths in recipes and options: a number of millimetres or the name of a format."""

import pytest

from twinlens.camera.film import SENSOR_WIDTHS_MM
from twinlens.dataset.poses import write_rig
from twinlens.errors import InputError
from twinlens.factory import default_rig, plan, read_recipe, recipe_from_table
from twinlens.factory.settings import RecipeSettings
from twinlens.scenes import load_scene, rig_from_table
from twinlens.schema import read

BASE = {"seed": 1, "count": 4, "scenes": ["cards"], "width": 320, "height": 240}


@pytest.mark.parametrize(
    ("width", "millimetres"),
    [(36, 36.0), ("35mm", 36.0), ("1/2.3", 6.17), ("APS-C", 23.5)],
)
def test_a_sensor_width_is_the_width_of_all_pixels(width, millimetres):
    rig = rig_from_table({"sensor_width_mm": width}, load_scene("cards"), 320, 240)
    assert [
        camera.pixel_pitch_um * camera.width for camera in rig.cameras
    ] == pytest.approx([1e3 * millimetres] * 2)


def test_a_camera_may_have_a_sensor_of_its_own():
    cameras = [{}, {"sensor_width_mm": "1", "width": 160}]
    first, second = rig_from_table(
        {"sensor_width_mm": 8.0, "cameras": cameras}, load_scene("cards"), 320, 240
    ).cameras
    assert (first.pixel_pitch_um, second.pixel_pitch_um) == pytest.approx((25.0, 82.5))


def test_near_infrared_cameras_have_a_sensor_of_their_own():
    table = {
        "filters": "RGGB",
        "nir": {"preset": "phone", "read_noise": {"sweep": [2.0, 3.0]}},
    }
    recipe = recipe_from_table(
        {**BASE, "rig": {"camera": {"band": "nir"}}, "sensor": table}
    )
    settings = [
        read(RecipeSettings, plan(recipe, i).drawn, "recipe.toml") for i in range(2)
    ]
    assert [setting.sensor.nir.read_noise for setting in settings] == [2.0, 3.0]
    assert settings[0].sensor.nir.full_well == 6000.0


@pytest.mark.parametrize(
    ("rig", "message"),
    [
        (
            {"sensor_width_mm": "APSC"},
            "unknown sensor format 'APSC'; did you mean 'APS-C'",
        ),
        ({"sensor_width_mm": 0}, "must be a positive number or the name of a format"),
        ({"sensor_width_mm": 36, "pixel_pitch_um": 5}, "keep one"),
    ],
)
def test_widths_that_cannot_be(rig, message):
    with pytest.raises(InputError, match=message) as caught:
        recipe_from_table({**BASE, "rig": rig})
    assert str(caught.value).startswith("recipe.toml: rig")


def test_a_width_replaces_the_pixel_pitch_of_the_scene(monkeypatch):
    scene = load_scene("cards")
    own = rig_from_table({"pixel_pitch_um": 3.45}, scene, 320, 240).cameras[0]
    assert own.pixel_pitch_um == 3.45
    assert default_rig(scene, 320, 240, intrinsics={"sensor_width_mm": "4/3"}).cameras[
        0
    ].pixel_pitch_um == (pytest.approx(1e3 * SENSOR_WIDTHS_MM["4/3"] / 320))


def test_a_recipe_takes_the_rig_of_a_calibration(tmp_path):
    pair = default_rig(load_scene("cards"), 320, 240, baseline=0.07)
    write_rig(tmp_path / "stereo.yml", pair)
    path = tmp_path / "recipe.toml"
    path.write_text('seed = 1\ncount = 1\nscenes = ["cards"]\n[rig]\nfile = "stereo.yml"\n')  # fmt: skip
    recipe = read_recipe(path)
    settings = read(RecipeSettings, plan(recipe, 0).drawn, path)
    scene = load_scene("cards")
    rig = settings.rig_of(scene, scene.rig, path, recipe.sources.file)
    assert rig.baseline() == pytest.approx(0.07)
    assert rig.cameras[0].width == 320
    assert (rig.world_from_cams[0] == scene.world_from_left).all()
    assert "stereo.yml" in recipe.sources.digests
    (tmp_path / "stereo.yml").write_text("%YAML:1.0\n---\nM1: 3\n")
    with pytest.raises(InputError, match=r"stereo\.yml: has no R"):
        read_recipe(path)
