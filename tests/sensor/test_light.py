"""Irradiance of the film against integrals, view factors of heat transfer, and the physical limit."""

import json
import math
import warnings

import numpy as np
import pytest
from scipy.integrate import quad

from twinlens.camera import Annulus, BareAperture, Camera, MaskAperture, Pinhole, Polygon, Rig, ThinLens
from twinlens.sensor import Exposure, ParaxialWarning, Sensor
from twinlens.sensor.light import irradiance_factor, working_f_number

CAMERA = Camera(96, 64, 100.0, 100.0, 47.5, 31.5)
WIDTHS = [0.01, 0.5, 1.0, 5.0, 20.0, 100.0]


def share(lens: ThinLens | BareAperture | Pinhole) -> float:
    """E / (pi L): 1 is the physical limit."""
    return irradiance_factor(CAMERA, lens, 8.0) / math.pi


def hole(width: float, *shape) -> BareAperture:
    """A bare aperture with A/v = `width`."""
    return BareAperture(width * 0.05, 0.05, *shape)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_bare_aperture_integrates_cosines_over_its_cone(width):
    """dE = L cos(theta) dOmega over the cone of the aperture: integrated over angles, not over the area."""
    expected, _ = quad(lambda t: 2 * math.cos(t) * math.sin(t), 0, math.atan(width / 2), epsabs=0, epsrel=1e-12)
    assert share(hole(width)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("shape", [(), (MaskAperture([[1.0]]),), (Polygon(5),)], ids=["disk", "mask", "polygon"])
def test_no_bare_aperture_exceeds_the_physical_limit(shape):
    shares = [share(hole(width, *shape)) for width in [*WIDTHS, 1e4, 1e8]]
    assert shares[:6] == sorted(shares[:6])
    assert max(shares) <= 1


@pytest.mark.parametrize("width", WIDTHS)
def test_a_bare_ring_is_the_difference_of_two_disks(width):
    assert share(hole(width, Annulus(0.6))) == pytest.approx(share(hole(width)) - share(hole(0.6 * width)), rel=1e-3)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("shape", [Polygon(4), MaskAperture([[1.0]])], ids=lambda shape: shape.name)
def test_a_bare_square_equals_the_view_factor_of_a_rectangle(width, shape):
    """Four corners of Howell's B-3: F = 1/(2 pi) (X/s atan(Y/s) + Y/t atan(X/t)), s^2 = 1 + X^2, t^2 = 1 + Y^2."""
    half = width / 2 / (math.sqrt(2) if shape.name == "polygon" else 1)
    s = math.hypot(1, half)
    assert share(hole(width, shape)) == pytest.approx(4 / math.pi * half / s * math.atan(half / s), rel=1e-3)


@pytest.mark.parametrize("width", [0.02, 0.05, 0.1, 0.15])
def test_a_small_bare_aperture_equals_the_lens(width):
    assert share(hole(width)) / share(hole(0.01)) == pytest.approx((width / 0.01) ** 2, rel=0.01)
    assert share(hole(width)) == pytest.approx(share(ThinLens(width * CAMERA.film_distance, 1.0)), rel=0.01)


def test_a_bare_aperture_of_zero_width_is_exposed_as_the_pinhole():
    assert share(BareAperture(0.0, 0.05)) == share(Pinhole()) == pytest.approx(1 / 256)


@pytest.mark.parametrize(("number", "warns"), [(0.5, True), (0.99, True), (1.0, False), (4.0, False)])
def test_a_lens_below_f1_gives_a_paraxial_warning(number, warns):
    """For a given exposure, once per image or rig, attributed to the calling line."""
    lens = ThinLens(CAMERA.film_distance / number, 1.0)
    assert share(lens) == pytest.approx(0.25 / number**2)
    white, given = np.ones((64, 96, 3)), Exposure(1e-6)
    rig = Rig.stereo(CAMERA, baseline=0.1)
    calls = (
        lambda: Sensor().expose(white, camera=CAMERA, lens=lens, exposure=given),
        lambda: Sensor().expose_rig([white, white], rig=rig, lens=lens, exposure=given),
    )
    for call in calls:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            call()
        assert [(w.category, w.filename) for w in caught] == [(ParaxialWarning, __file__)] * warns
        assert all("\n" not in str(w.message) for w in caught)


@pytest.mark.parametrize("fast", [0, 1, 2])
def test_the_warning_is_for_the_fastest_camera_of_a_rig(fast):
    """Three cameras: one has half the film distance, f/0.7, the others f/1.4."""
    cameras = [CAMERA] * 3
    cameras[fast] = CAMERA.replace(pixel_pitch_um=CAMERA.pixel_pitch_um / 2)
    rig, white = Rig(cameras, [np.eye(4)] * 3), [np.ones((64, 96, 3))] * 3
    lens = ThinLens(CAMERA.film_distance / 1.4, 1.0)
    with pytest.warns(ParaxialWarning, match=r"working f-number v/A = 0\.7 ") as caught:
        Sensor().expose_rig(white, rig=rig, lens=lens, exposure=Exposure(1e-6))
    assert len(caught) == 1


def test_an_automatic_exposure_compensates_for_the_paraxial_formula():
    """f/0.05 and f/4 give the same grey, without a warning (warnings are errors here)."""
    wide, narrow = (
        Sensor(shot_noise=False).expose(
            np.ones((64, 96, 3)), camera=CAMERA, lens=ThinLens(CAMERA.film_distance / number, 1.0)
        )
        for number in (0.05, 4.0)
    )
    assert wide.image.mean() == pytest.approx(narrow.image.mean(), abs=0.5)


@pytest.mark.parametrize("exposure", [None, Exposure(1e-6)])
def test_a_wide_bare_aperture_does_not_warn(exposure):
    photo = Sensor().expose(np.ones((64, 96, 3)), camera=CAMERA, lens=hole(20.0), exposure=exposure)
    assert photo.record["working_f_number"] == pytest.approx(0.05)


def test_the_record_has_the_working_f_number():
    """v/A = f/A (1 + v/s) for a focus distance s."""
    camera = CAMERA.replace(pixel_pitch_um=500.0)
    lens = ThinLens.from_f_number(2.8, focus_distance=0.1, film_distance=camera.film_distance)
    record = Sensor().expose(np.ones((64, 96, 3)), camera=camera, lens=lens).record
    assert "f_number" not in record
    assert record["working_f_number"] == pytest.approx(2.8 * (1 + camera.film_distance / 0.1))
    assert working_f_number(camera, lens, 8.0) == record["working_f_number"]
    json.dumps(record)
