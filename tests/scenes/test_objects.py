"""Objects of a scene file: every shape by name, the user's meshes, copies."""

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.scenes.scene_text import Read, required
from twinlens.errors import FileError, InputError
from twinlens.scenes import Mesh, assets
from twinlens.scenes.assets import SceneContext, read_mesh
from twinlens.scenes.model_files import read_model
from twinlens.scenes.objects import MESH_SHAPES

GIVEN = {
    "extents": {"height_field": "[1, 2]", "bent_sheet": "[1, 2]"},
    "radius": {"rounded_box": "0.1"},
}
VALUES = {
    "extents": "1.5",
    "radius": "0.3",
    "height": "2.0",
    "r_min": "0.1",
    "r_max": "0.2",
    "major_radius": "0.4",
    "minor_radius": "0.1",
    "profile": "[[0, 0], [1, 0.5], [0, 1]]",
    "points": "[[0, 0, 0], [0, 0, 1], [0, 1, 2]]",
    "amplitude": "0.1",
    "angle_deg": "40",
}


@pytest.mark.parametrize("kind", MESH_SHAPES)
def test_every_mesh_shape_is_made_from_its_required_keys(
    read_scene: Read, kind: str
) -> None:
    lines = [
        f"{key} = {GIVEN.get(key, {}).get(kind, VALUES[key])}"
        for key in required(MESH_SHAPES[kind])
    ]
    if kind == "height_field":
        lines = [
            "extents = [1, 2]",
            "amplitude = 0.1",
            "height = { type = 'value_noise', cells = 4, size = 16 }",
        ]
    scene = read_scene(
        f"[objects.b]\nshape = '{kind}'\nmaterial = 'grey'\n" + "\n".join(lines)
    )
    mesh = scene.objects[-1].shape
    assert isinstance(mesh, Mesh)
    assert mesh.faces.dtype == np.uint32
    assert mesh.faces.max() < len(mesh.vertices)
    assert np.isfinite(mesh.vertices).all()
    assert mesh.uv is not None
    assert mesh.uv.shape == (len(mesh.vertices), 2)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb"])
def test_mesh_files_keep_their_surface(
    tmp_path: Path, read_scene: Read, suffix: str
) -> None:
    trimesh.creation.icosphere(subdivisions=3, radius=0.5).export(
        tmp_path / f"m{suffix}"
    )
    scene = read_scene(f"[objects.m]\nfile = 'm{suffix}'\nmaterial = 'grey'")
    mesh = scene.objects[-1].shape
    assert isinstance(mesh, Mesh)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.5, atol=1e-6)
    assert len(mesh.faces) == 1280
    assert scene.files[-1] == (tmp_path / f"m{suffix}").resolve()
    flat = (
        read_scene(
            f"[objects.m]\nfile = 'm{suffix}'\nmaterial = 'grey'\nface_normals = true"
        )
        .objects[-1]
        .shape
    )
    assert isinstance(flat, Mesh)
    assert flat.normals is None


def test_an_obj_does_not_open_the_material_file_it_names(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(
        "mtllib ../secret.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    )
    (tmp_path.parent / "secret.mtl").write_text("newmtl a\nmap_Kd /etc/hostname\n")
    assert len(read_mesh(tmp_path / "m.obj").faces) == 1


@pytest.mark.parametrize("name", ["m.ply", "m.obj", "m.stl", "m.glb", "m.fbx"])
@pytest.mark.parametrize(
    "content", [b"", b"ply\nformat ascii 1.0\nelement vertex 9\n", b"\x00\xff" * 50]
)
def test_a_damaged_mesh_is_named(tmp_path: Path, name: str, content: bytes) -> None:
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


@pytest.mark.parametrize("corner", [99, 3, -1, -3])
@pytest.mark.parametrize("crease_deg", [0.0, 30.0])
def test_a_face_with_an_invalid_vertex_number_is_an_error(
    tmp_path: Path, corner: int, crease_deg: float
) -> None:
    (tmp_path / "m.ply").write_text(PLY.format(2))
    assert len(read_mesh(tmp_path / "m.ply", crease_deg).faces) == 1
    (tmp_path / "m.ply").write_text(PLY.format(corner))
    with pytest.raises(FileError, match=r"m\.ply: ") as caught:
        read_mesh(tmp_path / "m.ply", crease_deg)
    assert "\n" not in str(caught.value)


def test_a_mesh_of_too_many_triangles_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted as placed: one box of 12 triangles standing in two places is 24."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), geom_name="box")
    scene.graph.update(
        frame_to="again",
        geometry="box",
        matrix=trimesh.transformations.translation_matrix([5, 0, 0]),
    )
    scene.export(tmp_path / "m.glb")
    monkeypatch.setattr(assets, "MOST_FACES", 24)
    assert len(read_mesh(tmp_path / "m.glb").faces) == 24
    monkeypatch.setattr(assets, "MOST_FACES", 23)
    with pytest.raises(FileError, match=r"m\.glb: 24 triangles are more than 23"):
        read_mesh(tmp_path / "m.glb")


@pytest.mark.parametrize("suffix", [".stl", ".glb", ".obj"])
def test_a_mesh_file_that_is_too_large_is_not_opened(
    tmp_path: Path, suffix: str
) -> None:
    with (tmp_path / f"m{suffix}").open("wb") as stream:
        stream.truncate((2 << 30) + 1)
    read = (
        read_mesh
        if suffix == ".stl"
        else partial(read_model, context=SceneContext(tmp_path))
    )
    with pytest.raises(
        FileError, match=rf"m\{suffix}: the file is larger than 2048 MiB"
    ):
        read(tmp_path / f"m{suffix}")


UNIT = {
    "sphere": "radius = 1",
    "disk": "",
    "cylinder": "",
    "lying": "p0 = [0, 0, 0]\np1 = [1, 0, 0]",
}
STRETCHED = [
    ("sphere", "[2, 2, 2]", True),
    ("sphere", "[1, 1, 2]", False),
    ("sphere", "[1, 2, 1]", False),
    ("disk", "[3, 1, 1]", True),
    ("disk", "[1, 2, 3]", True),
    ("cylinder", "[2, 2, 5]", True),
    ("cylinder", "[2, 3, 2]", False),
    ("lying", "[2, 2, 2]", True),
    ("lying", "[1, 1, 2]", False),
]


@pytest.mark.parametrize(("kind", "scale", "good"), STRETCHED)
@pytest.mark.parametrize("where", ["scale = {}", "instances = [{{ scale = {} }}]"])
def test_round_shapes_need_a_uniform_scale(
    read_scene: Read, kind: str, scale: str, good: bool, where: str
) -> None:
    """And the scene is one that the renderer builds: the two must not disagree."""
    build = pytest.importorskip("twinlens.rendering.build").build
    shape = "cylinder" if kind == "lying" else kind
    text = f"[objects.b]\nshape = '{shape}'\nmaterial = 'grey'\n{UNIT[kind]}\n"
    turned = (
        "rotate = { axis = [1, 2, 3], deg = 40 }\n" if where.startswith("scale") else ""
    )
    if good:
        assert len(build(read_scene(text + turned + where.format(scale))).bodies) == 2
        return
    with pytest.raises(InputError, match=rf"a {shape} needs a uniform scale"):
        read_scene(text + turned + where.format(scale))


def test_a_stretched_disk_and_cylinder_are_as_large_as_they_say(
    read_scene: Read,
) -> None:
    build = pytest.importorskip("twinlens.rendering.build").build
    text = "[objects.{0}]\nshape = '{0}'\nmaterial = 'grey'\nscale = {1}\n"
    scene = read_scene(
        text.format("disk", "[3, 0.5, 1]") + text.format("cylinder", "[2, 2, 5]")
    )
    disk, cylinder = (body.shape.bbox() for body in build(scene).bodies[1:])
    np.testing.assert_allclose(disk.extents(), [6, 1, 0], atol=1e-5)
    np.testing.assert_allclose(cylinder.extents(), [4, 4, 5], atol=1e-5)


def test_a_sheared_cylinder_is_refused(read_scene: Read) -> None:
    rows = "matrix = [[1, 0, 0.5, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    with pytest.raises(InputError, match="a cylinder needs a uniform scale"):
        read_scene(f"[objects.b]\nshape = 'cylinder'\nmaterial = 'grey'\n{rows}")


def test_a_sharp_edge_stays_sharp_and_a_round_side_smooth(tmp_path: Path) -> None:
    trimesh.creation.cylinder(radius=0.5, height=1, sections=64).export(
        tmp_path / "c.ply"
    )
    mesh = read_mesh(tmp_path / "c.ply")
    assert mesh.normals is not None
    up = np.abs(mesh.normals[:, 2])
    assert ((up < 1e-6) | (up > 1 - 1e-6)).all()
    side = up < 0.5
    radial = mesh.vertices[side, :2] / 0.5
    np.testing.assert_allclose(
        mesh.normals[side, :2], radial, atol=math.sin(math.pi / 64) + 1e-6
    )


def test_merged_copies_have_the_poses_of_the_instances(read_scene: Read) -> None:
    text = """
[objects.b]
shape = "box"
extents = 1
scale = 0.5
material = "grey"
instances = [{ translate = [1, 2, 3] }, { translate = [-4, 0, 0], euler_deg = [0, 0, 45] }]
"""
    apart, joined = (
        read_scene(text).objects[-1],
        read_scene(text + "merge = true\n").objects[-1],
    )
    assert isinstance(apart.shape, Mesh)
    assert isinstance(joined.shape, Mesh)
    assert len(apart.instances) == 2
    assert joined.instances == ()
    half = len(joined.shape.vertices) // 2
    for part, pose in zip(
        (slice(half), slice(half, None)), apart.instances, strict=True
    ):
        expected = (
            np.c_[apart.shape.vertices, np.ones(half)]
            @ (pose @ apart.world_from_object).T
        )
        np.testing.assert_allclose(
            joined.shape.vertices[part], expected[:, :3], atol=1e-12
        )


def test_files_outside_the_folder_are_refused(tmp_path: Path, read_scene: Read) -> None:
    trimesh.creation.box().export(tmp_path.parent / "outside.ply")
    with pytest.raises(
        InputError, match=r"objects\.m\.file: '\.\./outside\.ply' leads outside"
    ):
        read_scene("[objects.m]\nfile = '../outside.ply'\nmaterial = 'grey'")
