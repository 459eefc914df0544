"""Sums over the windows of a row, for every way in which a side comes apart into threes and twos."""

import numpy as np
import pytest

from twinlens.matching.kernels.windows import box_row


@pytest.mark.parametrize("side", [1, 3, 5, 7, 9, 11, 15, 21, 25, 27, 33, 45, 81])
@pytest.mark.parametrize("more", [0, 1, 40])
@pytest.mark.parametrize("kind", [np.int32, np.int64])
def test_box_sums_are_those_of_each_window(side, more, kind):
    columns = np.random.default_rng(side).integers(0, 9999, side + more).astype(kind)
    spare, out = np.full((3, len(columns)), -1, kind), np.zeros(more + 1, kind)
    box_row(columns, side, spare, out)
    np.testing.assert_array_equal(out, [columns[x : x + side].sum() for x in range(more + 1)])
    assert (spare[2] == -1).all()  # the caller's own
