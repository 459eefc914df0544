"""`[sky]` in recipes: files and folders, scenes and families, their record, and the licences of what was used."""

import hashlib
import json

import numpy as np
import pytest

import twinlens as tl
from tests.factory_recipes import write_recipe, write_sky
from twinlens.dataset import (
    describe,
)
from twinlens.dataset.sample_files import sample_files
from twinlens.errors import InputError
from twinlens.factory import generate, make, read_recipe, remake
from twinlens.families import random_scene
from twinlens.scenes import Sky, load_scene

RECIPE = """
seed = 3
count = 2
scenes = ["tiny"]
width = 24
height = 16
spp = 4
denoise = false
keep = ["radiance"]
[sky]
file = "skies"
turn_deg = {{ uniform = [0, 360] }}
scale = {{ sweep = [1, 2] }}
[about]
license = "CC-BY-4.0"
[[about.credits]]
files = "skies/*.exr"
license = "CC0-1.0"
creator = "Ada | Bob"
url = "https://example.org/sky"
[gates]
attempts = 1
texture = 0
"""


@pytest.fixture
def recipe(tmp_path):
    write_sky(tmp_path / "skies" / "day.exr", np.full((4, 8, 3), 0.5))
    return write_recipe(tmp_path, RECIPE)


def test_a_sky_replaces_the_scenes_own_and_is_recorded(recipe, tmp_path):
    digest = hashlib.sha256((tmp_path / "skies" / "day.exr").read_bytes()).hexdigest()
    expected = {
        "file": "skies/day.exr",
        "sha256": digest,
        "visible": True,
        "lamps": True,
    }
    levels = []
    for i, scale in enumerate((1.0, 2.0)):
        sample = make(read_recipe(recipe), i)
        sky = sample.record["sky"]
        assert sky.items() >= expected.items()
        assert sky["scale"] == scale
        assert 0 <= sky["turn_deg"] <= 360
        levels.append(sample.shots[0].radiances[0].mean())
    # The turn of a uniform sky changes nothing but the noise.
    assert levels[1] / levels[0] == pytest.approx(2, rel=0.15)


def test_licence_and_author_of_each_file_are_in_the_dataset(recipe, tmp_path):
    generate(read_recipe(recipe), tmp_path / "set")
    text = (tmp_path / "set" / "ASSETS.md").read_text()
    digest = hashlib.sha256((tmp_path / "skies" / "day.exr").read_bytes()).hexdigest()
    assert (
        f"| skies/day.exr | `{digest}` | CC0-1.0 | Ada \\| Bob | https://example.org/sky |"
        in text
    )
    assert "| tiny/scene.toml |" in text
    assert "| not stated |" in text
    (tmp_path / "set" / "ASSETS.md").write_text("my own list")
    describe(tmp_path / "set")
    assert (tmp_path / "set" / "ASSETS.md").read_text() == "my own list"


@pytest.mark.parametrize(
    "family",
    ["room", *(pytest.param(f, marks=pytest.mark.slow) for f in ("tabletop", "cards"))],
)
def test_every_family_is_lit_by_a_sky_alone(family):
    """Twice the sky is twice the light: nothing else is lit."""
    scene = random_scene(family, 5, own_lights=False, width=32, object_count=4)
    rig = tl.Rig.stereo(
        tl.Camera.from_fov(32, 24, scene.fov_x_deg),
        scene.baseline,
        scene.world_from_left,
    )
    white = np.ones((4, 8, 3), np.float32)
    one, two = (
        tl.render(scene.lit_by(Sky(white, scale=s), lamps=False), rig, spp=4)[0]
        for s in (1.0, 2.0)
    )
    assert one.mean() > 0.02
    assert np.allclose(two, 2 * one, rtol=1e-3, atol=1e-5)


def test_a_sample_is_made_again_only_under_its_own_sky(recipe):
    sample = make(read_recipe(recipe), 0)
    stored = json.loads(sample_files(sample)["sample.json"])
    scene = load_scene(recipe.parent / "tiny")
    sky = sample.record["sky"]
    lit = scene.lit_by(
        Sky(
            np.full((4, 8, 3), 0.5, np.float32),
            sky["turn_deg"],
            sky["scale"],
            record=sky,
        )
    )
    for again in (remake(stored, lit), remake(stored, scene, folder=recipe.parent)):
        assert np.array_equal(again.shots[0].images[0], sample.shots[0].images[0])
    with pytest.raises(
        InputError,
        match=r"sample\.json: record\.sky: no file or folder 'skies/day\.exr'",
    ):
        remake(stored, scene, folder=recipe.parent / "tiny")
    write_sky(recipe.parent / "skies" / "day.exr", np.full((4, 8, 3), 0.4))
    with pytest.raises(InputError, match="lit by another sky"):
        remake(stored, scene, folder=recipe.parent)


@pytest.mark.parametrize(("old", "new", "message"), [
    ('file = "skies"', 'file = "night.exr"', r"sky\.file: no file or folder 'night.exr' next to the recipe"),
    ('file = "skies"', 'file = "tiny"', r"sky\.file: 'tiny' contains no \.hdr, \.exr, \.png file"),
    ("sweep = [1, 2]", "sweep = [1, 0]", r"sky\.scale: must be > 0"),
    ('files = "skies/*.exr"', 'files = "skies/*.hdr"', r"about\.credits\[0\]\.files: 'skies/\*\.hdr' is none of"),
])  # fmt: skip
def test_mistakes_are_named(recipe, old, new, message):
    recipe.write_text(recipe.read_text().replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        read_recipe(recipe)
    assert "\n" not in str(caught.value)
