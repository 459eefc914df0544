"""The theory of mismatches against matches of synthetic textures in noise, counted by a naive block match.

What was allowed was set before the first comparison: the formula counts correlated rivals as that many fewer
independent ones, and a doubling of rivals is worth a third of the light, so that the shares counted must lie between
those that theory gives to half a stop less and half a stop more light, and 0.05, three standard deviations of the
draws.
"""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from twinlens.studies.aperture_mismatch import RIGHT_PX, mismatch

HALF_A_STOP = math.sqrt(2.0)
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
    few, many = mismatch(np.array([snr * HALF_A_STOP, snr / HALF_A_STOP]), grain, SIDE, NDISP)
    assert few - 0.05 <= counted(grain, snr) <= many + 0.05
