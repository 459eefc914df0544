"""Normals and poses of glTF parts: vertex colours do not change the shading, and flattened nodes stay visible."""

import numpy as np
import pytest
import trimesh

from tests.scenes.gltf_files import square, write
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.gltf_materials import VERTEX_COLOR
from twinlens.scenes.model_files import read_model
from twinlens.scenes.shapes import face_cross


def read(path, crease_deg=None):
    return read_model(path, SceneContext(path.parent), crease_deg).mesh


def shading_deg(mesh):
    """The angle between the normal of each corner and that of its face, (F, 3)."""
    if mesh.normals is None:
        return np.zeros(mesh.faces.shape)
    normals = face_cross(mesh.vertices, mesh.faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosines = np.einsum("fci,fi->fc", mesh.normals[mesh.faces], normals)
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def colored(mesh):
    """Vertex colours that follow the position, so that each copy of a vertex has to keep its own."""
    share = (mesh.vertices - mesh.bounds[0]) / np.ptp(mesh.bounds, axis=0)
    rgba = np.pad(255 * share, ((0, 0), (0, 1)), constant_values=255)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=rgba.astype(np.uint8))
    return mesh


@pytest.mark.parametrize("crease_deg", [None, 0.0, 30.0])
def test_colors_of_vertices_do_not_round_the_edges_of_a_box(tmp_path, crease_deg):
    mesh = read(write(tmp_path / "m.glb", colored(trimesh.creation.box())), crease_deg)
    assert shading_deg(mesh).max() < 1e-4
    tints = mesh.attributes[VERTEX_COLOR.attribute]
    # The file has 8-bit colours; positions are those of the box of 1 m around the origin.
    np.testing.assert_allclose(tints[:, :3], mesh.vertices + 0.5, atol=1 / 255)


def test_a_round_side_with_colors_stays_smooth(tmp_path):
    """A ball of 20 degree facets has no edge over 30 degrees: its normals point away from its middle."""
    ball = colored(trimesh.creation.icosphere(subdivisions=2))
    mesh = read(write(tmp_path / "m.glb", ball))
    assert mesh.normals is not None
    np.testing.assert_allclose(mesh.normals, mesh.vertices, atol=0.02)


def flat_node(scale):
    """A square in z = 0 beside a box whose node has a scale."""
    scene = trimesh.Scene()
    scene.add_geometry(square())
    pose = np.diag([*scale, 1.0])
    pose[:3, 3] = [5.0, 0.0, 0.0]
    scene.add_geometry(trimesh.creation.box((1, 2, 3)), transform=pose)
    return scene


@pytest.mark.parametrize(
    ("scale", "area"),
    # A box with a side of zero is its face seen from both sides; without two sides nothing is left.
    [((1, 1, 0), 2 * 2.0), ((0, 1, 1), 2 * 6.0), ((2, 0, 1), 2 * 6.0), ((1, 0, 0), 0.0), ((0, 0, 0), 0.0)],
)  # fmt: skip
def test_a_node_that_is_flattened_keeps_its_faces(tmp_path, scale, area):
    mesh = read(write(tmp_path / "m.glb", flat_node(scale)))
    cross = face_cross(mesh.vertices, mesh.faces)
    assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(1.0 + area)
    assert shading_deg(mesh).max() < 1e-4
