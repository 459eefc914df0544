"""Images of parts of an aperture: they add up to the whole image, and halves see a small light apart."""

import math

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    centroid,
    chequered_room,
    grey,
    lamps,
    square_camera,
)
from twinlens.rendering import render_measured

CAMERA = tl.Camera(48, 36, 50.0, 50.0, 23.5, 17.5)
RIG = tl.Rig([CAMERA], [HERE])
LENS = tl.ThinLens(0.05, 2.0)
STOPPED = tl.ThinLens(0.02, 3.0)
HOLE = tl.BareAperture(0.01, 0.5)
BLADES = tl.ThinLens(0.05, 2.0, tl.Polygon(5, 20.0, 0.3))
LETTER = np.array([[1, 0, 0.3], [0.5, 0.2, 0.9], [1, 1, 0.0]])
PARTS = {"dual": tl.Dual(), "top, bottom": tl.Dual("y"), "quad": tl.Quad(), "grid": tl.Grid(3),
         "masks": tl.Masks([LETTER, 1 - LETTER])}  # fmt: skip


def names(*quick):
    """All names, of which others than these are slow."""
    slow = (pytest.param(name, marks=pytest.mark.slow) for name in {*PARTS} - {*quick})
    return pytest.mark.parametrize("name", [*quick, *sorted(slow)])


@pytest.fixture(scope="module")
def room():
    return chequered_room()


def assert_adds_up(parts, whole, relative=1e-6):
    total = parts.sum(axis=0)
    bound = relative * whole.max()
    np.testing.assert_allclose(total, whole, rtol=0, atol=bound)


@names("masks")
@pytest.mark.parametrize("lens", [LENS, HOLE, BLADES])
def test_parts_add_up_to_the_whole_image(room, name, lens):
    whole = tl.render(room, RIG, lens, spp=12, seed=1)[0]
    parts = tl.render(room, RIG, lens, spp=12, seed=1, parts=PARTS[name])[0]
    assert parts.dtype == np.float32
    assert parts.shape == (len(PARTS[name]), *whole.shape)
    assert_adds_up(parts, whole)


@pytest.mark.parametrize("denoise", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_measured_parts_have_the_error_of_the_whole_image(room, denoise):
    (whole,), _ = render_measured(room, RIG, LENS, 4, 1, denoise=denoise)
    (parts,), _ = render_measured(room, RIG, LENS, 4, 1, denoise=denoise, parts=tl.Dual())  # fmt: skip
    assert parts.image.shape == (2, *whole.image.shape)
    assert_adds_up(parts.image, whole.image, 1e-5)
    bound = 1e-5 * whole.image.max()
    np.testing.assert_allclose(parts.error, whole.error, rtol=0, atol=bound)


@pytest.mark.parametrize("name", ["dual", pytest.param("grid", marks=pytest.mark.slow)])
def test_parts_of_a_lens_grid_add_up_to_its_images(room, name):
    """Those of the blades, which are rendered alone, have other seeds."""
    lenses = [LENS, STOPPED, HOLE, BLADES]
    whole = tl.render_lens_grid(room, RIG, lenses, spp=12, seed=1)
    parts = tl.render_lens_grid(room, RIG, lenses, spp=12, seed=1, parts=PARTS[name])
    for of_whole, of_parts in zip(whole[:3], parts[:3], strict=True):
        assert_adds_up(of_parts[0], of_whole[0])
    np.testing.assert_array_equal(parts.standard_error[:3], whole.standard_error[:3])
    assert parts[3][0].sum() == pytest.approx(whole[3][0].sum(), rel=0.02)


def test_denoised_parts_add_up_to_the_denoised_image(room):
    options = {"spp": 8, "seed": 1, "denoise": True}
    whole = tl.render(room, RIG, LENS, **options)[0]
    parts = tl.render(room, RIG, LENS, **options, parts=tl.Dual())[0]
    assert parts.min() >= 0
    assert_adds_up(parts, whole, 1e-5)
    black = tl.Masks([np.zeros((2, 2))])
    assert not tl.render(room, RIG, LENS, **options, parts=black)[0].any()


def test_halves_of_a_lens_grid_equal_halves_rendered_alone(room):
    """Independent samples of the same halves, within the noise that their difference shows."""
    lenses = [LENS, STOPPED]
    dual = tl.Dual()
    alone = grey(tl.render(room, RIG, LENS, spp=256, seed=2, parts=dual)[0][0])
    for seed in range(3):
        grid = tl.render_lens_grid(room, RIG, lenses, spp=256, seed=seed, parts=dual)
        difference = grey(grid[0][0][0]) - alone
        assert abs(difference.mean()) < 0.005 * alone.mean()
        assert difference.std() < 0.05 * alone.mean()


@pytest.mark.parametrize(("depth", "axis"), [(0.5, "x"), (1.6, "y")])
def test_halves_see_a_small_light_apart(depth, axis):
    """Their centroids are 4/(3 pi) of the signed blur circle apart: positive, as a disparity, nearer than the focus."""
    fx, focus, aperture, spp, repeats = 400.0, 1.0, 0.05, 1024, 16
    scene = lamps([(0.0, 0.0, depth)], 1.0 * depth / fx)
    rig = tl.Rig([square_camera(35, fx)], [HERE])
    lens = tl.ThinLens(aperture, focus)
    parts = tl.Dual(axis)
    images = np.mean(
        [tl.render(scene, rig, lens, spp, k, parts=parts)[0] for k in range(repeats)],
        axis=0,
    )
    first, second = (centroid(grey(image))["xy".index(axis)] for image in images)
    signed = aperture * fx * (1 / depth - 1 / focus)
    assert first - second == pytest.approx(4 / (3 * math.pi) * signed, rel=0.01)
    light = images.sum(axis=(1, 2, 3))
    hits = repeats * spp * light[0] / 3
    assert light[0] == pytest.approx(light[1], rel=4 * math.sqrt(2 / hits))
