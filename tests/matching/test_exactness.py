"""Rounding, overflow and ties."""

import numpy as np
import pytest

import twinlens.matching as tm
from tests.matching.matching_reference import is_candidate, naive_volume
from twinlens.errors import InputError
from twinlens.matching.box import BoxMatch, blank
from twinlens.matching.costs import COSTS
from twinlens.matching.images import clipped_slope
from twinlens.matching.supports import window_sizes


def costs_of(left, right, name, side, low, count):
    """The kernel's cost volume, (H, W, count)."""
    box = BoxMatch(left, right, COSTS[name], side, low, low + count, 1)
    volume = np.zeros((*left.shape, box.depth))
    box.fill(volume, 0, 1.0, COSTS[name].offset)
    blank(volume, box.low, box.count)
    return np.pad(
        volume[..., :count],
        [(0, 0), (0, 0), (0, max(0, count - box.depth))],
        constant_values=np.inf,
    )


@pytest.mark.parametrize("value", [0.0, 0.1])
@pytest.mark.parametrize("name", ["zncc", "ncc"])
def test_constant_windows_of_floats_have_the_documented_cost(name, value):
    """Rows of light above leave rounding in the sums below, where a dark wall begins."""
    images = 1000 * np.random.default_rng(0).random((2, 40, 24))
    images[:, 12:] = value
    undefined = name == "zncc" or value == 0
    dark = np.s_[20:36]
    for scale in (1e-6, 1.0, 1e6):
        left, right = scale * images
        costs = costs_of(left, right, name, 5, 0, 4)[dark]
        candidate = np.isfinite(costs)
        np.testing.assert_allclose(costs[candidate], float(undefined), atol=1e-6)
        assert (candidate == is_candidate((16, 24), 0, 4)).all()
        if undefined:
            disparity = tm.match(left, right, name, block_size=5, num_disparities=4)
            assert (disparity[dark] == 0).all()


@pytest.mark.parametrize("name", ["sad", "ssd", "zssd", "zncc", "ncc", "jaccard"])
def test_of_equal_windows_of_floats_the_smallest_disparity_wins(name):
    tile = np.random.default_rng(1).random((70, 4)).astype(np.float32) / 3
    image = np.tile(tile, (1, 12))
    found = tm.match(
        image, image, name, block_size=5, num_disparities=12, subpixel="none", threads=1
    )
    np.testing.assert_array_equal(found[:, 16:-4], np.zeros((70, 28)))


@pytest.mark.parametrize(("name", "most"), [("zncc", 303), ("zssd", 255)])
def test_windows_too_wide_for_64_bits_are_refused_in_a_line(name, most):
    extremes = np.zeros((2, 2, 8), np.uint16)
    extremes[0, :, ::2] = extremes[1, :, 1::2] = 65535
    tm.match(*extremes, name, block_size=most, num_disparities=2)
    with pytest.raises(InputError, match=f"exact up to {most}") as caught:
        tm.match(*extremes, name, block_size=most + 2, num_disparities=2)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["zncc", "zssd"])
def test_wide_windows_of_16_bits_are_exact(name):
    pair = np.random.default_rng(2).choice([0, 65535], (2, 3, 9)).astype(np.uint16)
    costs = costs_of(*pair, name, 41, 0, 3)
    expected = naive_volume(*pair, name, 41, 0, 3)
    np.testing.assert_allclose(costs, expected, rtol=1e-12, atol=1e-9)


def test_a_winner_is_not_its_own_rival():
    """The fit at 3000 - 0.49998 rounds to half a pixel in float32, between two candidates."""
    width, d = 3010, 3000
    left, right = np.full((1, width), 40000, np.uint16), np.zeros((1, width), np.uint16)
    x = width - 5
    right[0, x - d : x - d + 2] = 40000, 39999
    matcher = tm.StereoMatcher(
        cost="sad", block_size=1, min_disparity=d - 3, num_disparities=7, uniqueness=50
    )
    found = matcher.match(left, right)
    assert found[0, x] == pytest.approx(d - 0.5, abs=1e-3)
    box = BoxMatch(left, right, COSTS["sad"], 1, d - 3, d + 4, 1)
    assert box.winners("v").rival[0, x] == 40000


def test_the_prefilter_equals_that_of_opencv():
    cv2 = pytest.importorskip("cv2")
    image = np.random.default_rng(3).integers(0, 256, (12, 20), dtype=np.uint8)
    border = cv2.BORDER_REPLICATE
    sobel = cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=3, borderType=border)
    slopes = clipped_slope(image.astype(np.int32))
    np.testing.assert_array_equal(slopes, np.clip(sobel, -31, 31) + 31)
    pair = np.roll(image, 3, axis=1), image
    filtered = [clipped_slope(side.astype(np.int32)) for side in pair]
    np.testing.assert_array_equal(
        tm.match(*pair, "sad", num_disparities=9, prefilter="xsobel"),
        tm.match(*filtered, "sad", num_disparities=9),
    )


def test_adaptive_windows_are_small_on_texture_and_large_without():
    image = np.full((21, 60), 90)
    image[:, 30:] += np.random.default_rng(6).integers(0, 150, (21, 30))
    sizes = window_sizes(image, (9, 5, 3), 2.0)
    assert (sizes[:, :25] == 0).all()
    assert (sizes[:, 36:] == 2).mean() > 0.9
    assert (window_sizes(image, (9, 5, 3), 1000.0) == 0).all()
