"""Invalid sensors, mismatches, exposures and images raise an InputError of one line that names the value."""

import numpy as np
import pytest

from tests.sensor.flat_fields import CAMERA, LENS, RIG, WHITE
from twinlens.camera import Pinhole
from twinlens.errors import InputError
from twinlens.sensor import Exposure, Mismatch, Sensor, auto_exposure

TOO_LONG = {"mismatch": Mismatch(time=2.0), "longest_exposure": 1e9}


def exposed(image=WHITE, camera=CAMERA, lens=LENS, **options):
    return Sensor().expose(image, camera=camera, lens=lens, **options)


def dual(halves, lens=LENS):
    return Sensor().expose_dual(halves, camera=CAMERA, lens=lens)


def exposed_rig(count, **options):
    return Sensor().expose_rig([WHITE] * count, rig=RIG, lens=LENS, **options)


REFUSALS = [  # what the message says, and the call; ranges of settings are in tests/test_settings.py
    ("did you mean 'phone'", lambda: Sensor.preset("phne")),
    ("mismatch makes the exposure invalid", lambda: Sensor(**TOO_LONG)),
    ("mismatch must be a Mismatch or a tuple", lambda: Sensor(mismatch={"gain": 1.1})),
    ("mismatch must be a Mismatch or a tuple", lambda: Sensor(mismatch=(3,))),
    ("black_level must be below 4095 DN", lambda: Sensor(black_level=4095.0)),
    ("did you mean 'consumer'", lambda: Mismatch.draw("consummer", 1)),
    ("number >= 0, got -1", lambda: Mismatch.draw("typical", -1)),
    ("number >= 0, got None", lambda: Mismatch.draw("typical", None)),
    ("'gian'; did you mean 'gain'", lambda: Mismatch.draw("typical", 1, gian=1.0)),
    ("working_f_number", lambda: Exposure(1.0).value(0.0)),
    ("shape", lambda: exposed(np.zeros((64, 96)))),
    ("shape", lambda: exposed(np.zeros((96, 64, 3)))),
    ("NaN", lambda: exposed(np.nan * WHITE)),
    ("numbers", lambda: exposed(np.full((64, 96, 3), "a"))),
    ("real numbers", lambda: exposed(WHITE.astype(complex))),
    ("unequal", lambda: exposed([[1.0], [1.0, 2.0]])),
    ("negative", lambda: exposed(-WHITE)),
    ("seed", lambda: exposed(seed=-1)),
    ("seed", lambda: exposed(seed=1.5)),
    ("eye", lambda: exposed(eye=-1)),
    ("a lens must be", lambda: exposed(lens=None)),
    ("camera must be a Camera", lambda: exposed(camera=None)),
    ("camera must be a Camera", lambda: exposed(camera=None, exposure=Exposure(0.1))),
    ("exposure must be an Exposure", lambda: exposed(exposure=0.1)),
    ("exposure must be an Exposure", lambda: exposed_rig(2, exposure=0.1)),
    ("one image per camera", lambda: exposed_rig(1)),
    (
        "one camera each",
        lambda: auto_exposure([], sensor=Sensor(), cameras=CAMERA, lens=LENS),
    ),
    ("two halves, got 1", lambda: dual([WHITE])),
    ("two halves, got None", lambda: dual(None)),
    ("a pinhole has none", lambda: dual([WHITE] * 2, Pinhole())),
    ("radiance", lambda: dual([WHITE[:4]] * 2)),
]


def test_invalid_calls_raise_in_one_line():
    for message, call in REFUSALS:
        with pytest.raises(InputError, match=message) as error:
            call()
        assert "\n" not in str(error.value)
