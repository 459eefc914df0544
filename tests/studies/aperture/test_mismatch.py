"""The probability of mismatches against naive block matching of noisy synthetic textures.

The tolerance of 0.03 is at least two standard deviations: 0.027 for the count of one seed, 0.016 for the mean of three,
0.008 for the theory with its 4000 samples.
"""

import math

import numpy as np
import pytest

from tests.studies.aperture.naive import refined_shifts, sheet, window_costs
from twinlens.studies.aperture.theory import (
    RIGHT_PX,
    drawn_sums,
    mismatch,
    mismatch_share,
)

SIDE, NDISP = 9, 32
SHIFT = 14  # of the right texture
STEP = 8


def counted(grain, snr, seed):
    """The share of windows whose refined match is wrong by more than RIGHT_PX."""
    random = np.random.default_rng(seed)
    errors = []
    for _ in range(3):
        texture = sheet(random, (160, 160 + NDISP), grain)
        noise = random.normal(0, 1 / math.sqrt(snr), (2, 160, 160))
        left = texture[:, :160] + noise[0]
        right = texture[:, SHIFT : SHIFT + 160] + noise[1]
        costs = window_costs(left, right, NDISP, SIDE, STEP)
        errors.append(np.abs(refined_shifts(costs) - SHIFT))
    return np.mean(np.stack(errors) > RIGHT_PX)


RATIOS = {
    1.2: [0.03, 0.1, 0.2, 0.4, 0.8],
    3.0: [0.05, 0.3, 1.0, 3.0],
    6.0: [0.3, 2.0, 10.0, 60.0],
}
"""Signal to noise of textures, by their grain."""


@pytest.mark.parametrize(
    "grain", [1.2, *(pytest.param(g, marks=pytest.mark.slow) for g in (3.0, 6.0))]
)
def test_counted_mismatches_equal_the_prediction(grain):
    for snr in RATIOS[grain]:
        share = np.mean([counted(grain, snr, seed) for seed in range(3, 6)])
        predicted = mismatch(np.array([snr]), grain, SIDE, NDISP)[0]
        assert predicted == pytest.approx(share, abs=0.03), snr


def isserlis(grain, first, second):
    """Cov(E_h, E_k) = 2 sums over the window of <(t(x) - t(x + h)) (t(y) - t(y + k))>^2, which is separable."""

    def correlation(shift):
        return np.exp(-(shift**2) / (4 * grain**2))

    along = np.arange(SIDE)[:, None] - np.arange(SIDE)
    both = correlation(along) + correlation(along + first - second)
    either = correlation(along - second) + correlation(along + first)
    return 2 * ((both - either) ** 2).sum() * (correlation(along) ** 2).sum()


@pytest.mark.parametrize("grain", [1.2, 3.0])
def test_mean_and_covariance_of_the_texture_sum(grain):
    energies, _, _ = drawn_sums(grain, SIDE, NDISP)
    shifts = np.arange(NDISP) - NDISP // 2
    mean = 2 * SIDE**2 * (1 - np.exp(-(shifts**2) / (4 * grain**2)))
    np.testing.assert_allclose(energies.mean(axis=0), mean, rtol=0.05, atol=1e-6)
    for first, second in ((8, 8), (8, 7), (8, -8), (3, 12)):
        columns = energies[:, [first + NDISP // 2, second + NDISP // 2]]
        covariance = np.cov(columns, rowvar=False)[0, 1]
        variances = [isserlis(grain, shift, shift) for shift in (first, second)]
        tolerance = 0.1 * math.sqrt(math.prod(variances))
        expected = isserlis(grain, first, second)
        assert covariance == pytest.approx(expected, abs=tolerance)


def test_variances_of_the_noise_sums():
    texture, both, noise = drawn_sums(1.2, SIDE, NDISP)
    zero = NDISP // 2
    far = zero + 11
    assert both[:, far].var() == pytest.approx(8 * texture[:, far].mean(), rel=0.1)
    difference = noise[:, far] - noise[:, zero]
    assert difference.var() == pytest.approx(12 * SIDE**2, rel=0.1)


@pytest.mark.parametrize("spread", [0.7, 8.0])
def test_limits_without_texture_and_without_noise(spread):
    """Of the shifts -16 to 15 those from -2 to 2 are right, the outer two half of the time after refinement."""
    noise_alone, texture_alone = mismatch(np.array([0.0, 1e6]), spread, SIDE, NDISP)
    assert noise_alone == pytest.approx(1 - 4 / 32, abs=0.03)
    assert texture_alone == 0


@pytest.mark.parametrize("spread", [1.3, 4.0])
def test_interpolation_in_the_table(spread):
    ratios = np.array([0.2, 1.0, 5.0])
    interpolated = mismatch_share(ratios, spread, SIDE, NDISP)
    expected = mismatch(ratios, spread, SIDE, NDISP)
    np.testing.assert_allclose(interpolated, expected, atol=0.04)
