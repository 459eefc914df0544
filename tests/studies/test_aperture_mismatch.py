"""The theory of mismatches against matches of synthetic textures in noise, counted by a naive block match.

Allowed are 0.05, three standard deviations of the eight hundred windows that are counted. That is less than what theory
would be off by without fading, or if noise on texture were not alike at neighbouring shifts.
"""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from twinlens.studies.aperture_mismatch import RIGHT_PX, mismatch, mismatch_share

SIDE, NDISP = 9, 32
STEP = 8


def textures(grain, count, size, random):
    """Gaussian textures of variance 1, each twice: as the left eye sees them and, shifted by 14 px, the right one."""
    for _ in range(count):
        sheet = gaussian_filter(random.normal(size=(size, size + NDISP)), grain, mode="wrap")
        sheet *= 2.0 * grain * math.sqrt(math.pi)
        yield sheet[:, :size], sheet[:, 14 : size + 14]


def counted(grain, snr, seed=3):
    """The share of windows whose least sum of squared differences, refined by a parabola, is wrong by over 2 px."""
    random = np.random.default_rng(seed)
    wrong = []
    for one, other in textures(grain, 3, 160, random):
        left, right = (eye + random.normal(0, 1 / math.sqrt(snr), eye.shape) for eye in (one, other))
        for y in range(0, 160 - SIDE, STEP):
            for x in range(NDISP, 160 - SIDE, STEP):
                block = left[y : y + SIDE, x : x + SIDE]
                costs = [((block - right[y : y + SIDE, x - d : x - d + SIDE]) ** 2).sum() for d in range(NDISP)]
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
def test_mismatches_counted_are_those_expected(grain, snr):
    assert mismatch(np.array([snr]), grain, SIDE, NDISP)[0] == pytest.approx(counted(grain, snr), abs=0.05)


@pytest.mark.parametrize("spread", [0.7, 2.0, 8.0])
def test_without_texture_all_is_chance_and_without_noise_all_is_right(spread):
    """Of the shifts -16 to 15 those from -2 to 2 are right, the outer two by half: refined by a parabola."""
    none, all_of_it = mismatch(np.array([0.0, 1e6]), spread, SIDE, NDISP)
    assert none == pytest.approx(1 - 4 / 32, abs=0.03)
    assert all_of_it == 0.0


def test_the_table_is_the_theory_between_its_places_and_at_them():
    at = np.array([0.2, 1.0, 5.0])
    for spread in (1.3, 4.0):
        expected = mismatch(at, spread, SIDE, NDISP)
        np.testing.assert_allclose(mismatch_share(at, spread, SIDE, NDISP), expected, atol=0.04)
