"""KITTI's background interpolation: how its stereo benchmark fills the pixels that a method left out.

The rule, as the development kit of the KITTI 2015 stereo/flow benchmark states it (Geiger, `io_disp.h`,
`interpolateBackground`): inside a row a gap takes the smaller of the two disparities beside it (the one farther away),
the ends of a row repeat its first and last estimate; then, in every column, the top and bottom ends repeat its first
and last one. A row with no estimate at all, between rows that have some, stays unknown.
"""

import numpy as np
from numpy.typing import NDArray

from twinlens.scoring.checks import Disparity, disparity_map


def interpolate_background(disp: Disparity) -> Disparity:
    """`disp` (H, W) in pixels, +inf where unknown, with its gaps filled by KITTI's rule; the dtype is kept.

    Raises
    ------
    InputError
        `disp` is no disparity map (see `checks.disparity_map`).

    >>> row = np.array([[np.inf, 5, np.inf, 3, np.inf]], np.float32)
    >>> interpolate_background(row).tolist()
    [[5.0, 5.0, 3.0, 3.0, 3.0]]
    """
    disp = disparity_map("disp", disp)
    in_rows = np.minimum(_carried(disp), _carried(disp[:, ::-1])[:, ::-1])
    # At a row's ends only one of the two neighbours exists, and the other is +inf: the minimum is the one that exists.
    return _extend_ends(in_rows.T).T


def _carried(disp: Disparity) -> Disparity:
    """Each unknown takes the last known value to its left; +inf where there is none."""
    last = np.maximum.accumulate(np.where(np.isfinite(disp), np.arange(disp.shape[1]), -1), axis=1)
    carried = np.take_along_axis(disp, np.maximum(last, 0), axis=1)
    return np.where(last < 0, np.asarray(np.inf, disp.dtype), carried)


def _extend_ends(rows: Disparity) -> Disparity:
    """Each row's ends repeat its first and last known value; its inner gaps stay."""
    known: NDArray[np.bool_] = np.isfinite(rows)
    before_first = np.maximum.accumulate(known, axis=1) == 0
    after_last = np.maximum.accumulate(known[:, ::-1], axis=1)[:, ::-1] == 0
    filled = np.where(before_first, _carried(rows[:, ::-1])[:, ::-1], rows)
    return np.where(after_last, _carried(rows), filled)
