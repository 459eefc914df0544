"""The warm-up runs once for each method and number of disparities, and not with warm_up=False."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scoring.scoring_methods import pair
from twinlens.scoring import run_benchmark


class Noting:
    """Records rows and range of every call."""

    name = "noting"

    def __init__(self):
        self.calls = []

    def match(self, left, right, *, num_disparities, min_disparity):
        self.calls.append((len(left), num_disparities))
        return np.full(left.shape[:2], 4, np.float32)


@pytest.mark.parametrize(
    ("warm_up", "calls"),
    [
        (True, [(32, 16), (40, 16), (40, 16), (32, 20), (40, 20)]),
        (False, [(40, 16), (40, 16), (40, 20)]),
    ],
)
def test_a_method_is_warmed_up_once_for_each_range(warm_up, calls):
    method = Noting()
    samples = [pair("a"), pair("b"), replace(pair("c"), ndisp=20)]
    run_benchmark(samples, [method], warm_up=warm_up)
    assert method.calls == calls
