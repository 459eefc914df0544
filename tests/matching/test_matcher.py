"""The searching kernels against plain loops, over random sizes, windows, ranges and number types."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import twinlens.matching as tm
from tests.matching.matching_reference import (
    assert_minimal,
    first_minimum,
    naive_fit,
    naive_volume,
)
from twinlens.matching.box import BoxMatch
from twinlens.matching.costs import COSTS

WHOLE_NUMBERS = ("sad", "ssd", "census", "rank")
BOUNDED = ("ncc", "zncc", "jaccard")
SEARCHES = [(name, 3) for name in COSTS if name != "rank"]
SEARCHES += [("census", 7), ("census", 9), ("rank", 5)]


@st.composite
def problems(draw):
    """left, right, block_size, min_disparity, num_disparities: small, ragged and sometimes degenerate."""
    shape = 2, draw(st.integers(1, 5)), draw(st.integers(1, 12))
    dtype = draw(st.sampled_from(["uint8", "uint16", "float32"]))
    brightest = draw(st.sampled_from([2, 65535 if dtype == "uint16" else 255]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    images = rng.random(shape) * brightest
    if dtype != "float32":
        images = np.rint(images)
    side = draw(st.sampled_from([1, 3, 5, 7]))
    return (
        *images.astype(dtype),
        side,
        draw(st.integers(-16, 8)),
        draw(st.integers(1, 16)),
    )


def whole(left, right, cost, side, low, count, **options):
    """The map without a sub-pixel fit."""
    return tm.match(
        left,
        right,
        cost,
        block_size=side,
        min_disparity=low,
        num_disparities=count,
        **{"subpixel": "none", "threads": 1} | options,
    )


@pytest.mark.parametrize(("cost", "descriptor"), SEARCHES)
@settings(max_examples=12, deadline=None)
@given(problem=problems())
def test_every_cost_chooses_a_minimum_of_plain_loops(cost, descriptor, problem):
    left, right, side, low, count = problem
    volume = naive_volume(*problem[:2], cost, *problem[2:], descriptor)
    disparity = whole(left, right, cost, side, low, count, census_window=descriptor)
    scale = 1.0
    if cost not in BOUNDED:
        scale = max(1.0, float(volume[np.isfinite(volume)].max(initial=0)))
    assert_minimal(volume, disparity, low, atol=1e-5 * scale, rtol=1e-5)
    if cost in WHOLE_NUMBERS and left.dtype.kind == "u":
        np.testing.assert_array_equal(disparity, first_minimum(volume, low))
    if cost in ("sad", "ssd") and left.dtype.kind == "u":
        box = BoxMatch(left, right, COSTS[cost], side, low, low + count, 1)
        finite = np.isfinite(disparity)
        lowest = box.winners("none").cost[finite]
        np.testing.assert_array_equal(lowest, volume.min(-1)[finite])


@pytest.mark.parametrize("cost", ["sad", "ssd", "zncc"])
@settings(max_examples=12, deadline=None)
@given(problem=problems())
def test_sub_pixel_fit_is_the_one_of_the_cost(cost, problem):
    left, right, side, low, count = problem
    volume = naive_volume(left, right, cost, side, low, count)
    best = whole(left, right, cost, side, low, count)
    fine = whole(left, right, cost, side, low, count, subpixel="auto")
    winners = np.where(np.isfinite(best), best - low, 0).astype(int)
    expected = naive_fit(volume, winners, COSTS[cost].fit) + low
    # Where three costs lie on a line to within rounding the fit is undetermined.
    padded = np.pad(volume, ((0, 0), (0, 0), (1, 1)), constant_values=np.inf)
    near = np.take_along_axis(padded, winners[..., None] + np.arange(3), axis=-1)
    with np.errstate(invalid="ignore"):
        flat = np.maximum(near[..., 0], near[..., 2]) - near[..., 1] < 1e-3
    tolerance = 2e-3 if cost == "zncc" else 1e-5
    np.testing.assert_allclose(fine[~flat], expected[~flat], atol=tolerance)


@pytest.mark.parametrize(
    ("cost", "count"), [("sad", 64), ("sad", 129), ("sad", 300), ("zncc", 129)]
)
def test_long_ranges_are_searched_in_passes_without_seams(cost, count):
    rng = np.random.default_rng(count)
    left, right = rng.integers(0, 256, (2, 2, 330), dtype=np.uint8)
    volume = naive_volume(left, right, cost, 3, -5, count)
    best = whole(left, right, cost, 3, -5, count)
    np.testing.assert_array_equal(best, volume.argmin(-1) - 5.0)
    fine = whole(left, right, cost, 3, -5, count, subpixel="auto")
    expected = naive_fit(volume, volume.argmin(-1), COSTS[cost].fit) - 5
    np.testing.assert_allclose(fine, expected, atol=1e-3)


@pytest.mark.parametrize("side", [15, 17, 21, 31])
def test_wide_windows_of_saturated_images_do_not_overflow(side):
    left, right = np.full((3, 40), 255, np.uint8), np.zeros((3, 40), np.uint8)
    left[:, ::7], right[:, 3::7] = 0, 255
    for cost in ("sad", "ssd", "zncc", "zssd"):
        volume = naive_volume(left, right, cost, side, 0, 6)
        disparity = whole(left, right, cost, side, 0, 6)
        assert_minimal(volume, disparity, 0, atol=1e-5, rtol=1e-6)


@pytest.mark.parametrize("side", [3, 11])
@pytest.mark.parametrize("low", [-5, 0, 3])
def test_candidates_outside_the_image_never_win_over_negative_correlations(side, low):
    """Light that grows to the right in one eye and to the left in the other, then black: costs of 2, and of 1."""
    ramp = 7 * np.arange(44) + np.random.default_rng(7).integers(0, 5, (6, 44))
    left = np.where(np.arange(44) < 30, ramp, 0).astype(np.uint8)
    right = (255 - ramp // 2).astype(np.uint8)
    volume = naive_volume(left, right, "zncc", side, low, 16)
    assert_minimal(volume, whole(left, right, "zncc", side, low, 16), low, atol=1e-5)
    assert {1, 2} <= set(np.round(volume.min(-1), 1).ravel())


def test_constant_images_tie_and_the_smallest_disparity_wins():
    flat = np.full((6, 12), 80, np.uint8)
    for cost in COSTS:
        disparity = tm.match(flat, flat, cost, block_size=3, num_disparities=4)
        np.testing.assert_array_equal(disparity, np.zeros((6, 12)), err_msg=cost)


def test_a_range_or_window_wider_than_the_image_is_no_error():
    left, right = np.random.default_rng(0).integers(0, 256, (2, 4, 9), dtype=np.uint8)
    wide = whole(left, right, "ssd", 31, -500, 1000)
    volume = naive_volume(left, right, "ssd", 31, -8, 17)
    np.testing.assert_array_equal(wide, volume.argmin(-1) - 8.0)
    assert np.isinf(whole(left, right, "sad", 3, 20, 9)).all()


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_the_answer_is_the_same_bytes_for_any_number_of_threads(dtype):
    images = np.random.default_rng(3).integers(0, 256, (2, 150, 70)).astype(dtype)
    for cost in ("sad", "ssd", "ncc", "zsad", "zssd", "zncc", "jaccard"):
        answers = {
            tm.match(*images, cost, num_disparities=12, threads=count).tobytes()
            for count in (1, 2, 3, 7)
        }
        assert len(answers) == 1, cost


def test_left_right_check_keeps_pixels_on_which_both_maps_agree():
    rng = np.random.default_rng(2)
    background, front = rng.integers(0, 256, (2, 20, 120), dtype=np.uint8)
    left, right = background[:, 4:104].copy(), background[:, 8:108].copy()
    left[:, 50:70], right[:, 38:58] = front[:, :20], front[:, :20]
    checked = whole(left, right, "sad", 3, 0, 16, lr_check=1.0)
    assert np.all(checked[2:-2, 52:68] == 12)
    assert np.all(checked[2:-2, 24:40] == 4)
    hidden = checked[2:-2, 43:49]
    assert np.isinf(hidden).mean() > 0.6


def test_colour_becomes_luma_and_integers_stay_integers():
    colour = np.random.default_rng(0).integers(0, 256, (4, 5, 3), dtype=np.uint8)
    expected = np.rint(colour @ np.array([0.299, 0.587, 0.114]))
    grey = tm.grey(colour)
    assert grey.dtype == np.uint8
    assert np.abs(grey - expected).max() <= 1
    mirrored = colour[:, ::-1].copy()
    np.testing.assert_array_equal(
        tm.match(colour, mirrored, "sad", num_disparities=4),
        tm.match(grey, tm.grey(mirrored), "sad", num_disparities=4),
    )


def test_signed_images_match_as_their_values_do():
    left, right = np.random.default_rng(0).integers(0, 256, (2, 8, 30), dtype=np.uint8)
    signed = [image.astype(np.int16) - 128 for image in (left, right)]
    for cost in ("sad", "ssd", "zncc"):
        expected = whole(left, right, cost, 5, 0, 8)
        np.testing.assert_array_equal(whole(*signed, cost, 5, 0, 8), expected)
