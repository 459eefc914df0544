"""A face of an OBJ file with a wrong number is named."""

from pathlib import Path

import pytest

from twinlens.errors import FileError
from twinlens.scenes.assets import obj_lines

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"


@pytest.mark.parametrize(
    ("face", "message"),
    [
        ("f 1 2 9", "face 'f 1 2 9' refers to vertex 9; the file has 3"),
        ("f -9 2 3", "face 'f -9 2 3' refers to vertex -9; the file has 3"),
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
