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
    result, finite = refine.filled(disparity), np.isfinite(disparity)
    np.testing.assert_array_equal(result[finite], disparity[finite])
    assert np.isfinite(result).all() == finite.any()


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


@pytest.mark.parametrize("method", ["sad", "zncc", "sad:support=adaptive"])
def test_uniqueness_removes_repetitive_texture(method):
    rng = np.random.default_rng(0)
    repeated = np.tile(rng.integers(0, 256, (12, 6), dtype=np.uint8), (1, 8))
    unique = rng.integers(0, 256, (12, 48), dtype=np.uint8)
    options = {"block_size": 3, "num_disparities": 14, "uniqueness": 5}
    inside = np.s_[2:-2, 14:-2]
    assert np.isinf(tm.match(repeated, repeated, method, **options)[inside]).all()
    of_unique = tm.match(unique, unique, method, **options)[inside]
    assert np.isfinite(of_unique).mean() > 0.9


def test_texture_removes_surfaces_without_texture():
    image = np.full((20, 40), 90, np.uint8)
    image[:, :20] = np.random.default_rng(0).integers(0, 256, (20, 20))
    disparity = tm.match(
        image, image, "sad", block_size=5, num_disparities=4, texture=5
    )
    assert np.isfinite(disparity[:, :18]).all()
    assert np.isinf(disparity[:, 24:]).all()


def test_no_refinement_but_filling_makes_a_pixel_known():
    left, right = np.random.default_rng(1).integers(0, 256, (2, 30, 50), dtype=np.uint8)
    plain = tm.StereoMatcher(
        cost="sad", block_size=5, num_disparities=10, min_disparity=3
    )
    unknown = np.isinf(plain.match(left, right))
    options = {"uniqueness": 10, "texture": 4, "lr_check": 1, "speckle_size": 30}
    for name, value in (options | {"median": 3}).items():
        refined = plain.replace(**{name: value})
        assert np.isinf(refined.match(left, right)[unknown]).all(), name
        filling = refined.replace(fill="background")
        assert np.isfinite(filling.match(left, right)).all(), name
