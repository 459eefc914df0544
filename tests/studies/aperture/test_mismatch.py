"""The probability of mismatches against naive block matching of noisy synthetic textures.

The tolerance of 0.03 is at least two standard deviations: 0.027 for the count of one seed, 0.011 for the mean of six,
0.008 for the theory with its 4000 samples.
"""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from twinlens.studies.aperture.theory import (
    RIGHT_PX,
    drawn_sums,
    mismatch,
    mismatch_share,
)

SIDE, NDISP = 9, 32
STEP = 8


def textures(grain, count, size, random):
    """Pairs of Gaussian textures of variance 1, the right one shifted by 14 px."""
    for _ in range(count):
        sheet = gaussian_filter(
            random.normal(size=(size, size + NDISP)), grain, mode="wrap"
        )
        sheet *= 2.0 * grain * math.sqrt(math.pi)
        yield sheet[:, :size], sheet[:, 14 : size + 14]


def counted(grain, snr, seed):
    """The share of windows whose least sum of squared differences, refined by a parabola, is wrong by > 2 px."""
    random = np.random.default_rng(seed)
    wrong = []
    for left, right in textures(grain, 3, 160, random):
        left, right = (
            eye + random.normal(0, 1 / math.sqrt(snr), eye.shape)
            for eye in (left, right)
        )
        for y in range(0, 160 - SIDE, STEP):
            for x in range(NDISP, 160 - SIDE, STEP):
                block = left[y : y + SIDE, x : x + SIDE]
                costs = [
                    ((block - right[y : y + SIDE, x - d : x - d + SIDE]) ** 2).sum()
                    for d in range(NDISP)
                ]
                best = int(np.argmin(costs))
                if 0 < best < NDISP - 1:
                    below, least, above = costs[best - 1 : best + 2]
                    best += 0.5 * (below - above) / (below - 2 * least + above)
                wrong.append(abs(best - 14) > RIGHT_PX)
    return float(np.mean(wrong))


@pytest.mark.parametrize(("grain", "snr"), [
    (1.2, 0.03), (1.2, 0.1), (1.2, 0.2), (1.2, 0.4), (1.2, 0.8),
    (3.0, 0.05), (3.0, 0.3), (3.0, 1.0), (3.0, 3.0),
    (6.0, 0.3), (6.0, 2.0), (6.0, 10.0), (6.0, 60.0),
])  # fmt: skip
def test_counted_mismatches_equal_the_prediction(grain, snr):
    share = np.mean([counted(grain, snr, seed) for seed in range(3, 9)])
    assert mismatch(np.array([snr]), grain, SIDE, NDISP)[0] == pytest.approx(
        share, abs=0.03
    )


def isserlis(grain, first, second):
    """Cov(E_h, E_k) = 2 sums over the window of <(t(x) - t(x + h)) (t(y) - t(y + k))>^2, which is separable."""

    def alike(x):
        return np.exp(-(x**2) / (4 * grain**2))

    along = np.arange(SIDE)[:, None] - np.arange(SIDE)
    across = (
        alike(along)
        - alike(along - second)
        - alike(along + first)
        + alike(along + first - second)
    )
    return 2 * (across**2).sum() * (alike(along) ** 2).sum()


@pytest.mark.parametrize("grain", [1.2, 3.0])
def test_mean_and_covariance_of_the_texture_sum(grain):
    energies, _, _ = drawn_sums(grain, SIDE, NDISP)
    shifts = np.arange(NDISP) - NDISP // 2
    mean = 2 * SIDE**2 * (1 - np.exp(-(shifts**2) / (4 * grain**2)))
    np.testing.assert_allclose(energies.mean(axis=0), mean, rtol=0.05, atol=1e-6)
    for first, second in ((8, 8), (8, 7), (8, -8), (3, 12)):
        covariance = np.cov(
            energies[:, first + NDISP // 2], energies[:, second + NDISP // 2]
        )[0, 1]
        scale = math.sqrt(
            isserlis(grain, first, first) * isserlis(grain, second, second)
        )
        assert covariance == pytest.approx(
            isserlis(grain, first, second), abs=0.1 * scale
        )


def test_variances_of_the_noise_sums():
    (texture, both, noise), far = drawn_sums(1.2, SIDE, NDISP), NDISP // 2 + 11
    assert both[:, far].var() == pytest.approx(8 * texture[:, far].mean(), rel=0.1)
    assert (noise[:, far] - noise[:, NDISP // 2]).var() == pytest.approx(
        12 * SIDE**2, rel=0.1
    )


@pytest.mark.parametrize("spread", [0.7, 2.0, 8.0])
def test_limits_without_texture_and_without_noise(spread):
    """Of the shifts -16 to 15 those from -2 to 2 are right, the outer two half of the time after refinement."""
    none, all_of_it = mismatch(np.array([0.0, 1e6]), spread, SIDE, NDISP)
    assert none == pytest.approx(1 - 4 / 32, abs=0.03)
    assert all_of_it == 0.0


def test_interpolation_in_the_table():
    at = np.array([0.2, 1.0, 5.0])
    for spread in (1.3, 4.0):
        expected = mismatch(at, spread, SIDE, NDISP)
        np.testing.assert_allclose(
            mismatch_share(at, spread, SIDE, NDISP), expected, atol=0.04
        )
