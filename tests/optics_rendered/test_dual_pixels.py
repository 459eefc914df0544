"""The disparity of dual pixels on a slanted plane, measured from rendered halves, follows the blur law."""

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, grey, scene_of
from twinlens.errors import InputError
from twinlens.scenes import Bitmap, SceneObject
from twinlens.studies.stage import noise_texture

CAMERA = tl.Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
LENS = tl.ThinLens(0.3, 1.0)
SIDE = 48  # of the windows, pixels


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


def measured_disparity(
    halves: np.ndarray, row: int, column: int, across: float, slant: np.ndarray
) -> float:
    """The shift along x between the halves around a pixel: the slope of the phase of the cross spectrum of two windows.

    The windows follow the shift, by half of it each, and `slant`, its change per row and column. Only low frequencies
    along x, below those at which a blur of the diameter `across` removes the texture, and the lowest ones along y are
    used: there the phase is that of the centroids, whatever the shape of the blur.
    """
    v, u = np.mgrid[:SIDE, :SIDE] - 0.5 * (SIDE - 1)
    taper = np.outer(np.hanning(SIDE + 2)[1:-1], np.hanning(SIDE + 2)[1:-1])
    omega, omega_down = np.meshgrid(*2 * [2 * np.pi * np.fft.fftfreq(SIDE)])
    used = (
        (omega > 0)
        & (0.5 * across * omega < 1.8)
        & (omega < 1.2)
        & (np.abs(omega_down) < 1.5 * 2 * np.pi / SIDE)
    )
    shift = 0.0
    for _ in range(8):
        places = [
            (row + v, column + u + side * (shift + slant[0] * v + slant[1] * u) / 2)
            for side in (1, -1)
        ]
        windows = [
            map_coordinates(half, place, order=3)
            for half, place in zip(halves, places, strict=True)
        ]
        first, second = (
            np.fft.fft2(taper * (window / np.average(window, weights=taper) - 1))
            for window in windows
        )
        cross = (first * second.conj())[used]
        shift -= float(
            (np.abs(cross) * omega[used] * np.angle(cross)).sum()
            / (np.abs(cross) * omega[used] ** 2).sum()
        )
    return shift


@pytest.mark.parametrize("axis", ["x", pytest.param("y", marks=pytest.mark.slow)])
def test_disparity_on_a_slanted_plane_follows_the_law(axis):
    """Within 2 % in every window whose blur circle is above 2 px, on both sides of the focus."""
    scene = slanted_plane()
    rig = tl.Rig([CAMERA], [HERE])
    law = tl.dual_pixel_disparity(tl.ground_truth(scene, rig)[0], CAMERA, LENS, axis)
    images = tl.render(scene, rig, LENS, spp=256, seed=1, parts=tl.Dual(axis))[0]
    halves = np.stack([grey(image) for image in images])
    if axis == "y":
        law, halves = law.T, halves.transpose(0, 2, 1)
    rows, columns = np.mgrid[
        24 : law.shape[0] - 23 : 12, 28 : law.shape[1] - 27 : 12
    ].reshape(2, -1)
    expected = law[rows, columns]
    circle = np.abs(expected) * 3 * math.pi / 4
    slant = np.zeros(2)
    for _ in range(3):
        places = zip(rows, columns, circle, strict=True)
        measured = np.array(
            [measured_disparity(halves, *place, slant) for place in places]
        )
        slant = np.linalg.lstsq(
            np.stack([rows, columns, np.ones(len(rows))], axis=1), measured
        )[0][:2]
    assert expected[circle > 2].min() < -2
    assert expected[circle > 2].max() > 2
    np.testing.assert_allclose(measured[circle > 2], expected[circle > 2], rtol=0.02)


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


def test_disparity_needs_light_in_both_halves():
    depth = np.ones((2, 2))
    right = LENS.replace(aperture=tl.MaskAperture(np.array([[0.0, 1.0], [0.0, 1.0]])))
    for arguments, message in (
        ((depth, CAMERA, tl.Pinhole()), "a pinhole has none"),
        ((depth, CAMERA, right), "light in both halves"),
        ((-depth, CAMERA, LENS), "depth must be positive"),
        ((depth, CAMERA, LENS, "z"), "axis"),
    ):
        with pytest.raises(InputError, match=message):
            tl.dual_pixel_disparity(*arguments)
