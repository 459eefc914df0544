"""Every measure with every support against plain loops, in several number types; the rest is refused with reason."""

import numpy as np
import pytest

import twinlens.matching as tm
from tests.matching.matching_reference import (
    assert_minimal,
    first_minimum,
    is_candidate,
    naive_support,
    window_cost,
)
from twinlens.errors import InputError
from twinlens.matching.costs import COSTS
from twinlens.matching.supports import SUPPORTS

SIDE, LOW, COUNT, DESCRIPTOR = 5, -2, 5, 3
SHAPE = (6, 11)
NUMBER_TYPES = ("uint8", "uint16", "float32")
NORMALISED = ("ncc", "zsad", "zssd", "zncc", "jaccard")
PIXELWISE = ("cross", "weighted", "guided")
GROWTH = {"ncc": 0, "zncc": 0, "jaccard": 0, "zssd": 2}
"""Powers of the area to which costs are proportional, where these are not 1."""


def images(dtype):
    """A pair with an edge, a constant patch and noise."""
    rng = np.random.default_rng(7)
    scene = rng.integers(0, 50, (2, *SHAPE)) + 90 * (np.arange(SHAPE[1]) > 5)
    scene[0, 1:5, :4] = 60
    factor = {"uint8": 1, "uint16": 257, "float32": 1 / 255}[dtype]
    return (scene * factor).astype(dtype)


def grey_levels(pair):
    """Both images as whole levels 0..255."""
    if pair.dtype.kind == "f":
        lowest, highest = float(pair.min()), float(pair.max())
        return np.rint((pair.astype(float) - lowest) * (255 / (highest - lowest)))
    return np.rint(pair / (257 if pair.dtype == np.uint16 else 1))


def adaptive_sides(left):
    """The smallest of 9, 7, 5 whose window has sum Ix^2 >= 2 (2 / 0.05)^2, or else 9."""
    padded = np.pad(left, ((0, 0), (1, 1)), mode="edge")
    slope = (padded[:, 2:] - padded[:, :-2]) / 2
    slope[:, [0, -1]] *= 2  # where there is one neighbour the step is one pixel
    energy = np.pad(slope**2, 4, mode="edge")
    sides = np.full(SHAPE, 9)
    for y, x in np.ndindex(SHAPE):
        for side in (7, 5):
            first, last = 4 - side // 2, 5 + side // 2
            near = energy[y + first : y + last, x + first : x + last]
            if near.sum() >= 2 * (2.0 / 0.05) ** 2:
                sides[y, x] = side
    return sides


def adaptive(cost, left, growth):
    """The sum of the middle sub-window and the best two of the four at the corners, scaled to the same area."""
    height, width = SHAPE
    sides = adaptive_sides(left)
    assert len(np.unique(sides)) > 1
    volume = np.empty((*SHAPE, COUNT))
    for y, x, i in np.ndindex(volume.shape):
        quarter = {9: 5, 7: 3, 5: 3}[sides[y, x]]
        step = sides[y, x] // 2 - quarter // 2
        rows = max(y - step, 0), min(y + step, height - 1)
        columns = max(x - step, 0), min(x + step, width - 1)
        corners = [cost(v, u, LOW + i, quarter) for v in rows for u in columns]
        total = cost(y, x, LOW + i, quarter) + sum(sorted(corners)[:2])
        volume[y, x, i] = total * (25 / quarter**2) ** growth
    return volume


def matched(pair, name, support):
    return tm.match(
        *pair,
        name,
        support=support,
        block_size=9 if support == "adaptive" else SIDE,
        min_disparity=LOW,
        num_disparities=COUNT,
        census_window=DESCRIPTOR,
        subpixel="none",
        threads=1,
    )


def case(support, dtype):
    """Bytes are quick with every support; floats with the usual one, and with one that reads grey levels."""
    quick = dtype == "uint8" or (dtype == "float32" and support in ("fixed", "cross"))
    marks = () if quick else pytest.mark.slow
    return pytest.param(support, dtype, marks=marks)


CASES = [case(support, dtype) for support in SUPPORTS for dtype in NUMBER_TYPES]


@pytest.mark.parametrize(("support", "dtype"), CASES)
@pytest.mark.parametrize("name", COSTS)
def test_every_measure_with_every_support_equals_plain_loops(name, support, dtype):
    pair = images(dtype)
    if support in PIXELWISE and name in NORMALISED:
        with pytest.raises(InputError, match="statistics of whole windows"):
            matched(pair, name, support)
        return
    cost = window_cost(name, *pair, DESCRIPTOR)
    levels = grey_levels(pair)
    if support == "adaptive":
        volume = adaptive(cost, levels[0], GROWTH.get(name, 1))
    else:
        volume = naive_support(support, cost, levels, SIDE, LOW, COUNT)
    volume[~is_candidate(SHAPE, LOW, COUNT)] = np.inf
    disparity = matched(pair, name, support)
    least = volume.min(axis=-1)
    scale = 1.0
    if GROWTH.get(name) != 0:
        scale = float(np.abs(least[np.isfinite(least)]).max())
    assert_minimal(volume, disparity, LOW, atol=1e-6 * scale)
    whole_costs = name in ("sad", "ssd", "census", "rank") and dtype != "float32"
    if whole_costs and support in ("fixed", "shiftable"):
        np.testing.assert_array_equal(disparity, first_minimum(volume, LOW))
