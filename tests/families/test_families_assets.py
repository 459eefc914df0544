"""A user's own files: normalised, drawn, placed at rest; broken ones are skipped and listed."""

import tracemalloc

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.families.families_checks import floating, intersecting, table_height
from tests.scenes.gltf_files import write
from twinlens.errors import InputError
from twinlens.families import Assets, random_scene
from twinlens.families.assets import MAX_CACHED


@pytest.fixture
def folder(tmp_path):
    """Three good meshes of odd sizes, three broken ones, a picture and an environment map."""
    trimesh.creation.box([200.0, 90.0, 50.0]).export(tmp_path / "crate.ply")
    trimesh.creation.capsule(height=0.02, radius=0.01).export(tmp_path / "pill.obj")
    trimesh.creation.icosphere(subdivisions=2, radius=7).export(tmp_path / "globe.glb")
    (tmp_path / "torn.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 9\n")
    (tmp_path / "empty.obj").write_text("# nothing\n")
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).export(
        tmp_path / "flat.ply"
    )
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 255, (40, 60, 3), dtype=np.uint8)).save(
        tmp_path / "cloth.png"
    )
    (tmp_path / "torn.png").write_bytes(b"\x89PNG broken")
    return tmp_path


def test_broken_files_are_listed_with_the_reason(folder):
    assets = Assets.from_folders(meshes=[folder], textures=[folder], hdris=[folder])
    assert assets.broken == ()  # no file was read yet
    assets.check()
    assert {path.name for path, _ in assets.broken} == {
        "torn.ply",
        "empty.obj",
        "flat.ply",
        "torn.png",
    }
    assert all(reason and "\n" not in reason for _, reason in assets.broken)
    assert "flat" in {path.name: reason for path, reason in assets.broken}["flat.ply"]


def test_memory_does_not_grow_with_the_folder(tmp_path):
    for i in range(12):
        Image.fromarray(np.full((500, 500, 3), 20 * i, np.uint8)).save(
            tmp_path / f"{i}.png"
        )
    assets = Assets.from_folders(textures=[tmp_path])
    tracemalloc.start()
    assets.check()
    kept = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert kept < 6 * 500 * 500 * 3 * 4
    assert not assets.broken


def test_a_file_may_be_a_texture_and_an_environment_map(tmp_path):
    Image.fromarray(np.full((4, 4, 3), 255, np.uint8)).save(tmp_path / "white.png")
    assets = Assets.from_folders(textures=[tmp_path], hdris=[tmp_path])
    rng = np.random.default_rng(0)
    assert assets.draw("textures", rng)[1].max() == pytest.approx(0.95)
    assert assets.draw("hdris", rng)[1].max() == pytest.approx(1.0)


def test_meshes_are_scaled_to_extent_one(folder):
    assets = Assets.from_folders(meshes=[folder])
    rng = np.random.default_rng(1)
    drawn = dict(assets.draw("meshes", rng) for _ in range(30))
    assert set(drawn) == {"crate", "pill", "globe"}
    for mesh in drawn.values():
        assert np.ptp(mesh.vertices, axis=0).max() == pytest.approx(1.0)
        np.testing.assert_allclose(
            mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0), 0, atol=1e-9
        )


def test_user_meshes_rest_on_the_table(folder):
    assets = Assets.from_folders(meshes=[folder], textures=[folder], hdris=[folder])
    scene = random_scene("tabletop", 8, assets=assets, object_count=9, width=80)
    names = {thing.name.rsplit("-", 1)[0] for thing in scene.objects}
    assert names & {"crate", "pill", "globe"}
    assert intersecting(scene) == []
    assert floating(scene, table_height(scene)) == []


@pytest.mark.parametrize("family", ["flying", "room", "cards", "street"])
def test_every_family_accepts_user_files(folder, family):
    assets = Assets.from_folders(meshes=[folder], textures=[folder], hdris=[folder])
    assert random_scene(family, 1, assets=assets, width=80).objects


def test_with_only_broken_files_scenes_use_built_in_bodies(folder):
    for name in ("crate.ply", "pill.obj", "globe.glb"):
        (folder / name).unlink()
    assets = Assets.from_folders(meshes=[folder])
    assert random_scene("tabletop", 1, assets=assets, width=80).objects
    assert len(assets.broken) == 3


def test_a_missing_or_empty_folder_is_an_error(tmp_path):
    with pytest.raises(InputError, match="no file or folder"):
        Assets.from_folders(meshes=[tmp_path / "nowhere"])
    with pytest.raises(InputError, match=r"contains no \.glb"):
        Assets.from_folders(meshes=[tmp_path])


def write_part(path, size):
    """A box of `size` metres (3,), y up, of red metal; trimesh writes it."""
    made = trimesh.creation.box(size)
    paint = trimesh.visual.material.PBRMaterial(
        name="red", baseColorFactor=[255, 0, 0, 255], metallicFactor=1.0
    )
    made.visual = trimesh.visual.TextureVisuals(
        uv=np.zeros((len(made.vertices), 2)), material=paint
    )
    made.export(path)


@pytest.mark.parametrize("family", ["tabletop", "flying"])
def test_meshes_keep_their_size_and_materials_if_asked(tmp_path, family):
    write_part(tmp_path / "part.glb", [0.012, 0.08, 0.05])
    assets = Assets.from_folders(meshes=[tmp_path], keep_scale=True, keep_material=True)
    scene = random_scene(family, 3, assets=assets, object_count=16, width=80)
    parts = [thing for thing in scene.objects if thing.name.startswith("part")]
    assert len(parts) > 2
    for thing in parts:
        sides = np.linalg.norm(thing.world_from_object[:3, :3], axis=0) * np.ptp(
            thing.shape.vertices, axis=0
        )
        np.testing.assert_allclose(sides, [0.012, 0.05, 0.08], rtol=1e-6)
        (name,) = thing.materials
        assert scene.materials[name].base_color.rgb == (1.0, 0.0, 0.0)
        assert scene.materials[name].metallic == 1.0
    assert len({thing.materials for thing in parts}) == 1
    if family == "tabletop":
        assert intersecting(scene) == []
        assert floating(scene, table_height(scene)) == []


def test_files_of_one_name_keep_their_own_materials(tmp_path):
    for name, side in (("a", 0.05), ("b", 0.1)):
        (tmp_path / name).mkdir()
        write_part(tmp_path / name / "part.glb", [side, side, side])
    assets = Assets.from_folders(meshes=[tmp_path], keep_scale=True, keep_material=True)
    scene = random_scene("tabletop", 3, assets=assets, object_count=16, width=80)
    names = {
        thing.materials for thing in scene.objects if thing.name.startswith("part")
    }
    assert names == {("part.glb:red",), ("part.glb:red-2",)}


def test_a_kept_size_excludes_a_depth_range(tmp_path):
    write_part(tmp_path / "part.glb", [0.1, 0.1, 0.1])
    assets = Assets.from_folders(meshes=[tmp_path], keep_scale=True)
    with pytest.raises(
        InputError,
        match="depth_range scales the whole scene; it cannot be used with keep_scale",
    ):
        random_scene("tabletop", 3, assets=assets, width=80, depth_range=(1.0, 4.0))


PAINTED = {"materials": [{"name": "paint"}], "meshes/0/primitives/0/material": 0}


def test_own_materials_do_not_depend_on_what_was_read_before(tmp_path):
    """More files than are kept in memory: one that is read twice for a scene has its materials once."""
    box = trimesh.creation.box([0.1, 0.2, 0.3])
    for i in range(MAX_CACHED + 3):
        write(tmp_path / f"m{i}.glb", box, PAINTED)

    def assets():
        return Assets.from_folders(
            meshes=[tmp_path], keep_material=True, mesh_share=1.0
        )

    used = assets()
    random_scene("tabletop", 1, assets=used, width=64)
    first = random_scene("tabletop", 2, assets=assets(), width=64)
    second = random_scene("tabletop", 2, assets=used, width=64)
    assert list(first.materials) == list(second.materials)
    materials = [item.material for item in first.objects]
    assert materials == [item.material for item in second.objects]
    of_files = [names for names in materials if isinstance(names, tuple)]
    assert len(of_files) > len(set(of_files))
    assert not any("-2" in name for names in of_files for name in names)
