"""Lenses, apertures, distortions, exposures and sensors from the texts of options."""

from dataclasses import replace

import numpy as np
import pytest

from twinlens.camera import (
    Annulus,
    BareAperture,
    BrownConrady,
    Camera,
    Disk,
    KannalaBrandt,
    MaskAperture,
    Pinhole,
    Polygon,
    ThinLens,
)
from twinlens.dataset import write_png
from twinlens.errors import InputError
from twinlens.factory.camera_text import (
    parse_distortion,
    parse_exposure,
    parse_misalignment,
    parse_mismatch,
    parse_sensor,
    parse_size,
)
from twinlens.factory.lenses import View, parse_aperture, parse_lens
from twinlens.optics import middle_focus
from twinlens.scenes import Scene
from twinlens.sensor import Exposure, Mismatch, Sensor

VIEW = View(
    Scene("made", (), {}, np.eye(4), (2.0, 6.0)),
    Camera(64, 48, 1000.0, 1000.0, 31.5, 23.5),
    (),
)


@pytest.mark.parametrize(
    ("text", "lens"),
    [
        ("pinhole", Pinhole()),
        ("thin:20", ThinLens(0.02, middle_focus(2.0, 6.0))),
        ("thin:20@1.5", ThinLens(0.02, 1.5)),
        ("f/ 2@inf", ThinLens(0.0025, float("inf"))),
        ("hole:0.35@50", BareAperture(0.35e-3, 0.05)),
    ],
)
def test_lenses(text, lens):
    assert parse_lens(text, VIEW) == lens


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "unknown lens ''"),
        ("thick:2", "did you mean 'thin'"),
        ("pinhole:3", "must be pinhole"),
        ("thin:2@near", "must be thin:DIAMETER_MM"),
        ("f/", "must be f/N"),
        ("hole:1", "must be hole:DIAMETER_MM@FILM_MM"),
        ("thin:x", "must be thin:DIAMETER_MM.*'x' is no number"),
        ("hole:1@inf", "film_mm: must be a number"),
    ],
)
def test_bad_lenses_raise_errors(text, message):
    with pytest.raises(InputError, match=message) as error:
        parse_lens(text, VIEW)
    assert str(error.value).startswith(f"--lens {text!r}")
    assert "\n" not in str(error.value)


def test_the_aperture_applies_to_every_lens_with_a_diameter():
    shape = Polygon(5)
    assert parse_lens("pinhole", VIEW, shape) == Pinhole()
    for text in ("thin:20", "f/2", "hole:0.35@50"):
        assert parse_lens(text, VIEW, shape).aperture == shape


@pytest.mark.parametrize(
    ("text", "shape"),
    [
        ("disk", Disk()),
        ("polygon: 6.0", Polygon(6)),
        ("polygon:5:-12.5:0.3", Polygon(5, rotation_deg=-12.5, roundness=0.3)),
        ("annulus:0.5", Annulus(0.5)),
    ],
)
def test_apertures(text, shape):
    assert parse_aperture(text) == shape


@pytest.mark.parametrize("channels", [1, 3])
def test_a_mask_has_the_transmission_of_the_image(tmp_path, channels):
    cells = np.random.default_rng(0).integers(0, 256, (4, 6), dtype=np.uint8)
    path = tmp_path / "code.png"
    write_png(path, cells if channels == 1 else np.dstack([cells] * 3))
    assert parse_aperture(f"mask:{path}") == MaskAperture(cells / 255)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("polygn:6", "did you mean 'polygon'"),
        ("polygon:6:1:0:3", "must be polygon:BLADES"),
        ("polygon:6.5", "blades: must be a whole number from 3 to 1000, got '6.5'"),
        ("disk:2", "must be disk"),
        ("mask:", "must be mask:FILE"),
    ],
)
def test_bad_apertures_raise_errors(text, message):
    with pytest.raises(InputError, match=message) as error:
        parse_aperture(text)
    assert str(error.value).startswith(f"--aperture {text!r}")


@pytest.mark.parametrize(
    ("text", "model"),
    [
        (
            "0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8",
            BrownConrady(0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
        ),
        ("brown-conrady:0,0,0.01,0", BrownConrady(p1=0.01)),
        ("fisheye:0.1, -0.02", KannalaBrandt(k1=0.1, k2=-0.02)),
    ],
)
def test_distortion_coefficients_are_in_opencv_order(text, model):
    assert parse_distortion(text) == model


@pytest.mark.parametrize(
    ("text", "exposure"),
    [
        ("auto", None),
        ("0.01", Exposure(0.01)),
        ("1/60", Exposure(1 / 60)),
        ("2/3,4", Exposure(2 / 3, 4.0)),
    ],
)
def test_exposures(text, exposure):
    assert parse_exposure(text) == exposure


def test_mismatches():
    assert parse_mismatch("blur_px=0.5,time=2") == Mismatch(time=2.0, blur_px=0.5)
    drawn = Mismatch.draw("typical", 4)
    assert parse_mismatch("typical", 4) == drawn
    assert parse_mismatch(" typical , seed = 4") == drawn
    assert parse_mismatch("level=typical,blur_px=0", 4) == replace(drawn, blur_px=0.0)


@pytest.mark.parametrize(
    ("text", "sensor"),
    [
        ("phone", Sensor.preset("phone")),
        (
            "phone:shot_noise=no,vignetting=yes",
            Sensor.preset("phone", shot_noise=False, vignetting=True),
        ),
        (
            "phone:wavelengths=6e-7/5e-7/4e-7",
            Sensor.preset("phone", wavelengths=(6e-7, 5e-7, 4e-7)),
        ),
    ],
)
def test_sensors(text, sensor):
    assert parse_sensor(text) == sensor


@pytest.mark.parametrize(
    ("parse", "text", "message"),
    [
        (parse_distortion, "0.1,nan", "must be k1"),
        (parse_distortion, "0.1,inf", "k2 must be a number from .* got inf"),
        (parse_distortion, "fisheye:1,2,3,4,5", r"fisheye:k1\[,k2"),
        (parse_distortion, "fishey:1", "did you mean 'fisheye'"),
        (parse_exposure, "1/0", "1/60"),
        (parse_exposure, "1/60,0", "gain"),
        (parse_exposure, "1/60,", "must be TIME_S"),
        (parse_mismatch, "", r"NAME=VALUE, or a level \(none, .*\) alone or first"),
        (parse_mismatch, "gain=1.05,typical", "alone or first; got 'typical'"),
        (parse_mismatch, "seed=3", "seed needs a level"),
        (parse_misalignment, "pitch=1", "did you mean 'pitch_deg'"),
        (parse_sensor, "phne", "did you mean 'phone'"),
        (parse_sensor, "phone:", "NAME=VALUE"),
        (parse_sensor, "ideal:preset=phone", "unknown parameter 'preset'"),
    ],
)
def test_errors_begin_with_the_option(parse, text, message):
    with pytest.raises(InputError, match=message) as error:
        parse(text)
    assert str(error.value).startswith("--")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "text", ["640x", "-1x4", "640x480x3", "6.4x480", "1" * 5000 + "x3"]
)
def test_bad_sizes_raise_errors(text):
    with pytest.raises(InputError, match="WIDTHxHEIGHT") as error:
        parse_size(text)
    assert len(str(error.value)) < 120
