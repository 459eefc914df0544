"""Every optic that cannot be is refused in one line that says what is wrong and what would be right."""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens import optics
from twinlens.camera import Annulus, BrownConrady, KannalaBrandt, MaskAperture, Polygon
from twinlens.diffraction import diffract
from twinlens.errors import InputError

CAMERA = tl.Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
NAN, INF = math.nan, math.inf
REFUSED = {  # what is asked for: (how, what the line must name)
    "negative aperture": (lambda: tl.ThinLens(-0.01, 2.0), "aperture_diameter"),
    "aperture nan": (lambda: tl.ThinLens(NAN, 2.0), "aperture_diameter"),
    "aperture without end": (lambda: tl.ThinLens(INF, 2.0), "aperture_diameter"),
    "focus at 0": (lambda: tl.ThinLens(0.01, 0.0), "focus_distance"),
    "focus behind the lens": (lambda: tl.ThinLens(0.01, -1.0), "focus_distance"),
    "focus nan": (lambda: tl.ThinLens(0.01, NAN), "focus_distance"),
    "changed to nan": (lambda: tl.ThinLens(0.01, 2.0).replace(aperture_diameter=NAN), "aperture_diameter"),
    "negative hole": (lambda: tl.BareAperture(-1e-3, 0.05), "diameter"),
    "hole nan": (lambda: tl.BareAperture(NAN, 0.05), "diameter"),
    "hole on the film": (lambda: tl.BareAperture(1e-3, 0.0), "film_distance"),
    "film nan": (lambda: tl.BareAperture(1e-3, NAN), "film_distance"),
    "f-number 0": (lambda: tl.ThinLens.from_f_number(0.0, 2.0, 0.05), "f_number"),
    "f-number nan": (lambda: tl.ThinLens.from_f_number(NAN, 2.0, 0.05), "f_number"),
    "f-number with no focal length": (lambda: tl.ThinLens.from_f_number(2.8, 2.0, 0.0), "film_distance"),
    "f-number, film nan": (lambda: tl.ThinLens.from_f_number(2.8, 2.0, NAN), "film_distance"),
    "f-number, focus at 0": (lambda: tl.ThinLens.from_f_number(2.8, 0.0, 0.05), "focus_distance"),
    "empty mask": (lambda: MaskAperture(np.zeros((0, 4))), "mask"),
    "black mask": (lambda: MaskAperture(np.zeros((4, 4))), "mask is black"),
    "mask nan": (lambda: MaskAperture([[0.5, NAN]]), "mask"),
    "colour mask": (lambda: MaskAperture(np.ones((4, 4, 3))), "mask"),
    "mask above 1": (lambda: MaskAperture([[2.0]]), "mask"),
    "two blades": (lambda: Polygon(2), "blades"),
    "roundness 2": (lambda: Polygon(6, roundness=2.0), "roundness"),
    "ring of no width": (lambda: Annulus(1.0), "inner"),
    "barrel that folds": (lambda: CAMERA.replace(distortion=BrownConrady(k1=-2.0)), "fold"),
    "fisheye that folds": (lambda: CAMERA.replace(distortion=KannalaBrandt(k1=-2.0)), "fold"),
    "distortion nan": (lambda: CAMERA.replace(distortion=BrownConrady(k1=NAN)), "k1"),
    "fx 0": (lambda: CAMERA.replace(fx=0.0), "fx"),
    "cx nan": (lambda: CAMERA.replace(cx=NAN), "cx"),
    "no pixels": (lambda: CAMERA.replace(width=0), "width"),
    "pitch 0": (lambda: CAMERA.replace(pixel_pitch_um=0.0), "pixel_pitch_um"),
    "fov 180": (lambda: tl.Camera.from_fov(64, 48, 180.0), "fov_x_deg"),
    "no baseline": (lambda: tl.Rig.stereo(CAMERA, 0.0), "baseline"),
    "depth nan": (lambda: optics.circle_of_confusion_px(NAN, 0.01, 60, 0.5), "depth"),
    "circle 0": (lambda: optics.in_focus(1.0, 0.01, 60, 0.5, circle_px=0.0), "circle_px"),
    "diffraction of a point": (lambda: diffract(np.zeros((48, 64, 3)), CAMERA, tl.Pinhole()), "pinhole"),
    "diffraction of a polygon": (
        lambda: diffract(np.zeros((48, 64, 3)), CAMERA, tl.ThinLens(0.01, 1.0, Polygon(5))),
        "disk",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_impossible_optics_are_refused_in_one_line(name):
    ask, named = REFUSED[name]
    with pytest.raises(InputError, match=named) as refusal:
        ask()
    line = str(refusal.value)
    assert "\n" not in line
    assert 15 < len(line) < 250


def test_what_lies_at_the_edge_of_the_possible_is_taken():
    """The refusals are not for everybody."""
    assert tl.ThinLens(0.0, INF).vergence == 0.0
    assert tl.BareAperture(0.0, 0.05).vergence == -20.0
    assert MaskAperture([[0.0, 1.0]]).area_fraction > 0
    assert CAMERA.replace(distortion=BrownConrady(k1=-0.2)).distortion is not None
