"""The occluded share against geometry."""

from types import SimpleNamespace

import numpy as np
import pytest

from twinlens.camera import Camera, Rig
from twinlens.scenes import Bitmap
from twinlens.studies.depth_error import occluded_percent
from twinlens.studies.stage import Stage, glowing, noise_texture

CAMERA = Camera(96, 72, 90.0, 90.0, 47.5, 35.5)


def square(name, centre, side):
    pose = np.diag([0.5 * side, -0.5 * side, -1.0, 1.0])
    pose[:3, 3] = centre
    return (
        name,
        {"type": "rectangle"},
        pose,
        Bitmap(noise_texture(32, 32, 1.0, 0.2, 0).astype(np.float32)),
    )


@pytest.mark.parametrize("base", [0.05, 0.1, 0.2])
def test_a_card_occludes_a_strip_as_wide_as_the_difference_of_disparities(base):
    """A card of h rows occludes f B (1/near - 1/far) columns of the wall."""
    near, far, side = 1.0, 2.0, 0.4
    scene = glowing(
        "card",
        [square("wall", (0, 0, far), 20.0), square("card", (0.1, 0, near), side)],
        near,
    )
    stage = Stage(scene, Rig.stereo(CAMERA, base, np.eye(4)))
    step = CAMERA.fx * base * (1 / near - 1 / far)
    outside = CAMERA.height * CAMERA.fx * base / far
    expected = (
        100
        * step
        * (CAMERA.fx * side / near)
        / (CAMERA.width * CAMERA.height - outside)
    )
    # Each border of the strip, of 36 rows, may move by half a pixel.
    assert occluded_percent(stage) == pytest.approx(expected, abs=100 * 36 / (96 * 72))


def test_pixels_outside_the_right_image_are_not_counted():
    disparity = np.float32([[3.0, 1.0, 1.0, 1.0, np.inf]])
    visible = np.array([[False, True, True, False, False]])
    truth = SimpleNamespace(disparity=disparity, visible=visible)
    stage = SimpleNamespace(truth=truth, camera=SimpleNamespace(width=5))
    assert occluded_percent(stage) == pytest.approx(100 / 3)
