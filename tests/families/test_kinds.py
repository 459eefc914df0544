"""Bodies are watertight, of extent 1, with outward faces and normals."""

import numpy as np
import pytest
import trimesh

from twinlens.families.kinds import KINDS
from twinlens.scenes.stable_poses import centre_of_mass

RNG_SEEDS = (0, 1, 2)


def merged(mesh):
    """As a trimesh, with vertices at equal positions merged."""
    made = trimesh.Trimesh(np.round(mesh.vertices, 9), mesh.faces, process=False)
    made.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=7)
    made.update_faces(made.nondegenerate_faces())
    return made


@pytest.mark.parametrize("name", KINDS)
def test_every_body_is_watertight_with_outward_normals(name):
    for seed in RNG_SEEDS:
        mesh = KINDS[name].make(np.random.default_rng(seed)).mesh
        solid = merged(mesh)
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert solid.volume > 0
        assert solid.body_count == 1
        assert np.ptp(mesh.vertices, axis=0).max() == pytest.approx(1.0)
        np.testing.assert_allclose(centre_of_mass(mesh), solid.center_mass, atol=1e-5)
        a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
        facing = np.einsum(
            "nc,nc->n", np.cross(b - a, c - a), mesh.normals[mesh.faces].mean(axis=1)
        )
        assert (facing >= -1e-12).all()
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("name", KINDS)
def test_bodies_have_fewer_than_8000_faces(name):
    faces = [
        len(KINDS[name].make(np.random.default_rng(seed)).mesh.faces)
        for seed in RNG_SEEDS
    ]
    assert max(faces) < 8000
