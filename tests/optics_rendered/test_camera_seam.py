"""A camera needs a projection and nothing else: an equidistant fisheye of 200 degrees, which is in this file only."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

import twinlens as tl
from tests.optics_rendered.optics_lights import BLACK, HERE, centroid, grey
from twinlens.camera import KannalaBrandt, chief_rays
from twinlens.camera.distortion import FilmProjection
from twinlens.scenes import Scene, SceneObject

SIDE = 121
FX = SIDE / math.radians(200)


class Equidistant(FilmProjection):
    """A film point at the distance theta from the axis, for the angle theta up to 180 degrees."""

    def project(self, directions):
        across = np.linalg.norm(directions[..., :2], axis=-1, keepdims=True)
        angle = np.arctan2(across, directions[..., 2:])
        return angle * directions[..., :2] / np.where(across > 0, across, 1.0)

    def unproject(self, film):
        angle = np.linalg.norm(film, axis=-1, keepdims=True)
        across = film * np.sinc(angle / np.pi)
        return np.concatenate([across, np.cos(angle)], axis=-1)


class Fisheye(tl.Camera):
    projection = Equidistant()


CAMERA = Fisheye(SIDE, SIDE, FX, FX, 60.0, 60.0)
RIG = tl.Rig([CAMERA], [HERE])


def direction(angle_deg: float, turn_deg: float) -> np.ndarray:
    """The unit direction at an angle from the axis, turned from +x (right) towards +y (down)."""
    angle, turn = math.radians(angle_deg), math.radians(turn_deg)
    across = math.sin(angle)
    return np.array([across * math.cos(turn), across * math.sin(turn), math.cos(angle)])


def pixel(angle_deg: float, turn_deg: float) -> np.ndarray:
    """Its pixel in an equidistant image."""
    radius, turn = FX * math.radians(angle_deg), math.radians(turn_deg)
    return 60.0 + radius * np.array([math.cos(turn), math.sin(turn)])


def bulb(angle_deg: float, turn_deg: float, distance: float, radius: float) -> Scene:
    """A ball of light of radiance 1."""
    pose = np.diag([radius, radius, radius, 1.0])
    pose[:3, 3] = distance * direction(angle_deg, turn_deg)
    light = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    ball = SceneObject("bulb", {"type": "sphere"}, "black", pose, light)
    path = {"type": "path", "max_depth": 2}
    return Scene("bulb", (ball,), {"black": BLACK}, HERE, (0.2, 20.0), {}, path)


@given(st.floats(0, 139), st.floats(0, 360), st.floats(0.1, 100))
def test_projection_and_rays_are_inverse(angle, turn, distance):
    ray = direction(angle, turn)
    np.testing.assert_allclose(CAMERA.project(distance * ray), pixel(angle, turn))
    np.testing.assert_allclose(CAMERA.rays(pixel(angle, turn)), ray, atol=1e-12)


def test_it_is_wide_and_sees_200_degrees():
    assert CAMERA.is_wide
    assert CAMERA.fov_x_deg == pytest.approx(200.0)
    assert not tl.Camera.from_fov(64, 48, 170.0).is_wide


def test_ideal_coordinates_end_at_90_degrees():
    ideal = CAMERA.unproject([pixel(80, 30), pixel(95, 30)])
    expected = direction(80, 30) / direction(80, 30)[2]
    np.testing.assert_allclose(ideal[0], expected, rtol=1e-9)
    assert np.isnan(ideal[1, :2]).all()


def test_a_fisheye_of_kannala_and_brandt_may_exceed_90_degrees():
    """Without coefficients it is equidistant."""
    camera = tl.Camera(SIDE, SIDE, FX, FX, 60.0, 60.0, KannalaBrandt())
    assert camera.is_wide
    grid = camera.pixel_grid()
    np.testing.assert_allclose(camera.rays(grid), CAMERA.rays(grid), atol=1e-12)
    points = 3.0 * CAMERA.rays(grid)
    np.testing.assert_allclose(camera.project(points), grid, atol=1e-9)


def test_a_fisheye_with_coefficients_inverts_its_polynomial():
    """theta_d of each pixel's angle, written out, is the pixel's distance from the axis."""
    k = (-0.02, 0.003, -0.0004, 0.00001)
    camera = tl.Camera(SIDE, SIDE, FX, FX, 60.0, 60.0, KannalaBrandt(*k))
    grid = camera.pixel_grid()
    x, y, z = np.moveaxis(camera.rays(grid), -1, 0)
    t = np.arctan2(np.hypot(x, y), z)
    film_radius = t * (1 + k[0] * t**2 + k[1] * t**4 + k[2] * t**6 + k[3] * t**8)
    u, v = np.moveaxis(grid - 60.0, -1, 0)
    np.testing.assert_allclose(FX * film_radius, np.hypot(u, v), atol=1e-9)
    np.testing.assert_allclose(np.hypot(x, y) * np.hypot(u, v), x * u + y * v)
    assert t.max() > math.radians(120)


@pytest.mark.parametrize("angle", [20, 80, 97])
def test_a_bulb_lands_where_its_angle_says(angle):
    """Solid angle 2 pi (1 - cos a), sin a = r/d; the film has theta / sin(theta) FX^2 pixels per steradian."""
    spp = 256
    image = grey(tl.render(bulb(angle, 200, 2.0, 0.2), RIG, spp=spp, seed=1)[0])
    theta = math.radians(angle)
    solid_angle = 2 * math.pi * (1 - math.sqrt(1 - 0.1**2))
    area = FX**2 * theta / math.sin(theta) * solid_angle
    assert image.sum() == pytest.approx(area, rel=0.01)
    assert np.abs(centroid(image) - pixel(angle, 200)).max() < 0.05


def test_other_lenses_than_a_pinhole_are_refused():
    lens = tl.ThinLens(0.01, 2.0)
    expected = "90 degrees or more from its axis needs a Pinhole, got the lens 'thin"
    with pytest.raises(tl.TwinlensError, match=expected):
        tl.render(bulb(20, 0, 2.0, 0.1), RIG, lens)
    with pytest.raises(tl.TwinlensError, match=expected):
        chief_rays(CAMERA, lens, [0.0, 0.0])
