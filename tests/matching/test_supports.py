"""Supports and semi-global matching against plain loops."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import ndimage

import twinlens.matching as tm
from tests.matching.matching_reference import (
    assert_minimal,
    is_candidate,
    naive_paths,
    naive_support,
    naive_volume,
    window_cost,
)
from twinlens.matching.costs import COSTS
from twinlens.matching.kernels.supports import cross_means
from twinlens.matching.semiglobal import Penalties, Sweeps
from twinlens.matching.supports import SUPPORTS

DIRECTIONS = (0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (1, 1), (-1, 1), (1, -1)
SIDE = 5


@st.composite
def pairs(draw):
    """Two small images with edges in them, and the first of five candidates."""
    shape = 2, draw(st.integers(1, 40)), draw(st.integers(1, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    scene = rng.integers(0, 40, shape)
    scene += 90 * (np.arange(shape[2]) > shape[2] // 2)
    return *scene.astype(np.uint8), draw(st.integers(-6, 4))


@pytest.mark.parametrize("support", ["shiftable", "cross", "weighted", "guided"])
@settings(max_examples=6, deadline=None)
@given(problem=pairs())
def test_every_support_equals_plain_loops(support, problem):
    left, right, low = problem
    cost = window_cost("sad", left, right)
    volume = naive_support(support, cost, (left, right), SIDE, low, 5)
    volume[~is_candidate(left.shape, low, 5)] = np.inf
    search = {"block_size": SIDE, "min_disparity": low, "num_disparities": 5}
    options = search | {"support": support, "subpixel": "none", "threads": 1}
    disparity = tm.match(left, right, "sad", **options)
    assert_minimal(volume, disparity, low)


def test_sums_over_crosses_are_exact_where_prefix_sums_wrap_around():
    volume = np.random.default_rng(1).integers(0, 2**32, (6, 5, 32), dtype=np.uint32)
    single_pixels, out = np.zeros((4, 6, 5), np.int32), np.empty((4, 5, 32))
    cross_means(volume.copy(), single_pixels, 1, out)
    np.testing.assert_array_equal(out, volume[1:5])


@pytest.mark.parametrize("support", SUPPORTS)
def test_semi_global_matching_of_every_cost_and_support_finds_a_shift(support):
    noise = np.random.default_rng(4).normal(128, 200, (20, 60))
    scene = ndimage.gaussian_filter(noise, 1.0).clip(0, 255).astype(np.uint8)
    left, right = scene[:, 4:54], scene[:, 7:57]
    options = {"block_size": 5, "num_disparities": 8, "optimisation": "sgm8"}
    for cost in COSTS:
        if SUPPORTS[support].pixelwise and COSTS[cost].scoring != "sum":
            continue  # refused: see test_combinations
        disparity = tm.match(left, right, cost, support=support, **options)
        assert np.mean(np.abs(disparity[4:-4, 12:-4] - 3) < 0.5) > 0.85, cost


@pytest.mark.parametrize("large", [20, 150])  # sums of 8 bits, and of 16
@pytest.mark.parametrize("depth", [32, 64, 96])
@pytest.mark.parametrize("paths", [4, 8])
def test_path_costs_equal_paths_followed_one_by_one(depth, paths, large):
    shape = 4, 70 + depth // 2, depth
    costs = np.random.default_rng(depth).integers(0, 60, shape)
    total = naive_paths(costs, DIRECTIONS[:paths], 7, large).astype(float)
    total[~is_candidate(shape[:2], 0, depth)] = np.inf
    penalties = Penalties(7, large, 60)
    volume = costs.astype(penalties.dtype)

    def rows(start, stop):
        return volume[start:stop]

    sweeps = Sweeps(rows, shape, paths, penalties, 0, depth, "none")
    winners = sweeps.winners(2, rivals=True)
    best = total.argmin(-1)
    near = np.abs(np.arange(depth) - best[..., None]) < 2
    np.testing.assert_array_equal(winners.disparity, best)
    np.testing.assert_array_equal(winners.cost, total.min(-1))
    np.testing.assert_array_equal(winners.rival, np.where(near, np.inf, total).min(-1))


@pytest.mark.parametrize("paths", [4, 8])
@pytest.mark.parametrize("low", [-3, 2])
def test_semi_global_matching_of_census_equals_its_formula(paths, low):
    rng = np.random.default_rng(paths)
    left, right = rng.integers(0, 256, (2, 6, 14), dtype=np.uint8)
    volume = naive_volume(left, right, "census", 1, low, 7, 5)
    candidate = np.isfinite(volume)
    # The lanes beyond the range are as costly as a candidate without a partner.
    costs = np.full((6, 14, 16), 24)
    costs[..., :7][candidate] = volume[candidate]
    sums = naive_paths(costs, DIRECTIONS[:paths], round(0.2 * 24), round(0.9 * 24))
    total = np.where(candidate, sums[..., :7], np.inf)
    matcher = tm.StereoMatcher(
        cost="census",
        block_size=1,
        census_window=5,
        optimisation=f"sgm{paths}",
        min_disparity=low,
        num_disparities=7,
        p1=0.2,
        p2=0.9,
        subpixel="none",
    )
    expected = np.where(candidate.any(-1), total.argmin(-1) + low, np.inf)
    np.testing.assert_array_equal(matcher.match(left, right), expected)
    mean_costs = matcher.cost_volume(left, right)
    np.testing.assert_allclose(mean_costs, total / paths, rtol=1e-6)


METHODS = ("census", "rank", "cross", "guided", "adaptive", "sgm", "birchfield_tomasi", "zsad")  # fmt: skip


@pytest.mark.parametrize("dtype", ["uint16", "float32"])
def test_wide_and_float_images_are_matched_and_threads_change_nothing(dtype):
    scene = np.random.default_rng(9).integers(0, 65536, (70, 60)).astype(dtype)
    left, right = scene[:, 5:50], scene[:, 9:54]
    options = {"num_disparities": 9, "block_size": 5}
    for method in METHODS:
        one = tm.match(left, right, method, threads=1, **options)
        three = tm.match(left, right, method, threads=3, **options)
        assert one.tobytes() == three.tobytes(), method
        assert np.mean(np.abs(one[5:-5, 14:-5] - 4) < 0.5) > 0.97, method


@pytest.mark.parametrize("method", ["cross", "adaptive", "sgm", "shiftable", "census"])
def test_degenerate_images_are_answered(method):
    flat = np.full((3, 4), 255, np.uint8)
    disparity = tm.match(
        flat, flat, method, num_disparities=100, min_disparity=-50, block_size=15
    )
    assert np.isfinite(disparity).all()
    dot = np.zeros((1, 1), np.uint8)
    assert tm.match(dot, dot, method, num_disparities=3) == 0
    assert np.isinf(tm.match(dot, dot, method, num_disparities=3, min_disparity=1))


@pytest.mark.parametrize("glints_in", [0, 1])
@pytest.mark.parametrize(
    ("method", "glint"),
    [("sgm:cost=sad,block_size=3", 4.0), ("sgm4:cost=ssd,block_size=3", 2.0)],
)
def test_highlights_in_one_image_do_not_overflow_the_costs(method, glint, glints_in):
    rng = np.random.default_rng(3)
    right = rng.random((40, 80)).astype(np.float32)
    images = [np.roll(right, 5, axis=1), right]
    images[glints_in][rng.random(right.shape) < 0.03] *= glint
    disparity = tm.match(*images, method, num_disparities=16)
    assert (np.abs(disparity[4:-4, 24:-4] - 5) < 1).mean() > 0.97


def test_flat_float_images_do_not_divide_by_zero():
    flat = np.full((12, 30), 0.3, np.float32)
    disparity = tm.match(flat, flat, method="sgm:cost=sad", num_disparities=8)
    assert (disparity[:, 8:] == 0).all()
