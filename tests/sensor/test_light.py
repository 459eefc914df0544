"""Irradiance of the film against integrals, view factors of heat transfer, and the physical limit."""

import json
import math
import warnings

import numpy as np
import pytest
from scipy.integrate import quad

from tests.sensor.flat_fields import CAMERA, QUIET, RIG, WHITE, shot
from twinlens.camera import (
    Annulus,
    BareAperture,
    Camera,
    MaskAperture,
    Pinhole,
    Polygon,
    Rig,
    ThinLens,
)
from twinlens.sensor import Exposure, Sensor
from twinlens.sensor.light import (
    ParaxialWarning,
    irradiance_factor,
    vignetting,
    working_f_number,
)

WIDTHS = [0.01, 0.5, 1.0, 5.0, 20.0, 100.0]
SHORT = Exposure(1e-6)
SQUARE = MaskAperture([[1.0]])


def lens_of(f_number: float, camera: Camera = CAMERA) -> ThinLens:
    return ThinLens(camera.film_distance / f_number, 2.0)


def share(lens: ThinLens | BareAperture | Pinhole) -> float:
    """E / (pi L): 1 is the physical limit."""
    return irradiance_factor(CAMERA, lens, 8.0) / math.pi


def hole(width: float, *shape) -> BareAperture:
    """A bare aperture with A/v = `width`."""
    return BareAperture(width * 0.05, 0.05, *shape)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_bare_aperture_integrates_cosines_over_its_cone(width):
    """dE = L cos(theta) dOmega over the cone of the aperture: integrated over angles, not over the area."""
    limit = math.atan(width / 2)
    expected, _ = quad(lambda t: 2 * math.cos(t) * math.sin(t), 0, limit, epsrel=1e-12)
    assert share(hole(width)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("shape", [(), (SQUARE,), (Polygon(5),)])
def test_no_bare_aperture_exceeds_the_physical_limit(shape):
    shares = [share(hole(width, *shape)) for width in [*WIDTHS, 1e4, 1e8]]
    assert shares[:6] == sorted(shares[:6])
    assert max(shares) <= 1


@pytest.mark.parametrize("width", WIDTHS)
def test_a_bare_ring_is_the_difference_of_two_disks(width):
    expected = share(hole(width)) - share(hole(0.6 * width))
    assert share(hole(width, Annulus(0.6))) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize(("shape", "side"), [(Polygon(4), 0.5**0.5), (SQUARE, 1.0)])
def test_a_bare_square_equals_the_view_factor_of_a_rectangle(width, shape, side):
    """Four corners of Howell's B-3: F = 1/(2 pi) (X/s atan(Y/s) + Y/t atan(X/t)), s^2 = 1 + X^2, t^2 = 1 + Y^2."""
    half = side * width / 2
    s = math.hypot(1, half)
    expected = 4 / math.pi * half / s * math.atan(half / s)
    assert share(hole(width, shape)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("width", [0.02, 0.05, 0.1, 0.15])
def test_a_small_bare_aperture_equals_the_lens(width):
    assert share(hole(width)) == pytest.approx(share(lens_of(1 / width)), rel=0.01)


def test_a_bare_aperture_of_zero_width_is_exposed_as_the_pinhole():
    assert share(BareAperture(0.0, 0.05)) == share(Pinhole()) == pytest.approx(1 / 256)


@pytest.mark.parametrize(
    ("f_number", "warns"), [(0.5, True), (0.99, True), (1.0, False), (4.0, False)]
)
def test_a_lens_below_f1_gives_a_paraxial_warning(f_number, warns):
    """For a given exposure, once per image or rig, attributed to the calling line."""
    lens = lens_of(f_number)
    assert share(lens) == pytest.approx(0.25 / f_number**2)
    calls = (
        lambda: Sensor().expose(WHITE, camera=CAMERA, lens=lens, exposure=SHORT),
        lambda: Sensor().expose_rig([WHITE] * 2, rig=RIG, lens=lens, exposure=SHORT),
    )
    for call in calls:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            call()
        expected = [(ParaxialWarning, __file__)] * warns
        assert [(warning.category, warning.filename) for warning in caught] == expected
        assert all("\n" not in str(warning.message) for warning in caught)


@pytest.mark.parametrize("fast", [0, 1, 2])
def test_the_warning_is_for_the_fastest_camera_of_a_rig(fast):
    """Three cameras: one has half the film distance, f/0.7, the others f/1.4."""
    cameras = [CAMERA] * 3
    cameras[fast] = CAMERA.replace(pixel_pitch_um=CAMERA.pixel_pitch_um / 2)
    rig = Rig(cameras, [np.eye(4)] * 3)
    with pytest.warns(ParaxialWarning, match=r"working f-number v/A = 0\.7 ") as caught:
        Sensor().expose_rig([WHITE] * 3, rig=rig, lens=lens_of(1.4), exposure=SHORT)
    assert len(caught) == 1


def test_an_automatic_exposure_compensates_for_the_paraxial_formula():
    """f/0.05 and f/4 give the same grey, without a warning (warnings are errors here)."""
    wide, narrow = (
        shot(Sensor(shot_noise=False), lens=lens_of(number)).image.mean()
        for number in (0.05, 4.0)
    )
    assert wide == pytest.approx(narrow, abs=0.5)


@pytest.mark.parametrize("exposure", [None, SHORT])
def test_a_wide_bare_aperture_does_not_warn(exposure):
    record = shot(Sensor(), lens=hole(20.0), exposure=exposure).record
    assert record["working_f_number"] == pytest.approx(0.05)


def test_the_record_has_the_working_f_number():
    """v/A = f/A (1 + v/s) for a focus distance s."""
    camera = CAMERA.replace(pixel_pitch_um=500.0)
    film = camera.film_distance
    lens = ThinLens.from_f_number(2.8, focus_distance=0.1, film_distance=film)
    record = shot(Sensor(), camera=camera, lens=lens).record
    assert "f_number" not in record
    assert record["working_f_number"] == pytest.approx(2.8 * (1 + film / 0.1))
    assert working_f_number(camera, lens, 8.0) == record["working_f_number"]
    json.dumps(record)


@pytest.mark.parametrize("f_number", [1.4, 2.0, 2.8, 4.0])
def test_mechanical_vignetting_equals_rays_traced_through_stop_and_rim(f_number):
    """Parallel rays through random points of the stop, of which those count that pass the rim before it."""
    camera = Camera(101, 1, 60.0, 60.0, 50.0, 0.0, pixel_pitch_um=100.0)
    v, count = camera.film_distance, 100_000
    rng = np.random.default_rng(5)
    radius = v / f_number / 2 * np.sqrt(rng.random(count))
    angle = rng.uniform(0, 2 * np.pi, count)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    tangent = (np.arange(101) - 50) / 60
    passed = [np.mean(np.hypot(x + 0.5 * v * t, y) <= v / 1.4 / 2) for t in tangent]
    expected = np.cos(np.arctan(tangent)) ** 4 * passed
    light = vignetting(camera, lens_of(f_number, camera))[0]
    assert light == pytest.approx(expected, abs=5 * 0.5 / math.sqrt(count))


def test_vignetting_of_the_corners_falls_by_stopping_down():
    camera = Camera.from_fov(640, 480, fov_x_deg=50)
    natural = vignetting(camera, Pinhole())
    corner = [
        (vignetting(camera, lens_of(number, camera)) / natural)[0, 0]
        for number in (0.1, 1.4, 2, 2.8, 4, 8)
    ]
    assert corner[0] > 0.95  # wider than any barrel: only cos^4 is left
    assert 0.4 < corner[1] < 0.6
    assert corner[1:] == sorted(corner[1:])
    assert corner[-1] == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(
    ("lens", "on", "dark"),
    [
        (Pinhole(), None, False), (Pinhole(), True, True), (ThinLens(3e-5, 1.0), None, True),
        (ThinLens(0.0, 1.0), None, False), (ThinLens(1e-4, 1.0), False, False),
        (BareAperture(1e-4, CAMERA.film_distance), None, True),
    ],
)  # fmt: skip
def test_lenses_of_some_width_have_vignetting_by_default(lens, on, dark):
    """cos^4 of the angle of a pixel near the corner, (x, y, 1) with x = (2 - 47.5) / 100 and y = (2 - 31.5) / 100."""
    light = shot(QUIET.replace(vignetting=on), lens=lens).image[..., 1]
    expected = 1 / (1 + 0.455**2 + 0.295**2) ** 2 if dark else 1
    assert light[2, 2] / light[32, 48] == pytest.approx(expected, rel=1e-3)
