"""The truth of any ordered pair: on its epipolar lines, equal to the closed forms, and leading back to the point."""

import itertools

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.rendering import rendering_cases as cases
from tests.rendering.rendering_answers import View
from tests.rigs import DISTORTIONS, px_from_world, rotation
from twinlens import geometry
from twinlens.camera import Camera, Rig, multiview

LEAST = 20  # pixels of a pair of images that both see


@pytest.fixture(scope="module")
def scene():
    return cases.scene()


def small_rig(seed):
    """Two unlike cameras, distorted or not, rolled at will, 4 m before the scene, a good way apart."""
    rng = np.random.default_rng(seed)
    poses = []
    for x in (-0.5, 0.5):
        centre = np.array([x, -4.0, 0.0]) + rng.uniform(-0.3, 0.3, 3)
        target = rng.uniform(-0.2, 0.2, 3)
        up = rotation(rng)[0]
        poses.append(geometry.look_at(centre, target, up))
    return Rig([small_camera(rng) for _ in poses], poses)


def small_camera(rng):
    fx = rng.uniform(14, 22)
    cx = 11.5 + rng.uniform(-2, 2)
    cy = 8.5 + rng.uniform(-2, 2)
    fy = fx * rng.uniform(0.9, 1.1)
    return Camera(24, 18, fx, fy, cx, cy, DISTORTIONS[rng.integers(3)])


class Pair:
    """A random rig, its correspondence, and the pixels of points that both images may have: here and there."""

    def __init__(self, scene, seed):
        self.scene = scene
        self.rig = small_rig(seed)
        self.answer = tl.correspondence(scene, self.rig)
        self.is_hit = np.isfinite(self.answer.pixels[..., 0])
        self.here = self.rig.cameras[0].pixel_grid()[self.is_hit]
        self.there = self.answer.pixels[self.is_hit]

    def ideal_pixels(self):
        both = zip(self.rig.cameras, (self.here, self.there), strict=True)
        return [multiview.ideal_pixels(camera, pixels) for camera, pixels in both]

    def positions(self):
        """The points of all pixels (H, W, 3)."""
        return tl.ground_truth(self.scene, self.rig, objects=False)[0].position


@pytest.fixture(scope="module")
def pairs(scene):
    return [Pair(scene, seed) for seed in range(40)]


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_truth_of_random_rigs_satisfies_their_fundamental_matrices(pairs):
    """p_b^T F p_a is 0, for pixels scaled to unit norm."""
    for pair in pairs:
        assert len(pair.here) > LEAST
        a, b = (unit(geometry.homogeneous(pixels)) for pixels in pair.ideal_pixels())
        matrix = multiview.fundamental_matrix(pair.rig)
        residual = np.einsum("ni,ij,nj->n", b, matrix, a)
        assert np.abs(residual).max() < 1e-9


def test_opencv_triangulates_the_truth_to_the_same_points(pairs):
    for pair in pairs[:20]:
        matrices = (px_from_world(pair.rig, index) for index in (0, 1))
        pixels = (ideal.T.copy() for ideal in pair.ideal_pixels())
        theirs = geometry.dehomogeneous(cv2.triangulatePoints(*matrices, *pixels).T)
        assert np.abs(theirs - pair.positions()[pair.is_hit]).max() < 1e-6


def test_every_ordered_pair_of_three_cameras_equals_the_closed_form(scene):
    rig = cases.crossed_rig()
    bodies = cases.bodies()
    for source, target in itertools.permutations(range(3), 2):
        answer = tl.correspondence(scene, rig, source, target)
        cameras = [rig.cameras[index] for index in (source, target)]
        poses = [rig.world_from_cams[index] for index in (source, target)]
        view = View(bodies, Rig(cameras, poses), 0)
        pixels = view.pixels()
        depth, body, _ = view.all_hits
        hit = body >= 0
        expected = np.full((len(pixels), 2), np.inf)
        expected[hit] = view.pixels_in(1, view.points(pixels[hit], depth[hit]))
        close = np.isclose(answer.pixels.reshape(-1, 2), expected, rtol=0, atol=1e-4)
        wrong = ~close.all(axis=1)
        assert view.near_edge(view.label, pixels[wrong], 1e-3).all()
        assert (answer.visible.ravel() != view.all_visible).mean() < 0.005
        assert np.isinf(answer.disparity).all()


def test_ground_truth_of_a_rectified_pair_agrees_in_both_orders(scene):
    rig = cases.rigs()[0]
    truths = tl.ground_truth(scene, rig, objects=False)
    for source, target, sign in ((0, 1, 1), (1, 0, -1)):
        answer = tl.correspondence(scene, rig, source, target)
        assert np.array_equal(answer.disparity, truths[source].disparity)
        assert np.array_equal(answer.visible, truths[source].visible)
        finite = np.isfinite(answer.disparity)
        shift = (rig.cameras[source].pixel_grid() - answer.pixels)[finite]
        assert np.abs(shift[:, 1]).max() < 1e-6
        assert np.abs(sign * shift[:, 0] - answer.disparity[finite]).max() < 1e-4
        assert np.array_equal(answer.flow[finite], -shift)
        assert np.isposinf(answer.flow[~finite]).all()
        error = answer.target_disparity[finite] - answer.disparity[finite]
        assert np.abs(error).max() < 1e-5
        assert np.isposinf(answer.target_disparity[~finite]).all()


def test_surfaces_of_a_still_scene_do_not_move(scene):
    """Whatever the cameras; and nothing is known where nothing was hit."""
    answer = tl.correspondence(scene, cases.crossed_rig(), 2, 0)
    missed = np.isinf(answer.pixels[..., 0])
    assert np.array_equal(answer.scene_flow[~missed], np.zeros(((~missed).sum(), 3)))
    assert np.isposinf(answer.scene_flow[missed]).all()
    assert np.isposinf(answer.target_disparity).all()


def test_cameras_at_one_position_are_related_by_a_homography(scene):
    """Also in the sky, whose points are at infinity."""
    crossed = cases.crossed_rig()
    camera = crossed.cameras[1]
    pose = crossed.world_from_cams[1]
    turn = rotation(np.random.default_rng(1), 0.2)
    rig = Rig([camera] * 2, [pose, pose @ geometry.rigid(turn, np.zeros(3))])
    answer = tl.correspondence(scene, rig, sky=True)
    first, second = (px_from_world(rig, index)[:, :3] for index in (0, 1))
    pixels = geometry.homogeneous(camera.pixel_grid())
    expected = geometry.dehomogeneous(pixels @ (second @ np.linalg.inv(first)).T)
    assert np.abs(answer.pixels - expected).max() < 1e-6
    assert (answer.visible == camera.contains(expected)).mean() > 0.999


def test_sky_has_the_pixel_of_its_point_at_infinity_or_is_unknown(scene):
    rig = cases.crossed_rig()
    plain, sky = (tl.correspondence(scene, rig, 2, 0, sky=sky) for sky in (False, True))
    missed = np.isinf(plain.pixels[..., 0])
    assert missed.any()
    assert not plain.visible[missed].any()
    rays = rig.cameras[2].unproject(rig.cameras[2].pixel_grid())[missed]
    far = geometry.transform_points(rig.b_from_a(2, 0), 1e9 * rays)
    assert np.abs(sky.pixels[missed] - rig.cameras[0].project(far)).max() < 1e-4
    assert np.array_equal(sky.pixels[~missed], plain.pixels[~missed])


def test_points_behind_the_target_are_unknown_not_nan(scene):
    ahead = geometry.look_at([0, -4, 0], [0, 0, 0])
    away = geometry.look_at([0, -4.1, 0], [0, -8, 0])
    camera = Camera(24, 18, 20.0, 20.0, 11.5, 8.5)
    answer = tl.correspondence(scene, Rig([camera, camera], [ahead, away]))
    assert np.isposinf(answer.pixels).all()
    assert not answer.visible.any()
