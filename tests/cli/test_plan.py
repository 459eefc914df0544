"""`twinlens plan`: the table, the file that renders, the figure, and infeasible tasks."""

import json
import re
import shlex

import numpy as np
import pytest
from PIL import Image

from twinlens.camera import ThinLens
from twinlens.camera.presets import find_camera
from twinlens.cli import plan
from twinlens.dataset import Dataset
from twinlens.optics.planning import LIMITS, plan_rig
from twinlens.optics.rig_task import RigTask

TASK = ("--depth", "1,4", "--fov", "50,70", "--size", "48x36", "--pixel-pitch-um", "30")


def test_json_is_the_plan_of_the_library(twinlens):
    options = ("--depth-error-mm", "400", "--disparity-error-px", "0.05")
    more = ("--f-number", "2", "--overlap", "0.7")
    code, out, err = twinlens("plan", *TASK, *options, *more, "--json")
    assert (code, err) == (0, "")
    best = plan_rig(RigTask(48, 36, 30.0, (1.0, 4.0), fov_x_deg=(50.0, 70.0), depth_error=0.4, disparity_error_px=0.05,
                            f_number=2.0, overlap=0.7)).best  # fmt: skip
    answer = json.loads(out)
    shown = answer["best"]
    assert answer["feasible"]
    assert answer["objective"] == "baseline"
    assert shown["baseline"] == best.baseline
    assert shown["depth_error"] == best.depth_error(shown["depths"]).tolist()
    assert answer["used"].keys() == answer["limits"].keys() <= set(LIMITS)


@pytest.mark.parametrize(
    "task",
    [
        ("--depth", "1,4", "--fov", "50,70", "--depth-error-mm", "20"),
        ("--depth", "0.5,3", "--fov", "60", "--max-disparities", "400"),
        ("--depth", "0.4,2", "--camera", "realsense-d435"),
        ("--depth", "2,30", "--fov", "40,60", "--max-disparities", "600"),
    ],
)
def test_disparities_are_one_number(twinlens, task):
    """The number of `match --num-disparities`, which covers the whole numbers around both ends, is the one used."""
    code, out, err = twinlens("plan", *task)
    assert (code, err) == (0, "")
    least, count = map(int, re.search(r"min-disparity (\d+) --num-disparities (\d+)", out).groups())  # fmt: skip
    assert re.search(r"^  disparities +(\d+)  at most", out, re.MULTILINE)[1] == str(count)  # fmt: skip
    shown = re.findall(r"^ +[\d.]+ m +([\d.]+) px", out, re.MULTILINE)
    near, far = float(shown[0]), float(shown[-1])
    assert least <= far + 0.05
    assert near - 0.05 <= least + count - 1 < near + 1.05


def test_the_file_of_a_plan_renders_and_is_part_of_a_recipe(twinlens, ball, tmp_path):
    file, recipe = tmp_path / "plan.toml", tmp_path / "recipe.toml"
    plan = json.loads(twinlens("plan", *TASK, "-o", file, "--json")[1])["best"]
    quick = ("--spp", "1", "--no-denoise")
    line = ("render", ball, "--rig", file, *quick, "-o", tmp_path / "one")
    assert twinlens(*line)[0] == 0
    text = f'seed = 3\ncount = 1\nscenes = ["{ball}"]\nspp = 1\ndenoise = false\n'
    recipe.write_text(text + file.read_text())
    assert twinlens("generate", recipe, "-o", tmp_path / "two")[0] == 0
    for folder in ("one", "two"):
        sample = Dataset(tmp_path / folder)[0]
        camera, shot = sample.rig.cameras[0], sample.lens(0)
        assert (camera.width, camera.height, camera.pixel_pitch_um) == (48, 36, 30.0)
        assert isinstance(shot.lens, ThinLens)
        exposure = shot.record["exposures"][0]
        expected = {
            "fx": camera.fx,
            "baseline": sample.rig.baseline(),
            "aperture_diameter": shot.lens.aperture_diameter,
            "focus_distance": shot.lens.focus_distance,
            "f_number": exposure["working_f_number"],
        }
        assert {name: plan[name] for name in expected} == pytest.approx(expected)


@pytest.mark.parametrize("name", ["plan.txt", "plan", "plan.json", "plan.toml.bak"])
def test_a_rigs_file_has_one_ending(twinlens, tmp_path, name):
    code, out, err = twinlens("plan", *TASK, "-o", tmp_path / name)
    assert (code, out) == (2, "")
    assert f"{name}' must end in .toml" in err
    assert not list(tmp_path.iterdir())


def test_the_exposure_used_and_the_one_needed_have_two_names(twinlens):
    """Mid-grey has the ratio of --snr after the needed one, and the printed ratio after the longest."""
    light = ("--lux", "300", "--snr", "10", "--sensor", "machine_vision")
    code, out, _ = twinlens("plan", *TASK, *light)
    assert code == 0
    used = float(re.search(r"^  exposure +([\d.]+) ms", out, re.M)[1])
    needed = float(re.search(r"^  needed exposure +([\d.]+) ms", out, re.M)[1])
    ratio = float(re.search(r"ratio of mid-grey ([\d.]+)", out)[1])
    assert needed < used
    assert len(re.findall(r"^  exposure ", out, re.M)) == 1
    # n electrons give n / sqrt(n + r^2): with shot noise alone, the ratio grows as the square root of the time.
    assert (ratio / 10) ** 2 == pytest.approx(used / needed, rel=0.1)


def test_an_infeasible_task_exits_with_1_and_its_changes_make_it_feasible(
    twinlens, tmp_path
):
    """Each change as printed, rounded to the looser side, is enough."""
    line = ("plan", *TASK, "--baseline", "0.05,0.1", "--depth-error-mm")
    code, out, err = twinlens(*line, "20", "-o", tmp_path / "plan.toml")
    assert (code, err) == (1, "")
    assert not (tmp_path / "plan.toml").exists()
    needs = r"  a depth error of 20 mm at 4 m needs a baseline of [\d.]+ m with .+ largest baseline is 0.1 m"
    assert re.search(needs, out)
    change = re.search(r"\n  depth error ([\d.]+) mm instead of 20 mm\n", out)
    needed = float(change[1])
    assert twinlens(*line, needed)[0] == 0
    assert twinlens(*line, 0.98 * needed)[0] == 1


def test_a_camera_of_the_list_has_its_intrinsics_and_baseline(twinlens):
    line = ("plan", "--depth", "0.4,2", "--camera", "realsense-d435", "--json")
    answer = json.loads(twinlens(*line)[1])
    best = answer["best"]
    assert answer["task"]["width"] == 1280
    assert (best["baseline"], best["f_number"]) == (0.05, 2.0)
    assert best["fx"] == pytest.approx(find_camera("realsense-d435").camera.fx)
    lens = json.loads(twinlens(*line, "--focal-length-mm", "1.8")[1])
    assert lens["best"]["focal_length"] == pytest.approx(1.8e-3)


def test_the_examples_of_the_help_are_feasible(twinlens, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line in re.findall(r"twinlens (plan .+)", plan.command.help):
        assert twinlens(*shlex.split(line))[0] == 0, line
    assert np.asarray(Image.open(tmp_path / "plan.png")).std() > 10
