"""Statistics of the windows of an image, against plain sums."""

import numpy as np
import pytest

from twinlens.matching.kernels.windows import (
    DEVIATIONS,
    NORMS,
    TOTALS,
    window_statistics,
)


@pytest.mark.parametrize("side", [1, 3, 9, 21])
@pytest.mark.parametrize("mode", [TOTALS, DEVIATIONS, NORMS])
@pytest.mark.parametrize(
    ("dtype", "kind"),
    [(np.uint8, np.float64), (np.uint8, np.int32), (np.uint16, np.int64)],
)
def test_statistics_are_those_of_each_window(side, mode, dtype, kind):
    if kind == np.int32 and side == 21:
        return  # its sums do not fit: see costs.numbers
    shape, largest = (side + 4, side + 6), np.iinfo(dtype).max
    image = np.random.default_rng(side).integers(0, largest, shape, dtype)
    totals, scales = np.empty((5, 7), kind), np.empty((5, 7))
    window_statistics(image, side, mode, totals, scales)
    values = image.astype(np.int64)
    windows = np.lib.stride_tricks.sliding_window_view(values, (side, side))
    sums, squares = windows.sum((-1, -2)), (windows**2).sum((-1, -2))
    np.testing.assert_array_equal(totals, sums)
    expected = sums
    if mode != TOTALS:
        norms = squares if mode == NORMS else side**2 * squares - sums**2
        expected = np.where(norms > 0, norms, np.inf) ** -0.5
    np.testing.assert_allclose(scales, expected, rtol=1e-12)
