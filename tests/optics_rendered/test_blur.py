"""The blur of a small light in rendered images: its diameter, its linearity in disparity, and its shape."""

import math

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    disk_diameter,
    grey,
    lamps,
    square_camera,
)
from twinlens.camera import MaskAperture, Polygon

FX = 400.0
OWN = 6.0  # px: the diameter of the light's own image
LIT = 0.25 * math.pi * OWN**2  # pixels
SIDE = 35
SPP = 1024
NEEDED = 0.0018  # standard error of a diameter that a measurement goes on for
LENS_WIDTHS, HOLE_WIDTHS = (0.04, 0.045, 0.05, 0.055, 0.06), (0.015, 0.018, 0.021, 0.025, 0.03)  # fmt: skip
LENS_LIGHTS = (2.0, 1.7, 1.5, 0.5, 0.2)
HOLE_LIGHTS = (1.5, 1.2, 1.0, 0.7, 0.4)


def lens_at_1_m(aperture):
    return tl.ThinLens(aperture, 1.0)


def hole_2_m_before_the_film(aperture):
    return tl.BareAperture(aperture, 2.0)


CASES = []  # (lens, its vergence, the vergence of the light, aperture)
for i in range(5):
    k = (i + 2) % 5
    CASES += [
        (lens_at_1_m, 1.0, LENS_LIGHTS[i], LENS_WIDTHS[k]),
        (hole_2_m_before_the_film, -0.5, HOLE_LIGHTS[i], HOLE_WIDTHS[k]),
    ]


def photographed(scene, lens, seeds) -> np.ndarray:
    """The mean over seeds of grey images by a camera on the axis."""
    rig = tl.Rig([square_camera(SIDE, FX)], [HERE])
    images = [grey(tl.render(scene, rig, lens, SPP, seed)[0]) for seed in seeds]
    return np.mean(images, axis=0)


def lamp(depth: float, light_px: float):
    """A light whose image in focus is `light_px` wide."""
    return lamps([(0.0, 0.0, depth)], 0.5 * light_px * depth / FX)


@pytest.mark.parametrize(("lens_of", "vergence", "light", "aperture"), CASES)
def test_blur_circle_diameter(lens_of, vergence, light, aperture):
    """A fx |1/z - k| within 1% including three standard errors, over five depths and five apertures.

    The diameter is computed from the second moment of the image. Its relative standard error for n hits is
    0.29/sqrt(n), times (1 + OWN^2/c^2) for the subtraction of the light's own size. No light is lost off the film.
    """
    expected = aperture * FX * abs(light - vergence)
    per_hit = 0.29 * (1 + (OWN / expected) ** 2)
    passes = math.ceil((per_hit / NEEDED) ** 2 / (LIT * SPP))
    image = photographed(lamp(1 / light, OWN), lens_of(aperture), range(passes))
    assert image.sum() == pytest.approx(LIT, rel=0.03)
    error = per_hit / math.sqrt(image.sum() * SPP * passes)
    assert abs(disk_diameter(image, OWN) / expected - 1) + 3 * error < 0.01


CODE = np.random.default_rng(7).random((7, 7)).round(1) * np.pad(np.ones((5, 5)), 1)
LETTER_F = [[1, 1, 1, 1], [1, 0, 0, 0], [1, 1, 1, 0], [1, 0, 0, 0], [1, 0, 0, 0]]
SHAPES = {
    "triangle": Polygon(3, rotation_deg=20),
    "hexagon": Polygon(6, rotation_deg=10, roundness=0.3),
    "code": MaskAperture(CODE),
    "letter F": MaskAperture(LETTER_F),
}


def through(shape, light_px: float, blur: float, side: int) -> np.ndarray:
    """The aperture's transmission over a blur of `blur` px, integrated over pixels for a light of diameter `own` px."""
    fine = 8
    line = ((np.arange(side * fine) + 0.5) / fine - 0.5 * side) / (0.5 * blur)
    transmission = shape.transmission(*np.meshgrid(line, line))
    grain = light_px * fine
    reach = math.ceil(0.5 * grain)
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    light = (np.hypot(u, v) <= 0.5 * grain).astype(float)
    size = [n + 2 * reach for n in transmission.shape]
    spectrum = np.fft.rfft2(light / light.sum(), size)
    seen = np.fft.irfft2(np.fft.rfft2(transmission, size) * spectrum, size)
    inside = slice(reach, reach + side * fine)
    return seen[inside, inside].reshape(side, fine, side, fine).mean(axis=(1, 3))


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize(("focus", "is_turned"), [(8.0, True), (8 / 15, False)])
def test_a_defocused_light_has_the_shape_of_the_aperture(name, focus, is_turned):
    """Rotated by 180 degrees in front of the plane of focus, upright behind it; correlation >= 0.99."""
    shape = SHAPES[name]
    depth = 1.0
    light_px = 5.0
    blur = 26.0
    lens = tl.ThinLens(blur / FX / abs(1 / depth - 1 / focus), focus, aperture=shape)
    image = photographed(lamp(depth, light_px), lens, range(4))
    upright = through(shape, light_px, blur, SIDE)
    expected = upright
    opposite = upright[::-1, ::-1]
    if is_turned:
        expected, opposite = opposite, expected
    assert correlation(image, expected) > 0.99
    if name != "hexagon":  # which turned by 180 degrees is itself
        assert correlation(image, opposite) < 0.9
