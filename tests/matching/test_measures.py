"""The laws of the measures: bounds, equality, and what each is blind to."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

import twinlens as tl
import twinlens.matching as tm
from tests.matching.matching_reference import (
    WINDOW_COSTS,
    features,
    naive_descriptors,
)
from twinlens.errors import InputError

ODD = st.sampled_from([1, 3, 5])
PAIRS = hnp.arrays(
    np.float64,
    st.tuples(st.just(2), st.integers(1, 5), st.integers(1, 5)),
    elements=st.integers(0, 255),
)
CENTRED_PAIRS = hnp.arrays(
    np.float64, st.tuples(st.just(2), ODD, ODD), elements=st.integers(0, 9)
)
SQUARE_PAIRS = hnp.arrays(
    np.float64, ODD.map(lambda side: (2, side, side)), elements=st.integers(0, 9)
)
DISTANCES = ("sad", "ssd", "zsad", "zssd", "birchfield_tomasi")
ORDINAL = ("census", "rank")
SIMILARITIES = ("ncc", "zncc", "jaccard")
ALL = DISTANCES + SIMILARITIES + ORDINAL


@pytest.mark.parametrize("name", DISTANCES + SIMILARITIES)
@given(windows=PAIRS)
def test_symmetric_bounded_and_extreme_for_equal_windows(name, windows):
    measure = getattr(tm, name)
    value = measure(*windows)
    assert value == pytest.approx(measure(*windows[::-1]), abs=1e-9)
    assert value >= (-1 - 1e-9 if name == "zncc" else 0)
    window = windows[0]
    same = measure(window, window)
    if name in DISTANCES:
        assert same == 0
        return
    assert value <= 1 + 1e-9
    # The similarity of windows without structure, whose norm is zero, is defined as 0.
    structure = {"ncc": window.any(), "zncc": np.ptp(window) > 0, "jaccard": True}
    assert same == (pytest.approx(1) if structure[name] else 0)


@pytest.mark.parametrize("name", ["zsad", "zssd", "zncc"])
@given(windows=PAIRS, offset=st.integers(-50, 50))
def test_blind_to_offset(name, windows, offset):
    measure, (a, b) = getattr(tm, name), windows
    assert measure(a, b + offset) == pytest.approx(measure(a, b), abs=1e-6)


@pytest.mark.parametrize("name", ["ncc", "zncc"])
@given(windows=PAIRS, gain=st.floats(0.1, 10))
def test_blind_to_gain(name, windows, gain):
    measure, (a, b) = getattr(tm, name), windows
    assert measure(a, b * gain) == pytest.approx(measure(a, b), abs=1e-9)


@given(windows=PAIRS)
def test_zncc_is_pearsons_correlation(windows):
    a, b = windows.reshape(2, -1)
    if np.ptp(a) > 0 and np.ptp(b) > 0:
        assert tm.zncc(a, b) == pytest.approx(np.corrcoef(a, b)[0, 1], abs=1e-9)


@pytest.mark.parametrize("name", DISTANCES + SIMILARITIES)
@given(windows=PAIRS)
def test_measures_equal_plain_formulas(name, windows):
    cost = WINDOW_COSTS[name](*(features(name, window) for window in windows))
    if name in SIMILARITIES:
        cost = 1 - cost
    if name == "zssd":
        cost /= windows[0].size  # that of the kernels is n times the measure
    assert getattr(tm, name)(*windows) == pytest.approx(cost, abs=1e-9)
    assert tm.birchfield_tomasi(*windows) <= tm.sad(*windows)


@pytest.mark.parametrize("name", ORDINAL)
@given(windows=SQUARE_PAIRS)
def test_census_and_rank_equal_plain_loops(name, windows):
    side = windows.shape[1]
    centre = side // 2, side // 2
    a, b = (naive_descriptors(window, side, name)[centre] for window in windows)
    assert getattr(tm, name)(*windows) == np.abs(a - b).sum()


@pytest.mark.parametrize("name", ORDINAL)
@given(windows=CENTRED_PAIRS)
def test_order_knows_no_exposure(name, windows):
    measure, (a, b) = getattr(tm, name), windows
    value = measure(a, b)
    assert 0 <= value <= a.size - 1
    assert measure(b, a) == value
    assert measure(a, a) == 0
    assert measure(np.exp(a), 3 * b**3 - 7) == value
    assert tm.rank(a, b) <= tm.census(a, b)


def test_census_of_an_inverted_window_is_as_far_as_can_be():
    window = np.random.default_rng(0).permutation(35).reshape(5, 7)
    assert tm.census(window, -window) == 34


@pytest.mark.parametrize(
    ("shift", "distance"),
    [(-0.5, 0.0), (0.25, 0.0), (0.5, 0.0), (0.8, 3.0), (-1.5, 10.0)],
)
def test_birchfield_tomasi_forgives_a_ramp_half_a_pixel(shift, distance):
    ramp = 10.0 * np.arange(7)
    value = tm.birchfield_tomasi(ramp, ramp + 10 * shift)
    assert value == pytest.approx(7 * distance)


@pytest.mark.parametrize("name", ORDINAL)
@pytest.mark.parametrize("shape", [(3,), (2, 3), (3, 4), (3, 3, 3)])
def test_a_window_without_a_centre_has_no_order(name, shape):
    with pytest.raises(InputError, match="odd in height and width"):
        getattr(tm, name)(np.ones(shape), np.ones(shape))


def test_a_single_number_has_no_row():
    with pytest.raises(InputError, match="rows of pixels"):
        tm.birchfield_tomasi(3, 4)


@pytest.mark.parametrize("name", ALL)
def test_every_measure_is_public_and_refuses_wrong_windows(name):
    measure = getattr(tm, name)
    assert getattr(tl, name) is measure
    for windows, message in (
        (([1, 2], [1, 2, 3]), "one shape"),
        (([], []), "empty"),
        (([1, np.nan], [1, 2]), "finite"),
    ):
        with pytest.raises(InputError, match=message):
            measure(*windows)
