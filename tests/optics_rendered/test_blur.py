"""The blur of a small light in rendered images: its diameter, its linearity in disparity, and its shape."""

import math

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    centroid,
    disk_diameter,
    grey,
    lamps,
    square_camera,
)
from twinlens.camera import Disk, MaskAperture, Polygon

FX = 400.0
OWN = 6.0  # px: the diameter of the light's own image
SIDE = 35
SPP = 1024
NEEDED = 0.0018  # standard error of a diameter that a measurement goes on for
CAMERAS = {  # name: lens of an aperture, its vergence, five vergences of the light, five apertures
    "lens": (
        lambda a: tl.ThinLens(a, 1.0),
        1.0,
        (2.0, 1.7, 1.5, 0.5, 0.2),
        (0.04, 0.045, 0.05, 0.055, 0.06),
    ),
    "bare hole": (
        lambda a: tl.BareAperture(a, 2.0),
        -0.5,
        (1.5, 1.2, 1.0, 0.7, 0.4),
        (0.015, 0.018, 0.021, 0.025, 0.03),
    ),
}


def photographed(scene, lens, seeds) -> np.ndarray:
    """The mean over seeds of grey images by a camera on the axis."""
    rig = tl.Rig([square_camera(SIDE, FX)], [HERE])
    return np.mean(
        [grey(tl.render(scene, rig, lens, spp=SPP, seed=seed)[0]) for seed in seeds],
        axis=0,
    )


def lamp(depth: float, own: float, x: float = 0.0):
    """A light whose image in focus is `own` px wide."""
    return lamps([(x, 0.0, depth)], 0.5 * own * depth / FX)


@pytest.mark.parametrize("row", range(5))
@pytest.mark.parametrize("name", CAMERAS)
def test_blur_circle_diameter(name, row):
    """A fx |1/z - k| within 1% including three standard errors, over five depths and five apertures.

    The diameter is computed from the second moment of the image. Its relative standard error for n hits is
    0.29/sqrt(n), times (1 + OWN^2/c^2) for the subtraction of the light's own size.
    """
    lens_of, vergence, lights, apertures = CAMERAS[name]
    scene = lamp(1 / lights[row], OWN)
    for aperture in apertures:
        expected = aperture * FX * abs(lights[row] - vergence)
        per_hit = 0.29 * (1 + (OWN / expected) ** 2)
        passes = math.ceil((per_hit / NEEDED) ** 2 / (0.25 * math.pi * OWN**2 * SPP))
        image = photographed(scene, lens_of(aperture), range(passes))
        assert image.sum() == pytest.approx(
            0.25 * math.pi * OWN**2, rel=0.03
        )  # no light is lost off the film
        error = per_hit / math.sqrt(image.sum() * SPP * passes)
        assert abs(disk_diameter(image, OWN) / expected - 1) + 3 * error < 0.01, (
            aperture,
            expected,
            error,
        )


def test_blur_is_linear_in_disparity_with_slope_aperture_over_baseline():
    """Disparity is measured from the centroids in the two images, blur from the second moments."""
    aperture, baseline, focus = 0.06, 0.12, 1.0
    camera = square_camera(SIDE, FX)
    measured = []
    for i, depth in enumerate((0.55, 0.65, 0.8, 1.3, 2.0, 4.0)):
        scene = lamp(depth, OWN, x=0.5 * baseline)
        shift = (
            0.5 * FX * baseline / depth
        )  # of the principal points, which keeps the light on the film
        left, right = (camera.replace(cx=camera.cx + s * shift) for s in (-1, 1))
        rig = tl.Rig.stereo(left, baseline, right=right)
        images = [
            grey(radiance)
            for radiance in tl.render(
                scene, rig, tl.ThinLens(aperture, focus), spp=SPP, seed=i
            )
        ]
        disparity = centroid(images[0])[0] - centroid(images[1])[0] + rig.doffs()
        blur = np.mean([disk_diameter(image, OWN) for image in images])
        measured.append((disparity, math.copysign(blur, focus - depth)))
    disparity, blur = np.array(measured).T
    (slope, offset), spread = np.polyfit(disparity, blur, 1, cov=True)
    error = math.sqrt(spread[0, 0])  # as the points scatter about the line
    assert abs(slope / (aperture / baseline) - 1) + 3 * error / slope < 0.01, (
        slope,
        error,
    )
    assert -offset / slope == pytest.approx(FX * baseline / focus, rel=0.01)
    assert np.std(blur - slope * disparity - offset) < 0.01 * np.ptp(blur)


SHAPES = {
    "triangle": Polygon(3, rotation_deg=20),
    "hexagon": Polygon(6, rotation_deg=10, roundness=0.3),
    "code": MaskAperture(
        np.random.default_rng(7).random((7, 7)).round(1) * np.pad(np.ones((5, 5)), 1)
    ),
    "letter F": MaskAperture(
        [[1, 1, 1, 1], [1, 0, 0, 0], [1, 1, 1, 0], [1, 0, 0, 0], [1, 0, 0, 0]]
    ),
}


def through(shape, own: float, blur: float, side: int) -> np.ndarray:
    """The aperture's transmission over a blur of `blur` px, integrated over pixels for a light of diameter `own` px."""
    fine = 8
    line = ((np.arange(side * fine) + 0.5) / fine - 0.5 * side) / (0.5 * blur)
    open_ = shape.transmission(*np.meshgrid(line, line))
    grain = own * fine
    reach = math.ceil(0.5 * grain)
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    light = (np.hypot(u, v) <= 0.5 * grain).astype(float)
    size = [n + 2 * reach for n in open_.shape]
    seen = np.fft.irfft2(
        np.fft.rfft2(open_, size) * np.fft.rfft2(light / light.sum(), size), size
    )
    seen = seen[reach : reach + side * fine, reach : reach + side * fine]
    return seen.reshape(side, fine, side, fine).mean(axis=(1, 3))


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


SIDES = pytest.mark.parametrize(
    ("focus", "turned"),
    [(8.0, True), (8 / 15, False)],
    ids=["before focus", "behind focus"],
)


@pytest.mark.parametrize("name", SHAPES)
@SIDES
def test_a_defocused_light_has_the_shape_of_the_aperture(name, focus, turned):
    """Rotated by 180 degrees in front of the plane of focus, upright behind it; correlation >= 0.99."""
    shape, depth, own, blur = SHAPES[name], 1.0, 5.0, 26.0
    lens = tl.ThinLens(blur / FX / abs(1 / depth - 1 / focus), focus, aperture=shape)
    image = photographed(lamp(depth, own), lens, range(4))
    drawn = through(shape, own, blur, SIDE)
    assert correlation(image, drawn[::-1, ::-1] if turned else drawn) > 0.99
    if name != "hexagon":  # which turned by 180 degrees is itself
        assert correlation(image, drawn if turned else drawn[::-1, ::-1]) < 0.9


def point_photograph(
    shape, focus, own: float, blur: float, side: int, spp: int
) -> np.ndarray:
    """A light at 1 m that is `own` px wide in focus, rendered with a blur of `blur` px."""
    lens = tl.ThinLens(blur / FX / abs(1 - 1 / focus), focus, aperture=shape)
    rig = tl.Rig([square_camera(side, FX)], [HERE])
    passes = range(max(1, spp >> 14))
    return np.mean(
        [
            grey(tl.render(lamp(1.0, own), rig, lens, spp=1 << 14, seed=s)[0])
            for s in passes
        ],
        axis=0,
    )


@pytest.mark.parametrize("name", ["triangle", "code"])
@SIDES
def test_a_small_light_has_the_shape_of_the_mask(name, focus, turned):
    """A light of 1/16 of the blur, against the transmission of the aperture without the light's own width."""
    drawn = through(SHAPES[name], 0.01, 16.0, 18)
    image = point_photograph(SHAPES[name], focus, 1.0, 16.0, 18, 1 << 15)
    assert correlation(image, drawn[::-1, ::-1] if turned else drawn) > 0.99
    assert correlation(image, drawn if turned else drawn[::-1, ::-1]) < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["triangle", "code"])
@SIDES
def test_a_very_small_light_has_the_shape_of_the_mask(name, focus, turned):
    """The same with a light of a fortieth of the blur."""
    drawn = through(SHAPES[name], 0.01, 40.0, 44)
    image = point_photograph(SHAPES[name], focus, 1.0, 40.0, 44, 1 << 17)
    assert correlation(image, drawn[::-1, ::-1] if turned else drawn) > 0.99


def test_a_blur_of_another_size_is_detected():
    """The comparison detects a blur of another size."""
    drawn = through(Disk(), OWN, 30.0, 48)
    assert disk_diameter(drawn, OWN) == pytest.approx(30.0, rel=2e-3)
    assert (
        disk_diameter(drawn, 0.0) > 30.5
    )  # the light itself, if it is forgotten, is noticed
