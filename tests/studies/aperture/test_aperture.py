"""The study `aperture`: parts of the theory against independent results, and findings of known tables."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import fourier_shift, gaussian_filter
from scipy.special import j1

from tests.studies.aperture.naive import measured_noise, sheet, wall_of
from twinlens.camera import Camera, Rig, ThinLens
from twinlens.sensor import Exposure
from twinlens.studies import FAILS, HOLDS, OPEN, STUDIES, SeedSupport, Table
from twinlens.studies.aperture import conclude, theory as aperture_theory
from twinlens.studies.aperture.theory import F_NUMBERS, MODES, ScaleModel
from twinlens.studies.intervals import log_parabola_minimum
from twinlens.studies.stage import Stage

STUDY = STUDIES["aperture"]


@pytest.mark.parametrize("grain", [1.0, 1.5, 2.0])
def test_grain_of_noise_smoothed_by_a_gaussian(grain):
    noise = np.random.default_rng(5).normal(size=(256, 256))
    texture = 0.5 + gaussian_filter(noise, grain, mode="wrap")
    picture = np.repeat(texture[..., None], 3, axis=2).astype(np.float32)
    assert aperture_theory.grain_px(picture) == pytest.approx(grain, rel=0.07)


def test_the_gaussian_matches_the_peak_of_the_airy_pattern():
    """(2 J1(v)/v)^2, v = pi r / (lambda N), near its middle."""
    camera, number, pitch_um = (
        Camera.from_fov(96, 72, 50.0, pixel_pitch_um=3.45),
        16.0,
        3.45,
    )
    lens = ThinLens(camera.film_distance / number, 2.0)
    radius = np.linspace(1e-3, 0.3, 50)
    phase = math.pi * radius * 1e-6 * pitch_um / (aperture_theory.WAVELENGTH * number)
    airy = (2 * j1(phase) / phase) ** 2
    sigma = float(np.mean(np.sqrt(-0.5 * radius**2 / np.log(airy))))
    assert aperture_theory.airy_px(camera, lens) == pytest.approx(sigma, rel=0.01)


@pytest.mark.parametrize("wells", [12.0, 150.0, 1500.0, 5000.0])
def test_noise_of_images_of_a_grey_wall(wells):
    """Of the green levels."""
    camera, lens, wall = wall_of((0.2, 0.2, 0.2))
    sensor = aperture_theory.SENSOR
    level_rate = sensor.level_rate(wall, camera=camera, lens=lens)[0, 0, 1]
    exposure = Exposure(wells / float(level_rate * sensor.full_well))
    noise = measured_noise(lambda image: image[..., 1], camera, lens, wall, exposure)
    predicted = float(aperture_theory.noise_electrons(wells))
    assert wells * noise == pytest.approx(predicted, rel=0.1)


def test_least_squares_reach_the_bound_under_blur():
    """A noisy, shifted texture of grain s and blur b: the error is proportional to (s^2 + b^2) noise."""
    grain, shift, size = 1.5, 0.02, 64
    waves = -2j * math.pi * np.fft.fftfreq(size)
    random = np.random.default_rng(9)

    def error(blur, noise):
        misses = []
        for _ in range(150):
            texture = sheet(random, (size, size), grain)
            first = gaussian_filter(texture, blur, mode="wrap")
            second = np.fft.ifft2(fourier_shift(np.fft.fft2(first), (0, shift))).real
            slope = np.fft.ifft2(waves * np.fft.fft2(first + second)).real / 2
            difference = first - second + random.normal(0, noise, first.shape)
            misses.append((slope * difference).sum() / (slope**2).sum())
        return np.std(misses)

    sharp = error(0.0, 0.05)
    for blur, noise in ((2.0, 0.05), (3.0, 0.05), (0.0, 0.15)):
        bound = aperture_theory.shift_bound(grain, [0.0, blur**2], 1.0, [0.05, noise])
        ratio = error(blur, noise) / sharp
        assert ratio == pytest.approx(bound[1] / bound[0], rel=0.25)


def test_the_blur_at_full_size_equals_the_models():
    stage = Stage.of("cards", 96, 72, pixel_pitch_um=3.45)
    model = ScaleModel.of(stage)
    has_depth = np.isfinite(stage.truth.depth)
    blur = np.abs(stage.blur(model.full_size(model.lens(1.0))))[has_depth]
    assert np.quantile(blur, 0.95) == pytest.approx(24.0)
    small = model.lens(1.0)
    assert stage.camera.film_distance / small.aperture_diameter == pytest.approx(1.0)


def shrunk(stage, scale):
    """The stage with every length times `scale`."""
    size = np.diag([scale, scale, scale, 1.0])
    things = tuple(
        replace(item, instances=tuple(size @ pose for pose in item.instances))
        if item.instances
        else replace(item, world_from_object=size @ item.world_from_object)
        for item in stage.scene.objects
    )
    poses = [
        np.vstack([pose[:3] * [1, 1, 1, scale], pose[3:]])
        for pose in stage.rig.world_from_cams
    ]
    return Stage(
        replace(stage.scene, objects=things), Rig(stage.rig.cameras, tuple(poses))
    )


@pytest.mark.slow
def test_the_image_at_full_size_equals_the_models():
    whole = Stage.of("staircase", 64, 48, pixel_pitch_um=3.45)
    small = shrunk(whole, 0.2)
    assert np.allclose(small.truth.depth, 0.2 * whole.truth.depth, rtol=1e-4)
    assert np.allclose(small.truth.disparity, whole.truth.disparity, rtol=1e-3)
    model = ScaleModel(whole, 0.2)
    lens = model.lens(0.05)
    big, little = (
        whole.photograph(model.full_size(lens), 32, 1)[0],
        small.photograph(lens, 32, 1)[0],
    )
    assert np.abs(big - little).mean() < 0.02 * big.mean()


def test_the_optimum_between_blur_and_shot_noise():
    """With shot noise only, the optimum of a wall with blur c at f/1 is c / (4 s)."""
    numbers = np.array(F_NUMBERS)
    wells = 4000.0 / numbers**2
    errors = aperture_theory.shift_bound(
        1.2, (12.0 / 4 / numbers) ** 2, wells, np.sqrt(wells)
    )
    assert log_parabola_minimum(numbers, errors) == pytest.approx(
        12.0 / 4 / 1.2, rel=0.05
    )


def table(best, cost=2.0, theory=5.6, jitter=0.0, median=2.0):
    """Wrong pixels as a parabola in stops, least at `best` of each scene; the median error is least at `median`.

    The Cramer-Rao bound is least at f/2.
    """
    random = np.random.default_rng(2)
    rows = [
        {
            "scene": scene, "seed": seed, "f_number": number, "exposure": mode, "diffraction": "with", "method": "sad",
            "level": 1 / number**2, "square_law": 1.0, "predicted": 1.0, "theory_best": 2.0, "totbad1": 0.0,
            "predicted_wrong": 1.0, "theory_best_wrong": theory, "avgerr": 0.0,
            "path_noise": 3.0 if mode == MODES[1] else 0.2,
            "a50": 1 + math.log2(number / median) ** 2,
            "totbad2": 9 + cost * math.log2(number / place) ** 2 + jitter * random.normal(),
        }
        for scene, place in best.items()
        for seed in (0, 1)
        for mode in MODES
        for number in F_NUMBERS
    ]  # fmt: skip
    light = [{**row, "diffraction": "without"} for row in rows]
    return Table(STUDY.all_columns, (*rows, *light))


def verdict(made):
    return conclude(made)[1]


def test_theory_holds_if_every_scene_is_near():
    finding = verdict(table({"a": 5.6, "b": 4.0, "c": 8.0}))
    assert finding.decided
    assert finding.holds
    assert finding.measured.value == pytest.approx(0.0, abs=0.1)
    assert "f/5.6" in finding.sentence


@pytest.mark.parametrize("best", [(11.0, 11.0, 11.0), (2.0, 5.6, 16.0)])
def test_theory_does_not_hold_if_one_scene_is_far(best):
    finding = verdict(table(dict(zip("abc", best, strict=True))))
    assert finding.decided
    assert not finding.holds


def test_a_curve_flatter_than_its_noise_does_not_decide():
    finding = verdict(table(dict.fromkeys("abc", 5.6), cost=0.01, jitter=0.5))
    assert not finding.decided
    assert "too flat compared with its noise to decide" in finding.sentence


def with_column(made, name, value_of):
    """The table with `value_of` each row in a column."""
    rows = tuple({**row, name: value_of(row)} for row in made)
    return Table(made.columns, rows)


@pytest.mark.parametrize(
    ("median", "holds"), [(2.0, True), (3.0, True), (4.0, False), (1.0, False)]
)
def test_the_median_error_is_compared_with_the_bound(median, holds):
    finding = conclude(table({"a": 11.0, "b": 8.0, "c": 8.0}, median=median))[-3]
    assert finding.holds == holds
    assert finding.measured.value == pytest.approx(2 * math.log2(median / 2.0), abs=0.1)
    assert ("outside in some scene for sad" in finding.sentence) != holds


@pytest.mark.parametrize(("ratios", "state"), [
    ((0.2, 0.3, 0.45), HOLDS), ((0.6, 0.7, 0.8), FAILS), ((0.2, 0.3, 0.9), OPEN), ((0.4, 0.7, 0.9), OPEN),
])  # fmt: skip
def test_the_whole_interval_of_rendering_noise_decides(ratios, state):
    noise = dict(zip("abc", ratios, strict=True))
    made = table(dict.fromkeys("abc", 4.0))
    finding = conclude(
        with_column(made, "path_noise", lambda row: noise[row["scene"]])
    )[-2]
    assert SeedSupport(finding, 1, 1).state == state
    assert finding.measured.value == pytest.approx(np.mean(ratios))
