"""Transforms and projection: group axioms, round trips, and OpenCV."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from twinlens import geometry as g
from twinlens.camera import Camera
from twinlens.errors import InputError

coordinate = st.floats(-50, 50)
vectors = arrays(np.float64, 3, elements=coordinate)
clouds = arrays(np.float64, (7, 3), elements=coordinate)
quaternions = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q) > 1e-3
)


poses = st.builds(
    lambda quaternion, place: g.rigid(
        Rotation.from_quat(quaternion).as_matrix(), place
    ),
    quaternions,
    vectors,
)


@given(poses)
def test_inverse_is_the_left_and_right_inverse(b_from_a):
    a_from_b = g.inverse(b_from_a)
    assert np.allclose(a_from_b @ b_from_a, np.eye(4), atol=1e-12)
    assert np.allclose(b_from_a @ a_from_b, np.eye(4), atol=1e-12)
    assert np.allclose(g.inverse(a_from_b), b_from_a, atol=1e-12)
    assert np.allclose(a_from_b, np.linalg.inv(b_from_a), atol=1e-10)


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


def changed(row, column, value):
    """The identity with one other entry."""
    pose = np.eye(4)
    pose[row, column] = value
    return pose


NOT_RIGID = [
    changed(0, 0, -1), np.diag([1.001, 1.001, 1.001, 1]), changed(0, 1, 4e-4), changed(2, 3, math.nan),
    changed(3, 0, 1e-9), np.eye(4)[:3], 3.0, "identity", [[1, 0], [0]], None,
]  # fmt: skip
LOOKS = [
    ([1, 2, 3], [1, 2, 3], [0, 0, 1]), ([0, 0, 0], [0, 0, 5], [0, 0, 1]), ([0, 0, 0], [0, 1, 0], [0, 0, 0]),
    ([0, 0, math.nan], [0, 1, 0], [0, 0, 1]), ([0, 0, 0], [0, math.inf, 0], [0, 0, 1]),
]  # fmt: skip
RIGID = [
    (np.eye(2), [0, 0, 0]), (np.eye(3), [0, 0]), (np.eye(3), "abc"), (np.eye(3) * 2, [0, 0, 0]),
]  # fmt: skip
DISPARITIES = [
    ([3.0, disparity], 700, 0.1, 5.0) for disparity in (-5.1, math.nan, -math.inf)
]
LENGTHS = [
    (1.0, fx, baseline)
    for fx, baseline in ((0, 0.1), (700, 0), (-700, 0.1), (700, -0.1), (math.nan, 1))
]


@pytest.mark.parametrize(
    ("call", "arguments", "says"),
    [
        (g.check_rigid, [(pose, "world_from_left") for pose in NOT_RIGID], "world_from_left"),
        (g.look_at, LOOKS, "look_at"),
        (g.rigid, RIGID, "rigid transform"),
        (g.depth_from_disparity, DISPARITIES, "disparity"),
        (g.depth_from_disparity, LENGTHS, "fx and baseline"),
    ],
)  # fmt: skip
def test_invalid_arguments_raise_in_one_line(call, arguments, says):
    for values in arguments:
        with pytest.raises(InputError, match=says) as refusal:
            call(*values)
        assert "\n" not in str(refusal.value)
