"""The plain data of a scene checks itself, whoever makes it."""

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.scenes import Mesh, Scene, SceneObject
from twinlens.scenes.materials import lambert
from twinlens.scenes.placement import rotation, translation

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
FACE = np.array([[0, 1, 2]], dtype=np.uint32)


def test_a_mesh_holds_float64_and_uint32():
    mesh = Mesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 1, 2]],
        uv=CORNERS[:, :2].astype(np.float32),
    )  # type: ignore[arg-type]
    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.uint32
    assert mesh.uv.dtype == np.float64
    assert Mesh(CORNERS, np.zeros((0, 3), np.int64)).faces.shape == (0, 3)


BROKEN = [
    (
        {"vertices": CORNERS[:, :2]},
        r"vertices must have the shape \(3, 3\), got \(3, 2\)",
    ),
    ({"vertices": CORNERS.ravel()}, "vertices must have the shape"),
    ({"vertices": [[0, 0, 0], [1, 0]]}, "vertices must be numbers"),
    ({"vertices": [["a", "b", "c"]]}, "vertices must be numbers"),
    (
        {"vertices": [[0, 0, 0], [1, np.nan, 0], [0, 1, 0]]},
        "vertices must be finite; row 1 is not",
    ),
    ({"faces": FACE.astype(np.float64)}, "faces must be integers"),
    ({"faces": FACE[0]}, "faces must be integers"),
    ({"faces": [[0, 1, 2, 2]]}, "faces must be integers"),
    ({"faces": [[0, 1, 3]]}, "faces must have vertex numbers 0 to 2, got 0 to 3"),
    ({"faces": [[0, 1, -1]]}, "faces must have vertex numbers 0 to 2, got -1 to 1"),
    ({"normals": CORNERS[:2]}, r"normals must have the shape \(3, 3\), got \(2, 3\)"),
    ({"normals": CORNERS + np.inf}, "normals must be finite"),
    ({"uv": CORNERS}, r"uv must have the shape \(3, 2\), got \(3, 3\)"),
    ({"uv": CORNERS[:1, :2]}, r"uv must have the shape \(3, 2\), got \(1, 2\)"),
]


def test_an_invalid_mesh_is_an_error():
    for change, message in BROKEN:
        with pytest.raises(InputError, match=message):
            Mesh(**({"vertices": CORNERS, "faces": FACE} | change))


def two_balls():
    balls = [SceneObject(name, {"type": "sphere"}, "paint") for name in ("one", "two")]
    paint = {"paint": lambert(0.5)}
    return Scene("balls", tuple(balls), paint, np.eye(4), (1.0, 2.0))


def test_other_poses_change_nothing_else():
    scene = two_balls()
    pose = translation([1, 2, 3]) @ rotation([0, 0, 1], 30)
    moved = scene.with_poses({"two": pose})
    assert moved.objects[0] is scene.objects[0]
    assert moved.objects[1].shape is scene.objects[1].shape
    assert moved.materials is scene.materials
    np.testing.assert_array_equal(moved.objects[1].world_from_object, pose)
    np.testing.assert_array_equal(scene.objects[1].world_from_object, np.eye(4))
    assert scene.with_poses({}).objects == scene.objects


WRONG_POSES = [
    ("three", np.eye(4), "unknown object 'three'"),
    ("one", np.eye(3), r"the pose of 'one' must be finite \(4, 4\)"),
    ("one", np.diag([1, 1, np.nan, 1]), "must be finite"),
    ("one", np.diag([1, 1, 1, 2]), "last row 0 0 0 1"),
    ("one", np.diag([1, 1, 0, 1]), "must be invertible"),
    ("one", np.diag([1, 1, 2, 1]), "a sphere needs a uniform scale"),
]


def test_wrong_poses_are_refused():
    for name, pose, message in WRONG_POSES:
        with pytest.raises(InputError, match=message):
            two_balls().with_poses({name: pose})
