"""Sums over the square window around every pixel of a row, and the scales that normalise a correlation.

A row at a time: `advance` slides the sums of columns down, `window_row` adds columns up to windows.
"""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import numpy as np

from twinlens.matching.kernels.compiling import jit

NOTHING, TOTALS, DEVIATIONS, NORMS, SHARES = 0, 1, 2, 3, 4


@jit
def advance(mode, new, old, there, state, equal):
    """Slide the columns' sums one row down: `new` enters, and where `there` is set `old` leaves.

    state (3, W): the sums of values and of squares, and the row before. equal: (W,) for how many rows, this one
    included, each column has held its value; (1,) for whole numbers, whose sums tell it.
    """
    kind = state.dtype.type
    sums, squares = state[0], state[1]
    if len(equal) == len(new):
        for x in range(len(new)):
            equal[x] = equal[x] + 1 if equal[x] > 0 and new[x] == state[2, x] else 1
            state[2, x] = kind(new[x])
    if there:
        for x in range(len(new)):
            sums[x] += kind(new[x]) - kind(old[x])
    else:
        for x in range(len(new)):
            sums[x] += kind(new[x])
    if mode in (DEVIATIONS, NORMS):
        if there:
            for x in range(len(new)):
                a, b = kind(new[x]), kind(old[x])
                squares[x] += a * a - b * b
        else:
            for x in range(len(new)):
                a = kind(new[x])
                squares[x] += a * a


@jit
def box_row(columns, side, spare, out):
    """out[x] = columns[x] + ... + columns[x + side - 1]; spare is (2, W), side odd.

    By threes as long as the side is their multiple, then by sums of 1, 2, 4, ... of what that gives. Each pass is
    written where nothing is read, and what lies ahead is a row of its own: LLVM makes no vector code of a row that is
    added to itself, nor of places that might count from a row's end.
    """
    width = len(out)
    sums, into, step, rest = columns, 0, 1, side
    while rest % 3 == 0 and rest > 3:
        thirds, second, third = spare[into], sums[step:], sums[2 * step :]
        for x in range(len(columns) - 3 * step + 1):
            thirds[x] = sums[x] + second[x] + third[x]
        sums, into, step, rest = thirds, 1 - into, 3 * step, rest // 3
    if rest == 3:
        second, third = sums[step:], sums[2 * step :]
        for x in range(width):
            out[x] = sums[x] + second[x] + third[x]
        return
    for x in range(width):
        out[x] = sums[x]
    place, power, left = step, step, rest >> 1
    while left > 0:
        twice, ahead = spare[into], sums[power:]
        for x in range(len(columns) - 2 * power + 1):
            twice[x] = sums[x] + ahead[x]
        sums, into = twice, 1 - into
        power *= 2
        if left & 1:
            ahead = sums[place:]
            for x in range(width):
                out[x] += ahead[x]
            place += power
        left >>= 1


@jit
def inverse_roots(mode, area, totals, squares, scales):
    """scales = 1 / sqrt(n S2 - S^2), or 1 / sqrt(S2); 0 where there is nothing to take the root of.

    The dtype of `area`, (1,), is what the difference is computed in: one that does not round it.
    """
    kind, wide = scales.dtype.type, area.dtype.type
    n = area[0]
    for x in range(len(totals)):
        total, square = wide(totals[x]), wide(squares[x])
        spread = square if mode == NORMS else wide(wide(n * square) - wide(total * total))
        there = spread > 0
        root = np.sqrt(kind(spread if there else n))
        scales[x] = kind(1) / root if there else kind(0)


@jit
def forget_flat(mode, side, row, equal, scales):
    """scales = 0 for windows of one value (for NORMS: of zeros); the windows end in `row`, whose columns are `equal`.

    Sums of floats cannot tell it: they round by more than a faint window varies.
    """
    length = 0
    for x in range(len(row)):
        goes_on = length > 0 and row[x] == row[x - 1]
        length = 0 if equal[x] < side else (length + 1 if goes_on else 1)
        if length >= side and (mode == DEVIATIONS or row[x] == 0):
            scales[x - side + 1] = 0


@jit
def window_row(mode, side, area, row, state, equal, spare, totals, scales):
    """Fill totals and scales, (W - side + 1), of the windows that end in `row`, from the columns' sums.

    spare is (3, W), of the columns' type.
    """
    count = len(totals)
    box_row(state[0], side, spare, totals)
    if mode == SHARES:
        for x in range(count):
            scales[x] = totals[x]
    elif mode in (DEVIATIONS, NORMS):
        squares = spare[2, :count]
        box_row(state[1], side, spare, squares)
        inverse_roots(mode, area, totals, squares, scales)
        if len(equal) == len(row):
            forget_flat(mode, side, row, equal, scales)
