"""A search that is too short for a pair without truth is named, by matched images whose shift is known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import twinlens as tl
from twinlens.matching.features import disparities_of_features
from twinlens.scoring import Pair, run_benchmark
from twinlens.scoring.benchmark import MapWarning
from twinlens.scoring.doubts import doubt_of_order, doubt_of_search


def pair(shift, ndisp, low=0):
    """Textured images whose disparity is `shift` everywhere, without truth."""
    right = np.random.default_rng(0).integers(0, 256, (40, 120), np.uint8)
    left = np.roll(right, shift, axis=1)
    return Pair("p", left, right, None, None, ndisp, min_disparity=low)


def warned(sample):
    with pytest.warns(MapWarning) as record:
        run_benchmark([sample], ["sad"])
    return str(record[0].message)


@pytest.mark.parametrize("shift", [10, 15, 20])
def test_surfaces_beyond_or_at_the_end_are_named(shift):
    text = warned(pair(shift, 11))
    assert "the last disparity of the search, 10 px" in text
    assert "--num-disparities" in text


def test_surfaces_before_the_first_disparity_are_named():
    text = warned(pair(-8, 11, low=-5))
    assert "--min-disparity" in text or "--num-disparities" in text


def test_a_sufficient_search_raises_no_doubt():
    run_benchmark([pair(6, 16)], ["sad"])


def test_far_things_at_zero_raise_no_doubt():
    assert not doubt_of_search(np.zeros((4, 4), np.float32), 0, 15)


def test_unknown_maps_raise_no_doubt():
    assert not doubt_of_search(np.full((4, 4), np.inf, np.float32), 0, 15)


def test_features_have_the_shift_of_the_images():
    right = gaussian_filter(np.random.default_rng(1).normal(0, 1, (90, 160)), 1.5)
    right = np.uint8(np.clip(128 + 120 * right / np.abs(right).max(), 0, 255))
    for shift in (12, -7):
        disparities = disparities_of_features(np.roll(right, shift, axis=1), right)
        assert len(disparities) > 20
        assert np.median(disparities) == pytest.approx(shift, abs=0.1)


def test_large_images_are_reduced_and_flat_or_tiny_ones_have_no_features():
    small = gaussian_filter(np.random.default_rng(2).normal(0, 1, (200, 300)), 1.0)
    small = np.uint8(np.clip(128 + 120 * small / np.abs(small).max(), 0, 255))
    right = np.repeat(np.repeat(small, 4, axis=0), 4, axis=1)
    disparities = disparities_of_features(np.roll(right, 40, axis=1), right)
    assert np.median(disparities) == pytest.approx(40, abs=0.5)
    assert not len(disparities_of_features(right[:20], right[:20]))
    flat = np.full((60, 80, 3), 90, np.uint8)
    assert not len(disparities_of_features(flat, flat))


@pytest.mark.parametrize("low", [0.0, -3.0])
def test_only_disparities_below_the_search_are_of_exchanged_images(low):
    spread = np.linspace(5, 30, 100)
    assert "exchanged" in doubt_of_order(-spread, low)
    assert "--min-disparity" in doubt_of_order(-spread, low)
    assert not doubt_of_order(spread, low)
    assert not doubt_of_order(spread - 20, low)
    assert not doubt_of_order(-spread[:10], low)
    assert not doubt_of_order(-spread, -40.0)


@pytest.fixture(scope="module")
def motorcycle():
    """The real pair, reduced to a third, so that disparities are 2 to 23 px."""
    sample = tl.scoring.motorcycle()
    return [image[::3, ::3] for image in (sample.im0, sample.im1)]


@pytest.mark.parametrize("method", ["sgm", "zncc"])
def test_exchanged_images_are_named(motorcycle, method):
    """Of a real pair; the warning of the range alone would lead astray."""
    left, right = motorcycle
    for ndisp in (24, 48):
        exchanged = Pair("p", right, left, None, None, ndisp)
        with pytest.warns(MapWarning, match="left and right are probably exchanged"):
            run_benchmark([exchanged], [method])
    run_benchmark([Pair("p", left, right, None, None, 28)], [method])
