"""The picture of `show costs`: a column for each candidate that is known."""

import re

import numpy as np
import pytest

import twinlens as tl
from twinlens.report.cost_picture import cost_picture

RNG = np.random.default_rng(4)
RIGHT = RNG.integers(0, 256, (40, 60)).astype(np.uint8)
LEFT = np.roll(RIGHT, 5, axis=1)
CURVES = tl.cost_curve(LEFT, RIGHT, 30, 20, methods=["sad", "zncc"], num_disparities=12)


@pytest.mark.parametrize(("truth", "windows"), [(5.0, 4), (np.inf, 3), (np.nan, 3)])
def test_without_truth_there_is_no_window_of_it(truth, windows):
    svg = cost_picture((LEFT, RIGHT), CURVES, truth, "svg").decode()
    assert len(re.findall("<image ", svg)) == windows * len(CURVES)
    assert all(
        curve.disparity == pytest.approx(5, abs=0.5) for curve in CURVES.values()
    )
