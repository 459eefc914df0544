"""Transforms and projection: group axioms, round trips, and OpenCV."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from twinlens import geometry as g
from twinlens.camera import Camera
from twinlens.errors import InputError

coordinate = st.floats(-50, 50)
vectors = arrays(np.float64, 3, elements=coordinate)
clouds = arrays(np.float64, (7, 3), elements=coordinate)
quaternions = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q) > 1e-3
)


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """The rotation matrix of a quaternion, independent of twinlens."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


poses = st.builds(lambda q, t: g.rigid(rotation_of(q), t), quaternions, vectors)


@given(poses)
def test_inverse_is_the_left_and_right_inverse(b_from_a):
    a_from_b = g.inverse(b_from_a)
    assert np.allclose(a_from_b @ b_from_a, np.eye(4), atol=1e-12)
    assert np.allclose(b_from_a @ a_from_b, np.eye(4), atol=1e-12)
    assert np.allclose(g.inverse(a_from_b), b_from_a, atol=1e-12)
    assert np.allclose(a_from_b, np.linalg.inv(b_from_a), atol=1e-10)


@given(poses, poses, poses, clouds)
def test_composition_is_associative(d_from_c, c_from_b, b_from_a, points_a):
    in_one = g.transform_points(d_from_c @ (c_from_b @ b_from_a), points_a)
    in_steps = g.transform_points(
        d_from_c, g.transform_points(c_from_b, g.transform_points(b_from_a, points_a))
    )
    assert np.allclose(in_one, in_steps, atol=1e-10)
    assert np.allclose(
        (d_from_c @ c_from_b) @ b_from_a, d_from_c @ (c_from_b @ b_from_a), atol=1e-10
    )


@given(poses, clouds)
def test_points_and_directions_equal_homogeneous_products(b_from_a, points):
    column = np.concatenate([points.T, np.ones((1, len(points)))])
    assert np.allclose(
        g.transform_points(b_from_a, points), (b_from_a @ column)[:3].T, atol=1e-12
    )
    assert np.allclose(
        g.rotate(b_from_a, points),
        g.transform_points(b_from_a, points) - b_from_a[:3, 3],
        atol=1e-11,
    )


@given(poses, clouds)
def test_rigid_transforms_preserve_distances_and_handedness(b_from_a, points):
    moved = g.transform_points(b_from_a, points)
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    assert np.allclose(
        np.linalg.norm(moved[:, None] - moved[None], axis=-1), apart, atol=1e-10
    )
    x, y, z = g.rotate(b_from_a, np.eye(3))
    assert np.allclose(np.cross(x, y), z, atol=1e-12)


@given(poses, clouds)
def test_a_pose_with_seven_digits_is_made_orthonormal(b_from_a, points):
    """Rounded matrices are replaced by the nearest rotation, so that the inverse is exact."""
    typed = g.check_rigid(np.round(b_from_a, 7), "pose")
    assert np.abs(typed - b_from_a).max() < 2e-7
    assert np.allclose(g.inverse(typed) @ typed, np.eye(4), atol=1e-12)
    assert np.allclose(
        g.transform_points(g.inverse(typed), g.transform_points(typed, points)),
        points,
        atol=1e-10,
    )


@given(poses)
def test_an_exact_pose_is_copied_unchanged(pose):
    """Poses must survive a round trip through files bit by bit."""
    given_array = pose.copy()
    kept = g.check_rigid(given_array, "pose")
    given_array[:3, 3] = 77
    assert np.array_equal(kept, pose)


@pytest.mark.parametrize("shape", [(3,), (5, 3), (2, 4, 3)])
def test_homogeneous_round_trip(shape):
    points = np.random.default_rng(0).normal(size=shape)
    lifted = g.homogeneous(points)
    assert lifted.shape == (*shape[:-1], 4)
    assert np.array_equal(g.dehomogeneous(lifted), points)
    assert np.allclose(g.dehomogeneous(lifted * -2.5), points, rtol=1e-15)


def test_a_point_at_infinity_becomes_inf():
    assert g.dehomogeneous([1.0, -2.0, 0.0]).tolist() == [math.inf, -math.inf]


@given(vectors, vectors, vectors)
def test_look_at_points_at_its_target_with_up_above(eye, target, up):
    sight = target - eye
    if min(np.linalg.norm(sight), np.linalg.norm(up)) < 1e-6:
        return
    if np.linalg.norm(np.cross(sight, up)) <= 1e-3 * np.linalg.norm(
        sight
    ) * np.linalg.norm(up):
        return
    world_from_cam = g.look_at(eye, target, up)
    seen = g.transform_points(g.inverse(world_from_cam), target)
    assert np.allclose(seen, [0, 0, np.linalg.norm(sight)], atol=1e-9)
    above = g.rotate(g.inverse(world_from_cam), up)
    assert abs(above[0]) < 1e-9
    assert above[1] < 0
    assert np.array_equal(world_from_cam[:3, 3], eye)


def test_look_at_north_from_the_origin_by_hand():
    """Looking along +y with +z up: right is +x, down is -z."""
    assert g.look_at([0, 0, 0], [0, 3, 0])[:3, :3].T.tolist() == [
        [1, 0, 0],
        [0, 0, -1],
        [0, 1, 0],
    ]


@pytest.mark.parametrize(
    ("eye", "target", "up"),
    [
        ([1, 2, 3], [1, 2, 3], [0, 0, 1]),
        ([0, 0, 0], [0, 0, 5], [0, 0, 1]),
        ([0, 0, 0], [0, 1, 0], [0, 0, 0]),
        ([0, 0, math.nan], [0, 1, 0], [0, 0, 1]),
        ([0, 0, 0], [0, math.inf, 0], [0, 0, 1]),
    ],
)
def test_degenerate_look_at_raises(eye, target, up):
    refuses(lambda: g.look_at(eye, target, up), "look_at")


def test_projection_equals_opencv(rng):
    """K [R | t] X against cv2.projectPoints, random cameras and points."""
    for _ in range(20):
        cam_from_world = g.rigid(rotation_of(rng.normal(size=4)), rng.normal(size=3))
        fx, fy, cx, cy = rng.uniform([300, 300, 100, 100], [900, 900, 500, 400])
        camera = Camera(640, 480, fx, fy, cx, cy)
        points_cam = rng.uniform([-2, -2, 0.5], [2, 2, 9], size=(50, 3))
        points = g.transform_points(g.inverse(cam_from_world), points_cam)
        turn, _ = cv2.Rodrigues(cam_from_world[:3, :3])
        theirs, _ = cv2.projectPoints(
            points, turn, cam_from_world[:3, 3], camera.K, None
        )
        ours = camera.project(g.transform_points(cam_from_world, points))
        assert np.allclose(ours, theirs[:, 0], atol=1e-8)
        by_matrix = g.dehomogeneous(
            g.homogeneous(points) @ (camera.K @ cam_from_world[:3]).T
        )
        assert np.allclose(by_matrix, ours, atol=1e-8)


def test_the_film_of_a_real_camera_gives_the_same_pixels_as_fx():
    """v = 50 mm, pixels of 4 x 5 um: fx = v m_x, and the point by similar triangles."""
    density = np.array([1 / 4e-6, 1 / 5e-6])
    film = np.array([0.05 * 0.3 / 1.5, -0.05 * 0.2 / 1.5])
    camera = Camera(6000, 4000, 0.05 * density[0], 0.05 * density[1], 3001.25, 1999.5)
    assert np.allclose(
        camera.project([0.3, -0.2, 1.5]), film * density + (3001.25, 1999.5), rtol=1e-13
    )


def test_points_behind_the_aperture_have_no_image():
    camera = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)
    assert np.isnan(camera.project([[1, 1, 0], [1, 1, -2], [0, 0, -1e-300]])).all()


depths = st.floats(1e-3, 1e6)


@given(depths, st.floats(10, 5000), st.floats(1e-3, 2), st.floats(-200, 200))
def test_disparity_and_depth_are_inverse(depth, fx, baseline, doffs):
    disparity = fx * baseline / depth - doffs
    if disparity + doffs < 1e-6:
        return
    back = g.depth_from_disparity(disparity, fx, baseline, doffs)
    lost = (
        4e-16 * (abs(doffs) + abs(disparity)) / (disparity + doffs)
    )  # the subtraction's own rounding
    assert abs(back / depth - 1) < 1e-12 + lost


@given(
    st.floats(-3, 3),
    st.floats(-3, 3),
    st.floats(0.5, 50),
    st.floats(-30, 30),
    st.floats(0.01, 1),
)
def test_the_depth_of_the_difference_of_two_projections(x, y, z, doffs, baseline):
    left = Camera(640, 480, 700, 650, 300, 240)
    right = left.replace(cx=left.cx + doffs)
    difference = left.project([x, y, z])[0] - right.project([x - baseline, y, z])[0]
    assert 700 * baseline / z - doffs == pytest.approx(difference, abs=1e-9)
    assert g.depth_from_disparity(difference, 700, baseline, doffs) == pytest.approx(
        z, rel=1e-9
    )


def test_unknown_stays_unknown():
    assert g.depth_from_disparity(math.inf, 700, 0.1, doffs=5.0) == math.inf
    assert g.depth_from_disparity([-5.0], 700, 0.1, doffs=5.0).tolist() == [math.inf]


@pytest.mark.parametrize("disparity", [-5.1, math.nan, -math.inf])
def test_disparities_behind_the_camera_raise(disparity):
    refuses(
        lambda: g.depth_from_disparity([3.0, disparity], 700, 0.1, doffs=5.0),
        "disparity",
    )


@pytest.mark.parametrize(
    ("fx", "baseline"),
    [(0, 0.1), (700, 0), (-700, 0.1), (700, -0.1), (math.nan, 1), (7, math.inf)],
)
def test_invalid_fx_and_baseline_raise(fx, baseline):
    refuses(lambda: g.depth_from_disparity(1.0, fx, baseline), "fx and baseline")


def not_rigid() -> dict[str, object]:
    mirror, scale, shear, nan, projective = (np.eye(4) for _ in range(5))
    mirror[0, 0] = -1
    scale[:3, :3] *= 1.001
    shear[0, 1] = 1e-4
    nan[2, 3] = math.nan
    projective[3, 0] = 1e-9
    return {
        "mirror": mirror,
        "scale": scale,
        "shear": shear,
        "nan": nan,
        "projective": projective,
        "3x4": np.eye(4)[:3],
        "number": 3.0,
        "text": "identity",
        "ragged": [[1, 0], [0]],
        "none": None,
    }


@pytest.mark.parametrize("kind", not_rigid())
def test_invalid_poses_raise_with_their_name(kind):
    refuses(
        lambda: g.check_rigid(not_rigid()[kind], "world_from_left"), "world_from_left"
    )


@pytest.mark.parametrize(
    ("rotation", "translation"),
    [
        (np.eye(2), [0, 0, 0]),
        (np.eye(3), [0, 0]),
        (np.eye(3), "abc"),
        (np.eye(3) * 2, [0, 0, 0]),
    ],
)
def test_rigid_raises_for_wrong_shapes(rotation, translation):
    refuses(lambda: g.rigid(rotation, translation), "rigid transform")


def refuses(call, *words):
    """Expect an InputError of one line with these words."""
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.fixture
def rng():
    return np.random.default_rng(7)
