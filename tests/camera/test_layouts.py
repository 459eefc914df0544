"""Positions and directions of the cameras of each layout."""

import numpy as np
import pytest

from tests.rigs import px_from_world
from twinlens import geometry
from twinlens.camera import Camera
from twinlens.camera.layouts import arc, grid, line, toed_in

CAMERA = Camera.from_fov(64, 48, 60)
POSE = geometry.look_at([1, 2, 3], [4, 5, 3.5])


def centres(rig):
    return geometry.transform_points(
        geometry.inverse(POSE), [pose[:3, 3] for pose in rig.world_from_cams]
    )


def test_any_two_cameras_of_a_line_are_a_rectified_pair():
    rig = line(CAMERA, 4, 0.1, POSE)
    assert all(
        rig.is_rectified(i, j) == (i < j) for i in range(4) for j in range(4) if i != j
    )
    assert np.allclose(centres(rig), [[0.1 * i, 0, 0] for i in range(4)])


def test_a_grid_is_ordered_row_by_row():
    rig = grid(CAMERA, 2, 3, 0.1, 0.2, POSE)
    assert np.allclose(
        centres(rig), [[0.1 * j, 0.2 * i, 0] for i in range(2) for j in range(3)]
    )
    assert rig.is_rectified(3, 5)
    assert not rig.is_rectified(0, 3)


def test_an_arc_looks_at_its_centre():
    rig = arc(CAMERA, 5, 2.0, 80, POSE)
    target = geometry.transform_points(POSE, [0, 0, 2.0])
    for i in range(5):
        assert np.allclose(
            geometry.dehomogeneous(px_from_world(rig, i) @ [*target, 1]),
            [CAMERA.cx, CAMERA.cy],
        )
    away = np.array([pose[:3, 3] for pose in rig.world_from_cams]) - target
    assert np.allclose(np.linalg.norm(away, axis=1), 2)
    assert np.degrees(np.arccos(away[0] @ away[-1] / 4)) == pytest.approx(80)
    assert (np.diff(centres(rig)[:, 0]) > 0).all()
    assert np.allclose(rig.world_from_cams[2], POSE)


def test_a_full_circle_closes_with_equal_steps():
    rig = arc(CAMERA, 6, 1.0, 360)
    assert [rig.baseline(i, (i + 1) % 6) for i in range(6)] == pytest.approx([1.0] * 6)


def test_toed_in_axes_intersect_at_the_distance():
    rig = toed_in(CAMERA, 0.3, 2.0, POSE)
    assert rig.baseline() == pytest.approx(0.3)
    assert centres(rig)[0, 0] < 0
    target = [*geometry.transform_points(POSE, [0, 0, 2.0]), 1]
    for i in (0, 1):
        assert np.allclose(
            geometry.dehomogeneous(px_from_world(rig, i) @ target),
            [CAMERA.cx, CAMERA.cy],
        )


def test_a_layout_takes_one_camera_per_place():
    other = CAMERA.replace(fx=100.0)
    assert toed_in([CAMERA, other], 0.1, 1.0).cameras == (CAMERA, other)
