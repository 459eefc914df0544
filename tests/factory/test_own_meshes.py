"""Own meshes of a recipe: the files that they name belong to the dataset's identity."""

import json
import re

import numpy as np
import pytest
import trimesh

from tests.scenes.gltf_files import picture, png, square, unpacked
from twinlens.dataset import read_manifest
from twinlens.errors import FileError, InputError
from twinlens.factory import generate
from twinlens.factory.recipe import recipe_from_table
from twinlens.factory.workers import in_process, worker_processes

OBJ = """mtllib ../../paints/a.mtl
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
vt 0 0
vt 1 0
vt 0 1
usemtl a
f 1/1 3/3 2/2
f 1/1 2/2 4/3
f 1/1 4/2 3/3
f 2/1 3/2 4/3
"""
SIZE = {"seed": 1, "count": 2, "width": 64, "height": 48, "spp": 1}
RECIPE = {"families": ["tabletop"], **SIZE}


@pytest.fixture
def folder(tmp_path):
    """parts/deep/m.gltf with its .bin and .png, and parts/box.obj with its .mtl."""
    painted = square(baseColorTexture=picture(np.ones((2, 2, 3))))
    header, binary = unpacked(trimesh.Scene(painted).export(file_type="glb"))
    deep = tmp_path / "parts" / "deep"
    deep.mkdir(parents=True)
    (deep / "m.bin").write_bytes(binary)
    (deep / "tiles.png").write_bytes(png(np.full((2, 2, 3), 0.5)))
    header["buffers"][0]["uri"] = "m.bin"
    header["images"] = [{"uri": "tiles.png"}]
    (deep / "m.gltf").write_text(json.dumps(header))
    (tmp_path / "parts" / "box.obj").write_text(
        "mtllib box.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n"
    )
    (tmp_path / "parts" / "box.mtl").write_text("newmtl a\nKd 1 0 0\n")
    return tmp_path


def test_files_that_meshes_name_are_sources(folder):
    recipe = recipe_from_table(
        {**RECIPE, "assets": {"meshes": "parts", "keep_material": True}},
        folder / "recipe.toml",
    )
    expected = [
        "parts/box.mtl",
        "parts/box.obj",
        "parts/deep/m.bin",
        "parts/deep/m.gltf",
        "parts/deep/tiles.png",
    ]
    assert list(recipe.sources.digests) == expected
    plain = recipe_from_table(
        {**RECIPE, "assets": {"meshes": "parts"}}, folder / "recipe.toml"
    )
    assert "parts/box.mtl" not in plain.sources.digests
    assert "parts/deep/m.bin" in plain.sources.digests  # its geometry


USES = {
    "families": {
        "families": ["cards"],
        "assets": {"meshes": "parts", "keep_material": True, "mesh_share": 1.0},
    },
    "objects": {
        "scenes": ["cards"],
        "scene": {
            "objects": {
                "own": {
                    "file": "parts/deep/cut.obj",
                    "translate": [0, 0, 1],
                    "scale": 0.1,
                }
            }
        },
    },
}


@pytest.fixture(params=USES)
def shared(tmp_path, request):
    """A recipe of parts/deep/cut.obj, which names ../../paints/a.mtl, which names ../pictures/tiles.png."""
    for name in ("parts/deep", "paints", "pictures"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "parts" / "deep" / "cut.obj").write_text(OBJ)
    (tmp_path / "paints" / "a.mtl").write_text(
        "newmtl a\nmap_Kd ../pictures/tiles.png\n"
    )
    (tmp_path / "pictures" / "tiles.png").write_bytes(png(np.full((2, 2, 3), 0.5)))
    written = {
        **SIZE,
        **USES[request.param],
        "denoise": False,
        "gates": {"texture": 0.0, "visible": 0.0},
    }
    return recipe_from_table(written, tmp_path / "recipe.toml")


NAMED = {"paints/a.mtl", "parts/deep/cut.obj", "pictures/tiles.png"}


def test_files_in_other_folders_of_the_recipe_are_sources(shared):
    assert {*shared.sources.digests} >= NAMED
    if shared.kind == "family":
        _, mesh = shared.sources.families_assets.draw(
            "meshes", np.random.default_rng(0)
        )
        assert list(mesh.materials) == ["parts/deep/cut.obj:a"]
    else:
        shared.sources.check_contents()


@pytest.mark.slow
@pytest.mark.parametrize("engine", [in_process, worker_processes(2)])
def test_samples_are_made_from_files_in_other_folders(shared, tmp_path, engine):
    assert generate(shared, tmp_path / "set", engine=engine).made == 2
    assert read_manifest(tmp_path / "set").info.get("skipped_assets", []) == []
    credits = (tmp_path / "set" / "ASSETS.md").read_text()
    assert all(f"| {name} |" in credits for name in NAMED)
    (tmp_path / "pictures" / "tiles.png").write_bytes(png(np.full((2, 2, 3), 0.25)))
    again = recipe_from_table(shared.written, shared.file)
    with pytest.raises(InputError, match=r"pictures/tiles\.png has changed"):
        generate(again, tmp_path / "set", engine=engine)


def test_files_outside_the_recipes_folder_are_refused(shared, tmp_path):
    (tmp_path.parent / "secret.png").write_bytes(png(np.full((2, 2, 3), 0.5)))
    (tmp_path / "paints" / "a.mtl").write_text("newmtl a\nmap_Kd ../../secret.png\n")
    recipe = recipe_from_table(shared.written, shared.file)
    rule = f"'../secret.png' leads outside the folder {tmp_path.name!r}; copy the file below it"
    if recipe.kind == "family":
        assets = recipe.sources.families_assets.check()
        assert assets.broken == ((tmp_path / "parts" / "deep" / "cut.obj", rule),)
    else:
        with pytest.raises(FileError, match=f"cut.obj: {re.escape(rule)}$"):
            generate(recipe, tmp_path / "set")
    assert not any("secret" in name for name in recipe.sources.digests)
