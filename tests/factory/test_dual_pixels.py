"""Samples with dual pixels: their files, disparity, record, verification and reading."""

import shutil

import numpy as np
import pytest

from tests.factory_recipes import write_recipe
from twinlens.dataset import Dataset, read_pfm, write_pfm
from twinlens.dataset.verify import verify_sample
from twinlens.factory import (
    generate,
    read_recipe,
)

RECIPE = """
seed = 5
count = {count}
scenes = ["tiny"]
width = 48
height = 36
spp = 16
denoise = false
dual_pixel = true

[[lenses]]
kind = "pinhole"

[[lenses]]
kind = "thin"
aperture_mm = 100
focus = 1.2

[sensor]
preset = "ideal"
output = "linear"
bits = 16
vignetting = false
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dual")
    generate(read_recipe(write_recipe(folder, RECIPE, 2)), folder / "out")
    return folder / "out"


@pytest.fixture
def sample(made):
    return Dataset(made)[0]


def test_lenses_with_an_aperture_have_two_halves_and_their_disparity(made, sample):
    new = {f"dp-{part}{i}" for part in ("left", "right", "disp") for i in (0, 1)}
    assert {path.stem for path in (sample.folder / "lens-1").iterdir()} == {
        "im0",
        "im1",
    } | new
    assert not any(path.name.startswith("dp") for path in sample.folder.iterdir())
    assert verify_sample(sample) == []
    assert "dp-left0.png" in (made / "croissant.json").read_text()
    assert "| dual pixels |" in (made / "README.md").read_text()


def test_the_whole_image_is_the_mean_of_the_halves(sample):
    """A linear sensor without noise reads each half at twice the gain."""
    shot = sample.lens(1)
    mean = 0.5 * shot.dp_left0 + 0.5 * shot.dp_right0
    bright = (shot.dp_left0 < 65535) & (shot.dp_right0 < 65535)
    np.testing.assert_allclose(mean[bright], shot.im0[bright], atol=1.0 + 65535 / 4096)
    assert (shot.dp_left0 != shot.dp_right0).any()


def test_the_halves_are_apart_by_the_true_disparity(sample):
    """On the textured wall behind the focus, the shift with the least difference is that of the truth."""
    shot, wall = sample.lens(1), (slice(0, 36), slice(30, 46))
    left = shot.dp_left0.mean(axis=-1)
    right = shot.dp_right0.mean(axis=-1)
    expected = shot.dp_disp0[wall]
    assert expected.max() < -0.5
    columns, shifts = np.arange(48.0), np.arange(-3, 3.01, 0.1)
    errors = []
    for shift in shifts:
        moved = [np.interp(columns - shift, columns, row) for row in right]
        errors.append(np.square(left - moved)[wall].sum())
    best = shifts[np.argmin(errors)]
    assert best == pytest.approx(np.median(expected), abs=0.35)


def test_damage_is_found(sample, tmp_path):
    folder = shutil.copytree(sample.folder, tmp_path / "copy")
    lens = folder / "lens-1"
    write_pfm(lens / "dp-disp0.pfm", -read_pfm(lens / "dp-disp0.pfm"))
    (finding,) = verify_sample(Dataset(folder)[0])
    assert finding.startswith("lens-1/dp-disp0.pfm: disparity is not that of the lens")
    (lens / "dp-right1.png").unlink()
    (finding,) = verify_sample(Dataset(folder)[0])
    assert finding.startswith("lens-1/dp-right1.png: is missing")
