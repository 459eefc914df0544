"""From a folder of two meshes to COCO and BOP, by the commands of docs/own_objects.md alone."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import trimesh

import twinlens as tl
from tests.docs.pages import blocks

PAGE = Path(__file__).parents[2] / "docs" / "own_objects.md"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="docs/ is not next to tests/")
SMALL = {
    "count = 1000": "count = 4\nspp = 1\ndenoise = false",
    "width = 640\nheight = 480": "width = 64\nheight = 48",
    "train = 0.8\nval = 0.2": "train = 0.5\nval = 0.5",
    "in_view = 0.9": "",
    "[splits]": "[gates]\ntexture = 0\n[splits]",
}
NAMES = {"mug", "brick"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the meshes and the recipe of the page, smaller."""
    recipe = next(text for _, text in blocks(PAGE, "toml") if "[splits]" in text)
    for large, small in SMALL.items():
        assert large in recipe
        recipe = recipe.replace(large, small)
    (tmp_path / "parts.toml").write_text(recipe)
    (tmp_path / "parts").mkdir()
    mug = trimesh.creation.cylinder(0.04, 0.1, sections=24)
    brick = trimesh.creation.box([0.12, 0.06, 0.04])
    for name, mesh in {"mug": mug, "brick": brick}.items():
        mesh.visual.vertex_colors = [180, 90, 60, 255]
        mesh.export(tmp_path / "parts" / f"{name}.glb")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def commands():
    """The indented commands of the page's section on several parts."""
    section = PAGE.read_text().split("## Several parts")[1]
    lines = re.findall(r"^    (twinlens .*)$", section, flags=re.MULTILINE)
    return [shlex.split(line)[1:] for line in lines]


def read(path):
    return json.loads(Path(path).read_text())


# of pycocotools 2.0.11
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.slow
def test_from_two_meshes_to_categories_of_their_names(twinlens, folder):
    for command in commands():
        code, out, err = twinlens(*command)
        assert code == 0, out + err
    data = tl.Dataset("set")
    seen = {
        truth.object_name(item).partition("[")[0]
        for sample in data
        for truth in (sample.truth0, sample.truth1)
        for item in truth.objects
    }
    assert seen >= NAMES

    whole = read("set-coco/annotations/instances.json")
    assert {row["name"] for row in whole["categories"]} == NAMES
    assert whole["info"]["description"] == "Mugs and bricks on a table."
    assert whole["info"]["contributor"] == "Your Name"
    assert [row["name"] for row in whole["licenses"]] == ["CC-BY-4.0"]
    splits = {row.info["split"] for row in data.manifest.rows}
    files = [f"set-coco/annotations/instances_{split}.json" for split in splits]
    images = [image["file_name"] for file in files for image in read(file)["images"]]
    assert sorted(images) == sorted(image["file_name"] for image in whole["images"])

    mugs = read("mugs-coco/annotations/instances.json")
    assert [row["name"] for row in mugs["categories"]] == ["mug"]
    assert 0 < len(mugs["annotations"]) < len(whole["annotations"])
    _check_masks(mugs, data)

    absent = ("export", "set", "--to", "coco", "--object", "mgu", "-o", "absent")
    code, out, err = twinlens(*absent)
    assert code == 2
    assert "mug" in err
    assert len((out + err).strip().splitlines()) == 1
    assert not Path("absent").exists()

    models = read("set-bop/models/models_info.json")
    assert {model["name"] for model in models.values()} == NAMES
    sizes = {model["name"]: model["diameter"] for model in models.values()}
    # Millimetres, between the farthest vertices: of a cylinder of 80 x 100 mm, and of a box.
    assert sizes["mug"] == pytest.approx(np.hypot(80, 100), rel=1e-3)
    assert sizes["brick"] == pytest.approx(np.linalg.norm([120, 60, 40]), rel=1e-3)


def _check_masks(mugs, data):
    """pycocotools decodes each mask to the pixels of a mug in the truth."""
    masks = pytest.importorskip("pycocotools.mask")
    for row in mugs["annotations"]:
        number, view = divmod(row["image_id"] - 1, 2)
        truth = data[number].truth(view)
        mug_ids = [
            item.object_id
            for item in truth.objects
            if truth.object_name(item).startswith("mug[")
        ]
        pixels = masks.decode(row["segmentation"]) > 0
        assert set(np.unique(truth.object_id[pixels])) <= set(mug_ids)
        assert row["area"] == pixels.sum()
