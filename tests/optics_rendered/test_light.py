"""The first dark ring of the Airy pattern, measured on the image of a small light."""

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, grey, lamps, square_camera
from twinlens.camera.film import diffract


@pytest.mark.parametrize("f_number", [16.0, 24.0])
def test_the_first_dark_ring_of_a_rendered_point(f_number):
    """A light of half a pixel in focus, rendered and diffracted: its ring is at 1.22 lambda v/A within 2%."""
    camera = square_camera(161, 4000.0, pixel_pitch_um=1.0)
    lens = tl.ThinLens(camera.film_distance / f_number, 2.0)
    star = lamps([(0.0, 0.0, 2.0)], 0.25 * 2.0 / camera.fx, radiance=1e4)
    sharp = tl.render(star, tl.Rig([camera], [HERE]), lens, spp=256, seed=0)[0]
    assert np.count_nonzero(grey(sharp)) == 1
    blurred = diffract(sharp, camera, lens)
    v, u = np.mgrid[:161, :161]
    radius = np.hypot(u - camera.cx, v - camera.cy)
    for channel, wavelength in enumerate((611e-9, 549e-9, 464e-9)):
        expected = 1.22 * wavelength * f_number / 1e-6
        near = np.abs(radius / expected - 1) < 0.15
        light = blurred[..., channel]
        fit = np.polynomial.Polynomial.fit(radius[near], light[near], 4)
        line = np.linspace(0.88, 1.12, 2401) * expected
        lowest = line[np.argmin(fit(line))]
        assert lowest == pytest.approx(expected, rel=0.02)
        assert fit(lowest) < 0.01 * light.max()
