"""The light on the film against integrals over the hole, closed forms of heat transfer, and the bound of energy."""

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
    """E / (pi L): 1 where the film sees nothing but light."""
    return irradiance_factor(CAMERA, lens, 8.0) / math.pi


def hole(width: float, *shape) -> BareAperture:
    """A hole whose A/v is `width`."""
    return BareAperture(width * 0.05, 0.05, *shape)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_bare_hole_gathers_the_cosines_of_all_it_sees(width):
    """dE = L cos(theta) dOmega over the cone that the hole opens: integrated over angles, not over its area."""
    expected, _ = quad(lambda t: 2 * math.cos(t) * math.sin(t), 0, math.atan(width / 2), epsabs=0, epsrel=1e-12)
    assert share(hole(width)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("shape", [(), (MaskAperture([[1.0]]),), (Polygon(5),)], ids=["disk", "mask", "polygon"])
def test_no_hole_brings_the_film_more_light_than_there_is(shape):
    shares = [share(hole(width, *shape)) for width in [*WIDTHS, 1e4, 1e8]]
    assert shares[:6] == sorted(shares[:6])
    assert max(shares) <= 1


@pytest.mark.parametrize("width", WIDTHS)
def test_a_bare_ring_is_a_disk_less_a_disk(width):
    assert share(hole(width, Annulus(0.6))) == pytest.approx(share(hole(width)) - share(hole(0.6 * width)), rel=1e-3)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("shape", [Polygon(4), MaskAperture([[1.0]])], ids=lambda shape: shape.name)
def test_a_bare_square_is_the_rectangle_of_heat_transfer(width, shape):
    """Four corners of Howell's B-3: F = 1/(2 pi) (X/s atan(Y/s) + Y/t atan(X/t)), s^2 = 1 + X^2, t^2 = 1 + Y^2."""
    half = width / 2 / (math.sqrt(2) if shape.name == "polygon" else 1)
    s = math.hypot(1, half)
    assert share(hole(width, shape)) == pytest.approx(4 / math.pi * half / s * math.atan(half / s), rel=1e-3)


@pytest.mark.parametrize("width", [0.02, 0.05, 0.1, 0.15])
def test_a_small_hole_follows_the_square_of_its_width_and_the_lens(width):
    assert share(hole(width)) / share(hole(0.01)) == pytest.approx((width / 0.01) ** 2, rel=0.01)
    assert share(hole(width)) == pytest.approx(share(ThinLens(width * CAMERA.film_distance, 1.0)), rel=0.01)


def test_a_hole_of_no_width_is_exposed_as_the_pinhole():
    assert share(BareAperture(0.0, 0.05)) == share(Pinhole()) == pytest.approx(1 / 256)


@pytest.mark.parametrize(("number", "warns"), [(0.5, True), (0.99, True), (1.0, False), (4.0, False)])
def test_a_lens_below_f1_warns_of_the_paraxial_law(number, warns):
    """Where the exposure is given, once a picture or pair, in the name of the line that asked for it."""
    lens = ThinLens(CAMERA.film_distance / number, 1.0)
    assert share(lens) == pytest.approx(0.25 / number**2)
    white, given = np.ones((64, 96, 3)), Exposure(1e-6)
    rig = Rig.stereo(CAMERA, baseline=0.1)
    asks = (
        lambda: Sensor().expose(white, camera=CAMERA, lens=lens, exposure=given),
        lambda: Sensor().expose_rig([white, white], rig=rig, lens=lens, exposure=given),
    )
    for ask in asks:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            ask()
        assert [(w.category, w.filename) for w in caught] == [(ParaxialWarning, __file__)] * warns
        assert all("\n" not in str(w.message) for w in caught)


@pytest.mark.parametrize("fast", [0, 1, 2])
def test_the_fastest_camera_of_a_rig_is_warned_of_whichever_it_is(fast):
    """Three cameras behind one lens: the film of one is half as far from it, at f/0.7 where the others have f/1.4."""
    cameras = [CAMERA] * 3
    cameras[fast] = CAMERA.replace(pixel_pitch_um=CAMERA.pixel_pitch_um / 2)
    rig, white = Rig(cameras, [np.eye(4)] * 3), [np.ones((64, 96, 3))] * 3
    lens = ThinLens(CAMERA.film_distance / 1.4, 1.0)
    with pytest.warns(ParaxialWarning, match=r"working f-number v/A = 0\.7 ") as caught:
        Sensor().expose_rig(white, rig=rig, lens=lens, exposure=Exposure(1e-6))
    assert len(caught) == 1


def test_an_automatic_exposure_makes_up_for_the_law():
    """The picture through f/0.05 is the one through f/4: no warning (they are errors here), and the same grey."""
    wide, narrow = (
        Sensor(shot_noise=False).expose(
            np.ones((64, 96, 3)), camera=CAMERA, lens=ThinLens(CAMERA.film_distance / number, 1.0)
        )
        for number in (0.05, 4.0)
    )
    assert wide.image.mean() == pytest.approx(narrow.image.mean(), abs=0.5)


@pytest.mark.parametrize("exposure", [None, Exposure(1e-6)])
def test_an_open_box_is_no_lens_and_does_not_warn(exposure):
    photo = Sensor().expose(np.ones((64, 96, 3)), camera=CAMERA, lens=hole(20.0), exposure=exposure)
    assert photo.record["working_f_number"] == pytest.approx(0.05)


def test_the_records_f_number_says_which_it_is():
    """v/A is the record's, f/A the lens's: a close focus tells them apart, v/A = f/A (1 + v/s) at focal length f."""
    camera = CAMERA.replace(pixel_pitch_um=500.0)
    lens = ThinLens.from_f_number(2.8, focus_distance=0.1, film_distance=camera.film_distance)
    record = Sensor().expose(np.ones((64, 96, 3)), camera=camera, lens=lens).record
    assert "f_number" not in record
    assert record["working_f_number"] == pytest.approx(2.8 * (1 + camera.film_distance / 0.1))
    assert working_f_number(camera, lens, 8.0) == record["working_f_number"]
    json.dumps(record)
