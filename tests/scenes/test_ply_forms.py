"""PLY files with triangle strips, and with the line ends of other systems. Areas are those of shapely and trimesh."""

import numpy as np
import pytest
import trimesh
from shapely import Polygon

from twinlens.errors import FileError
from twinlens.scenes.assets import read_mesh
from twinlens.scenes.scene import SceneWarning

STRIP = [0, 1, 2, 3, 4, 5]
LADDER = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1.5, 0], [3, 0, 0], [3, 2, 0]])
OUTLINE = Polygon(LADDER[[0, 2, 4, 5, 3, 1], :2])
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def ply(points, lists, form, element="tristrips", name="vertex_indices", kind="int"):
    """A PLY file of vertices and lists of vertices."""
    order = FORMATS[form]
    header = ["ply", f"format {form} 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"element {element} {len(lists)}", f"property list {kind} int {name}"]
    head = "\n".join([*header, "end_header", ""]).encode()
    if not order:
        rows = [*points.tolist(), *([len(row), *row] for row in lists)]
        return head + "\n".join(" ".join(map(str, row)) for row in rows).encode()
    count = {"int": "i4", "uchar": "u1"}[kind]
    body = points.astype(f"{order}f4").tobytes()
    for row in lists:
        body += np.array(len(row), order + count).tobytes()
        body += np.array(row, f"{order}i4").tobytes()
    return head + body


def area_vector(path):
    mesh = read_mesh(path)
    corners = mesh.vertices[mesh.faces]
    edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.cross(*edges).sum(axis=0) / 2


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("name", ["vertex_indices", "vertex_index"])
def test_a_strip_covers_its_outline_and_faces_one_way(tmp_path, form, name):
    (tmp_path / "m.ply").write_bytes(ply(LADDER, [STRIP], form, name=name))
    right = [0, 0, -OUTLINE.area]  # the first triangle, 0 1 2, is clockwise
    np.testing.assert_allclose(area_vector(tmp_path / "m.ply"), right, atol=1e-6)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize(
    "lists",
    [
        [[0, 1, 2, -1, 3, 5, 4, 2, -1, 1, 0]],
        [[0, 1, 2], [5, 4, 3, 2, 1, 0]],
        [[0, 1, 2, 3, 3, 4, 4, 4, 5, 3, 1, -1]],
        [[], [-1, -1, 0, 2, 1], [4, 5]],
    ],
)
def test_strips_have_the_triangles_of_trimesh(tmp_path, form, lists):
    (tmp_path / "m.ply").write_bytes(ply(LADDER, lists, form))
    strips = []
    for numbers in lists:
        strips += " ".join(map(str, numbers)).split("-1")
    strips = [np.array(strip.split(), int) for strip in strips]
    long = [strip for strip in strips if len(strip) > 2]
    other = trimesh.Trimesh(LADDER, trimesh.util.triangle_strips_to_faces(long), process=False)  # fmt: skip
    mesh = read_mesh(tmp_path / "m.ply")
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert made.area == pytest.approx(other.area, rel=1e-6)
    corners = other.triangles
    right = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(
        area_vector(tmp_path / "m.ply"), right.sum(axis=0) / 2, atol=1e-6
    )


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("ending", [b"\r", b"\r\n"])
@pytest.mark.parametrize("element", ["face", "tristrips"])
def test_lines_may_end_as_on_other_systems(tmp_path, form, ending, element):
    """The numbers of a binary file hold the bytes of line ends: 13 is the first one after the header."""
    points = np.concatenate([LADDER, np.full((8, 3), 0.5)])
    points[0, 0] = np.frombuffer(b"\n\r\n\r", "<f4" if "little" in form else ">f4")[0]
    kind = "uchar" if element == "face" else "int"
    lists = [[0, 2, 4, 5, 3, 1]] if element == "face" else [STRIP]
    data = ply(points, lists, form, element, kind=kind)
    end = data.index(b"end_header\n") + 11
    header, body = data[:end].replace(b"\n", ending), data[end:]
    if form == "ascii":
        body = body.replace(b"\n", ending)
    (tmp_path / "m.ply").write_bytes(header + body)
    sign = 1 if element == "face" else -1
    outline = Polygon(points[[0, 2, 4, 5, 3, 1], :2])
    right = [0, 0, sign * outline.area]
    np.testing.assert_allclose(area_vector(tmp_path / "m.ply"), right, atol=1e-6)


def test_faces_go_before_strips_which_are_named(tmp_path):
    text = ply(LADDER, [[0, 2, 4, 5, 3, 1]], "ascii", "face").decode()
    strips = "element tristrips 1\nproperty list int int vertex_indices\n"
    text = text.replace("end_header", f"{strips}end_header")
    (tmp_path / "m.ply").write_text(text + "\n3 0 1 2\n")
    with pytest.warns(SceneWarning, match=r"m\.ply: not used: element 'tristrips'"):
        area = area_vector(tmp_path / "m.ply")
    np.testing.assert_allclose(area, [0, 0, OUTLINE.area], atol=1e-6)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize(
    ("lists", "message"),
    [
        ([[0, 1, 6]], "refers to a vertex outside 0 to 5"),
        ([[0, 1, -2]], "refers to a vertex outside 0 to 5"),
        ([[0, 1]], "has no triangles"),
        ([[0, 1, 1, 2, 2]], "has no triangles"),
    ],
)
def test_wrong_strips_are_named(tmp_path, form, lists, message):
    (tmp_path / "m.ply").write_bytes(ply(LADDER, lists, form))
    with pytest.raises(FileError, match=rf"m\.ply: .*{message}"):
        read_mesh(tmp_path / "m.ply")


def test_strips_that_end_early_are_named(tmp_path):
    data = ply(LADDER, [STRIP], "binary_little_endian")
    (tmp_path / "m.ply").write_bytes(data[:-4])
    with pytest.raises(FileError, match=r"m\.ply: .*ends before its last face"):
        read_mesh(tmp_path / "m.ply")
