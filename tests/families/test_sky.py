"""The clear sky: brightest at the sun, bluest opposite to it, of mean luminance 1."""

import numpy as np

from twinlens.families.lighting import clear_sky


def test_a_clear_sky_is_bright_at_the_sun_and_blue_opposite_to_it():
    sky = clear_sky(2.5, 40.0)
    above = sky[: len(sky) // 2] @ [0.2126, 0.7152, 0.0722]
    assert abs(above.mean() - 1) < 0.1  # colours outside the sRGB gamut are clipped
    row, column = np.unravel_index(above.argmax(), above.shape)
    assert abs(column - 128) < 4
    assert abs((0.5 - (row + 0.5) / 128) * 180 - 40.0) < 4
    opposite = sky[40, 0]
    assert opposite[2] > 1.3 * opposite[0]


def test_a_low_sun_reddens_the_horizon():
    horizon = clear_sky(4.0, 4.0)[60, 128]
    assert horizon[0] > horizon[2]
