"""The halves of dual pixels: levels, noise, saturation and crosstalk on flat fields."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.sensor import Exposure, Sensor

CAMERA = tl.Camera(60, 50, 600.0, 600.0, 29.5, 24.5, pixel_pitch_um=3.45)
LENS = tl.ThinLens(CAMERA.film_distance / 4, focus_distance=1.0)
TIME = 1e-3
SENSOR = Sensor(
    filters="mono", output="raw", quantum_efficiency=(1e-9, 0.62, 1e-9), full_well=9000.0, read_noise=6.0, prnu=0.0,
    dsnu=0.0, dark_current=5e4, adc_bits=16, black_level=300.0, vignetting=False,
)  # fmt: skip


QUIET = SENSOR.replace(shot_noise=False, read_noise=0.0, dark_current=0.0)


def flat(*electrons: float) -> np.ndarray:
    """Halves that collect these numbers of electrons in TIME, (2, H, W, 3)."""
    per_unit = SENSOR.electrons_per_radiance(CAMERA, LENS)[1] * TIME
    halves = np.zeros((2, CAMERA.height, CAMERA.width, 3))
    halves[..., 1] = np.reshape(electrons, (2, 1, 1)) / per_unit
    return halves


EXPOSURE = Exposure(TIME, 0.8)
GAIN = 0.8 * (2**16 - 1 - 300) / 9000  # DN per electron of whole pixels


def levels(sensor: Sensor, electrons: tuple[float, float], frames: int) -> np.ndarray:
    """Levels above black of left, right and whole pixels, in DN, (3, frames, H, W)."""
    how = {"camera": CAMERA, "lens": LENS, "exposure": EXPOSURE}
    images = []
    for seed in range(frames):
        photos = sensor.expose_dual(flat(*electrons), seed=seed, **how)
        images.append([photo.image for photo in photos])
    return np.array(images, dtype=float).swapaxes(0, 1) - 300


def assert_moments(values: np.ndarray, mean: float, variance: float) -> None:
    """Within 4 standard errors."""
    assert values.mean() == pytest.approx(mean, abs=4 * np.sqrt(variance / values.size))
    assert values.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / values.size))


def test_mean_and_variance_of_the_halves():
    """Mean K_h (mu + dark / 2) and variance K_h^2 (mu + dark / 2 + read^2) + 1/12, with K_h = 2 K."""
    *halves, whole = levels(SENSOR, (1500.0, 900.0), 32)
    for half, electrons in zip(halves, (1525.0, 925.0), strict=True):
        variance = (2 * GAIN) ** 2 * (electrons + 6.0**2) + 1 / 12
        assert_moments(half, 2 * GAIN * electrons, variance)
    assert_moments(whole, GAIN * 2450.0, GAIN**2 * (2450.0 + 6.0**2) + 1 / 12)


def test_noise_of_the_halves_is_independent_and_the_whole_is_their_sum():
    left, right, whole = levels(SENSOR, (1500.0, 1500.0), 16)
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 4 / np.sqrt(left.size)
    remainder = whole - (left + right) / 2  # the read noise of all three
    assert remainder.var() == pytest.approx(GAIN**2 * 6.0**2 * (1 + 1 + 1), rel=0.02)


def test_a_whole_image_has_the_noise_of_a_sensor_with_single_photodiodes():
    whole = levels(SENSOR, (1500.0, 900.0), 16)[2]
    radiance = flat(1500.0, 900.0).sum(axis=0)
    how = {"camera": CAMERA, "lens": LENS, "exposure": EXPOSURE}
    photos = [SENSOR.expose(radiance, seed=seed, **how) for seed in range(16)]
    single = np.array([photo.image for photo in photos])
    assert whole.mean() == pytest.approx(single.mean() - 300.0, rel=2e-3)
    assert whole.var() == pytest.approx(single.var(), rel=0.05)


def test_each_half_saturates_at_half_of_the_full_well():
    left, right, whole = levels(SENSOR, (9000.0, 1000.0), 2)
    assert left.mean() == pytest.approx(2 * GAIN * 4500, rel=1e-3)
    assert whole.mean() == pytest.approx(GAIN * (4500 + 1000 + 25), rel=2e-3)
    assert right.mean() == pytest.approx(2 * GAIN * 1025, rel=2e-3)


def test_fixed_patterns_of_the_halves_differ_and_stay():
    sensor = SENSOR.replace(prnu=0.02, dsnu=5.0)
    left, right, _ = levels(sensor, (2000.0, 2000.0), 24).mean(axis=1)
    again = levels(sensor, (2000.0, 2000.0), 25)[0, 1:].mean(axis=0)
    assert np.corrcoef(left.ravel(), again.ravel())[0, 1] > 0.9
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.1


def test_crosstalk_mixes_the_light_of_the_halves():
    sensor = QUIET.replace(dual_crosstalk=0.1)
    left, right, whole = levels(sensor, (3000.0, 1000.0), 1).mean(axis=(1, 2, 3))
    assert left == pytest.approx(2 * GAIN * 2800, abs=1)
    assert right == pytest.approx(2 * GAIN * 1200, abs=1)
    assert whole == pytest.approx(GAIN * 4000, abs=1)


def test_near_infrared_halves_have_the_levels_of_their_own_sensor():
    camera = CAMERA.replace(band="nir")
    sensor = QUIET.replace(nir=QUIET.replace(full_well=2000.0))
    photos = sensor.expose_dual(
        flat(900.0, 900.0), camera=camera, lens=LENS, exposure=Exposure(TIME)
    )
    left, right, whole = (photo.image.mean() - 300 for photo in photos)
    assert whole > 1000
    assert left == pytest.approx(whole, abs=1)
    assert right == pytest.approx(whole, abs=1)


def test_automatic_exposure_is_that_of_the_whole_image():
    halves = flat(2000.0, 1000.0)
    photos = Sensor().expose_dual(halves, camera=CAMERA, lens=LENS)
    expected = Sensor().expose(halves.sum(axis=0), camera=CAMERA, lens=LENS).record
    assert all(photo.record["time_s"] == expected["time_s"] for photo in photos)
    assert all(photo.image.dtype == np.uint8 for photo in photos)
