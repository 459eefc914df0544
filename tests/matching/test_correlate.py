"""The kernel of ZNCC of bytes: what its bytes say, and its winners beside whole numbers."""

import numpy as np
import pytest

from twinlens.matching.box import BoxMatch
from twinlens.matching.costs import COSTS
from twinlens.matching.kernels.quads import weave_factors, weave_quads, weave_rests

EDGES = (0, 1, 126, 127, 128, 129, 254, 255)


def signed_bytes(words):
    """(W, 4) of the bytes of (W,) int32, lowest first."""
    return words.astype("<i4").view(np.int8).reshape(-1, 4).astype(int)


@pytest.mark.parametrize("centre", [127, 128])
@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize(("width", "side"), [(40, 5), (9, 9), (4, 7), (3, 1)])
def test_factors_and_their_rests_say_what_enters_and_what_leaves(centre, there, width, side):
    rng = np.random.default_rng(width)
    new, old = rng.choice(EDGES, (2, width)).astype(np.uint8)
    factors, rests = np.zeros(width, np.int32), np.zeros(width, np.int32)
    weave_factors(new, old, there, side, centre, factors)
    weave_rests(new, old, there, side, centre, rests)
    for x, found in enumerate(signed_bytes(factors) + signed_bytes(rests)):
        behind = x >= side
        expected = [
            int(new[x]) - centre,
            (centre - int(old[x])) * there,
            centre - int(new[x - side]) if behind else 0,
            (int(old[x - side]) - centre) * there if behind else 0,
        ]
        assert list(found) == expected
    assert set(np.unique(signed_bytes(rests))) <= {0, 1}


def test_quads_hold_both_rows_here_and_a_side_ahead():
    new, old = np.random.default_rng(0).integers(0, 256, (2, 12), dtype=np.uint8)
    quads = np.zeros(12, np.uint32)
    weave_quads(new, old, 5, quads)
    found = quads.astype("<u4").view(np.uint8).reshape(-1, 4)
    ahead = [np.append(row[5:], np.zeros(5, np.uint8)) for row in (new, old)]
    np.testing.assert_array_equal(found, np.stack([new, old, *ahead], axis=-1))


def exact_winners(left, right, side, low, high):
    """The disparity of the largest correlation at each pixel, in whole numbers; of equal ones the smallest.

    Signed squares of correlations, c |c| / s, are compared by their cross products. The kernel's are float32: these
    images, drawn by their seeds, have no two that differ by less than it can tell.
    """
    radius, n, width = side // 2, side * side, left.shape[1]
    views = [
        np.lib.stride_tricks.sliding_window_view(np.pad(image.astype(np.int64), radius, mode="edge"), (side, side))
        for image in (left, right)
    ]
    totals = [view.sum((-1, -2)) for view in views]
    spread = n * (views[1] ** 2).sum((-1, -2)) - totals[1] ** 2
    found = np.full(left.shape, np.inf)
    for y, x in np.ndindex(left.shape):
        best = None
        for d in range(max(low, x - width + 1), min(high, x + 1)):
            product = int((views[0][y, x] * views[1][y, x - d]).sum())
            covariance = n * product - int(totals[0][y, x]) * int(totals[1][y, x - d])
            likeness = (covariance * abs(covariance), int(spread[y, x - d])) if spread[y, x - d] else (0, 1)
            if best is None or likeness[0] * best[1] > best[0] * likeness[1]:
                best, found[y, x] = likeness, d
    return found


def saturated(rng, shape):
    """Bytes of which many are black or white."""
    return np.clip(rng.normal(128, 140, shape), 0, 255).astype(np.uint8)


IMAGES = {
    "noise": lambda rng, shape: rng.integers(0, 256, shape, dtype=np.uint8),
    "saturated": saturated,
    "more black than white": lambda rng, shape: saturated(rng, shape) // 2 * (rng.random(shape) > 0.3),
    "bright": lambda rng, shape: (255 - rng.integers(0, 40, shape)).astype(np.uint8),
    "two values": lambda rng, shape: rng.choice([0, 255], shape).astype(np.uint8),
    "a flat half": lambda rng, shape: np.where(np.arange(shape[-1]) < 12, 77, saturated(rng, shape)).astype(np.uint8),
}


@pytest.mark.parametrize("side", [1, 3, 9, 11])
@pytest.mark.parametrize("kind", IMAGES)
def test_winners_are_those_of_whole_numbers(kind, side):
    left, right = IMAGES[kind](np.random.default_rng(side), (2, 7, 26)).astype(np.uint8)
    for low, high in ((0, 20), (-9, 9), (4, 7), (20, 60)):
        found = BoxMatch(left, right, COSTS["zncc"], side, low, high, 1).winners("none", costs=False)
        np.testing.assert_array_equal(found.disparity, exact_winners(left, right, side, low, high))


def test_a_right_image_that_is_the_negative_of_the_left_has_a_winner_all_the_same():
    left = np.random.default_rng(5).integers(0, 256, (6, 40), dtype=np.uint8)
    right = 255 - left
    found = BoxMatch(left, right, COSTS["zncc"], 3, 0, 1, 1).winners("none", costs=False)
    np.testing.assert_array_equal(found.disparity, 0)
    wide = BoxMatch(left, right, COSTS["zncc"], 5, -2, 3, 1).winners("none", costs=False)
    np.testing.assert_array_equal(wide.disparity, exact_winners(left, right, 5, -2, 3))


@pytest.mark.parametrize("shape", [(1, 1), (5, 1), (1, 2), (4, 3), (2, 7)])
def test_images_narrower_than_the_window_have_their_winners(shape):
    left, right = saturated(np.random.default_rng(2), (2, *shape))
    for side, low, high in ((1, 0, 3), (5, -4, 5), (11, 0, 70), (9, -130, 130)):
        found = BoxMatch(left, right, COSTS["zncc"], side, low, high, 2).winners("none", costs=False)
        np.testing.assert_array_equal(found.disparity, exact_winners(left, right, side, low, high))


@pytest.mark.parametrize("fit", ["v", "parabola"])
def test_the_kernels_with_and_without_costs_agree(fit):
    rng = np.random.default_rng(1)
    left = saturated(rng, (40, 170))
    right = np.roll(left, -6, axis=1)
    right = np.clip(right + rng.normal(0, 9, right.shape), 0, 255).astype(np.uint8)
    for low, high, threads in ((0, 64, 1), (0, 128, 2), (-5, 75, 2), (3, 40, 1)):
        match = BoxMatch(left, right, COSTS["zncc"], 7, low, high, threads)
        alone, beside = (match.winners(fit, costs=costs).disparity for costs in (False, True))
        # The second has the left window's scale in its costs, which rounds once more.
        np.testing.assert_allclose(alone, beside, rtol=3e-7, atol=2e-6)
