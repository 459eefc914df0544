"""Placing objects: the order of scale, rotation and translation, and what a rotation keeps."""

import numpy as np
from hypothesis import example, given, strategies as st
from scipy.spatial.transform import Rotation

from twinlens.scenes.placement import CopyGrid, Placement, rotation
from twinlens.scenes.scene import Scene

angles = st.floats(-720, 720)
components = st.floats(-10, 10).filter(lambda x: abs(x) > 1e-3)


def placed(**keys):
    return Placement.model_validate(keys).world_from_object()


def copies(table):
    return CopyGrid.model_validate(table).poses()


@given(angle=angles, x=components, y=components, z=components)
def test_rotation_agrees_with_scipy(angle, x, y, z):
    axis = np.array([x, y, z])
    theirs = Rotation.from_rotvec(
        np.radians(angle) * axis / np.linalg.norm(axis)
    ).as_matrix()
    np.testing.assert_allclose(rotation(axis, angle)[:3, :3], theirs, atol=1e-9)


@given(a=angles, b=angles, c=angles)
def test_euler_angles_turn_about_the_fixed_axes_in_order(a, b, c):
    theirs = Rotation.from_euler("xyz", [a, b, c], degrees=True).as_matrix()
    np.testing.assert_allclose(placed(euler_deg=[a, b, c])[:3, :3], theirs, atol=1e-9)


def test_scale_comes_first_and_translation_last():
    pose = placed(
        scale=[2, 1, 1], rotate={"axis": [0, 0, 1], "deg": 90}, translate=[0, 0, 5]
    )
    np.testing.assert_allclose(pose @ [1, 0, 0, 1], [0, 2, 5, 1], atol=1e-12)


def test_a_list_of_rotations_applies_in_order():
    pose = placed(
        rotate=[{"axis": [1, 0, 0], "deg": 90}, {"axis": [0, 0, 1], "deg": 90}]
    )
    np.testing.assert_allclose(pose @ [0, 1, 0, 1], [0, 0, 1, 1], atol=1e-12)


@example((0.5, 0.5, 0.0))  # straight down
@given(st.tuples(components, components, components))
def test_look_at_turns_z_to_the_target(target):
    pose = placed(translate=[0.5, 0.5, 11.0], look_at=list(target))
    towards = np.array(target) - [0.5, 0.5, 11.0]
    np.testing.assert_allclose(
        pose[:3, 2], towards / np.linalg.norm(towards), atol=1e-9
    )
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)


def test_an_array_is_centred_with_its_step():
    poses = copies({"count": [3, 2, 1], "step": [1.0, 0.5, 9.0]})
    places = np.array([pose[:3, 3] for pose in poses])
    np.testing.assert_allclose(places.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.unique(places[:, 0]), [-1, 0, 1])
    np.testing.assert_allclose(np.unique(places[:, 1]), [-0.25, 0.25])


def test_jitter_stays_in_its_bounds_and_follows_its_seed():
    table = {
        "count": [9, 9, 1],
        "step": [1, 1, 0],
        "jitter": [0.1, 0.2, 0.0],
        "jitter_deg": 20,
        "seed": 4,
    }
    still = {"count": [9, 9, 1], "step": [1, 1, 0]}
    moved = np.array([p[:3, 3] for p in copies(table)]) - [
        p[:3, 3] for p in copies(still)
    ]
    assert (np.abs(moved).max(axis=0) <= [0.1, 0.2, 0.0]).all()
    assert np.abs(moved).max(axis=0)[0] > 0.08
    np.testing.assert_array_equal(copies(table), copies(table))


def test_the_default_pose_of_a_scene_may_be_moved():
    scene = Scene("s", (), {}, np.eye(4), (1.0, 2.0))
    assert scene.at(placed(translate=[1, 2, 3])).world_from_left[2, 3] == 3
