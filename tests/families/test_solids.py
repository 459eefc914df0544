"""Bodies are closed, turned outside out, of extent 1, with normals that point outwards."""

import numpy as np
import pytest
import trimesh

from twinlens.families.catalogue import KINDS
from twinlens.families.resting import centre_of_mass

RNG_SEEDS = (0, 1, 2)


def joined(mesh):
    """As trimesh sees it, equal vertices joined."""
    made = trimesh.Trimesh(np.round(mesh.vertices, 9), mesh.faces, process=False)
    made.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=7)
    made.update_faces(made.nondegenerate_faces())
    return made


@pytest.mark.parametrize("name", KINDS)
def test_every_body_is_closed_and_turned_outwards(name):
    for seed in RNG_SEEDS:
        mesh = KINDS[name].make(np.random.default_rng(seed)).mesh
        solid = joined(mesh)
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert solid.volume > 0
        assert solid.body_count == 1
        assert np.ptp(mesh.vertices, axis=0).max() == pytest.approx(1.0)
        np.testing.assert_allclose(centre_of_mass(mesh), solid.center_mass, atol=1e-5)
        a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
        facing = np.einsum("nc,nc->n", np.cross(b - a, c - a), mesh.normals[mesh.faces].mean(axis=1))
        assert (facing >= -1e-12).all()
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("name", KINDS)
def test_bodies_are_of_modest_size(name):
    faces = [len(KINDS[name].make(np.random.default_rng(seed)).mesh.faces) for seed in RNG_SEEDS]
    assert max(faces) < 8000
