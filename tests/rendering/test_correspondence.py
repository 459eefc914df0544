"""The truth of any ordered pair: on its epipolar lines, equal to the closed forms, and leading back to the point."""

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.rendering import rendering_cases as cases
from tests.rendering.rendering_answers import View
from tests.rigs import px_from_world, rotation
from twinlens import geometry
from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Rig, multiview
from twinlens.errors import InputError
from twinlens.geometry import homogeneous
from twinlens.geometry.triangulation import METHODS

DISTORTIONS = (None, BrownConrady(-0.1, 0.02, 1e-3, -5e-4), KannalaBrandt(0.02, -0.01))
LEAST = 20  # pixels of a pair of images that both see


@pytest.fixture(scope="module")
def scene():
    return cases.scene()


def small_rig(seed):
    """Two unlike cameras, distorted or not, rolled at will, 4 m before the scene, a good way apart."""
    rng = np.random.default_rng(seed)
    centres = [
        np.array([x, -4.0, 0.0]) + rng.uniform(-0.3, 0.3, 3) for x in (-0.5, 0.5)
    ]
    poses = [
        geometry.look_at(centre, rng.uniform(-0.2, 0.2, 3), rotation(rng)[0])
        for centre in centres
    ]
    return Rig([small_camera(rng) for _ in poses], poses)


def small_camera(rng):
    fx, cx, cy = (
        rng.uniform(14, 22),
        11.5 + rng.uniform(-2, 2),
        8.5 + rng.uniform(-2, 2),
    )
    return Camera(
        24, 18, fx, fx * rng.uniform(0.9, 1.1), cx, cy, DISTORTIONS[rng.integers(3)]
    )


@pytest.fixture(scope="module")
def pairs(scene):
    """(rig, correspondence, its known pixels here, and there) of a hundred random rigs."""
    found = []
    for seed in range(100):
        rig = small_rig(seed)
        answer = tl.correspondence(scene, rig)
        known = np.isfinite(answer.pixels[..., 0])
        found.append(
            (rig, answer, rig.cameras[0].pixel_grid()[known], answer.pixels[known])
        )
    return found


def ideal(rig, here, there):
    return multiview.ideal_pixels(rig.cameras[0], here), multiview.ideal_pixels(
        rig.cameras[1], there
    )


def algebraic_residual(matrix, a, b):
    """p_b^T F p_a of pixels scaled to unit norm."""
    first, second = (
        p / np.linalg.norm(p, axis=-1, keepdims=True) for p in map(homogeneous, (a, b))
    )
    return np.einsum("ni,ij,nj->n", second, matrix, first)


def test_truth_of_a_hundred_random_rigs_satisfies_their_fundamental_matrices(pairs):
    for rig, _, here, there in pairs:
        assert len(here) > LEAST
        residual = algebraic_residual(
            multiview.fundamental_matrix(rig), *ideal(rig, here, there)
        )
        assert np.abs(residual).max() < 1e-9


def test_fundamental_matrices_agree_with_opencv(pairs):
    balanced = np.array([[16.0, 0, 11.5], [0, 16.0, 8.5], [0, 0, 1.0]])
    for rig, _, here, there in pairs[:20]:
        theirs, _ = cv2.findFundamentalMat(*ideal(rig, here, there), cv2.FM_8POINT)
        ours, theirs = (
            balanced.T @ matrix @ balanced
            for matrix in (multiview.fundamental_matrix(rig), theirs)
        )
        ours, theirs = ours / np.linalg.norm(ours), theirs / np.linalg.norm(theirs)
        assert min(np.abs(ours - theirs).max(), np.abs(ours + theirs).max()) < 1e-6


def test_matches_triangulate_to_the_true_points(scene, pairs):
    for rig, answer, here, there in pairs[:30]:
        position = tl.ground_truth(scene, rig, objects=False)[0].position[
            np.isfinite(answer.pixels[..., 0])
        ]
        for method in METHODS:
            points = multiview.triangulate(rig, [here, there], method=method)
            assert np.abs(points - position).max() < 1e-9
        for index, pixels in enumerate((here, there)):
            cam = geometry.transform_points(
                geometry.inverse(rig.world_from_cams[index]), points
            )
            assert np.abs(rig.cameras[index].project(cam) - pixels).max() < 1e-9


def test_opencv_triangulates_the_truth_to_the_same_points(scene, pairs):
    for rig, answer, here, there in pairs[:20]:
        position = tl.ground_truth(scene, rig, objects=False)[0].position[
            np.isfinite(answer.pixels[..., 0])
        ]
        a, b = ideal(rig, here, there)
        theirs = cv2.triangulatePoints(
            px_from_world(rig, 0), px_from_world(rig, 1), a.T.copy(), b.T.copy()
        )
        assert np.abs(geometry.dehomogeneous(theirs.T) - position).max() < 1e-6


def test_correspondences_are_symmetric(scene, pairs):
    """The ray of the target's pixel through an exact match ends where the source's does."""
    for rig, answer, _, _ in pairs[:10]:
        rows, columns = np.nonzero(answer.visible)
        position = tl.ground_truth(scene, rig, objects=False)[0].position[rows, columns]
        seen = answer.pixels[rows, columns]
        target = rig.cameras[1]
        xy = target.unproject(seen)[:, :2]
        single = [Camera(1, 1, 100.0, 100.0, -100 * x, -100 * y) for x, y in xy]
        again = tl.ground_truth(
            scene,
            Rig(single[:40], [rig.world_from_cams[1]] * len(single[:40])),
            objects=False,
        )
        back = np.array([truth.position[0, 0] for truth in again])
        assert (np.linalg.norm(back - position[:40], axis=1) < 1e-4).all()


def test_every_ordered_pair_of_three_cameras_equals_the_closed_form(scene):
    rig = cases.crossed_rig()
    bodies = cases.bodies()
    for source in range(3):
        for target in range(3):
            if source == target:
                continue
            answer = tl.correspondence(scene, rig, source, target)
            view = View(
                bodies,
                Rig(
                    [rig.cameras[i] for i in (source, target)],
                    [rig.world_from_cams[i] for i in (source, target)],
                ),
                0,
            )
            pixels = view.pixels()
            depth, body, _ = view.hits(pixels)
            expected = np.full((len(pixels), 2), np.inf)
            expected[body >= 0] = view.partner_pixels(
                view.points(pixels[body >= 0], depth[body >= 0])
            )
            given = answer.pixels.reshape(-1, 2)
            with np.errstate(invalid="ignore"):
                wrong = ~((np.abs(given - expected) <= 1e-4) | (given == expected)).all(
                    axis=1
                )
            assert view.near_edge(view.label, pixels[wrong], 1e-3).all()
            unlike = answer.visible.ravel() != view.all_visible
            assert unlike.mean() < 0.005
            assert np.isinf(answer.disparity).all()


def test_a_rectified_pair_has_its_disparity_in_both_orders_and_ground_truth_agrees(
    scene,
):
    rig = cases.rigs()[0]
    truths = tl.ground_truth(scene, rig)
    for source, target, sign in ((0, 1, 1), (1, 0, -1)):
        answer = tl.correspondence(scene, rig, source, target)
        truth = truths[source]
        assert np.array_equal(answer.disparity, truth.disparity)
        assert np.array_equal(answer.visible, truth.visible)
        known = np.isfinite(answer.disparity)
        u, v = np.moveaxis(rig.cameras[source].pixel_grid(), -1, 0)
        assert np.abs(answer.pixels[known, 1] - v[known]).max() < 1e-6
        assert (
            np.abs(
                sign * (u - answer.pixels[..., 0])[known] - answer.disparity[known]
            ).max()
            < 1e-4
        )


def test_cameras_at_one_position_are_related_by_a_homography(scene):
    a = cases.crossed_rig()
    turned = a.world_from_cams[1] @ geometry.rigid(
        rotation(np.random.default_rng(1), 0.2), np.zeros(3)
    )
    rig = Rig([a.cameras[1]] * 2, [a.world_from_cams[1], turned])
    answer = tl.correspondence(scene, rig, sky=True)
    homography = px_from_world(rig, 1)[:, :3] @ np.linalg.inv(
        px_from_world(rig, 0)[:, :3]
    )
    expected = geometry.dehomogeneous(
        geometry.homogeneous(rig.cameras[0].pixel_grid()) @ homography.T
    )
    assert np.abs(answer.pixels - expected).max() < 1e-6
    assert (answer.visible == rig.cameras[1].contains(expected)).mean() > 0.999


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


@pytest.mark.parametrize("pair", [(0, 0), (0, 3), (-1, 0)])
def test_an_invalid_pair_of_cameras_is_an_error(scene, pair):
    with pytest.raises(InputError, match="two different cameras from 0 to 2"):
        tl.correspondence(scene, cases.crossed_rig(), *pair)
