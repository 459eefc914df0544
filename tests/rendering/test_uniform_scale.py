"""Stretched round shapes, which Mitsuba would silently render round, are errors; also where a plugin turns them."""

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.scenes.scene import SceneObject

SLANTED = {"type": "cylinder", "p0": [0.2, 0.0, 0.0], "p1": [1.2, 1.0, 0.0]}
TURN = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
TURNED = {"type": "cylinder", "to_world": TURN}
SCALES = [  # along which axes the shape may be longer
    (SLANTED, (2, 2, 2), True),
    (SLANTED, (1, 1, 3), False),
    (SLANTED, (3, 1, 1), False),
    (TURNED, (3, 1, 1), True),
    (TURNED, (1, 1, 3), False),
]


def scaled(shape, scales, *copies):
    return SceneObject("it", shape, "any", np.diag([*scales, 1.0]), instances=copies)


@pytest.mark.parametrize(("shape", "scales", "is_allowed"), SCALES)
def test_cylinders_may_be_stretched_along_their_axis_alone(shape, scales, is_allowed):
    if is_allowed:
        scaled(shape, scales)
        return
    with pytest.raises(InputError, match="needs a uniform scale"):
        scaled(shape, scales)
    with pytest.raises(InputError, match="needs a uniform scale"):
        scaled(shape, (1, 1, 1), np.diag([*scales, 1.0]))


def test_a_cylinder_of_length_zero_is_an_error():
    with pytest.raises(InputError, match="p0 and p1 finite and different"):
        scaled({**SLANTED, "p1": SLANTED["p0"]}, (1, 1, 1))
