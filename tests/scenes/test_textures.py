"""Laws of the patterns: range, period, mean, spectrum, and the same picture from the same seed."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from twinlens.scenes import textures

Pattern = Callable[[int], textures.Image]
PATTERNS = {
    "value_noise": lambda seed: textures.value_noise(96, 64, (8, 4), seed),
    "value_cells": lambda seed: textures.value_noise(96, 64, (8, 4), seed, "nearest"),
    "fractal_noise": lambda seed: textures.fractal_noise(96, 64, (3, 2), seed),
    "random_dots": lambda seed: textures.random_dots(96, 64, 40, (0.02, 0.08), seed),
    "checker": lambda seed: textures.checker(96, 64, (6, 4), seed),
    "stripes": lambda seed: textures.stripes(96, 64, 6, seed),
    "sine": lambda seed: textures.stripes(96, 64, 6, seed, profile="sine"),
    "siemens_star": lambda seed: textures.siemens_star(96, 64, 12, seed),
    "bricks": lambda seed: textures.bricks(96, 64, (3, 4), seed),
    "wood": lambda seed: textures.wood(96, 64, 5, seed),
    "gradient": lambda seed: textures.gradient(96, 64, seed),
}
RANDOM = [
    "value_noise",
    "value_cells",
    "fractal_noise",
    "random_dots",
    "bricks",
    "wood",
]
SMOOTH_PERIODIC = ["value_noise", "fractal_noise", "sine", "random_dots"]


@pytest.mark.parametrize("name", PATTERNS)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_values_stay_in_the_unit_interval_and_repeat_with_their_seed(name, seed):
    made = PATTERNS[name](seed)
    assert made.shape == (64, 96)
    assert made.dtype == np.float32
    assert made.min() >= 0
    assert made.max() <= 1
    np.testing.assert_array_equal(made, PATTERNS[name](seed))


@pytest.mark.parametrize("name", RANDOM)
def test_different_seeds_make_different_patterns(name):
    assert np.abs(PATTERNS[name](1) - PATTERNS[name](2)).max() > 0.05


@pytest.mark.parametrize("name", SMOOTH_PERIODIC)
def test_periodic_patterns_have_no_seam(name):
    """The step across the border is no larger than the largest step inside."""
    made = PATTERNS[name](5).astype(float)
    for axis in (0, 1):
        inside = np.abs(np.diff(made, axis=axis)).max()
        across = np.abs(np.take(made, 0, axis) - np.take(made, -1, axis)).max()
        assert across <= inside + 1e-6


def test_dots_that_cross_the_border_come_back_on_the_other_side():
    """Rolling the picture keeps every dot whole: the area is what separate discs have, wherever they lie."""
    areas = [
        textures.random_dots(200, 200, 1, (0.1, 0.1), seed).sum() for seed in range(40)
    ]
    np.testing.assert_allclose(areas, np.pi * 20**2, rtol=0.01)


def test_dots_cover_what_independent_discs_cover():
    """1 - exp(-n pi r^2): the coverage of a Boolean model of discs."""
    cover = np.mean(
        [
            textures.random_dots(256, 256, 200, (0.03, 0.03), seed).mean()
            for seed in range(12)
        ]
    )
    assert cover == pytest.approx(1 - np.exp(-200 * np.pi * 0.03**2), abs=0.02)


def test_value_noise_passes_through_its_lattice():
    """Smooth noise meets the lattice values where the cells begin, and averages to one half over seeds."""
    coarse = textures.value_noise(8, 8, (8, 8), 4, "nearest")
    fine = textures.value_noise(8 * 101, 8 * 101, (8, 8), 4)
    np.testing.assert_allclose(fine[::101, ::101], coarse, atol=1e-3)
    means = [
        float(textures.value_noise(64, 64, (16, 16), seed).mean()) for seed in range(64)
    ]
    assert np.mean(means) == pytest.approx(0.5, abs=4 * float(np.std(means)) / 8)


@pytest.mark.parametrize("gain", [0.5, 0.7])
def test_fractal_noise_falls_off_as_its_gain_says(gain):
    """The radial power spectrum of a sum of octaves has slope -(2 + 2H), H = -log2(gain)."""
    power = np.zeros((512, 512))
    for seed in range(12):
        made = textures.fractal_noise(
            512, 512, (4, 4), seed, octaves=8, gain=gain, contrast=0.5
        )
        power += np.abs(np.fft.fft2(made - made.mean())) ** 2
    frequency = np.hypot(
        *np.meshgrid(np.fft.fftfreq(512, 1 / 512), np.fft.fftfreq(512, 1 / 512))
    )
    octaves = 2.0 ** np.arange(3, 8)
    rings = [
        power[(frequency >= low) & (frequency < 2 * low)].mean() for low in octaves
    ]
    slope = np.polyfit(np.log2(octaves), np.log2(rings), 1)[0]
    assert slope == pytest.approx(-2 - 2 * -np.log2(gain), abs=0.3)


@pytest.mark.parametrize("gain", [0.4, 0.8])
def test_fractal_noise_has_the_contrast_asked_for(gain):
    spread = [
        textures.fractal_noise(256, 256, (16, 16), s, gain=gain, contrast=0.6).std()
        for s in range(8)
    ]
    assert np.mean(spread) == pytest.approx(0.6 / 5, rel=0.08)


def test_checker_and_stripes_have_their_periods():
    board = textures.checker(64, 32, (8, 4))
    np.testing.assert_array_equal(board, 1 - np.roll(board, 8, axis=1))
    np.testing.assert_array_equal(board, 1 - np.roll(board, 8, axis=0))
    assert board[0, 0] == 1
    bars = textures.stripes(64, 4, 8, duty=0.25)
    np.testing.assert_array_equal(bars[0, :8], [1, 1, 0, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(bars, np.roll(bars, 8, axis=1))


def test_an_edge_inside_a_texel_is_grey_by_the_share_it_covers():
    assert textures.stripes(3, 1, 1, duty=0.5)[0].tolist() == [1.0, 0.5, 0.0]


def test_the_star_has_its_spokes_and_blurs_to_grey_in_the_middle():
    star = textures.siemens_star(401, 401, 18)
    angle = (np.arange(7200) + 0.5) / 7200 * 2 * np.pi
    ring = (
        star[
            (200 + 150 * np.sin(angle)).round().astype(int),
            (200 + 150 * np.cos(angle)).round().astype(int),
        ]
        > 0.5
    )
    assert (
        np.count_nonzero(ring != np.roll(ring, 1)) >= 36
    )  # an edge on both sides of every spoke
    assert np.abs(np.fft.rfft(ring - ring.mean())).argmax() == 18
    assert star[198:203, 198:203].mean() == pytest.approx(0.5, abs=0.1)
    assert star[0, 0] == 0.5


def test_the_top_row_is_the_end_of_the_gradient():
    made = textures.gradient(4, 100)
    assert made[0, 0] > 0.99
    assert made[-1, 0] < 0.01
