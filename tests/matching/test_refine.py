"""Refinement steps: which pixels each of them keeps, removes and fills."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

import twinlens.matching as tm
from twinlens.matching import refine

INF = np.inf
MAPS = hnp.arrays(
    np.float32,
    st.tuples(st.integers(1, 7), st.integers(1, 7)),
    elements=st.one_of(st.just(INF), st.integers(0, 4).map(float)),
)


@given(disparity=MAPS)
def test_filling_makes_all_pixels_known_and_keeps_known_ones(disparity):
    result, known = refine.filled(disparity), np.isfinite(disparity)
    np.testing.assert_array_equal(result[known], disparity[known])
    assert np.isfinite(result).all() == known.any()


def test_filling_takes_the_background():
    disparity = np.float32([[INF, 7, INF, INF, 2, INF], [INF] * 6])
    expected = [7, 7, 2, 2, 2, 2]
    np.testing.assert_array_equal(refine.filled(disparity), [expected, expected])


@settings(deadline=None)
@given(disparity=MAPS, size=st.integers(1, 6))
def test_speckles_are_the_small_components_that_scipy_labels(disparity, size):
    expected = np.full(disparity.shape, INF)
    for value in np.unique(disparity[np.isfinite(disparity)]):
        labels, count = ndimage.label(disparity == value)
        for label in range(1, count + 1):
            if (labels == label).sum() >= size:
                expected[labels == label] = value
    np.testing.assert_array_equal(
        refine.without_speckles(disparity, size, 0.5), expected
    )


@given(disparity=MAPS)
def test_median_is_that_of_known_neighbours_and_keeps_density(disparity):
    result = refine.median(disparity, 3)
    np.testing.assert_array_equal(np.isfinite(result), np.isfinite(disparity))
    for y, x in np.argwhere(np.isfinite(disparity)):
        near = disparity[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2]
        near = np.sort(near[np.isfinite(near)])
        assert result[y, x] == near[(len(near) - 1) // 2]


def test_uniqueness_removes_repetitive_texture():
    rng = np.random.default_rng(0)
    tile = rng.integers(0, 256, (12, 6), dtype=np.uint8)
    repeated = np.tile(tile, (1, 8))
    free = rng.integers(0, 256, (12, 48), dtype=np.uint8)
    for method in (
        "sad:block_size=3",
        "zncc:block_size=3",
        "sad:block_size=3,support=adaptive",
    ):
        matcher = tm.parse_method(method).matcher(num_disparities=14, uniqueness=5)
        again = matcher.match(repeated, repeated)
        assert np.isinf(again[2:-2, 14:-2]).all(), method
        assert np.isfinite(matcher.match(free, free)[2:-2, 14:-2]).mean() > 0.9, method


def test_texture_removes_surfaces_without_texture():
    image = np.full((20, 40), 90, np.uint8)
    image[:, :20] = np.random.default_rng(0).integers(0, 256, (20, 20))
    got = np.isfinite(
        tm.match(image, image, "sad", block_size=5, num_disparities=4, texture=5)
    )
    assert got[:, :18].all()
    assert not got[:, 24:].any()


@pytest.mark.parametrize(
    "option",
    [
        {"uniqueness": 10},
        {"texture": 4},
        {"lr_check": 1},
        {"speckle_size": 30},
        {"median": 3},
    ],
)
def test_no_refinement_but_filling_makes_a_pixel_known(option):
    left, right = np.random.default_rng(1).integers(0, 256, (2, 30, 50), dtype=np.uint8)
    plain = tm.StereoMatcher(
        cost="sad", block_size=5, num_disparities=10, min_disparity=3
    )
    unknown = np.isinf(plain.match(left, right))
    refined = plain.replace(**option).match(left, right)
    assert np.isinf(refined[unknown]).all()
    assert np.isfinite(
        plain.replace(**option, fill="background").match(left, right)
    ).all()
