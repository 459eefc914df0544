"""Cost curves: equal to the costs of two windows, and minimised by the matchers' own disparities."""

import numpy as np
import pytest

import twinlens as tl
from tests.matching.matching_reference import naive_volume
from twinlens.matching import METHODS, StereoMatcher
from twinlens.matching.costs import COSTS

OWN = [name for name, method in METHODS.items() if method.matcher is StereoMatcher]


def shifted_pair(dtype=np.uint8, shape=(20, 44)):
    """A random pair with disparities 3 and 7, and noise."""
    rng = np.random.default_rng(5)
    right = rng.integers(10, 240, shape)
    left = np.roll(right, 7, axis=1)
    left[:10] = np.roll(right[:10], 3, axis=1)
    left = np.clip(left + rng.integers(-6, 7, shape), 0, 255)
    scale = {np.uint8: 1, np.uint16: 257, np.float32: 1 / 255}[dtype]
    return (left * scale).astype(dtype), (right * scale).astype(dtype)


def curve_of(images, u, v, method, **options):
    (curve,) = tl.cost_curve(*images, u, v, method, **options).values()
    return curve


@pytest.mark.parametrize("name", COSTS)
def test_a_curve_is_the_cost_of_the_windows_of_its_candidates(name):
    images = shifted_pair(shape=(9, 24))
    volume = naive_volume(*images, name, 5, -2, 12, 3)
    if name == "zssd":
        volume /= 25  # the kernel's is n times the measure
    method = f"{name}:block_size=5,census_window=3"
    for u, v in ((12, 4), (0, 0), (23, 8), (5, 3)):
        curve = curve_of(images, u, v, method, num_disparities=12, min_disparity=-2)
        np.testing.assert_allclose(curve.costs, volume[v, u], rtol=1e-6, atol=1e-6)
        assert list(curve.disparities) == list(range(-2, 10))


KINDS = [(name, np.uint8) for name in OWN] + [
    ("sad", np.uint16),
    ("zncc", np.float32),
    *(
        pytest.param(name, dtype, marks=pytest.mark.slow)
        for name, dtype in (
            ("sad", np.float32),
            ("zncc", np.uint16),
            ("sgm", np.uint16),
            ("sgm", np.float32),
        )
    ),
]
"""Methods, and dtypes of images: each compiles kernels of its own."""


@pytest.mark.parametrize(("name", "dtype"), KINDS)
def test_the_curves_winner_is_that_of_the_map(name, dtype):
    search = {"num_disparities": 12, "min_disparity": -1}
    unrefined = f"{name}:lr_check=none,speckle_size=0"
    images = shifted_pair(dtype)
    disparity = tl.match(*images, unrefined, **search)
    for u, v in ((20, 9), (0, 0), (43, 19), (2, 10), (30, 11)):
        curve = curve_of(images, u, v, name, **search)
        assert curve.disparity == disparity[v, u]
        lowest = pytest.approx(curve.costs.min(), rel=1e-9, abs=1e-9)
        assert curve.cost_at(curve.winner) == lowest


def test_float_ties_go_to_the_smallest_disparity_as_in_the_map():
    """A periodic texture repeats after 4 px; rounding must not choose between the equal costs."""
    row = np.tile(np.float32([0.1, 0.7, 0.3, 0.9]), 10)
    image = np.tile(row, (9, 1))
    curve = curve_of((image, image), 30, 4, "sad:block_size=5", num_disparities=12)
    assert (curve.winner, curve.rival) == (0, 4)


@pytest.mark.parametrize("method", ["zssd", "sgm", "adaptive", "sad"])
def test_a_volume_holds_the_curves(method):
    images = shifted_pair()
    search = {"num_disparities": 60, "min_disparity": -8}
    matcher = tl.matching.parse_method(method).matcher(**search)
    volume = matcher.cost_volume(*images)
    assert (volume.shape, volume.dtype) == ((20, 44, 60), np.float32)
    for u, v in ((20, 9), (0, 19)):
        curve = curve_of(images, u, v, matcher)
        np.testing.assert_allclose(volume[v, u], curve.costs, rtol=1e-6, atol=1e-6)


def test_the_rival_is_the_second_minimum():
    costs = np.array([4.0, 1.0, 2.0, np.inf])
    curve = tl.matching.CostCurve(
        0, 0, StereoMatcher(), np.arange(4), costs, 1, None, 1.1
    )
    assert [curve.cost_at(d) for d in (1.4, 7.0, np.inf)] == [1.0, np.inf, np.inf]
    curve = curve_of(shifted_pair(), 30, 15, "sad", num_disparities=12)
    beside = np.pad(curve.costs, 1, constant_values=np.inf)
    minimum = (curve.costs <= beside[:-2]) & (curve.costs <= beside[2:])
    apart = np.abs(curve.disparities - curve.winner) >= 2
    assert curve.winner == 7
    assert curve.rival == np.where(minimum & apart, curve.costs, np.inf).argmin()


def test_without_candidates_there_is_no_winner():
    search = {"num_disparities": 4, "min_disparity": 10}
    curve = curve_of(shifted_pair(), 3, 5, "sad", **search)
    assert (curve.winner, curve.rival, curve.disparity) == (None, None, np.inf)
    assert np.isinf(curve.costs).all()


def test_objects_of_one_cost_have_given_names():
    small = StereoMatcher("sad", 3, num_disparities=6)
    large = StereoMatcher("sad", 7)
    matchers = {"small": small, "large": large}
    curves = tl.cost_curve(*shifted_pair(), 20, 9, matchers)
    assert list(curves) == ["small", "large"]
    assert [len(curve.costs) for curve in curves.values()] == [6, 64]
    assert [curve.matcher for curve in curves.values()] == [small, large]


@pytest.mark.parametrize(
    ("pixel", "methods", "message"),
    [
        ((44, 0), "sad", "u must be a whole number from 0 to 43"),
        ((0, -1), "sad", "v must be a whole number from 0 to 19"),
        ((1, 1), "opencv_bm", "opencv_bm has no cost curve"),
        ((1, 1), {"mine": len}, "mine has no cost curve"),
        ((1, 1), [], "no method is named"),
        ((1, 1), ["sad", StereoMatcher(cost="sad")], "two methods are named 'sad'"),
        ((1, 1), [StereoMatcher(), StereoMatcher()], "objects by name"),
    ],
)
def test_wrong_input_is_refused(pixel, methods, message):
    with pytest.raises(tl.TwinlensError, match=message):
        tl.cost_curve(*shifted_pair(), *pixel, methods)
