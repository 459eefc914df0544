"""What the commands of each page of docs start from: the files that a reader of the page has.

`STORIES` has a function for every page whose commands `test_examples` runs; it writes into an empty folder.
"""

import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.docs.pages import blocks
from twinlens.cli import run
from twinlens.dataset.codecs.pfm import write_pfm

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
QUICK = ["--spp", "1", "--no-denoise"]
"""Options that make the images of `twinlens render` cheap."""

PLAIN = """
seed = 3
count = 2
scenes = ["cards"]
"""
LENSES = """
seed = 5
count = 4
families = ["tabletop"]
rig = { baseline = { uniform = [0.05, 0.1] } }
[[lenses]]
kind = "thin"
f_number = 1.4
[[lenses]]
kind = "thin"
f_number = 4
"""
ARC = """
layout = "arc"
count = 3
angle_deg = 30
"""
MATCHER = """
import numpy as np

def name(left, right, *, num_disparities, min_disparity):
    return np.full(left.shape[:2], min_disparity + 1, np.float32)
"""


def small_recipe(text: str, **changes: str | int) -> str:
    """The recipe with two small samples of one light path a pixel, which no gate rejects for their noise."""
    small = {"count": 2, "width": 96, "height": 72, "spp": 1, "denoise": "false"}
    small |= changes
    is_replaced = re.compile(rf"({'|'.join(small)}) = ").match
    top, bracket, tables = text.partition("\n[")
    kept = [line for line in top.splitlines() if not is_replaced(line)]
    lines = [f"{key} = {value}" for key, value in small.items()]
    gates = "\n[gates]\nattempts = 5\ntexture = 0\n"
    return "\n".join([*lines, *kept]) + bracket + tables + gates


def recipe_of(page: str, part: str, **changes: str | int) -> str:
    """The small form of the page's recipe that contains `part`."""
    (text,) = [text for _, text in blocks(DOCS / page, "toml") if part in text]
    return small_recipe(text, **changes)


def render(*arguments: str) -> None:
    assert run(["render", *arguments, *QUICK]) == 0


def write_images(folder: Path) -> None:
    """im0.png and im1.png: noise at a disparity of 3 px."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 256, (72, 99, 3), np.uint8)
    cv2.imwrite(str(folder / "im0.png"), texture[:, :96])
    cv2.imwrite(str(folder / "im1.png"), texture[:, 3:])


def write_network(path: Path) -> None:
    """A small network of descriptors."""
    pytest.importorskip("onnxruntime")
    from tests.matching.test_descriptors import patches

    patches(path)


def write_pair(folder: Path) -> None:
    """A pair without truth."""
    write_images(folder)
    camera = "[100 0 47.5; 0 100 35.5; 0 0 1]"
    lines = [f"cam0={camera}", f"cam1={camera}", "doffs=0", "baseline=100"]
    lines += ["width=96", "height=72", "ndisp=16"]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")


def dataset(folder: Path) -> None:
    """out: the staircase, as README renders it but for size and noise."""
    render("staircase", "--size", "160x120", "-o", str(folder / "out"))


def benchmark(folder: Path) -> None:
    dataset(folder)
    (folder / "recipe.toml").write_text(small_recipe(LENSES))
    with zipfile.ZipFile(folder / "my-maps.zip", "w") as archive:
        archive.write(folder / "out/staircase/disp0.pfm", "staircase.pfm")


def camera(folder: Path) -> None:
    """Nothing: the page's commands take bundled scenes."""


def recipe(folder: Path) -> None:
    (folder / "recipe.toml").write_text(small_recipe(PLAIN))


def shards(folder: Path) -> None:
    """Two datasets of two random scenes each."""
    for number in (1, 2):
        text = small_recipe(LENSES, seed=number)
        (folder / "shard.toml").write_text(text)
        made = str(folder / f"shard-{number}")
        assert run(["generate", str(folder / "shard.toml"), "-o", made]) == 0


def motion(folder: Path) -> None:
    (folder / "docs").mkdir()
    shutil.copy(DOCS / "motion.toml", folder / "docs")


def light_fields(folder: Path) -> None:
    text = recipe_of("light_fields.md", 'layout = "light_field"', width=48, height=48)
    (folder / "light_field.toml").write_text(text)


def methods(folder: Path) -> None:
    dataset(folder)
    write_images(folder)
    write_network(folder / "net.onnx")
    (folder / "path/to").mkdir(parents=True)
    (folder / "path/to/file.py").write_text(MATCHER)


def projectors(folder: Path) -> None:
    (folder / "scan.toml").write_text(recipe_of("projectors.md", "sequence = ["))


def real_pairs(folder: Path) -> None:
    write_pair(folder / "pairs/desk")
    write_pair(folder / "pairs/shelf")


def realism(folder: Path) -> None:
    dataset(folder)
    (folder / "start.toml").write_text(small_recipe(PLAIN))
    for name in ("desk", "shelf"):
        write_pair(folder / "my-pairs" / name)
        disparity = np.full((72, 96), 3.0, np.float32)
        write_pfm(folder / "my-pairs" / name / "disp0.pfm", disparity)


def reconstruction(folder: Path) -> None:
    (folder / "arc.toml").write_text(ARC)


def calibration(folder: Path) -> None:
    """The calibration file of the page."""
    ((_, text),) = blocks(DOCS / "rigs.md", "text")
    (folder / "stereo.yml").write_text(text)


def rigs(folder: Path) -> None:
    """A calibration file, a recipe that names it, and a dataset of a rig of the page that is not rectified."""
    calibration(folder)
    recipe = recipe_of("rigs.md", 'families = ["tabletop"]')
    size = "width = 96\nheight = 72\n"
    (folder / "calibrated.toml").write_text(recipe.replace(size, ""))
    rig = next(text for _, text in blocks(DOCS / "rigs.md", "toml") if "toed" in text)
    (folder / "rig.toml").write_text(rig)
    options = ["--rig", str(folder / "rig.toml"), "--size", "96x72"]
    render("staircase", *options, "-o", str(folder / "out"))


def training(folder: Path) -> None:
    write_images(folder)
    text = (ROOT / "benchmarks/learned/recipe.toml").read_text()
    (folder / "my.toml").write_text(small_recipe(text))
    write_pair(folder / "YOUR_PAIRS/desk")
    trained = folder / "out/mine/seed-0.onnx"
    trained.parent.mkdir(parents=True)
    write_network(trained)


STORIES: dict[str, Callable[[Path], None]] = {
    "docs/benchmark.md": benchmark,
    "docs/camera.md": camera,
    "docs/cluster.md": recipe,
    "docs/datasets.md": shards,
    "docs/light_fields.md": light_fields,
    "docs/methods.md": methods,
    "docs/motion.md": motion,
    "docs/projectors.md": projectors,
    "docs/real_pairs.md": real_pairs,
    "docs/realism.md": realism,
    "docs/recipes.md": recipe,
    "docs/reconstruction.md": reconstruction,
    "docs/rigs.md": rigs,
    "docs/training.md": training,
}
