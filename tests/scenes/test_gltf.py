"""glTF and OBJ files in scene.toml: materials, node trees, axes and sizes; only files below the scene's folder."""

import json
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from tests.dataset.test_fuzz import fuzz, in_process, other_values  # noqa: F401
from tests.scenes.gltf_files import (
    glb,
    picture,
    png,
    square,
    unpacked,
    with_extensions,
    write,
)
from tests.scenes.scene_text import Read
from twinlens.errors import FileError, InputError
from twinlens.scenes import Mesh, Scene
from twinlens.scenes.assets import SceneContext, read_mesh
from twinlens.scenes.gltf_materials import VERTEX_COLOR, Transform
from twinlens.scenes.materials import Bitmap, Color, Material
from twinlens.scenes.model_files import MaterialWarning, Model, read_model

OWN = "[objects.own]\nfile = 'm.glb'\n"


def own(scene: Scene) -> tuple[Mesh, tuple[str, ...]]:
    thing = scene.objects[-1]
    assert isinstance(thing.shape, Mesh)
    return thing.shape, thing.materials


def read(path: Path) -> Model:
    return read_model(path, SceneContext(path.parent))


def only_material(path: Path) -> Material:
    (material,) = read(path).materials.values()
    return material


def texels(value: Any) -> Any:
    """The pixels of a map."""
    assert isinstance(value, Bitmap)
    return value.pixels


def test_a_file_has_its_own_material_size_and_up_axis(
    tmp_path: Path, read_scene: Read
) -> None:
    """12 mm stay 12 mm, and glTF's y axis becomes the world's z."""
    part = trimesh.creation.box([0.012, 0.03, 0.02])
    part.visual = trimesh.visual.TextureVisuals(
        uv=np.zeros((8, 2)),
        material=trimesh.visual.material.PBRMaterial(name="steel", metallicFactor=1.0),
    )
    write(tmp_path / "m.glb", part)
    mesh, names = own(read_scene(OWN))
    assert names == ("m.glb:steel",)
    np.testing.assert_allclose(
        np.ptp(mesh.vertices, axis=0), [0.012, 0.02, 0.03], atol=1e-9
    )
    mesh, names = own(read_scene(OWN + "material = 'grey'\nup_axis = 'z'\n"))
    assert names == ("grey",)
    np.testing.assert_allclose(
        np.ptp(mesh.vertices, axis=0), [0.012, 0.03, 0.02], atol=1e-9
    )


def test_a_material_of_the_scene_replaces_those_of_the_file(
    tmp_path: Path, read_scene: Read
) -> None:
    """Nothing of the file's materials is read then, not even a damaged picture."""
    write(
        tmp_path / "m.glb",
        square(baseColorTexture=picture(np.ones((2, 2, 3)))),
        damage_picture,
    )
    scene = read_scene(OWN + "material = 'grey'\n")
    assert own(scene)[1] == ("grey",)
    assert set(scene.materials) == {"grey"}
    with pytest.raises(
        InputError,
        match=r"objects.own: .*m\.glb: images\[0\] must be a \.png or \.jpg picture",
    ):
        read_scene(OWN)


def damage_picture(header: dict[str, Any]) -> None:
    header["images"][0] = {"bufferView": 0}


def test_vertices_without_a_normal_get_that_of_their_faces(tmp_path: Path) -> None:
    header, binary = unpacked(
        trimesh.Scene(square()).export(file_type="glb", include_normals=True)
    )
    accessor = header["accessors"][
        header["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    ]
    start = header["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    (tmp_path / "m.glb").write_bytes(
        glb(header, binary[:start] + bytes(12) + binary[start + 12 :])
    )
    np.testing.assert_allclose(
        read(tmp_path / "m.glb").mesh.normals, [[0, 0, 1]] * 4, atol=1e-9
    )


def test_other_mesh_files_need_a_material(tmp_path: Path, read_scene: Read) -> None:
    trimesh.creation.box().export(tmp_path / "m.ply")
    with pytest.raises(
        InputError,
        match=r"objects.m: missing key 'material'; only \.glb, \.gltf, \.obj files have",
    ):
        read_scene("[objects.m]\nfile = 'm.ply'\n")


def test_a_node_tree_with_several_materials_is_one_object(
    tmp_path: Path, read_scene: Read
) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(square(name="red"), node_name="a")
    shift = trimesh.transformations.translation_matrix([0, 0, 2.0])
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
    scene.add_geometry(
        square(name="blue"), node_name="b", parent_node_name="a", transform=shift @ turn
    )
    mirror = np.diag([-1.0, 1, 1, 1])
    scene.add_geometry(
        square(name="red"), node_name="c", parent_node_name="b", transform=mirror
    )
    write(tmp_path / "m.glb", scene)
    mesh, names = own(read_scene(f"{OWN}up_axis = 'z'\n"))
    assert {name.removesuffix("-2") for name in names} == {"m.glb:blue", "m.glb:red"}
    assert mesh.surface is not None
    blue = mesh.vertices[mesh.faces[mesh.surface == names.index("m.glb:blue")].ravel()]
    np.testing.assert_allclose(
        [blue.min(axis=0), blue.max(axis=0)], [[0, 0, 1.5], [0, 1, 2.5]], atol=1e-6
    )
    assert len(mesh.faces) == 6
    cross = np.cross(
        *(
            mesh.vertices[mesh.faces[:, i]] - mesh.vertices[mesh.faces[:, 0]]
            for i in (1, 2)
        )
    )
    np.testing.assert_allclose(np.abs(cross).sum(axis=1), 1, atol=1e-6)
    facing = cross[:, 0] + cross[:, 2]
    assert mesh.normals is not None
    np.testing.assert_allclose(
        facing, mesh.normals[mesh.faces[:, 0]] @ [1, 0, 1], atol=1e-6
    )


def test_color_factor_and_srgb_texture_are_multiplied(tmp_path: Path) -> None:
    stored = np.zeros((2, 2, 3))
    stored[0, 1] = [0.5, 1.0, 0.0]
    path = write(
        tmp_path / "m.glb",
        square(baseColorTexture=picture(stored), baseColorFactor=[1.0, 0.5, 0.2, 1.0]),
    )
    color = texels(only_material(path).base_color)
    linear = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(color[0, 1], [linear, 128 / 255, 0], atol=3e-3)
    assert not color[1].any()


def test_metalness_and_roughness_are_the_blue_and_the_green_channel(
    tmp_path: Path,
) -> None:
    stored = np.zeros((1, 2, 3))
    stored[0, 0], stored[0, 1] = [1.0, 0.2, 0.0], [0.0, 0.8, 1.0]
    path = write(
        tmp_path / "m.glb",
        square(
            metallicRoughnessTexture=picture(stored),
            roughnessFactor=0.5,
            metallicFactor=1.0,
        ),
    )
    material = only_material(path)
    np.testing.assert_allclose(texels(material.roughness), [[0.1, 0.4]], atol=2e-3)
    np.testing.assert_allclose(texels(material.metallic), [[0.0, 1.0]])
    assert material.base_color == Color((1.0, 1.0, 1.0))


def test_alpha_becomes_opacity(tmp_path: Path) -> None:
    stored = np.ones((1, 3, 4))
    stored[0, :, 3] = [0.2, 0.6, 1.0]
    modes: dict[str, tuple[Any, float | None]] = {
        "OPAQUE": (1.0, None),
        "MASK": ([[0.2, 0.6, 1.0]], 0.4),
        "BLEND": ([[0.2, 0.6, 1.0]], None),
    }
    for mode, (opacity, cutoff) in modes.items():
        look = square(baseColorTexture=picture(stored), alphaMode=mode, alphaCutoff=0.4)
        material = only_material(write(tmp_path / "m.glb", look))
        assert material.alpha_cutoff == cutoff
        value = getattr(material.opacity, "pixels", material.opacity)
        np.testing.assert_allclose(value, opacity, atol=2e-3)


def test_emission_is_factor_times_strength_times_texture(tmp_path: Path) -> None:
    path = write(
        tmp_path / "m.glb",
        square(emissiveFactor=[1.0, 0.5, 0.0]),
        with_extensions(emissive_strength={"emissiveStrength": 8.0}),
    )
    assert only_material(path).emission == Color((8.0, 4.0, 0.0))


def test_sides_and_glass(tmp_path: Path) -> None:
    path = write(tmp_path / "m.glb", square(doubleSided=True, metallicFactor=1.0))
    assert only_material(path).two_sided
    glass = with_extensions(transmission={"transmissionFactor": 1.0}, ior={"ior": 1.33})
    path = write(
        tmp_path / "m.glb", square(metallicFactor=0.0, roughnessFactor=0.0), glass
    )
    pane = only_material(path)
    assert pane.thin_walled
    assert (pane.transmission, pane.ior) == (1.0, 1.33)
    solid = with_extensions(
        transmission={"transmissionFactor": 1.0}, volume={"thicknessFactor": 1.0}
    )
    path = write(
        tmp_path / "m.glb", square(metallicFactor=0.0, roughnessFactor=0.0), solid
    )
    assert not only_material(path).thin_walled


def test_a_texture_transform_rotates_counter_clockwise_as_seen() -> None:
    """Coordinates (u, v up) -> (u, v down) of glTF by hand: the point right of the origin moves up by 90 degrees."""
    matrix = Transform(
        offset=[0.25, 0.5], rotation=np.pi / 2, scale=[2.0, 1.0]
    ).matrix()
    u, v_down = 0.25, 0.0
    scaled = np.array([2 * u, v_down])
    turned = np.array([scaled[1], -scaled[0]])  # up is negative v
    expected = [turned[0] + 0.25, turned[1] + 0.5]
    np.testing.assert_allclose(
        matrix @ [u, 1 - v_down, 1], [expected[0], 1 - expected[1], 1], atol=1e-12
    )


def test_a_normal_map_is_scaled_and_stays_unit_length(tmp_path: Path) -> None:
    tilted = np.array([0.6, 0.0, 0.8])
    path = write(
        tmp_path / "m.glb",
        square(normalTexture=picture(np.tile((tilted + 1) / 2, (2, 2, 1)))),
        lambda header: header["materials"][0]["normalTexture"].update(scale=2.0),
    )
    normal = 2 * texels(only_material(path).normal)[0, 0] - 1
    np.testing.assert_allclose(
        normal, np.array([1.2, 0, 0.8]) / np.hypot(1.2, 0.8), atol=0.01
    )


@pytest.mark.parametrize("colored", [False, True])
def test_a_part_without_texture_coordinates_leaves_those_of_others(
    tmp_path: Path, colored: bool
) -> None:
    """All parts have the file's own normals, and the second one no TEXCOORD_0."""
    scene = trimesh.Scene()
    scene.add_geometry(square(baseColorTexture=picture(np.eye(3)[None])))
    bare = trimesh.creation.box([1, 1, 1])
    if colored:
        bare.visual.vertex_colors = np.round(255 * (bare.vertices + 0.5)).astype(
            np.uint8
        )
    scene.add_geometry(
        bare, transform=trimesh.transformations.translation_matrix([0, 0, 3])
    )
    header, binary = unpacked(scene.export(file_type="glb", include_normals=True))
    header["materials"].append({"pbrMetallicRoughness": {"metallicFactor": 0.0}})
    header["meshes"][1]["primitives"][0]["material"] = len(header["materials"]) - 1
    (tmp_path / "m.glb").write_bytes(glb(header, binary))
    attributes = [mesh["primitives"][0]["attributes"] for mesh in header["meshes"]]
    assert [("NORMAL" in each, "TEXCOORD_0" in each) for each in attributes] == [
        (True, True),
        (True, False),
    ]
    model = read(tmp_path / "m.glb")
    mesh = model.mesh
    assert mesh.uv is not None
    assert mesh.normals is not None
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    textured = corners[:, 2] < 1
    np.testing.assert_allclose(
        mesh.uv[mesh.faces.ravel()][textured],
        corners[textured, :2] + [0.5, 0],
        atol=1e-6,
    )
    if colored:
        colors = mesh.attributes[VERTEX_COLOR.attribute][mesh.faces.ravel(), :3]
        expected = corners[~textured] - [-0.5, -0.5, 2.5]
        np.testing.assert_allclose(colors[~textured], expected, atol=1e-5)


def test_a_file_without_a_scene_has_its_nodes(tmp_path: Path) -> None:
    def change(header: dict[str, Any]) -> None:
        header.pop("scene", None)
        header.pop("scenes")
        header["nodes"] = [
            {"mesh": 0, "translation": [0, 0, 1]},
            {"children": [0], "scale": [2, 2, 2]},
        ]

    mesh = read(write(tmp_path / "m.glb", square(), change)).mesh
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [1, 2, 2], atol=1e-6)


def write_colored(path: Path, colors: Any, **material: Any) -> Path:
    """A square with vertex colours (4, 3 or 4), which trimesh writes for meshes without a texture only."""
    header, binary = unpacked(trimesh.Scene(square(**material)).export(file_type="glb"))
    data = np.asarray(colors, dtype="<f4")
    header["bufferViews"].append(
        {"buffer": 0, "byteOffset": len(binary), "byteLength": data.nbytes}
    )
    view, kind = len(header["bufferViews"]) - 1, f"VEC{data.shape[1]}"
    header["accessors"].append(
        {"bufferView": view, "componentType": 5126, "count": 4, "type": kind}
    )
    header["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = (
        len(header["accessors"]) - 1
    )
    header["buffers"][0]["byteLength"] = len(binary) + data.nbytes
    path.write_bytes(glb(header, binary + data.tobytes()))
    return path


FACTOR = [0.2, 0.4, 0.8]
COLORS = np.array([[1, 0, 0, 1], [0, 1, 0, 0.5], [0, 0, 1, 0], [1, 1, 1, 1]])


def test_vertex_colors_are_mesh_attributes(tmp_path: Path) -> None:
    path = write_colored(
        tmp_path / "m.glb", COLORS[:, :3], baseColorFactor=[*FACTOR, 1.0]
    )
    model = read(path)
    (material,) = model.materials.values()
    assert (material.base_color, material.opacity) == (VERTEX_COLOR, 1.0)
    tinted = model.mesh.attributes[VERTEX_COLOR.attribute]
    np.testing.assert_allclose(tinted[:, :3], COLORS[:, :3] * FACTOR, atol=1e-6)


def test_vertex_colors_have_opacity(tmp_path: Path) -> None:
    model = read(write_colored(tmp_path / "m.glb", COLORS, alphaMode="BLEND"))
    (material,) = model.materials.values()
    assert material.opacity == VERTEX_COLOR
    tinted = model.mesh.attributes[VERTEX_COLOR.attribute]
    np.testing.assert_allclose(tinted, COLORS, atol=1e-6)


def test_a_texture_is_kept_where_vertices_have_colors_too(tmp_path: Path) -> None:
    texture = picture(np.linspace(0, 1, 12).reshape(2, 2, 3))
    path = write_colored(tmp_path / "m.glb", np.ones((4, 3)), baseColorTexture=texture)
    assert isinstance(only_material(path).base_color, Bitmap)
    path = write_colored(tmp_path / "m.glb", COLORS, baseColorTexture=texture)
    with pytest.warns(
        MaterialWarning, match="not rendered: vertex colours multiplied with a texture"
    ):
        assert isinstance(only_material(path).base_color, Bitmap)


def test_normal_maps_are_there_twice_where_texture_coordinates_are_mirrored(
    tmp_path: Path,
) -> None:
    """Two squares, the second one with u from right to left; both share all other maps."""
    tilt, color = (
        picture(np.tile((np.array([0.6, 0.0, 0.8]) + 1) / 2, (2, 2, 1))),
        picture(np.eye(3)[None]),
    )
    both = [square(normalTexture=tilt, baseColorTexture=color) for _ in range(2)]
    both[1].visual.uv = both[1].visual.uv * [-1, 1] + [1, 0]
    scene = trimesh.Scene()
    for i, each in enumerate(both):
        scene.add_geometry(
            each, transform=trimesh.transformations.translation_matrix([0, 0, i])
        )
    model = read(write(tmp_path / "m.glb", scene, one_material))
    assert list(model.materials) == ["m.glb:paint", "m.glb:paint-2"]
    upright, flipped = model.materials.values()
    assert (upright.mirrored, flipped.mirrored) == (False, True)
    assert upright.base_color is flipped.base_color
    assert upright.normal is flipped.normal
    assert model.mesh.surface is not None
    heights = model.mesh.vertices[model.mesh.faces[:, 0], 2]
    np.testing.assert_array_equal(model.mesh.surface, heights > 0.5)


def one_material(header: dict[str, Any]) -> None:
    for mesh in header["meshes"]:
        mesh["primitives"][0]["material"] = 0


def test_what_cannot_be_rendered_is_named_in_one_line(tmp_path: Path) -> None:
    sheen = with_extensions(sheen={"sheenColorFactor": [1, 1, 1]}, anisotropy={})
    path = write(tmp_path / "m.glb", square(), sheen)
    with pytest.warns(MaterialWarning) as caught:
        read(path)
    assert [str(each.message) for each in caught] == [
        f"{path}: not rendered: KHR_materials_anisotropy, KHR_materials_sheen"
    ]


def test_geometry_that_is_not_rendered_is_named(tmp_path: Path) -> None:
    def change(header: dict[str, Any]) -> None:
        first = header["meshes"][0]["primitives"][0]
        header["meshes"][0]["primitives"].append({**first, "mode": 6})
        first["targets"] = [{}]
        header["nodes"][-1].update(skin=0, extensions={"EXT_mesh_gpu_instancing": {}})
        header["extensions"] = {"KHR_lights_punctual": {"lights": []}}

    path = write(tmp_path / "m.glb", square(), change)
    lost = "points, lines and triangle fans, morph targets, skins, EXT_mesh_gpu_instancing, KHR_lights_punctual"
    with pytest.warns(MaterialWarning, match=f"rendered: {lost}$"):
        assert len(read(path).mesh.faces) == 2


def test_the_files_that_a_file_names_have_a_common_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A header of some bytes could name a large file a thousand times."""
    header, binary = unpacked(trimesh.Scene(square()).export(file_type="glb"))
    (tmp_path / "m.bin").write_bytes(binary)
    header["buffers"] = [{"uri": "m.bin"}] * 3
    (tmp_path / "m.gltf").write_text(json.dumps(header))
    read(tmp_path / "m.gltf")
    monkeypatch.setattr(
        "twinlens.scenes.model_files.LARGEST_MESH_FILE", 3 * len(binary) - 1
    )
    with pytest.raises(
        FileError, match=r"m\.gltf: .*m\.bin: the file is larger than 0 MiB"
    ):
        read(tmp_path / "m.gltf")


def test_a_gltf_file_names_its_neighbours(tmp_path: Path, read_scene: Read) -> None:
    header, binary = unpacked(
        trimesh.Scene(square(baseColorTexture=picture(np.ones((2, 2, 3))))).export(
            file_type="glb"
        )
    )
    folder = tmp_path / "parts"
    folder.mkdir()
    (folder / "white space.png").write_bytes(png(np.full((2, 2, 3), 0.5)))
    (folder / "m.bin").write_bytes(binary)
    header["buffers"][0]["uri"] = "m.bin"
    header["images"] = [{"uri": "white%20space.png"}]
    (folder / "m.gltf").write_text(json.dumps(header))
    scene = read_scene("[objects.own]\nfile = 'parts/m.gltf'\n")
    assert {path.name for path in scene.files} == {
        "scene.toml",
        "m.gltf",
        "m.bin",
        "white space.png",
    }


MTL = "newmtl red\nKd 0.8 0.1 0.1\nNs 10\nKe 4 2 0\nnewmtl tiles\nKd 1 1 1\nmap_Kd tiles.png\nKs 0 0 0\n"
OBJ = """mtllib m.mtl
v 0 0 0
v 1 0 0
v 0 1 0
v 1 1 0
vt 0 0
vt 1 0
vt 0 1
usemtl red
f 1/1 2/2 3/3
usemtl tiles
f 2/2 4/1 3/3
"""


def test_an_obj_has_the_materials_of_its_mtl_file(
    tmp_path: Path, read_scene: Read
) -> None:
    (tmp_path / "m.obj").write_text(OBJ)
    (tmp_path / "m.mtl").write_text(MTL)
    (tmp_path / "tiles.png").write_bytes(png(np.full((2, 2, 3), 0.5)))
    scene = read_scene("[objects.own]\nfile = 'm.obj'\n")
    mesh, names = own(scene)
    assert names == ("m.obj:red", "m.obj:tiles")
    assert mesh.surface is not None
    assert mesh.surface.tolist() == [0, 1]
    np.testing.assert_array_equal(
        np.ptp(mesh.vertices, axis=0), [1, 1, 0]
    )  # OBJ has no up axis: z, as it was
    linear = ((128 / 255 + 0.055) / 1.055) ** 2.4
    tiles, red = (scene.materials[f"m.obj:{name}"] for name in ("tiles", "red"))
    assert isinstance(tiles, Material)
    assert isinstance(red, Material)
    np.testing.assert_allclose(texels(tiles.base_color), linear, rtol=1e-6)
    assert tiles.specular == 0.0
    assert red.roughness == pytest.approx((2 / 12) ** 0.25)
    assert red.emission == Color((4.0, 2.0, 0.0))
    assert {path.name for path in scene.files} == {
        "scene.toml",
        "m.obj",
        "m.mtl",
        "tiles.png",
    }


def test_an_obj_may_have_faces_without_area(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(OBJ + "usemtl red\nf 1/1 1/1 4/1\n")
    (tmp_path / "m.mtl").write_text(MTL.replace("map_Kd", "#"))
    assert len(read(tmp_path / "m.obj").mesh.faces) == 3


@pytest.mark.parametrize(
    ("face", "message"),
    [
        ("f 0/1 2/2 3/3", "a face has the vertex number 0; OBJ counts from 1"),
        ("f 1/1 2/0 3/3", "a face has the vertex number 0; OBJ counts from 1"),
        ("f -3 -2 -1\nv 0 0 1", "has negative vertex numbers before its last vertex"),
    ],
)
def test_vertex_numbers_that_would_be_misread_are_errors(
    tmp_path: Path, face: str, message: str
) -> None:
    (tmp_path / "m.obj").write_text(OBJ.replace("f 1/1 2/2 3/3", face))
    (tmp_path / "m.mtl").write_text(MTL)
    with pytest.raises(FileError, match=f"m.obj: {message}"):
        read(tmp_path / "m.obj")
    with pytest.raises(FileError, match=f"m.obj: {message}"):
        read_mesh(tmp_path / "m.obj")


def test_keys_of_a_mtl_file_that_are_not_rendered_are_named(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(OBJ)
    (tmp_path / "m.mtl").write_text(
        MTL.replace("map_Kd", "map_Ks")
        + "bump -bm 2 b.png\nmap_d d.png\nKs 1 0.5 0.5\n"
    )
    with pytest.warns(
        MaterialWarning,
        match=r"m\.obj: not rendered: bump, map_d, map_ks, the colour of Ks$",
    ):
        read(tmp_path / "m.obj")


def test_files_in_other_folders_of_the_scene_are_found(
    tmp_path: Path, read_scene: Read
) -> None:
    """Names in an .obj and an .mtl file are relative to the folder of each."""
    for name in ("m/o", "parts", "pictures"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "m" / "o" / "m.obj").write_text(
        OBJ.replace("m.mtl", "../../parts/m.mtl")
    )
    (tmp_path / "parts" / "m.mtl").write_text(
        MTL.replace("tiles.png", "../pictures/tiles.png")
    )
    (tmp_path / "pictures" / "tiles.png").write_bytes(png(np.full((2, 2, 3), 0.5)))
    scene = read_scene("[objects.own]\nfile = 'm/o/m.obj'\n")
    assert {path.relative_to(tmp_path).as_posix() for path in scene.files} == {
        *("scene.toml", "m/o/m.obj", "parts/m.mtl", "pictures/tiles.png")
    }
    for name in ("../../../secret.mtl", "../../../parts/m.mtl"):
        (tmp_path / "m" / "o" / "m.obj").write_text(OBJ.replace("m.mtl", name))
        with pytest.raises(
            InputError, match=r"objects.own: .*leads outside the folder '"
        ):
            read_scene("[objects.own]\nfile = 'm/o/m.obj'\n")


@pytest.mark.parametrize(
    "name",
    [
        "../secret.png",
        "/etc/hostname",
        "link.png",
        "http://a.b/c.png",
        "C:/x.png",
        "a\\b.png",
    ],
)
@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_files_outside_the_folder_are_refused(
    tmp_path: Path, read_scene: Read, suffix: str, name: str
) -> None:
    (tmp_path.parent / "secret.png").write_bytes(png(np.ones((2, 2, 3))))
    if not (tmp_path / "link.png").is_symlink():
        (tmp_path / "link.png").symlink_to(tmp_path.parent / "secret.png")
    if suffix == ".glb":
        write(
            tmp_path / "m.glb",
            square(baseColorTexture=picture(np.ones((2, 2, 3)))),
            lambda h: h["images"].__setitem__(0, {"uri": name}),
        )
    else:
        (tmp_path / "m.obj").write_text(OBJ)
        (tmp_path / "m.mtl").write_text(MTL.replace("tiles.png", name))
    with pytest.raises(
        InputError,
        match=r"objects.own: .*(leads outside|must be a file name|web addresses)",
    ) as caught:
        read_scene(f"[objects.own]\nfile = 'm{suffix}'\n")
    assert "\n" not in str(caught.value)


def add_node(header: dict[str, Any], **node: Any) -> None:
    header["nodes"].append(node)
    header["scenes"][0]["nodes"].append(len(header["nodes"]) - 1)


def add_huge_nodes(header: dict[str, Any]) -> None:
    add_node(header, scale=[1e200] * 3, children=[len(header["nodes"]) + 1])
    header["nodes"].append({"mesh": 0, "scale": [1e200] * 3})


def change_surface(header: dict[str, Any], **factors: float) -> None:
    header["materials"][0]["pbrMetallicRoughness"] = factors


def add_accessor(header: dict[str, Any]) -> None:
    header["accessors"].append(
        {"componentType": 5126, "count": 1 << 40, "type": "VEC4"}
    )


def shine(header: dict[str, Any], index: int = 99) -> None:
    header["materials"][0].update(
        emissiveTexture={"index": index}, emissiveFactor=[1, 1, 1]
    )
    if index == 0:
        header["textures"] = [{}]


HOSTILE: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "nodes": (
        lambda h: h.update(nodes=[{"mesh": 0}] * 100_000),
        "nodes: must be a list of at most 50000",
    ),
    "loop": (lambda h: add_node(h, children=[len(h["nodes"])]), "has two parents"),
    "materials": (
        lambda h: h.update(materials=[{}] * 10_001),
        "materials: must be a list of at most 10000",
    ),
    "pose": (add_huge_nodes, "has no finite pose"),
    "rotation": (
        lambda h: add_node(h, mesh=0, rotation=[0, 0, 0, 0]),
        "zero norm quaternions",
    ),
    "nan": (
        lambda h: change_surface(h, roughnessFactor=float("nan")),
        "roughnessFactor: must be a finite number",
    ),
    "range": (
        lambda h: change_surface(h, metallicFactor=7.0),
        "metallicFactor: must be <= 1",
    ),
    "bomb": (add_accessor, "accessors of .* are more than"),
    "view": (
        lambda h: h["bufferViews"][0].update(byteLength=1 << 40),
        "ends after its buffer",
    ),
    "extension": (
        lambda h: h.update(extensionsRequired=["KHR_draco"]),
        "requires KHR_draco, which",
    ),
    "sparse": (
        lambda h: h["accessors"][1].update(sparse={}),
        "POSITION is sparse, which twinlens cannot read",
    ),
    "texture": (
        shine,
        r"materials\[0\].emissiveTexture.index is 99, but the length of 'textures' is 0",
    ),
    "mesh": (
        lambda h: h["nodes"][-1].update(mesh=99),
        r"nodes\[0\].mesh is 99, but the length of 'meshes' is 1",
    ),
    "child": (
        lambda h: add_node(h, children=[7]),
        r"nodes\[1\].children\[0\] is 7, but the length of 'nodes' is 2",
    ),
    "accessor": (
        lambda h: h["meshes"][0]["primitives"][0]["attributes"].update(POSITION=99),
        r"meshes\[0\].primitives\[0\].attributes.POSITION is 99, but the length of 'accessors' is 3",
    ),
    "buffer": (
        lambda h: h["bufferViews"][0].update(buffer=3),
        r"bufferViews\[0\].buffer is 3, but the length of",
    ),
    "scene": (
        lambda h: h.update(scenes=[]),
        "scene is 0, but the length of 'scenes' is 0",
    ),
    "indices": (
        lambda h: h["meshes"][0]["primitives"][0].update(indices=1),
        r"meshes\[0\]: indices must be SCALAR, of unsigned integers",
    ),
    "version": (
        lambda h: h["asset"].update(version="1.0"),
        r"asset.version: must be 2.0, got '1.0'",
    ),
    "asset": (lambda h: h.pop("asset"), "missing key 'asset'"),
    "coordinates": (
        lambda h: (
            h["meshes"][0]["primitives"][0]["attributes"].pop("TEXCOORD_0")
            and shine(h, 0)
        ),
        r"material 'paint' has textures, but a part of the mesh has no texture coordinates \(set 0\)",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_headers_are_errors_of_one_line(tmp_path: Path, name: str) -> None:
    change, message = HOSTILE[name]
    write(tmp_path / "m.glb", square(), change)
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path / "m.glb")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "m.glb"))


@pytest.mark.parametrize("name", ["x" * 100_000, "\N{SNOWMAN}" * 200])
def test_long_names_are_errors_of_one_short_line(tmp_path: Path, name: str) -> None:
    (tmp_path / "m.obj").write_text(OBJ)
    (tmp_path / "m.mtl").write_text(MTL.replace("tiles.png", name))
    with pytest.raises(
        InputError, match=r"must be a file name relative|no file"
    ) as caught:
        read(tmp_path / "m.obj")
    assert len(str(caught.value)) < 500
    (tmp_path / "m.obj").write_text(OBJ.replace("red", name))
    with pytest.raises(InputError, match=r"m\.mtl|has no material") as caught:
        read(tmp_path / "m.obj")
    assert len(str(caught.value)) < 500


def test_a_picture_bomb_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "m.glb", square(baseColorTexture=picture(np.ones((8, 5, 3)))))
    monkeypatch.setattr("twinlens.scenes.assets._MOST_PIXELS", 39)
    with pytest.raises(
        FileError,
        match=r"m\.glb: images\[0\]: a picture may have 1 to 39 pixels, got 5x8",
    ):
        read(tmp_path / "m.glb")


@pytest.mark.parametrize("cases", [60, pytest.param(10_000, marks=pytest.mark.slow)])
def test_damaged_files_are_read_or_refused_in_one_line(
    tmp_path: Path, cases: int
) -> None:
    """Truncated, and with bytes changed, in the header more often than in the data."""
    texture = picture(np.random.default_rng(0).random((4, 4, 3)))
    path = write(
        tmp_path / "m.glb",
        square(
            baseColorTexture=texture, normalTexture=texture, emissiveFactor=[1, 1, 1]
        ),
    )
    whole, rng = path.read_bytes(), np.random.default_rng(1)
    messages = []
    for _ in range(cases):
        data = bytearray(whole)
        for _ in range(rng.integers(1, 5)):
            data[rng.integers(len(data) if rng.random() < 0.3 else len(data) // 2)] = (
                rng.integers(256)
            )
        path.write_bytes(
            data[: rng.integers(len(data))] if rng.random() < 0.2 else data
        )
        try:
            read(path)
        except InputError as error:
            messages.append(str(error))
        except MaterialWarning:
            pass
    assert len(messages) > cases // 3
    assert not any("\n" in message for message in messages)
    assert list(tmp_path.iterdir()) == [path]


def fuzz_header(cases: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.glb"
        texture = picture(np.random.default_rng(0).random((4, 4, 3)))
        part = square(
            baseColorTexture=texture,
            normalTexture=texture,
            emissiveFactor=[1, 1, 1],
            alphaMode="MASK",
        )
        write(
            path,
            part,
            with_extensions(ior={"ior": 1.4}, transmission={"transmissionFactor": 0.5}),
        )
        header, binary = unpacked(path.read_bytes())

        def read_changed(text: bytes) -> None:
            path.write_bytes(glb(json.loads(text), binary))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", MaterialWarning)
                mesh = read(path).mesh
            assert np.isfinite(mesh.vertices).all()
            assert mesh.faces.max() < len(mesh.vertices)

        fuzz(read_changed, other_values(json.dumps(header).encode()), cases)


@pytest.mark.parametrize("cases", [60, pytest.param(3_000, marks=pytest.mark.slow)])
def test_changed_headers_are_read_or_refused_in_one_line(
    in_process: Callable[..., None],  # noqa: F811
    cases: int,
) -> None:
    in_process(fuzz_header, cases)
