"""Exposure, seeds, rigs and images."""

import json
import math
import sys
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from tests.sensor.flat_fields import (
    CAMERA,
    LENS,
    QUIET,
    RIG,
    WHITE,
    colours,
    correlation,
    exposure_to,
    shot,
)
from twinlens.camera import Annulus, BareAperture, MaskAperture, Pinhole, ThinLens
from twinlens.sensor import PRESETS, Exposure, Mismatch, Sensor
from twinlens.sensor.picture import FILTERS, demosaic, mosaic

MIDDLE_GREY = 118  # 18% of white, as sRGB writes it
PATTERNS = [name for name in FILTERS if len(name) == 4 and name.isupper()]


@pytest.mark.parametrize("stop", [1, 4, 8])
def test_brightness_follows_the_aperture_squared_over_eight_stops(stop):
    """With shot noise and one exposure: each stop halves the light."""
    sensor = Sensor.preset("ideal", output="raw")
    narrow = LENS.replace(aperture_diameter=LENS.aperture_diameter / 2 ** (stop / 2))
    exposure = exposure_to(0.7, sensor)
    full, stopped = (
        shot(sensor, lens=lens, exposure=exposure).image.mean()
        for lens in (LENS, narrow)
    )
    assert stopped * 2**stop == pytest.approx(full, rel=0.01)


@pytest.mark.parametrize(
    "aperture", [Annulus(0.6), MaskAperture([[1, 0.5], [0.25, 0]])]
)
def test_brightness_follows_the_open_area(aperture):
    whole, part = (
        QUIET.electrons_per_radiance(CAMERA, lens)
        for lens in (LENS, LENS.replace(aperture=aperture))
    )
    assert part / whole == pytest.approx([aperture.area_fraction] * 3, rel=1e-6)


def test_light_per_pixel_does_not_depend_on_the_film_distance():
    """E decreases as 1/v^2 while the pixel area (v/fx)^2 grows as v^2."""
    near, far = (
        QUIET.electrons_per_radiance(CAMERA, BareAperture(1e-3, distance))
        for distance in (0.05, 0.1)
    )
    assert far / near == pytest.approx([1, 1, 1], rel=1e-3)


def test_a_pinhole_is_exposed_as_its_f_number():
    f8 = ThinLens(CAMERA.film_distance / 8, focus_distance=math.inf)
    pinhole, wide = (
        shot(QUIET, lens=lens, exposure=Exposure(0.01)).record
        for lens in (Pinhole(), f8)
    )
    assert pinhole["mean_electrons"] == pytest.approx(wide["mean_electrons"])
    assert pinhole["working_f_number"] == 8


def test_linear_output_is_proportional_to_radiance_and_balanced():
    image = colours()
    sensor = QUIET.replace(quantum_efficiency=(0.3, 0.9, 0.5), black_level=256.0)
    picture = shot(sensor, image, exposure=exposure_to(0.9, QUIET, image)).image
    ratio = picture / image
    assert picture.dtype == np.uint16
    assert np.ptp(ratio[image > 0.3]) / ratio.mean() < 0.01


@pytest.mark.parametrize("radiance", [1e-3, 37.0, 1e6])
def test_auto_exposure_makes_a_grey_wall_middle_grey(radiance):
    picture = shot(Sensor(), radiance * WHITE).image
    assert picture.dtype == np.uint8
    assert picture.mean() == pytest.approx(MIDDLE_GREY, abs=1)


def test_auto_exposure_keeps_highlights_within_two_stops():
    image = WHITE.copy()
    image[:, :48] = 6.0
    assert shot(Sensor(), image).record["saturated_fraction"] == 0
    image[:8, :8] = 1e5
    assert shot(Sensor(), image).image[40, 80].mean() > 40


def test_a_black_scene_gives_a_black_image():
    photo = shot(Sensor(longest_exposure=1.0), 0 * WHITE)
    assert (photo.record["time_s"], photo.record["gain"]) == (1.0, 16.0)
    assert photo.image.mean() < 20


def test_gain_is_used_after_the_longest_time():
    time = shot(Sensor()).record["time_s"]
    short = shot(Sensor(longest_exposure=time / 4))
    assert short.record["gain"] == pytest.approx(4)
    assert short.image.mean() == pytest.approx(MIDDLE_GREY, abs=1.5)


def test_exposure_value_equals_its_definition():
    record = shot(Sensor(), exposure=Exposure(1 / 60)).record
    assert record["ev"] == pytest.approx(math.log2(4**2 * 60))


NOISY = Sensor(
    prnu=0.0,
    dsnu=0.0,
    read_noise=0.0,
    dark_current=0.0,
    output="raw",
    vignetting=False,
)


def noise(image: np.ndarray) -> np.ndarray:
    """A flat field without the means of its channels."""
    return image - image.mean(axis=(0, 1))


def noise_of(sensor: Sensor, **how) -> np.ndarray:
    return noise(shot(sensor, **how).image)


def assert_independent(*noises: np.ndarray) -> None:
    bound = 5 / math.sqrt(noises[0].size)
    for first, second in zip(noises, noises[1:] + noises[:1], strict=True):
        assert abs(correlation(first, second)) < bound


def test_the_seed_determines_the_bytes_with_threads():
    def take(_: int) -> bytes:
        return shot(Sensor(), colours(), seed=5).image.tobytes()

    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(take, range(8)))) == 1


def test_seeds_and_cameras_give_independent_noise():
    assert_independent(*(noise_of(NOISY, seed=seed) for seed in (0, 1, 2**40)))
    left, right = Sensor(output="raw", vignetting=False).expose_pair(
        WHITE, WHITE, rig=RIG, lens=LENS
    )
    assert_independent(noise(left.image), noise(right.image))
    assert left.record["time_s"] == right.record["time_s"]


def test_the_fixed_pattern_depends_on_the_sensor_only():
    """Equal in all frames; different for other cameras and serial numbers."""
    still = NOISY.replace(prnu=0.05, shot_noise=False)
    first = noise_of(still, seed=1)
    assert correlation(first, noise_of(still, seed=2)) > 0.9999
    second = noise_of(still, seed=1, eye=1)
    assert_independent(first, second, noise_of(still.replace(serial=7), seed=1))


def test_a_pair_shares_one_exposure():
    left, right = QUIET.expose_pair(WHITE, 3 * WHITE, rig=RIG, lens=LENS)
    assert right.image.mean() / left.image.mean() == pytest.approx(3, rel=1e-3)


def test_mismatch_changes_the_second_camera():
    mismatch = Mismatch(gain=1.1, time=0.7, black_level=40.0)
    wrong = QUIET.replace(black_level=256.0, mismatch=mismatch, output="raw")
    left, right = wrong.expose_pair(WHITE, WHITE, rig=RIG, lens=LENS)
    light = left.image.mean() - 256
    assert right.image.mean() == pytest.approx(256 + 40 + 1.1 * 0.7 * light, rel=1e-3)
    assert right.record["black_level_dn"] == 296
    assert right.record["gain"] == pytest.approx(1.1 * left.record["gain"])


@pytest.mark.parametrize(
    ("linear", "byte"),
    [(1e-12, 0), (0.0031308, 10), (0.18, MIDDLE_GREY), (0.5, 188), (1.0, 255)],
)
def test_srgb_equals_published_values(linear, byte):
    sensor = QUIET.replace(output="srgb", bits=8)
    assert (shot(sensor, exposure=exposure_to(linear, sensor)).image == byte).all()


def test_gamma_output_is_the_power_law():
    sensor = QUIET.replace(output="gamma", gamma=2.0)
    picture = shot(sensor, exposure=exposure_to(0.25, QUIET)).image
    assert picture == pytest.approx(65535 / 2, rel=1e-3)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_mosaic_has_the_colours_of_its_name(pattern):
    letters = np.array(list(pattern)).reshape(2, 2)
    for channel, letter in enumerate("RGB"):
        light = np.zeros((4, 4, 3))
        light[..., channel] = 1
        assert (mosaic(light, pattern) == np.tile(letters == letter, (2, 2))).all()


@pytest.mark.parametrize("pattern", PATTERNS)
def test_demosaicing_restores_smooth_colours(pattern):
    v, u = np.mgrid[:64, :96]
    image = np.stack([0.2 + u / 200, 0.9 - v / 100, 0.4 + u / 300], axis=-1)
    exposure = exposure_to(0.9, QUIET, image)
    sensor = QUIET.replace(quantum_efficiency=(0.5, 1.0, 0.7))
    full, bayer = (
        shot(sensor.replace(filters=filters), image, exposure=exposure)
        for filters in ("rgb", pattern)
    )
    error = np.subtract(full.image, bayer.image, dtype=np.float64)
    assert np.abs(error)[4:-4, 4:-4].max() < 0.01 * 65535


def test_mono_sums_the_three_bands():
    efficiency = (0.2, 0.5, 0.3)
    sensor = QUIET.replace(filters="mono", output="raw", quantum_efficiency=efficiency)
    photo = shot(sensor, exposure=Exposure(1e-3))
    assert photo.record["mean_electrons"] == pytest.approx(
        sum(photo.record["electrons_per_radiance"])
    )
    assert photo.image.shape == (64, 96)


@pytest.mark.parametrize("bits", [8, 10, 16])
def test_raw_output_is_the_converters_numbers(bits):
    sensor = Sensor(adc_bits=bits, output="raw", black_level=20.0)
    photo = shot(sensor, 1e9 * WHITE, exposure=Exposure(1.0))
    assert photo.image.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert photo.image.max() == 2**bits - 1
    assert photo.record["saturated_fraction"] > 0.4


@pytest.mark.parametrize("name", PRESETS)
def test_presets_give_well_exposed_images_without_opencv(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    sensor = Sensor.preset(name)
    photo = shot(sensor, colours())
    assert photo.image.shape == (64, 96, 3)
    assert 60 < photo.image.mean() < 160
    record = json.loads(json.dumps(photo.record))
    assert record["sensor"]["full_well"] == sensor.full_well


def test_the_default_has_the_snr_and_the_threshold_of_its_source():
    """The manual of the mvBlueFOX3-2051: 40.3 dB, and 71.2 dB from full well to threshold.

    The read noise has two digits: half a unit of the last one changes the threshold by 0.14 dB.
    """
    sensor = Sensor.preset("machine_vision")
    rounding = (sensor.full_well / 4095) ** 2 / 12
    threshold = np.sqrt(sensor.read_noise**2 + rounding + 1 / 4) + 1 / 2
    assert 10 * np.log10(sensor.full_well) == pytest.approx(40.3, abs=0.05)
    assert 20 * np.log10(sensor.full_well / threshold) == pytest.approx(71.2, abs=0.14)


def test_demosaicing_is_as_accurate_as_opencv():
    """Mean square error on an image with edges and texture, against OpenCV's edge-aware method."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:128, :160]
    disk = (u - 80) ** 2 + (v - 64) ** 2 < 40**2
    level = 0.5 + 0.2 * np.sin(u / 3 + v / 7) + 0.2 * disk
    grain = rng.normal(0, 0.01, (128, 160, 1))
    image = np.clip(level[..., None] * [0.9, 1.0, 0.7] + grain, 0, 1)
    bayer = mosaic(image, "RGGB")
    sixteen = np.rint(bayer * 65535).astype(np.uint16)
    theirs = cv2.cvtColor(sixteen, cv2.COLOR_BayerRGGB2RGB_EA) / 65535

    def error(restored: np.ndarray) -> float:
        return ((restored - image)[4:-4, 4:-4] ** 2).mean()

    assert error(demosaic(bayer, "RGGB")) < error(theirs)
