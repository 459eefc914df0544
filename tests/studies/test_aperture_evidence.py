"""What theory reads off sharp pictures, and the strips that it gives to a wrong depth along edges, against matches."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import convolve, gaussian_filter

from twinlens.camera import ThinLens
from twinlens.sensor import Exposure
from twinlens.studies import aperture_theory
from twinlens.studies.aperture_evidence import SIDE, Evidence, shared_texture
from twinlens.studies.aperture_shots import Model
from twinlens.studies.stage import Stage

GRAIN, NDISP = 1.2, 32
NEAR, FAR = 20, 8
LEFT_EDGE, RIGHT_EDGE = 60, 130


def sheet(random, shape):
    return gaussian_filter(random.normal(size=shape), GRAIN, mode="wrap") * 2 * GRAIN * math.sqrt(math.pi)


@pytest.mark.parametrize("noise", [0.0, 0.7])
def test_texture_is_what_both_eyes_see_alike_and_noise_is_none(noise):
    random = np.random.default_rng(4)
    texture = 0.3 * sheet(random, (240, 320))
    left, right = (1.0 + texture + random.normal(0, 0.3 * noise, texture.shape) for _ in range(2))
    depth = np.full(texture.shape, 7)
    depth[:, :40] = -1
    grain, variance = shared_texture(left, right, depth)
    assert grain == pytest.approx(GRAIN, rel=0.1)
    assert variance[:, 40:].mean() == pytest.approx(0.09, rel=0.1)
    assert (variance[:, :40] == 0).all()


def test_an_edge_between_two_depths_is_the_nearer_ones():
    depth = np.repeat([[3, 3, 3, 8, 8, 8, 3, 3]], 6, axis=0)
    picture = np.where(depth == 8, 1.0, 0.0)
    for eye, near in ((picture, depth), (picture.T, depth.T)):
        _, variance = shared_texture(eye, eye, near)
        assert (variance[near == 3] == 0).all()
        assert variance[near == 8].any()


def test_pictures_that_share_nothing_have_no_texture():
    grain, variance = shared_texture(np.ones((20, 30)), np.ones((20, 30)), np.ones((20, 30), np.int64))
    assert grain == 1.0
    assert (variance == 0).all()


@pytest.mark.parametrize("wells", [30.0, 500.0, 5000.0])
def test_the_noise_of_luma_is_that_of_photographs_of_a_grey_wall(wells):
    from twinlens.matching import grey

    stage = Stage.of("cards", 160, 120, pixel_pitch_um=3.45)
    lens, sensor = Model(stage, 1.0).lens(4.0), aperture_theory.SENSOR
    wall = np.full((120, 160, 3), 0.2, np.float32)
    rate = sensor.level_rate(wall, camera=stage.camera, lens=lens)[0, 0]

    def lumas(held):
        time = held / (rate[1] * sensor.full_well)
        shots = [sensor.expose(wall, camera=stage.camera, lens=lens, seed=k, exposure=Exposure(time)) for k in range(4)]
        return np.stack([grey(shot.image) for shot in shots]).astype(np.float64)

    level = wells / sensor.full_well
    rise = (lumas(1.1 * wells).mean() - lumas(0.9 * wells).mean()) / (0.2 * level)
    expected = float(aperture_theory.luma_noise(np.full((1, 3), level))[0])
    assert lumas(wells).std() / rise == pytest.approx(expected, rel=0.1)


def disk(width):
    y, x = np.mgrid[-10:11, -10:11]
    made = np.clip(width / 2 + 0.5 - np.hypot(x, y), 0.0, 1.0)
    return made / made.sum()


def pair(near_disk, far_disk, wall, card):
    """Two eyes of a near card before a far wall, each blurred as a disk: (96, 200)."""
    mask = np.zeros((96, 260))
    mask[:, LEFT_EDGE:RIGHT_EDGE] = 1.0
    eyes = []
    for near, far in ((0, 0), (NEAR, FAR)):
        behind = convolve(np.roll(wall, -far, axis=1), disk(far_disk), mode="wrap")
        before = convolve(np.roll(card * mask, -near, axis=1), disk(near_disk), mode="wrap")
        through = 1.0 - convolve(np.roll(mask, -near, axis=1), disk(near_disk), mode="wrap")
        eyes.append((before + through * behind)[:, :200])
    return eyes


def matched(left, right):
    """The shifts of the least sums of squared differences at the columns that have all partners, (rows, columns)."""
    half = SIDE // 2
    costs = np.full((NDISP, *left.shape), np.inf)
    for d in range(NDISP):
        squares = (left[:, d:] - right[:, : left.shape[1] - d]) ** 2
        windows = np.lib.stride_tricks.sliding_window_view(squares, (SIDE, SIDE)).sum(axis=(2, 3))
        costs[d, half:-half, d + half : left.shape[1] - half] = windows
    return costs.argmin(axis=0)


@pytest.mark.parametrize(("near_disk", "far_disk", "pixels"), [(0.6, 12.0, 1.0), (0.6, 0.6, 1.0), (12.0, 0.6, 2.0)])
def test_the_strip_along_an_edge_that_has_the_wrong_depth_is_as_wide_as_matches_have_it(near_disk, far_disk, pixels):
    """At the card's right edge, where both eyes see all of the wall.

    A blurred card is a veil that theory makes opaque: it is allowed twice as much.
    """
    random = np.random.default_rng(8)
    x = np.arange(200)
    truth = np.broadcast_to(np.where((x >= LEFT_EDGE) & (x < RIGHT_EDGE), NEAR, FAR), (96, 200)).astype(np.int64)
    blur = np.where(truth == NEAR, near_disk, far_disk).astype(np.float64)
    band = np.zeros(truth.shape, bool)
    band[10:-10, RIGHT_EDGE - 16 : RIGHT_EDGE + 16] = True
    found, expected = [], []
    for _ in range(3):
        sheets = sheet(random, (96, 260)), sheet(random, (96, 260))
        found.append(np.abs(matched(*pair(near_disk, far_disk, *sheets)) - truth)[band] > 2)
        left, right = pair(0.6, 0.6, *sheets)
        grain, texture = shared_texture(left, np.take_along_axis(right, np.maximum(x - truth, 0), axis=1), truth)
        theory = Evidence(SimpleNamespace(ndisp=NDISP), None, None, texture, grain, truth, band)
        expected.append(np.abs(theory._majority(blur, grain**2)[0] - truth[band]) > 2)
    assert 32 * np.mean(expected) == pytest.approx(32 * np.mean(found), abs=pixels)


def test_light_is_lost_by_blur_by_noise_and_by_nothing_else():
    """More wrong with less light, with more blur, and with diffraction; the same through every lens if its light is."""
    stage = Stage.of("cards", 96, 72, pixel_pitch_um=3.45)
    model = Model.of(stage)
    lens = model.lens(11.0)
    radiance = stage.photograph(model.full_size(lens), 16, 1)
    theory = Evidence.of(stage, lens, radiance)
    time = 0.3 / float(theory.levels.mean())
    sharp = np.zeros(stage.truth.depth.shape)

    def wrong(lens, time, blur=0.0, diffracts=False):
        return theory.expected(lens, Exposure(time), sharp + blur, diffracts).wrong

    few = wrong(lens, time)
    assert wrong(lens, time / 100) > few
    assert wrong(lens, time, blur=12.0) > few
    assert wrong(model.lens(32.0), time * (32 / 11) ** 2, diffracts=True) > few
    assert wrong(ThinLens(4 * lens.aperture_diameter, lens.focus_distance), time / 16) == pytest.approx(few)
    assert theory.expected(lens, Exposure(time), sharp, diffracts=False, paths=0.5).wrong == few


def test_light_paths_are_a_tenth_of_the_light_where_they_say_so():
    """Beside shot noise alone: a tenth of S electrons over sqrt(S) of them."""
    stage = Stage.of("cards", 96, 72, pixel_pitch_um=3.45)
    lens = Model(stage, 1.0).lens(11.0)
    wall = [np.full((72, 96, 3), 0.2, np.float32)] * 2
    theory = Evidence.of(stage, lens, wall)
    time = 0.5 / float(theory.levels.mean())
    ratio = theory.expected(lens, Exposure(time), np.zeros((72, 96)), diffracts=False, paths=0.1).path_noise
    assert ratio == pytest.approx(0.1 * math.sqrt(0.5 * aperture_theory.SENSOR.full_well) / math.sqrt(0.45), rel=0.2)
