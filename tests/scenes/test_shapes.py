"""Made meshes against closed forms: volumes, areas, normals that point outwards, lengths that are kept."""

import math

import numpy as np
import pytest
import trimesh

from twinlens.geometry import rigid
from twinlens.scenes import Bitmap, shapes
from twinlens.scenes.placement import rotation

VESSEL = np.array([[0, 0], [0.5, 0], [0.5, 0], [0.5, 2], [0.5, 2], [0, 2]], dtype=float)
SIDES = np.array([1.0, 2.0, 3.0])
ANGLES = np.arange(24) * math.pi / 12
CIRCLE = np.column_stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES])
ROUND_CORNERS = (
    # the inner box, a slab on each face, a quarter cylinder on each edge, a ball in the corners
    0.6 * 1.6 * 2.6 + 0.4 * (0.6 * 1.6 + 1.6 * 2.6 + 0.6 * 2.6) + math.pi * 0.04 * (0.6 + 1.6 + 2.6)
    + 4 / 3 * math.pi * 0.008
)  # fmt: skip
RING = 2 * math.pi**2 * 0.04
CLOSED = {
    "box": (shapes.box(SIDES), 6.0),
    "rounded_box": (shapes.rounded_box(SIDES, 0.2, subdivisions=24), ROUND_CORNERS),
    "cylinder by lathe": (shapes.lathe(VESSEL, segments=512, smooth=False), math.pi * 0.25 * 2),
    "ring by tube": (shapes.tube(CIRCLE.tolist(), 0.2, sides=128, closed=True), RING),
    "icosphere": (shapes.creation("icosphere", radius=0.5, subdivisions=5), math.pi / 6),
    "capsule": (
        shapes.creation("capsule", radius=0.2, height=1.0, count=[128, 128]), math.pi * 0.04 * (1 + 4 / 3 * 0.2),
    ),
    "cone": (shapes.cone(radius=0.3, height=1.0, sections=512), math.pi * 0.09 / 3),
    "torus": (
        shapes.creation("torus", major_radius=1.0, minor_radius=0.2, major_sections=256, minor_sections=128), RING,
    ),
}  # fmt: skip
"""Bodies, and their volumes."""


def corners(mesh):
    return np.moveaxis(mesh.vertices[mesh.faces], 1, 0)


def least_agreement(mesh):
    """The least cosine between a face and the normals of its corners."""
    a, b, c = corners(mesh)
    face = np.cross(b - a, c - a)
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    return np.einsum("ij,ikj->ik", face, mesh.normals[mesh.faces]).min()


def volume(mesh):
    """By the divergence theorem: positive only where the faces turn outwards."""
    a, b, c = corners(mesh)
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


@pytest.mark.parametrize("name", CLOSED)
def test_a_closed_body_has_its_volume_and_its_faces_turn_outwards(name):
    mesh, expected = CLOSED[name]
    assert volume(mesh) == pytest.approx(expected, rel=3e-3)
    welded = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    welded.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=9)
    assert welded.is_watertight


@pytest.mark.parametrize("name", CLOSED)
def test_normals_are_unit_and_agree_with_the_faces(name):
    mesh, _ = CLOSED[name]
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-9)
    assert least_agreement(mesh) > 0.5


@pytest.mark.parametrize("name", CLOSED)
def test_no_triangle_crosses_the_texture_seam(name):
    mesh, _ = CLOSED[name]
    widths = np.ptp(mesh.uv[mesh.faces][..., 0], axis=1)
    assert widths.max() <= 1.0
    if name not in ("box", "rounded_box"):
        from_axis = np.linalg.norm(mesh.vertices[mesh.faces][..., :2], axis=2)
        touches_axis = from_axis.min(axis=1) <= 1e-6
        assert widths[~touches_axis].max(initial=0) < 0.5


def test_a_smooth_lathe_meets_its_points_and_the_normals_of_a_sphere():
    angle = np.linspace(-math.pi / 2, math.pi / 2, 13)
    ball = shapes.lathe(np.column_stack([np.cos(angle), np.sin(angle)]), segments=64)
    inner = np.abs(ball.vertices[:, 2]) < 0.9
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 1, atol=6e-3)
    np.testing.assert_allclose(ball.normals[inner], ball.vertices[inner], atol=0.03)


def test_texture_tiles_are_measured_in_metres():
    mesh = shapes.box(SIDES, tile=0.5)
    edges = np.concatenate([mesh.faces, np.roll(mesh.faces, 1, axis=1)]).reshape(2, -1)
    in_tiles, in_metres = (
        np.linalg.norm(values[edges[0]] - values[edges[1]], axis=1)
        for values in (mesh.uv, mesh.vertices)
    )
    np.testing.assert_allclose(0.5 * in_tiles, in_metres, rtol=1e-6)


def test_a_height_field_has_the_given_heights_and_slopes():
    slope = 0.3  # of z over x
    row = slope * np.linspace(-1, 1, 41, dtype=np.float32)
    mesh = shapes.height_field(np.array([2.0, 2.0]), Bitmap(np.tile(row, (41, 1))))
    heights = slope * mesh.vertices[:, 0]
    np.testing.assert_allclose(mesh.vertices[:, 2], heights, atol=1e-6)
    normal = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
    np.testing.assert_allclose(mesh.normals - normal, 0, atol=1e-5)
    top = np.zeros((3, 3), np.float32)
    top[0] = 1  # the first row is +y
    field = shapes.height_field(np.array([2.0, 2.0]), Bitmap(top))
    assert field.vertices[-1].tolist() == [1, 1, 1]


def test_bending_keeps_length():
    mesh = shapes.bent_sheet(np.array([1.0, 0.2]), 180.0, segments=256)
    row = mesh.vertices[:257]
    assert np.linalg.norm(np.diff(row, axis=0), axis=1).sum() == pytest.approx(
        1.0, rel=1e-4
    )
    assert np.ptp(row[:, 0]) == pytest.approx(2 / math.pi, rel=1e-4)


def test_moving_a_mesh_moves_its_normals_as_a_plane_moves():
    ball = shapes.creation("uv_sphere", radius=1.0)
    turn = rigid(rotation(np.array([1.0, 2, 3]), 40)[:3, :3], [1, 2, 3])
    squashed = shapes.transformed(ball, turn @ np.diag([1.0, 2.0, 0.5, 1.0]))
    assert least_agreement(squashed) > 0.9


@pytest.mark.parametrize("last", [[0, 1, 0], [2, 1, 3], [1, 1, 2]])
@pytest.mark.parametrize("axes", [[0, 1, 2], [1, 2, 0], [2, 1, 0]])
def test_a_tube_around_two_right_angles_keeps_its_radius(last, axes):
    """Rings lie across the direction between the two segments, also where that turns by a right angle at once."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], last])[:, axes]
    mesh = shapes.tube(points, 0.1, sides=16, smooth=False)
    steps = np.diff(points, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    rings = mesh.vertices.reshape(4, 17, 3)
    between = [steps[0], steps[0] + steps[1], steps[1] + steps[2], steps[2]]
    for ring, centre, direction in zip(rings, points, between, strict=True):
        spokes = ring - centre
        assert np.linalg.norm(spokes, axis=1) == pytest.approx(np.full(17, 0.1))
        assert spokes @ direction == pytest.approx(np.zeros(17), abs=1e-12)
