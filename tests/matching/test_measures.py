"""The laws of the measures: bounds, equality, and what each is blind to."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

import twinlens as tl
import twinlens.matching as tm
from tests.matching.matching_reference import naive_descriptors, pixel_difference
from twinlens.errors import InputError

VALUES = st.integers(0, 255)
PAIRS = hnp.arrays(
    np.float64,
    st.tuples(st.just(2), st.integers(1, 5), st.integers(1, 5)),
    elements=VALUES,
)
ODD = st.sampled_from([1, 3, 5])
CENTRED_PAIRS = hnp.arrays(
    np.float64, st.tuples(st.just(2), ODD, ODD), elements=st.integers(0, 9)
)
SQUARE_PAIRS = hnp.arrays(
    np.float64, ODD.map(lambda side: (2, side, side)), elements=st.integers(0, 9)
)
DISTANCES = ("sad", "ssd", "zsad", "zssd", "birchfield_tomasi")
ORDINAL = ("census", "rank")
SIMILARITIES = ("ncc", "zncc", "jaccard")
BLIND_TO_OFFSET = ("zsad", "zssd", "zncc")
BLIND_TO_GAIN = ("ncc", "zncc")


@pytest.mark.parametrize("name", DISTANCES + SIMILARITIES)
@given(windows=PAIRS)
def test_symmetric_and_bounded(name, windows):
    measure = getattr(tm, name)
    value = measure(*windows)
    assert value == pytest.approx(measure(*windows[::-1]), abs=1e-9)
    assert value >= (-1 - 1e-9 if name == "zncc" else 0)
    if name in SIMILARITIES:
        assert value <= 1 + 1e-9


@pytest.mark.parametrize("name", DISTANCES)
@given(windows=PAIRS)
def test_equal_windows_have_no_distance(name, windows):
    assert getattr(tm, name)(windows[0], windows[0]) == 0


@pytest.mark.parametrize("name", SIMILARITIES)
@given(windows=PAIRS)
def test_equal_windows_with_structure_are_wholly_similar(name, windows):
    window = windows[0]
    structured = window.any() if name != "zncc" else np.ptp(window) > 0
    if structured or name == "jaccard":
        assert getattr(tm, name)(window, window) == pytest.approx(1)
    else:
        assert getattr(tm, name)(window, window) == 0


@pytest.mark.parametrize("name", BLIND_TO_OFFSET)
@given(windows=PAIRS, offset=st.integers(-50, 50))
def test_blind_to_offset(name, windows, offset):
    measure = getattr(tm, name)
    assert measure(windows[0], windows[1] + offset) == pytest.approx(
        measure(*windows), abs=1e-6
    )


@pytest.mark.parametrize("name", BLIND_TO_GAIN)
@given(windows=PAIRS, gain=st.floats(0.1, 10))
def test_blind_to_gain(name, windows, gain):
    measure = getattr(tm, name)
    assert measure(windows[0], windows[1] * gain) == pytest.approx(
        measure(*windows), abs=1e-9
    )


@given(windows=PAIRS)
def test_zncc_is_pearsons_correlation(windows):
    a, b = windows.reshape(2, -1)
    if np.ptp(a) > 0 and np.ptp(b) > 0:
        assert tm.zncc(a, b) == pytest.approx(np.corrcoef(a, b)[0, 1], abs=1e-9)


@given(windows=PAIRS)
def test_jaccard_follows_from_sad_and_sums(windows):
    total, gap = windows.sum(), tm.sad(*windows)
    if total + gap > 0:
        assert tm.jaccard(*windows) == pytest.approx((total - gap) / (total + gap))


@given(windows=SQUARE_PAIRS)
def test_census_and_rank_equal_plain_loops(windows):
    side = windows.shape[1]
    for name in ORDINAL:
        a, b = (
            naive_descriptors(window, side, name)[side // 2, side // 2]
            for window in windows
        )
        assert getattr(tm, name)(*windows) == np.abs(a - b).sum()


@pytest.mark.parametrize("name", ORDINAL)
@given(windows=CENTRED_PAIRS)
def test_order_knows_no_exposure(name, windows):
    a, b = windows
    value = getattr(tm, name)(a, b)
    assert 0 <= value <= a.size - 1
    assert getattr(tm, name)(b, a) == value
    assert getattr(tm, name)(a, a) == 0
    assert getattr(tm, name)(np.exp(a), 3 * b**3 - 7) == value


@given(windows=CENTRED_PAIRS)
def test_rank_is_the_coarser_of_the_two(windows):
    assert tm.rank(*windows) <= tm.census(*windows)


def test_census_of_an_inverted_window_is_as_far_as_can_be():
    window = np.random.default_rng(0).permutation(35).reshape(5, 7)
    assert tm.census(window, -window) == 34


@given(windows=PAIRS)
def test_birchfield_tomasi_equals_plain_loops(windows):
    difference = pixel_difference("birchfield_tomasi", *windows, 1)
    total = sum(difference(y, x, x) for y, x in np.ndindex(windows.shape[1:]))
    assert tm.birchfield_tomasi(*windows) == pytest.approx(total)
    assert tm.birchfield_tomasi(*windows) <= tm.sad(*windows)


@pytest.mark.parametrize(
    ("shift", "each"), [(-0.5, 0.0), (0.25, 0.0), (0.5, 0.0), (0.8, 3.0), (-1.5, 10.0)]
)
def test_birchfield_tomasi_forgives_a_ramp_half_a_pixel(shift, each):
    ramp = 10.0 * np.arange(7)
    assert tm.birchfield_tomasi(ramp, ramp + 10 * shift) == pytest.approx(7 * each)


@pytest.mark.parametrize("name", ORDINAL)
@pytest.mark.parametrize("shape", [(3,), (2, 3), (3, 4), (3, 3, 3)])
def test_a_window_without_a_centre_has_no_order(name, shape):
    with pytest.raises(InputError, match="odd in height and width"):
        getattr(tm, name)(np.ones(shape), np.ones(shape))


def test_a_single_number_has_no_row():
    with pytest.raises(InputError, match="rows of pixels"):
        tm.birchfield_tomasi(3, 4)


@pytest.mark.parametrize("name", DISTANCES + SIMILARITIES + ORDINAL)
def test_every_measure_is_a_public_name(name):
    assert getattr(tl, name) is getattr(tm, name)


@pytest.mark.parametrize("name", DISTANCES + SIMILARITIES + ORDINAL)
def test_wrong_windows_are_refused(name):
    measure = getattr(tm, name)
    with pytest.raises(InputError, match="one shape"):
        measure([1, 2], [1, 2, 3])
    with pytest.raises(InputError, match="empty"):
        measure([], [])
    with pytest.raises(InputError, match="finite"):
        measure([1, np.nan], [1, 2])
