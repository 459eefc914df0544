"""docs/own_objects.md: its blocks run in order in a copy of its folder, with small images; its links work."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.docs.pages import blocks, run_block
from twinlens.dataset import open_sample
from twinlens.dataset.codecs.ply import read_ply
from twinlens.geometry import transform_points

ROOT = Path(__file__).parents[2]
PAGE, FILES = ROOT / "docs" / "own_objects.md", ROOT / "examples" / "own_objects"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="docs/ is not next to tests/")
SMALL = {"width = 640": "width = 128", "height = 480": "height = 96"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder in which the page has run, and what its blocks printed."""
    folder = tmp_path_factory.mktemp("page") / "own_objects"
    shutil.copytree(FILES, folder)
    recipe = folder / "recipe.toml"
    text = recipe.read_text()
    for large, small in SMALL.items():
        assert large in text
        text = text.replace(large, small)
    recipe.write_text(text)
    return folder, "".join(
        run_block(*block, folder) for block in blocks(PAGE, "sh", "python")
    )


def test_the_tables_of_the_page_are_those_of_the_files():
    bench, recipe, *_ = (text for _, text in blocks(PAGE, "toml"))
    assert bench in (FILES / "bench.toml").read_text()
    assert recipe in (FILES / "recipe.toml").read_text()


@pytest.mark.slow
def test_the_part_has_its_own_size_and_its_poses_reproject_it(run):
    folder, printed = run
    assert "2 samples, 0 with findings" in printed
    overlaps = [
        float(line.split("IoU ")[1]) for line in printed.splitlines() if "IoU" in line
    ]
    sample = open_sample(folder / "out" / "0000000")
    truth = sample.truth0
    mounts = [
        thing for thing in truth.objects if truth.object_name(thing).startswith("mount")
    ]
    assert len(overlaps) == len(mounts) >= 3
    assert min(overlaps) >= 0.99
    table = next(thing for thing in truth.objects if thing not in mounts)
    for thing in mounts:
        assert_allclose(thing.extent * 1000, [[-30, -42.5, 0], [30, 7, 50]], atol=1e-4)
        vertices, _ = read_ply(sample.path(f"models/{thing.model}.ply"))
        table_from_part = np.linalg.inv(table.cam_from_object) @ thing.cam_from_object
        heights = transform_points(table_from_part, vertices)[:, 2] - table.extent[1, 2]
        assert 0 <= heights.min() < 1e-4  # metres
        assert np.count_nonzero(heights < 1e-4) >= 3
