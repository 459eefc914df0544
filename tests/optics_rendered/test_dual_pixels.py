"""The disparity of dual pixels on a slanted plane, measured from rendered halves, follows the blur law."""

import math

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import scene_of
from twinlens.scenes import Bitmap, SceneObject
from twinlens.studies.stage import noise_texture

CAMERA = tl.Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
LENS = tl.ThinLens(0.3, 1.0)


def slanted_plane() -> tl.Scene:
    """A glowing plane of noise at 1 m, whose near corner is at 0.8 m and whose far one at 1.4 m, about."""
    right = np.array([0.9, 0.0, 0.3])
    down = np.array([0.0, 0.9, 0.3])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, -down, np.cross(right, -down)], axis=1)
    pose[:3, 3] = 0, 0, 1
    texture = np.float32(noise_texture(720, 720, 2.5, 0.5, 3))
    light = {"type": "area", "radiance": Bitmap(texture)}
    shape = {"type": "rectangle"}
    return scene_of(SceneObject("plane", shape, "black", pose, light))


def test_disparity_is_that_of_two_pinholes_at_the_centroids():
    """As the disparity of a stereo pair whose baseline is 4/(3 pi) of the diameter, less that of the focus."""
    rig = tl.Rig.stereo(CAMERA, 4 / (3 * math.pi) * LENS.aperture_diameter)
    truth = tl.ground_truth(slanted_plane(), rig)[0]
    at_focus = CAMERA.fx * rig.baseline() / LENS.focus_distance
    disparity = tl.dual_pixel_disparity(truth, CAMERA, LENS)
    assert disparity.dtype == np.float32
    np.testing.assert_allclose(disparity, truth.disparity - at_focus, atol=2e-3)


def test_disparity_of_given_depths_along_both_axes():
    """0 in focus, unknown where nothing was hit; along y it has the focal length along y."""
    camera = CAMERA.replace(fy=300.0)
    depth = np.array([[np.inf, 1.0, 0.5]])
    across, down = (
        tl.dual_pixel_disparity(depth, camera, LENS, axis)[0] for axis in "xy"
    )
    assert across[0] == np.inf
    assert across[1] == 0
    assert across[2] == pytest.approx(4 / (3 * math.pi) * 0.3 * 150, rel=1e-3)
    assert down[2] == pytest.approx(2 * across[2], rel=1e-3)
