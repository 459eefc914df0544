"""The laws of the measures: bounds, equality, and what each is blind to."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import twinlens.matching as tm
from twinlens.errors import InputError

VALUES = st.integers(0, 255)
PAIRS = hnp.arrays(np.float64, st.tuples(st.just(2), st.integers(1, 5), st.integers(1, 5)), elements=VALUES)
DISTANCES = ("sad", "ssd", "zsad", "zssd")
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
    assert measure(windows[0], windows[1] + offset) == pytest.approx(measure(*windows), abs=1e-6)


@pytest.mark.parametrize("name", BLIND_TO_GAIN)
@given(windows=PAIRS, gain=st.floats(0.1, 10))
def test_blind_to_gain(name, windows, gain):
    measure = getattr(tm, name)
    assert measure(windows[0], windows[1] * gain) == pytest.approx(measure(*windows), abs=1e-9)


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


@pytest.mark.parametrize("name", DISTANCES + SIMILARITIES)
def test_wrong_windows_are_refused(name):
    measure = getattr(tm, name)
    with pytest.raises(InputError, match="one shape"):
        measure([1, 2], [1, 2, 3])
    with pytest.raises(InputError, match="empty"):
        measure([], [])
    with pytest.raises(InputError, match="finite"):
        measure([1, np.nan], [1, 2])
