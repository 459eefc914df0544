"""Cost curves: equal to the measures of two windows, and minimised by the matchers' own disparities."""

import numpy as np
import pytest

import twinlens as tl
from tests.matching.matching_reference import (
    naive_descriptors,
    naive_paths,
    naive_pixel_window_volume,
)
from twinlens.matching import METHODS, StereoMatcher, measures

OWN = [name for name, method in METHODS.items() if method.matcher is StereoMatcher]
MEASURES = ("sad", "ssd", "ncc", "zsad", "zssd", "zncc", "jaccard")


def shifted_pair(dtype=np.uint8, shape=(20, 44)):
    """A random pair with disparities 3 and 7, and noise."""
    rng = np.random.default_rng(5)
    right = rng.integers(10, 240, shape)
    left = np.where(
        np.arange(shape[0])[:, None] < 10,
        np.roll(right, 3, axis=1),
        np.roll(right, 7, axis=1),
    )
    left = np.clip(left + rng.integers(-6, 7, shape), 0, 255)
    if dtype == np.float32:
        return (left / 255).astype(dtype), (right / 255).astype(dtype)
    scale = 257 if dtype == np.uint16 else 1
    return (left * scale).astype(dtype), (right * scale).astype(dtype)


@pytest.mark.parametrize("name", MEASURES)
@pytest.mark.parametrize("place", [(20, 9), (0, 0), (43, 19), (5, 3)])
def test_a_curve_is_the_measure_of_two_windows(name, place):
    left, right = shifted_pair()
    u, v = place
    method = f"{name}:block_size=5"
    curve = tl.cost_curve(
        left, right, u, v, method, num_disparities=12, min_disparity=-2
    )[method]
    a, b = (np.pad(image, 2, mode="edge") for image in (left, right))
    measure = getattr(measures, name)
    for d, cost in zip(curve.disparities, curve.costs, strict=True):
        if not 0 <= u - d < 44:
            assert cost == np.inf
            continue
        value = measure(a[v : v + 5, u : u + 5], b[v : v + 5, u - d : u - d + 5])
        expected = 1 - value if name in ("ncc", "zncc", "jaccard") else value
        assert cost == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert list(curve.disparities) == list(range(-2, 10))


@pytest.mark.parametrize("name", ["census", "rank", "birchfield_tomasi"])
def test_a_curve_of_descriptors_is_the_sum_of_pixel_differences(name):
    left, right = shifted_pair(shape=(9, 24))
    method = f"{name}:block_size=3,census_window=3"
    volume = naive_pixel_window_volume(left, right, name, 3, 0, 9)
    for u, v in ((0, 0), (12, 4), (23, 8)):
        curve = tl.cost_curve(left, right, u, v, method, num_disparities=9)[method]
        np.testing.assert_allclose(curve.costs, volume[v, u], rtol=1e-12)


@pytest.mark.parametrize("name", OWN)
def test_the_curves_winner_is_that_of_the_map(name):
    left, right = shifted_pair()
    unrefined = f"{name}:lr_check=none,speckle_size=0"
    disparity = tl.match(left, right, unrefined, num_disparities=12, min_disparity=-1)
    for u, v in ((20, 9), (0, 0), (43, 19), (2, 10), (30, 11)):
        curve = tl.cost_curve(
            left, right, u, v, [name], num_disparities=12, min_disparity=-1
        )[name]
        assert curve.disparity == disparity[v, u]
        assert curve.cost_at(curve.winner) == pytest.approx(
            curve.costs.min(), rel=1e-9, abs=1e-9
        )


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
@pytest.mark.parametrize("name", ["sad", "zncc", "sgm"])
def test_other_dtypes_have_the_maps_winner(name, dtype):
    left, right = shifted_pair(dtype)
    disparity = tl.match(left, right, name, num_disparities=12)
    for u, v in ((20, 9), (43, 19), (2, 10)):
        assert (
            tl.cost_curve(left, right, u, v, name, num_disparities=12)[name].disparity
            == disparity[v, u]
        )


def test_float_ties_go_to_the_smallest_disparity_as_in_the_map():
    """A periodic texture repeats after 4 px; rounding must not choose between the equal costs."""
    row = np.tile(np.float32([0.1, 0.7, 0.3, 0.9]), 10)
    image = np.tile(row, (9, 1))
    curve = tl.cost_curve(image, image, 30, 4, "sad:block_size=5", num_disparities=12)[
        "sad:block_size=5"
    ]
    assert (curve.winner, curve.rival) == (0, 4)


def test_a_semi_global_curve_is_the_mean_over_its_paths():
    left, right = shifted_pair(shape=(8, 16))
    method = "sgm4:census_window=3"
    a, b = (naive_descriptors(image, 3, "census") for image in (left, right))
    pixel_costs = np.full((8, 16, 5), 8)  # the largest cost, where there is no partner
    for d in range(5):
        pixel_costs[:, d:, d] = np.abs(a[:, d:] - b[:, : 16 - d]).sum(axis=2)
    penalties = round(0.2 * 8), round(0.9 * 8)
    paths = naive_paths(pixel_costs, [(0, -1), (-1, 0), (0, 1), (1, 0)], *penalties)
    for u, v in ((12, 4), (15, 7), (2, 0)):
        curve = tl.cost_curve(left, right, u, v, method, num_disparities=5)[method]
        known = np.isfinite(curve.costs)
        np.testing.assert_allclose(curve.costs[known], paths[v, u][known] / 4)
        assert known.sum() == min(u + 1, 5)


@pytest.mark.parametrize("method", ["zssd", "sgm", "adaptive", "sad"])
def test_a_volume_holds_the_curves(method):
    left, right = shifted_pair()
    matcher = tl.matching.parse_method(method).matcher(
        num_disparities=60, min_disparity=-8
    )
    volume = matcher.cost_volume(left, right)
    assert (volume.shape, volume.dtype) == ((20, 44, 60), np.float32)
    for u, v in ((20, 9), (0, 19)):
        (curve,) = tl.cost_curve(left, right, u, v, matcher).values()
        np.testing.assert_allclose(volume[v, u], curve.costs, rtol=1e-6, atol=1e-6)


def test_the_rival_is_the_second_minimum():
    curve = tl.matching.CostCurve(
        0,
        0,
        StereoMatcher(),
        np.arange(4),
        np.array([4.0, 1.0, 2.0, np.inf]),
        1,
        None,
        1.1,
    )
    assert curve.cost_at(1.4) == 1.0
    assert (curve.cost_at(7.0), curve.cost_at(np.inf)) == (np.inf, np.inf)
    left, right = shifted_pair()
    found = tl.cost_curve(left, right, 30, 15, "sad", num_disparities=12)["sad"]
    minima = [
        d
        for d in range(1, 11)
        if found.costs[d] <= min(found.costs[d - 1], found.costs[d + 1])
    ]
    ends = [d for d, near in ((0, 1), (11, 10)) if found.costs[d] <= found.costs[near]]
    assert found.rival == min(
        (d for d in minima + ends if abs(d - found.winner) >= 2),
        key=lambda d: found.costs[d],
    )
    assert found.winner == 7


def test_without_candidates_there_is_no_winner():
    left, right = shifted_pair()
    curve = tl.cost_curve(
        left, right, 3, 5, "sad", num_disparities=4, min_disparity=10
    )["sad"]
    assert (curve.winner, curve.rival, curve.disparity) == (None, None, np.inf)
    assert np.isinf(curve.costs).all()


def test_objects_of_one_cost_have_given_names():
    matchers = {
        "small": StereoMatcher("sad", 3, num_disparities=6),
        "large": StereoMatcher("sad", 7),
    }
    curves = tl.cost_curve(*shifted_pair(), 20, 9, matchers)
    assert [(name, len(curve.costs), curve.matcher) for name, curve in curves.items()] == [
        ("small", 6, matchers["small"]), ("large", 64, matchers["large"]),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("pixel", "methods", "message"),
    [
        ((44, 0), "sad", "u must be a whole number from 0 to 43"),
        ((0, -1), "sad", "v must be a whole number from 0 to 19"),
        ((1.5, 0), "sad", "u must be"),
        ((1, 1), "opencv_bm", "opencv_bm has no cost curve"),
        ((1, 1), [len], "has no cost curve"),
        ((1, 1), [], "no method is named"),
        ((1, 1), "sda", "did you mean 'sad'"),
        ((1, 1), ["sad", StereoMatcher(cost="sad")], "two methods are named 'sad'"),
        ((1, 1), [StereoMatcher(), StereoMatcher()], "objects by name"),
        ((1, 1), {"mine": len}, "mine has no cost curve"),
        ((1, 1), "sad:block_size=99", "block_size is 99"),
    ],
)
def test_wrong_input_is_refused(pixel, methods, message):
    with pytest.raises(tl.TwinlensError, match=message):
        tl.cost_curve(*shifted_pair(), *pixel, methods)
