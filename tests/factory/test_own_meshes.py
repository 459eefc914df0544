"""Own meshes of a recipe: the files that they name belong to the dataset's identity."""

import json

import numpy as np
import pytest
import trimesh

from tests.scenes.gltf_files import picture, png, square, unpacked
from twinlens.errors import FileError
from twinlens.factory.recipe import recipe_from_table
from twinlens.factory.sources import Sources

RECIPE = {"families": ["tabletop"], "seed": 1, "count": 2, "width": 64, "height": 48, "spp": 1}


@pytest.fixture
def folder(tmp_path):
    """parts/deep/m.gltf with its .bin and .png, and parts/box.obj with its .mtl."""
    header, binary = unpacked(
        trimesh.Scene(square(baseColorTexture=picture(np.ones((2, 2, 3))))).export(file_type="glb")
    )
    (tmp_path / "parts" / "deep").mkdir(parents=True)
    (tmp_path / "parts" / "deep" / "m.bin").write_bytes(binary)
    (tmp_path / "parts" / "deep" / "tiles.png").write_bytes(png(np.full((2, 2, 3), 0.5)))
    header["buffers"][0]["uri"] = "m.bin"
    header["images"] = [{"uri": "tiles.png"}]
    (tmp_path / "parts" / "deep" / "m.gltf").write_text(json.dumps(header))
    (tmp_path / "parts" / "box.obj").write_text("mtllib box.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    (tmp_path / "parts" / "box.mtl").write_text("newmtl a\nKd 1 0 0\n")
    return tmp_path


def test_files_that_meshes_name_are_sources(folder):
    recipe = recipe_from_table({**RECIPE, "assets": {"meshes": "parts", "keep_material": True}}, folder / "recipe.toml")
    expected = ["parts/box.mtl", "parts/box.obj", "parts/deep/m.bin", "parts/deep/m.gltf", "parts/deep/tiles.png"]
    assert list(recipe.sources.digests) == expected
    plain = recipe_from_table({**RECIPE, "assets": {"meshes": "parts"}}, folder / "recipe.toml")
    assert "parts/box.mtl" not in plain.sources.digests
    assert "parts/deep/m.bin" in plain.sources.digests  # its geometry


def test_a_change_of_a_material_file_is_noticed(folder):
    sources = Sources(folder, assets={"meshes": ("parts/box.obj",)}, keep_material=True)
    assert set(sources.digests) == {"parts/box.obj", "parts/box.mtl"}
    (folder / "parts" / "box.mtl").write_text("newmtl a\nKd 0 1 0 \n")
    with pytest.raises(FileError, match=r"box\.mtl: has changed while samples were made from it"):
        sources.families_assets.draw("meshes", np.random.default_rng(0))
