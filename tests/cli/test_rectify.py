import json

import numpy as np
import pytest

from tests.factory_recipes import write_recipe, write_sky
from twinlens.cli import run
from twinlens.dataset import Dataset, write_sample
from twinlens.factory import make, read_recipe

QUICK = ("--size", "48x36", "--spp", "1", "--no-denoise")


@pytest.fixture(scope="module")
def toed_in(tmp_path_factory):
    """A sample of two cameras that are turned to each other."""
    folder = tmp_path_factory.mktemp("toed_in")
    (folder / "rig.toml").write_text('layout = "toed_in"\nbaseline = 0.2\n')
    line = (
        "render",
        "cards",
        "--rig",
        folder / "rig.toml",
        *QUICK,
        "-o",
        folder / "out",
    )
    assert run([str(part) for part in line]) == 0
    return folder / "out" / "cards"


def test_a_toed_in_pair_is_rectified_and_verifies(twinlens, toed_in, tmp_path):
    target = tmp_path / "new" / "cards"
    line = ("rectify", toed_in, "-o")
    code, out, _ = twinlens(*line, target, "--own-centres", "--json")
    answer = json.loads(out)
    assert code == 0
    assert {"disp0.pfm", "calib.txt"} <= set(answer["files"])
    assert Dataset(target)[0].calibration.doffs == answer["doffs"] != 0
    assert twinlens("verify", target)[0] == 0
    assert twinlens(*line, target)[0] == 2
    assert twinlens(*line, target, "--overwrite")[0] == 0


def test_a_pair_without_a_rectification_is_refused_in_a_line(twinlens, tmp_path):
    """The epipole is inside the image. The truth of such a pair is there all the same."""
    file, sample, no = tmp_path / "rig.toml", tmp_path / "out/cards", tmp_path / "no"
    second = "{ translate = [0.02, 0.0, 0.4] }"
    file.write_text(f'layout = "cameras"\ncameras = [{{}}, {second}]\n')
    line = ("render", "cards", "--rig", file, *QUICK, "-o", tmp_path / "out")
    assert twinlens(*line)[0] == 0
    assert twinlens("verify", tmp_path / "out")[0] == 0
    for line in (
        ("rectify", sample, "-o", no),
        ("reconstruct", sample, "--method", "sgm", "-o", no),
    ):
        code, _, err = twinlens(*line)
        assert (code, err.count("\n")) == (2, 1)
        assert "looks along the baseline" in err
        assert not no.exists()


OWN = """
seed = 2
count = 1
scenes = ["tiny"]
width = 32
height = 24
spp = 1
denoise = false
[gates]
texture = 0
[sky]
file = "day.exr"
[rig]
layout = "toed_in"
baseline = 0.2
[scene.objects.ball]
shape = "uv_sphere"
radius = 0.2
material = {{ type = "diffuse" }}
translate = [{{ uniform = [-0.2, 0.2] }}, -0.6, 1]
"""


def test_a_sample_with_the_objects_and_the_sky_of_a_recipe(twinlens, tmp_path):
    """Warped pictures need no sky; new ones need its file in the folder of the recipe."""
    recipe = write_recipe(tmp_path / "recipe", OWN)
    write_sky(recipe.parent / "day.exr", np.full((4, 8, 3), 1.5))
    write_sample(tmp_path / "own", make(read_recipe(recipe), 0))
    scene, new = recipe.parent / "tiny" / "scene.toml", tmp_path / "new"
    line = ("rectify", tmp_path / "own", "--scene", scene, "--overwrite", "-o", new)
    for pictures in ("maps", "render"):
        options = ("--pictures", pictures, "--folder", recipe.parent)
        assert twinlens(*line, *options)[::2] == (0, "")
        assert "ball" in Dataset(new)[0].truth(0).object_names
    error = "twinlens: sample.json: record.sky: no file or folder 'day.exr'\n"
    assert twinlens(*line, "--pictures", "render") == (2, "", error)
