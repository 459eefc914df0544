"""Bad input of every kind: exit code 2, a one-line error, and no partial output."""

import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import click
import pytest

from tests.dataset import dataset_scene
from tests.factory_recipes import digests
from twinlens.camera import Rig
from twinlens.cli import COMMANDS, cli
from twinlens.cli.options import SettingType
from twinlens.dataset import write_sample
from twinlens.errors import InputError
from twinlens.scenes import bundled_folder


@pytest.fixture
def refuses(twinlens, tmp_path):
    """Check that a command gives a one-line error with `words` and leaves tmp_path unchanged."""

    def check(words, *arguments):
        before = sorted(tmp_path.rglob("*"))
        code, out, err = twinlens(*arguments)
        assert code == 2, (code, out, err)
        assert out == ""
        assert err.startswith("twinlens: ")
        assert err.count("\n") == 1
        assert words in err
        assert sorted(tmp_path.rglob("*")) == before

    return check


def test_unknown_command(refuses):
    refuses("did you mean 'render'", "rendr")


def test_unknown_option(refuses):
    refuses("--sizes", "render", "cards", "--sizes", "3", "-o", "x")


def test_an_option_given_twice(refuses):
    words = "option --size is given 2 times; give it once"
    refuses(words, "render", "cards", "--size", "1", "--size", "2", "-o", "x")


def test_unknown_scene(refuses, tmp_path):
    refuses("did you mean 'staircase'", "render", "stairs", "-o", tmp_path / "o")


def test_a_name_longer_than_file_systems_allow(refuses, tmp_path):
    refuses(
        "more than 255 bytes", "render", "cards", "-o", tmp_path / ("é" * 128) / "o"
    )


def test_missing_scene_file(refuses, tmp_path):
    refuses("scene.toml", "render", tmp_path / "scene.toml", "-o", tmp_path / "o")


THIN = ("--lens", "thin:3")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--size", "0x9"), "WIDTHxHEIGHT"),
        (("--fov", "wide"), "--fov must be a finite number > 0, got 'wide'"),
        (("--fov", "200"), "--fov: must be a number of degrees > 0 and <= 179, got"),
        (("--baseline", "1e5"), "--baseline 100000: the views have nothing in common"),
        (("--lens", "F/2.8"), "did you mean 'f/2.8'?"),
        (("--lens", "f2.8@3"), "did you mean 'f/2.8@3'?"),
        ((*THIN, *THIN), "--lens thin:3: is given twice"),
        (("--aperture", "polygon:6"), "--aperture polygon:6: has no effect, every"),
        (("--diffraction",), "--diffraction: has no effect, every lens is a pinhole"),
        (("--dual-pixel",), "--dual-pixel: has no effect, every lens is a pinhole"),
        (
            (*THIN, "--dual-pixel", "--diffraction"),
            "dual_pixel and diffraction exclude",
        ),
        (("--distortion", "-3"), "--distortion BrownConrady(k1=-3"),
        (("--exposure", "1e9", "--mismatch", "time=2"), "makes the exposure invalid"),
        (("--focal-length-px", "1,2,3"), "FX[,FY]"),
        (("--focal-length-px", "7", "--fov", "4"), "both set the focal length"),
        (("--principal-point", "3"), "CX,CY"),
        (("--sensor-width-mm", "APSC"), "did you mean 'APS-C'?"),
        (("--sensor-width-mm", "36", "--pixel-pitch-um", "5"), "both set"),
        (("--sensor", "phone:bit=16"), "did you mean 'bits'"),
        (("--camera", "oak"), "--camera oak: unknown camera 'oak'; did you mean"),
        (("--camera", "oak-d", "--size", "64x48"), "--camera: height: the sensor has"),
        (("--sky", "none.exr"), "--sky: no file or folder 'none.exr'"),
    ],
)
def test_options_that_no_picture_can_have(refuses, tmp_path, options, words):
    refuses(words, "render", "cards", *options, "-o", tmp_path / "o")


def setting_options():
    """The options of all commands whose type is a declared setting, with their commands."""
    for name in COMMANDS:
        command = cli.get_command(click.Context(cli), name)
        for option in command.params:
            if isinstance(option.type, SettingType):
                yield command, option


def test_options_refuse_what_the_declaration_of_their_setting_excludes():
    options = list(setting_options())
    assert {"spp", "seed", "bits", "overlap"} <= {option.name for _, option in options}
    for command, option in options:
        setting = option.type.field.setting
        texts = ["wide", "nan", "", "1,2"]
        for limit, step in ((setting.least, -1), (setting.above, 0), (setting.most, 1)):
            if math.isfinite(limit):
                texts.append(f"{limit + step * max(1, abs(limit)):g}")
        for text in texts:
            message = f"{option.opts[0]} must be {option.type.field.allowed}, got "
            with pytest.raises(InputError, match=f"^{re.escape(message)}"):
                option.type.convert(text, option, click.Context(command))


def test_unknown_key_in_a_scene(refuses, tmp_path):
    scene = tmp_path / "scene.toml"
    good = (bundled_folder() / "cards" / "scene.toml").read_text()
    scene.write_text(good.replace("fov_x_deg", "fov_x_degg"))
    refuses("fov_x_deg", "render", scene, "-o", tmp_path / "o")


def test_a_lens_needs_a_focus_where_the_scene_has_no_depth_range(refuses, tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text(
        '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>'
        '<shape type="sphere"/></scene>'
    )
    refuses(
        "add the focus distance",
        "render",
        scene,
        "--lens",
        "thin:20",
        "-o",
        tmp_path / "o",
    )


@pytest.mark.parametrize(
    ("method", "words"),
    [
        ("znc", "did you mean 'zncc'"),
        ("mine=zncc:block_size=8", "mine: option block_size must be an odd whole"),
    ],
)
def test_bad_methods(refuses, dataset, tmp_path, method, words):
    pair = dataset / "cards" / "im0.png", dataset / "cards" / "im1.png"
    refuses(words, "match", *pair, "--method", method, "-o", tmp_path / "d.pfm")
    refuses(words, "benchmark", dataset, "--methods", method, "-o", tmp_path / "board")


def test_truncated_files(refuses, dataset, tmp_path):
    sample = dataset / "cards"
    for name in ("im0.png", "disp0.pfm"):
        whole = (sample / name).read_bytes()
        (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    refuses(
        "disp0.pfm", "score", tmp_path / "disp0.pfm", "--truth", sample / "disp0.pfm"
    )
    pair = tmp_path / "im0.png", sample / "im1.png"
    refuses("im0.png", "match", *pair, "-o", tmp_path / "d.pfm")


def test_maps_that_do_not_exist_and_other_files_are_named(refuses, dataset, tmp_path):
    notes = tmp_path / "notes.txt"
    notes.write_text("no map")
    for maps, words in (
        (tmp_path / "none.pfm", f"{tmp_path / 'none.pfm'}: no such file or folder"),
        (notes, "notes.txt: neither a folder nor a readable zip"),
    ):
        refuses(words, "score", maps, "--truth", dataset, "-o", tmp_path / "board")


@pytest.mark.parametrize(
    ("line", "suffix"),
    [
        (("render", "cards", "-o"), ""),
        (("generate", "{recipe}", "-o"), ""),
        (("rectify", "{set}/cards", "-o"), ""),
        (("show", "epipolar", "{set}/cards", "-o"), ".png"),
        (("export", "{set}", "--to", "carla", "-o"), ""),
        (("benchmark", "{set}", "-o"), ""),
        (("match", "{im0}", "{im0}", "-o"), ".pfm"),
        (("match", "{im0}", "{im0}", "-o", "{tmp}/d.pfm", "--picture"), ".png"),
        (("study", "window", "-o"), ""),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_an_output_below_a_file_names_that_file(
    refuses, dataset, tmp_path, line, suffix
):
    file, recipe = tmp_path / "file", tmp_path / "recipe.toml"
    file.touch()
    recipe.write_text('seed = 1\ncount = 1\nscenes = ["cards"]')
    names = {
        "recipe": recipe,
        "set": dataset,
        "im0": dataset / "cards" / "im0.png",
        "tmp": tmp_path,
    }
    words = f"twinlens: {file}: is a file where a folder is needed; choose another name"
    refuses(words, *(part.format(**names) for part in line), file / f"x{suffix}")


def test_a_file_in_place_of_a_dataset(refuses, tmp_path):
    (tmp_path / "file").touch()
    for command in ("verify", "statistics", "describe"):
        refuses(
            f"{tmp_path / 'file'}: not a folder; a dataset is a folder of samples",
            command,
            tmp_path / "file",
        )


def test_a_sample_of_one_view(refuses, tmp_path):
    """Commands that need a pair say so; `twinlens rectify` would not help."""
    pair = dataset_scene.sample(width=16, height=12)
    shot = replace(pair.shots[0], images=pair.shots[0].images[:1])
    rig = Rig(pair.rig.cameras[:1], pair.rig.world_from_cams[:1])
    write_sample(
        tmp_path / "set" / "a",
        replace(pair, rig=rig, shots=(shot,), truths=pair.truths[:1]),
    )
    for line in (
        ("rectify", tmp_path / "set" / "a"),
        ("show", "epipolar", tmp_path / "set" / "a"),
    ):
        refuses("a: has one view; a pair needs two", *line, "-o", tmp_path / "x.png")
    refuses(
        "a: has one view; disparity needs two",
        "benchmark",
        tmp_path / "set",
        "-o",
        tmp_path / "board",
    )


def test_missing_dataset_and_board(refuses, tmp_path):
    refuses("no such folder", "benchmark", tmp_path / "none", "-o", tmp_path / "board")
    refuses("none.json", "report", tmp_path / "none.json")


def test_an_unwritable_output(refuses, dataset):
    pair = dataset / "cards" / "im0.png", dataset / "cards" / "im1.png"
    refuses("/proc/d.pfm", "match", *pair, "-o", "/proc/d.pfm")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_the_output_stream():
    with Path("/dev/full").open("w") as full:
        child = subprocess.run(
            [sys.executable, "-m", "twinlens", "scenes"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert child.returncode == 2
    assert child.stderr.startswith("twinlens: ")


OUTPUTS = [
    (("render", "cards"), "Dataset folder"),
    (("generate", "recipe.toml"), "Dataset folder"),
    (("reconstruct", "out"), "Folder of the reconstruction."),
    (("rectify", "out"), "Folder of the new sample."),
    (("show", "epipolar", "out"), "The picture, a PNG file."),
    (("export", "out", "--to", "carla"), "Folder of the export."),
    (("match", "a.png", "b.png"), "The disparity map, a .pfm file."),
    (("benchmark", "out"), "Folder of the board."),
    (("score", ".", "--truth", "out"), "Folder of the board."),
    (("study", "window"), "Output folder."),
    (("demo",), None),
    (("report", "board.json"), None),
]
"""Commands that write, and the help of an output that has to be given."""
WRITES_BUCKETS = ("render", "generate", "export")


@pytest.mark.parametrize(
    ("line", "meaning"), OUTPUTS, ids=lambda value: value and value[0]
)
def test_an_output_that_is_missing_empty_or_a_bucket(
    refuses, tmp_path, monkeypatch, line, meaning
):
    monkeypatch.chdir(tmp_path)
    if meaning:
        refuses(f"twinlens: Missing option '-o' / '--output': {meaning}", *line)
    refuses("'-o' / '--output': the name is empty", *line, "-o", "")
    if line[0] not in WRITES_BUCKETS:
        words = "'memory://x/y' is a bucket's address"
        refuses(words, *line, "-o", "memory://x/y")


def test_a_demo_in_a_folder_with_other_files(refuses, tmp_path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "dataset.json").touch()
    refuses(
        "contains 'dataset.json' and no board; choose a new or an empty folder",
        "demo",
        "-o",
        tmp_path / "set",
    )


def test_folders_above_an_output_are_made(twinlens, dataset, tmp_path):
    pair = dataset / "cards" / "im0.png", dataset / "cards" / "im1.png"
    for name, line in {
        "a/b/d.pfm": (
            "match",
            *pair,
            "--method",
            "sad:block_size=5",
            "--ndisp",
            "8",
            "--picture",
            tmp_path / "c/d.png",
        ),
        "e/f/board": ("benchmark", dataset, "--methods", "sad:block_size=5"),
        "g/h/page.html": ("report", tmp_path / "e" / "f" / "board"),
        "i/j/set": ("export", dataset, "--to", "carla"),
        "k/l/lines.png": ("show", "epipolar", dataset / "cards"),
        "m/n/set": ("render", "cards", "--size", "32x24", "--spp", "1", "--no-denoise"),
        "o/p/cards": ("rectify", dataset / "cards"),
        "q/r/points": ("reconstruct", dataset / "cards", "--cell-mm", "40"),
    }.items():
        code, _, err = twinlens(*line, "-o", tmp_path / name)
        assert (code, err) == (0, "")
        assert (tmp_path / name).exists()


def test_a_folder_without_a_scene(refuses, tmp_path):
    (tmp_path / "scenes").mkdir()
    words = "the folder has no scene.toml; name a scene file, or one of"
    refuses(words, "render", tmp_path / "scenes", "-o", "x")


@pytest.mark.parametrize("first", ["64", "-64"])
def test_disparities_beyond_the_image_width(refuses, dataset, first):
    truth = dataset / "cards" / "disp0.pfm"
    line = ("score", truth, "--truth", truth, "--min-disparity", first)
    refuses("expected -63 to 63", *line)


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--published", "2026-02-30", "published: must be a date such as 2026-01-31"),
        ("--published", "20260131", "published: must be a date"),
        ("--url", "example.org/set", "url: must be an address such as https://"),
        ("--url", "https://", "url: must be an address"),
        ("--url", "https://[x", "url: must be an address"),
        ("--url", "https://exam ple.org", "url: must be an address"),
        ("--creator", "  ", "creator: must be a text that is not empty"),
    ],
)
def test_bad_descriptions(refuses, dataset, option, value, words):
    before = digests(dataset)
    refuses(words, "describe", dataset, option, value)
    assert digests(dataset) == before
