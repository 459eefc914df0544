"""Window statistics and census descriptors of images, and ZSAD volumes, which are not sums of a pixel term.

A volume is (rows, W, depth), the candidate's index last. Right images are reversed, as in `slide`.
"""

import numpy as np

from twinlens.matching.kernels.compiling import inlined, jit

TOTALS, DEVIATIONS, NORMS = 0, 1, 2


@inlined
def add_row(row, sums, squares):
    """Add the values of an image row, and their squares, to the sums over columns."""
    for x in range(len(row)):
        value = sums.dtype.type(row[x])
        sums[x] += value
        squares[x] += value * value


@inlined
def subtract_row(row, sums, squares):
    """Undo `add_row`."""
    for x in range(len(row)):
        value = sums.dtype.type(row[x])
        sums[x] -= value
        squares[x] -= value * value


@inlined
def running_sums(values, side, out):
    """out[x] = sum of values[x : x + side]: the next value enters and the first one leaves."""
    total = out.dtype.type(0)
    for x in range(side - 1):
        total += values[x]
    for x in range(len(out)):
        total += values[x + side - 1]
        out[x] = total
        total -= values[x]


@jit
def window_statistics(image, side, mode, totals, scales):
    """Sums and scales of all windows of a padded image (rows + side - 1, columns + side - 1).

    totals (rows, columns): the sum S of the window's n pixels. scales, for DEVIATIONS: 1 / sqrt(n S2 - S^2), with the
    sum S2 of the squares; for NORMS: 1 / sqrt(S2); 0 where the root's argument is not positive. For TOTALS: S.
    Whole numbers are summed without loss in the dtype of `totals`.
    """
    rows, columns = totals.shape
    area = totals.dtype.type(side * side)
    padded = image.shape[1]
    sums, squares = np.zeros(padded, totals.dtype), np.zeros(padded, totals.dtype)
    window_squares = np.zeros(columns, totals.dtype)
    for y in range(1 - side, rows):
        # Sums over the columns of the window: the row that enters is added, the one that leaves subtracted. The first
        # side - 1 rows only fill them.
        add_row(image[y + side - 1], sums, squares)
        if y > 0:
            subtract_row(image[y - 1], sums, squares)
        if y < 0:
            continue
        row = totals[y]
        running_sums(sums, side, row)
        running_sums(squares, side, window_squares)
        for x in range(columns):
            # n S2 - S^2 is n^2 times the variance; as a difference of whole numbers it is exact.
            square = window_squares[x]
            if mode == DEVIATIONS:
                square = area * square - row[x] * row[x]
            spread = np.float64(square)
            scale = 1.0 / np.sqrt(spread) if spread > 0 else 0.0
            scales[y, x] = row[x] if mode == TOTALS else scale


@jit
def zero_flat_scales(image, side, zeros_only, scales):
    """Set scales to 0 for windows of one value (zeros_only: of zeros) of a padded image.

    Sums of floats do not identify these windows: their rounding errors exceed the variance of a faint texture.
    """
    # For how many rows each column has held its value.
    same = np.zeros(image.shape[1], np.int64)
    for y in range(len(image)):
        row, above = image[y], image[max(y - 1, 0)]
        # length: how many columns in a row have held one value, the same, for at least `side` rows.
        length = 0
        for x in range(len(row)):
            same[x] = same[x] + 1 if row[x] == above[x] else 1
            goes_on = length > 0 and row[x] == row[x - 1]
            length = 0 if same[x] < side else (length + 1 if goes_on else 1)
            if length >= side and (row[x] == 0 or not zeros_only):
                scales[y - side + 1, x - side + 1] = 0


@jit
def census_words(padded, side, first, last, words):
    """words (H, W), zeros: the bits first..last of each pixel's window, row by row without its centre.

    Bit i of the census of a pixel p is [I(q_i) < I(p)] for the i-th neighbour q_i in reading order; the Hamming
    distance of two such words is the census cost (Zabih and Woodfill, ECCV 1994). padded (H + side - 1, W + side - 1).
    The first bit ends up highest.
    """
    height, width = words.shape
    one = words.dtype.type(1)
    radius = side // 2
    for y in range(height):
        centre, word = padded[y + radius, radius : radius + width], words[y]
        for bit in range(first, last):
            # The centre is place side^2 // 2 in reading order: from there on, bit i belongs to place i + 1.
            place = bit + (bit >= side * side // 2)
            column = place % side
            neighbour = padded[y + place // side, column : column + width]
            # One bit of all pixels of the row at a time: the loop over x is vectorised.
            for x in range(width):
                word[x] = (word[x] << one) | words.dtype.type(neighbour[x] < centre[x])


@jit
def zero_mean_absolute(
    left, right, left_mean, right_mean, start, mean_start, radius, volume
):
    """volume[y, x, j] = sum |(a - mean a) - (b - mean b)| over the window; images padded, the right ones reversed."""
    rows, width, depth = volume.shape
    side = 2 * radius + 1
    for y in range(rows):
        for x in range(width):
            out = volume[y, x]
            out[:] = 0
            means = right_mean[y, mean_start - x : mean_start - x + depth]
            for i in range(side):
                for k in range(side):
                    a = left[y + i, x + k] - left_mean[y, x]
                    there = right[y + i, start - x - k : start - x - k + depth]
                    for j in range(depth):
                        out[j] += abs(a - (there[j] - means[j]))
