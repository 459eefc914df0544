"""Bad input of every kind: exit code 2, a one-line error, and no partial output."""

import math
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest

from twinlens.cli import COMMANDS, cli
from twinlens.cli.options import SettingType
from twinlens.errors import InputError


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


@pytest.fixture
def places(dataset, tmp_path):
    """What the lines below name: a dataset, the files of its sample, a file, and a folder of other files."""
    sample, file, letters = dataset / "cards", tmp_path / "file", tmp_path / "letters"
    file.touch()
    letters.mkdir()
    (letters / "dataset.json").touch()
    recipe = tmp_path / "recipe.toml"
    recipe.write_text('seed = 1\ncount = 1\nscenes = ["cards"]')
    return {
        "set": dataset,
        "im0": sample / "im0.png",
        "im1": sample / "im1.png",
        "disp": sample / "disp0.pfm",
        "file": file,
        "recipe": recipe,
        "letters": letters,
        "long": 300 * "a",
        "tmp": tmp_path,
    }


REFUSED = """
rendr | did you mean 'render'
render cards --sizes 3 -o x | --sizes
render cards --size 1 --size 2 -o x | option --size is given 2 times; give it once
render stairs -o {tmp}/o | did you mean 'staircase'
render {letters} -o {tmp}/o | the folder has no scene.toml; name a scene file, or one of
render cards --size 0x9 -o {tmp}/o | WIDTHxHEIGHT
render cards --fov 200 -o {tmp}/o | --fov: must be a number of degrees > 0 and <= 179, got
render cards --baseline 1e5 -o {tmp}/o | --baseline 100000: the views have nothing in common
render cards --lens f2.8@3 -o {tmp}/o | did you mean 'f/2.8@3'?
render cards --lens f/2.8,focus=3m -o {tmp}/o | must be f/N[@FOCUS_M], and '2.8,focus=3m' is no number
render cards --lens thin:f_number=2 -o {tmp}/o | must be thin:DIAMETER_MM[@FOCUS_M], and 'f_number=2' is no number
plan --depth 1,4 --fov 60 -o {tmp}/plan.txt | plan.txt' must end in .toml
benchmark {tmp}/none --methods zcnn -o {tmp}/b | did you mean 'zncc'?
render cards --lens thin:3 --lens thin:3 -o {tmp}/o | --lens thin:3: is given twice
render cards --aperture polygon:6 -o {tmp}/o | --aperture polygon:6: has no effect, every
render cards --dual-pixel -o {tmp}/o | --dual-pixel: has no effect, every lens is a pinhole
render cards --distortion -3 -o {tmp}/o | --distortion BrownConrady(k1=-3
render cards --exposure 1e9 --mismatch time=2 -o {tmp}/o | makes the exposure invalid
render cards --focal-length-px 1,2,3 -o {tmp}/o | FX[,FY]
render cards --focal-length-px 7 --fov 4 -o {tmp}/o | both set the focal length
render cards --principal-point 3 -o {tmp}/o | CX,CY
render cards --sensor-width-mm 36 --pixel-pitch-um 5 -o {tmp}/o | both set
render cards --sensor phone:bit=16 -o {tmp}/o | did you mean 'bits'
render cards --camera oak -o {tmp}/o | --camera oak: unknown camera 'oak'; did you mean
render cards --sky none.exr -o {tmp}/o | --sky: no file or folder 'none.exr'
render cards --rig {tmp}/none.toml -o {tmp}/o | none.toml
generate {tmp}/none.toml -o {tmp}/o | none.toml
generate {recipe} -o {tmp}/o --shard 3/2 | --shard must be i/n
generate {recipe} -o {tmp}/o --workers 2 --scheduler tcp://x:1 | exclude each other
match {im0} {im1} --num-disparities 128 -o {tmp}/d.pfm | num_disparities is 128: an image 64 pixels wide
match {im0} {im1} --method sad:block_size=9999 -o {tmp}/d.pfm | is 9999: a window of
match {im0} {im1} --method znc -o {tmp}/d.pfm | did you mean 'zncc'
match {im0} {im1} --method sad --confidence {tmp}/c.pfm -o {tmp}/d.pfm | --confidence: sad computes none
match {im0} {im1} --method sad:confidence=ambiguity --confidence {tmp}/d.pfm -o {tmp}/d.pfm | is also
match {im0} {im1} --method sad:confidence=ambiguity --confidence {tmp}/c.png -o {tmp}/d.pfm | must end in .pfm
match {im0} {im1} --method sad:num_disparities=4 --num-disparities 8 -o {tmp}/d.pfm | the search range of sad:num_disp
match {im0} {im1} --method sad --command x -o {tmp}/d.pfm | both name a matcher
match {im0} {im1} --min-disparity 64 -o {tmp}/d.pfm | min_disparity is 64: an image 64 pixels wide
match {im0} {im1} --time-limit 3 -o {tmp}/d.pfm | applies to programs only
match {im0} {im1} -o /proc/d.pfm | /proc/d.pfm
match {file} {im1} -o {tmp}/d.pfm | file
benchmark {set} --methods mine=zncc:block_size=8 -o {tmp}/b | mine: option block_size must be an odd whole
benchmark {set} --methods sad,function:function=nomodule:f -o {tmp}/b | cannot be imported
benchmark {tmp}/none -o {tmp}/b | no such folder
score {disp} --truth {disp} --region all | --region
score {disp} --truth {disp} --min-disparity 64 | expected -63 to 63
score {letters} --truth {set} --ndisp 8 -o {tmp}/b | --ndisp
score {tmp}/none.pfm --truth {set} -o {tmp}/b | none.pfm: no such file or folder
score {disp} --truth {set} | is one map: give one truth
verify {file} | not a folder; a dataset is a folder of samples
verify nowhere://x | nowhere
statistics {file} | not a folder; a dataset is a folder of samples
describe {set} --url example.org/set | url: must be an address such as https://
export {set} --to carla --split train -o {tmp}/o | has no splits, so no split 'train'
report {tmp}/none.json | none.json
report {letters} | board.json
reconstruct {set}/cards --method truht -o {tmp}/o | --method is 'truth' or a matcher: unknown method
reconstruct {set}/cards --far 0.1 -o {tmp}/o | no point is left; allow larger depths
rectify {set}/cards --fit vlid -o {tmp}/o | did you mean 'valid'
rectify {set}/cards --scene {long} -o {tmp}/o | File name too long
statistics {set} --like {long} | File name too long
cameras --size 640x480 | name the file by --read
rectify {set}/cards --fit vlid -o {set}/cards | unknown --fit 'vlid'; did you mean 'valid'
rectify {tmp}/none --pictures warp -o {tmp}/o | unknown --pictures 'warp'
show epipolar {set}/cards --cameras 0,2 -o {tmp}/e.png | --cameras
show epipolar {set}/cards -o {tmp}/e.jpg | must end in .png
show flow cards --target 0@1 -o {tmp}/f.png | cards: nothing moves: add [[motion]]
show flow cards --target left -o {tmp}/f.png | --target must be CAMERA@SECONDS, such as 0@0.4
show flow cards --target 1@nan -o {tmp}/f.png | --target must be CAMERA@SECONDS
show flow cards --target 2@1 -o {tmp}/f.png | the target camera must be a whole number from 0 to 1, got 2
show confidence {set}/cards --method opencv_bm -o {tmp}/c.png | this method has no cost volume
show costs {set}/cards --at 64,0 -o {tmp}/c.svg | --at must be U,V, a column from 0 to 63 and a row from 0 to 47
show costs {set}/cards --at 1,2 --methods opencv_bm -o {tmp}/c.svg | opencv_bm has no cost curve
show costs {set}/cards --at 1,2 --lens 2 -o {tmp}/c.svg | --lens must be a whole number from 0 to 1
plan --depth 1,2 --fov 60 --focal-length-mm 4 | give exactly one of --fov and
plan --depth 1,2 --fov 60 --baseline a | --baseline must be one number, or the least and
plan --depth 1,2 --fov 60 --snr 2 | --snr needs --lux
plan --depth 1,2 --fov 60 --lux 2 --snr 1e4 | --snr must be at most
study pinhol -o {tmp}/o | did you mean 'pinhole'
study window --seeds 0 -o {tmp}/o | seeds
study {tmp}/absent.py -o {tmp}/o | no such file
demo -o {letters} | contains 'dataset.json' and no board; choose a new or an empty folder
"""


@pytest.mark.parametrize("row", REFUSED.strip().splitlines())
def test_a_line_that_cannot_be_carried_out(refuses, places, row):
    line, words = row.split(" | ")
    refuses(words, *(part.format(**places) for part in line.split()))


@pytest.mark.parametrize(
    "line",
    [
        "render cards",
        "generate {file}",
        "reconstruct {set}/cards",
        "rectify {set}/cards",
        "show epipolar {set}/cards",
        "export {set} --to carla",
        "match {im0} {im1}",
        "benchmark {set}",
        "study window",
        "demo",
    ],
)
def test_an_output_that_is_missing_empty_or_a_bucket(
    refuses, places, monkeypatch, line
):
    monkeypatch.chdir(places["tmp"])
    command = line.format(**places).split()
    if line != "demo":
        refuses("twinlens: Missing option '-o' / '--output'", *command)
    refuses("'-o' / '--output': the name is empty", *command, "-o", "")
    if command[0] not in ("render", "generate", "export"):
        words = "'memory://x/y' is a bucket's address"
        refuses(words, *command, "-o", "memory://x/y")


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


@pytest.mark.parametrize(
    "line",
    [
        "render cards -o {file}/x",
        "generate {recipe} -o {file}/x",
        "rectify {set}/cards -o {file}/x",
        "show epipolar {set}/cards -o {file}/x.png",
        "export {set} --to carla -o {file}/x",
        "benchmark {set} -o {file}/x",
        "match {im0} {im0} -o {file}/x.pfm",
        "match {im0} {im0} -o {tmp}/d.pfm --picture {file}/x.png",
        "study window -o {file}/x",
    ],
)
def test_an_output_below_a_file_names_that_file(refuses, places, line):
    file = places["file"]
    words = f"twinlens: {file}: is a file where a folder is needed; choose another name"
    refuses(words, *line.format(**places).split())


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


"""Commands that write, and the help of an output that has to be given."""


def test_folders_above_an_output_are_made(twinlens, places, tmp_path):
    for line, output in (
        ("match {im0} {im1} --method sad --ndisp 8 --picture {tmp}/c/d.png -o", "a/b/d.pfm"),
        ("benchmark {set} --methods sad:block_size=5 -o", "e/f/board"),
        ("report {tmp}/e/f/board -o", "g/h/page.html"),
        ("export {set} --to carla -o", "i/j/set"),
        ("show epipolar {set}/cards -o", "k/l/lines.png"),
        ("rectify {set}/cards -o", "o/p/cards"),
        ("reconstruct {set}/cards --cell-mm 40 -o", "q/r/points"),
    ):  # fmt: skip
        code, _, err = twinlens(*line.format(**places).split(), tmp_path / output)
        assert (code, err) == (0, "")
        assert (tmp_path / output).exists()
