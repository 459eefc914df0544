"""A face of an OBJ file with a wrong number is named."""

from pathlib import Path

import numpy as np
import pytest

from twinlens.errors import FileError
from twinlens.scenes.assets import SceneContext, obj_lines, read_mesh
from twinlens.scenes.model_files import read_model
from twinlens.scenes.shapes import face_cross

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"


@pytest.mark.parametrize(
    ("face", "message"),
    [
        ("f 1 2 9", "face 'f 1 2 9' refers to vertex 9; the file has 3"),
        ("f -9 2 3", "face 'f -9 2 3' refers to vertex -9; the file has 3 before"),
        ("f 1/-4 2/2 3/3", "refers to texture coordinate -4; the file has 3 before"),
        ("f 1/-0 2/2 3/3", "has the vertex number 0"),
        ("f --1 2 3", "face 'f --1 2 3' is not of vertex numbers"),
        ("f 1/1 2/2 3/7", "face 'f 1/1 2/2 3/7' refers to texture coordinate 7"),
        ("f 1 b 3", "face 'f 1 b 3' is not of vertex numbers"),
        ("f 1 2.5 3", "face 'f 1 2.5 3' is not of vertex numbers"),
    ],
)
def test_a_wrong_number_names_the_face(face, message):
    with pytest.raises(FileError, match=message):
        obj_lines(Path("a.obj"), f"{TRIANGLE}{face}\n".encode())


@pytest.mark.parametrize("face", ["f 1 2 3", "f 1/1/1 2/2/1 3/3/1", "f 1//1 2//1 3//1"])
def test_right_numbers_are_read(face):
    assert face in obj_lines(Path("a.obj"), f"{TRIANGLE}{face}\n".encode())


def with_materials(path):
    return read_model(path, SceneContext(path.parent)).mesh


SQUARE = "v {0} 0 0\nv {1} 0 0\nv {1} 1 0\nv {0} 1 0\n"
COORDINATES = "vt {0} 0\nvt {1} 0\nvt {1} 1\nvt {0} 1\n"


@pytest.mark.parametrize(
    "face", ["f -4/-4 -3/-3 -2/-2 -1/-1", "f -4/-4 -3/-3 -2/-2\nf -4/-4 -2/-2 -1/-1"]
)
@pytest.mark.parametrize("reader", [read_mesh, with_materials])
def test_each_object_may_count_from_its_own_last_vertex(tmp_path, reader, face):
    """As programs write that append objects to a file: two squares apart, of unit area, with u = x and v = y."""
    path = tmp_path / "m.obj"
    blocks = [SQUARE.format(x, x + 1) + COORDINATES.format(x, x + 1) for x in (0, 5)]
    path.write_text("".join(f"{block}{face}\n" for block in blocks))
    mesh = reader(path)
    cross = face_cross(mesh.vertices, mesh.faces)
    assert np.allclose(cross, [0, 0, 1])
    assert len(mesh.faces) == 4
    assert np.allclose(mesh.uv, mesh.vertices[:, :2])
    assert {0.0, 1.0, 5.0, 6.0} == set(mesh.vertices[mesh.faces.ravel(), 0])


@pytest.mark.parametrize("vertex", ["v 0,5 0 1", "v 0.5D0 0 1", "v 1 2", "v a b c"])
def test_a_vertex_that_is_no_position_is_named(vertex):
    with pytest.raises(FileError, match=f"the vertex '{vertex}' must be three numbers"):
        obj_lines(Path("a.obj"), f"{TRIANGLE}{vertex}\nf 1 2 3\n".encode())
