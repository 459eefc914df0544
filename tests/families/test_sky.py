"""The clear sky: brightest at the sun, bluest opposite to it, of mean luminance 1."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.families import Assets
from twinlens.families.composition import Composition
from twinlens.families.lighting import clear_sky, daylight
from twinlens.geometry import look_at


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


@pytest.mark.parametrize(("seed", "side"), [(3, -1.0), (4, 1.0)])
def test_the_sky_is_brightest_around_the_sun(seed, side):
    """A camera that looks at the sun sees the brightest part of the sky in the middle of its image."""
    composed = Composition(
        "sky", np.random.SeedSequence(seed), Assets(), None, (1, 1), 1.0, 64
    )
    daylight(composed, np.random.default_rng(seed), np.zeros(3), 1.0, side)
    sun = composed.objects[0].world_from_object[:3, 3]
    assert sun[0] * side > 0
    sky = {"environment": composed.lights["environment"]}
    scene = tl.Scene("sky", (), {}, np.eye(4), (0.5, 2.0), lights=sky)
    rig = tl.Rig([tl.Camera.from_fov(32, 32, 80)], [look_at(np.zeros(3), sun)])
    luminance = tl.render(scene, rig, spp=4)[0] @ [0.2126, 0.7152, 0.0722]
    brightest = np.argwhere(luminance > 0.9 * luminance.max()).mean(axis=0)
    assert np.hypot(*(brightest - 15.5)) < 3
