"""Scenes in the near infrared: reflectances and lights by rule and by their own values."""

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.scenes import Bitmap, Color, Scene, SceneObject, Sky, bands, load_scene
from twinlens.scenes.materials import lambert

TOML = """
[materials.dyed]
type = "diffuse"
reflectance = [0.3, 0.05, 0.05]
[materials.own]
type = "mask"
opacity = 1.0
nir = 0.7
bsdf = { type = "diffuse", reflectance = 0.1 }
[materials.gold]
type = "roughconductor"
material = "Au"
[materials.picture]
type = "plastic"
diffuse_reflectance = { type = "checker", cells = 2, colors = [[0.5, 0.0, 0.0], 0.5] }
[objects.lamp]
shape = "rectangle"
material = "dyed"
emitter = { radiance = 3.0, nir = "led" }
[lights.sun]
type = "directional"
irradiance = [2.0, 3.0, 4.0]
nir = "daylight"
[lights.warm]
type = "point"
intensity = [1.845, 0.826, 0.233]
[lights.sky]
type = "sunsky"
[camera]
position = [0, 0, 3]
look_at = [0, 0, 0]
up = [0, 1, 0]
depth_range = [1, 4]
"""


def test_the_band_of_a_scene_file(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(TOML)
    near = bands.near_infrared(load_scene(file))
    assert near.materials["own"].base_color == Color((0.7, 0.7, 0.7))
    assert near.materials["gold"].conductor.k == Color((5.59, 5.59, 5.59))
    assert near.materials["picture"].base_color.pixels.shape == (512, 512)
    dyed = near.materials["dyed"].base_color.rgb[0]
    assert dyed == pytest.approx(0.3 + 0.25 / 0.32 * 0.3)
    assert near.objects[0].emitter is None
    assert near.lights["sun"]["irradiance"].rgb == pytest.approx([0.22 * 3] * 3)
    assert near.lights["warm"]["intensity"].rgb[0] / 0.968 == pytest.approx(
        0.91, abs=0.01
    )  # CIE illuminant A
    assert near.lights["sky"]["sun_scale"] == 0.234
    assert "nir" not in str(near.lights)
    assert all(material.nir is None for material in near.materials.values())
    file.write_text(TOML.replace('nir = "daylight"', 'nir = "sunny"'))
    with pytest.raises(InputError, match=r"lights.sun.nir"):
        load_scene(file)


def test_greys_keep_their_reflectance_and_colours_become_no_darker():
    rgb = np.random.default_rng(1).random((100, 3))
    near = bands.nir_reflectance(rgb)
    assert (
        (near >= rgb.max(axis=-1)) & (near <= np.maximum(rgb.max(axis=-1), 0.6))
    ).all()
    grey = np.linspace(0, 1, 5)
    assert (bands.nir_reflectance(np.stack([grey] * 3, axis=-1)) == grey).all()


def test_a_sky_has_the_share_of_its_mean_colour_or_its_own():
    pixels = np.tile(np.array([0.3, 0.5, 1.0], np.float32), (4, 8, 1))
    scene = Scene("one", (), {}, np.eye(4), (1.0, 2.0), sky=Sky(pixels, scale=2.0))
    assert bands.near_infrared(scene).sky.scale == pytest.approx(
        2 * bands.nir_share(pixels[0, 0])
    )
    assert (
        bands.nir_share(pixels[0, 0])
        < bands.nir_share(np.ones(3))
        < bands.nir_share(np.array([1.0, 0.5, 0.2]))
    )
    dark = Scene("one", (), {}, np.eye(4), (1.0, 2.0), sky=Sky(pixels, nir=0.0))
    assert not bands.near_infrared(dark).is_lit


def test_a_texture_of_two_materials_stays_one():
    picture = Bitmap(np.random.default_rng(1).random((4, 4, 3)).astype(np.float32))
    paint = lambert(picture)
    things = (
        SceneObject("a", {"type": "sphere"}, "a"),
        SceneObject("b", {"type": "sphere"}, "b"),
    )
    near = bands.near_infrared(
        Scene("two", things, {"a": paint, "b": paint}, np.eye(4), (1.0, 2.0))
    )
    assert near.materials["a"].base_color is near.materials["b"].base_color
