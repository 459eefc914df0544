"""Objects of a recipe: drawn poses, copies and meshes, at rest without intersections, and made again from a record."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.families.families_checks import (
    crossing,
    floating,
    intersecting,
    table_height,
)
from twinlens.camera import Camera, Rig
from twinlens.dataset.layouts import category
from twinlens.errors import InputError
from twinlens.factory import make, plan, recipe_from_table, remake
from twinlens.factory.gates import Rejected
from twinlens.factory.ledger import Failure
from twinlens.factory.objects import copy_names, with_objects
from twinlens.factory.produce import sample_or_failure
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
    seat = trimesh.creation.box([0.05, 0.05, 0.006])
    leg = trimesh.creation.box([0.004, 0.004, 0.03])
    corners = [(x, y, -0.015) for x in (-0.02, 0.02) for y in (-0.02, 0.02)]
    legs = [leg.copy().apply_translation(corner) for corner in corners]
    ball, ring = (
        trimesh.creation.icosphere(3, 0.03),
        trimesh.creation.torus(0.03, 0.004),
    )
    lower = ball.triangles_center[:, 2] < 0
    three_quarters = ring.triangles_center[:, :2].min(axis=1) < 0
    return {
        "rod": trimesh.creation.cylinder(0.002, 0.12, sections=8),
        "sheet": trimesh.creation.box([0.1, 0.08, 0.0015]),
        "stool": trimesh.util.concatenate([seat, *legs]),
        "bowl": ball.submesh([np.flatnonzero(lower)], append=True),
        "hook": ring.submesh([np.flatnonzero(three_quarters)], append=True),
    }


def recipe_of(folder, objects, **more):
    table = {"seed": 5, "count": 9, "width": 32, "height": 24, "spp": 1}
    table |= {"scenes": ["scene.toml"], "scene": {"objects": objects}, **more}
    return recipe_from_table(table, folder / "recipe.toml")


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
@pytest.mark.parametrize("count", [10, pytest.param(1000, marks=pytest.mark.slow)])
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
        assert sum("[" in thing.name for thing in scene.objects) == 10
        assert intersecting(scene, 200) == []
        assert crossing(scene) == []
        assert floating(scene, table_height(scene)) == []


@pytest.mark.parametrize(("height", "crosses"), [(0.2, True), (0.205, False)])
def test_crossing_rods_are_found(folder, height, crosses):
    """The check itself: no vertex of one is inside the other."""
    rod = {"file": "thin/rod.ply", "material": "red"}
    first = {**rod, "euler_deg": [90, 0, 0], "translate": [0, 0, 0.2]}
    second = {**rod, "euler_deg": [90, 0, 90], "translate": [0, 0, height]}
    scene = placed(recipe_of(folder, {"one": first, "other": second}))
    pairs = {frozenset(pair) for pair in crossing(scene)}
    assert (frozenset(("one", "other")) in pairs) == crosses
    assert intersecting(scene) == []


def test_bodies_rest_on_other_placed_bodies(folder):
    """The carried bodies stand inside the carrier's top, and both are at rest."""
    tray = {"shape": "box", "extents": [0.2, 0.3, 0.02], "material": "blue"}
    recipe = recipe_of(
        folder,
        {
            "top": {**BOX, "count": 3, "resting_on": "tray"},
            "tray": {**tray, "resting_on": "table", "upright": True},
        },
    )
    scene = placed(recipe)
    names = [body.name for body in scene.objects]
    assert names == ["table", "block", "top[0]", "top[1]", "top[2]", "tray"]
    assert intersecting(scene) == []
    assert floating(scene, table_height(scene)) == []
    for body in scene.objects[2:5]:
        vertices = transformed(body.shape, body.world_from_object).vertices
        assert vertices[:, 2].min() == pytest.approx(0.02, abs=1e-4)


def test_words_choose_place_orientation_and_view(folder):
    cone = {"file": "parts/cone.ply", "resting_on": "table", "material": "red"}
    upright = {"upright": True, "within": [[-0.4, -0.2], [-0.3, 0.0]]}
    recipe = recipe_of(
        folder,
        {
            "up": {**cone, "count": 4, **upright},
            "seen": {**cone, "count": 4, "in_view": 1.0},
            "box": {
                **BOX,
                "resting_on": "table",
                "looking_at": "camera",
                "upright": True,
            },
            "free": {**BOX, "translate": [0, 0, 0.3], "looking_at": "box"},
        },
    )
    base = load_scene(folder / "scene.toml")
    narrow = Rig.stereo(Camera.from_fov(320, 240, 20), 0.02, base.world_from_left)
    scene = with_objects(base, tables(recipe), narrow, 7, folder, recipe.file)
    bodies = {body.name: body for body in scene.objects}

    def pose(name):
        return bodies[name].world_from_object

    def vertices(name):
        return transformed(bodies[name].shape, pose(name)).vertices

    for i in range(4):
        assert pose(f"up[{i}]")[2, 2] == pytest.approx(1)
        x, y = pose(f"up[{i}]")[:2, 3]
        assert -0.4 <= x <= -0.2
        assert -0.3 <= y <= 0.0
        for view, camera in enumerate(narrow.cameras):
            pixels = narrow.project(view, vertices(f"seen[{i}]"))
            assert camera.contains(pixels).all()
    # The box turns its front, -y, to the camera; its origin is near the middle of its contact.
    to_camera = base.world_from_left[:2, 3] - pose("box")[:2, 3]
    front = to_camera / np.linalg.norm(to_camera)
    np.testing.assert_allclose(-pose("box")[:2, 1], front, atol=0.05)
    middle = (vertices("box").min(axis=0) + vertices("box").max(axis=0)) / 2
    to_box = middle - pose("free")[:3, 3]
    axis = to_box / np.linalg.norm(to_box)
    np.testing.assert_allclose(pose("free")[:3, 2], axis, atol=1e-9)


def test_each_copy_draws_its_own_values_and_the_plan_has_them_all(folder):
    part = {**PARTS, "count": {"integers": [5, 9]}}
    recipe = recipe_of(folder, {"part": part})
    drawn = [tables(recipe, i)["part"] for i in range(9)]
    copies = [copy for sample in drawn for copy in sample]
    counts = {len(sample) for sample in drawn}
    assert counts <= set(range(5, 10))
    assert len(counts) > 2
    assert len({copy["scale"] for copy in copies}) == len(copies)
    assert len({copy["file"] for copy in copies}) == 5
    del part["count"]
    (single,) = tables(recipe_of(folder, {"part": part}))["part"]
    assert single["scale"] == drawn[0][0]["scale"], "a count changes no other draw"


def test_copies_are_called_after_their_meshes_or_as_the_recipe_says(folder):
    objects = {
        "part": {**PARTS, "count": 6},
        "tool": {**PARTS, "count": 2, "label": "wrench"},
        "block": {**BOX, "translate": [0, 0, 0.4], "label": "brick"},
    }
    recipe = recipe_of(folder, objects)
    names = copy_names(tables(recipe))
    meshes = [Path(copy["file"]).stem for copy in tables(recipe)["part"]]
    assert [name.split("[")[0] for name in names["part"]] == meshes
    assert names["tool"] == ["wrench[0]", "wrench[1]"]
    assert names["block"] == ["brick"]
    everything = [name for group in names.values() for name in group]
    assert len(set(everything)) == len(everything) == 9
    assert set(everything) <= {thing.name for thing in placed(recipe).objects}
    assert copy_names(
        {"mug": [{}], "part": [{"folder": "p", "file": "p/mug.glb"}]}
    ) == {
        "mug": ["mug"],
        "part": ["mug[0]"],
    }
    with pytest.raises(InputError, match="label: must not end as the number of a copy"):
        recipe_of(folder, {"part": {**PARTS, "label": "nut[2]"}})
    taken = {"block": {**BOX, "translate": [0, 0, 0.4], "label": "table"}}
    with pytest.raises(
        InputError, match=r"'table' is also an object of the scene; give"
    ):
        placed(recipe_of(folder, taken))


@pytest.mark.parametrize("name", ["bolt-1", "bolt-10", "m-8", "part_2", "no.3", "Ü-2"])
@pytest.mark.parametrize("counted", [{}, {"count": 1}])
def test_a_category_is_spelled_as_the_file_the_label_or_the_key(name, counted):
    by_file = {"folder": "parts", "file": f"parts/{name}.glb"}
    objects = {
        "file": [by_file | counted],
        "label": [{"label": f"{name}-7"} | counted],
        f"key-{name}": [counted],
    }
    copies = [copy for names in copy_names(objects).values() for copy in names]
    # Beside names that would be those of the first copies, if their numbers were those of copies.
    scene = [*copies, name.rstrip("-0123456789"), name]
    expected = [name, f"{name}-7", f"key-{name}"]
    assert [category(copy, scene) for copy in copies] == expected


def test_the_record_makes_the_sample_again(folder):
    looks = {"type": "diffuse", "reflectance": {"uniform": [0.2, 0.8]}}
    recipe = recipe_of(
        folder,
        {"part": {**PARTS, "count": 3, "material": looks, "in_view": 0.5}},
        gates={"texture": 0},
    )
    sample = make(recipe, 1)
    again = remake(stored(sample), load_scene(folder / "scene.toml"), folder=folder)
    np.testing.assert_array_equal(sample.shots[0].images[0], again.shots[0].images[0])
    np.testing.assert_array_equal(sample.truths[1].depth, again.truths[1].depth)
    # Of the attempt that was taken, which need not be the first.
    drawn = stored(sample)["record"]["spec"]["drawn"]
    meshes = [Path(copy["file"]).stem for copy in drawn["scene"]["objects"]["part"]]
    names = sample.truths[0].object_names
    assert sorted(name.split("[")[0] for name in names if "[" in name) == sorted(meshes)


def stored(sample):
    from twinlens.dataset.sample_files import sample_files

    return json.loads(dict(sample_files(sample))["sample.json"])


@pytest.mark.parametrize(
    ("objects", "message"),
    [
        ({"mug": {"translate": [0, 0, 1]}}, "mug: a new object needs one of 'file'"),
        ({"block": {"resting_on": "block"}}, "resting_on: unknown object 'block'"),
        (
            {"block": {"resting_on": "table", "translate": [0, 0, 0]}},
            "'translate' and 'resting_on' exclude each other",
        ),
        ({"block": {"within": [[0, 1], [0, 1]]}}, "'within' needs 'resting_on'"),
        ({"p": {**PARTS, "folder": "none"}}, "p: folder: no file or folder 'none'"),
        ({"p": {**PARTS, "file": "a.ply"}}, "'file' and 'folder' exclude each other"),
        ({"p": {**BOX, "file": "../x.ply"}}, "p.file: '../x.ply' leads outside"),
        (
            {"p": {**PARTS, "material": {"choice": ["red", "rad"]}}},
            r"scene.objects.p.material: unknown material 'rad'; did you mean 'red'\?",
        ),
        (
            {"p": {"file": "parts/box.ply"}},
            r"missing key 'material'; only \.glb, \.gltf",
        ),
        ({"p": PARTS, "p[0]": BOX}, r"'p\[0\]' is also the name of a copy of"),
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
    bench = SCENE.replace("block", "lamp").replace("red", "brass")
    chrome = '[materials.chrome]\ntype = "conductor"\n'
    (folder / "bench.toml").write_text(bench + chrome)
    (folder / "models").mkdir()
    trimesh.creation.box([0.06, 0.04, 0.03]).export(folder / "models" / "box.glb")
    blocks = [text.partition("```")[0] for text in page.split("```toml\n")[1:]]
    examples = [text for text in blocks if "scene.objects" in text]
    assert len(examples) == 2
    for text in examples:
        table = tomllib.loads(text.replace('"parts"', '"models"'))
        recipe = recipe_from_table(table, folder / "recipe.toml")
        assert 3 <= len(tables(recipe)["part"]) <= 15


@pytest.mark.parametrize(
    ("keys", "cause", "remedy"),
    [
        (
            {"scale": 100},
            r"'p' is [3-7](.\d+)? m wide, 'table' 1 m",
            "the 'scale' of 'p', such as 0.001 for",
        ),
        (
            {"within": [[3, 4], [0, 1]]},
            "'within' is off 'table', which spans x -0.5 to 0.5 and y -0.4 to 0.4",
            "'within'",
        ),
        (
            {"count": 9, "within": [[-0.02, 0.02], [-0.32, -0.28]]},
            r"'p\[\d\]', 0\.\d+ m wide, on 'table', 1 m, in 200",
            "",
        ),
    ],
)
def test_no_free_place_says_the_sizes(folder, keys, cause, remedy):
    body = {**BOX, **keys, "resting_on": "table"}
    with pytest.raises(Rejected, match=f"no free place: {cause}") as caught:
        placed(recipe_of(folder, {"p": body}))
    assert remedy in caught.value.remedy


WIDE = {**BOX, "scale": 100, "resting_on": "table"}
LARGE_OR_NOT = {"scale": {"choice": [100, 1000]}}


@pytest.mark.parametrize(
    ("objects", "draws"),
    [
        ({"p": WIDE}, 1),
        ({"p": {**WIDE, "count": {"integers": [2, 5]}}}, 1),
        ({"p": {**WIDE, "within": [[-0.2, 0.2], [0, {"uniform": [0.1, 0.2]}]]}}, 1),
        ({"p": {**WIDE, "resting_on": "q"}, "q": {**BOX, "translate": [0, 0, 0.1]}}, 1),
        ({"p": {**WIDE, **LARGE_OR_NOT}}, 3),
        ({"p": {**WIDE, "count": {"integers": [0, 200]}}}, 3),
        ({"p": {**WIDE, "resting_on": "q"}, "q": {**BOX, **LARGE_OR_NOT, "resting_on": "table"}}, 3),
    ],
)  # fmt: skip
def test_an_object_that_never_fits_is_drawn_once(folder, objects, draws):
    """If its size and its carrier's are drawn, or it may be missing, another draw may pass."""
    recipe = recipe_of(folder, objects, gates={"attempts": 3})
    failure = sample_or_failure(recipe, 0)
    assert isinstance(failure, Failure)
    assert {row["reason"] for row in failure.rejections} == {"no free place"}
    assert len(failure.rejections) == draws
