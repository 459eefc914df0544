"""The error of matched depth grows as z^2 / (f B)."""

import numpy as np
import pytest

from twinlens import matching
from twinlens.camera import Camera, Rig
from twinlens.reconstruction import view_of_disparity

WIDTH, HEIGHT, FX = 160, 100, 200.0
MATCHERS = {
    "zncc": matching.StereoMatcher(cost="zncc", block_size=9, num_disparities=40),
    "sgm": matching.StereoMatcher(
        cost="census", block_size=1, num_disparities=40, optimisation="sgm8"
    ),
}


def texture(rng):
    """A random continuous texture with wavelengths of 4 to 20 pixels."""
    angle, phase = rng.uniform(0, 2 * np.pi, (2, 60))
    k = 2 * np.pi / rng.uniform(4, 20, 60)
    kx, ky = k * np.cos(angle), k * np.sin(angle)
    return lambda u, v: (
        128 + 14 * np.cos(kx * u[..., None] + ky * v[..., None] + phase).sum(axis=-1)
    )


def pair(rng, middle, slope=0.03):
    """Left and right image, with noise, of a slanted plane, and its disparity middle + slope (u - cx)."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    disparity = middle + slope * (u - 0.5 * (WIDTH - 1))
    paint = texture(rng)
    source = (u + middle - slope * 0.5 * (WIDTH - 1)) / (
        1 - slope
    )  # the left pixel that each right one shows
    photos = [paint(x, v) + rng.normal(0, 2, u.shape) for x in (u, source)]
    return [
        np.clip(np.rint(photo), 0, 255).astype(np.uint8) for photo in photos
    ], disparity


def depth_errors(matcher, baseline, depth, seeds=2):
    """Absolute depth errors in the middle of the image, metres, of planes at about `depth` metres."""
    camera = Camera(WIDTH, HEIGHT, FX, FX, 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1))
    rig = Rig.stereo(camera, baseline)
    errors = []
    for seed in range(seeds):
        images, disparity = pair(np.random.default_rng(seed), FX * baseline / depth)
        view = view_of_disparity(matcher.match(*images), rig)
        inner = (slice(12, -12), slice(60, -12))
        error = np.abs(view.depth - FX * baseline / disparity)[inner]
        errors.append(error[np.abs(error) < 0.2 * depth])
    return np.concatenate(errors)


@pytest.mark.parametrize("name", MATCHERS)
def test_depth_error_grows_with_the_square_of_depth_and_falls_with_the_baseline(name):
    matcher = MATCHERS[name]
    depths = np.array([1.0, 1.4, 2.0, 2.8])
    wide = [np.median(depth_errors(matcher, 0.15, depth)) for depth in depths]
    exponent = np.polyfit(np.log(depths), np.log(wide), 1)[0]
    assert exponent == pytest.approx(2, abs=0.15)
    narrow = np.median(depth_errors(matcher, 0.075, 1.4))
    assert narrow / wide[1] == pytest.approx(2, rel=0.15)
    in_px = wide[0] * FX * 0.15 / depths[0] ** 2
    assert 0.005 < in_px < 0.3
