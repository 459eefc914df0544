"""Positions and directions of the cameras of each layout."""

import numpy as np
import pytest

from tests.rigs import px_from_world
from twinlens import geometry
from twinlens.camera import Camera
from twinlens.camera.layouts import (
    arc,
    grid,
    hemisphere,
    line,
    orbit,
    toed_in,
    trajectory,
)
from twinlens.errors import InputError

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


UP = np.array([0.0, 0.0, 1.0])
CENTRE = geometry.transform_points(POSE, [0, 0, 2.0])


def eyes(rig):
    return np.array([pose[:3, 3] for pose in rig.world_from_cams])


def elevations_deg(rig, up=UP):
    away = eyes(rig) - CENTRE
    return np.degrees(np.arcsin(away @ up / np.linalg.norm(away, axis=1)))


def assert_looks_at(rig, target):
    for i in range(len(rig)):
        pixel = geometry.dehomogeneous(px_from_world(rig, i) @ [*target, 1])
        assert np.allclose(pixel, [CAMERA.cx, CAMERA.cy])


def assert_upright(rig, up=UP):
    """The x axis is horizontal, and y points down."""
    for pose in rig.world_from_cams:
        assert abs(pose[:3, 0] @ up) < 1e-12
        assert pose[:3, 1] @ up < 0


@pytest.mark.parametrize("up", [UP, np.array([0.0, 2, 0]), np.array([0.3, -0.2, 1])])
def test_an_orbit_keeps_its_centre_and_its_elevation(up):
    rig = orbit(CAMERA, 8, 2.0, world_from_first=POSE, up=up)
    assert np.array_equal(rig.world_from_cams[0], POSE)
    assert_looks_at(rig, CENTRE)
    unit = up / np.linalg.norm(up)
    heights = (eyes(rig) - CENTRE) @ unit
    assert np.allclose(heights, heights[0])
    # A regular octagon: its sides are 2 r sin(pi / 8).
    r = np.sqrt(4 - heights[0] ** 2)
    sides = [rig.baseline(i, (i + 1) % 8) for i in range(8)]
    assert sides == pytest.approx([2 * r * np.sin(np.pi / 8)] * 8)
    # The second camera is to the right of the first one.
    assert rig.b_from_a(1, 0)[0, 3] > 0
    # Rolls are kept: the axes are those of the first camera, turned about `up`.
    assert [pose[:3, 1] @ unit for pose in rig.world_from_cams] == pytest.approx(
        [POSE[:3, 1] @ unit] * 8
    )


def test_an_orbit_of_an_angle_has_a_camera_at_both_ends():
    rig = orbit(CAMERA, 4, 2.0, 90, 30, POSE)
    assert_looks_at(rig, CENTRE)
    assert_upright(rig)
    assert elevations_deg(rig) == pytest.approx([30] * 4)
    flat = (eyes(rig) - CENTRE)[:, :2]
    turned = np.unwrap(np.arctan2(flat[:, 1], flat[:, 0]))
    assert np.degrees(turned - turned[0]) == pytest.approx([0, 30, 60, 90])
    behind = -POSE[:2, 2] / np.linalg.norm(POSE[:2, 2])
    assert flat[0] / np.linalg.norm(flat[0]) == pytest.approx(behind)


def test_a_hemisphere_has_equal_areas():
    rig = hemisphere(CAMERA, 200, 2.0, 20.0, POSE)
    assert np.linalg.norm(eyes(rig) - CENTRE, axis=1) == pytest.approx([2.0] * 200)
    assert_looks_at(rig, CENTRE)
    assert_upright(rig)
    assert elevations_deg(rig).min() > 20
    # Archimedes: the area above a height is proportional to the height that is left.
    lowest = np.sin(np.radians(20))
    for elevation in (30, 45, 60, 75):
        share = (1 - np.sin(np.radians(elevation))) / (1 - lowest)
        assert (elevations_deg(rig) > elevation).mean() == pytest.approx(
            share, abs=1 / 200
        )
    # Evenly spread: no two are closer than half the side of a square of equal area.
    away = np.linalg.norm(eyes(rig)[:, None] - eyes(rig), axis=-1)
    area = 2 * np.pi * 2.0**2 * (1 - lowest) / 200
    assert away[away > 0].min() > 0.5 * np.sqrt(area)


@pytest.mark.parametrize("height", [5.0, -5.0])
def test_a_camera_that_looks_along_the_axis_is_the_limit_of_one_that_almost_does(
    height,
):
    along = geometry.look_at([0, 0, height], [0, 0, 0], up=[0, 1, 0])
    tilted = geometry.look_at(
        [0, -1e-5 * np.sign(height), height], [0, 0, 0], up=[0, 1, 0]
    )
    for make in (
        lambda pose: orbit(CAMERA, 3, 5.0, 90, 30, pose),
        lambda pose: hemisphere(CAMERA, 3, 5.0, 20, pose),
    ):
        assert np.allclose(eyes(make(along)), eyes(make(tilted)), atol=1e-3)
    turned = orbit(CAMERA, 4, 5.0, world_from_first=along)
    assert np.allclose(eyes(turned), [[0, 0, height]] * 4)


def test_a_trajectory_passes_its_waypoints_in_equal_steps():
    waypoints = np.array([[0, 0, 0], [0.4, 0, 1], [0.2, -0.3, 1.5], [-1, 0.2, 3.0]])
    rig = trajectory(CAMERA, 301, waypoints, world_from_start=POSE)
    at = centres(rig)
    assert np.allclose(at[[0, -1]], waypoints[[0, -1]])
    steps = np.linalg.norm(np.diff(at, axis=0), axis=1)
    assert steps.max() / steps.min() < 1.01
    for waypoint in waypoints:
        assert np.linalg.norm(at - waypoint, axis=1).min() <= steps.max()
    assert all(
        np.array_equal(pose[:3, :3], POSE[:3, :3]) for pose in rig.world_from_cams
    )


def test_a_straight_trajectory_has_equal_steps_whatever_its_waypoints():
    line_of_three = [[0, 0, 0], [0.1, 0, 0.2], [1, 0, 2]]
    rig = trajectory(CAMERA, 5, line_of_three, 2.0, POSE)
    assert np.allclose(centres(rig)[:4], [[0.25 * i, 0, 0.5 * i] for i in range(4)])
    assert_looks_at(rig, CENTRE)
    # The y axis stays in the plane of the direction and of the pose's y axis.
    for pose in rig.world_from_cams:
        assert abs(pose[:3, 0] @ POSE[:3, 1]) < 1e-12


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: orbit(CAMERA, 3, 2.0, up=[0, 0, 0]), "up must be a direction"),
        (lambda: orbit(CAMERA, 3, 2.0, up=[0, np.nan, 0]), "up must be a direction"),
        (lambda: orbit(CAMERA, 3, -2.0, up=[0, 1, 0]), "radius"),
        (lambda: orbit(CAMERA, 3, 2.0, 361, up=[0, 1, 0]), "angle_deg"),
        (lambda: orbit(CAMERA, 3, 2.0, 90, 90, POSE), "elevation_deg"),
        (lambda: hemisphere(CAMERA, 3, 2.0, 90, POSE), "elevation_deg"),
        (lambda: hemisphere(CAMERA, 0, 2.0, 10, POSE), "count"),
        (lambda: trajectory(CAMERA, 3, [[0, 0, 0]]), "two points or more"),
        (lambda: trajectory(CAMERA, 3, [[0, 0], [1, 1]]), "two points or more"),
        (lambda: trajectory(CAMERA, 3, [[0, 0, 1], [0, 0, 1]]), "must differ"),
        (lambda: trajectory(CAMERA, 3, [[0, 0, 0], [0, 0, np.inf]]), "finite"),
        (lambda: trajectory(CAMERA, 3, [[0, 0, 0], [0, 0, 2]], 2.0), "to differ"),
    ],
)
def test_paths_refuse_what_has_no_meaning(make, message):
    with pytest.raises(InputError, match=message):
        make()
