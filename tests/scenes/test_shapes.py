"""Made meshes against closed forms: volumes, areas, normals that point outwards, lengths that are kept."""

import math

import numpy as np
import pytest
import trimesh

from twinlens.geometry import rigid
from twinlens.scenes import Bitmap, Mesh, shapes
from twinlens.scenes.placement import rotation

VESSEL = np.array([[0, 0], [0.5, 0], [0.5, 0], [0.5, 2], [0.5, 2], [0, 2]], dtype=float)
CLOSED = {
    "box": (shapes.box(np.array([1.0, 2.0, 3.0])), 6.0),
    "rounded_box": (
        shapes.rounded_box(np.array([1.0, 2.0, 3.0]), 0.2, subdivisions=24),
        # the inner box, a slab on each face, a quarter cylinder on each edge, a ball in the corners
        0.6 * 1.6 * 2.6
        + 0.4 * (0.6 * 1.6 + 1.6 * 2.6 + 0.6 * 2.6)
        + math.pi * 0.04 * (0.6 + 1.6 + 2.6)
        + 4 / 3 * math.pi * 0.008,
    ),
    "cylinder by lathe": (
        shapes.lathe(VESSEL, segments=512, smooth=False),
        math.pi * 0.25 * 2,
    ),
    "ring by tube": (
        shapes.tube(
            [[math.cos(t), math.sin(t), 0] for t in np.arange(24) * math.pi / 12],
            0.2,
            sides=128,
            closed=True,
        ),
        2 * math.pi**2 * 0.04,
    ),
    "icosphere": (
        shapes.creation("icosphere", radius=0.5, subdivisions=5),
        math.pi / 6,
    ),
    "capsule": (
        shapes.creation("capsule", radius=0.2, height=1.0, count=[128, 128]),
        math.pi * 0.04 * (1 + 4 / 3 * 0.2),
    ),
    "cone": (shapes.cone(radius=0.3, height=1.0, sections=512), math.pi * 0.09 / 3),
    "torus": (
        shapes.creation(
            "torus",
            major_radius=1.0,
            minor_radius=0.2,
            major_sections=256,
            minor_sections=128,
        ),
        2 * math.pi**2 * 0.04,
    ),
}


def volume(mesh: Mesh) -> float:
    """By the divergence theorem: positive only where the faces turn outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("name", CLOSED)
def test_a_closed_body_has_its_volume_and_its_faces_turn_outwards(name: str) -> None:
    mesh, expected = CLOSED[name]
    assert volume(mesh) == pytest.approx(expected, rel=3e-3)
    welded = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    welded.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=9)
    assert welded.is_watertight


@pytest.mark.parametrize("name", CLOSED)
def test_normals_are_unit_and_agree_with_the_faces(name: str) -> None:
    mesh, _ = CLOSED[name]
    assert mesh.normals is not None
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-9)
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    corner = mesh.normals[mesh.faces]
    assert np.einsum("ij,ikj->ik", face, corner).min() > 0.5


@pytest.mark.parametrize("name", CLOSED)
def test_no_triangle_crosses_the_texture_seam(name: str) -> None:
    mesh, _ = CLOSED[name]
    assert mesh.uv is not None
    corners = mesh.uv[mesh.faces]
    assert np.ptp(corners[..., 0], axis=1).max() <= 1.0
    if name not in ("box", "rounded_box"):
        body_only = (
            np.linalg.norm(mesh.vertices[mesh.faces][..., :2], axis=2).min(axis=1)
            > 1e-6
        )
        assert np.ptp(corners[body_only][..., 0], axis=1).max(initial=0) < 0.5


def test_a_smooth_lathe_meets_its_points_and_the_normals_of_a_sphere() -> None:
    angle = np.linspace(-math.pi / 2, math.pi / 2, 13)
    ball = shapes.lathe(np.column_stack([np.cos(angle), np.sin(angle)]), segments=64)
    inner = np.abs(ball.vertices[:, 2]) < 0.9
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 1, atol=6e-3)
    np.testing.assert_allclose(ball.normals[inner], ball.vertices[inner], atol=0.03)


def test_texture_tiles_are_measured_in_metres() -> None:
    mesh = shapes.box(np.array([1.0, 2.0, 3.0]), tile=0.5)
    assert mesh.uv is not None
    for a, b, c in mesh.faces:
        for p, q in ((a, b), (b, c), (c, a)):
            on_uv = np.linalg.norm(mesh.uv[p] - mesh.uv[q]) * 0.5
            assert on_uv == pytest.approx(
                np.linalg.norm(mesh.vertices[p] - mesh.vertices[q])
            )


def test_a_height_field_has_the_given_heights_and_slopes() -> None:
    x = np.linspace(-1, 1, 41)
    heights = np.broadcast_to(0.3 * x, (41, 41)).astype(
        np.float32
    )  # rises with x, 0.3 a metre
    mesh = shapes.height_field(np.array([2.0, 2.0]), Bitmap(heights))
    np.testing.assert_allclose(
        mesh.vertices[:, 2], 0.3 * mesh.vertices[:, 0], atol=1e-6
    )
    np.testing.assert_allclose(
        mesh.normals,
        np.broadcast_to([-0.3, 0, 1] / np.sqrt(1.09), (41 * 41, 3)),
        atol=1e-5,
    )
    top_only = np.zeros((3, 3), np.float32)
    top_only[0] = 1  # the first row is +y
    assert shapes.height_field(np.array([2.0, 2.0]), Bitmap(top_only)).vertices[
        -1
    ].tolist() == [1, 1, 1]


def test_bending_keeps_length() -> None:
    mesh = shapes.bent_sheet(np.array([1.0, 0.2]), 180.0, segments=256)
    row = mesh.vertices[:257]
    assert np.linalg.norm(np.diff(row, axis=0), axis=1).sum() == pytest.approx(
        1.0, rel=1e-4
    )
    assert np.ptp(row[:, 0]) == pytest.approx(2 / math.pi, rel=1e-4)


def test_moving_a_mesh_moves_its_normals_as_a_plane_moves() -> None:
    ball = shapes.creation("uv_sphere", radius=1.0)
    squash = rigid(rotation(np.array([1.0, 2, 3]), 40)[:3, :3], [1, 2, 3]) @ np.diag(
        [1.0, 2.0, 0.5, 1.0]
    )
    moved = shapes.transformed(ball, squash)
    a, b, c = (moved.vertices[moved.faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    assert moved.normals is not None
    assert np.einsum("ij,ikj->ik", face, moved.normals[moved.faces]).min() > 0.9
