"""Stable poses against closed forms and trimesh; distances of outlines against densely sampled points."""

import math

import numpy as np
import pytest
import trimesh

from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh
from twinlens.scenes.stable_poses import (
    gap,
    inside_by,
    outline,
    stable_poses,
)


def mesh_of(solid):
    return Mesh(np.array(solid.vertices), np.array(solid.faces))


def test_box_has_six_stable_poses():
    extents = np.array([1.0, 0.6, 0.3])
    poses = stable_poses(mesh_of(trimesh.creation.box(extents)))
    heights = np.round([rest.height for rest in poses], 6)
    assert sorted(heights) == [0.3, 0.3, 0.6, 0.6, 1.0, 1.0]
    assert heights[0] == 0.3  # the largest face is the most probable
    for rest in poses:
        np.testing.assert_allclose(rest.turn @ rest.turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rest.turn) == pytest.approx(1.0)
        assert rest.points[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        assert rest.top is not None


@pytest.mark.parametrize(("lean", "stays"), [(0.25, True), (0.35, False)])
def test_a_sheared_box_topples_once_its_centre_of_mass_passes_its_edge(lean, stays):
    """The top of a box 0.3 wide and 1 high is moved by `lean`, its centre of mass above the base by half of it."""
    box = mesh_of(trimesh.creation.box([0.3, 0.3, 1.0]))
    box.vertices[:, 0] += lean * box.vertices[:, 2]
    uprightness = [abs(rest.turn[2, 2]) for rest in stable_poses(box)]
    assert (max(uprightness) > 1 - 1e-9) == stays


def test_a_bowl_has_no_level_top():
    corners = [(0.2, 0), (0.5, 0.4), (0.45, 0.4)]
    profile = np.array(
        [(0, 0), *np.repeat(corners, 2, axis=0), (0.15, 0.05), (0, 0.05)]
    )
    poses = stable_poses(shapes.lathe(profile, 32, smooth=False))
    upright = [rest for rest in poses if rest.turn[2, 2] > 0.999]
    assert upright
    assert all(rest.top is None for rest in upright)


def uprightness(poses):
    """|cosine| of the tilt of the body's z axis (N,), and the probabilities (N,)."""
    tilt = np.array([abs(pose.up[2]) for pose in poses])
    return tilt, np.array([pose.probability for pose in poses])


def lying(poses):
    """The probability that the z axis is level within 3 degrees."""
    tilt, probability = uprightness(poses)
    return probability[tilt < 0.05].sum()


def rests_on_its_support(poses):
    return all(inside_by(pose.support, pose.centre[:2]) > -1e-9 for pose in poses)


def cylinder(radius, height, sides):
    return trimesh.creation.cylinder(radius, height, sections=sides)


def cap_angle(radius, height):
    """The share of all directions, from a point on the axis of a disc, `height` away from it, that meet the disc."""
    return (1 - height / math.hypot(radius, height)) / 2


PEN = 0.004 / 0.14
CANS = [(PEN, PEN), (0.283, 0.283), (0.5, 0.5), (2.0, 2.0)]
CONES = [(0.3, 0.0), (1.0, 0.0), (2.5, 0.0)]
CUPS = [(0.3, 0.4), (0.2, 0.7), (0.5, 0.45)]
# Few sides are farther from the solid of revolution.
OF_24_SIDES = [(solid, 24, 0.003) for solid in CANS]
OF_24_SIDES += [(solid, 24, 0.02) for solid in CONES]
OF_24_SIDES += [(solid, 24, 0.01) for solid in CUPS]
OF_MANY_SIDES = [
    (solid, sides, 0.002 if solid in CUPS else 0.003)
    for solid in CANS + CONES + CUPS
    for sides in (64, 360)
]


@pytest.mark.parametrize(("radii", "sides", "tolerance"), OF_24_SIDES + OF_MANY_SIDES)
def test_a_frustum_stands_on_its_ends_or_lies_on_its_wall(radii, sides, tolerance):
    """Solids of height 1 with two radii: the chance does not depend on the number of sides."""
    low, high = radii
    profile = [(0, 0), (low, 0), (high, 1), (0, 1)]
    solid = trimesh.creation.revolve(profile[: 4 if high else 3], sections=sides)
    poses = stable_poses(mesh_of(solid))
    # The centre of mass of a solid frustum.
    moment = low**2 + 2 * low * high + 3 * high**2
    centre = moment / (4 * (low**2 + low * high + high**2))
    up = np.array([pose.up[2] for pose in poses])
    probability = np.array([pose.probability for pose in poses])
    upright = probability[up > 0.999].sum()
    upside_down = probability[up < -0.999].sum()
    assert upright == pytest.approx(cap_angle(low, centre), abs=tolerance)
    assert upside_down == pytest.approx(cap_angle(high, 1 - centre), abs=tolerance)
    is_wall = abs(up) <= 0.999
    assert is_wall.sum() == sides
    lean = math.atan2(high - low, 1)
    np.testing.assert_allclose(up[is_wall], math.sin(lean), atol=0.01)
    np.testing.assert_allclose(
        probability[is_wall], probability[is_wall].mean(), rtol=1e-6
    )
    assert rests_on_its_support(poses)


def test_the_mesh_of_a_can_has_no_effect():
    """Rings of quads, caps of another pattern, vertices of single precision, any orientation and place."""
    profile = np.array([(0, -0.5), (0.1, -0.5), (0.283, -0.5), (0.283, -0.3)])
    profile = np.concatenate([profile, [(0.283, 0.1), (0.283, 0.5), (0, 0.5)]])
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.7, 0.4]))
    for sides in (64, 90):
        can = trimesh.creation.revolve(profile, sections=sides)
        can.apply_transform(turn)
        can.vertices = np.float32(can.vertices + np.array([0.3, -0.2, 0.5]))
        poses = stable_poses(mesh_of(can))
        axis = turn[:3, 2]
        on_end = sum(p.probability for p in poses if abs(p.up @ axis) > 0.999)
        assert on_end == pytest.approx(2 * cap_angle(0.283, 0.5), abs=0.003)
        assert sum(pose.probability for pose in poses) == pytest.approx(1)
        assert rests_on_its_support(poses)


@pytest.mark.parametrize("subdivisions", [3, 4])
def test_ellipsoids_rest_on_their_shortest_axis(subdivisions):
    """Two poles of an oblate one, the belt of a prolate one: they roll off their long axis, whatever its facet."""
    ball = trimesh.creation.icosphere(subdivisions)
    oblate = stable_poses(Mesh(ball.vertices * [0.5, 0.5, 0.25], np.array(ball.faces)))
    for sign in (1, -1):
        on_pole = [pose for pose in oblate if sign * pose.up[2] > 0.98]
        share = sum(pose.probability for pose in on_pole)
        assert share == pytest.approx(0.5, abs=0.01)
    prolate = stable_poses(Mesh(ball.vertices * [0.3, 0.3, 0.5], np.array(ball.faces)))
    belt = sum(pose.probability for pose in prolate if abs(pose.up[2]) < 0.1)
    assert belt == pytest.approx(1)


@pytest.mark.parametrize(("corners", "radius"), [(6, 0.004), (6, 0.05), (3, 0.01)])
def test_the_faces_of_a_pencil_stay_faces(corners, radius):
    """Solid angle of a regular polygon: 2 pi - 2 n atan(tan(pi / n) / sqrt(1 + (radius / distance)^2))."""
    poses = stable_poses(mesh_of(cylinder(radius, 0.18, corners)))
    slope = math.sqrt(1 + (radius / 0.09) ** 2)
    angle = 2 * math.pi
    angle -= 2 * corners * math.atan(math.tan(math.pi / corners) / slope)
    end = angle / (4 * math.pi)
    faces = sorted(pose.probability for pose in poses if abs(pose.up[2]) < 0.01)
    np.testing.assert_allclose(faces, [(1 - 2 * end) / corners] * corners, rtol=1e-9)
    apex = radius * math.cos(math.pi / corners)
    lowest = [pose.centre[2] for pose in poses if abs(pose.up[2]) < 0.01]
    np.testing.assert_allclose(lowest, apex, rtol=1e-6)


def test_a_needle_lies_and_a_sheet_does_not_stand_on_its_rim():
    """Both are thinner than the margin of balance: 0.1 % of their length."""
    needle = stable_poses(mesh_of(trimesh.creation.box([0.001, 0.001, 1.0])))
    assert len(needle) == 4
    assert lying(needle) == pytest.approx(1)
    sheet = stable_poses(mesh_of(trimesh.creation.box([1.0, 0.8, 0.001])))
    assert [pose.probability for pose in sheet] == pytest.approx([0.5, 0.5], abs=0.002)
    coin = stable_poses(mesh_of(cylinder(0.5, 0.001, 90)))
    assert [pose.probability for pose in coin] == pytest.approx([0.5, 0.5], abs=0.002)


def rounded_box(extents, radius, subdivisions):
    ball = trimesh.creation.icosphere(subdivisions, radius).vertices
    corners = trimesh.creation.box(np.array(extents) - 2 * radius).vertices
    return trimesh.convex.convex_hull((corners[:, None] + ball).reshape(-1, 3))


def smooth_box_shares(extents, radius, count=100_000):
    """The limit of a rounded box's mesh: the shares of random directions that descend to the faces along x, y and z.

    From the ball at a corner, the normal moves along a great circle away from the corner's direction, up to the
    cylinder at an edge. There it moves to the side of that direction that it is on.
    """
    corner = np.array(extents) / 2 - radius
    rays = np.abs(np.random.default_rng(0).normal(size=(count, 3)))
    # Bisection of each ray for the surface, at the distance `radius` from the inner box.
    rays *= max(extents) / np.linalg.norm(rays, axis=1, keepdims=True)
    low, high = np.zeros((2, count, 1))
    high += 1
    for _ in range(50):
        middle = (low + high) / 2
        outer = np.maximum(middle * rays - corner, 0)
        is_inside = np.linalg.norm(outer, axis=1, keepdims=True) < radius
        low, high = np.where(is_inside, middle, low), np.where(is_inside, high, middle)
    normal = np.maximum(low * rays - corner, 0) / radius
    # On the great circle, all components fall by the corner's direction until the first is 0.
    on_ball = (normal > 0).all(axis=1)
    fall = (normal[on_ball] / corner).min(axis=1, keepdims=True)
    normal[on_ball] -= fall * corner
    face = (normal / corner).argmax(axis=1)
    return np.bincount(face, minlength=3) / count


@pytest.mark.parametrize(
    ("extents", "radius"),
    [([1.0, 0.7, 0.4], 0.1), ([1.0, 0.7, 0.4], 0.15), ([1.0, 0.8, 0.6], 0.25)],
)
def test_a_rounded_box_rests_as_the_smooth_one(extents, radius):
    expected = smooth_box_shares(extents, radius)
    for subdivisions, tolerance in ((3, 0.03), (4, 0.01)):
        poses = stable_poses(mesh_of(rounded_box(extents, radius, subdivisions)))
        assert len(poses) == 6
        assert rests_on_its_support(poses)
        axis = [int(np.abs(pose.up).argmax()) for pose in poses]
        shares = np.bincount(axis, [pose.probability for pose in poses])
        np.testing.assert_allclose(shares, expected, atol=tolerance)


@pytest.mark.parametrize("subdivisions", [3, 5])
@pytest.mark.parametrize(("solid", "depth"), [(True, 3 / 8), (False, 1 / 2)])
def test_half_a_ball_and_a_bowl_rest_on_their_rim_or_their_dome(
    solid, depth, subdivisions
):
    """Their centre of mass is 3/8 or 1/2 of the radius below the rim."""
    ball = trimesh.creation.icosphere(subdivisions)
    down, middle = [0, 0, -1], [0, 0, 0]
    half = trimesh.intersections.slice_mesh_plane(ball, down, middle, cap=solid)
    poses = stable_poses(mesh_of(half))
    on_rim = sum(pose.probability for pose in poses if pose.up[2] < -0.999)
    on_dome = sum(pose.probability for pose in poses if pose.up[2] > 0.98)
    assert on_rim == pytest.approx(cap_angle(1, depth), abs=0.005)
    assert on_rim + on_dome == pytest.approx(1)
    assert rests_on_its_support(poses)


@pytest.mark.parametrize("sections", [(24, 12), (48, 24), (100, 50)])
def test_a_torus_lies_on_one_of_its_two_sides(sections):
    major, minor = sections
    torus = trimesh.creation.torus(0.3, 0.1, major_sections=major, minor_sections=minor)
    poses = stable_poses(mesh_of(torus))
    assert [pose.probability for pose in poses] == pytest.approx([0.5, 0.5], abs=1e-6)


@pytest.mark.parametrize("subdivisions", [1, 3, 5])
def test_a_ball_rests_in_any_orientation(subdivisions):
    """Mean and covariance of the directions are those of the uniform distribution."""
    poses = stable_poses(mesh_of(trimesh.creation.icosphere(subdivisions, 0.5)))
    up = np.array([pose.up for pose in poses])
    probability = np.array([pose.probability for pose in poses])
    assert len(poses) == 20 * 4**subdivisions
    assert probability.max() < 2 * probability.min()
    np.testing.assert_allclose(probability @ up, 0, atol=1e-9)
    np.testing.assert_allclose((up.T * probability) @ up, np.eye(3) / 3, atol=1e-3)


@pytest.mark.parametrize("sides", [48, 64, 200])
def test_a_loaded_tube_rolls_to_its_heavy_side(sides):
    """A weight at -y, of 14 % of the tube's volume: overlapping parts count twice. It rolls if that is 2 mm down."""
    tube = cylinder(0.1, 1.0, sides)
    weight = trimesh.creation.box([0.08, 0.06, 0.9])
    weight.apply_translation([0, -0.06, 0])
    poses = stable_poses(mesh_of(trimesh.util.concatenate([tube, weight])))
    on_wall = [pose for pose in poses if abs(pose.up[2]) < 0.5]
    shift = 0.06 * weight.volume / (weight.volume + tube.volume)
    expected = 1 - 2 * cap_angle(0.1, 0.5)
    assert sum(pose.probability for pose in on_wall) == pytest.approx(
        expected, abs=0.003
    )
    for pose in on_wall:
        assert shift * (1 - pose.up[1]) < 0.002


@pytest.mark.parametrize("seed", range(12))
def test_probabilities_are_those_of_trimesh(seed):
    """Of random polyhedra, whose faces are triangles that tip from one to the next."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(rng.integers(6, 60), 3)) * rng.uniform(0.3, 1, 3)
    hull = trimesh.convex.convex_hull(points)
    transforms, expected = trimesh.poses.compute_stable_poses(
        hull, sigma=0.0, n_samples=1, threshold=0.0
    )
    poses = stable_poses(mesh_of(hull))
    assert sum(pose.probability for pose in poses) == pytest.approx(1)
    ours = np.zeros(len(transforms))
    for i, transform in enumerate(transforms):
        same = [pose for pose in poses if pose.up @ transform[2, :3] > 1 - 1e-9]
        ours[i] = sum(pose.probability for pose in same)
    # A body that is nearly above an edge tips over here; its share goes to another pose.
    tipped = ours == 0
    for transform in transforms[tipped]:
        assert tips_easily(hull, transform)
    moved = expected[tipped].sum()
    assert np.abs(ours - expected).sum() == pytest.approx(2 * moved, abs=1e-6)
    assert tipped.any() == (seed in (2, 9))


def tips_easily(hull, transform):
    """Whether a turn of 5 degrees, or 0.2 % of the size, tips a hull over an edge."""
    points = trimesh.transform_points(hull.vertices, transform)
    above = trimesh.transform_points([hull.center_mass], transform)[0]
    contact = outline(points[points[:, 2] < 1e-9, :2])
    inside = inside_by(contact, above[:2])
    return inside < max(0.002, math.tan(math.radians(5)) * above[2])


def border(polygon):
    """Points on the edges of a polygon."""
    steps = np.linspace(0, 1, 20)[:, None, None]
    return (polygon + steps * (np.roll(polygon, -1, axis=0) - polygon)).reshape(-1, 2)


def test_gap_is_a_lower_bound_of_the_distance():
    rng = np.random.default_rng(5)
    apart = 0
    for _ in range(200):
        a, b = (
            outline(rng.normal(size=(9, 2)) + rng.uniform(-4, 4, 2)) for _ in range(2)
        )
        distance = np.linalg.norm(border(a)[:, None] - border(b), axis=-1).min()
        assert gap(a, b) <= distance + 1e-9
        if gap(a, b) > 0:
            apart += 1
            assert not any(inside_by(b, point) > 0 for point in border(a))
            assert not any(inside_by(a, point) > 0 for point in border(b))
    assert apart > 50


def test_inside_by_is_the_distance_to_the_nearest_edge():
    square = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
    assert inside_by(square, np.array([1.0, 0.25])) == pytest.approx(0.25)
    assert inside_by(square, np.array([3.0, 1.0])) == pytest.approx(-1.0)
    assert math.isclose(inside_by(square, np.array([2.0, 1.0])), 0.0, abs_tol=1e-12)
