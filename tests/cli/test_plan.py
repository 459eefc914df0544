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
    options = (
        "--depth-error-mm",
        "400",
        "--disparity-error-px",
        "0.05",
        "--f-number",
        "2",
        "--overlap",
        "0.7",
    )
    code, out, err = twinlens("plan", *TASK, *options, "--json")
    assert (code, err) == (0, "")
    best = plan_rig(RigTask(48, 36, 30.0, (1.0, 4.0), fov_x_deg=(50.0, 70.0), depth_error=0.4, disparity_error_px=0.05,
                            f_number=2.0, overlap=0.7)).best  # fmt: skip
    answer = json.loads(out)
    assert answer["feasible"]
    assert answer["objective"] == "baseline"
    assert answer["best"]["baseline"] == best.baseline
    assert (
        answer["best"]["depth_error"]
        == best.depth_error(answer["best"]["depths"]).tolist()
    )
    assert answer["used"].keys() == answer["limits"].keys() <= set(LIMITS)


def test_the_file_of_a_plan_renders_and_is_part_of_a_recipe(twinlens, ball, tmp_path):
    file = tmp_path / "plan.toml"
    answer = json.loads(twinlens("plan", *TASK, "-o", file, "--json")[1])["best"]
    assert (
        twinlens(
            "render",
            ball,
            "--rig",
            file,
            "--spp",
            "1",
            "--no-denoise",
            "-o",
            tmp_path / "one",
        )[0]
        == 0
    )
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(
        f'seed = 3\ncount = 1\nscenes = ["{ball}"]\nspp = 1\ndenoise = false\n{file.read_text()}'
    )
    assert twinlens("generate", recipe, "-o", tmp_path / "two")[0] == 0
    for folder in ("one", "two"):
        sample = Dataset(tmp_path / folder)[0]
        camera = sample.rig.cameras[0]
        assert (camera.width, camera.height, camera.pixel_pitch_um) == (48, 36, 30.0)
        assert (camera.fx, sample.rig.baseline()) == pytest.approx(
            (answer["fx"], answer["baseline"])
        )
        lens = sample.lens(0).lens
        assert isinstance(lens, ThinLens)
        assert lens.aperture_diameter == pytest.approx(answer["aperture_diameter"])
        assert lens.focus_distance == pytest.approx(answer["focus_distance"])
        assert sample.lens(0).record["exposures"][0][
            "working_f_number"
        ] == pytest.approx(answer["f_number"])


def test_an_infeasible_task_exits_with_1_and_its_changes_make_it_feasible(
    twinlens, tmp_path
):
    """Each change as printed, rounded to the looser side, is enough."""
    others = (*TASK, "--baseline", "0.05,0.1")
    code, out, err = twinlens(
        "plan", *others, "--depth-error-mm", "20", "-o", tmp_path / "plan.toml"
    )
    assert (code, err) == (1, "")
    assert not (tmp_path / "plan.toml").exists()
    assert re.search(
        r"  a depth error of 20 mm at 4 m needs a baseline of [\d.]+ m with .+ largest baseline is 0.1 m",
        out,
    )
    (needed,) = re.findall(
        r"^  depth error ([\d.]+) mm instead of 20 mm$", out, flags=re.MULTILINE
    )
    assert twinlens("plan", *others, "--depth-error-mm", needed)[0] == 0
    assert (
        twinlens("plan", *others, "--depth-error-mm", str(0.98 * float(needed)))[0] == 1
    )


def test_light_makes_the_exposure_a_limit(twinlens):
    dark = (*TASK, "--lux", "0.001")
    code, out, _ = twinlens("plan", *dark)
    assert code == 1
    needed = float(re.search(r"exposure ([\d.]+) ms instead of 20 ms", out)[1])
    assert twinlens("plan", *dark, "--longest-exposure", str(1e-3 * needed))[0] == 0
    assert twinlens("plan", *dark, "--longest-exposure", str(0.99e-3 * needed))[0] == 1


def test_a_camera_of_the_list_has_its_intrinsics_and_baseline(twinlens):
    answer = json.loads(
        twinlens("plan", "--depth", "0.4,2", "--camera", "realsense-d435", "--json")[1]
    )
    best = answer["best"]
    assert (answer["task"]["width"], best["baseline"], best["f_number"]) == (
        1280,
        0.05,
        2.0,
    )
    assert best["fx"] == pytest.approx(find_camera("realsense-d435").camera.fx)
    lens = json.loads(
        twinlens(
            "plan",
            "--depth",
            "0.4,2",
            "--camera",
            "realsense-d435",
            "--focal-length-mm",
            "1.8",
            "--json",
        )[1]
    )
    assert lens["best"]["focal_length"] == pytest.approx(1.8e-3)
    wider = json.loads(
        twinlens(
            "plan",
            "--depth",
            "0.4,2",
            "--camera",
            "realsense-d435",
            "--baseline",
            "0.08",
            "--json",
        )[1]
    )
    assert wider["best"]["depth_error"] == pytest.approx(
        [error * 0.05 / 0.08 for error in best["depth_error"]]
    )


def test_the_examples_of_the_help_are_feasible(twinlens, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line in re.findall(r"twinlens (plan .+)", plan.command.help):
        assert twinlens(*shlex.split(line))[0] == 0, line
    assert np.asarray(Image.open(tmp_path / "plan.png")).std() > 10


FOV = ("--depth", "1,2", "--fov", "60")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--depth", "4,1", "--fov", "60"), "--depth must be"),
        (
            ("--depth", "1,2", "--fov", "60", "--focal-length-mm", "4"),
            "give exactly one of --fov and --focal-length-mm",
        ),
        (
            ("--depth", "1,2"),
            "give exactly one of --fov and --focal-length-mm, or a --camera",
        ),
        (
            ("--depth", "1,2", "--fov", "60", "--baseline", "a"),
            "--baseline must be one number, or the least and the most",
        ),
        ((*FOV, "--f-number", "0"), "--f-number must be"),
        ((*FOV, "--overlap", "2"), "--overlap must be a number from 0 to below 1"),
        ((*FOV, "--snr", "2"), "--snr needs --lux"),
        ((*FOV, "--lux", "2", "--snr", "1e4"), "--snr must be at most"),
        (
            (*FOV, "--lux", "2", "--longest-exposure", "auto"),
            "--longest-exposure must be",
        ),
        (("--depth", "1,2", "--camera", "realsense"), "did you mean 'realsense-d435'"),
        ((*FOV, "--size", "12"), "--size must be"),
    ],
)
def test_bad_input_is_one_line(twinlens, options, message):
    code, out, err = twinlens("plan", *options)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err
