"""A lens needs `rays` and `chief_ray` and nothing else: a lens that shears, which is in this file only."""

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    centroid,
    grey,
    lamps,
    spread,
    square_camera,
)
from twinlens.camera import Lens, chief_rays
from twinlens.camera.aperture import NUMPY

FX = 300.0
SIDE = 61
SHEAR = 0.1
HALF_WIDTH = 0.02
"""Metres: of the square of the aperture."""

CAMERA = square_camera(SIDE, FX)
RIG = tl.Rig([CAMERA], [HERE])


class Shear(Lens):
    """Looks along (x + SHEAR y, y, 1) through each point of a square aperture whose right half is dark."""

    name = "shear"

    def rays(self, x, y, u1, u2, xp=NUMPY):
        width = xp.constant(HALF_WIDTH)
        shear = xp.constant(SHEAR)
        origin = width * (2.0 * u1 - 1.0), width * (2.0 * u2 - 1.0), 0.0
        clear = xp.where(u1 < 0.5, 1.0, 0.0)
        return origin, (x + shear * y, y, 1.0), clear

    def chief_ray(self, x, y):
        return (0.0, 0.0, 0.0), (x + SHEAR * y, y, 1.0)


def pixel_of(x: float, y: float, z: float) -> np.ndarray:
    """Where the ray through the point (x, y, z) starts, if it goes through the middle of the aperture."""
    u = FX * (x / z - SHEAR * y / z) + CAMERA.cx
    return np.array([u, FX * y / z + CAMERA.cy])


@pytest.mark.parametrize("point", [(0.03, 0.05, 1.0), (-0.06, 0.1, 2.0)])
def test_a_light_lands_where_the_sheared_ray_starts(point):
    """Through the clear half of the aperture, a in [-w, 0] x [-w, w]: its centroid is at X - a = X + w/2.

    The sum over pixels of the radiance is the light's area in pixels, halved by the dark half. The variance of the
    image is that of a rectangle of FX w / z by 2 FX w / z, plus that of the light.
    """
    x, y, z = point
    radius = 0.004 * z
    image = grey(tl.render(lamps([point], radius), RIG, Shear(), spp=4096, seed=1)[0])
    expected = pixel_of(x + 0.5 * HALF_WIDTH, y, z)
    width = FX * HALF_WIDTH / z
    light_px = FX * radius / z
    area = np.pi * light_px**2
    variance = (width**2 + (2 * width) ** 2) / 12 + light_px**2 / 2
    deviation = np.sqrt(variance / (image.sum() * 4096))
    assert np.abs(centroid(image) - expected).max() < 4 * deviation
    assert image.sum() == pytest.approx(0.5 * area, rel=0.02)
    assert spread(image) == pytest.approx(variance, rel=0.03)


def test_chief_rays_follow_the_lens():
    origins, directions = chief_rays(CAMERA, Shear(), [[30.0, 30.0], [45.0, 60.0]])
    assert origins.tolist() == [[0, 0, 0], [0, 0, 0]]
    expected = [[0, 0, 1], [0.05 + SHEAR * 0.1, 0.1, 1]]
    np.testing.assert_allclose(directions, expected, rtol=0, atol=1e-15)


def test_guides_and_denoising_need_nothing_more():
    scene = lamps([(0.0, 0.0, 1.0)], 0.05)
    image = tl.render(scene, RIG, Shear(), spp=16, seed=0, denoise=True)[0]
    shift = 0.5 * FX * HALF_WIDTH
    assert np.abs(centroid(grey(image)) - pixel_of(0, 0, 1) - (shift, 0)).max() < 0.3


NEEDS_A_PURE_SHIFT = {
    "lens grid": lambda scene: tl.render_lens_grid(scene, RIG, [Shear()], spp=1),
    "image of the parts": lambda scene: tl.render(
        scene, RIG, Shear(), spp=1, parts=tl.Dual()
    ),
    "parts of an aperture": lambda scene: tl.dual_pixel_disparity(
        np.ones((SIDE, SIDE)), CAMERA, Shear()
    ),
    "division of the aperture": lambda scene: tl.aperture_points(Shear()),
    "light field": lambda scene: tl.light_field_rig(CAMERA, Shear(), 3),
    "refocusing": lambda scene: tl.refocus([np.ones((SIDE, SIDE, 3))], RIG, Shear()),
    "diffraction": lambda scene: tl.diffract(np.ones((SIDE, SIDE, 3)), CAMERA, Shear()),
    "exposure": lambda scene: tl.Sensor().expose(
        np.ones((SIDE, SIDE, 3)), camera=CAMERA, lens=Shear()
    ),
}


def test_tricks_that_need_a_pure_shift_refuse_it_in_one_line():
    scene = lamps([(0.0, 0.0, 1.0)], 0.01)
    for name, trick in NEEDS_A_PURE_SHIFT.items():
        with pytest.raises(tl.TwinlensError) as error:
            trick(scene)
        purpose, _, rest = str(error.value).partition(" needs ")
        allowed = "(Pinhole, ThinLens or BareAperture)"
        assert rest == f"a paraxial lens {allowed}, got the lens 'shear'", name
        assert name in purpose
