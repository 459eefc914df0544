"""Lens models against paraxial ray matrices."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, strategies as st

from twinlens import optics
from twinlens.camera import (
    ApertureLens,
    BareAperture,
    Camera,
    Paraxial,
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


def test_lenses_are_equal_by_value_and_hashable():
    assert {ThinLens(0.1, 2.0): 1}[ThinLens(0.1, 2.0)] == 1
    assert ThinLens(0.1, 2.0) != ThinLens(0.1, 2.1)
    assert np.isclose(ThinLens(0.1, 2.0).replace(focus_distance=4.0).vergence, 0.25)


@given(diameters, distances, st.floats(0.05, 100))
def test_blur_is_proportional_to_disparity_from_focus(diameter, focus, z):
    """c = (A/B) |d - d_focus|."""
    fx, baseline = 700.0, 0.12
    parallax = fx * baseline / z - fx * baseline / focus
    blur = ThinLens(diameter, focus).blur_px(z, fx)
    assert blur == pytest.approx(diameter / baseline * parallax, abs=1e-9)


@dataclass(frozen=True)
class Measured(ThinLens):
    """A thin lens whose blur is that of its rays."""

    def blur_px(self, depth, fx, x=0.0, y=0.0):
        return ApertureLens.blur_px(self, depth, fx, x, y)


@given(diameters, distances, st.floats(0.05, 100), st.floats(-1, 1), st.floats(-1, 1))
def test_the_blur_of_marginal_rays_is_the_closed_form(diameter, focus, z, x, y):
    lens, measured = ThinLens(diameter, focus), Measured(diameter, focus)
    for depth in (z, math.inf):
        expected = lens.blur_px(depth, 700.0)
        assert measured.blur_px(depth, 700.0, x, y) == pytest.approx(expected, abs=1e-9)


@dataclass(frozen=True)
class Zoom(Paraxial):
    """A paraxial lens with the least that one needs."""

    name = "zoom"
    aperture_diameter: float
    vergence: float = 0.0


@given(diameters, st.floats(-3, 3), st.floats(0.5, 2), st.floats(-1, 1))
def test_an_adjusted_lens_has_a_smaller_aperture_and_another_vergence(
    diameter, vergence, f_number, defocus
):
    """The ray through the point a of the adjusted aperture is tilted by the defocus times a."""
    for lens in (
        Zoom(diameter, vergence),
        ThinLens(diameter, 1.0, defocus=vergence - 1),
    ):
        adjusted = lens.adjusted(f_number, defocus)
        assert adjusted.aperture_diameter == pytest.approx(diameter / f_number)
        assert adjusted.vergence == pytest.approx(vergence + defocus, abs=1e-12)
        general = ApertureLens.adjusted(lens, f_number, defocus)
        for ours, theirs in zip(
            general.rays(0.1, 0.2, 0.7, 0.3),
            adjusted.rays(0.1, 0.2, 0.7, 0.3),
            strict=True,
        ):
            assert np.allclose(ours, theirs, rtol=0, atol=1e-12)


def test_the_light_of_a_lens_without_formulas_of_its_own():
    """E/L = pi/4 (A/v)^2 on the axis, and cos^4 = 1/4 at 45 degrees."""
    camera = Camera(101, 3, 50.0, 50.0, 50.0, 1.0)
    lens = Zoom(camera.film_distance / 2)
    assert lens.irradiance(camera) == pytest.approx(math.pi / 16)
    assert lens.relative_light(camera)[1, [50, 100]] == pytest.approx([1, 0.25])
    assert lens.depth_of_field(700.0) == optics.depth_of_field(
        lens.aperture_diameter, 700.0, 0.0
    )
