"""A user's own files are drawn from; what cannot be used is skipped, named and counted."""

import numpy as np
import pytest

from twinlens.dataset import Dataset, read_manifest
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.verify import verify_sample
from twinlens.factory import generate, read_recipe

RECIPE = """
seed = 4
count = 1
families = ["cards"]
width = 48
height = 36
spp = 1
denoise = false
[scene]
object_count = 4
[assets]
textures = "mine"
[gates]
texture = 0
"""


@pytest.fixture
def recipe(tmp_path):
    (tmp_path / "mine" / "deeper").mkdir(parents=True)
    pixels = np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)
    (tmp_path / "mine" / "good.png").write_bytes(encode_png(pixels))
    (tmp_path / "mine" / "deeper" / "broken.png").write_bytes(b"not a picture")
    (tmp_path / "recipe.toml").write_text(RECIPE)
    return read_recipe(tmp_path / "recipe.toml")


def test_broken_files_are_skipped_and_named_without_the_machines_paths(
    recipe, tmp_path
):
    assert generate(recipe, tmp_path / "set").complete
    skipped = read_manifest(tmp_path / "set").info["skipped_assets"]
    assert [(entry["kind"], entry["file"]) for entry in skipped] == [
        ("textures", "mine/deeper/broken.png")
    ]
    assert skipped[0]["reason"]
    assert str(tmp_path) not in (tmp_path / "set" / "dataset.json").read_text()
    assert verify_sample(Dataset(tmp_path / "set")[0]) == []
