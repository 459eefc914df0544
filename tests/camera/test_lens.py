"""Lens models against paraxial ray matrices."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from twinlens import optics
from twinlens.camera import (
    BareAperture,
    Camera,
    Pinhole,
    ThinLens,
    film_distance,
)

diameters = st.floats(1e-6, 0.5)
distances = st.floats(0.05, 1e4)
film = st.floats(1e-3, 0.3)


def film_point(
    z: float, height: float, a: float, power: float, film_distance: float
) -> float:
    """Film position, upright, of the ray from (z, height) through the point a of the lens, by ABCD matrices."""
    slope_before = (a - height) / z
    slope_behind = slope_before - power * a
    return -(a + slope_behind * film_distance)


@given(diameters, distances, film, st.floats(0.06, 100))
def test_blur_equals_ray_transfer_matrices(diameter, focus, film_distance, z):
    """The two marginal rays of an axial point are A v |1/z - k| apart on the film."""
    power = 1 / optics.focal_length(focus, film_distance)
    ends = [
        film_point(z, 0.0, a, power, film_distance)
        for a in (-diameter / 2, diameter / 2)
    ]
    k = ThinLens(diameter, focus).vergence
    assert abs(ends[1] - ends[0]) == pytest.approx(
        diameter * film_distance * abs(1 / z - k), abs=1e-12
    )


@given(diameters, film, st.floats(0.06, 100))
def test_a_bare_aperture_has_the_vergence_of_zero_power(diameter, film_distance, z):
    ends = [
        film_point(z, 0.0, a, 0.0, film_distance) for a in (-diameter / 2, diameter / 2)
    ]
    k = BareAperture(diameter, film_distance).vergence
    assert abs(ends[1] - ends[0]) == pytest.approx(
        diameter * film_distance * abs(1 / z - k), abs=1e-12
    )


@given(distances, film)
def test_from_f_number_obeys_the_thin_lens_equation(focus, film_distance):
    """1/f = 1/z + 1/v, and the aperture is f/N."""
    lens = ThinLens.from_f_number(2.8, focus, film_distance)
    f = lens.aperture_diameter * 2.8
    assert 1 / f == pytest.approx(1 / focus + 1 / film_distance, rel=1e-12)
    assert lens.focus_distance == focus


def test_film_distance_of_each_lens():
    camera = Camera(64, 48, 700.0, 700.0, 31.5, 23.5, pixel_pitch_um=3.0)
    assert film_distance(camera, BareAperture(20e-6, 0.05)) == 0.05
    for lens in (Pinhole(), ThinLens(1e-3, 1.0)):
        assert film_distance(camera, lens) == pytest.approx(2.1e-3, rel=1e-12)


def test_a_50_mm_f2_lens_by_hand():
    """50 mm f/2 focused at infinity, with the film in the focal plane: a pupil of 25 mm, and k = 0."""
    lens = ThinLens.from_f_number(2.0, math.inf, 0.05)
    assert lens.aperture_diameter == pytest.approx(0.025, rel=1e-14)
    assert lens.vergence == 0.0


@given(diameters, distances, st.floats(0.05, 100))
def test_blur_is_proportional_to_disparity_from_focus(diameter, focus, z):
    """c = (A/B) |d - d_focus|."""
    fx, baseline = 700.0, 0.12
    blur = optics.circle_of_confusion_px(
        z, diameter, fx, ThinLens(diameter, focus).vergence
    )
    parallax = fx * baseline / z - fx * baseline / focus
    assert blur == pytest.approx(diameter / baseline * parallax, abs=1e-9)


def test_the_film_distance_of_a_bare_aperture_gives_the_pixel_pitch():
    """With a film distance of 50 mm and fx = 500 px, a pixel is 0.1 mm wide."""
    assert Camera(
        64, 48, 500.0, 500.0, 31.5, 23.5, pixel_pitch_um=100.0
    ).film_distance == pytest.approx(0.05)


def test_lenses_are_equal_by_value_and_hashable():
    assert {ThinLens(0.1, 2.0): 1}[ThinLens(0.1, 2.0)] == 1
    assert ThinLens(0.1, 2.0) != ThinLens(0.1, 2.1)
    assert np.isclose(ThinLens(0.1, 2.0).replace(focus_distance=4.0).vergence, 0.25)
