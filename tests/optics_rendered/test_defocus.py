"""Depth from focus and defocus on rendered planes of known depth."""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens.studies.stage import centred_camera, noise_planes

CAMERA = centred_camera(64, 48, 200.0)
DEPTH = 1.9
APERTURE = 0.03
SIGMA = 0.05
SIDE = 9
RIM = 12
RIG = tl.Rig([CAMERA], [np.eye(4)])
STACK = [tl.ThinLens(APERTURE, 1 / k) for k in (0.2, 0.36, 0.52, 0.68, 0.84)]


def grey(image):
    return np.asarray(image, np.float64).mean(axis=-1)


@pytest.fixture(scope="module")
def plane():
    """A textured plane and its sharp image."""
    scene = noise_planes(CAMERA, 0.05, DEPTH, 4)[0].scene
    return scene, grey(tl.render(scene, RIG, tl.Pinhole(), spp=256, seed=1)[0])


def noisy(image, seed):
    return image / image.mean() + SIGMA * np.random.default_rng(seed).standard_normal(
        image.shape
    )


def samples(lens):
    points, shares = tl.aperture_points(lens)
    return [tl.ApertureSamples(points, share, lens.vergence) for share in shares]


def ratio(estimate, sharp, apertures):
    """The rms error of 1/z over its bound."""
    bound = tl.inverse_depth_bound(
        sharp / sharp.mean(), apertures, CAMERA.fx, 1 / DEPTH, SIGMA, block_size=SIDE
    )
    return math.sqrt(np.mean(((estimate - 1 / DEPTH) / bound)[RIM:-RIM, RIM:-RIM] ** 2))


def test_a_focal_stack_is_near_its_bound(plane):
    scene, sharp = plane
    stack = [
        noisy(grey(tl.render(scene, RIG, lens, 512, 10 + k)[0]), k)
        for k, lens in enumerate(STACK)
    ]
    apertures = [samples(lens)[0] for lens in STACK]
    estimate = tl.inverse_depth_from_defocus(
        stack, apertures, CAMERA.fx, 1.1, 10.0, steps=24, block_size=SIDE
    )
    assert ratio(estimate, sharp, apertures) < 1.5
    vergences = [lens.vergence for lens in STACK]
    sharpest = tl.inverse_depth_from_focus(
        stack, vergences, block_size=SIDE, neighbours=2
    )
    quarter_step = 0.25 * (vergences[1] - vergences[0])
    assert np.median(sharpest[RIM:-RIM, RIM:-RIM]) == pytest.approx(
        1 / DEPTH, abs=quarter_step
    )
