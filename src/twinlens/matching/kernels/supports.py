"""Gather costs over support regions: one kernel for each shape and weighting.

Volumes are (rows, W, depth), the candidate's index last; outputs are the rows [top, top + len(out)) of the input.
Regions end at the image's edges.
"""

import numpy as np

from twinlens.matching.kernels.compiling import jit


@jit
def best_quarters(volume, step, top, sizes, size, scale, out):
    """out = the sub-window's cost at the pixel plus the two lowest of its four diagonal neighbours at `step` pixels.

    Multiplied by scale, and only at pixels where sizes, (len(out), W) or more, is `size`.
    """
    rows, width, depth = volume.shape
    for y in range(len(out)):
        up, down = max(y + top - step, 0), min(y + top + step, rows - 1)
        for x in range(width):
            if sizes[y, x] != size:
                continue
            first, last = max(x - step, 0), min(x + step, width - 1)
            a, b = volume[up, first], volume[up, last]
            c, d = volume[down, first], volume[down, last]
            centre, here = volume[y + top, x], out[y, x]
            for j in range(depth):
                low, high = min(a[j], b[j]), max(a[j], b[j])
                low2, high2 = min(c[j], d[j]), max(c[j], d[j])
                # The lowest two of four: the least of all, and the least of the three others.
                here[j] = scale * (
                    centre[j] + min(low, low2) + min(max(low, low2), min(high, high2))
                )


@jit
def cross_arms(image, contrast, length, arms):
    """arms (4, H, W), zeros: pixels left, right, above and below within `contrast` of the pixel, at most `length`."""
    height, width = image.shape
    for y in range(height):
        for side, (dy, dx) in enumerate(((0, -1), (0, 1), (-1, 0), (1, 0))):
            for step in range(1, length + 1):
                v, shift = y + dy * step, dx * step
                if not 0 <= v < height:
                    break
                first, last = max(0, -shift), min(width, width - shift)
                here = image[y, first:last]
                there = image[v, first + shift : last + shift]
                reach = arms[side, y, first:last]
                # An arm grows by a step only if it has reached all pixels before.
                for x in range(last - first):
                    similar = abs(here[x] - there[x]) <= contrast
                    reach[x] = step if similar and reach[x] == step - 1 else reach[x]


@jit
def cross_means(volume, arms, top, out):
    """out = the mean cost over each pixel's cross region: the horizontal arms of all pixels on its vertical arm.

    Orthogonal integral images (Zhang, Lu and Lafruit, 2009): the sum over a horizontal arm is the difference of two
    prefix sums along the row, P(x2 + 1) - P(x1); the sum of these over a vertical arm, of two prefix sums along the
    column. So every region takes four reads, whatever its size.

    arms (4, rows, W): of the volume's rows. The volume is overwritten by prefix sums. These may wrap around; their
    differences, the sums over regions, must fit its dtype.
    """
    rows, width, depth = volume.shape
    prefix = np.zeros((width + 1, depth), volume.dtype)
    zeros = np.zeros((width, depth), volume.dtype)
    sizes = np.zeros((rows + 1, width), np.int64)
    # Each row becomes the sum over the horizontal arms of all rows down to it.
    for y in range(rows):
        for x in range(width):
            a, b, c = prefix[x], prefix[x + 1], volume[y, x]
            for j in range(depth):
                b[j] = a[j] + c[j]
        above = volume[y - 1] if y > 0 else zeros
        for x in range(width):
            first, last = x - arms[0, y, x], x + arms[1, y, x] + 1
            sizes[y + 1, x] = sizes[y, x] + last - first
            a, b, c, total = prefix[first], prefix[last], volume[y, x], above[x]
            for j in range(depth):
                c[j] = total[j] + (b[j] - a[j])
    # The sum over the rows of the vertical arm is the difference of two of them.
    for y in range(top, top + len(out)):
        for x in range(width):
            first, last = y - arms[2, y, x], y + arms[3, y, x]
            size = sizes[last + 1, x] - sizes[first, x]
            a = volume[first - 1, x] if first > 0 else zeros[x]
            b, here = volume[last, x], out[y - top, x]
            for j in range(depth):
                here[j] = volume.dtype.type(b[j] - a[j]) / size


@jit
def adaptive_weights(volume, left, right, start, nearness, similar, radius, top, out):
    """out = the weighted mean of the costs over the window; weights of similarity and proximity in both images.

    E(p, d) = sum_q w(p, q) w'(p - d, q - d) C(q, d) / sum_q w(p, q) w'(p - d, q - d): equation (7) of Yoon and Kweon,
    "Adaptive support-weight approach for correspondence search", PAMI 28(4), 2006. w and w' are the weights in the left
    and in the right image; `nearness` holds the product of their proximities, which are equal.

    left (rows, W); right reversed and edge-continued, candidate j of column x at start - x + j; nearness (side, side);
    similar[k]: the weight of an absolute difference of k grey levels; the images hold levels 0..255.
    """
    rows, width, depth = volume.shape
    columns = right.shape[1]
    weights = np.zeros(columns, np.float64)
    norm = np.zeros((width, depth), np.float64)
    total = np.zeros((width, depth), np.float64)
    for y in range(top, top + len(out)):
        norm[:] = 0.0
        total[:] = 0.0
        for i in range(max(-radius, -y), min(radius, rows - 1 - y) + 1):
            for k in range(-radius, radius + 1):
                # The weights of the right pixels at this offset, once for all candidates of the row.
                for q in range(columns):
                    # The image is reversed: the neighbour k pixels to the right is at q - k.
                    neighbour = min(max(q - k, 0), columns - 1)
                    weights[q] = similar[abs(right[y, q] - right[y + i, neighbour])]
                for x in range(max(0, -k), min(width, width - k)):
                    near = (
                        nearness[i + radius, k + radius]
                        * similar[abs(left[y, x] - left[y + i, x + k])]
                    )
                    sums, norms, cost = total[x], norm[x], volume[y + i, x + k]
                    there = weights[start - x : start - x + depth]
                    for j in range(depth):
                        weight = near * there[j]
                        norms[j] += weight
                        sums[j] += weight * cost[j]
        for x in range(width):
            sums, norms, here = total[x], norm[x], out[y - top, x]
            for j in range(depth):
                here[j] = sums[j] / norms[j]


@jit
def clipped_means(volume, radius, top, out):
    """out = the volume's mean over the square window, cut at the edges."""
    rows, width, depth = volume.shape
    prefix = np.zeros((width + 1, depth), np.float64)
    column = np.zeros((width, depth), np.float64)
    for y in range(top, top + len(out)):
        above, below = max(0, y - radius), min(rows, y + radius + 1)
        column[:] = 0.0
        for v in range(above, below):
            for x in range(width):
                a, b = column[x], volume[v, x]
                for j in range(depth):
                    a[j] += b[j]
        for x in range(width):
            a, b, c = prefix[x], prefix[x + 1], column[x]
            for j in range(depth):
                b[j] = a[j] + c[j]
        for x in range(width):
            first, last = max(0, x - radius), min(width, x + radius + 1)
            a, b, here = prefix[first], prefix[last], out[y - top, x]
            share = 1.0 / ((last - first) * (below - above))
            for j in range(depth):
                here[j] = (b[j] - a[j]) * share
