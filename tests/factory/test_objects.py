"""Objects of a recipe: drawn poses, copies and meshes, at rest without intersections, and made again from a record."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.families.families_checks import (
    SURROUNDINGS,
    crossing,
    floating,
    intersecting,
    table_height,
)
from twinlens.camera import Camera, Rig
from twinlens.errors import InputError
from twinlens.factory import make, plan, recipe_from_table, remake
from twinlens.factory.gates import Rejected
from twinlens.factory.objects import with_objects
from twinlens.factory.produce import Exhausted
from twinlens.families import Assets, random_scene
from twinlens.scenes import load_scene
from twinlens.scenes.shapes import transformed

SCENE = """
[camera]
position = [0, -0.9, 0.6]
look_at = [0, 0, 0.05]
fov_x_deg = 45
depth_range = [0.6, 2.0]
[materials.red]
type = "diffuse"
reflectance = [0.6, 0.1, 0.1]
[materials.blue]
type = "diffuse"
reflectance = [0.1, 0.1, 0.6]
[objects.table]
shape = "box"
extents = [1.0, 0.8, 0.04]
translate = [0, 0, -0.02]
material = "blue"
[objects.block]
shape = "box"
extents = [0.2, 0.2, 0.05]
translate = [0, 0.1, 0.025]
material = "red"
[lights.sky]
type = "constant"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recipe's folder with a scene and meshes, one of which is not convex."""
    home = tmp_path_factory.mktemp("own")
    (home / "scene.toml").write_text(SCENE)
    (home / "parts").mkdir()
    made = {
        "box": trimesh.creation.box([0.06, 0.04, 0.03]),
        "can": trimesh.creation.cylinder(0.02, 0.05, sections=24),
        "cone": trimesh.creation.cone(0.025, 0.06, sections=24),
        "ring": trimesh.creation.annulus(0.015, 0.03, 0.012, sections=24),
        "torus": trimesh.creation.torus(
            0.03, 0.008, major_sections=24, minor_sections=12
        ),
    }
    for name, mesh in made.items():
        mesh.export(home / "parts" / f"{name}.ply")
    (home / "thin").mkdir()
    for name, mesh in _thin().items():
        mesh.export(home / "thin" / f"{name}.ply")
    return home


def _thin():
    """Meshes that meet others where none of their vertices is inside: rods, legs, a sheet; and open shells."""
    seat, leg, shell = (
        trimesh.creation.box([0.05, 0.05, 0.006]),
        trimesh.creation.box([0.004, 0.004, 0.03]),
        {},
    )
    for name, made in (
        ("bowl", trimesh.creation.icosphere(3, 0.03)),
        ("hook", trimesh.creation.torus(0.03, 0.004)),
    ):
        x, y, z = made.triangles_center.T
        shell[name] = made.submesh(
            [np.flatnonzero((z < 0) if name == "bowl" else (x < 0) | (y < 0))],
            append=True,
        )
    legs = [
        leg.copy().apply_translation([x, y, -0.015])
        for x in (-0.02, 0.02)
        for y in (-0.02, 0.02)
    ]
    return {
        "rod": trimesh.creation.cylinder(0.002, 0.12, sections=8),
        "sheet": trimesh.creation.box([0.1, 0.08, 0.0015]),
        "stool": trimesh.util.concatenate([seat, *legs]),
        **shell,
    }


def recipe_of(folder, objects, **more):
    table = {
        "seed": 5,
        "count": 9,
        "scenes": ["scene.toml"],
        "width": 32,
        "height": 24,
        "spp": 1,
        **more,
    }
    return recipe_from_table(
        {**table, "scene": {"objects": objects, **more.get("scene", {})}},
        folder / "recipe.toml",
    )


def tables(recipe, index=0):
    return plan(recipe, index).drawn["scene"]["objects"]


def placed(recipe, index=0):
    base = load_scene(recipe.file.parent / "scene.toml")
    rig = Rig.stereo(Camera.from_fov(320, 240, 45), 0.06, base.world_from_left)
    return with_objects(
        base,
        tables(recipe, index),
        rig,
        plan(recipe, index).seed,
        recipe.file.parent,
        recipe.file,
    )


PARTS = {
    "folder": "parts",
    "count": 10,
    "scale": {"uniform": [0.7, 1.6]},
    "resting_on": "table",
    "material": "red",
}
BOX = {"file": "parts/box.ply", "material": "red"}


@pytest.mark.parametrize("parts", ["parts", "thin"])
@pytest.mark.parametrize("count", [20, pytest.param(1000, marks=pytest.mark.slow)])
def test_own_meshes_rest_without_intersections(folder, count, parts):
    """By winding numbers and crossing edges, which find any depth; beside a body that is drawn anew."""
    recipe = recipe_of(
        folder,
        {
            "part": {**PARTS, "folder": parts},
            "block": {"translate": [{"uniform": [-0.3, 0.3]}, 0.1, 0.025]},
        },
    )
    for index in range(count // 10):
        scene = placed(recipe, index)
        assert sum(thing.name.startswith("part[") for thing in scene.objects) == 10
        assert intersecting(scene, 200) == []
        assert crossing(scene) == []
        assert floating(scene, table_height(scene)) == []


def test_crossing_rods_are_found(folder):
    """The check itself: no vertex of one is inside the other."""
    rod = {"file": "thin/rod.ply", "material": "red"}
    for height, crosses in ((0.2, True), (0.205, False)):
        flat = [
            {**rod, "euler_deg": [90, 0, turn], "translate": [0, 0, z]}
            for turn, z in ((0, 0.2), (90, height))
        ]
        scene = placed(recipe_of(folder, {"one": flat[0], "other": flat[1]}))
        assert (
            set(crossing(scene)) & {("one", "other"), ("other", "one")} != set()
        ) == crosses
        assert intersecting(scene) == []


def test_bodies_rest_on_other_placed_bodies(folder):
    """The carried bodies stand inside the carrier's top, and both are at rest."""
    recipe = recipe_of(
        folder,
        {
            "top": {"file": "parts/box.ply", "count": 3, "resting_on": "tray", "material": "red"},
            "tray": {"shape": "box", "extents": [0.2, 0.3, 0.02], "resting_on": "table", "upright": True,
                     "material": "blue"},
        },
    )  # fmt: skip
    scene = placed(recipe)
    names = [thing.name for thing in scene.objects]
    assert names == ["table", "block", "top[0]", "top[1]", "top[2]", "tray"]
    assert intersecting(scene) == []
    assert floating(scene, table_height(scene)) == []
    for thing in scene.objects[2:5]:
        assert transformed(thing.shape, thing.world_from_object).vertices[
            :, 2
        ].min() == pytest.approx(0.02, abs=1e-4)


def test_words_choose_place_orientation_and_view(folder):
    cone = {"file": "parts/cone.ply", "resting_on": "table", "material": "red"}
    recipe = recipe_of(
        folder,
        {
            "up": {**cone, "count": 4, "upright": True, "within": [[-0.4, -0.2], [-0.3, 0.0]]},
            "seen": {**cone, "count": 4, "in_view": 1.0},
            "box": {"file": "parts/box.ply", "resting_on": "table", "material": "red", "looking_at": "camera",
                    "upright": True},
            "free": {"file": "parts/can.ply", "translate": [0, 0, 0.3], "looking_at": "box", "material": "red"},
        },
    )  # fmt: skip
    base = load_scene(folder / "scene.toml")
    narrow = Rig.stereo(Camera.from_fov(320, 240, 20), 0.02, base.world_from_left)
    scene = with_objects(base, tables(recipe), narrow, 7, folder, recipe.file)
    things = {thing.name: thing for thing in scene.objects}
    for i in range(4):
        pose = things[f"up[{i}]"].world_from_object
        assert pose[2, 2] == pytest.approx(1)
        assert -0.4 <= pose[0, 3] <= -0.2
        assert -0.3 <= pose[1, 3] <= 0.0
        seen = things[f"seen[{i}]"]
        points = transformed(seen.shape, seen.world_from_object).vertices
        assert all(
            camera.contains(narrow.project(j, points)).all()
            for j, camera in enumerate(narrow.cameras)
        )
    box = things["box"].world_from_object
    to_camera = (base.world_from_left[:2, 3] - box[:2, 3]) / np.linalg.norm(
        base.world_from_left[:2, 3] - box[:2, 3]
    )
    np.testing.assert_allclose(
        -box[:2, 1], to_camera, atol=0.05
    )  # its origin is near the middle of its contact
    free = things["free"].world_from_object
    middle = transformed(things["box"].shape, box).vertices
    middle = (middle.min(axis=0) + middle.max(axis=0)) / 2
    np.testing.assert_allclose(
        free[:3, 2],
        (middle - free[:3, 3]) / np.linalg.norm(middle - free[:3, 3]),
        atol=1e-9,
    )


def test_each_copy_draws_its_own_values_and_the_plan_has_them_all(folder):
    recipe = recipe_of(folder, {"part": {**PARTS, "count": {"integers": [5, 9]}}})
    drawn = [tables(recipe, i)["part"] for i in range(9)]
    assert {len(copies) for copies in drawn} <= set(range(5, 10))
    assert len({len(copies) for copies in drawn}) > 2
    assert len({copy["scale"] for copies in drawn for copy in copies}) == sum(
        map(len, drawn)
    )
    assert len({copy["file"] for copies in drawn for copy in copies}) == 5
    single = recipe_of(
        folder, {"part": {key: value for key, value in PARTS.items() if key != "count"}}
    )
    assert (
        tables(single)["part"][0]["scale"] == drawn[0][0]["scale"]
    )  # a count changes no other draw
    more = recipe_of(
        folder, {"part": {**PARTS, "count": {"integers": [5, 9]}}}, count=20
    )
    assert plan(more, 4) == plan(recipe, 4)
    assert set(recipe.sources.digests) >= {
        "scene.toml",
        "parts/box.ply",
        "parts/torus.ply",
    }


def test_a_scenes_object_keeps_the_keys_that_are_not_given(folder):
    recipe = recipe_of(
        folder,
        {"block": {"euler_deg": [0, 0, {"uniform": [10, 20]}], "material": "blue"}},
    )
    before, after = (
        load_scene(folder / "scene.toml").objects[1],
        placed(recipe).objects[1],
    )
    np.testing.assert_array_equal(before.shape.vertices, after.shape.vertices)
    np.testing.assert_array_equal(
        before.world_from_object[:, 3], after.world_from_object[:, 3]
    )
    assert after.material == "blue"
    assert 10 <= np.degrees(np.arctan2(*after.world_from_object[[1, 0], 0])) <= 20


def test_the_record_makes_the_sample_again(folder):
    looks = {"type": "diffuse", "reflectance": {"uniform": [0.2, 0.8]}}
    recipe = recipe_of(
        folder,
        {"part": {**PARTS, "count": 3, "material": looks, "in_view": 0.5}},
        gates={"texture": 0},
    )
    sample = make(recipe, 1)
    record = json.loads(json.dumps(stored(sample)))
    again = remake(record, load_scene(folder / "scene.toml"), folder=folder)
    np.testing.assert_array_equal(sample.shots[0].images[0], again.shots[0].images[0])
    np.testing.assert_array_equal(sample.truths[1].depth, again.truths[1].depth)
    assert {"part[0]", "part[2]"} <= set(sample.truths[0].object_names)


def stored(sample):
    from twinlens.dataset.sample_files import sample_files

    return json.loads(dict(sample_files(sample))["sample.json"])


def test_families_take_the_same_words(folder):
    """A tabletop of own bodies only: nothing of the family but its surroundings."""
    recipe = recipe_from_table(
        {
            "seed": 2, "count": 3, "families": ["tabletop"], "width": 32, "height": 24, "spp": 1,
            "gates": {"texture": 0, "visible": 0},
            "scene": {
                "object_count": 0,
                "objects": {"part": {**PARTS, "scale": 3, "count": 4, "in_view": 0.9,
                                     "material": {"type": "diffuse", "reflectance": 0.4}}},
            },
        },
        folder / "recipe.toml",
    )  # fmt: skip
    names = set(make(recipe, 0).truths[0].object_names)
    assert {f"part[{i}]" for i in range(4)} <= names
    assert names - {f"part[{i}]" for i in range(4)} <= SURROUNDINGS


def test_a_share_of_one_uses_own_meshes_only(folder):
    own = {"box", "can", "cone", "ring", "torus"}
    names = {share: bodies_of(folder, share) for share in (0.0, 1.0)}
    assert names[1.0] <= own
    assert not names[0.0] & {
        "box",
        "can",
        "torus",
    }  # twinlens has cones and rings of its own


def bodies_of(folder, share):
    assets = Assets.from_folders(meshes=[folder / "parts"], mesh_share=share)
    scene = random_scene("tabletop", 4, assets=assets, width=64)
    return {
        thing.name.split("-")[0]
        for thing in scene.objects
        if thing.name not in SURROUNDINGS
    }


@pytest.mark.parametrize(
    ("objects", "message"),
    [
        (
            {"mug": {"translate": [0, 0, 1]}},
            "recipe.toml: scene.objects.mug: a new object needs one of 'file', 'folder'",
        ),
        (
            {"block": {"resting": "table"}},
            r"scene.objects.block: unknown key 'resting'; did you mean 'resting_on'\?",
        ),
        (
            {"block": {"resting_on": "tabel"}},
            "scene.objects.block.resting_on: unknown object 'tabel'; did you mean",
        ),
        (
            {"block": {"resting_on": "block"}},
            "scene.objects.block.resting_on: unknown object 'block'",
        ),
        (
            {"block": {"resting_on": "table", "translate": [0, 0, 0]}},
            "'translate' and 'resting_on' exclude each other",
        ),
        ({"block": [{"scale": 2}]}, r"scene.objects.block: must be one table, got \["),
        (
            {"block": {"within": [[0, 1], [0, 1]]}},
            "scene.objects.block: 'within' needs 'resting_on'",
        ),
        (
            {"block": {"count": {"uniform": [1, 3]}}},
            "scene.objects.block.count: must be a whole number",
        ),
        (
            {"block": {"scale": {"uniform": [0, 1]}}},
            "scene.objects.block.scale: must be > 0, got 0",
        ),
        (
            {"p": {**PARTS, "folder": "none"}},
            "scene.objects.p: folder: no file or folder 'none'",
        ),
        (
            {"p": {**PARTS, "file": "parts/box.ply"}},
            "scene.objects.p: 'file' and 'folder' exclude each other",
        ),
        (
            {"p": {"file": "../x.ply", "material": "red"}},
            "scene.objects.p.file: '../x.ply' leads outside",
        ),
        (
            {"p": {**PARTS, "material": {"type": "dffuse"}}},
            "scene.objects.p.material.type: must be one of",
        ),
        (
            {"p": {**PARTS, "material": "rad"}},
            r"scene.objects.p.material: unknown material 'rad'; did you mean 'red'\?",
        ),
        (
            {"p": {**PARTS, "material": {"choice": ["red", "rad"]}}},
            "scene.objects.p.material: unknown material 'rad'",
        ),
        (
            {"p": {"file": "scene.toml"}},
            "scene.objects.p: file: meshes may be .*, got 'scene.toml'",
        ),
        (
            {"p": {"file": "scene.toml", "material": "red"}},
            "scene.objects.p: file: meshes may be .*, got 'scene.toml'",
        ),
        (
            {"p": {"file": "parts/box.ply"}},
            "scene.objects.p: missing key 'material'; only .glb, .gltf, .obj files",
        ),
        ({"p": {"folder": "parts"}}, "scene.objects.p: missing key 'material'"),
        ({"": PARTS}, "scene.objects: an object needs a name, got ''"),
        (
            {"p": PARTS, "p[0]": {"file": "parts/box.ply", "material": "red"}},
            r"'p\[0\]' is also the name of a copy of",
        ),
        (
            {"p": {**BOX, "resting_on": "q"}, "q": {**BOX, "resting_on": "p"}},
            ". -> . -> . rest on or look at each other",
        ),
    ],
)
def test_mistakes_are_one_line_that_names_file_key_and_remedy(folder, objects, message):
    with pytest.raises(InputError, match=message) as caught:
        recipe_of(folder, objects)
    assert "\n" not in str(caught.value)


def test_the_examples_of_the_page_are_read(folder):
    page = (Path(__file__).parents[2] / "docs" / "recipes.md").read_text()
    bench = SCENE.replace("objects.block", "objects.lamp").replace(
        "materials.red", "materials.brass"
    )
    (folder / "bench.toml").write_text(
        bench.replace('"red"', '"brass"') + '[materials.chrome]\ntype = "conductor"\n'
    )
    examples = [
        text.split("```")[0]
        for text in page.split("```toml\n")[1:]
        if "scene.objects" in text.split("```")[0]
    ]
    assert len(examples) == 2
    (folder / "models").mkdir()
    trimesh.creation.box([0.06, 0.04, 0.03]).export(folder / "models" / "box.glb")
    for text in examples:
        recipe = recipe_from_table(
            tomllib.loads(text.replace('"parts"', '"models"')), folder / "recipe.toml"
        )
        assert 3 <= len(tables(recipe)["part"]) <= 15


def test_a_full_table_rejects_the_draw(folder):
    recipe = recipe_of(
        folder,
        {"part": {**PARTS, "count": 9, "within": [[-0.02, 0.02], [-0.32, -0.28]]}},
    )
    with pytest.raises(
        Rejected,
        match=r"no free place: 'part\[\d\]', 0\.\d+ m wide, on 'table', 1 m, in 200",
    ):
        placed(recipe)


@pytest.mark.parametrize(("keys", "found", "remedy"), [
    ({"scale": 100}, "'p' is [3-7](.\\d+)? m wide, 'table' 1 m", "the 'scale' of 'p', such as 0.001 for"),
    ({"within": [[3, 4], [0, 1]]}, "'within' is off 'table', which spans x -0.5 to 0.5 and y -0.4 to 0.4", "'within'"),
])  # fmt: skip
def test_no_free_place_says_the_sizes(folder, keys, found, remedy):
    with pytest.raises(Rejected, match=f"no free place: {found}") as caught:
        placed(recipe_of(folder, {"p": {**BOX, **keys, "resting_on": "table"}}))
    assert remedy in caught.value.remedy


def test_rejections_name_the_recipes_own_file(folder):
    table = {
        "seed": 1,
        "count": 1,
        "scenes": ["scene.toml"],
        "width": 32,
        "height": 24,
        "spp": 1,
    }
    objects = {"p": {"shape": "sphere", "material": "red", "resting_on": "table"}}
    with pytest.raises(Exhausted) as caught:
        make(
            recipe_from_table(
                {**table, "scene": {"objects": objects}}, folder / "mine.toml"
            ),
            0,
        )
    assert caught.value.rejections[0]["found"].startswith(
        "mine.toml: scene.objects.p: resting_on: needs a mesh"
    )


@pytest.mark.parametrize(("family", "objects", "message"), [
    ("flying", {"p": {**BOX, "resting_on": "table", "material": "moon"}}, "p.resting_on: unknown object 'table'"),
    ("tabletop", {"p": {**BOX, "resting_on": "tabel", "material": "wall"}}, "'tabel'; did you mean 'table'"),
    ("tabletop", {"p": {**BOX, "material": "gray"}}, "p.material: unknown material 'gray'"),
])  # fmt: skip
def test_names_that_no_scene_of_a_family_has_are_refused(
    folder, family, objects, message
):
    table = {"seed": 1, "count": 1, "families": [family], "scene": {"objects": objects}}
    with pytest.raises(InputError, match=message):
        recipe_from_table(table, folder / "recipe.toml")
    fitting = {
        "p": {
            **BOX,
            "looking_at": "wall" if family == "tabletop" else "backdrop",
            "material": "key-light",
        }
    }
    recipe_from_table({**table, "scene": {"objects": fitting}}, folder / "recipe.toml")
