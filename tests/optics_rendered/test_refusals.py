"""Invalid optics raise an InputError of one line."""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens import optics
from twinlens.camera import (
    Annulus,
    BrownConrady,
    KannalaBrandt,
    MaskAperture,
    Polygon,
    undistort_maps,
)
from twinlens.camera.film import diffract
from twinlens.errors import InputError
from twinlens.optics.diffraction import airy_kernel

CAMERA = tl.Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
LENS = tl.ThinLens(1e-4, 1.0)
DARK = np.zeros((48, 64, 3))
NAN, INF = math.nan, math.inf
INVALID = {  # case: (call, the name in the message)
    "aperture as wide as the sun": (
        lambda: tl.ThinLens(1.4e9, 2.0),
        "aperture_diameter",
    ),
    "aperture below an atom": (lambda: tl.ThinLens(1e-200, 2.0), "aperture_diameter"),
    "aperture beyond numbers": (lambda: tl.ThinLens(10**400, 2.0), "aperture_diameter"),
    "aperture in words": (lambda: tl.ThinLens("wide", 2.0), "aperture_diameter"),
    "aperture of no shape": (
        lambda: tl.ThinLens(0.01, 2.0, "disk"),
        "aperture must be Disk",
    ),
    "focus in an array": (
        lambda: tl.ThinLens(0.01, np.array([1.0, 2.0])),
        "focus_distance",
    ),
    "focus too near for numbers": (lambda: tl.ThinLens(0.01, 5e-324), "focus_distance"),
    "focus at -inf": (lambda: tl.ThinLens(0.01, -INF), "focus_distance"),
    "film without end": (lambda: tl.BareAperture(1e-3, INF), "film_distance"),
    "film too near for numbers": (
        lambda: tl.BareAperture(1e-3, 5e-324),
        "film_distance",
    ),
    "f-number without a film": (
        lambda: tl.ThinLens.from_f_number(2.8, 2.0, None),
        "film_distance",
    ),
    "f-number inf": (lambda: tl.ThinLens.from_f_number(INF, 2.0, 0.05), "f_number"),
    "negative aperture": (lambda: tl.ThinLens(-0.01, 2.0), "aperture_diameter"),
    "aperture nan": (lambda: tl.ThinLens(NAN, 2.0), "aperture_diameter"),
    "aperture without end": (lambda: tl.ThinLens(INF, 2.0), "aperture_diameter"),
    "focus at 0": (lambda: tl.ThinLens(0.01, 0.0), "focus_distance"),
    "focus behind the lens": (lambda: tl.ThinLens(0.01, -1.0), "focus_distance"),
    "focus nan": (lambda: tl.ThinLens(0.01, NAN), "focus_distance"),
    "changed to nan": (
        lambda: tl.ThinLens(0.01, 2.0).replace(aperture_diameter=NAN),
        "aperture_diameter",
    ),
    "negative hole": (lambda: tl.BareAperture(-1e-3, 0.05), "diameter"),
    "hole nan": (lambda: tl.BareAperture(NAN, 0.05), "diameter"),
    "hole on the film": (lambda: tl.BareAperture(1e-3, 0.0), "film_distance"),
    "film nan": (lambda: tl.BareAperture(1e-3, NAN), "film_distance"),
    "f-number 0": (lambda: tl.ThinLens.from_f_number(0.0, 2.0, 0.05), "f_number"),
    "f-number nan": (lambda: tl.ThinLens.from_f_number(NAN, 2.0, 0.05), "f_number"),
    "f-number with no focal length": (
        lambda: tl.ThinLens.from_f_number(2.8, 2.0, 0.0),
        "film_distance",
    ),
    "f-number, film nan": (
        lambda: tl.ThinLens.from_f_number(2.8, 2.0, NAN),
        "film_distance",
    ),
    "f-number, focus at 0": (
        lambda: tl.ThinLens.from_f_number(2.8, 0.0, 0.05),
        "focus_distance",
    ),
    "empty mask": (lambda: MaskAperture(np.zeros((0, 4))), "mask"),
    "black mask": (lambda: MaskAperture(np.zeros((4, 4))), "mask is black"),
    "mask nan": (lambda: MaskAperture([[0.5, NAN]]), "mask"),
    "ragged mask": (lambda: MaskAperture([[1.0], [1.0, 0.0]]), "unequal length"),
    "text mask": (lambda: MaskAperture([["open"]]), "mask must hold numbers"),
    "negative mask": (lambda: MaskAperture([[-0.5]]), "mask"),
    "infinite mask": (lambda: MaskAperture([[INF]]), "mask"),
    "colour mask": (lambda: MaskAperture(np.ones((4, 4, 3))), "mask"),
    "mask above 1": (lambda: MaskAperture([[2.0]]), "mask"),
    "two blades": (lambda: Polygon(2), "blades"),
    "half a blade": (lambda: Polygon(5.5), "blades"),
    "huge blades": (lambda: Polygon(10**400), "blades"),
    "rotation nan": (lambda: Polygon(5, rotation_deg=NAN), "rotation_deg"),
    "text roundness": (lambda: Polygon(5, roundness="round"), "roundness"),
    "inner nan": (lambda: Annulus(NAN), "inner"),
    "text inner": (lambda: Annulus("half"), "inner"),
    "roundness 2": (lambda: Polygon(6, roundness=2.0), "roundness"),
    "ring of zero width": (lambda: Annulus(1.0), "inner"),
    "folding barrel": (
        lambda: CAMERA.replace(distortion=BrownConrady(k1=-2.0)),
        "fold",
    ),
    "folding fisheye": (
        lambda: CAMERA.replace(distortion=KannalaBrandt(k1=-2.0)),
        "fold",
    ),
    "distortion nan": (lambda: CAMERA.replace(distortion=BrownConrady(k1=NAN)), "k1"),
    "distortion inf": (lambda: BrownConrady(p1=INF), "p1"),
    "text distortion": (lambda: KannalaBrandt(k2="x"), "k2"),
    "huge distortion": (lambda: BrownConrady(k3=1e300), "k3"),
    "tangential fold": (
        lambda: CAMERA.replace(distortion=BrownConrady(p2=-2.0)),
        "fold",
    ),
    "pole in the image": (
        lambda: CAMERA.replace(distortion=BrownConrady(k4=-4.0)),
        "fold",
    ),
    "distortion without a model": (
        lambda: CAMERA.replace(distortion=(0.1, 0.2)),
        "distortion must be",
    ),
    "fy negative": (lambda: CAMERA.replace(fy=-60.0), "fy"),
    "fx 0": (lambda: CAMERA.replace(fx=0.0), "fx"),
    "cx nan": (lambda: CAMERA.replace(cx=NAN), "cx"),
    "no pixels": (lambda: CAMERA.replace(width=0), "width"),
    "pitch 0": (lambda: CAMERA.replace(pixel_pitch_um=0.0), "pixel_pitch_um"),
    "half a pixel": (lambda: tl.Camera.from_fov(0.5, 48, 40.0), "width"),
    "fov 0": (lambda: tl.Camera.from_fov(64, 48, 0.0), "fov_x_deg"),
    "fov nan": (lambda: tl.Camera.from_fov(64, 48, NAN), "fov_x_deg"),
    "fov 180": (lambda: tl.Camera.from_fov(64, 48, 180.0), "fov_x_deg"),
    "no baseline": (lambda: tl.Rig.stereo(CAMERA, 0.0), "baseline"),
    "depth nan": (lambda: optics.circle_of_confusion_px(NAN, 0.01, 60, 0.5), "depth"),
    "circle 0": (
        lambda: optics.in_focus(1.0, 0.01, 60, 0.5, circle_px=0.0),
        "circle_px",
    ),
    "negative wavelength": (
        lambda: diffract(DARK, CAMERA, LENS, wavelengths=(-5e-7, 5e-7, 4e-7)),
        "wavelengths",
    ),
    "wavelengths in nanometres": (
        lambda: diffract(DARK, CAMERA, LENS, wavelengths=(611, 549, 464)),
        "550e-9",
    ),
    "two wavelengths": (
        lambda: diffract(DARK, CAMERA, LENS, wavelengths=(5e-7, 5e-7)),
        "three",
    ),
    "sensor's wavelength 0": (
        lambda: tl.Sensor(wavelengths=(0.0, 5e-7, 4e-7)),
        "wavelengths",
    ),
    "sensor's wavelength in nanometres": (
        lambda: tl.Sensor(wavelengths=(611, 549, 464)),
        "wavelengths",
    ),
    "text white balance": (
        lambda: tl.Sensor(white_balance="no"),
        "white_balance must be True or False",
    ),
    "numeric shot noise": (
        lambda: tl.Sensor(shot_noise=0.5),
        "shot_noise must be True or False",
    ),
    "numeric vignetting": (
        lambda: tl.Sensor(vignetting=1),
        "vignetting must be True or False",
    ),
    "diffraction without a lens": (
        lambda: diffract(DARK, CAMERA, "lens"),
        "a lens must be",
    ),
    "diffraction without a camera": (
        lambda: diffract(DARK, None, LENS),
        "camera must be a Camera",
    ),
    "exposure without a lens": (
        lambda: tl.Sensor().expose(DARK, camera=CAMERA, lens=None),
        "a lens must be",
    ),
    "exposure without a camera": (
        lambda: tl.Sensor().expose(DARK, camera=None, lens=LENS),
        "camera must be a Camera",
    ),
    "numeric exposure": (
        lambda: tl.Sensor().expose(DARK, camera=CAMERA, lens=LENS, exposure=0.1),
        "exposure must be an Exposure",
    ),
    "exposure without a camera, given time": (
        lambda: tl.Sensor().expose(
            DARK, camera=None, lens=LENS, exposure=tl.Exposure(0.1)
        ),
        "camera must be a Camera",
    ),
    "numeric exposure of a rig": (
        lambda: tl.Sensor().expose_rig(
            [DARK], rig=tl.Rig([CAMERA], [np.eye(4)]), lens=LENS, exposure=0.1
        ),
        "exposure must be an Exposure",
    ),
    "kernel without a pitch": (lambda: airy_kernel(1e-6, 5e-7, 8.0, 3), "pixel_pitch"),
    "huge kernel": (lambda: airy_kernel((1e-6, 1e-6), 5e-7, 8.0, 10**9), "radius_px"),
    "map without a camera": (lambda: undistort_maps(None, CAMERA), "two cameras"),
    "text rotation": (lambda: undistort_maps(CAMERA, CAMERA, "left"), "to_from_camera"),
    "diffraction of a point": (
        lambda: diffract(np.zeros((48, 64, 3)), CAMERA, tl.Pinhole()),
        "pinhole",
    ),
    "diffraction of a polygon": (
        lambda: diffract(
            np.zeros((48, 64, 3)), CAMERA, tl.ThinLens(0.01, 1.0, Polygon(5))
        ),
        "disk",
    ),
}


@pytest.mark.parametrize("name", INVALID)
def test_invalid_optics_raise_in_one_line(name):
    make, message = INVALID[name]
    with pytest.raises(InputError, match=message) as error:
        make()
    line = str(error.value)
    assert "\n" not in line
    assert 15 < len(line) < 250


def test_extreme_valid_optics_are_accepted():
    assert tl.ThinLens(0.0, INF).vergence == 0.0
    assert tl.BareAperture(0.0, 0.05).vergence == -20.0
    assert MaskAperture([[0.0, 1.0]]).area_fraction > 0
    assert CAMERA.replace(distortion=BrownConrady(k1=-0.2)).distortion is not None
