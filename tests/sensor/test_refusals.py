"""Invalid sensors, mismatches, exposures and images raise an InputError of one line that names the value."""

import math

import numpy as np
import pytest

from twinlens.camera import Camera, Pinhole, Rig, ThinLens
from twinlens.errors import InputError
from twinlens.sensor import Exposure, Mismatch, Sensor, auto_exposure

CAMERA = Camera(96, 64, 100.0, 100.0, 47.5, 31.5)
LENS = ThinLens(CAMERA.film_distance / 4, focus_distance=2.0)
RIG = Rig.stereo(CAMERA, baseline=0.1)
WHITE = np.ones((64, 96, 3))
NAN, INF = math.nan, math.inf
TOO_LONG = {"mismatch": Mismatch(time=2.0), "longest_exposure": 1e9}


def exposed(image=WHITE, camera=CAMERA, lens=LENS, **options):
    return Sensor().expose(image, camera=camera, lens=lens, **options)


REFUSALS = [  # what the message says, and the call
    ("did you mean 'gamma'", lambda: Sensor().replace(gama=2.0)),
    ("did you mean 'srgb'", lambda: Sensor(output="srbg")),
    ("did you mean", lambda: Sensor(filters="RGBG")),
    ("did you mean 'phone'", lambda: Sensor.preset("phne")),
    ("mismatch makes the exposure invalid", lambda: Sensor(**TOO_LONG)),
    ("mismatch must be a Mismatch or a tuple", lambda: Sensor(mismatch={"gain": 1.1})),
    ("mismatch must be a Mismatch or a tuple", lambda: Sensor(mismatch=(3,))),
    ("black_level must be below 4095 DN", lambda: Sensor(black_level=4095.0)),
    ("wavelengths", lambda: Sensor(wavelengths=(611, 549, 464))),
    ("did you mean 'consumer'", lambda: Mismatch.draw("consummer", 1)),
    ("number >= 0, got -1", lambda: Mismatch.draw("typical", -1)),
    ("number >= 0, got None", lambda: Mismatch.draw("typical", None)),
    ("'gian'; did you mean 'gain'", lambda: Mismatch.draw("typical", 1, gian=1.0)),
    ("exposure time", lambda: Exposure(0.0)),
    ("exposure time", lambda: Exposure("1")),
    ("exposure gain", lambda: Exposure(1.0, INF)),
    ("exposure gain", lambda: Exposure(1.0, True)),
    ("working_f_number", lambda: Exposure(1.0).value(0.0)),
    ("shape", lambda: exposed(np.zeros((64, 96)))),
    ("shape", lambda: exposed(np.zeros((96, 64, 3)))),
    ("NaN", lambda: exposed(NAN * WHITE)),
    ("numbers", lambda: exposed(np.full((64, 96, 3), "a"))),
    ("real numbers", lambda: exposed(WHITE.astype(complex))),
    ("unequal", lambda: exposed([[1.0], [1.0, 2.0]])),
    ("negative", lambda: exposed(-WHITE)),
    ("seed", lambda: exposed(seed=-1)),
    ("seed", lambda: exposed(seed=1.5)),
    ("eye", lambda: exposed(eye=-1)),
    ("a lens must be", lambda: exposed(lens=None)),
    ("camera must be a Camera", lambda: exposed(camera=None)),
    (
        "camera must be a Camera",
        lambda: exposed(camera=None, exposure=Exposure(0.1)),
    ),
    ("exposure must be an Exposure", lambda: exposed(exposure=0.1)),
    (
        "exposure must be an Exposure",
        lambda: Sensor().expose_rig([WHITE] * 2, rig=RIG, lens=LENS, exposure=0.1),
    ),
    (
        "one image per camera",
        lambda: Sensor().expose_rig([WHITE], rig=RIG, lens=Pinhole()),
    ),
    (
        "one camera each",
        lambda: auto_exposure([], sensor=Sensor(), cameras=CAMERA, lens=LENS),
    ),
]


def test_invalid_calls_raise_in_one_line():
    for message, call in REFUSALS:
        with pytest.raises(InputError, match=message) as error:
            call()
        assert "\n" not in str(error.value)
