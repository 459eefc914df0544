"""Projectors in recipes, and what their samples store of them."""

import dataclasses

import numpy as np
import pytest
from PIL import Image

import twinlens as tl
from tests.factory_recipes import write_recipe
from twinlens.dataset.sample_files import sample_files
from twinlens.dataset.verify import verify_place, verify_sample
from twinlens.factory import generate, make, read_recipe
from twinlens.scenes import load_scene

RECIPE = """
seed = 3
count = 2
scenes = ["tiny"]
width = 24
height = 16
spp = 2
denoise = false
[gates]
attempts = 1
texture = 0
dark = 1
[scene]
ambient = {{ sweep = [0.25, 0] }}
[[rig.projectors]]
translate = [0.03, 0, 0]
width = 40
height = 30
fov_x_deg = 30
band = "rgb"
power = {{ log_uniform = [50, 100] }}
pattern = {{ choice = [{{ type = "dots", density = 0.3 }}, {{ type = "stripes", period = 4 }}] }}
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("projectors")
    assert generate(read_recipe(write_recipe(folder, RECIPE)), folder / "out").complete
    return tl.Dataset(folder / "out")


def test_samples_store_projectors_and_their_truth(data):
    sample = data[0]
    (projector,) = sample.rig.projectors
    assert 50 <= projector.power <= 100
    drawn = sample.record["record"]["spec"]["drawn"]["rig"]["projectors"][0]
    assert drawn["power"] == projector.power
    assert "| projectors of a sample | 1 |" in (data.path / "README.md").read_text()
    for i in (0, 1):
        truth = sample.truth(i)
        (projection,) = truth.projections
        expected = sample.rig.views.project(2, truth.position[truth.hit])
        assert np.abs(projection.pixels[truth.hit] - expected).max() < 1e-4
        assert 0.2 < projection.lit.mean() < 1
    shapes = data.select("projector_pixels0", "lit1")[0]
    assert shapes["projector_pixels0"].shape == (1, 16, 24, 2)
    assert (shapes["lit1"][0] == sample.truth1.projections[0].lit).all()


def test_ambient_scales_the_light_of_the_scene_only(data):
    """With no ambient light, what the projector does not light directly or by reflection is black."""
    ambient, dark = data
    assert (ambient.record["record"]["ambient"], dark.record["record"]["ambient"]) == (
        0.25,
        0,
    )
    scene = load_scene(data.path.parent / "tiny")
    rig = tl.Rig.stereo(tl.Camera.from_fov(24, 16, 50), 0.1, scene.world_from_left)
    whole, half = (
        tl.render(each, rig, spp=4)[0] for each in (scene, scene.with_ambient(0.5))
    )
    assert np.allclose(half, whole / 2, rtol=1e-5)


def test_verify_checks_the_truth_of_projection(data, tmp_path):
    assert not any(findings for _, findings in verify_place(data.path))
    stored = make(read_recipe(data.path.parent / "recipe.toml"), 0)
    first, second = stored.truths
    (light,) = first.projections
    assert light.lit.any()
    wrong = {
        "projector0.u and .v": {
            "projections": (dataclasses.replace(light, pixels=light.pixels + 1),)
        },
        "outside its pattern": {
            "projections": (dataclasses.replace(light, lit=light.lit | True),)
        },
        "faces away from it": {"normal": -first.normal},
    }
    samples = {
        what: dataclasses.replace(
            stored, truths=(dataclasses.replace(first, **changes), second)
        )
        for what, changes in wrong.items()
    }
    unseen = [dataclasses.replace(each, band="nir") for each in stored.rig.projectors]
    samples["no camera sees"] = dataclasses.replace(
        stored, rig=stored.rig.with_projectors(unseen)
    )
    for what, sample in samples.items():
        folder = tmp_path / what.replace(" ", "")
        folder.mkdir()
        for name, content in sample_files(sample).items():
            (folder / name).write_bytes(content)
        (finding,) = verify_sample(tl.Dataset(folder)[0])
        assert finding.startswith(
            "sample.json: " if what == "no camera sees" else "truth0.exr: "
        )
        assert what in finding


def test_a_picture_is_a_pattern_and_a_file_of_the_recipe(data, tmp_path):
    folder = data.path.parent
    Image.fromarray(np.eye(30, 40, dtype=np.uint8) * 255).save(folder / "dots.png")
    text = (
        (folder / "recipe.toml")
        .read_text()
        .replace('{ type = "stripes", period = 4 }', "DOTS")
    )
    text = text.replace('{ type = "dots", density = 0.3 }', "DOTS").replace(
        "width = 40\nheight = 30\n", "aperture_mm = 5\n"
    )
    (folder / "pictured.toml").write_text(
        text.replace("DOTS", '{ type = "picture", file = "dots.png" }')
    )
    recipe = read_recipe(folder / "pictured.toml")
    assert "dots.png" in recipe.sources.files
    (projector,) = make(recipe, 0).rig.projectors
    assert (projector.pattern == np.eye(30, 40)).all()
    assert projector.aperture_diameter == 0.005
