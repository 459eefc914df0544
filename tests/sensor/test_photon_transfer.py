"""The photon transfer method of EMVA 1288 on simulated flat fields recovers the parameters of the sensor."""

import numpy as np
import pytest

from twinlens.camera import Camera, ThinLens
from twinlens.sensor import Exposure, Sensor

CAMERA = Camera(300, 300, 3000.0, 3000.0, 149.5, 149.5, pixel_pitch_um=3.45)
LENS = ThinLens(CAMERA.film_distance / 4, focus_distance=1.0)
SENSOR = Sensor(
    filters="mono",
    output="raw",
    quantum_efficiency=(1e-9, 0.62, 1e-9),
    full_well=9000.0,
    read_noise=3.1,
    prnu=0.011,
    dsnu=2.4,
    dark_current=0.0,
    adc_bits=14,
    black_level=300.0,
)
GAIN = 0.8  # leaves room above the full well in the converter


def frame(level: float, seed: int) -> np.ndarray:
    """A flat field of green light with a mean of `level` full wells."""
    per_unit = SENSOR.electrons_per_radiance(CAMERA, LENS)[1] * 1e-3
    flat = np.zeros((300, 300, 3))
    flat[..., 1] = level * SENSOR.full_well / per_unit
    photo = SENSOR.expose(
        flat, camera=CAMERA, lens=LENS, seed=seed, exposure=Exposure(1e-3, GAIN)
    )
    return photo.image.astype(np.float64)


@pytest.fixture(scope="module")
def transfer() -> tuple[np.ndarray, np.ndarray]:
    """Mean and temporal variance (half the variance of a difference) at 12 levels up to 70% of saturation."""
    levels = np.linspace(0, 0.7, 12)
    pairs = [
        (frame(level, 2 * i), frame(level, 2 * i + 1)) for i, level in enumerate(levels)
    ]
    mean = np.array([(a.mean() + b.mean()) / 2 for a, b in pairs])
    variance = np.array([(a - b).var() / 2 for a, b in pairs])
    return mean, variance


@pytest.fixture(scope="module")
def system_gain(transfer) -> float:
    """K: the slope of variance over mean, weighted by the standard error."""
    mean, variance = transfer
    return np.polyfit(mean - mean[0], variance, 1, w=1 / variance)[0]


def test_gain(system_gain):
    expected = GAIN * (2**14 - 1 - 300) / 9000
    assert system_gain == pytest.approx(expected, rel=0.02)


def test_read_noise(transfer, system_gain):
    """sigma_d^2 = (sigma_y.dark^2 - 1/12) / K^2."""
    assert np.sqrt(transfer[1][0] - 1 / 12) / system_gain == pytest.approx(
        3.1, rel=0.02
    )


def test_full_well(transfer, system_gain):
    saturated = frame(3.0, seed=99)
    assert saturated.max() < 2**14 - 1
    assert (saturated.mean() - transfer[0][0]) / system_gain == pytest.approx(
        9000, rel=0.02
    )


def test_black_level(transfer):
    assert transfer[0][0] == pytest.approx(300, abs=0.1)


def spatial_variance(level: float, count: int = 16) -> tuple[float, float]:
    """Spatial variance of the mean of `count` frames, without the remaining temporal noise; and the mean."""
    frames = np.stack([frame(level, 1000 + i) for i in range(count)])
    return frames.mean(axis=0).var() - frames.var(
        axis=0, ddof=1
    ).mean() / count, frames.mean()


def test_prnu_and_dsnu(system_gain):
    """PRNU^2 = (s_50^2 - s_dark^2) / (mean_50 - mean_dark)^2, DSNU = s_dark / K."""
    dark_variance, dark_mean = spatial_variance(0.0)
    variance, mean = spatial_variance(0.5)
    assert np.sqrt(variance - dark_variance) / (mean - dark_mean) == pytest.approx(
        0.011, rel=0.02
    )
    assert np.sqrt(dark_variance) / system_gain == pytest.approx(2.4, rel=0.02)


def test_quantum_efficiency(system_gain):
    """Responsivity over K, with the standard's formula of photons: 50.34 A t lambda E in um^2, ms, um, uW/cm^2."""
    radiance, time_ms = 2.0, 4.0
    irradiance = np.pi / 4 / 4**2 * radiance * 100  # W/m^2 are 100 uW/cm^2
    photons = 50.34 * 3.45**2 * time_ms * 0.549 * irradiance
    flat = np.full((300, 300, 3), radiance)
    dim = SENSOR.replace(full_well=photons)
    photo = dim.expose(
        flat, camera=CAMERA, lens=LENS, exposure=Exposure(time_ms * 1e-3, GAIN)
    )
    electrons = (photo.image.mean() - 300) / dim.system_gain(GAIN)
    assert electrons / photons == pytest.approx(0.62, rel=0.005)
    assert photo.record["mean_electrons"] == pytest.approx(electrons, rel=0.001)


def test_dark_current_grows_with_time():
    """mu_dark = mu_0 + I t, with equal variance (EMVA 1288)."""
    dark = np.zeros((300, 300, 3))
    warm = SENSOR.replace(dark_current=50.0, dsnu=0.0, read_noise=0.0)
    photo = warm.expose(dark, camera=CAMERA, lens=LENS, exposure=Exposure(8.0))
    electrons = (photo.image - 300.0) / warm.system_gain()
    assert electrons.mean() == pytest.approx(400, rel=0.005)
    assert electrons.var() == pytest.approx(400, rel=0.02)
