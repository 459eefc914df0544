"""Level faces and prisms of `twinlens.scenes.resting` against densely sampled points."""

import numpy as np
import pytest
import trimesh

from twinlens.scenes.resting import Placed, level_faces, world_triangles
from twinlens.scenes.scene import Mesh, SceneObject
from twinlens.scenes.stable_poses import outline, stable_poses

_L = np.array(
    [
        [(0, 0), (2, 0), (2, 1)],
        [(0, 0), (2, 1), (0, 1)],
        [(0, 1), (1, 1), (1, 2)],
        [(0, 1), (1, 2), (0, 2)],
    ]
)


def test_a_face_holds_what_is_inside_its_outline():
    """An L of two rectangles, whose edges meet in a T."""
    rng = np.random.default_rng(1)
    face = level_faces(np.concatenate([_L, np.full((4, 3, 1), 0.5)], axis=2))[0]
    assert face.height == 0.5
    held = 0
    for _ in range(300):
        polygon = outline(rng.uniform(0, 2, 2) + rng.normal(0, 0.2, (6, 2)))
        t = rng.dirichlet(np.ones(len(polygon)), 400)
        x, y = np.concatenate([t @ polygon, polygon]).T
        inside = (x >= 0) & (y >= 0) & (y <= 2) & (x <= np.where(y <= 1, 2, 1))
        if face.holds(polygon):
            held += 1
            assert inside.all()
    assert held > 20


def test_level_faces_are_those_that_face_up():
    box = trimesh.creation.box([1.0, 1.0, 0.2])
    faces = level_faces(box.vertices[box.faces])
    assert [round(face.height, 9) for face in faces] == [0.1]
    assert level_faces(trimesh.creation.icosahedron().triangles) == []


def test_a_prism_that_meets_a_triangle_is_found():
    """No point of a triangle that the check calls clear is inside the prism."""
    rng = np.random.default_rng(2)
    can = trimesh.creation.cylinder(0.5, 1.0, sections=12)
    rest = stable_poses(Mesh(can.vertices, can.faces))[0]
    trial = Placed(rest, np.eye(3), np.zeros(3))
    triangles = rng.normal([0, 0, 0.5], 1.0, (600, 3, 3))
    met = np.array([trial.meets(one[None]) for one in triangles])
    points = rng.dirichlet(np.ones(3), 300) @ triangles
    polygon = trial.moved(rest.footprint)
    edge = np.roll(polygon, -1, axis=0) - polygon
    side = edge[:, 0] * (points[..., None, 1] - polygon[:, 1]) - edge[:, 1] * (
        points[..., None, 0] - polygon[:, 0]
    )
    inside = (
        (side > 0).all(axis=-1) & (points[..., 2] > 0) & (points[..., 2] < rest.height)
    )
    assert not (inside.any(axis=1) & ~met).any()
    assert (~met).mean() > 0.05
    assert (
        met[~inside.any(axis=1)].mean() < 0.3
    )  # few of those that are clear are refused


@pytest.mark.parametrize("shape", [
    {"type": "sphere", "radius": 0.4, "center": [0.1, 0, 0]}, {"type": "cylinder", "radius": 0.2, "p1": [0, 1, 1]},
])  # fmt: skip
def test_triangles_of_round_shapes_enclose_them(shape):
    """Their planes are outside of the sphere, or of the circle around the axis, and close to it."""
    triangles = world_triangles(SceneObject("round", shape, "grey"))[0]
    normal = np.cross(
        triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    )
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distance = np.abs(
        ((triangles[:, 0] - np.array(shape.get("center", [0.0] * 3))) * normal).sum(
            axis=1
        )
    )
    assert (distance >= shape["radius"]).all()
    assert (distance <= 1.002 * shape["radius"]).all()
