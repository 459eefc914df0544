"""Polygons of mesh files cover the area that their outline has. Shapely knows the right areas and outlines."""

import contextlib

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from twinlens.errors import InputError
from twinlens.scenes.assets import read_mesh
from twinlens.scenes.polygons import concave_triangles
from twinlens.scenes.shapes import face_cross

C_PLATE = [
    *[(-1.5, -1.5), (1.5, -1.5), (1.5, -0.5), (-0.5, -0.5)],
    *[(-0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (-1.5, 1.5)],
]
# A square with a square hole, joined to the outline by two coincident edges.
FRAME = [(0, 0), (3, 0), (3, 3), (0, 3), (0, 0), (1, 1), (1, 2), (2, 2), (2, 1), (1, 1)]
OUTLINES = {
    "plate": (C_PLATE, 7.0),
    "frame": (FRAME, 8.0),
    "dart from a hidden corner": ([(-1, -1), (1, 0), (-1, 1), (-0.2, 0)], 1.2),
    "notch that is nearly flat": ([(0, 0), (1, 0), (2, 0), (2, 1), (1, 1 - 1e-6), (0, 1)], 2.0 - 1e-6),
    "repeated vertex": ([(0, 0), (4, 0), (4, 0), (4, 4), (2, 1), (0, 4)], 10.0),
    "convex": ([(0, 0), (2, 0), (3, 1), (2, 2), (0, 2)], 5.0),
}  # fmt: skip


def random_outline(rng):
    """The outline of a random simple polygon: boxes that overlap, or points around a centre."""
    if rng.random() < 0.5:
        corners = rng.uniform(0, 3, (6, 2))
        boxes = [shapely.box(x, y, x + 1.5, y + 0.7) for x, y in corners]
        parts = shapely.get_parts(shapely.union_all(boxes))
        largest = max(parts, key=lambda part: part.area)
        outline = np.array(largest.exterior.coords)[:-1]
        return outline if largest.exterior.is_ccw else outline[::-1]
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    radii = rng.uniform(0.2, 2.0, 12)
    outline = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
    return outline if shapely.LinearRing(outline).is_ccw else outline[::-1]


def test_triangles_of_random_polygons_cover_their_outlines():
    rng = np.random.default_rng(7)
    concave = 0
    for _ in range(200):
        outline = random_outline(rng)
        polygon = shapely.Polygon(outline)
        pose = Rotation.random(random_state=rng).as_matrix()
        points = np.pad(outline, ((0, 0), (0, 1))) @ pose.T + rng.uniform(-5, 5, 3)
        triangles = concave_triangles(points)
        if triangles is None:
            assert polygon.convex_hull.area == pytest.approx(polygon.area, rel=1e-9)
            continue
        concave += 1
        made = [shapely.Polygon(outline[corners]) for corners in triangles]
        assert sum(part.area for part in made) == pytest.approx(polygon.area, rel=1e-9)
        covered = shapely.union_all(made, grid_size=1e-9)
        assert covered.symmetric_difference(polygon).area < 1e-6
        # All triangles face as the polygon does.
        assert (face_cross(points, triangles) @ pose[:, 2] > -1e-12).all()
    assert concave > 150


def as_obj(outline):
    vertices = [f"v {x!r} {y!r} 0.5" for x, y in outline]
    corners = " ".join(f"{i + 1}//1" for i in range(len(outline)))
    return "\n".join([*vertices, "vn 0 0 1", f"f {corners}", ""])


def as_ply(outline, order):
    """A PLY file with a triangle before the polygon, a colour of vertices, and a number for each face."""
    form = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = f"""ply
format {form} 1.0
comment made by a test
element vertex {len(outline) + 3}
property double x
property double y
property float z
property uchar red
element material 1
property list uchar float roughness
element face 2
property int part
property list uchar uint vertex_indices
end_header
"""
    points = [(9.0, 9.0), (10.0, 9.0), (9.0, 10.0), *outline]
    polygon = [i + 3 for i in range(len(outline))]
    if not order:
        vertices = "".join(f"{x!r} {y!r} 0.5 7\n" for x, y in points)
        faces = " ".join(map(str, [len(polygon), *polygon]))
        return f"{header}{vertices}2 0.1 0.2\n5 3 0 1 2\n6 {faces}\n".encode()
    rows = [(x, y, 0.5, 7) for x, y in points]
    columns = [("x", f"{order}f8"), ("y", f"{order}f8"), ("z", f"{order}f4"), ("red", "u1")]  # fmt: skip
    body = np.array(rows, dtype=columns).tobytes()
    body += b"\x02" + np.array([0.1, 0.2], f"{order}f4").tobytes()
    for part, face in ((5, [0, 1, 2]), (6, polygon)):
        body += np.array([part], f"{order}i4").tobytes() + bytes([len(face)])
        body += np.array(face, f"{order}u4").tobytes()
    return header.encode() + body


def area(path):
    mesh = read_mesh(path, crease_deg=0.0)
    cross = face_cross(mesh.vertices, mesh.faces)
    assert (cross[:, 2] >= 0).all()
    return float(np.linalg.norm(cross, axis=1).sum() / 2)


@pytest.mark.filterwarnings("ignore:.*not used:twinlens.errors.NotUsedWarning")
@pytest.mark.parametrize("name", OUTLINES)
def test_a_polygon_of_a_file_covers_its_own_area_alone(tmp_path, name):
    outline, right = OUTLINES[name]
    (tmp_path / "m.obj").write_text(as_obj(outline))
    assert area(tmp_path / "m.obj") == pytest.approx(right, rel=1e-12)
    for order in ("", "<", ">"):
        (tmp_path / "m.ply").write_bytes(as_ply(outline, order))
        assert area(tmp_path / "m.ply") - 0.5 == pytest.approx(right, rel=1e-12)


def test_texture_coordinates_stay_with_their_corners(tmp_path):
    """In an OBJ file by vt, in a PLY file by a list of u, v for each corner."""
    uv = [(0.1 * x, 0.2 * y) for x, y in C_PLATE]
    corners = " ".join(f"{i + 1}/{i + 1}" for i in range(len(uv)))
    lines = [f"v {x} {y} 0" for x, y in C_PLATE] + [f"vt {u!r} {v!r}" for u, v in uv]
    (tmp_path / "m.obj").write_text("\n".join([*lines, f"f {corners}"]))
    coordinates = " ".join(f"{u!r} {v!r}" for u, v in uv)
    (tmp_path / "m.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
        + "".join(f"{x} {y} 0\n" for x, y in C_PLATE)
        + f"8 0 1 2 3 4 5 6 7 16 {coordinates}\n"
    )
    for name in ("m.obj", "m.ply"):
        mesh = read_mesh(tmp_path / name, crease_deg=0.0)
        assert mesh.uv is not None
        assert len(mesh.faces) == 6
        np.testing.assert_allclose(mesh.uv, mesh.vertices[:, :2] * [0.1, 0.2], atol=1e-7)  # fmt: skip


def test_a_quad_that_is_not_planar_is_split_from_its_first_vertex(
    tmp_path,
):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 1\nv 1 1 0\nv 0 1 1\nf 1 2 3 4\n")
    mesh = read_mesh(tmp_path / "m.obj", crease_deg=0.0)
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    np.testing.assert_allclose(sorted(middle[:, 2]), [1 / 3, 1 / 3])
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).area == pytest.approx(3**0.5)


@pytest.mark.filterwarnings("ignore:.*not used:twinlens.errors.NotUsedWarning")
@settings(max_examples=300, deadline=None)
@given(st.data())
def test_damaged_polygon_files_are_one_error_or_read(tmp_path_factory, data):
    """Each byte that is changed or missing ends in a mesh or in an error of the package, never in another exception."""
    order = data.draw(st.sampled_from(["", "<", ">", "obj"]))
    whole = as_obj(C_PLATE).encode() if order == "obj" else as_ply(C_PLATE, order)
    at = data.draw(st.integers(0, len(whole) - 1))
    byte = bytes([data.draw(st.integers(0, 255))])
    cut = data.draw(st.booleans())
    content = whole[:at] if cut else whole[:at] + byte + whole[at + 1 :]
    path = tmp_path_factory.mktemp("m") / ("m.obj" if order == "obj" else "m.ply")
    path.write_bytes(content)
    with contextlib.suppress(InputError):
        read_mesh(path)
