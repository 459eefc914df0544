"""Projection and its inverse against OpenCV, round trips, and invalid cameras."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from twinlens.camera import BrownConrady, Camera, KannalaBrandt

focal = st.floats(50, 5000)
cameras = st.builds(
    Camera,
    width=st.integers(1, 2000),
    height=st.integers(1, 2000),
    fx=focal,
    fy=focal,
    cx=st.floats(-500, 2500),
    cy=st.floats(-500, 2500),
)
LENSES = [
    None,
    BrownConrady(k1=-0.28, k2=0.09, p1=1e-3, p2=-7e-4),
    BrownConrady(k1=0.1, k2=-0.02, k3=0.004, k4=0.03),
    KannalaBrandt(k1=-0.02, k2=0.004),
]


@pytest.mark.parametrize("distortion", LENSES)
def test_round_trip_of_every_pixel_through_each_distortion(distortion):
    camera = Camera(160, 120, 150.0, 145.0, 81.25, 57.5, distortion)
    grid = camera.pixel_grid()
    assert np.abs(camera.project(camera.unproject(grid) * 3.0) - grid).max() < 1e-9


def test_pixel_centres_are_integers_and_the_image_extends_half_a_pixel():
    camera = Camera(4, 3, 100.0, 100.0, 1.5, 1.0)
    grid = camera.pixel_grid()
    assert grid.shape == (3, 4, 2)
    assert grid[2, 3].tolist() == [3.0, 2.0]
    assert camera.unproject([1.5, 1.0]).tolist() == [0, 0, 1]
    assert camera.contains(grid).all()
    edge = [
        (-0.5, 0),
        (3.4999, 2.4999),
        (0, -0.5),
        (-0.5001, 0),
        (3.5, 0),
        (0, 2.5),
        (math.nan, 0),
    ]
    assert camera.contains(edge).tolist() == [
        True,
        True,
        True,
        False,
        False,
        False,
        False,
    ]


def test_x_is_right_and_y_is_down():
    camera = Camera(101, 101, 100.0, 50.0, 50.0, 50.0)
    assert camera.project([0.1, 0.2, 1.0]).tolist() == [60.0, 60.0]


@pytest.mark.parametrize("z", [0.0, -1.0])
def test_points_behind_the_camera_have_no_pixel(z):
    assert np.isnan(Camera.from_fov(64, 48, 60).project([0.1, 0.1, z])).all()


@given(st.integers(1, 4000), st.integers(1, 4000), st.floats(0.5, 175))
def test_from_fov_spans_its_angle_from_edge_to_edge(width, height, fov):
    camera = Camera.from_fov(width, height, fov)
    left, right = camera.unproject([(-0.5, 0), (width - 0.5, 0)])[:, 0]
    assert math.degrees(math.atan(right) - math.atan(left)) == pytest.approx(
        fov, abs=1e-9
    )
    assert camera.fov_x_deg == pytest.approx(fov, abs=1e-9)
    assert (camera.cx, camera.cy) == ((width - 1) / 2, (height - 1) / 2)
    assert camera.fx == camera.fy


@given(cameras, st.floats(0.5, 50))
def test_film_distance_is_fx_times_the_pixel_pitch(camera, pitch):
    """A film at distance v with pixel pitch p: n pixels from the centre have the tangent n p / v."""
    camera = camera.replace(pixel_pitch_um=pitch)
    across = camera.unproject([camera.cx + 10, camera.cy])[0]
    assert across == pytest.approx(10 * pitch * 1e-6 / camera.film_distance, rel=1e-12)
