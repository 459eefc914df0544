import json

import numpy as np
import pytest

from tests.factory_recipes import write_recipe, write_sky
from twinlens.dataset import Dataset, write_sample
from twinlens.factory import make, read_recipe

QUICK = ("--size", "48x36", "--spp", "1", "--no-denoise")


def test_a_toed_in_pair_is_rectified_and_verifies(twinlens, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text('layout = "toed_in"\nbaseline = 0.2\n')
    assert (
        twinlens("render", "cards", "--rig", file, *QUICK, "-o", tmp_path / "out")[0]
        == 0
    )
    target = tmp_path / "new" / "cards"
    code, out, _ = twinlens(
        "rectify", tmp_path / "out" / "cards", "-o", target, "--own-centres", "--json"
    )
    assert code == 0
    assert {"disp0.pfm", "calib.txt"} <= set(json.loads(out)["files"])
    assert Dataset(target)[0].calibration.doffs == json.loads(out)["doffs"] != 0
    assert twinlens("verify", target)[0] == 0
    code, _, err = twinlens("rectify", tmp_path / "out" / "cards", "-o", target)
    assert (code, err) == (
        2,
        f"twinlens: {target}: exists already; choose another name, or add --overwrite\n",
    )
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "1.png").touch()
    code, _, err = twinlens(
        "rectify", tmp_path / "out" / "cards", "-o", tmp_path / "photos", "--overwrite"
    )
    assert (code, "is not a sample, so it is not overwritten" in err) == (2, True)
    assert (tmp_path / "photos" / "1.png").exists()
    assert (
        twinlens("rectify", tmp_path / "out" / "cards", "-o", target, "--overwrite")[0]
        == 0
    )
    for wrong in (
        ("--fit", "vlid"),
        ("--misalignment", "roll=1"),
        ("--misalignment", "roll_deg=x"),
        ("--misalignment", "roll_deg=1,roll_deg=2"),
        ("--misalignment", "roll_deg=inf"),
        ("--cameras", "1,0"),
    ):
        code, _, err = twinlens(
            "rectify", tmp_path / "out" / "cards", "-o", tmp_path / "no", *wrong
        )
        assert code == 2
        assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("second", "says"),
    [
        ("{ translate = [0.02, 0.0, 0.4] }", "looks along the baseline"),
        ("{}", "centres coincide"),
    ],
)
def test_a_pair_without_a_rectification_is_refused_in_a_line(
    twinlens, tmp_path, second, says
):
    """The epipole inside the image; two cameras in one place. The truth of such a pair is there all the same."""
    file, sample = tmp_path / "rig.toml", tmp_path / "out" / "cards"
    file.write_text(f'layout = "cameras"\ncameras = [{{}}, {second}]\n')
    quick = ("--size", "96x72", "--spp", "1", "--no-denoise")
    assert (
        twinlens("render", "cards", "--rig", file, *quick, "-o", tmp_path / "out")[0]
        == 0
    )
    assert twinlens("verify", tmp_path / "out")[0] == 0
    commands = [("rectify", sample, "-o", tmp_path / "no")]
    commands += [("reconstruct", sample, "--method", "sgm", "-o", tmp_path / "no")]
    if second == "{}":
        commands += [("show", "epipolar", sample, "-o", tmp_path / "no.png")]
    for command in commands:
        code, _, err = twinlens(*command)
        assert code == 2
        assert says in err
        assert err.count("\n") == 1
    assert not list(tmp_path.glob("no*"))


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


@pytest.mark.parametrize("pictures", ["maps", "render"])
def test_a_sample_with_the_objects_and_the_sky_of_a_recipe(
    twinlens, tmp_path, pictures
):
    """Warped pictures need no sky; new ones need its file in the folder of the recipe."""
    recipe = write_recipe(tmp_path / "recipe", OWN)
    write_sky(recipe.parent / "day.exr", np.full((4, 8, 3), 1.5))
    write_sample(tmp_path / "own", make(read_recipe(recipe), 0))
    scene = recipe.parent / "tiny" / "scene.toml"
    line = (
        "rectify",
        tmp_path / "own",
        "--scene",
        scene,
        "--pictures",
        pictures,
        "-o",
        tmp_path / "new",
    )
    code, _, err = twinlens(*line, "--folder", recipe.parent)
    assert (code, err) == (0, "")
    assert "ball" in Dataset(tmp_path / "new")[0].truth(0).object_names
    if pictures == "render":
        code, _, err = twinlens(*line, "--overwrite")
        assert (code, err) == (
            2,
            "twinlens: sample.json: record.sky: no file or folder 'day.exr'\n",
        )
