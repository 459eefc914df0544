"""Placing objects: the order of scale, rotation and translation, and what a rotation keeps."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from tests.scenes.scene_text import Read
from twinlens.errors import InputError
from twinlens.scenes.placement import CopyGrid, Placement, rotation
from twinlens.scenes.scene import Scene

angles = st.floats(-720, 720)
components = st.floats(-10, 10).filter(lambda x: abs(x) > 1e-3)


def placed(**keys: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    return Placement.model_validate(keys).world_from_object()


def copies(table: dict[str, Any]) -> tuple[np.ndarray[Any, np.dtype[np.float64]], ...]:
    return CopyGrid.model_validate(table).poses()


@given(angle=angles, x=components, y=components, z=components)
def test_rotation_agrees_with_scipy(angle: float, x: float, y: float, z: float) -> None:
    axis = np.array([x, y, z])
    theirs = Rotation.from_rotvec(
        np.radians(angle) * axis / np.linalg.norm(axis)
    ).as_matrix()
    np.testing.assert_allclose(rotation(axis, angle)[:3, :3], theirs, atol=1e-9)


@given(a=angles, b=angles, c=angles)
def test_euler_angles_turn_about_the_fixed_axes_in_order(
    a: float, b: float, c: float
) -> None:
    theirs = Rotation.from_euler("xyz", [a, b, c], degrees=True).as_matrix()
    np.testing.assert_allclose(placed(euler_deg=[a, b, c])[:3, :3], theirs, atol=1e-9)


def test_scale_comes_first_and_translation_last() -> None:
    pose = placed(
        scale=[2, 1, 1], rotate={"axis": [0, 0, 1], "deg": 90}, translate=[0, 0, 5]
    )
    np.testing.assert_allclose(pose @ [1, 0, 0, 1], [0, 2, 5, 1], atol=1e-12)


def test_a_list_of_rotations_applies_in_order() -> None:
    pose = placed(
        rotate=[{"axis": [1, 0, 0], "deg": 90}, {"axis": [0, 0, 1], "deg": 90}]
    )
    np.testing.assert_allclose(pose @ [0, 1, 0, 1], [0, 0, 1, 1], atol=1e-12)


@given(st.tuples(components, components, components))
def test_look_at_turns_z_to_the_target(target: tuple[float, float, float]) -> None:
    pose = placed(translate=[0.5, 0.5, 11.0], look_at=list(target))
    towards = np.array(target) - [0.5, 0.5, 11.0]
    np.testing.assert_allclose(
        pose[:3, 2], towards / np.linalg.norm(towards), atol=1e-9
    )
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)


def test_look_at_straight_down() -> None:
    np.testing.assert_allclose(
        placed(translate=[0, 0, 2], look_at=[0, 0, 0])[:3, 2], [0, 0, -1], atol=1e-12
    )


def test_an_array_is_centred_with_its_step() -> None:
    poses = copies({"count": [3, 2, 1], "step": [1.0, 0.5, 9.0]})
    places = np.array([pose[:3, 3] for pose in poses])
    np.testing.assert_allclose(places.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.unique(places[:, 0]), [-1, 0, 1])
    np.testing.assert_allclose(np.unique(places[:, 1]), [-0.25, 0.25])


def test_jitter_stays_in_its_bounds_and_follows_its_seed() -> None:
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


def test_the_default_pose_of_a_scene_may_be_moved() -> None:
    scene = Scene("s", (), {}, np.eye(4), (1.0, 2.0))
    assert scene.at(placed(translate=[1, 2, 3])).world_from_left[2, 3] == 3


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            "extents = 1\ntranslate = [1e30, 0, 0]",
            r"translate\[0\]: must be <= 1e\+09, got 1e\+30",
        ),
        ("extents = 1\nscale = 1e30", r"scale: must be <= 1e\+09"),
        (
            "extents = 1\nscale = 1e308\neuler_deg = [0, 0, 30]",
            r"scale: must be <= 1e\+09",
        ),
        (
            "extents = 1\nmatrix = [[1, 0, 0, -2e9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]",
            r"matrix\[0\]\[3\]:",
        ),
        ("extents = 1e15", r"extents: must be <= 1e\+09, got 1000000000000000"),
        ("extents = [1, 1e15, 1]", r"extents\[1\]: must be <= 1e\+09"),
    ],
)
def test_lengths_of_astronomic_size_are_errors(
    read_scene: Read, keys: str, message: str
) -> None:
    with pytest.raises(InputError, match=rf"objects\.b\.{message}"):
        read_scene(f"[objects.b]\nshape = 'box'\nmaterial = 'grey'\n{keys}\n")
