"""A dataset is tied to the contents of its source files: samples of two versions of a file are never mixed."""

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.factory_recipes import RECIPE, SCENE, digests, write_recipe, write_sky
from twinlens.dataset import read_manifest, write_png
from twinlens.errors import FileError, InputError
from twinlens.factory import generate, make, read_recipe
from twinlens.factory.sources import Sources, file_digests
from twinlens.factory.workers import Order, make_one
from twinlens.scenes import load_scene

ASSETS = """
seed = 6
count = 2
families = ["cards"]
width = 32
height = 24
spp = 1
denoise = false
[scene]
object_count = 12
[assets]
textures = ["mine"]
[gates]
texture = 0
dark = 1
burnt = 1
"""


def picture(path: Path, seed: int) -> None:
    path.parent.mkdir(exist_ok=True)
    write_png(path, np.random.default_rng(seed).integers(0, 255, (16, 16, 3), np.uint8))


@pytest.fixture
def unfinished_dataset(tmp_path):
    """A recipe of the tiny scene, and a dataset that has one of its two samples."""
    recipe = write_recipe(tmp_path, count=2)
    generate(read_recipe(recipe), tmp_path / "set", limit=1)
    return recipe, tmp_path / "set"


def test_a_scene_edited_between_two_runs_is_an_error_until_it_is_restored(
    unfinished_dataset,
):
    """A new modification time alone is no change."""
    recipe, folder = unfinished_dataset
    before = digests(folder)
    scene = recipe.parent / "tiny" / "scene.toml"
    scene.write_text(SCENE.replace("reflectance = 0.4", "reflectance = 0.5"))
    changed = r"tiny/scene\.toml has changed.*restore them, or name"
    with pytest.raises(InputError, match=changed):
        generate(read_recipe(recipe), folder)
    assert digests(folder) == before
    scene.write_text(SCENE)
    os.utime(scene, (1, 1))
    assert generate(read_recipe(recipe), folder).complete


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda mine: (mine / "a.png").unlink(), "mine/a.png is gone"),
        (lambda mine: picture(mine / "c.png", 9), "mine/c.png is new"),
    ],
)
def test_a_changed_added_or_removed_asset_is_named(tmp_path, edit, message):
    for seed, name in enumerate(("a.png", "b.png")):
        picture(tmp_path / "mine" / name, seed)
    (tmp_path / "recipe.toml").write_text(ASSETS)
    generate(read_recipe(tmp_path / "recipe.toml"), tmp_path / "set", limit=1)
    assert set(read_manifest(tmp_path / "set").info["sources"]) == {
        "mine/a.png",
        "mine/b.png",
    }
    edit(tmp_path / "mine")
    with pytest.raises(InputError, match=message):
        generate(read_recipe(tmp_path / "recipe.toml"), tmp_path / "set")


@pytest.mark.parametrize("damage", ["edited", "gone"])
def test_an_asset_that_changes_in_the_middle_is_told_and_is_no_bad_draw(
    tmp_path, damage
):
    picture(tmp_path / "mine" / "a.png", 0)
    (tmp_path / "recipe.toml").write_text(ASSETS)
    recipe = read_recipe(tmp_path / "recipe.toml")
    _ = recipe.sources.digests
    picture(tmp_path / "mine" / "a.png", 1)
    if damage == "gone":
        (tmp_path / "mine" / "a.png").unlink()
    with pytest.raises(
        FileError,
        match=r"mine/a\.png: (has changed while|cannot be read \(No such file)",
    ):
        make(recipe, 0)


WALL = """<scene version="3.0.0">
<integrator type="path"/>
<emitter type="constant"/>
<shape type="rectangle"><transform name="to_world"><scale value="9"/>
<rotate x="1" angle="180"/><translate z="{z}"/></transform></shape>
<sensor type="perspective"><float name="fov" value="50"/></sensor>
</scene>"""


@pytest.mark.parametrize("rendered", [False, True])
def test_a_mitsuba_file_that_changes_in_the_middle_is_told(tmp_path, rendered):
    """Mitsuba opens it when it is first rendered, after twinlens has read it."""
    wall, path = tmp_path / "wall.xml", tmp_path / "recipe.toml"
    wall.write_text(WALL.format(z=3))
    size = "width = 9\nheight = 9\nspp = 1\ndenoise = false\ngates = { texture = 0, burnt = 1 }\n"
    path.write_text(f'seed = 4\ncount = 2\nscenes = ["wall.xml"]\n{size}')
    recipe = read_recipe(path)
    _ = recipe.sources.digests
    if rendered:
        make(recipe, 0)
    wall.write_text(WALL.format(z=7))
    with pytest.raises(FileError, match=r"wall\.xml: has changed while samples were"):
        make(recipe, 1)


def test_a_mask_that_goes_in_the_middle_ends_the_run_and_keeps_what_was_made(tmp_path):
    mask, away = tmp_path / "code.png", tmp_path / "away.png"
    lens, rest = RECIPE.index('kind = "thin"'), RECIPE.index("[sensor]")
    shape = 'shape = {{ kind = "mask", file = "code.png" }}\n\n'
    thin = f'kind = "thin"\naperture_mm = 8\n{shape}'
    write_png(mask, np.eye(3, dtype=np.uint8) * 255)
    path = write_recipe(tmp_path, RECIPE[:lens] + thin + RECIPE[rest:], count=2)
    recipe, folder = read_recipe(path), tmp_path / "set"
    assert set(recipe.sources.digests) == {"code.png", "tiny/scene.toml"}
    generate(recipe, folder, limit=1)
    mask.rename(away)
    with pytest.raises(FileError, match=r"code\.png"):
        generate(recipe, folder)
    assert read_manifest(folder).info["rejections"] == {}
    away.rename(mask)
    assert generate(read_recipe(path), folder).complete


def test_a_worker_with_other_files_refuses(tmp_path):
    recipe = read_recipe(write_recipe(tmp_path))
    from twinlens.factory.sample import made_with

    order = Order(
        recipe.written,
        tmp_path / "recipe.toml",
        tmp_path,
        made_with(),
        {"a.png": "00"},
        1,
    )
    with pytest.raises(
        InputError,
        match=r"this worker has other source files .*: a\.png is gone, tiny/scene\.toml is new",
    ):
        make_one(order, 0)


def test_a_scenes_files_have_the_same_names_however_its_folder_is_written(
    tmp_path, monkeypatch
):
    """Two of one name in two folders stay two."""
    (tmp_path / "scene").mkdir()
    for seed, folder in enumerate(("a", "b")):
        picture(tmp_path / "scene" / folder / "t.png", seed)
    textures = "".join(
        f'[textures.{k}]\ntype = "bitmap"\nfilename = "{k}/t.png"\n' for k in ("a", "b")
    )
    painted = SCENE.replace('"noise"', '"a"').replace(
        "reflectance = 0.4", 'reflectance = "b"'
    )
    (tmp_path / "scene" / "scene.toml").write_text(
        painted.replace("[textures.noise]", f"{textures}[textures.noise]")
    )
    monkeypatch.chdir(tmp_path)
    by_folder = [
        file_digests(load_scene(where))
        for where in ("scene", tmp_path / "scene", "./scene/scene.toml")
    ]
    assert by_folder[0] == by_folder[1] == by_folder[2]
    assert set(by_folder[0]) == {"scene.toml", "a/t.png", "b/t.png"}
    sources = Sources(tmp_path, ("scene",))
    assert set(sources.digests) == {
        "scene/scene.toml",
        "scene/a/t.png",
        "scene/b/t.png",
    }
    content = (tmp_path / "scene/a/t.png").read_bytes()
    assert sources.digests["scene/a/t.png"] == hashlib.sha256(content).hexdigest()


def test_a_bundled_scene_is_named_after_itself():
    assert "cards/scene.toml" in Sources(scenes=("cards",)).digests


def test_damaged_meshes_and_skies_are_found_before_the_first_sample(tmp_path):
    recipe = write_recipe(tmp_path, OWN)
    write_sky(tmp_path / "skies" / "day.exr", np.ones((4, 8, 3)))
    (tmp_path / "parts").mkdir()
    for name in "ab":
        trimesh.creation.box([0.1, 0.1, 0.1]).export(tmp_path / "parts" / f"{name}.glb")
    whole = (tmp_path / "parts" / "b.glb").read_bytes()
    (tmp_path / "parts" / "b.glb").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileError, match=r"b\.glb: "):
        generate(read_recipe(recipe), tmp_path / "set")
    assert not (tmp_path / "set").exists()
    (tmp_path / "parts" / "b.glb").write_bytes(whole)
    write_sky(tmp_path / "skies" / "night.exr", np.zeros((4, 8, 3)))
    with pytest.raises(FileError, match=r"^sky\.file: .*night\.exr: is black"):
        generate(read_recipe(recipe), tmp_path / "set")


OWN = """
seed = 3
count = 1
scenes = ["tiny"]
width = 24
height = 16
spp = 1
denoise = false
[sky]
file = "skies"
[scene.objects.part]
folder = "parts"
translate = [0, 0, 1]
[gates]
texture = 0
"""
