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
from twinlens.errors import InputError
from twinlens.rendering import render_measured

CAMERA = tl.Camera(48, 36, 50.0, 50.0, 23.5, 17.5)
RIG = tl.Rig([CAMERA], [HERE])
LENSES = {
    "lens": tl.ThinLens(0.05, 2.0),
    "stopped lens": tl.ThinLens(0.02, 3.0),
    "bare hole": tl.BareAperture(0.01, 0.5),
    "five blades": tl.ThinLens(0.05, 2.0, tl.Polygon(5, 20.0, 0.3)),
}
LETTER = np.array([[1, 0, 0.3], [0.5, 0.2, 0.9], [1, 1, 0.0]])
PARTS = {"dual": tl.Dual(), "top, bottom": tl.Dual("y"), "quad": tl.Quad(), "grid": tl.Grid(3),
         "masks": tl.Masks([LETTER, 1 - LETTER])}  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name == "masks" else pytest.mark.slow)
        for name in PARTS
    ],
)
def test_parts_add_up_to_the_whole_image(name):
    scene = chequered_room()
    for lens in (LENSES["lens"], LENSES["bare hole"], LENSES["five blades"]):
        whole = tl.render(scene, RIG, lens, spp=12, seed=1)[0]
        parts = tl.render(scene, RIG, lens, spp=12, seed=1, parts=PARTS[name])[0]
        assert parts.dtype == np.float32
        assert parts.shape == (len(PARTS[name]), *whole.shape)
        np.testing.assert_allclose(
            parts.sum(axis=0), whole, rtol=0, atol=1e-6 * whole.max()
        )


@pytest.mark.parametrize("denoise", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_measured_parts_have_the_error_of_the_whole_image(denoise):
    scene, lens = chequered_room(), LENSES["lens"]
    how = {
        "scene": scene,
        "rig": RIG,
        "lens": lens,
        "spp": 4,
        "seed": 1,
        "denoise": denoise,
    }
    (whole,), _ = render_measured(**how)
    (parts,), _ = render_measured(**how, parts=tl.Dual())
    assert parts.image.shape == (2, *whole.image.shape)
    np.testing.assert_allclose(
        parts.image.sum(axis=0), whole.image, rtol=0, atol=1e-5 * whole.image.max()
    )
    np.testing.assert_allclose(
        parts.error, whole.error, rtol=0, atol=1e-5 * whole.image.max()
    )


@pytest.mark.parametrize("name", ["dual", pytest.param("grid", marks=pytest.mark.slow)])
def test_parts_of_a_lens_grid_add_up_to_its_images(name):
    scene, lenses = chequered_room(), list(LENSES.values())
    whole = tl.render_lens_grid(scene, RIG, lenses, spp=12, seed=1)
    parts = tl.render_lens_grid(scene, RIG, lenses, spp=12, seed=1, parts=PARTS[name])
    for one, several in zip(
        whole[:3], parts[:3], strict=True
    ):  # the blades are rendered with other seeds alone
        np.testing.assert_allclose(
            several[0].sum(axis=0), one[0], rtol=0, atol=1e-6 * one[0].max()
        )
    np.testing.assert_array_equal(parts.standard_error[:3], whole.standard_error[:3])
    assert parts[3][0].sum() == pytest.approx(whole[3][0].sum(), rel=0.02)


def test_denoised_parts_add_up_to_the_denoised_image():
    scene = chequered_room()
    whole = tl.render(scene, RIG, LENSES["lens"], spp=8, seed=1, denoise=True)[0]
    parts = tl.render(
        scene, RIG, LENSES["lens"], spp=8, seed=1, denoise=True, parts=tl.Dual()
    )[0]
    assert parts.min() >= 0
    np.testing.assert_allclose(
        parts.sum(axis=0), whole, rtol=0, atol=1e-5 * whole.max()
    )


def test_denoised_small_parts_have_the_light_of_raw_ones():
    """Of the 32 guide samples of a pixel, about one is in each of 25 parts."""
    scene, cells = chequered_room(), tl.Grid(5)
    raw = tl.render(scene, RIG, LENSES["lens"], spp=256, seed=2, parts=cells)[0]
    denoised = tl.render(
        scene, RIG, LENSES["lens"], spp=16, seed=1, denoise=True, parts=cells
    )[0]
    np.testing.assert_allclose(
        denoised.mean(axis=(1, 2, 3)), raw.mean(axis=(1, 2, 3)), rtol=0.15
    )


def test_parts_without_light_are_black():
    parts = tl.Masks([np.zeros((2, 2))])
    assert not tl.render(
        chequered_room(), RIG, LENSES["lens"], spp=2, denoise=True, parts=parts
    )[0].any()


def test_halves_of_a_lens_grid_equal_halves_rendered_alone():
    """Independent samples of the same halves, within the noise that their difference shows."""
    scene, lens = chequered_room(), LENSES["lens"]
    alone = tl.render(scene, RIG, lens, spp=256, seed=2, parts=tl.Dual())[0]
    for seed in range(3):
        grid = tl.render_lens_grid(
            scene,
            RIG,
            [lens, LENSES["stopped lens"]],
            spp=256,
            seed=seed,
            parts=tl.Dual(),
        )[0][0]
        difference = grey(grid[0]) - grey(alone[0])
        assert abs(difference.mean()) < 0.005 * grey(alone[0]).mean()
        assert difference.std() < 0.05 * grey(alone[0]).mean()


@pytest.mark.parametrize(
    ("depth", "axis"), [(0.5, "x"), (0.7, "y"), (1.6, "y"), (3.0, "x")]
)
def test_halves_see_a_small_light_apart(depth, axis):
    """Their centroids are 4/(3 pi) of the signed blur circle apart: positive, as a disparity, nearer than the focus."""
    fx, focus, aperture = 400.0, 1.0, 0.05
    scene = lamps([(0.0, 0.0, depth)], 1.0 * depth / fx)
    rig = tl.Rig([square_camera(35, fx)], [HERE])
    lens = tl.ThinLens(aperture, focus)
    images = np.mean(
        [
            tl.render(scene, rig, lens, 1024, seed, parts=tl.Dual(axis))[0]
            for seed in range(16)
        ],
        axis=0,
    )
    first, second = (centroid(grey(image))["xy".index(axis)] for image in images)
    signed = aperture * fx * (1 / depth - 1 / focus)
    assert first - second == pytest.approx(4 / (3 * math.pi) * signed, rel=0.01)
    hits = 16 * 1024 * grey(images[0]).sum()
    assert images[0].sum() == pytest.approx(
        images[1].sum(), rel=4 * math.sqrt(2 / hits)
    )


def test_crosstalk_brings_the_halves_together():
    """The distance of the centroids of a small light is 1 - 2c of that without crosstalk, and the sum stays."""
    camera, lens = square_camera(35, 400.0), tl.ThinLens(0.05, 1.0)
    halves = tl.render(
        lamps([(0.0, 0.0, 0.5)], 1.0 * 0.5 / 400),
        tl.Rig([camera], [HERE]),
        lens,
        256,
        parts=tl.Dual(),
    )
    ideal = tl.Sensor.preset(
        "ideal", output="linear", bits=16, shot_noise=False, vignetting=False
    )

    def photos(crosstalk: float) -> list[np.ndarray]:
        shots = ideal.replace(dual_crosstalk=crosstalk).expose_dual(
            halves[0], camera=camera, lens=lens
        )
        return [grey(shot.image) for shot in shots]

    def distance(images: list[np.ndarray]) -> float:
        return float(centroid(images[0])[0] - centroid(images[1])[0])

    without = photos(0.0)
    for crosstalk in (0.1, 0.25, 0.5):
        mixed = photos(crosstalk)
        assert distance(mixed) == pytest.approx(
            (1 - 2 * crosstalk) * distance(without), abs=0.01
        )
        np.testing.assert_allclose(mixed[2], without[2], atol=2)


def test_what_has_no_parts_is_refused():
    scene = chequered_room()
    with pytest.raises(InputError, match="a pinhole has none"):
        tl.render(scene, RIG, parts=tl.Dual())
    with pytest.raises(InputError, match="a pinhole has none"):
        tl.render_lens_grid(scene, RIG, [LENSES["lens"], tl.Pinhole()], parts=tl.Dual())
    with pytest.raises(
        InputError, match="parts must be Dual, Quad, Grid or Masks, got 'dual'"
    ):
        tl.render(scene, RIG, LENSES["lens"], parts="dual")
