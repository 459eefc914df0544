"""Epipolar geometry of random pairs: matches satisfy it, results equal OpenCV, degenerate input raises."""

import cv2
import numpy as np
import pytest

from tests.rigs import px_from_world, random_rig, seen
from twinlens import geometry
from twinlens.camera import Camera, Rig, multiview
from twinlens.camera.layouts import line, toed_in
from twinlens.errors import InputError
from twinlens.geometry import epipolar

CAMERA = Camera(640, 480, 700.0, 690.0, 310.25, 241.0)
SEEDS = range(40)


def ideal(rig, points, index):
    return multiview.ideal_pixels(rig.cameras[index], seen(rig, points, index))


def centres(rig):
    return [pose[:3, 3] for pose in rig.world_from_cams]


def residual(F, a, b):
    """|p_b^T F p_a| of pixels scaled to unit norm."""
    first, second = (
        p / np.linalg.norm(p, axis=-1, keepdims=True)
        for p in map(geometry.homogeneous, (a, b))
    )
    return np.abs(np.einsum("ni,ij,nj->n", second, F, first))


@pytest.fixture(scope="module")
def rigs():
    return [random_rig(np.random.default_rng(seed), distorted=True) for seed in SEEDS]


def test_matches_of_random_rigs_satisfy_the_epipolar_constraint(rigs):
    for rig, points in rigs:
        first, second = (seen(rig, points, index) for index in (0, 1))
        essential = multiview.essential_matrix(rig)
        fundamental = multiview.fundamental_matrix(rig)

        a, b = ideal(rig, points, 0), ideal(rig, points, 1)
        assert residual(fundamental, a, b).max() < 1e-9
        assert epipolar.sampson_distance(fundamental, a, b).max() < 1e-8
        rays_a = rig.cameras[0].unproject(first)
        rays_b = rig.cameras[1].unproject(second)
        products = np.einsum("ni,ij,nj->n", rays_b, essential, rays_a)
        assert np.abs(products).max() < 1e-10
        sizes = np.linalg.svd(essential, compute_uv=False)
        assert np.allclose(sizes, [rig.baseline(), rig.baseline(), 0], atol=1e-12)
        assert np.linalg.norm(fundamental) == pytest.approx(1)


def test_lines_and_distances_equal_opencv(rigs):
    for rig, points in rigs[:20]:
        fundamental = multiview.fundamental_matrix(rig)
        a, b = ideal(rig, points, 0), ideal(rig, points, 1)
        lines = epipolar.epipolar_lines(fundamental, a)
        theirs = cv2.computeCorrespondEpilines(a[:, None], 1, fundamental)[:, 0]
        assert np.allclose(lines, theirs, atol=1e-6, rtol=1e-9)

        moved = b + 2.5 * lines[:, :2]
        distance = epipolar.sampson_distance(fundamental, a, moved)
        pairs = zip(geometry.homogeneous(a), geometry.homogeneous(moved), strict=True)
        squares = [cv2.sampsonDistance(*pair, fundamental) for pair in pairs]
        assert np.allclose(distance, np.sqrt(squares), rtol=1e-6)


def test_epipoles_are_images_of_the_centres_and_null_vectors_of_f(rigs):
    for rig, _ in rigs[:20]:
        matrix = multiview.fundamental_matrix(rig)
        at_a, at_b = multiview.epipoles(rig)
        assert np.abs(matrix @ at_a).max() < 1e-12
        assert np.abs(at_b @ matrix).max() < 1e-12
        centre = px_from_world(rig, 0) @ [*rig.world_from_cams[1][:3, 3], 1]
        assert np.allclose(at_a, centre / np.linalg.norm(centre), atol=1e-12)


def test_an_epipolar_plane_contains_both_centres_and_the_point(rigs):
    for rig, points in rigs[:20]:
        planes = epipolar.epipolar_planes(*centres(rig), points)
        for held in (points, *centres(rig)):
            assert (
                np.abs((planes[:, :3] * held).sum(axis=1) + planes[:, 3]).max() < 1e-12
            )
        assert np.allclose(np.linalg.norm(planes[:, :3], axis=1), 1)


def test_the_epipolar_curve_contains_the_match_in_the_distorted_image(rigs):
    for rig, points in rigs[:20]:
        pose = geometry.inverse(rig.world_from_cams[0])
        depth = geometry.transform_points(pose, points[0])[2]
        curve = multiview.epipolar_curve(rig, seen(rig, points, 0)[0], [depth])
        assert np.allclose(curve[0], seen(rig, points, 1)[0], atol=1e-8)


def test_a_rectified_pair_has_horizontal_lines_and_epipoles_at_infinity():
    rig = line(CAMERA, 2, 0.1)
    lines = epipolar.epipolar_lines(
        multiview.fundamental_matrix(rig), [[100.0, 50.0], [3.0, 400.0]]
    )
    assert np.allclose(np.abs(lines), [[0, 1, 50], [0, 1, 400]], atol=1e-12)
    assert [e[2] for e in multiview.epipoles(rig)] == [0, 0]
    assert multiview.epipole_in_image(rig) is None


def test_the_epipole_is_the_image_of_the_other_camera_in_front_or_behind():
    ahead = Rig([CAMERA] * 2, [np.eye(4), geometry.rigid(np.eye(3), [0.0, 0.0, 1.0])])
    for a, b in ((0, 1), (1, 0)):
        epipole, F = [CAMERA.cx, CAMERA.cy], multiview.fundamental_matrix(ahead, a, b)
        assert np.allclose(multiview.epipole_in_image(ahead, a, b), epipole)
        assert (epipolar.epipolar_lines(F, epipole) == 0).all()
        assert np.allclose(
            geometry.dehomogeneous(multiview.epipoles(ahead, a, b)[0]), epipole
        )
        assert epipolar.sampson_distance(F, epipole, [1.0, 2.0]) == pytest.approx(
            0, abs=1e-12
        )


def test_a_point_on_the_baseline_has_no_epipolar_plane():
    rig = toed_in(CAMERA, 0.4, 2.0)
    assert (
        epipolar.epipolar_planes(*centres(rig), [[0.05, 0, 0], [0.3, 0, 0]]) == 0
    ).all()


def test_a_line_at_infinity_is_0_0_1():
    """b's image plane is parallel to the epipolar plane and does not intersect it."""
    up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    rig = Rig([CAMERA] * 2, [np.eye(4), geometry.rigid(up, [0.5, 0, 0])])
    assert np.allclose(
        epipolar.epipolar_lines(multiview.fundamental_matrix(rig), [100.0, CAMERA.cy]),
        [0, 0, 1],
    )


PAIR, TOGETHER = line(CAMERA, 2, 0.1), Rig([CAMERA] * 2, [np.eye(4)] * 2)
INFINITE = [[np.inf] * 3]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: multiview.essential_matrix(TOGETHER), "centres coincide"),
        (lambda: multiview.fundamental_matrix(PAIR, 0, 0), "two different cameras"),
        (lambda: multiview.fundamental_matrix(PAIR, 0, 2), "from 0 to 1"),
        (lambda: multiview.ideal_pixels(CAMERA, [[np.nan, 0]]), "finite"),
        (lambda: multiview.epipolar_curve(PAIR, [0, 0], [0.0]), "positive"),
        (lambda: epipolar.epipolar_planes(*centres(PAIR), INFINITE), "infinity"),
    ],
)
def test_invalid_input_raises(call, says):
    with pytest.raises(InputError, match=says):
        call()
