"""A search that is too short for a pair without truth is named, by matched images whose shift is known."""

import numpy as np
import pytest

from twinlens.scoring import Pair, run_benchmark
from twinlens.scoring.benchmark import MapWarning
from twinlens.scoring.doubts import doubt_of_search


def pair(shift, ndisp, low=0):
    """Textured images whose disparity is `shift` everywhere, without truth."""
    right = np.random.default_rng(0).integers(0, 256, (40, 120), np.uint8)
    left = np.roll(right, shift, axis=1)
    return Pair("p", left, right, None, None, ndisp, min_disparity=low)


def warned(sample):
    with pytest.warns(MapWarning) as record:
        run_benchmark([sample], ["sad"])
    return str(record[0].message)


@pytest.mark.parametrize("shift", [10, 15, 20])
def test_surfaces_beyond_or_at_the_end_are_named(shift):
    text = warned(pair(shift, 11))
    assert "the last disparity of the search, 10 px" in text
    assert "--num-disparities" in text


def test_surfaces_before_the_first_disparity_are_named():
    text = warned(pair(-8, 11, low=-5))
    assert "--min-disparity" in text or "--num-disparities" in text


def test_a_sufficient_search_raises_no_doubt():
    run_benchmark([pair(6, 16)], ["sad"])


def test_far_things_at_zero_raise_no_doubt():
    assert not doubt_of_search(np.zeros((4, 4), np.float32), 0, 15)


def test_unknown_maps_raise_no_doubt():
    assert not doubt_of_search(np.full((4, 4), np.inf, np.float32), 0, 15)
