"""The light of a rig's task: lux to electrons, and the noise of an exposure that the plan chooses."""

import math

import numpy as np
import pytest

from twinlens.camera import Camera, ThinLens
from twinlens.sensor import Exposure, Sensor, light_on_grey

LUMINOSITY = {611: 0.4906, 549: 0.9920, 464: 0.0711}
"""CIE 1931 luminous efficiency, interpolated in the table of CIE 15:2004 at 5 nm."""


def grey_radiance(lux):
    """W/(m^2 sr) in each band, of a white light whose three bands have equal power."""
    return 0.18 * lux / math.pi / (683.0 * sum(LUMINOSITY.values()))


@pytest.mark.parametrize("filters", ["rgb", "mono"])
def test_electrons_and_noise_are_those_of_an_exposure(filters):
    """A uniform grey image, exposed for the time that gives the ratio; the noise of pixels, fixed patterns excluded."""
    sensor = Sensor(
        filters=filters,
        prnu=0.0,
        dsnu=0.0,
        dark_current=0.0,
        output="raw",
        vignetting=False,
        adc_bits=16,
    )
    light = light_on_grey(
        sensor, 400.0, pixel_pitch_um=3.45, longest_exposure=0.02, least_snr=20.0
    )
    camera = Camera.from_fov(200, 150, 50, pixel_pitch_um=3.45)
    number = light.largest_f_number(0.002)
    lens = ThinLens(camera.film_distance / number, focus_distance=2.0)
    image = np.full((150, 200, 3), grey_radiance(400.0))
    photo = sensor.expose(
        image, camera=camera, lens=lens, seed=3, exposure=Exposure(0.002)
    )
    numbers = (
        photo.image.astype(float)
        if filters == "mono"
        else photo.image[..., 1].astype(float)
    )
    electrons = (numbers - sensor.black_level) / sensor.system_gain()
    assert electrons.mean() == pytest.approx(
        light.electrons_per_second * 0.002 / number**2, rel=0.02
    )
    assert electrons.mean() / electrons.std() == pytest.approx(20.0, rel=0.03)


def test_light_is_proportional_to_the_area_of_a_pixel_and_white_saturates():
    small, large = (light_on_grey(Sensor(), 100.0, pitch, 0.01) for pitch in (2.0, 4.0))
    assert large.electrons_per_second == pytest.approx(4 * small.electrons_per_second)
    assert small.most_electrons == pytest.approx(0.18 * Sensor().full_well)
