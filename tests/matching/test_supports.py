"""Transforms, supports and semi-global matching against plain loops."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import ndimage

import twinlens.matching as tm
from tests.matching.matching_reference import (
    is_candidate,
    naive_paths,
    naive_pixel_costs,
    naive_pixel_window_volume,
    naive_volume,
)
from twinlens.errors import InputError
from twinlens.matching.costs import COSTS
from twinlens.matching.kernels.supports import cross_means
from twinlens.matching.semiglobal import Penalties, Sweeps
from twinlens.matching.supports import SUPPORTS

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


def assert_minimal(volume, disparity, low, tolerance=1e-4):
    """The disparity is a candidate of least cost wherever there is a candidate, and unknown elsewhere."""
    least = volume.min(axis=-1)
    known = np.isfinite(least)
    np.testing.assert_array_equal(np.isfinite(disparity), known)
    index = np.where(known, disparity - low, 0).astype(int)
    chosen = np.take_along_axis(volume, index[..., None], -1)[..., 0]
    np.testing.assert_allclose(chosen[known], least[known], atol=tolerance)


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
    np.testing.assert_array_equal(
        got, np.where(np.isfinite(volume.min(-1)), volume.argmin(-1) + low, np.inf)
    )


@settings(max_examples=10, deadline=None)
@given(problem=pairs(), side=st.sampled_from([1, 3]))
def test_birchfield_tomasi_equals_plain_loops(problem, side):
    left, right, low = problem[0][:4], problem[1][:4], problem[2]
    volume = naive_pixel_window_volume(left, right, "birchfield_tomasi", side, low, 5)
    assert_minimal(
        volume, whole(left, right, "birchfield_tomasi", low, block_size=side), low
    )


def shiftable(left, right, low):
    volume = naive_volume(left, right, "sad", SIDE, low, 5)
    best = volume.copy()
    for y, x in np.ndindex(left.shape):
        near = volume[
            max(0, y - RADIUS) : y + RADIUS + 1, max(0, x - RADIUS) : x + RADIUS + 1
        ]
        best[y, x] = near.min(axis=(0, 1))
    return best


def arms(image, y, x, contrast=20):
    """How far left, right, up and down the pixel's cross reaches."""
    result = []
    for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0)):
        reach = 0
        while reach < RADIUS:
            v, u = y + dy * (reach + 1), x + dx * (reach + 1)
            if not (0 <= v < image.shape[0] and 0 <= u < image.shape[1]):
                break
            if abs(int(image[v, u]) - int(image[y, x])) > contrast:
                break
            reach += 1
        result.append(reach)
    return result


def cross(left, right, low):
    costs = naive_pixel_costs(left, right, low, 5)
    volume = np.empty_like(costs)
    for y, x in np.ndindex(left.shape):
        _, _, up, down = arms(left, y, x)
        region = []
        for v in range(y - up, y + down + 1):
            before, after, _, _ = arms(left, v, x)
            region += [costs[v, u] for u in range(x - before, x + after + 1)]
        volume[y, x] = np.mean(region, axis=0)
    return volume


def weighted(left, right, low):
    costs, width = naive_pixel_costs(left, right, low, 5), left.shape[1]
    volume = np.empty_like(costs)
    for y, x, i in np.ndindex(costs.shape):
        u = int(np.clip(x - low - i, 0, width - 1))
        top = bottom = 0.0
        for v in range(max(0, y - RADIUS), min(len(left), y + RADIUS + 1)):
            for h in range(max(-RADIUS, -x), min(RADIUS, width - 1 - x) + 1):
                near = np.exp(-2 * np.hypot(v - y, h) / 12.0)
                ours = abs(int(left[y, x]) - int(left[v, x + h]))
                theirs = abs(
                    int(right[y, u]) - int(right[v, np.clip(u + h, 0, width - 1)])
                )
                weight = near * np.exp(-(ours + theirs) / 12.0)
                top, bottom = top + weight * costs[v, x + h, i], bottom + weight
        volume[y, x, i] = top / bottom
    return volume


def box_mean(values):
    out = np.empty_like(values)
    for y, x in np.ndindex(values.shape[:2]):
        near = values[
            max(0, y - RADIUS) : y + RADIUS + 1, max(0, x - RADIUS) : x + RADIUS + 1
        ]
        out[y, x] = near.mean(axis=(0, 1))
    return out


def guided(left, right, low):
    costs, guide = naive_pixel_costs(left, right, low, 5), left[:, :, None] / 255.0
    slope = box_mean(costs * guide) - box_mean(guide) * box_mean(costs)
    slope = slope / (box_mean(guide**2) - box_mean(guide) ** 2 + 1e-4)
    return box_mean(slope) * guide + box_mean(box_mean(costs) - slope * box_mean(guide))


REFERENCES = {
    "shiftable": shiftable,
    "cross": cross,
    "weighted": weighted,
    "guided": guided,
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
def test_every_cost_with_every_support_finds_a_shift_or_is_refused_with_the_reason(
    cost, support
):
    scene = ndimage.gaussian_filter(
        np.random.default_rng(4).normal(128, 200, (20, 60)), 1.0
    )
    scene = np.clip(scene, 0, 255).astype(np.uint8)
    left, right = scene[:, 4:54], scene[:, 7:57]
    if SUPPORTS[support].pixelwise and COSTS[cost].scoring != "sum":
        with pytest.raises(InputError, match="statistics of whole windows"):
            tm.match(left, right, cost, support=support)
        return
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
    ways = [(0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (1, 1), (-1, 1), (1, -1)][
        :paths
    ]
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
    ways = [(0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (1, 1), (-1, 1), (1, -1)][
        :paths
    ]
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
