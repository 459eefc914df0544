"""Every measure with every support against plain loops, in several number types; the rest is refused with reason."""

import functools

import numpy as np
import pytest

import twinlens.matching as tm
from tests.matching.matching_reference import (
    WINDOW_COSTS,
    assert_minimal,
    first_minimum,
    naive_cross,
    naive_guided,
    naive_shiftable,
    naive_weighted,
    pixel_difference,
)
from twinlens.errors import InputError
from twinlens.matching.costs import COSTS
from twinlens.matching.supports import SUPPORTS

SIDE, LOW, COUNT, DESCRIPTOR = 5, -2, 5, 3
RADIUS = SIDE // 2
SHAPE = (6, 11)
NORMALISED = ("ncc", "zsad", "zssd", "zncc", "jaccard")
PIXELWISE = ("cross", "weighted", "guided")


def images(dtype):
    """A pair with an edge, a constant patch and noise."""
    rng = np.random.default_rng(7)
    scene = rng.integers(0, 50, (2, *SHAPE)) + 90 * (np.arange(SHAPE[1]) > 5)
    scene[0, 1:5, :4] = 60
    factor = {"uint8": 1, "uint16": 257, "float32": 1 / 255}[dtype]
    return (scene * factor).astype(dtype)


def grey_levels(left, right):
    """Both as whole levels 0..255."""
    if left.dtype.kind == "f":
        low, high = min(left.min(), right.min()), max(left.max(), right.max())
        return [
            np.rint((image.astype(float) - low) * (255 / (float(high) - low)))
            for image in (left, right)
        ]
    return [
        np.rint(image / (257 if image.dtype == np.uint16 else 1))
        for image in (left, right)
    ]


def window_cost(name, left, right):
    """cost(y, x, d, side) of edge-continued images."""
    height, width = left.shape
    whole = name in WINDOW_COSTS
    difference = None if whole else pixel_difference(name, left, right, DESCRIPTOR)

    @functools.cache
    def cost(y, x, d, side):
        reach = np.arange(-(side // 2), side // 2 + 1)
        rows = np.clip(y + reach, 0, height - 1)
        ours, theirs = (np.clip(column + reach, 0, width - 1) for column in (x, x - d))
        if whole:
            a, b = left[np.ix_(rows, ours)], right[np.ix_(rows, theirs)]
            return WINDOW_COSTS[name](a.astype(float), b.astype(float))
        return sum(
            difference(v, h, k) for v in rows for h, k in zip(ours, theirs, strict=True)
        )

    return cost


def volume_of(cost, side):
    volume = np.empty((*SHAPE, COUNT))
    for y, x, i in np.ndindex(volume.shape):
        volume[y, x, i] = cost(y, x, LOW + i, side)
    return volume


def without_partners(volume):
    partner = np.arange(SHAPE[1])[:, None] - LOW - np.arange(COUNT)
    volume[:, (partner < 0) | (partner >= SHAPE[1])] = np.inf
    return volume


def fixed(cost, _left, _right, _growth):
    return volume_of(cost, SIDE)


def shiftable(cost, _left, _right, _growth):
    return naive_shiftable(without_partners(volume_of(cost, SIDE)), RADIUS)


def adaptive(cost, left, _right, growth):
    """The five sub-windows of the smallest of 9, 7, 5 whose window has sum Ix^2 >= 2 (2 / 0.05)^2, or else of 9."""
    height, width = SHAPE
    padded = np.pad(left, ((0, 0), (1, 1)), mode="edge")
    slope = (padded[:, 2:] - padded[:, :-2]) / 2
    slope[:, [0, -1]] *= 2  # where there is one neighbour the step is one pixel
    energy = np.pad(slope**2, 4, mode="edge")
    volume = np.empty((*SHAPE, COUNT))
    chosen = set()
    for y, x in np.ndindex(SHAPE):
        side = 9
        for smaller in (7, 5):
            reach = smaller // 2
            near = energy[y + 4 - reach : y + 5 + reach, x + 4 - reach : x + 5 + reach]
            side = smaller if near.sum() >= 2 * (2.0 / 0.05) ** 2 else side
        chosen.add(side)
        quarter = {9: 5, 7: 3, 5: 3}[side]
        step = side // 2 - quarter // 2
        rows, columns = (
            (max(y - step, 0), min(y + step, height - 1)),
            (max(x - step, 0), min(x + step, width - 1)),
        )
        for i in range(COUNT):
            corners = sorted(
                cost(v, h, LOW + i, quarter) for v in rows for h in columns
            )
            total = cost(y, x, LOW + i, quarter) + corners[0] + corners[1]
            volume[y, x, i] = total * (25 / quarter**2) ** growth
    assert len(chosen) > 1
    return volume


def cross(cost, left, _right, _growth):
    return naive_cross(volume_of(cost, 1), left, RADIUS)


def weighted(cost, left, right, _growth):
    return naive_weighted(volume_of(cost, 1), left, right, LOW, RADIUS)


def guided(cost, left, _right, _growth):
    return naive_guided(volume_of(cost, 1), left, RADIUS)


REFERENCES = {
    "fixed": fixed,
    "shiftable": shiftable,
    "adaptive": adaptive,
    "cross": cross,
    "weighted": weighted,
    "guided": guided,
}


def growth(name):
    return {"ncc": 0, "zncc": 0, "jaccard": 0, "zssd": 2}.get(name, 1)


def found(dtype, name, support):
    return tm.match(
        *images(dtype), name, support=support, block_size=9 if support == "adaptive" else SIDE,
        min_disparity=LOW, num_disparities=COUNT,
        census_window=DESCRIPTOR, subpixel="none", threads=1,
    )  # fmt: skip


def test_the_references_cover_all_there_is():
    assert set(REFERENCES) == set(SUPPORTS)
    assert set(PIXELWISE) == {
        name for name, support in SUPPORTS.items() if support.pixelwise
    }
    assert set(NORMALISED) == {
        name for name, cost in COSTS.items() if cost.scoring != "sum"
    }


@pytest.mark.parametrize(
    "dtype", ["uint8", "float32", pytest.param("uint16", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("support", REFERENCES)
@pytest.mark.parametrize("name", COSTS)
def test_every_measure_with_every_support_equals_plain_loops(name, support, dtype):
    if support in PIXELWISE and name in NORMALISED:
        with pytest.raises(InputError, match="statistics of whole windows"):
            found(dtype, name, support)
        return
    left, right = images(dtype)
    volume = REFERENCES[support](
        window_cost(name, left, right), *grey_levels(left, right), growth(name)
    )
    volume = without_partners(volume)
    disparity = found(dtype, name, support)
    least = volume.min(axis=-1)
    largest = float(np.abs(least[np.isfinite(least)]).max())
    scale = 1.0 if growth(name) == 0 else largest
    assert_minimal(volume, disparity, LOW, atol=1e-6 * scale)
    whole_costs = name in ("sad", "ssd", "census", "rank") and dtype != "float32"
    if whole_costs and support in ("fixed", "shiftable"):
        np.testing.assert_array_equal(disparity, first_minimum(volume, LOW))
