"""Rendered light on a sensor: brightness over stops, and the first dark ring of the Airy pattern."""

import math

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    chequered_room,
    grey,
    lamps,
    square_camera,
)
from twinlens.camera.film import diffract
from twinlens.sensor import Exposure

SENSOR = tl.Sensor(
    quantum_efficiency=(1.0, 1.0, 1.0), full_well=1e6, read_noise=0.0, dark_current=0.0, prnu=0.0, dsnu=0.0,
    adc_bits=16, black_level=0.0, output="linear", bits=16, white_balance=False, vignetting=False,
)  # fmt: skip


def test_light_is_proportional_to_the_square_of_the_aperture():
    """A room from f/2 to f/32: each mean over A^2 is that of all within 1 %, three standard errors included."""
    camera = square_camera(32, 40.0)
    rig, room = tl.Rig([camera], [HERE]), chequered_room()
    exposure, light = None, []
    for f_number in (2.0, 4.0, 8.0, 32.0):
        lens = tl.ThinLens(camera.film_distance / f_number, 2.5)
        takes = [tl.render(room, rig, lens, spp=64, seed=take)[0] for take in range(4)]
        if exposure is None:
            electrons = SENSOR.electrons_per_radiance(camera, lens).max()
            exposure = Exposure(0.9 * SENSOR.full_well / electrons / np.max(takes))
        photos = [
            SENSOR.expose(
                radiance, camera=camera, lens=lens, seed=take, exposure=exposure
            ).image
            for take, radiance in enumerate(takes)
        ]
        assert np.max(photos) < 65535
        light.append(np.mean(photos, axis=(1, 2, 3)) / lens.aperture_diameter**2)
    relative = np.array(light) / np.mean(light)
    error = math.sqrt(relative.var(axis=1, ddof=1).mean() / 4)
    assert np.abs(relative.mean(axis=1) - 1).max() + 3 * error < 0.01


@pytest.mark.parametrize("f_number", [16.0, pytest.param(24.0, marks=pytest.mark.slow)])
def test_the_first_dark_ring_of_a_rendered_point(f_number):
    """A light of half a pixel in focus, rendered and diffracted: its ring is at 1.22 lambda v/A within 2 %."""
    camera = square_camera(161, 4000.0, pixel_pitch_um=1.0)
    lens = tl.ThinLens(camera.film_distance / f_number, 2.0)
    star = lamps([(0.0, 0.0, 2.0)], 0.25 * 2.0 / camera.fx, radiance=1e4)
    sharp = tl.render(star, tl.Rig([camera], [HERE]), lens, spp=64, seed=0)[0]
    assert np.count_nonzero(grey(sharp)) == 1
    blurred = diffract(sharp, camera, lens)
    v, u = np.mgrid[:161, :161]
    radius = np.hypot(u - camera.cx, v - camera.cy)
    for channel, wavelength in enumerate((611e-9, 549e-9, 464e-9)):
        expected = 1.22 * wavelength * f_number / 1e-6
        near = np.abs(radius / expected - 1) < 0.15
        profile = blurred[..., channel]
        fit = np.polynomial.Polynomial.fit(radius[near], profile[near], 4)
        line = np.linspace(0.88, 1.12, 2401) * expected
        darkest = line[np.argmin(fit(line))]
        assert darkest == pytest.approx(expected, rel=0.02)
        assert fit(darkest) < 0.01 * profile.max()
