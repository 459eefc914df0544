"""Exposure, seeds, rigs and images."""

import json
import math
import sys
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from twinlens.camera import (
    Annulus,
    BareAperture,
    Camera,
    MaskAperture,
    Pinhole,
    Rig,
    ThinLens,
)
from twinlens.sensor import PRESETS, Exposure, Mismatch, Sensor, auto_exposure
from twinlens.sensor.picture import FILTERS, demosaic, mosaic

CAMERA = Camera(96, 64, 100.0, 100.0, 47.5, 31.5)
LENS = ThinLens(CAMERA.film_distance / 4, focus_distance=2.0)
QUIET = Sensor.preset(
    "ideal", shot_noise=False, output="linear", bits=16, black_level=256.0
)


def grey(value: float = 1.0, camera: Camera = CAMERA) -> np.ndarray:
    return np.full((camera.height, camera.width, 3), value, dtype=np.float32)


def scene() -> np.ndarray:
    v, u = np.mgrid[:64, :96]
    return np.stack(
        [1 + np.sin(u / 7), 1 + np.cos(v / 5), 0.2 + u / 96], axis=-1
    ).astype(np.float32)


@pytest.mark.parametrize("stop", range(9))
def test_brightness_follows_the_aperture_squared_over_eight_stops(stop):
    """With shot noise and one exposure: each stop halves the light."""
    sensor = Sensor.preset("ideal", output="raw")
    exposure = Exposure(1e-3)
    scale = (
        0.7
        * sensor.full_well
        / (sensor.electrons_per_radiance(CAMERA, LENS).max() * 1e-3)
    )
    lens = LENS.replace(aperture_diameter=LENS.aperture_diameter / math.sqrt(2**stop))
    full, stopped = (
        sensor.expose(
            grey(scale), camera=CAMERA, lens=each, exposure=exposure
        ).image.mean()
        for each in (LENS, lens)
    )
    assert stopped * 2**stop == pytest.approx(full, rel=0.01)


@pytest.mark.parametrize(
    "aperture",
    [Annulus(0.6), MaskAperture([[1, 0.5], [0.25, 0]])],
    ids=lambda a: a.name,
)
def test_brightness_follows_the_open_area(aperture):
    exposure = Exposure(1e-3)
    light = [
        QUIET.expose(grey(), camera=CAMERA, lens=lens, exposure=exposure).record[
            "mean_electrons"
        ]
        for lens in (LENS, LENS.replace(aperture=aperture))
    ]
    assert light[1] / light[0] == pytest.approx(aperture.area_fraction, rel=1e-6)


def test_a_small_bare_aperture_and_a_lens_of_the_same_size_pass_equal_light():
    size = CAMERA.film_distance / 16
    hole, lens = (
        BareAperture(size, CAMERA.film_distance),
        LENS.replace(aperture_diameter=size),
    )
    ratio = QUIET.electrons_per_radiance(CAMERA, hole) / QUIET.electrons_per_radiance(
        CAMERA, lens
    )
    assert ratio == pytest.approx([1, 1, 1], rel=1e-3)


def test_light_per_pixel_does_not_depend_on_the_film_distance():
    """E decreases as 1/v^2 while the pixel area (v/fx)^2 grows as v^2."""
    near, far = BareAperture(1e-3, 0.05), BareAperture(1e-3, 0.1)
    ratio = QUIET.electrons_per_radiance(CAMERA, far) / QUIET.electrons_per_radiance(
        CAMERA, near
    )
    assert ratio == pytest.approx([1, 1, 1], rel=1e-3)


def test_a_pinhole_is_exposed_as_its_f_number():
    f8 = ThinLens(CAMERA.film_distance / 8, focus_distance=math.inf)
    pinhole, f8 = (
        QUIET.expose(grey(), camera=CAMERA, lens=lens, exposure=Exposure(0.01)).record
        for lens in (Pinhole(), f8)
    )
    assert pinhole["mean_electrons"] == pytest.approx(f8["mean_electrons"])
    assert pinhole["working_f_number"] == 8


def test_vignetting_is_the_fourth_power_of_the_cosine():
    wide = Camera(101, 3, 50.0, 50.0, 50.0, 1.0)
    exposure = auto_exposure(
        [grey(1, wide)], sensor=QUIET, cameras=wide, lens=Pinhole()
    )
    dark = (
        QUIET.replace(vignetting=True)
        .expose(grey(1, wide), camera=wide, lens=Pinhole(), exposure=exposure)
        .image
    )
    flat = QUIET.expose(
        grey(1, wide), camera=wide, lens=Pinhole(), exposure=exposure
    ).image
    assert dark[1, 100, 1] / flat[1, 100, 1] == pytest.approx(
        0.25, rel=1e-3
    )  # 45 degrees
    assert dark[1, 50, 1] == flat[1, 50, 1]


def test_linear_output_is_proportional_to_radiance_and_balanced():
    image = scene()
    exposure = Exposure(0.9 / QUIET.level_rate(image, camera=CAMERA, lens=LENS).max())
    picture = QUIET.replace(quantum_efficiency=(0.3, 0.9, 0.5)).expose(
        image, camera=CAMERA, lens=LENS, exposure=exposure
    )
    ratio = picture.image / image
    assert picture.image.dtype == np.uint16
    assert np.ptp(ratio[image > 0.3]) / ratio.mean() < 0.01


def test_auto_exposure_makes_a_grey_wall_middle_grey():
    picture = Sensor().expose(grey(37.0), camera=CAMERA, lens=LENS).image
    assert picture.dtype == np.uint8
    assert picture.mean() == pytest.approx(
        118, abs=1
    )  # 18% of white, as sRGB writes it


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
def test_auto_exposure_does_not_depend_on_the_radiance_scale(scale):
    assert Sensor().expose(
        scene() * scale, camera=CAMERA, lens=LENS
    ).image.mean() == pytest.approx(
        Sensor().expose(scene(), camera=CAMERA, lens=LENS).image.mean(), rel=0.01
    )


def test_auto_exposure_keeps_highlights_within_two_stops():
    image = grey(1.0)
    image[:, :48] = 6.0
    assert (
        Sensor().expose(image, camera=CAMERA, lens=LENS).record["saturated_fraction"]
        == 0
    )
    image[:8, :8] = 1e5
    lamp = Sensor().expose(image, camera=CAMERA, lens=LENS)
    assert lamp.image[40, 80].mean() > 40


def test_a_black_scene_gives_a_black_image():
    photo = Sensor(longest_exposure=1.0).expose(grey(0.0), camera=CAMERA, lens=LENS)
    assert photo.record["time_s"] == 1.0
    assert photo.record["gain"] == 16.0
    assert photo.image.mean() < 20


def test_gain_is_used_after_the_longest_time():
    dim = Sensor().expose(grey(), camera=CAMERA, lens=LENS).record
    short = Sensor(longest_exposure=dim["time_s"] / 4).expose(
        grey(), camera=CAMERA, lens=LENS
    )
    assert short.record["gain"] == pytest.approx(4)
    assert short.image.mean() == pytest.approx(118, abs=1.5)


def test_exposure_value_equals_its_definition():
    record = (
        Sensor()
        .expose(grey(), camera=CAMERA, lens=LENS, exposure=Exposure(1 / 60))
        .record
    )
    assert record["ev"] == pytest.approx(math.log2(4**2 * 60))


RIG = Rig.stereo(CAMERA, baseline=0.1)
FIXED = Sensor(
    prnu=0.05,
    dsnu=0.0,
    read_noise=0.0,
    dark_current=0.0,
    output="raw",
    vignetting=False,
)


def noise_of(sensor: Sensor, **how) -> np.ndarray:
    image = sensor.expose(grey(), camera=CAMERA, lens=LENS, **how).image.astype(
        np.float64
    )
    return (image - image.mean(axis=(0, 1))).ravel()


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a, b)[0, 1])


def test_the_seed_determines_the_bytes_with_threads():
    def take(_: int) -> bytes:
        return (
            Sensor().expose(scene(), camera=CAMERA, lens=LENS, seed=5).image.tobytes()
        )

    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(take, range(8)))) == 1


def test_seeds_give_independent_noise():
    sensor = FIXED.replace(prnu=0.0)
    a, b, c = (noise_of(sensor, seed=seed) for seed in (0, 1, 2**40))
    bound = 5 / math.sqrt(len(a))
    assert (
        max(abs(correlation(a, b)), abs(correlation(b, c)), abs(correlation(a, c)))
        < bound
    )


def test_left_and_right_noise_is_uncorrelated():
    left, right = Sensor(output="raw", vignetting=False).expose_pair(
        grey(), grey(), rig=RIG, lens=LENS, seed=0
    )
    a, b = ((p.image - p.image.mean(axis=(0, 1))).ravel() for p in (left, right))
    assert abs(correlation(a, b)) < 5 / math.sqrt(len(a))
    assert left.record["time_s"] == right.record["time_s"]


def test_the_fixed_pattern_depends_on_the_sensor_only():
    """Equal in all frames; different for other cameras and serial numbers."""
    still = FIXED.replace(shot_noise=False)
    first = noise_of(still, seed=1)
    assert correlation(first, noise_of(still, seed=2)) > 0.9999
    bound = 5 / math.sqrt(len(first))
    assert abs(correlation(first, noise_of(still, seed=1, eye=1))) < bound
    assert abs(correlation(first, noise_of(still.replace(serial=7), seed=1))) < bound


def test_a_pair_shares_one_exposure():
    left, right = QUIET.expose_pair(grey(1.0), grey(3.0), rig=RIG, lens=LENS)
    assert right.image.mean() / left.image.mean() == pytest.approx(3, rel=1e-3)


def test_mismatch_changes_the_second_camera():
    wrong = QUIET.replace(
        mismatch=Mismatch(gain=1.1, time=0.7, black_level=40.0), output="raw"
    )
    left, right = wrong.expose_pair(grey(), grey(), rig=RIG, lens=LENS)
    light = left.image.mean() - 256
    assert right.image.mean() == pytest.approx(256 + 40 + 1.1 * 0.7 * light, rel=1e-3)
    assert right.record["black_level_dn"] == 296
    assert right.record["gain"] == pytest.approx(1.1 * left.record["gain"])


@pytest.mark.parametrize(
    ("linear", "byte"), [(0.0, 0), (0.0031308, 10), (0.18, 118), (0.5, 188), (1.0, 255)]
)
def test_srgb_equals_published_values(linear, byte):
    sensor = QUIET.replace(output="srgb", bits=8)
    exposure = Exposure(
        linear / sensor.level_rate(grey(), camera=CAMERA, lens=LENS).max() or 1e-12
    )
    assert (
        sensor.expose(grey(), camera=CAMERA, lens=LENS, exposure=exposure).image == byte
    ).all()


def test_gamma_output_is_the_power_law():
    exposure = Exposure(0.25 / QUIET.level_rate(grey(), camera=CAMERA, lens=LENS).max())
    picture = (
        QUIET.replace(output="gamma", gamma=2.0)
        .expose(grey(), camera=CAMERA, lens=LENS, exposure=exposure)
        .image
    )
    assert picture == pytest.approx(65535 / 2, rel=1e-3)


@pytest.mark.parametrize("pattern", [f for f in FILTERS if len(f) == 4 and f.isupper()])
def test_a_mosaic_has_the_colours_of_its_name(pattern):
    for channel, letter in enumerate("RGB"):
        light = np.zeros((4, 4, 3))
        light[..., channel] = 1
        seen = mosaic(light, pattern)
        assert "".join(
            "?" if not bright else letter for bright in seen[:2, :2].ravel()
        ) == "".join(letter if letter == there else "?" for there in pattern)
        assert (seen == np.tile(seen[:2, :2], (2, 2))).all()


@pytest.mark.parametrize("pattern", [f for f in FILTERS if len(f) == 4 and f.isupper()])
def test_demosaicing_restores_smooth_colours(pattern):
    v, u = np.mgrid[:64, :96]
    image = np.stack([0.2 + u / 200, 0.9 - v / 100, 0.4 + u / 300], axis=-1)
    exposure = Exposure(0.9 / QUIET.level_rate(image, camera=CAMERA, lens=LENS).max())
    full, bayer = (
        QUIET.replace(filters=f, quantum_efficiency=(0.5, 1.0, 0.7))
        .expose(image, camera=CAMERA, lens=LENS, exposure=exposure)
        .image.astype(float)
        for f in ("rgb", pattern)
    )
    assert np.abs(bayer - full)[4:-4, 4:-4].max() < 0.01 * 65535


def test_mono_sums_the_three_bands():
    sensor = QUIET.replace(
        filters="mono", output="raw", quantum_efficiency=(0.2, 0.5, 0.3)
    )
    record = sensor.expose(
        grey(), camera=CAMERA, lens=LENS, exposure=Exposure(1e-3)
    ).record
    assert record["mean_electrons"] == pytest.approx(
        sum(record["electrons_per_radiance"])
    )
    assert sensor.expose(grey(), camera=CAMERA, lens=LENS).image.shape == (64, 96)


@pytest.mark.parametrize("bits", [8, 10, 16])
def test_raw_output_is_the_converters_numbers(bits):
    sensor = Sensor(adc_bits=bits, output="raw", black_level=20.0, largest_gain=1e9)
    photo = sensor.expose(grey(1e9), camera=CAMERA, lens=LENS, exposure=Exposure(1.0))
    assert photo.image.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert photo.image.max() == 2**bits - 1
    assert photo.record["saturated_fraction"] > 0.4


@pytest.mark.parametrize("name", PRESETS)
def test_presets_give_well_exposed_images(name):
    photo = Sensor.preset(name).expose(scene(), camera=CAMERA, lens=LENS)
    assert photo.image.shape == (64, 96, 3)
    assert 60 < photo.image.mean() < 160
    assert (
        json.loads(json.dumps(photo.record))["sensor"]["full_well"]
        == Sensor.preset(name).full_well
    )


def test_the_default_has_the_snr_and_the_threshold_of_its_source():
    """The manual of the mvBlueFOX3-2051: 40.3 dB, and 71.2 dB from full well to threshold.

    The read noise has two digits: half a unit of the last one changes the threshold by 0.14 dB.
    """
    sensor = Sensor.preset("machine_vision")
    threshold = (
        np.sqrt(sensor.read_noise**2 + (sensor.full_well / 4095) ** 2 / 12 + 1 / 4)
        + 1 / 2
    )
    assert 10 * np.log10(sensor.full_well) == pytest.approx(40.3, abs=0.05)
    assert 20 * np.log10(sensor.full_well / threshold) == pytest.approx(71.2, abs=0.14)


def test_every_preset_works_without_opencv(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    for name in PRESETS:
        assert Sensor.preset(name).expose(
            grey(), camera=CAMERA, lens=LENS
        ).image.shape == (64, 96, 3)
    assert Sensor(filters="RGGB", output="raw").expose(
        grey(), camera=CAMERA, lens=LENS
    ).image.shape == (64, 96)


def test_demosaicing_is_as_accurate_as_opencv():
    """Mean square error on an image with edges and texture, against OpenCV's edge-aware method."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:128, :160]
    grey_level = (
        0.5
        + 0.2 * np.sin(u / 3 + v / 7)
        + 0.2 * ((u - 80) ** 2 + (v - 64) ** 2 < 40**2)
    )
    image = np.clip(
        grey_level[..., None] * [0.9, 1.0, 0.7] + rng.normal(0, 0.01, (128, 160, 1)),
        0,
        1,
    )
    ours = demosaic(mosaic(image, "RGGB"), "RGGB")
    sixteen = np.rint(mosaic(image, "RGGB") * 65535).astype(np.uint16)
    theirs = cv2.cvtColor(sixteen, cv2.COLOR_BayerRGGB2RGB_EA) / 65535
    inner = (slice(4, -4), slice(4, -4))
    assert ((ours - image)[inner] ** 2).mean() < ((theirs - image)[inner] ** 2).mean()
