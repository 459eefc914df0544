"""The estimate of the renderer's noise, against the error relative to converged images."""

import numpy as np
import pytest


@pytest.mark.parametrize("kind", ["raw", "denoised"])
def test_the_estimate_agrees_with_the_error(renderer, kind):
    """Median over windows of 7x7 pixels, over eight seeds, within 25 %."""
    found = renderer("noise estimate")
    estimate, error = (
        windows(found[f"{kind}/squared {name}"]) for name in ("estimate", "error")
    )
    assert np.median(estimate) == pytest.approx(np.median(error), rel=0.25)


def test_samples_double_until_enough(renderer):
    found = renderer("noise estimate")
    np.testing.assert_array_equal(found["counts"], [4, 16, 1024])


def windows(squares):
    """Root mean square over seeds, channels and windows of 7x7 pixels."""
    squares = squares.mean(axis=(0, -1))
    return np.sqrt(
        np.lib.stride_tricks.sliding_window_view(squares, (7, 7)).mean(axis=(-1, -2))
    )
