"""A new lens: one that shears and has rays and nothing else, and an anamorphic one for samples."""

import json
import subprocess
import sys

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.anamorphic import LENS
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
from twinlens.factory import Shoot, make_sample

FX = 300.0
SIDE = 61
SHEAR = 0.1
HALF_WIDTH = 0.02
"""Metres: of the square of the aperture."""

CAMERA = square_camera(SIDE, FX)
RIG = tl.Rig([CAMERA], [HERE])
SCENE = lamps([(0.0, 0.0, 1.0)], 0.01)
BRIGHT = np.ones((SIDE, SIDE, 3))


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


NEEDS_A_PURE_SHIFT = {
    "lens grid": lambda lens: tl.render_lens_grid(SCENE, RIG, [lens], spp=1),
    "image of the parts": lambda lens: tl.render(
        SCENE, RIG, lens, spp=1, parts=tl.Dual()
    ),
    "parts of an aperture": lambda lens: tl.dual_pixel_disparity(
        np.ones((SIDE, SIDE)), CAMERA, lens
    ),
    "division of the aperture": lambda lens: tl.aperture_points(lens),
    "light field": lambda lens: tl.light_field_rig(CAMERA, lens, 3),
    "refocusing": lambda lens: tl.refocus([BRIGHT], RIG, lens),
}
NEEDS_AN_APERTURE = {
    "diffraction": lambda lens: tl.diffract(BRIGHT, CAMERA, lens),
    "exposure": lambda lens: tl.Sensor().expose(BRIGHT, camera=CAMERA, lens=lens),
    "mismatch": lambda lens: tl.Sensor().lenses(RIG, lens),
    "sample": lambda lens: make_sample(SCENE, RIG, [lens], Shoot(spp=1)),
}
A_PARAXIAL = "a paraxial lens (one shift of all rays for each point of the aperture, as ThinLens has)"
AN_OPEN = "a lens with an aperture (an ApertureLens, as ThinLens is)"


@pytest.mark.parametrize(
    ("uses", "lens", "needed"),
    [
        (NEEDS_A_PURE_SHIFT, Shear(), A_PARAXIAL),
        (NEEDS_A_PURE_SHIFT, LENS, A_PARAXIAL),
        (NEEDS_AN_APERTURE, Shear(), AN_OPEN),
    ],
)
def test_a_lens_is_refused_in_one_line_by_what_needs_more_of_it(uses, lens, needed):
    for name, use in uses.items():
        with pytest.raises(tl.TwinlensError) as error:
            use(lens)
        purpose, _, rest = str(error.value).partition(" needs ")
        assert rest == f"{needed}, got the lens {lens.name!r}", name
        assert name in purpose


@pytest.mark.parametrize("defocus", [0.0, 0.15])
@pytest.mark.parametrize(
    "depth",
    [0.8, 2.6, *(pytest.param(z, marks=pytest.mark.slow) for z in (2.0, 3.5, 8.0))],
)
def test_an_anamorphic_lens_blurs_across_and_down_by_two_foci(depth, defocus):
    """A light becomes an ellipse with the diameters A fx |1/z - kx| and A fy |1/z - ky|.

    A uniform ellipse has the second moments c^2/16; those of the light, a disk, and of pixels add. A mismatch of focus
    adds to both vergences.
    """
    light_px = 4.0
    lens = LENS.adjusted(f_number=1.0, defocus=defocus)
    lights = lamps([(0, 0, depth)], light_px * depth / FX)
    image = grey(tl.render(lights, RIG, lens, spp=1024)[0])
    vergences = np.array([1 / LENS.focus_x, 1 / LENS.focus_y]) + defocus
    diameters = FX * LENS.aperture_diameter * (1 / depth - vergences)
    expected = diameters**2 / 16 + light_px**2 / 4 + 1 / 12
    np.testing.assert_allclose(second_moments(image), expected, rtol=0.02)
    assert lens.blur_px(depth, FX) == pytest.approx(diameters[0], abs=1e-9)


def second_moments(image):
    """Mean squared distances from the centroid across and down, px^2."""
    v, u = np.mgrid[:SIDE, :SIDE]
    middle_u, middle_v = centroid(image)
    across = ((u - middle_u) ** 2 * image).sum() / image.sum()
    down = ((v - middle_v) ** 2 * image).sum() / image.sum()
    return [across, down]


def test_the_blur_of_rays_is_signed_and_known_at_every_film_point():
    """A (fx/z - fx k), at infinity too, and at points off the axis, as a pure shift does not depend on them."""
    depth = np.array([1.0, 2.0, np.inf])
    expected = FX * 0.02 * (1 / depth - 0.5)
    for x in (0.0, -0.3, 0.4):
        np.testing.assert_allclose(LENS.blur_px(depth, FX, x, 0.2), expected, atol=1e-9)


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    """What the commands did with the anamorphic lens, and the folder where they did it."""
    folder = tmp_path_factory.mktemp("anamorphic")
    program = [sys.executable, "-m", "tests.optics_rendered.anamorphic", str(folder)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1]), folder


def test_samples_of_a_new_lens_are_made_verified_and_made_again(commands):
    results, folder = commands
    assert [code for code, _ in results["codes"]] == [0] * 4, results["codes"]
    printed = results["codes"][0][1]
    assert "blur circle" in printed
    assert "sharp to" not in printed  # a lens with two foci has no one depth of field
    assert results["lens"] == repr(LENS.replace(aperture=tl.Polygon(6)))
    assert results["same_again"]
    assert "vergence" not in results["blur_is"]  # it has two
    maps = np.load(folder / "maps.npz")
    for name in ("rendered", "generated"):
        depth, blur = maps[f"{name}_depth"], maps[f"{name}_blur"]
        expected = (
            results["fx"] * LENS.aperture_diameter * (1 / depth - 1 / LENS.focus_x)
        )
        np.testing.assert_allclose(blur, expected, rtol=1e-5, atol=1e-6)


def test_a_paraxial_lens_cannot_replace_its_rays():
    """Lens grids share light paths by aperture and vergence alone."""
    for name in ("rays", "through", "chief_ray"):
        with pytest.raises(TypeError, match=f"must not replace '{name}'"):
            type("Zoom", (tl.ThinLens,), {name: lambda self: None})
