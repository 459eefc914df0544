"""A camera needs a projection and nothing else: an equidistant fisheye of 200 degrees, which is in this file only."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, centroid, glow, grey, scene_of
from twinlens.camera import KannalaBrandt, chief_rays
from twinlens.camera.distortion import FilmProjection
from twinlens.scenes import SceneObject

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
    angle = math.radians(angle_deg)
    turn = math.radians(turn_deg)
    across = math.sin(angle)
    return np.array([across * math.cos(turn), across * math.sin(turn), math.cos(angle)])


def pixel(angle_deg: float, turn_deg: float) -> np.ndarray:
    """Its pixel in an equidistant image."""
    radius = FX * math.radians(angle_deg)
    turn = math.radians(turn_deg)
    return 60.0 + radius * np.array([math.cos(turn), math.sin(turn)])


def bulb(angle_deg: float, turn_deg: float) -> tl.Scene:
    """A ball of light of radiance 1 and radius 0.2 m at 2 m."""
    pose = np.diag([0.2, 0.2, 0.2, 1.0])
    pose[:3, 3] = 2.0 * direction(angle_deg, turn_deg)
    return scene_of(SceneObject("bulb", {"type": "sphere"}, "black", pose, glow(1.0)))


@given(st.floats(0, 139), st.floats(0, 360), st.floats(0.1, 100))
def test_projection_and_rays_are_inverse(angle, turn, distance):
    ray = direction(angle, turn)
    np.testing.assert_allclose(CAMERA.project(distance * ray), pixel(angle, turn))
    np.testing.assert_allclose(CAMERA.rays(pixel(angle, turn)), ray, atol=1e-12)


def test_it_is_wide_and_its_ideal_coordinates_end_at_90_degrees():
    assert CAMERA.is_wide
    assert CAMERA.fov_x_deg == pytest.approx(200.0)
    assert not tl.Camera.from_fov(64, 48, 170.0).is_wide
    ideal = CAMERA.unproject([pixel(80, 30), pixel(95, 30)])
    expected = direction(80, 30) / direction(80, 30)[2]
    np.testing.assert_allclose(ideal[0], expected, rtol=1e-9)
    assert np.isnan(ideal[1, :2]).all()


@pytest.mark.parametrize("k", [(0, 0, 0, 0), (-0.02, 0.003, -0.0004, 0.00001)])
def test_a_fisheye_of_kannala_and_brandt_inverts_its_polynomial_beyond_90_degrees(k):
    """theta_d of each pixel's angle, written out, is the pixel's distance from the axis."""
    camera = tl.Camera(SIDE, SIDE, FX, FX, 60.0, 60.0, KannalaBrandt(*k))
    assert camera.is_wide
    grid = camera.pixel_grid()
    rays = camera.rays(grid)
    np.testing.assert_allclose(camera.project(3.0 * rays), grid, atol=1e-9)
    x, y, z = np.moveaxis(rays, -1, 0)
    t = np.arctan2(np.hypot(x, y), z)
    film_radius = t * (1 + k[0] * t**2 + k[1] * t**4 + k[2] * t**6 + k[3] * t**8)
    u, v = np.moveaxis(grid - 60.0, -1, 0)
    np.testing.assert_allclose(FX * film_radius, np.hypot(u, v), atol=1e-9)
    np.testing.assert_allclose(np.hypot(x, y) * np.hypot(u, v), x * u + y * v)
    assert t.max() > math.radians(120)


@pytest.mark.parametrize("angle", [20, 80, 97])
def test_a_bulb_lands_where_its_angle_says(angle):
    """Solid angle 2 pi (1 - cos a), sin a = r/d; the film has theta / sin(theta) FX^2 pixels per steradian."""
    image = grey(tl.render(bulb(angle, 200), RIG, spp=256, seed=1)[0])
    theta = math.radians(angle)
    solid_angle = 2 * math.pi * (1 - math.sqrt(1 - 0.1**2))
    area = FX**2 * theta / math.sin(theta) * solid_angle
    assert image.sum() == pytest.approx(area, rel=0.01)
    assert np.abs(centroid(image) - pixel(angle, 200)).max() < 0.05


def test_other_lenses_than_a_pinhole_are_refused():
    lens = tl.ThinLens(0.01, 2.0)
    expected = "90 degrees or more from its axis needs a Pinhole, got the lens 'thin"
    with pytest.raises(tl.TwinlensError, match=expected):
        tl.render(bulb(20, 0), RIG, lens)
    with pytest.raises(tl.TwinlensError, match=expected):
        chief_rays(CAMERA, lens, [0.0, 0.0])
