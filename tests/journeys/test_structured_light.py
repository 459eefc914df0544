"""From a recipe of a projector's patterns to decoded points, by the commands of docs/projectors.md alone."""

import json
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

import twinlens as tl
from tests.docs.pages import blocks

PAGE = Path(__file__).parents[2] / "docs" / "projectors.md"
SECTION = "## Sequences of patterns"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="docs/ is not next to tests/")
SMALL = {
    "width = 640\nheight = 480": "width = 64\nheight = 48",
    "width = 256\nheight = 192": "width = 32\nheight = 24",
    "spp = 16": "spp = 4",
    "count = 2": "count = 1",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the recipe of the page, smaller."""
    recipe = next(text for _, text in blocks(PAGE, "toml") if "sequence = [" in text)
    for large, small in SMALL.items():
        assert large in recipe
        recipe = recipe.replace(large, small)
    (tmp_path / "scan.toml").write_text(recipe)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def commands():
    """The commands of the section of the page."""
    section = PAGE.read_text().split(SECTION)[1].split("\n## ")[0]
    text = section.split("```sh\n")[1].split("```")[0]
    return [shlex.split(line)[1:] for line in text.splitlines()]


@pytest.mark.slow
def test_from_a_recipe_of_patterns_to_points(twinlens, folder):
    for command in commands():
        code, out, _ = twinlens(*command)
        assert code == 0, out
    assert "of the lit ones, u " in out
    (sample,) = tl.Dataset("scans")
    assert sample.num_frames == 1 + 2 * 5 + 4
    assert sample.scene
    decoded = json.loads(Path("decoded/decoded.json").read_text())
    (views,) = decoded["samples"].values()
    for view, found in enumerate(views):
        name = f"decoded/{sample.name}/decoded{view}"
        picture = cv2.imread(f"{name}.png")
        height, width = sample.image(view).shape[:2]
        title_height = picture.shape[0] - height
        assert picture.shape[1] == 4 * width
        assert 8 < title_height < 24
        for column in range(4):  # black letters on white above each picture
            title = picture[:title_height, column * width :][:, :width]
            assert title.min() < 64
            assert title.max() == 255
        arrays = np.load(f"{name}.npz")
        truth = sample.truth(view)
        light = truth.projections[0]
        # Pixels at edges see two surfaces, and the truth is that of one.
        apart = maximum_filter(truth.depth, 3) - minimum_filter(truth.depth, 3)
        both = arrays["valid"] & light.lit & ~(apart > 0.1 * truth.depth)
        error = np.abs(arrays["u"][both] - light.pixels[both, 0])
        assert found["against_truth"]["decoded_of_lit"] > 0.8
        # Glossy objects also reflect the pattern, at other columns.
        assert (error < 0.5).mean() > 0.95
        assert found["against_truth"]["u_px"]["within_half"] > 0.9
        offsets = arrays["points"][both] - truth.position[both]
        away = np.linalg.norm(offsets, axis=-1)
        assert np.median(away) < 0.05 * np.median(truth.depth[both])
        assert Path(f"{name}.png").stat().st_size > 100
        assert Path(f"decoded/{sample.name}/points{view}.ply").exists()


def test_patterns_of_different_scenes_are_warned_of(twinlens, folder):
    recipe = (folder / "scan.toml").read_text()
    start = recipe.index("sequence = [")
    lone = 'pattern = { type = "gray_code", frame = { sweep = [0, 1] } }\n'
    (folder / "lone.toml").write_text(recipe[:start] + lone)
    code, _, err = twinlens("generate", "lone.toml", "-o", "lone")
    assert code == 0
    assert "replace pattern by sequence" in err
    code, out, err = twinlens("decode", "lone", "-o", "none")
    assert code == 2
    assert "the sample has no" in out + err
    assert not (folder / "none").exists()


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ('sequence = [{ type = "gray" }]', "gray_code"),
        ("sequence = []", "at least 1"),
        ('sequence = [{ type = "white" }]\npattern = { type = "dots" }', "keep one"),
        ('sequence = [{ type = "picture", file = "absent.png" }]', "absent.png"),
        ('sequence = [{ type = "gray_code", frame = 99 }]', r"sequence[0]"),
    ],
)
def test_wrong_sequences_are_one_line(twinlens, folder, change, problem):
    recipe = (folder / "scan.toml").read_text()
    (folder / "wrong.toml").write_text(recipe[: recipe.index("sequence = [")] + change)
    code, out, err = twinlens("generate", "wrong.toml", "-o", "wrong")
    assert code == 2
    assert problem in err
    assert len((out + err).strip().splitlines()) == 1
    assert not (folder / "wrong").exists()
