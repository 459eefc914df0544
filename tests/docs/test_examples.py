"""Every command, recipe and program of README and docs is accepted, runs, and prints what the page shows.

Three kinds of examples, by cost:

- what a page shows below a command (`$ twinlens ...`) is compared with what the command prints, as a whole, but for
  times, sizes, folders and versions; commands that render or match large images are slow tests;
- tables of settings and Python programs are read; slow tests run the programs;
- slow tests run the other commands of a page in order, with small images, from the files of `stories`.

`ELSEWHERE` names the tests that run the commands of the other pages.
"""

import contextlib
import doctest
import io
import re
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w
import trimesh

import twinlens as tl
from tests.docs.pages import blocks, commands
from tests.docs.stories import DOCS, QUICK, ROOT, STORIES, calibration
from twinlens.cli import run
from twinlens.dataset.codecs.exr import encode_exr
from twinlens.dataset.codecs.png import write_png
from twinlens.factory import read_recipe
from twinlens.scenes import load_scene, rig_from_table

pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="docs/ is not next to tests/")
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
ELSEWHERE = {
    "README.md": "tests/docs/test_readme.py",
    "docs/multiview.md": "tests/journeys/test_many_views.py",
    "docs/own_objects.md": "tests/docs/test_own_objects_page.py, tests/journeys/test_own_parts.py",
    "docs/studies.md": "tests/docs/test_readme.py, tests/studies/test_studies_page.py",
}
NOT_RUN = ("--scheduler", "SLURM")
"""What marks a command that needs a cluster."""
VOLATILE = {
    r"\b\d+(\.\d+)? ?(ms|s|min|h)\b": "TIME",
    r"\b\d+(\.\d+)? ?(bytes|kB|MB|GB)\b": "SIZE",
    r"file:///\S*/": "FOLDER/",
}
"""What differs between two runs, and the word that stands for it."""


def name_of(page):
    return str(page.relative_to(ROOT))


def masked(text):
    for pattern, word in VOLATILE.items():
        text = re.sub(pattern, word, text)
    return text


def printed(line):
    """(exit code, stdout and stderr) of a command line of twinlens, run here; `> FILE` takes stdout."""
    words = shlex.split(line, comments=True)
    start = words.index("twinlens") + 1
    words, target = words[start:], None
    if ">" in words:
        target = Path(words[words.index(">") + 1])
        words = words[: words.index(">")]
    out, err = io.StringIO(), io.StringIO() if target else None
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err or out):
        code = run(words)
    if target:
        target.write_text(out.getvalue())
    return code, out.getvalue() + (err.getvalue() if err else "")


# What a page shows of the output


SHOWN = [
    (page, command)
    for page in PAGES
    for command in commands(page)
    if command.shown is not None
]
RENDERING = re.compile(r"twinlens (render|generate|rectify|study|benchmark|show)")


def cases_shown():
    for page, command in SHOWN:
        marks = [pytest.mark.slow] if RENDERING.match(command.line) else []
        name = f"{page.stem}: {command.line}"[:60]
        yield pytest.param(page, command, id=name, marks=marks)


@pytest.mark.parametrize(("page", "command"), list(cases_shown()))
def test_a_command_prints_what_the_page_shows(page, command, tmp_path, monkeypatch):
    """`...` on the page stands for any text. Files of the repository are named from its root."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "benchmarks").symlink_to(ROOT / "benchmarks")
    calibration(tmp_path)
    misspelt = 'seed = 1\ncount = 1\nscenes = ["cards"]\nrig = { basline = 0.1 }\n'
    (tmp_path / "misspelt.toml").write_text(misspelt)
    _, text = printed(command.line)
    want, got = masked(command.shown).rstrip() + "\n", masked(text).rstrip() + "\n"
    is_as_shown = doctest.OutputChecker().check_output(want, got, doctest.ELLIPSIS)
    assert is_as_shown, f"{page} shows\n{want}\nnot\n{got}"


def test_pages_show_output():
    """The walk above is not empty."""
    assert {page.name for page, _ in SHOWN} >= {"planning.md", "rigs.md", "recipes.md"}


# Tables of settings


SCENE = """
[camera]
position = [0, -3, 1]
look_at = [0, 0, 0.5]
depth_range = [1.0, 9.0]
[lights.sky]
type = "constant"
[materials.grey]
type = "diffuse"
[objects.ball]
shape = "sphere"
material = "grey"
"""
RECIPE = 'seed = 1\ncount = 2\nscenes = ["cards"]\n'
SKY = '\n[sky]\nfile = "hdris/day.exr"\n'
WORKSHOP = """
camera = { position = [0, -3, 1], look_at = [0, 0, 0.5], depth_range = [1.0, 9.0] }
lights = { sky = { type = "constant" } }
materials = { brass = { type = "diffuse" }, chrome = { type = "diffuse" } }
[objects]
lamp = { shape = "sphere", material = "brass" }
table = { shape = "box", extents = [1, 1, 0.1], material = "chrome" }
"""
"""A bench.toml with all that docs/recipes.md says of it."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the files that the tables of docs name."""
    folder = tmp_path_factory.mktemp("tables")
    calibration(folder)
    (folder / "bench.toml").write_text(WORKSHOP)
    rows = np.random.default_rng(0).random((4, 8, 3), np.float32)
    (folder / "hdris").mkdir()
    for name in ("workshop.exr", "hdris/day.exr"):
        light = {channel: rows[..., i] for i, channel in enumerate("RGB")}
        (folder / name).write_bytes(encode_exr(light))
    (folder / "parts").mkdir()
    for name in ("mount.glb", "parts/mug.glb", "parts/housing.glb"):
        trimesh.creation.box([0.1, 0.1, 0.1]).export(folder / name)
    return folder


READ_ELSEWHERE = {"motion", "multiview"}
"""Pages whose tables are parts of one scene: test_motion_page and test_many_views read them."""
TABLES = [
    pytest.param(page, text, id=f"{page.stem}-{i}")
    for page in PAGES
    for i, (_, text) in enumerate(blocks(page, "toml"))
    if not text.startswith("#:schema") and page.stem not in READ_ELSEWHERE
]


def completed(text, whole):
    """The tables of a page with those of `whole` that they lack."""
    tables, others = tomllib.loads(text), tomllib.loads(whole)
    both = {key: tables[key] | others[key] for key in tables.keys() & others.keys()}
    return others | tables | both


@pytest.mark.parametrize(("page", "text"), TABLES)
def test_a_table_of_settings_is_read(page, text, files):
    """As a scene, a rig's file, or a recipe; what a part lacks to a whole file is added."""
    bench = (ROOT / "examples/own_objects/bench.toml").read_text()
    keys = tomllib.loads(text).keys()
    if text in bench:
        return  # test_own_objects_page renders the whole
    if "layout" in keys:
        assert rig_from_table(tomllib.loads(text), tl.load_scene("cards"), 64, 48)
    elif keys & {"objects", "textures"}:
        path = files / "scene.toml"
        path.write_text(tomli_w.dumps(completed(text, SCENE)))
        assert load_scene(path)
    else:
        path = files / "recipe.toml"
        path.write_text(text if "seed" in keys else RECIPE + text + SKY)
        assert read_recipe(path)


# Programs


PROGRAMS = {
    "bands.md": {"320, 240": "80, 60", "640, 480": "64, 48", "spp=64": "spp=2"},
    "families.md": {"640, 480": "64, 48", "width=1280": "width=64", "spp=64": "spp=2"},
    "index.md": {"640, 480": "80, 60", "spp=16, denoise=True": "spp=2"},
    "methods.md": {"160, 120": "80, 60", "spp=16": "spp=4"},
}
"""The pages whose programs run here, and what makes them small. Other tests run those of the other pages."""


@pytest.mark.slow
@pytest.mark.parametrize("name", PROGRAMS)
def test_the_programs_of_a_page_run_in_order(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("scans", "fabrics", "skies"):
        (tmp_path / folder).mkdir()
    trimesh.creation.box([0.1, 0.1, 0.1]).export(tmp_path / "scans/box.ply")
    cloth = np.random.default_rng(0).integers(0, 256, (16, 16, 3), np.uint8)
    for path in ("fabrics/cloth.png", "skies/day.png"):
        write_png(tmp_path / path, cloth)
    programs = [text for _, text in blocks(DOCS / name, "python")]
    names = {}
    for program in programs:
        if program.startswith(">>> "):
            continue  # test_site compares what it prints
        for large, small_text in PROGRAMS[name].items():
            program = program.replace(large, small_text)
        exec(compile(program, name, "exec"), names)


# Commands


def lines_of(page):
    """The command lines of a page that run here, in order: those whose output is not compared above."""
    for command in commands(page):
        is_ours = re.match(r"(\S+=\S+ )?twinlens [a-z]", command.line)
        is_run = not any(part in command.line for part in NOT_RUN)
        if is_ours and is_run and command.shown is None:
            yield command.line


def small(line):
    if line.startswith("twinlens render"):
        has_size = (
            "--rig stereo.yml" in line or "--principal-point" in line or "-px" in line
        )
        size = [] if has_size else ["--size", "96x72"]
        head, hash_, comment = line.partition(" #")
        return " ".join([head, *QUICK, *size]) + hash_ + comment
    return line.replace("--at 120,80", "--at 60,40")


@pytest.mark.slow
@pytest.mark.parametrize("name", STORIES)
def test_the_commands_of_a_page_run_in_order(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    STORIES[name](tmp_path)
    lines = list(lines_of(ROOT / name))
    assert lines
    for line in lines:
        code, text = printed(small(line))
        assert code == 0, f"{line}\n{text}"
        assert "warning: " not in text, f"{line}\n{text}"


def test_no_page_is_left_out():
    with_commands = {name_of(page) for page in PAGES if any(lines_of(page))}
    assert with_commands == {*STORIES, *ELSEWHERE}
