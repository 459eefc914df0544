"""The searching kernels against plain loops, over random sizes, windows, ranges and number types."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import twinlens.matching as tm
from tests.matching.matching_reference import naive_fit, naive_volume
from twinlens.errors import InputError
from twinlens.matching.box import BoxMatch
from twinlens.matching.costs import COSTS

EXACT = ("sad", "ssd")
ALL = ("sad", "ssd", "ncc", "zsad", "zssd", "zncc", "jaccard")


@st.composite
def problems(draw, dtypes=("uint8", "uint16", "float32")):
    """left, right, block_size, min_disparity, num_disparities: small, ragged and sometimes degenerate."""
    height, width = draw(st.integers(1, 5)), draw(st.integers(1, 12))
    dtype = np.dtype(draw(st.sampled_from(dtypes)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    top = (
        draw(st.sampled_from([2, 255]))
        if dtype != np.uint16
        else draw(st.sampled_from([3, 65535]))
    )
    images = rng.random((2, height, width)) * top
    if dtype.kind != "f":
        images = np.rint(images)
    left, right = images.astype(dtype)
    return (
        left,
        right,
        draw(st.sampled_from([1, 3, 5, 7])),
        draw(st.integers(-16, 8)),
        draw(st.integers(1, 16)),
    )


def chosen_costs(volume, disparity, low):
    """The reference's cost of the disparities that were chosen, where one was."""
    known = np.isfinite(disparity)
    index = np.where(known, disparity - low, 0).astype(int)
    return np.take_along_axis(volume, index[..., None], axis=-1)[..., 0]


@pytest.mark.parametrize("cost", EXACT)
@settings(max_examples=25, deadline=None)
@given(problem=problems(dtypes=("uint8", "uint16")))
def test_integer_costs_choose_the_same_as_naive_loops(cost, problem):
    left, right, side, low, count = problem
    volume = naive_volume(left, right, cost, side, low, count)
    disparity = tm.match(
        left,
        right,
        cost,
        block_size=side,
        min_disparity=low,
        num_disparities=count,
        subpixel="none",
        threads=1,
    )
    expected = np.where(np.isfinite(volume.min(-1)), volume.argmin(-1) + low, np.inf)
    np.testing.assert_array_equal(disparity, expected)
    best = (
        BoxMatch(left, right, COSTS[cost], side, low, low + count, 1)
        .winners("none")
        .cost
    )
    known = np.isfinite(expected)
    np.testing.assert_array_equal(best[known], volume.min(-1)[known])


@pytest.mark.parametrize("cost", ALL)
@settings(max_examples=15, deadline=None)
@given(problem=problems())
def test_every_cost_chooses_a_minimum_of_plain_loops(cost, problem):
    left, right, side, low, count = problem
    volume = naive_volume(left, right, cost, side, low, count)
    disparity = tm.match(
        left,
        right,
        cost,
        block_size=side,
        min_disparity=low,
        num_disparities=count,
        subpixel="none",
        threads=1,
    )
    least = volume.min(-1)
    known = np.isfinite(least)
    np.testing.assert_array_equal(np.isfinite(disparity), known)
    scale = (
        1.0
        if cost in ("ncc", "zncc", "jaccard")
        else max(1.0, float(least[known].max(initial=0)))
    )
    np.testing.assert_allclose(
        chosen_costs(volume, disparity, low)[known],
        least[known],
        atol=1e-5 * scale,
        rtol=1e-5,
    )


@pytest.mark.parametrize("cost", ["sad", "ssd", "zncc"])
@settings(max_examples=12, deadline=None)
@given(problem=problems())
def test_sub_pixel_fit_is_the_one_of_the_cost(cost, problem):
    left, right, side, low, count = problem
    volume = naive_volume(left, right, cost, side, low, count)
    options = {
        "block_size": side,
        "min_disparity": low,
        "num_disparities": count,
        "threads": 1,
    }
    whole = tm.match(left, right, cost, subpixel="none", **options)
    fine = tm.match(left, right, cost, **options)
    winners = np.where(np.isfinite(whole), whole - low, 0).astype(int)
    expected = naive_fit(volume, winners, COSTS[cost].fit) + low
    # Where three costs lie on a line to within rounding the fit is undetermined.
    near = [
        np.take_along_axis(volume, np.clip(winners + i, 0, count - 1)[..., None], -1)[
            ..., 0
        ]
        for i in (-1, 0, 1)
    ]
    with np.errstate(invalid="ignore"):
        sharp = ~(np.maximum(near[0], near[2]) - near[1] < 1e-3)
    np.testing.assert_allclose(
        fine[sharp], expected[sharp], atol=2e-3 if cost == "zncc" else 1e-5
    )


@pytest.mark.parametrize("cost", ALL)
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_a_shifted_random_image_gives_its_shift_everywhere_inside(cost, dtype):
    rng = np.random.default_rng(5)
    scene = rng.integers(0, 256, (40, 120)).astype(dtype)
    for shift, low in ((0, -8), (7, 0), (-5, -9)):
        left, right = scene[:, 20:100], scene[:, 20 + shift : 100 + shift]
        disparity = tm.match(
            left, right, cost, block_size=5, min_disparity=low, num_disparities=16
        )
        assert np.array_equal(
            np.rint(disparity[3:-3, 14:-14]), np.full((34, 52), shift)
        )


@pytest.mark.parametrize(
    ("cost", "count"), [("sad", 64), ("sad", 129), ("sad", 300), ("zncc", 129)]
)
def test_long_ranges_are_searched_in_passes_without_seams(cost, count):
    rng = np.random.default_rng(count)
    left, right = rng.integers(0, 256, (2, 2, 330), dtype=np.uint8)
    volume = naive_volume(left, right, cost, 3, -5, count)
    fine = tm.match(
        left,
        right,
        cost,
        block_size=3,
        min_disparity=-5,
        num_disparities=count,
        threads=1,
    )
    whole = tm.match(
        left,
        right,
        cost,
        block_size=3,
        min_disparity=-5,
        num_disparities=count,
        threads=1,
        subpixel="none",
    )
    np.testing.assert_array_equal(whole, volume.argmin(-1) - 5.0)
    expected = naive_fit(volume, volume.argmin(-1), COSTS[cost].fit) - 5
    np.testing.assert_allclose(fine, expected, atol=1e-3)


@pytest.mark.parametrize("side", [15, 17, 21, 31])
def test_wide_windows_of_saturated_images_do_not_overflow(side):
    left = np.full((side, 40), 255, np.uint8)
    right = np.zeros((side, 40), np.uint8)
    left[:, ::7], right[:, 3::7] = 0, 255
    for cost in ("sad", "ssd", "zncc", "zssd"):
        volume = naive_volume(left[:3], right[:3], cost, side, 0, 6)
        got = tm.match(
            left[:3],
            right[:3],
            cost,
            block_size=side,
            num_disparities=6,
            subpixel="none",
        )
        np.testing.assert_allclose(
            chosen_costs(volume, got, 0), volume.min(-1), atol=1e-5, rtol=1e-6
        )


@pytest.mark.parametrize("side", [3, 11])
@pytest.mark.parametrize("low", [-5, 0, 3])
def test_candidates_outside_the_image_never_win_over_negative_correlations(side, low):
    """Light that grows to the right in one eye and to the left in the other, then black: costs of 2, and of 1."""
    ramp = 7 * np.arange(44) + np.random.default_rng(7).integers(0, 5, (6, 44))
    left, right = (
        np.where(np.arange(44) < 30, ramp, 0).astype(np.uint8),
        (255 - ramp // 2).astype(np.uint8),
    )
    volume = naive_volume(left, right, "zncc", side, low, 16)
    got = tm.match(
        left,
        right,
        "zncc",
        block_size=side,
        min_disparity=low,
        num_disparities=16,
        subpixel="none",
    )
    known = np.isfinite(volume.min(-1))
    np.testing.assert_array_equal(np.isfinite(got), known)
    assert {1, 2} <= set(np.round(volume.min(-1)[known], 1))
    np.testing.assert_allclose(
        chosen_costs(volume, got, low)[known], volume.min(-1)[known], atol=1e-5
    )


@pytest.mark.parametrize("cost", ALL)
def test_constant_images_tie_and_the_smallest_disparity_wins(cost):
    flat = np.full((6, 12), 80, np.uint8)
    disparity = tm.match(flat, flat, cost, block_size=3, num_disparities=4)
    np.testing.assert_array_equal(disparity, np.zeros((6, 12)))


def test_only_pixels_without_a_candidate_are_unknown():
    left, right = np.random.default_rng(0).integers(0, 256, (2, 5, 20), dtype=np.uint8)
    known = np.isfinite(
        tm.match(left, right, "sad", block_size=3, min_disparity=4, num_disparities=3)
    )
    np.testing.assert_array_equal(known, np.broadcast_to(np.arange(20) >= 4, (5, 20)))
    known = np.isfinite(
        tm.match(left, right, "sad", block_size=3, min_disparity=-6, num_disparities=3)
    )
    np.testing.assert_array_equal(known, np.broadcast_to(np.arange(20) < 16, (5, 20)))
    assert not np.isfinite(
        tm.match(left, right, "sad", min_disparity=20, num_disparities=9)
    ).any()


def test_a_range_or_window_wider_than_the_image_is_no_error():
    left, right = np.random.default_rng(0).integers(0, 256, (2, 4, 9), dtype=np.uint8)
    wide = tm.match(
        left,
        right,
        "ssd",
        block_size=31,
        num_disparities=1000,
        min_disparity=-500,
        subpixel="none",
    )
    volume = naive_volume(left, right, "ssd", 31, -8, 17)
    np.testing.assert_array_equal(wide, volume.argmin(-1) - 8.0)


@pytest.mark.parametrize("cost", ALL)
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_the_answer_is_the_same_bytes_for_any_number_of_threads(cost, dtype):
    left, right = np.random.default_rng(3).integers(0, 256, (2, 150, 70)).astype(
        dtype
    ) / np.dtype(dtype).type(1)
    left, right = left.astype(dtype), right.astype(dtype)
    answers = [
        tm.match(left, right, cost, num_disparities=12, threads=n).tobytes()
        for n in (1, 2, 3, 7)
    ]
    assert len(set(answers)) == 1


def test_the_right_map_is_the_left_map_of_the_mirrored_pair():
    scene = np.random.default_rng(1).integers(0, 256, (12, 80), dtype=np.uint8)
    left, right = scene[:, 10:70], scene[:, 14:74]
    matcher = tm.StereoMatcher(cost="sad", block_size=3, num_disparities=9)
    ours, theirs = (
        matcher.match(left, right),
        matcher.match(right[:, ::-1], left[:, ::-1])[:, ::-1],
    )
    assert np.array_equal(np.rint(ours[1:-1, 6:-6]), np.full((10, 48), 4))
    assert np.array_equal(np.rint(theirs[1:-1, 6:-6]), np.full((10, 48), 4))


def test_left_right_check_keeps_pixels_on_which_both_maps_agree():
    rng = np.random.default_rng(2)
    background, front = rng.integers(0, 256, (2, 20, 120), dtype=np.uint8)
    left, right = background[:, 4:104].copy(), background[:, 8:108].copy()
    left[:, 50:70], right[:, 38:58] = front[:, :20], front[:, :20]
    checked = tm.match(
        left,
        right,
        "sad",
        block_size=3,
        num_disparities=16,
        lr_check=1.0,
        subpixel="none",
    )
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
    other = colour[:, ::-1].copy()
    np.testing.assert_array_equal(
        tm.match(colour, other, "sad", num_disparities=4),
        tm.match(grey, tm.grey(other), "sad", num_disparities=4),
    )


def test_signed_images_match_as_their_values_do():
    left, right = np.random.default_rng(0).integers(0, 256, (2, 8, 30), dtype=np.uint8)
    shifted = [(image.astype(np.int16) - 128) for image in (left, right)]
    for cost in ("sad", "ssd", "zncc"):
        expected = tm.match(
            left, right, cost, block_size=5, num_disparities=8, subpixel="none"
        )
        np.testing.assert_array_equal(
            tm.match(*shifted, cost, block_size=5, num_disparities=8, subpixel="none"),
            expected,
        )


GOOD = np.zeros((4, 6), np.uint8)
WRONG = {
    "even block": ((GOOD, GOOD), {"block_size": 4}, "use 3 or 5"),
    "negative block": ((GOOD, GOOD), {"block_size": -1}, ">= 1"),
    "block of no number": ((GOOD, GOOD), {"block_size": "x"}, "whole number"),
    "empty range": ((GOOD, GOOD), {"num_disparities": 0}, ">= 1"),
    "half a candidate": ((GOOD, GOOD), {"min_disparity": 0.5}, "whole number"),
    "sizes differ": ((GOOD, GOOD[:3]), {}, "6x4 and 6x3"),
    "dtypes differ": ((GOOD, GOOD.astype(np.uint16)), {}, "one dtype"),
    "wide integers": ((GOOD.astype(np.int64),) * 2, {}, "use uint8, uint16 or float32"),
    "not a number": (
        (GOOD.astype(float), np.full((4, 6), np.nan)),
        {},
        r"right image holds nan at \[0, 0\]",
    ),
    "no image": ((GOOD[:0], GOOD[:0]), {}, r"shape \(0, 6\)"),
    "four channels": ((np.zeros((4, 6, 4), np.uint8),) * 2, {}, "H, W, 3"),
    "unknown method": ((GOOD, GOOD), {"method": "znc"}, "did you mean 'zncc'"),
    "unknown option": ((GOOD, GOOD), {"blocksize": 5}, "did you mean 'block_size'"),
    "misspelt method": ((GOOD, GOOD), {"methd": "sad"}, "did you mean 'method'"),
    "a path": (
        ("a.png", "b.png"),
        {},
        r"left image is 'a.png'; give an array: twinlens.dataset.read_image",
    ),
    "unknown fit": ((GOOD, GOOD), {"subpixel": "parabolla"}, "did you mean 'parabola'"),
    "negative check": ((GOOD, GOOD), {"lr_check": -1}, ">= 0"),
    "negative light": ((GOOD - 1.0, GOOD - 1.0), {"method": "jaccard"}, "values >= 0"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_is_refused_in_one_line_with_the_remedy(case):
    images, options, message = WRONG[case]
    with pytest.raises(InputError, match=message) as caught:
        tm.match(*images, **options)
    assert "\n" not in str(caught.value)
