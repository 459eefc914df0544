"""Transforms, supports and semi-global matching against plain loops."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import ndimage

import twinlens.matching as tm
from tests.matching.matching_reference import (
    assert_minimal,
    first_minimum,
    is_candidate,
    naive_cross,
    naive_guided,
    naive_paths,
    naive_pixel_costs,
    naive_pixel_window_volume,
    naive_shiftable,
    naive_volume,
    naive_weighted,
)
from twinlens.matching.costs import COSTS
from twinlens.matching.kernels.supports import cross_means
from twinlens.matching.semiglobal import Penalties, Sweeps
from twinlens.matching.supports import SUPPORTS

DIRECTIONS = (0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (1, 1), (-1, 1), (1, -1)
RADIUS = 2
SIDE = 2 * RADIUS + 1


@st.composite
def pairs(draw):
    """Two small images with edges in them, and the first of five candidates."""
    height, width = draw(st.integers(1, 40)), draw(st.integers(1, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    scene = rng.integers(0, 40, (2, height, width)) + 90 * (
        np.arange(width) > width // 2
    )
    left, right = scene.astype(np.uint8)
    return left, right, draw(st.integers(-6, 4))


def whole(left, right, cost, low, count=5, **options):
    return tm.match(
        left,
        right,
        cost,
        min_disparity=low,
        num_disparities=count,
        subpixel="none",
        threads=1,
        **options,
    )


@pytest.mark.parametrize(
    ("cost", "descriptor"), [("census", 3), ("census", 7), ("census", 9), ("rank", 5)]
)
@settings(max_examples=6, deadline=None)
@given(problem=pairs(), side=st.sampled_from([1, 3]))
def test_transformed_costs_equal_plain_loops(cost, descriptor, problem, side):
    left, right, low = problem[0][:4], problem[1][:4], problem[2]
    volume = naive_pixel_window_volume(left, right, cost, side, low, 5, descriptor)
    got = whole(left, right, cost, low, block_size=side, census_window=descriptor)
    np.testing.assert_array_equal(got, first_minimum(volume, low))


@settings(max_examples=10, deadline=None)
@given(problem=pairs(), side=st.sampled_from([1, 3]))
def test_birchfield_tomasi_equals_plain_loops(problem, side):
    left, right, low = problem[0][:4], problem[1][:4], problem[2]
    volume = naive_pixel_window_volume(left, right, "birchfield_tomasi", side, low, 5)
    assert_minimal(
        volume, whole(left, right, "birchfield_tomasi", low, block_size=side), low
    )


REFERENCES = {
    "shiftable": lambda left, right, low: naive_shiftable(
        naive_volume(left, right, "sad", SIDE, low, 5), RADIUS
    ),
    "cross": lambda left, right, low: naive_cross(
        naive_pixel_costs(left, right, low, 5), left, RADIUS
    ),
    "weighted": lambda left, right, low: naive_weighted(
        naive_pixel_costs(left, right, low, 5), left, right, low, RADIUS
    ),
    "guided": lambda left, right, low: naive_guided(
        naive_pixel_costs(left, right, low, 5), left, RADIUS
    ),
}


@pytest.mark.parametrize("support", REFERENCES)
@settings(max_examples=6, deadline=None)
@given(problem=pairs())
def test_every_support_equals_plain_loops(support, problem):
    left, right, low = problem
    volume = REFERENCES[support](left, right, low)
    volume[~is_candidate(left.shape, low, 5)] = np.inf
    assert_minimal(
        volume, whole(left, right, "sad", low, support=support, block_size=SIDE), low
    )


def test_sums_over_crosses_are_exact_where_prefix_sums_wrap_around():
    volume = np.random.default_rng(1).integers(0, 2**32, (6, 5, 32), dtype=np.uint32)
    single_pixels, out = np.zeros((4, 6, 5), np.int32), np.empty((4, 5, 32))
    cross_means(volume.copy(), single_pixels, 1, out)
    np.testing.assert_array_equal(out, volume[1:5])


@pytest.mark.parametrize("support", SUPPORTS)
@pytest.mark.parametrize("cost", COSTS)
def test_every_cost_with_every_support_finds_a_shift(cost, support):
    scene = ndimage.gaussian_filter(
        np.random.default_rng(4).normal(128, 200, (20, 60)), 1.0
    )
    scene = np.clip(scene, 0, 255).astype(np.uint8)
    left, right = scene[:, 4:54], scene[:, 7:57]
    if SUPPORTS[support].pixelwise and COSTS[cost].scoring != "sum":
        return  # refused: see test_combinations
    for optimisation in ("wta", "sgm8"):
        got = tm.match(
            left,
            right,
            cost,
            support=support,
            block_size=5,
            num_disparities=8,
            optimisation=optimisation,
        )
        assert np.mean(np.abs(got[4:-4, 12:-4] - 3) < 0.5) > 0.85, optimisation


@pytest.mark.parametrize("large", [20, 150])  # sums of 8 bits, and of 16
@pytest.mark.parametrize("depth", [32, 64, 96])
@pytest.mark.parametrize("paths", [4, 8])
def test_path_costs_equal_paths_followed_one_by_one(depth, paths, large):
    costs = np.random.default_rng(depth).integers(0, 60, (5, 110, depth))
    ways = DIRECTIONS[:paths]
    total = naive_paths(costs, ways, 7, large).astype(float)
    total[~is_candidate((5, 110), 0, depth)] = np.inf
    penalties = Penalties(7, large, 60)
    volume = costs.astype(penalties.dtype)
    got = Sweeps(
        lambda start, stop: volume[start:stop],
        costs.shape,
        paths,
        penalties,
        0,
        depth,
        "none",
    ).winners(2, rivals=True)
    near = np.abs(np.arange(depth) - total.argmin(-1)[..., None]) < 2
    np.testing.assert_array_equal(got.disparity, total.argmin(-1))
    np.testing.assert_array_equal(got.cost, total.min(-1))
    np.testing.assert_array_equal(got.rival, np.where(near, np.inf, total).min(-1))


@pytest.mark.parametrize("paths", [4, 8])
@pytest.mark.parametrize("low", [-3, 2])
def test_semi_global_matching_of_census_equals_its_formula(paths, low):
    left, right = np.random.default_rng(paths).integers(
        0, 256, (2, 6, 14), dtype=np.uint8
    )
    volume = naive_pixel_window_volume(left, right, "census", 1, low, 7, 5)
    candidate = np.isfinite(volume)
    # The lanes beyond the range are as costly as a candidate without a partner.
    costs = np.pad(
        np.where(candidate, volume, 24).astype(int),
        ((0, 0), (0, 0), (0, 9)),
        constant_values=24,
    )
    small, large = round(0.2 * 24), round(0.9 * 24)
    ways = DIRECTIONS[:paths]
    total = np.where(candidate, naive_paths(costs, ways, small, large)[..., :7], np.inf)
    got = whole(
        left,
        right,
        "census",
        low,
        7,
        block_size=1,
        census_window=5,
        optimisation=f"sgm{paths}",
        p1=0.2,
        p2=0.9,
    )
    np.testing.assert_array_equal(
        got, np.where(candidate.any(-1), total.argmin(-1) + low, np.inf)
    )


@pytest.mark.parametrize(
    "method",
    [
        "census",
        "rank",
        "cross",
        "guided",
        "adaptive",
        "sgm",
        "birchfield_tomasi",
        "zsad",
    ],
)
@pytest.mark.parametrize("dtype", ["uint16", "float32"])
def test_wide_and_float_images_are_matched_and_threads_change_nothing(method, dtype):
    scene = np.random.default_rng(9).integers(0, 65536, (70, 60)).astype(dtype)
    left, right = scene[:, 5:50], scene[:, 9:54]
    options = {"num_disparities": 9, "block_size": 5}
    answers = [tm.match(left, right, method, threads=n, **options) for n in (1, 3)]
    assert answers[0].tobytes() == answers[1].tobytes()
    assert np.mean(np.abs(answers[0][5:-5, 14:-5] - 4) < 0.5) > 0.97


@pytest.mark.parametrize("method", ["cross", "adaptive", "sgm", "shiftable", "census"])
def test_degenerate_images_are_answered(method):
    flat = np.full((3, 4), 255, np.uint8)
    got = tm.match(
        flat, flat, method, num_disparities=100, min_disparity=-50, block_size=15
    )
    assert np.isfinite(got).all()
    dot = np.zeros((1, 1), np.uint8)
    assert tm.match(dot, dot, method, num_disparities=3)[0, 0] == 0
    assert np.isinf(
        tm.match(dot, dot, method, num_disparities=3, min_disparity=1)[0, 0]
    )


@pytest.mark.parametrize("glints_in", ["left", "right"])
@pytest.mark.parametrize(
    ("method", "glint"),
    [("sgm:cost=sad,block_size=3", 4.0), ("sgm4:cost=ssd,block_size=3", 2.0)],
)
def test_highlights_in_one_image_do_not_overflow_the_costs(method, glint, glints_in):
    rng = np.random.default_rng(3)
    right = rng.random((40, 80)).astype(np.float32)
    left = np.roll(right, 5, axis=1)
    glinting = {"left": left, "right": right}[glints_in]
    glinting[rng.random(glinting.shape) < 0.03] *= glint
    found = tm.match(left, right, method, num_disparities=16)
    inside = np.s_[4:-4, 24:-4]
    assert (np.abs(found[inside] - 5) < 1).mean() > 0.97


def test_flat_float_images_do_not_divide_by_zero():
    flat = np.full((12, 30), 0.3, np.float32)
    assert (
        tm.match(flat, flat, method="sgm:cost=sad", num_disparities=8)[:, 8:] == 0
    ).all()
