"""Objects of a scene file: every shape by name, the user's meshes, copies."""

import math
from functools import partial

import numpy as np
import pytest
import trimesh

from tests.scenes.scene_text import required
from twinlens.errors import FileError, InputError
from twinlens.rendering.build import build
from twinlens.scenes import assets
from twinlens.scenes.assets import SceneContext, read_mesh
from twinlens.scenes.model_files import read_model
from twinlens.scenes.objects import MESH_SHAPES

REQUIRED = {
    "box": "extents = 1.5",
    "rounded_box": "extents = 1.5\nradius = 0.1",
    "icosphere": "",
    "uv_sphere": "",
    "icosahedron": "",
    "capsule": "",
    "solid_cylinder": "radius = 0.3\nheight = 2.0",
    "cone": "radius = 0.3\nheight = 2.0",
    "annulus": "r_min = 0.1\nr_max = 0.2\nheight = 2.0",
    "torus": "major_radius = 0.4\nminor_radius = 0.1",
    "lathe": "profile = [[0, 0], [1, 0.5], [0, 1]]",
    "tube": "points = [[0, 0, 0], [0, 0, 1], [0, 1, 2]]\nradius = 0.3",
    "height_field": "extents = [1, 2]\namplitude = 0.1\nheight = { type = 'value_noise', cells = 4, size = 16 }",
    "bent_sheet": "extents = [1, 2]\nangle_deg = 40",
}


def mesh_of(read_scene, lines):
    """The mesh of an object with these lines."""
    scene = read_scene(f"[objects.m]\n{lines}\n")
    return scene.objects[-1].shape


@pytest.mark.parametrize("kind", MESH_SHAPES)
def test_every_mesh_shape_is_made_from_its_required_keys(read_scene, kind):
    lines = REQUIRED[kind].splitlines()
    keys = {line.partition(" ")[0] for line in lines}
    assert keys == set(required(MESH_SHAPES[kind]))
    head = f"shape = '{kind}'\nmaterial = 'grey'\n"
    mesh = mesh_of(read_scene, head + REQUIRED[kind])
    assert mesh.faces.dtype == np.uint32
    assert mesh.faces.max() < len(mesh.vertices)
    assert np.isfinite(mesh.vertices).all()
    assert mesh.uv.shape == (len(mesh.vertices), 2)
    if lines:
        with pytest.raises(InputError, match=r"objects\.m: missing key"):
            mesh_of(read_scene, head + "\n".join(lines[1:]))


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb"])
def test_mesh_files_keep_their_surface(tmp_path, read_scene, suffix):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    ball.export(tmp_path / f"m{suffix}")
    table = f"file = 'm{suffix}'\nmaterial = 'grey'\n"
    mesh = mesh_of(read_scene, table)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.5, atol=1e-6)
    assert len(mesh.faces) == 1280
    assert mesh_of(read_scene, table + "face_normals = true").normals is None


def test_an_obj_does_not_open_the_material_file_it_names(tmp_path):
    (tmp_path / "m.obj").write_text(
        "mtllib ../secret.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    )
    (tmp_path.parent / "secret.mtl").write_text("newmtl a\nmap_Kd /etc/hostname\n")
    assert len(read_mesh(tmp_path / "m.obj").faces) == 1


@pytest.mark.parametrize("name", ["m.ply", "m.obj", "m.stl", "m.glb", "m.fbx"])
def test_a_damaged_mesh_is_named(tmp_path, name):
    for content in (b"", b"ply\nformat ascii 1.0\nelement vertex 9\n", b"\0\xff" * 50):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError, match=name):
            read_mesh(tmp_path / name)


PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 {}
"""


@pytest.mark.parametrize("crease_deg", [0.0, 30.0])
def test_a_face_with_an_invalid_vertex_number_is_an_error(tmp_path, crease_deg):
    path = tmp_path / "m.ply"
    path.write_text(PLY.format(2))
    assert len(read_mesh(path, crease_deg).faces) == 1
    for corner in (99, 3, -1, -3):
        path.write_text(PLY.format(corner))
        with pytest.raises(FileError, match=r"m\.ply: ") as caught:
            read_mesh(path, crease_deg)
        assert "\n" not in str(caught.value)


def test_a_mesh_of_too_many_triangles_is_refused(tmp_path, monkeypatch):
    """Counted as placed: one box of 12 triangles standing in two places is 24."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), geom_name="box")
    shift = trimesh.transformations.translation_matrix([5, 0, 0])
    scene.graph.update(frame_to="again", geometry="box", matrix=shift)
    scene.export(tmp_path / "m.glb")
    monkeypatch.setattr(assets, "MOST_FACES", 24)
    assert len(read_mesh(tmp_path / "m.glb").faces) == 24
    monkeypatch.setattr(assets, "MOST_FACES", 23)
    with pytest.raises(FileError, match=r"m\.glb: 24 triangles are more than 23"):
        read_mesh(tmp_path / "m.glb")


@pytest.mark.parametrize("suffix", [".stl", ".glb", ".obj"])
def test_a_mesh_file_that_is_too_large_is_not_opened(tmp_path, suffix):
    path = tmp_path / f"m{suffix}"
    with path.open("wb") as stream:
        stream.truncate((2 << 30) + 1)
    read_own = partial(read_model, context=SceneContext(tmp_path))
    read = read_mesh if suffix == ".stl" else read_own
    too_large = rf"m\{suffix}: the file is larger than 2048 MiB"
    with pytest.raises(FileError, match=too_large):
        read(path)


HEADS = {
    "sphere": "shape = 'sphere'\nradius = 1",
    "disk": "shape = 'disk'",
    "cylinder": "shape = 'cylinder'",
    "lying cylinder": "shape = 'cylinder'\np0 = [0, 0, 0]\np1 = [1, 0, 0]",
}
STRETCHED = {
    "sphere [2, 2, 2]": True,
    "sphere [1, 1, 2]": False,
    "sphere [1, 2, 1]": False,
    "disk [3, 1, 1]": True,
    "disk [1, 2, 3]": True,
    "cylinder [2, 2, 5]": True,
    "cylinder [2, 3, 2]": False,
    "lying cylinder [2, 2, 2]": True,
    "lying cylinder [1, 1, 2]": False,
}
"""Whether a shape may have the scale."""
TURNED = "rotate = { axis = [1, 2, 3], deg = 40 }\nscale = "


@pytest.mark.parametrize("case", STRETCHED)
@pytest.mark.parametrize("ends", [(TURNED, ""), ("instances = [{ scale = ", " }]")])
def test_round_shapes_need_a_uniform_scale(read_scene, case, ends):
    """And the scene is one that the renderer builds: the two must not disagree."""
    shape, _, scale = case.partition(" [")
    placement = f"[{scale}".join(ends)
    text = f"[objects.b]\n{HEADS[shape]}\nmaterial = 'grey'\n{placement}"
    if STRETCHED[case]:
        assert len(build(read_scene(text)).bodies) == 2
        return
    with pytest.raises(InputError, match="needs a uniform scale"):
        read_scene(text)


def test_a_stretched_disk_and_cylinder_are_as_large_as_they_say(
    read_scene,
):
    text = "[objects.{0}]\nshape = '{0}'\nmaterial = 'grey'\nscale = {1}\n"
    disk, cylinder = (
        text.format("disk", [3, 0.5, 1]),
        text.format("cylinder", [2, 2, 5]),
    )
    bodies = build(read_scene(disk + cylinder)).bodies[1:]
    sizes = [body.shape.bbox().extents() for body in bodies]
    np.testing.assert_allclose(sizes, [[6, 1, 0], [4, 4, 5]], atol=1e-5)


def test_a_sharp_edge_stays_sharp_and_a_round_side_smooth(tmp_path):
    solid = trimesh.creation.cylinder(radius=0.5, height=1, sections=64)
    solid.export(tmp_path / "c.ply")
    mesh = read_mesh(tmp_path / "c.ply")
    up = np.abs(mesh.normals[:, 2])
    assert ((up < 1e-6) | (up > 1 - 1e-6)).all()
    side = up < 0.5
    radial = mesh.vertices[side, :2] / 0.5
    half_a_section = math.sin(math.pi / 64)
    np.testing.assert_allclose(
        mesh.normals[side, :2], radial, atol=half_a_section + 1e-6
    )


def test_merged_copies_have_the_poses_of_the_instances(read_scene):
    text = """
[objects.b]
shape = "box"
extents = 1
scale = 0.5
material = "grey"
instances = [{ translate = [1, 2, 3] }, { translate = [-4, 0, 0], euler_deg = [0, 0, 45] }]
"""
    apart = read_scene(text).objects[-1]
    joined = read_scene(text + "merge = true\n").objects[-1]
    assert joined.instances == ()
    corners = np.c_[apart.shape.vertices, np.ones(len(apart.shape.vertices))]
    poses = [pose @ apart.world_from_object for pose in apart.instances]
    expected = np.concatenate([corners @ pose.T for pose in poses])
    np.testing.assert_allclose(joined.shape.vertices, expected[:, :3], atol=1e-12)
