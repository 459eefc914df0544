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
from twinlens.camera.aperture import NUMPY
from twinlens.camera.lens import paraxial_ray

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
class Soft(ApertureLens):
    """A lens with spherical aberration: the ray through the radius r has the vergence k + s r^2."""

    name = "soft"
    aperture_diameter: float
    k: float
    s: float

    def through(self, x, y, ax, ay, xp=NUMPY):
        vergence = self.k + self.s * (ax**2 + ay**2)
        return *paraxial_ray(x, y, ax, ay, vergence), 1.0


@pytest.mark.parametrize("offset", [-0.3, -0.05, 0.0, 0.05, 0.08, 0.1, 0.2, 0.5])
@pytest.mark.parametrize("s", [250.0, -250.0])
def test_spherical_aberration_blurs_where_the_rim_is_sharp(offset, s):
    """2 fx max |r (e - s r^2)| with e = 1/z - k: at the rim, or at r^2 = e / (3 s), where it has the sign of e.

    At e = 0.1 / m the rim is sharp, and the blur circle is 4.62 px wide. 33 points find the largest to 0.6 %.
    """
    lens, rim, fx = Soft(0.04, 0.5, s), 0.02, 3000.0
    widths = [2 * fx * rim * (offset - s * rim**2)]
    if 0 < offset / s < 3 * rim**2:
        widths.append(2 * fx * np.sqrt(offset / (3 * s)) * 2 / 3 * offset)
    expected = max(widths, key=abs)
    for x in (0.0, 0.3):
        blur = lens.blur_px([1 / (0.5 + offset)], fx, x, 0.1)
        assert blur == pytest.approx([expected], rel=0.006, abs=1e-9)


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


class OwnFormulas:
    """What a lens knows better than its base: it vignettes by half, and its film is 0.5 m away."""

    name = "own"
    is_bare = True

    def distance_to_film(self, camera):
        return 0.5

    def irradiance(self, camera):
        return 0.3 * self.aperture_diameter**2

    def relative_light(self, camera):
        return np.full((camera.height, camera.width), 0.5)

    def blur_px(self, depth, fx, x=0.0, y=0.0):
        """That of a vergence of 0.25 / m, whatever the rays say."""
        return optics.circle_of_confusion_px(depth, self.aperture_diameter, fx, 0.25)

    def depth_of_field(self, fx):
        return optics.depth_of_field(self.aperture_diameter, fx, 0.25)


class OwnZoom(OwnFormulas, Zoom):
    """A paraxial lens with formulas of its own."""


class OwnRays(OwnFormulas, Soft):
    """Draws rays from the right half of a square alone, and has chief rays through the middle of that half."""

    def rays(self, x, y, u1, u2, xp=NUMPY):
        radius = 0.5 * self.aperture_diameter
        point = radius * u1, radius * (2 * u2 - 1)
        origin, direction, _ = self.through(x, y, *point, xp)
        return origin, direction, 0.5

    def chief_ray(self, x, y):
        origin, direction, _ = self.through(x, y, self.aperture_diameter / 4, 0.0)
        return origin, direction


@pytest.mark.parametrize("lens", [OwnZoom(0.02, 0.4), OwnRays(0.02, 0.4, 9.0)])
@pytest.mark.parametrize("defocus", [0.0, 0.1, -0.3])
def test_an_adjusted_lens_keeps_the_formulas_of_its_lens(lens, defocus):
    """With another A and k: light in proportion to A^2, blur A fx (1/z - k), depth of field 1/z = k +- c / (A fx)."""
    camera = Camera(6, 4, 700.0, 700.0, 2.5, 1.5)
    half = lens.adjusted(2.0, 0.0).adjusted(1.0, defocus)
    assert (half.name, half.is_bare) == ("own", True)
    assert isinstance(half, Paraxial) == isinstance(lens, Paraxial)
    assert film_distance(camera, half) == 0.5
    assert half.irradiance(camera) == pytest.approx(0.3 * 0.01**2)
    assert (half.relative_light(camera) == 0.5).all()
    depth = np.array([0.7, 3.0, math.inf])
    blur = optics.circle_of_confusion_px(depth, 0.01, 700.0, 0.25 + defocus)
    assert half.blur_px(depth, 700.0) == pytest.approx(blur, abs=1e-12)
    expected = optics.depth_of_field(0.01, 700.0, 0.25 + defocus)
    assert half.depth_of_field(700.0) == pytest.approx(expected)


def test_an_adjusted_lens_draws_the_rays_of_its_lens_and_keeps_chief_rays():
    """From the points a/N, tilted by the defocus; the blur of a lens without a formula is that of these rays."""
    lens = OwnRays(0.02, 0.4, 9.0)
    adjusted = lens.adjusted(2.0, 0.1)
    origin, direction, weight = adjusted.rays(0.1, 0.2, 0.6, 0.9)
    point = 0.01 * 0.6 / 2, 0.01 * 0.8 / 2
    tilted = Soft(0.02, 0.5, 9.0).through(0.1, 0.2, *point)
    assert origin == pytest.approx(tilted[0])
    assert direction == pytest.approx(tilted[1])
    assert weight == 0.5
    assert adjusted.chief_ray(0.1, 0.2) == lens.chief_ray(0.1, 0.2)
    soft = Soft(0.02, 0.4, 9.0).adjusted(2.0, 0.0).adjusted(1.0, 0.1)
    expected = Soft(0.01, 0.5, 9.0).blur_px(3.0, 700.0)
    assert soft.blur_px(3.0, 700.0) == pytest.approx(expected, abs=1e-12)


def test_a_depth_of_field_without_an_end_has_no_known_middle():
    """(near, inf) says nothing of k, so that it is not known for another k or A."""
    lens = OwnZoom(1e-3, 0.4)
    assert lens.depth_of_field(700.0)[1] == math.inf
    assert lens.adjusted(2.0, 0.1).depth_of_field(700.0) is None
    assert lens.adjusted(1.0, 0.0).depth_of_field(700.0) == lens.depth_of_field(700.0)


def test_the_light_of_a_lens_without_formulas_of_its_own():
    """E/L = pi/4 (A/v)^2 on the axis, and cos^4 = 1/4 at 45 degrees."""
    camera = Camera(101, 3, 50.0, 50.0, 50.0, 1.0)
    lens = Zoom(camera.film_distance / 2)
    assert lens.irradiance(camera) == pytest.approx(math.pi / 16)
    assert lens.relative_light(camera)[1, [50, 100]] == pytest.approx([1, 0.25])
    smaller = lens.adjusted(2.0, 0.0)  # a lens without a barrel still has none
    assert (smaller.relative_light(camera) == lens.relative_light(camera)).all()
    assert lens.depth_of_field(700.0) == optics.depth_of_field(
        lens.aperture_diameter, 700.0, 0.0
    )
