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
    n, width = side * side, left.shape[1]
    ours, theirs = (
        np.lib.stride_tricks.sliding_window_view(
            np.pad(image.astype(np.int64), side // 2, mode="edge"), (side, side)
        ).reshape(*image.shape, -1)
        for image in (left, right)
    )
    spread = n * (theirs**2).sum(-1) - theirs.sum(-1) ** 2
    winners = np.full(left.shape, np.inf)
    for y, x in np.ndindex(left.shape):
        best = None
        for d in range(max(low, x - width + 1), min(high, x + 1)):
            a, b = ours[y, x], theirs[y, x - d]
            covariance = n * int(a @ b) - int(a.sum()) * int(b.sum())
            likeness = 0, 1
            if spread[y, x - d]:
                likeness = covariance * abs(covariance), int(spread[y, x - d])
            if best is None or likeness[0] * best[1] > best[0] * likeness[1]:
                best, winners[y, x] = likeness, d
    return winners


def assert_exact(left, right, side, low, high, threads=1):
    box = BoxMatch(left, right, COSTS["zncc"], side, low, high, threads)
    winners = box.winners("none", costs=False).disparity
    expected = exact_winners(left, right, side, low, high)
    np.testing.assert_array_equal(winners, expected)


def saturated(rng, shape):
    """Bytes of which many are black or white."""
    return np.clip(rng.normal(128, 140, shape), 0, 255).astype(np.uint8)


IMAGES = {
    "noise": lambda rng, shape: rng.integers(0, 256, shape, dtype=np.uint8),
    "saturated": saturated,
    "more black than white": lambda rng, shape: (
        saturated(rng, shape) // 2 * (rng.random(shape) > 0.3)
    ),
    "bright": lambda rng, shape: 255 - rng.integers(0, 40, shape),
    "two values": lambda rng, shape: rng.choice([0, 255], shape),
    "a flat half": lambda rng, shape: np.where(
        np.arange(shape[-1]) < 12, 77, saturated(rng, shape)
    ),
}


@pytest.mark.parametrize("side", [1, 3, 9, 11])
@pytest.mark.parametrize("kind", IMAGES)
def test_winners_are_those_of_whole_numbers(kind, side):
    pair = IMAGES[kind](np.random.default_rng(side), (2, 7, 26)).astype(np.uint8)
    for low, high in ((0, 20), (-9, 9), (4, 7), (20, 60)):
        assert_exact(*pair, side, low, high)


def test_a_right_image_that_is_the_negative_of_the_left_has_a_winner_all_the_same():
    left = np.random.default_rng(5).integers(0, 256, (6, 40), dtype=np.uint8)
    assert_exact(left, 255 - left, 3, 0, 1)
    assert_exact(left, 255 - left, 5, -2, 3)


@pytest.mark.parametrize("shape", [(1, 1), (5, 1), (1, 2), (4, 3), (2, 7)])
def test_images_narrower_than_the_window_have_their_winners(shape):
    pair = saturated(np.random.default_rng(2), (2, *shape))
    for side, low, high in ((1, 0, 3), (5, -4, 5), (11, 0, 70), (9, -130, 130)):
        assert_exact(*pair, side, low, high, threads=2)


@pytest.mark.parametrize("fit", ["v", "parabola"])
def test_the_kernels_with_and_without_costs_agree(fit):
    rng = np.random.default_rng(1)
    left = saturated(rng, (40, 170))
    right = np.roll(left, -6, axis=1) + rng.normal(0, 9, left.shape)
    right = np.clip(right, 0, 255).astype(np.uint8)
    for low, high, threads in ((0, 64, 1), (0, 128, 2), (-5, 75, 2), (3, 40, 1)):
        box = BoxMatch(left, right, COSTS["zncc"], 7, low, high, threads)
        without = box.winners(fit, costs=False).disparity
        with_costs = box.winners(fit, costs=True).disparity
        # The second has the left window's scale in its costs, which rounds once more.
        np.testing.assert_allclose(without, with_costs, rtol=3e-7, atol=2e-6)
