"""Texture measured on sharp images, and predictions of wrong pixels, against counted matches."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import convolve

from tests.studies.aperture.naive import (
    measured_noise,
    refined_shifts,
    sheet,
    wall_of,
    window_costs,
)
from twinlens.matching import grey
from twinlens.sensor import Exposure
from twinlens.studies.aperture import theory as aperture_theory
from twinlens.studies.aperture.theory import (
    SIDE,
    Evidence,
    ScaleModel,
    SharedTexture,
    shared_texture,
)
from twinlens.studies.stage import Stage

GRAIN, NDISP = 1.2, 32
NEAR, FAR = 20, 8
LEFT_EDGE, RIGHT_EDGE = 60, 130


@pytest.mark.parametrize("grain", [1.2, 2.0])
@pytest.mark.parametrize("noise", [0.0, 0.21])
def test_shared_texture_excludes_noise(grain, noise):
    random = np.random.default_rng(4)
    texture = 1.0 + 0.3 * sheet(random, (240, 320), grain)
    left, right = texture + random.normal(0, noise, (2, *texture.shape))
    depth = np.full(texture.shape, 7)
    depth[:, :40] = -1
    measured, variance = shared_texture(left, right, depth)
    assert measured == pytest.approx(grain, rel=0.1)
    assert variance[:, 40:].mean() == pytest.approx(0.09, rel=0.15)
    assert (variance[:, :40] == 0).all()


def test_an_edge_between_two_depths_belongs_to_the_nearer_one():
    depth = np.repeat([[3, 3, 3, 8, 8, 8, 3, 3]], 6, axis=0)
    image = np.where(depth == 8, 1.0, 0.0)
    for picture, near in ((image, depth), (image.T, depth.T)):
        _, variance = shared_texture(picture, picture, near)
        assert (variance[near == 3] == 0).all()
        assert variance[near == 8].any()


@pytest.mark.parametrize(
    ("colour", "gain"),
    [((0.3, 0.1, 0.05), 1.0), ((0.05, 0.1, 0.3), 8.0)],
)
def test_luma_noise_of_images_of_a_coloured_wall(colour, gain):
    camera, lens, wall = wall_of(colour)
    rate = aperture_theory.SENSOR.level_rate(wall, camera=camera, lens=lens)[0, 0]
    for level in (0.005, 0.05, 0.3):
        time = level / float(gain * rate @ aperture_theory.LUMA)
        noise = measured_noise(grey, camera, lens, wall, Exposure(time, gain))
        predicted = aperture_theory.luma_noise(gain * time * rate[None], gain)[0]
        assert level * noise == pytest.approx(float(predicted), rel=0.06)


def disk(width):
    y, x = np.mgrid[-10:11, -10:11]
    made = np.clip(width / 2 + 0.5 - np.hypot(x, y), 0.0, 1.0)
    return made / made.sum()


def pair(near_disk, far_disk, wall, card):
    """Left and right images (96, 200) of a near card in front of a far wall, each blurred by a disk."""
    mask = np.zeros((96, 260))
    mask[:, LEFT_EDGE:RIGHT_EDGE] = 1.0
    pictures = []
    for near, far in ((0, 0), (NEAR, FAR)):
        behind = convolve(np.roll(wall, -far, axis=1), disk(far_disk), mode="wrap")
        before = convolve(
            np.roll(card * mask, -near, axis=1), disk(near_disk), mode="wrap"
        )
        through = 1.0 - convolve(
            np.roll(mask, -near, axis=1), disk(near_disk), mode="wrap"
        )
        pictures.append((before + through * behind)[:, :200])
    return pictures


def matched(left, right):
    """The shifts of the least sums of squared differences, (rows, columns); 0 at the border."""
    half = SIDE // 2
    shifts = window_costs(left, right, NDISP, SIDE).argmin(axis=0)
    return np.pad(shifts, ((half, half), (NDISP + half, half)))


@pytest.mark.parametrize(
    ("near_disk", "far_disk", "pixels"),
    [(0.6, 12.0, 1.0), (0.6, 0.6, 1.0), (12.0, 0.6, 2.0)],
)
def test_the_strip_of_wrong_depth_along_an_edge(near_disk, far_disk, pixels):
    """At the card's right edge, where the wall is visible in both images.

    The theory ignores that a blurred card is translucent, so the tolerance is doubled there.
    """
    random = np.random.default_rng(8)
    columns = np.arange(200)
    on_card = (columns >= LEFT_EDGE) & (columns < RIGHT_EDGE)
    truth = np.tile(np.where(on_card, NEAR, FAR), (96, 1))
    blur = np.where(truth == NEAR, near_disk, far_disk)
    band = np.zeros(truth.shape, bool)
    band[10:-10, RIGHT_EDGE - 16 : RIGHT_EDGE + 16] = True
    measured, expected = [], []
    for _ in range(3):
        sheets = [sheet(random, (96, 260), GRAIN) for _ in range(2)]
        shifts = matched(*pair(near_disk, far_disk, *sheets))
        measured.append(np.abs(shifts - truth)[band] > 2)
        left, right = pair(0.6, 0.6, *sheets)
        partners = np.maximum(columns - truth, 0)
        aligned = np.take_along_axis(right, partners, axis=1)
        grain, texture = shared_texture(left, aligned, truth)
        theory = SharedTexture(grain, texture, truth, band, NDISP)
        majority = theory.majority(blur, grain**2)[0]
        expected.append(np.abs(majority - truth[band]) > 2)
    assert 32 * np.mean(expected) == pytest.approx(32 * np.mean(measured), abs=pixels)


@pytest.mark.parametrize(("grain", "contrast", "level", "blur"), [
    (1.2, 0.08, 0.005, 0.0), (1.2, 0.08, 0.05, 12.0),
    pytest.param(1.2, 0.02, 0.04, 0.0, marks=pytest.mark.slow),
    pytest.param(2.0, 0.02, 0.05, 0.0, marks=pytest.mark.slow),
    pytest.param(1.2, 0.08, 0.005, 6.0, marks=pytest.mark.slow),
])  # fmt: skip
def test_wrong_pixels_of_a_flat_sheet(grain, contrast, level, blur):
    """The whole chain: a texture blurred by a disk, exposed by the sensor, its 8-bit luma matched by a naive SSD.

    The tolerance is 5 percentage points. Counts of 1600 windows have a standard deviation of at most 1.2. Without blur
    the theory is 1 to 4 too high: it includes windows at the borders, and means over 25 px remove some texture.
    """
    stage = Stage.of("cards", 320, 240, pixel_pitch_um=3.45)
    lens, away = ScaleModel(stage, 1.0).lens(11.0), 14
    everywhere = np.ones((240, 320))
    visible = np.indices(everywhere.shape)[1] >= away
    truth = SimpleNamespace(visible=visible, disparity=away * everywhere)
    flat = SimpleNamespace(camera=stage.camera, truth=truth, ndisp=NDISP)

    def both(texture):
        radiance = np.repeat(0.2 * texture[..., None], 3, axis=2).astype(np.float32)
        return radiance[:, :320], radiance[:, away:]

    counted, expected = [], []
    for seed in range(2):
        random = np.random.default_rng(seed)
        sharp = 1.0 + contrast * sheet(random, (240, 320 + away), grain)
        blurred = convolve(sharp, disk(blur), mode="wrap") if blur else sharp
        theory = Evidence.of(flat, lens, 0.0 * everywhere, both(sharp))
        exposure = Exposure(level / float(theory.levels.mean()))
        photos = aperture_theory.SENSOR.expose_pair(
            *both(blurred), rig=stage.rig, lens=lens, seed=seed, exposure=exposure
        )
        lumas = [grey(photo.image).astype(np.float64) for photo in photos]
        shifts = refined_shifts(window_costs(*lumas, NDISP, SIDE, step=4))
        counted.append(100 * np.mean(np.abs(shifts - away) > 2))
        predicted = theory.expected(lens, exposure, blur * everywhere, diffracts=False)
        expected.append(predicted[0])
    assert np.mean(expected) == pytest.approx(np.mean(counted), abs=5.0)


def test_the_ratio_of_rendering_noise_to_shot_noise():
    """A tenth of S electrons over sqrt(S)."""
    stage = Stage.of("cards", 96, 72, pixel_pitch_um=3.45)
    lens = ScaleModel(stage, 1.0).lens(11.0)
    wall = [np.full((72, 96, 3), 0.2, np.float32)] * 2
    theory = Evidence.of(stage, lens, np.zeros((72, 96)), wall)
    time = 0.5 / float(theory.levels.mean())
    ratio = theory.expected(
        lens, Exposure(time), np.zeros((72, 96)), diffracts=False, paths=0.1
    )[1]
    assert ratio == pytest.approx(
        0.1 * math.sqrt(0.5 * aperture_theory.SENSOR.full_well) / math.sqrt(0.45),
        rel=0.2,
    )
