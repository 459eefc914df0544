"""Stretched round shapes, which Mitsuba would silently render round, are errors."""

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.scenes.scene import SceneObject

UPRIGHT = {"type": "cylinder"}
LYING = {"type": "cylinder", "p0": [0.0, 0.0, 0.0], "p1": [1.0, 0.0, 0.0]}
SLANTED = {"type": "cylinder", "p0": [0.2, 0.0, 0.0], "p1": [1.2, 1.0, 0.0]}
TURNED = {
    "type": "cylinder",
    "to_world": np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]]),
}
BALL = {"type": "sphere"}


def thing(shape, scales, instances=()):
    return SceneObject("it", shape, "any", np.diag([*scales, 1.0]), instances=instances)


@pytest.mark.parametrize(
    ("shape", "scales"),
    [
        (UPRIGHT, (1, 1, 3)),
        (LYING, (3, 1, 1)),
        (SLANTED, (2, 2, 2)),
        (TURNED, (3, 1, 1)),
        (BALL, (2, 2, 2)),
    ],
)
def test_allowed_scales_of_spheres_and_cylinders(shape, scales):
    thing(shape, scales)


@pytest.mark.parametrize(
    ("shape", "scales"),
    [(UPRIGHT, (3, 1, 1)), (LYING, (1, 1, 3)), (SLANTED, (1, 1, 3)), (SLANTED, (3, 1, 1)), (TURNED, (1, 1, 3)),
     (BALL, (1, 1, 2))],
)  # fmt: skip
def test_stretched_spheres_and_cylinders_are_errors(shape, scales):
    with pytest.raises(InputError, match="needs a uniform scale") as refusal:
        thing(shape, scales)
    assert "\n" not in str(refusal.value)
    with pytest.raises(InputError, match="needs a uniform scale"):
        thing(shape, (1, 1, 1), (np.diag([*scales, 1.0]),))


def test_a_cylinder_of_length_zero_is_an_error():
    with pytest.raises(InputError, match="p0 and p1 finite and different"):
        thing({**LYING, "p1": LYING["p0"]}, (1, 1, 1))
