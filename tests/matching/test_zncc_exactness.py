"""ZNCC of 8-bit images: the winners are those of exact whole-number arithmetic."""

import numpy as np
import pytest

from twinlens.matching.box import BoxMatch
from twinlens.matching.costs import COSTS


def exact_winners(left, right, side, low, high):
    """The disparity of the largest correlation at each pixel, in whole numbers; of equal ones the smallest.

    Signed squares of correlations, c |c| / s, are compared by their cross products. The kernel's are float32: these
    images, drawn by their seeds, have no two that differ by less than it can tell.
    """
    radius, n, width = side // 2, side * side, left.shape[1]
    views = [
        np.lib.stride_tricks.sliding_window_view(
            np.pad(image.astype(np.int64), radius, mode="edge"), (side, side)
        )
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
            likeness = (
                (covariance * abs(covariance), int(spread[y, x - d]))
                if spread[y, x - d]
                else (0, 1)
            )
            if best is None or likeness[0] * best[1] > best[0] * likeness[1]:
                best, found[y, x] = likeness, d
    return found


def saturated(rng, shape):
    """Bytes of which many are black or white."""
    return np.clip(rng.normal(128, 140, shape), 0, 255).astype(np.uint8)


IMAGES = {
    "noise": lambda rng, shape: rng.integers(0, 256, shape, dtype=np.uint8),
    "saturated": saturated,
    "more black than white": lambda rng, shape: (
        saturated(rng, shape) // 2 * (rng.random(shape) > 0.3)
    ),
    "bright": lambda rng, shape: (255 - rng.integers(0, 40, shape)).astype(np.uint8),
    "two values": lambda rng, shape: rng.choice([0, 255], shape).astype(np.uint8),
    "a flat half": lambda rng, shape: np.where(
        np.arange(shape[-1]) < 12, 77, saturated(rng, shape)
    ).astype(np.uint8),
}


@pytest.mark.parametrize("side", [1, 3, 9, 11])
@pytest.mark.parametrize("kind", IMAGES)
def test_winners_are_those_of_whole_numbers(kind, side):
    left, right = IMAGES[kind](np.random.default_rng(side), (2, 7, 26)).astype(np.uint8)
    for low, high in ((0, 20), (-9, 9), (4, 7), (20, 60)):
        found = BoxMatch(left, right, COSTS["zncc"], side, low, high, 1).winners(
            "none", costs=False
        )
        np.testing.assert_array_equal(
            found.disparity, exact_winners(left, right, side, low, high)
        )


def test_a_right_image_that_is_the_negative_of_the_left_has_a_winner_all_the_same():
    left = np.random.default_rng(5).integers(0, 256, (6, 40), dtype=np.uint8)
    right = 255 - left
    found = BoxMatch(left, right, COSTS["zncc"], 3, 0, 1, 1).winners(
        "none", costs=False
    )
    np.testing.assert_array_equal(found.disparity, 0)
    wide = BoxMatch(left, right, COSTS["zncc"], 5, -2, 3, 1).winners(
        "none", costs=False
    )
    np.testing.assert_array_equal(wide.disparity, exact_winners(left, right, 5, -2, 3))


@pytest.mark.parametrize("shape", [(1, 1), (5, 1), (1, 2), (4, 3), (2, 7)])
def test_images_narrower_than_the_window_have_their_winners(shape):
    left, right = saturated(np.random.default_rng(2), (2, *shape))
    for side, low, high in ((1, 0, 3), (5, -4, 5), (11, 0, 70), (9, -130, 130)):
        found = BoxMatch(left, right, COSTS["zncc"], side, low, high, 2).winners(
            "none", costs=False
        )
        np.testing.assert_array_equal(
            found.disparity, exact_winners(left, right, side, low, high)
        )


@pytest.mark.parametrize("fit", ["v", "parabola"])
def test_the_kernels_with_and_without_costs_agree(fit):
    rng = np.random.default_rng(1)
    left = saturated(rng, (40, 170))
    right = np.roll(left, -6, axis=1)
    right = np.clip(right + rng.normal(0, 9, right.shape), 0, 255).astype(np.uint8)
    for low, high, threads in ((0, 64, 1), (0, 128, 2), (-5, 75, 2), (3, 40, 1)):
        match = BoxMatch(left, right, COSTS["zncc"], 7, low, high, threads)
        without, with_costs = (
            match.winners(fit, costs=costs).disparity for costs in (False, True)
        )
        # The second has the left window's scale in its costs, which rounds once more.
        np.testing.assert_allclose(without, with_costs, rtol=3e-7, atol=2e-6)
