"""Triangulation: exact pixels give the point, results equal OpenCV, noise has the predicted covariance."""

import cv2
import numpy as np
import pytest

from tests.rigs import px_from_world, random_rig, seen
from twinlens import geometry
from twinlens.camera import Camera, Rig
from twinlens.camera.layouts import line, toed_in
from twinlens.camera.multiview import covariance, fundamental_matrix, triangulate
from twinlens.errors import InputError
from twinlens.geometry.triangulation import METHODS, correct_matches

CAMERA = Camera(640, 480, 700.0, 690.0, 310.25, 241.0)
AHEAD = Rig([CAMERA] * 2, [np.eye(4), geometry.rigid(np.eye(3), [0.0, 0.0, 1.0])])
"""Two cameras on one optical axis."""


@pytest.mark.parametrize("method", METHODS)
def test_exact_pixels_of_two_cameras_give_the_point(method):
    for seed in range(40):
        rig, points = random_rig(np.random.default_rng(seed), distorted=True)
        back = triangulate(rig, [seen(rig, points, i) for i in (0, 1)], method=method)
        assert np.abs(back - points).max() < 1e-9


@pytest.mark.parametrize("method", ["midpoint", "dlt"])
def test_exact_pixels_of_more_cameras_give_the_point(method):
    for seed in range(10):
        rig, points = random_rig(np.random.default_rng(seed), count=4, distorted=True)
        back = triangulate(
            rig, [seen(rig, points, i) for i in (2, 0, 3)], (2, 0, 3), method
        )
        assert np.abs(back - points).max() < 1e-9


def noisy(rig, points, rng, sigma=1.0):
    return [
        seen(rig, points, i) + rng.normal(0, sigma, (len(points), 2))
        for i in range(len(rig))
    ]


@pytest.mark.parametrize("method", METHODS)
def test_triangulation_of_corrected_matches_equals_opencv(method):
    """After correction to their epipolar lines, all methods give the same point."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        rig, points = random_rig(rng)
        matches = correct_matches(fundamental_matrix(rig), *noisy(rig, points, rng))
        theirs = cv2.triangulatePoints(
            px_from_world(rig, 0), px_from_world(rig, 1), *(m.T.copy() for m in matches)
        ).T
        assert np.allclose(
            triangulate(rig, matches, method=method),
            geometry.dehomogeneous(theirs),
            atol=1e-6,
        )


@pytest.mark.parametrize("sigma", [0.3, 5.0])
def test_corrected_matches_equal_opencv(sigma):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        rig, points = random_rig(rng)
        matrix, (a, b) = fundamental_matrix(rig), noisy(rig, points, rng, sigma)
        ours, theirs = (
            correct_matches(matrix, a, b),
            cv2.correctMatches(matrix, a[None], b[None]),
        )
        assert all(
            np.allclose(mine, its[0], atol=1e-6)
            for mine, its in zip(ours, theirs, strict=True)
        )


def test_corrected_matches_move_no_further_than_opencvs_for_large_noise():
    """At 40 px OpenCV's polynomial loses digits: the results differ by up to 0.03 px, and ours must be nearer."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        rig, points = random_rig(rng)
        matrix, noisy_pixels = (
            fundamental_matrix(rig),
            np.stack(noisy(rig, points, rng, 40.0)),
        )
        ours, theirs = (
            correct_matches(matrix, *noisy_pixels),
            cv2.correctMatches(matrix, *noisy_pixels[:, None]),
        )
        moved = [
            ((np.reshape(corrected, noisy_pixels.shape) - noisy_pixels) ** 2).sum(
                axis=(0, 2)
            )
            for corrected in (ours, theirs)
        ]
        assert (moved[0] <= moved[1] + 1e-8).all()
        assert np.allclose(ours, np.reshape(theirs, noisy_pixels.shape), atol=0.05)


def test_a_vertical_error_is_divided_between_the_images():
    near_a, near_b = correct_matches(
        fundamental_matrix(line(CAMERA, 2, 0.2)), [[100.0, 50.0]], [[80.0, 53.0]]
    )
    assert np.allclose(near_a, [[100, 51.5]], atol=1e-9)
    assert np.allclose(near_b, [[80, 51.5]], atol=1e-9)


def test_the_midpoint_is_the_middle_of_the_shortest_segment_between_two_rays():
    rig = line(CAMERA, 2, 1.0)
    above = (
        seen(rig, np.array([[0.5, -0.25, 2.0]]), 0),
        seen(rig, np.array([[0.5, 0.25, 2.0]]), 1),
    )
    got = triangulate(rig, above, method="midpoint")[0]
    ends = [[0.5, -0.25, 2.0], [-0.5, 0.25, 2.0]]
    normal = np.cross(*ends)
    s, _, t = np.linalg.solve(
        np.stack([ends[0], normal, np.negative(ends[1])], axis=1), [1.0, 0, 0]
    )
    assert np.allclose(
        got,
        0.5 * (s * np.array(ends[0]) + [1, 0, 0] + t * np.array(ends[1])),
        atol=1e-12,
    )


@pytest.mark.parametrize("method", METHODS)
def test_covariance_of_noisy_points_equals_the_prediction(method):
    """Monte Carlo of 20000 draws: variances are known to 1 %, and each of the six numbers must agree to 5 %."""
    rng = np.random.default_rng(5)
    rig, points = random_rig(rng, distorted=True)
    draws = np.repeat(points[:1], 20000 if method == "optimal" else 4000, axis=0)
    got = triangulate(rig, noisy(rig, draws, rng, 0.3), method=method)
    if method != "optimal":  # no promise but that they do no better than the bound
        assert np.trace(np.cov(got.T)) > 0.93 * np.trace(
            covariance(rig, points[:1], 0.3)[0]
        )
        return
    root = np.linalg.cholesky(covariance(rig, points[:1], 0.3)[0])
    whitened = np.linalg.solve(root, (got - points[0]).T)
    assert np.abs(np.cov(whitened) - np.eye(3)).max() < 0.05


def test_depth_error_is_z_squared_over_fb():
    rig, depths = line(CAMERA, 2, 0.1), np.array([1.0, 2.0, 8.0])
    points = np.stack([0.05 + 0 * depths, 0 * depths, depths], axis=1)
    sigma = np.sqrt(covariance(rig, points, 0.25)[:, 2, 2])
    assert np.allclose(
        sigma, depths**2 / (CAMERA.fx * 0.1) * np.sqrt(2) * 0.25, rtol=0.01
    )


def test_more_cameras_and_less_noise_reduce_the_covariance():
    rig, points = random_rig(np.random.default_rng(2), count=3)
    two, three = covariance(rig, points), covariance(rig, points, 1.0, (0, 1, 2))
    assert (np.linalg.eigvalsh(two - three) > -1e-15).all()
    assert (np.trace(three, axis1=1, axis2=2) < np.trace(two, axis1=1, axis2=2)).all()
    assert np.allclose(covariance(rig, points, [2.0, 2.0]), 4 * two)
    assert (
        np.linalg.eigvalsh(two - covariance(rig, points, [1.0, 0.5])) > -1e-15
    ).all()


@pytest.mark.parametrize("method", METHODS)
def test_rays_without_an_intersection_in_front_give_inf(method):
    rig = line(CAMERA, 2, 0.1)
    parallel, parting = (
        ([[300.0, 200.0]], [[300.0, 200.0]]),
        ([[300.0, 200.0]], [[301.0, 200.0]]),
    )
    for pixels in (parallel, parting):
        assert np.isposinf(triangulate(rig, pixels, method=method)).all()
    toed = toed_in(CAMERA, 0.5, 2.0)
    behind = triangulate(toed, ([[10.0, 200.0]], [[630.0, 200.0]]), method=method)
    assert np.isposinf(behind).all()
    along_the_baseline = [[[CAMERA.cx, CAMERA.cy]]] * 2
    assert np.isposinf(triangulate(AHEAD, along_the_baseline, method=method)).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_distant_point_is_finite(method):
    rig, far = line(CAMERA, 2, 0.1), np.array([[100.0, 50.0, 1000.0]])
    points = triangulate(rig, [seen(rig, far, i) for i in (0, 1)], method=method)
    assert np.allclose(points, far, rtol=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_no_pixels_give_no_points(method):
    rig = line(CAMERA, 2, 0.1)
    assert triangulate(rig, [np.zeros((0, 2))] * 2, method=method).shape == (0, 3)
    assert covariance(rig, np.zeros((0, 3))).shape == (0, 3, 3)


@pytest.mark.parametrize("method", METHODS)
def test_accuracy_far_from_the_origin_is_that_of_float64(method):
    rig, points = random_rig(np.random.default_rng(0), distorted=True)
    away = 1e5
    moved = Rig(
        rig.cameras,
        [
            geometry.rigid(pose[:3, :3], pose[:3, 3] + away)
            for pose in rig.world_from_cams
        ],
    )
    pixels = [seen(moved, points + away, i) for i in (0, 1)]
    assert (
        np.abs(triangulate(moved, pixels, method=method) - points - away).max() < 1e-9
    )


@pytest.mark.parametrize("method", METHODS)
def test_random_pixels_give_points_or_inf(method):
    rng = np.random.default_rng(1)
    for rig in (line(CAMERA, 2, 0.1), toed_in(CAMERA, 0.5, 2.0), AHEAD):
        points = triangulate(rig, rng.uniform(0, 480, (2, 500, 2)), method=method)
        assert (np.isfinite(points).all(axis=1) | np.isposinf(points).all(axis=1)).all()
        assert np.isfinite(points).any()


def test_a_pixel_on_the_epipole_does_not_change():
    pair = np.array([[CAMERA.cx, CAMERA.cy]]), np.array([[5.0, 7.0]])
    assert np.array_equal(correct_matches(fundamental_matrix(AHEAD), *pair), pair)


ONE, RANK_1 = [[1.0, 2.0]], np.diag([1.0, 0, 0])
TOGETHER = Rig([CAMERA] * 2, [np.eye(4)] * 2)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda rig: triangulate(rig, [ONE] * 2, method="optical"), "mean 'optimal'"),
        (lambda rig: triangulate(rig, [ONE] * 2, (0, 0)), "different cameras"),
        (lambda rig: triangulate(rig, [ONE] * 2, (0, 3)), "from 0 to 2"),
        (lambda rig: triangulate(rig, [ONE] * 3, (0, 1, 2)), "'midpoint' or 'dlt'"),
        (lambda rig: triangulate(rig, [[[1.0, np.nan]]] * 2), "finite"),
        (lambda rig: triangulate(rig, [ONE, ONE * 2]), "same N"),
        (lambda rig: triangulate(TOGETHER, [ONE] * 2), "centres coincide"),
        (lambda rig: covariance(rig, [[0.0, 0, -1]]), "z > 0"),
        (lambda rig: covariance(rig, [[0.0, 0, np.inf]]), "infinity"),
        (lambda rig: covariance(rig, [[0.0, 0, 1]], 0.0), "sigma_px"),
        (lambda rig: covariance(rig, [[0.3, -0.1, 1e18]]), "do not determine"),
        (lambda rig: correct_matches(RANK_1, ONE, ONE), "rank 2"),
        (lambda rig: correct_matches(np.eye(3), ONE, [[1.0, 2, 3]]), "equally many"),
        (lambda rig: correct_matches(np.eye(3), [[np.inf, 2]], ONE), "finite"),
    ],
)
def test_invalid_input_raises(call, says):
    with pytest.raises(InputError, match=says):
        call(line(CAMERA, 3, 0.1))
