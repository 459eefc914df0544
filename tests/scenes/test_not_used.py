"""What a file has and twinlens does not use is named in one line a file, with what is done instead."""

import warnings

import numpy as np
import pytest
import trimesh

from twinlens.errors import FileError, NotUsedWarning
from twinlens.scenes import load_scene
from twinlens.scenes.assets import SceneContext, read_mesh
from twinlens.scenes.model_files import MaterialWarning, read_model

CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
NORMALS = "normals (edges over 30 degrees are sharp; see crease_deg)"
PLY = """ply
format ascii 1.0
{comment}element vertex 3
property float x
property float y
property float z
{vertex}element face 1
property list uchar int vertex_indices
{face}{element}end_header
"""


def ply(values="", vertex="", face="", face_values="", element="", comment=""):
    header = PLY.format(vertex=vertex, face=face, element=element, comment=comment)
    corners = "".join(f"{x} {y} 0 {values}\n" for x, y in ((0, 0), (1, 0), (0, 1)))
    return f"{header}{corners}3 0 1 2 {face_values}\n0 1\n"


def colored_stl():
    """A binary file with a colour in the attribute of its second facet. Source: Materialise Magics."""
    data = bytearray(trimesh.creation.box().export(file_type="stl"))
    data[84 + 50 + 48 : 84 + 50 + 50] = b"\x1f\x80"
    return bytes(data)


def floats(*names):
    return "".join(f"property float {name}\n" for name in names)


LEFT_OUT = "cstype (left out), lines (left out), points (left out)"
RGB = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
EDGES = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
MESHES = {
    "plain.obj": (f"{CORNERS}vt 0 0\ng a\no b\ns off\nf 1/1 2/1 3/1\n", ""),
    "normals.obj": (f"{CORNERS}vn 0 0 1\nf 1//1 2//1 3//1\n", NORMALS),
    "smooth.obj": (f"{CORNERS}s 1\nf 1 2 3\n", NORMALS),
    "lines.obj": (f"{CORNERS}f 1 2 3\nl 1 2\np 3\ncstype bezier\n", LEFT_OUT),
    "colours.obj": ("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n", "colours of vertices (the material)"),
    "weights.obj": ("v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3\n", ""),
    "plain.ply": (ply(values="0 0", vertex=floats("s", "t")), ""),
    "normals.ply": (ply(values="0 0 1", vertex=floats("nx", "ny", "nz")), NORMALS),
    "colours.ply": (ply(values="9 8 7", vertex=RGB), "colours of vertices (the object's material)"),
    "faces.ply": (ply(face=RGB, face_values="1 2 3"), "colours of faces (the object's material)"),
    "quality.ply": (ply(values="0.5", vertex=floats("quality")), "'quality' of vertices (left out)"),
    "edges.ply": (ply(element=EDGES), "element 'edge' (left out)"),
    "picture.ply": (ply(comment="comment TextureFile a.png\n"), "its picture (the object's material)"),
    "plain.stl": (trimesh.creation.box().export(file_type="stl"), ""),
    "colours.stl": (colored_stl(), "colours of facets (the object's material)"),
}  # fmt: skip
"""The content of files, and what is named."""


@pytest.mark.parametrize("name", MESHES)
def test_meshes(tmp_path, name):
    content, named = MESHES[name]
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert len(read_mesh(path).faces)
    assert [str(warning.message) for warning in caught] == (
        [f"{path}: not used: {named}"] if named else []
    )


def test_normals_are_not_named_where_the_crease_angle_is_given(tmp_path):
    path = tmp_path / "m.obj"
    path.write_text(MESHES["normals.obj"][0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_mesh(path, crease_deg=20.0)
        read_model(path, SceneContext(tmp_path), crease_deg=20.0)


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        ("Ka 1 1 1\nillum 2\nKd .5", ""),
        ("illum 7", "illum 7"),
        ("refl -type sphere sky.png\nbump b.png", "bump, refl"),
        ("map_Ns n.png\nTf 1 1 1\ndecal d.png", "decal, map_ns, tf"),
        ("disp -mm 0 1 d.png\nPs 1\naniso .5", "aniso, disp, ps"),
    ],
)
def test_keys_of_mtl_files(tmp_path, lines, named):
    path = tmp_path / "m.obj"
    path.write_text(f"mtllib m.mtl\n{CORNERS}usemtl m\nf 1 2 3\nl 1 2\n")
    (tmp_path / "m.mtl").write_text(f"newmtl m\n{lines}\n")
    expected = ", ".join(filter(None, ["lines (left out)", named]))
    with pytest.warns(MaterialWarning) as caught:
        read_model(path, SceneContext(tmp_path))
    [warning] = caught
    assert str(warning.message) == f"{path}: not rendered: {expected}"


SENSORS = {
    '<sensor type="perspective"/>': "",
    '<sensor type="thinlens"><float name="aperture_radius" value="0.1"/></sensor>': (
        "aperture_radius (the lens of the command or recipe)"
    ),
    '<sensor type="perspective"><float name="principalPointOffsetY" value="0.1"/></sensor>': (
        "principal_point_offset_y (a centred principal point)"
    ),
    '<sensor type="perspective"><film type="hdrfilm"><integer name="crop_width" value="8"/></film></sensor>': (
        "crop_width (the whole film)"
    ),
    '<sensor type="perspective"/><sensor type="thinlens"/>': "1 more sensor (the first one)",
}


@pytest.mark.parametrize("sensors", SENSORS)
def test_sensors_of_mitsuba_files(tmp_path, sensors):
    path = tmp_path / "s.xml"
    path.write_text(f'<scene version="3.0.0">{sensors}</scene>')
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_scene(path)
    named = SENSORS[sensors]
    assert [str(warning.message) for warning in caught] == (
        [f"{path}: sensor: not used: {named}"] if named else []
    )
    assert all(issubclass(warning.category, NotUsedWarning) for warning in caught)


def test_positions_are_read_whatever_else_is_there(tmp_path):
    """The same triangle from every file of one."""
    for name, (content, _) in MESHES.items():
        if name.endswith(".stl"):
            continue
        path = tmp_path / name
        path.write_text(content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotUsedWarning)
            mesh = read_mesh(path)
        np.testing.assert_allclose(mesh.vertices[mesh.faces[0]].sum(axis=0), [1, 1, 0])


@pytest.mark.parametrize(
    ("name", "text", "has"),
    [
        ("m.obj", f"{CORNERS}l 1 2\n", r"; it has lines \(left out\)$"),
        ("m.obj", f"{CORNERS}F 1 2 3\n", r"; it has F \(left out\)$"),
        ("m.obj", CORNERS, "$"),
        ("m.ply", ply().replace("face 1", "edge 1"), r"; it has element 'edge' \(left out\)$"),
        ("m.ply", ply().partition("element face")[0] + "end_header\n0 0 0\n1 0 0\n0 1 0\n", "$"),
    ],
)  # fmt: skip
def test_a_file_without_triangles_names_what_it_has(tmp_path, name, text, has):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(FileError, match=f"{name}: has no triangles{has}"):
        read_mesh(path)
    if name == "m.obj":
        with pytest.raises(FileError, match=f"{name}: has no triangles{has}"):
            read_model(path, SceneContext(tmp_path))
