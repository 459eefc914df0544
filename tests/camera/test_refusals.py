"""Invalid cameras, lenses, apertures and rigs raise an InputError of one line that names the value."""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens.camera import (
    ALIGNED,
    MaskAperture,
    Misalignment,
    Polygon,
    layouts,
    misaligned,
    undistort_maps,
)
from twinlens.camera.film import diffract
from twinlens.errors import InputError
from twinlens.optics.diffraction import airy_kernel

CAMERA = tl.Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
LENS = tl.ThinLens(1e-4, 1.0)
HERE = np.eye(4)
DARK = np.zeros((48, 64, 3))
NAN, INF = math.nan, math.inf


def check_one_line(error: InputError) -> None:
    assert "\n" not in str(error)
    assert 15 < len(str(error)) < 250


def test_numbers_beyond_floats_and_arrays_are_refused():
    for value in (10**400, np.array([1.0, 2.0])):
        with pytest.raises(InputError, match="fx"):
            CAMERA.replace(fx=value)
        with pytest.raises(InputError, match="blades"):
            Polygon(value)


def test_f_numbers_film_and_focus_have_limits():
    valid = {"f_number": 2.8, "focus_distance": 2.0, "film_distance": 0.05}
    for name in valid:
        for value in (0.0, -2.0, NAN, "2", None):
            with pytest.raises(InputError, match=name) as error:
                tl.ThinLens.from_f_number(**valid | {name: value})
            check_one_line(error.value)


def layout_at(pose):
    return layouts.line(CAMERA, 3, 0.1, pose)


REFUSALS = [  # what the message says, and the call
    ("mask must be a grey-scale", lambda: MaskAperture(np.zeros((0, 4)))),
    ("mask must be a grey-scale", lambda: MaskAperture(np.ones((4, 4, 3)))),
    ("mask is black", lambda: MaskAperture(np.zeros((4, 4)))),
    ("mask must hold transmissions from 0 to 1", lambda: MaskAperture([[0.5, NAN]])),
    ("mask must hold transmissions from 0 to 1", lambda: MaskAperture([[-0.5]])),
    ("mask must hold transmissions from 0 to 1", lambda: MaskAperture([[2.0]])),
    ("unequal length", lambda: MaskAperture([[1.0], [1.0, 0.0]])),
    ("mask must hold numbers", lambda: MaskAperture([["open"]])),
    ("distortion must be", lambda: CAMERA.replace(distortion=(0.1, 0.2))),
    ("aperture must be", lambda: tl.ThinLens(0.01, 2.0, "disk")),
    ("aperture_diameter", lambda: tl.ThinLens(1e-200, 2.0)),
    ("width", lambda: tl.Camera.from_fov(0.5, 48, 40.0)),
    ("one pose per camera", lambda: tl.Rig([], [])),
    ("1 camera and 0 poses", lambda: tl.Rig([CAMERA], [])),
    (r"world_from_cams\[1\]", lambda: tl.Rig([CAMERA] * 2, [HERE, 2 * HERE])),
    (r"world_from_cams\[0\]", lambda: tl.Rig([CAMERA], [np.eye(3)])),
    (
        "world_from_left",
        lambda: tl.Rig.stereo(CAMERA, 0.1, np.diag([1, 1, -1, 1])),
    ),
    ("a rig of 1 camera", lambda: misaligned(tl.Rig([CAMERA], [HERE]), [ALIGNED] * 2)),
    ("columns", lambda: layouts.line(CAMERA, 0, 0.1)),
    ("rows", lambda: layouts.grid(CAMERA, 1.5, 2, 0.1, 0.1)),
    ("spacing_x", lambda: layouts.line(CAMERA, 2, 0.0)),
    ("angle_deg", lambda: layouts.arc(CAMERA, 3, 1.0, 361)),
    ("radius", lambda: layouts.arc(CAMERA, 3, -1.0, 30)),
    ("count", lambda: layouts.arc(CAMERA, 0, 1.0, 30)),
    ("distance", lambda: layouts.toed_in(CAMERA, 0.1, 0.0)),
    ("3 places", lambda: layouts.line([CAMERA] * 2, 3, 0.1)),
    ("pose of a layout", lambda: layout_at(np.diag([1, 1, -1, 1]))),
    ("two cameras", lambda: undistort_maps(None, CAMERA)),
    ("to_from_camera", lambda: undistort_maps(CAMERA, CAMERA, "left")),
    ("550e-9", lambda: diffract(DARK, CAMERA, LENS, (611, 549, 464))),
    ("a lens must be", lambda: diffract(DARK, CAMERA, "lens")),
    ("camera must be a Camera", lambda: diffract(DARK, None, LENS)),
    ("pixel_pitch", lambda: airy_kernel(1e-6, 5e-7, 8.0, 3)),
]


def test_invalid_calls_raise_in_one_line():
    for message, call in REFUSALS:
        with pytest.raises(InputError, match=message) as error:
            call()
        check_one_line(error.value)


def test_lengths_have_limits():
    allowed = "a positive number of metres, from 1e-12 to 1e"
    for length in (0, -0.1, 1e-30, 1e300, NAN, INF):
        with pytest.raises(InputError, match=allowed):
            tl.Rig.stereo(CAMERA, length)
        with pytest.raises(InputError, match=allowed):
            layouts.line(CAMERA, 2, length)


def test_fields_of_view_have_limits():
    for degrees in (0, 180, -5, NAN):
        with pytest.raises(InputError, match="fov_x_deg"):
            tl.Camera.from_fov(640, 480, degrees)


def test_extreme_valid_optics_are_accepted():
    assert tl.ThinLens(0.0, INF).vergence == 0.0
    assert tl.BareAperture(0.0, 0.05).vergence == -20.0
    assert MaskAperture([[0.0, 1.0]]).area_fraction > 0
    assert Misalignment(roll_deg=-89.9).roll_deg == -89.9
