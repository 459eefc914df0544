"""Presets of cameras: figures against the published fields of view, and their geometry when binned and cropped."""

import math
import re

import numpy as np
import pytest

from twinlens.camera.presets import CAMERAS, find_camera
from twinlens.errors import InputError

PUBLISHED = {  # degrees, of the sources
    "oak-d": (80, 2.0),  # horizontal
    "realsense-d435": (91.2, 3.0),  # horizontal, with the tolerance of the data sheet
    "gopro-hero9-wide": (118, 2.0),  # horizontal, GoPro's "Wide" in 16:9
    "mer-pancam": (16, 0.5),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_field_of_view_is_the_published_one(name):
    published, tolerance = PUBLISHED[name]
    assert CAMERAS[name].camera.fov_x_deg == pytest.approx(published, abs=tolerance)


def test_the_phone_has_the_diagonal_of_its_sensor_format():
    """1/2.55 inch, whose inch is 18 mm of image below 1/2 inch."""
    camera = CAMERAS["pixel4"].camera
    assert math.hypot(
        camera.width, camera.height
    ) * camera.pixel_pitch_um / 1e3 == pytest.approx(18 / 2.55, rel=0.01)


@pytest.mark.parametrize("name", CAMERAS)
def test_every_preset_has_a_source(name):
    reference = find_camera(name).reference(name)
    assert reference["name"] == name
    assert len(reference["source"]) > 50
    assert re.search(r"\w+\.(com|org)/\w+", reference["source"])


@pytest.mark.parametrize("name", CAMERAS)
def test_binning_keeps_the_view_and_the_sensor(name):
    whole = CAMERAS[name].camera
    half = CAMERAS[name].resized(whole.width // 2)
    assert half.fov_x_deg == pytest.approx(whole.fov_x_deg, abs=1e-9)
    assert half.width * half.pixel_pitch_um == pytest.approx(
        whole.width * whole.pixel_pitch_um
    )
    assert half.film_distance == pytest.approx(whole.film_distance)
    ends = [(-0.5, -0.5), (whole.width - 0.5, whole.height - 0.5)]
    small = [(-0.5, -0.5), (half.width - 0.5, half.height - 0.5)]
    assert np.allclose(half.unproject(small), whole.unproject(ends), atol=1e-9)


def test_cropped_rows_are_those_in_the_middle():
    whole = CAMERAS["gopro-hero9-wide"].camera
    crop = CAMERAS["gopro-hero9-wide"].resized(960, 400)
    assert np.allclose(
        crop.unproject([(100.0, 30.0)]), whole.unproject([(100.0, 100.0)]), atol=1e-9
    )


def test_a_sensor_has_no_more_rows_than_it_has():
    with pytest.raises(
        InputError, match="the sensor has 400 rows at a width of 640, got 480"
    ):
        CAMERAS["realsense-d435"].resized(640, 480)


def test_an_unknown_camera_is_named_with_the_nearest():
    with pytest.raises(InputError, match="did you mean 'realsense-d435'"):
        find_camera("realsense-d345")
