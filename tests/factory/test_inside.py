import numpy as np
import pytest
import trimesh

from twinlens.factory.gates import crossings, encloses
from twinlens.scenes import Mesh, Scene, SceneObject

RNG = np.random.default_rng(4)
POINTS = RNG.uniform(-1.5, 1.5, (300, 3))


def one(shape, pose=None, instances=()):
    body = SceneObject(
        "it", shape, "grey", np.eye(4) if pose is None else pose, instances=instances
    )
    return Scene("made", (body,), {"grey": {"type": "diffuse"}}, np.eye(4), (1, 2))


def test_a_torus_encloses_what_its_equation_says():
    torus = trimesh.creation.torus(
        major_radius=1.0, minor_radius=0.4, major_sections=256, minor_sections=128
    )
    tube = np.hypot(np.hypot(POINTS[:, 0], POINTS[:, 1]) - 1.0, POINTS[:, 2])
    clear = np.abs(tube - 0.4) > 0.01  # the mesh lies a little inside
    odd = [
        crossings(torus.vertices, torus.faces.astype(np.uint32), point) % 2 == 1
        for point in POINTS
    ]
    assert np.array_equal(np.array(odd)[clear], (tube < 0.4)[clear])
    assert 20 < sum(odd) < 280


@pytest.mark.parametrize(
    ("shape", "inside"),
    [
        (
            {"type": "sphere", "center": (0.2, 0, 0), "radius": 0.8},
            lambda p: np.linalg.norm(p - (0.2, 0, 0)) < 0.8,
        ),
        ({"type": "sphere"}, lambda p: np.linalg.norm(p) < 1),
        ({"type": "cube"}, lambda p: np.abs(p).max() < 1),
        ({"type": "rectangle"}, lambda p: False),
        ({"type": "disk"}, lambda p: False),
    ],
)
def test_analytic_shapes_know_their_inside(shape, inside):
    assert [encloses(one(shape), "it", point) for point in POINTS[:60]] == [
        bool(inside(p)) for p in POINTS[:60]
    ]


def test_scaled_and_instanced_bodies_are_found_where_they_stand():
    pose = np.diag([0.5, 0.5, 2.0, 1.0])
    pose[:3, 3] = (3, 0, 0)
    moved = np.eye(4)
    moved[:3, 3] = (0, 5, 0)
    assert encloses(one({"type": "cube"}, pose), "it", np.array([3.4, 0.0, 1.9]))
    assert not encloses(one({"type": "cube"}, pose), "it", np.array([3.6, 0.0, 0.0]))
    many = one({"type": "cube"}, pose, instances=(np.eye(4), moved))
    assert encloses(many, "it[1]", np.array([3.0, 5.0, 0.0]))
    assert not encloses(many, "it[0]", np.array([3.0, 5.0, 0.0]))


def test_winding_and_turning_of_a_mesh_do_not_matter():
    ball = trimesh.creation.icosphere(subdivisions=2)
    for faces in (ball.faces, ball.faces[:, ::-1]):
        mesh = Mesh(ball.vertices, faces.astype(np.uint32))
        assert encloses(one(mesh), "it", np.array([0.3, 0.2, -0.4]))
        assert not encloses(one(mesh), "it", np.array([0.8, 0.8, 0.0]))
