"""glTF and OBJ files in scene.toml: materials, node trees, axes and sizes; only files below the scene's folder."""

import json
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.transformations import rotation_matrix, translation_matrix

from tests.dataset.dataset_damage import damaged
from tests.dataset.test_fuzz import fuzz, in_process, other_values  # noqa: F401
from tests.scenes.gltf_files import (
    exported,
    glb,
    picture,
    png,
    square,
    with_extensions,
    with_values,
    write,
    write_colored,
)
from twinlens.errors import FileError, InputError
from twinlens.scenes.assets import SceneContext, read_mesh
from twinlens.scenes.gltf_materials import VERTEX_COLOR, Transform
from twinlens.scenes.materials import Bitmap, Color, VertexColor
from twinlens.scenes.model_files import MaterialWarning, read_model

OWN = "[objects.own]\nfile = 'm.glb'\n"
WHITE = picture(np.ones((2, 2, 3)))
GREY_PNG = png(np.full((2, 2, 3), 0.5))
GREY_LINEAR = ((128 / 255 + 0.055) / 1.055) ** 2.4
"""The texels of `GREY_PNG` in linear sRGB (IEC 61966-2-1)."""
TILT = np.array([0.6, 0.0, 0.8])
NORMAL_MAP = picture(np.tile((TILT + 1) / 2, (2, 2, 1)))


def read(path):
    return read_model(path, SceneContext(path.parent))


def material_of(path, *content):
    """The only material of a .glb file of `content`, as `write` takes it."""
    (material,) = read(write(path, *content)).materials.values()
    return material


@pytest.fixture
def glb_path(tmp_path):
    return tmp_path / "m.glb"


def test_a_file_has_its_own_material_size_and_up_axis(glb_path, read_scene):
    """12 mm stay 12 mm, and glTF's y axis becomes the world's z."""
    part = trimesh.creation.box([0.012, 0.03, 0.02])
    steel = trimesh.visual.material.PBRMaterial(name="steel", metallicFactor=1.0)
    part.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=steel)
    write(glb_path, part)
    y_up = read_scene(OWN).objects[-1]
    z_up = read_scene(OWN + "material = 'grey'\nup_axis = 'z'\n").objects[-1]
    assert y_up.materials == ("m.glb:steel",)
    assert z_up.materials == ("grey",)
    sizes = [np.ptp(part.shape.vertices, axis=0) for part in (y_up, z_up)]
    expected = [[0.012, 0.02, 0.03], [0.012, 0.03, 0.02]]
    np.testing.assert_allclose(sizes, expected, atol=1e-9)


def test_a_material_of_the_scene_replaces_those_of_the_file(glb_path, read_scene):
    """Nothing of the file's materials is read then, not even a damaged picture."""
    damaged_picture = {"images": [{"bufferView": 0}]}
    write(glb_path, square(baseColorTexture=WHITE), damaged_picture)
    scene = read_scene(OWN + "material = 'grey'\n")
    assert set(scene.materials) == {"grey"}
    message = r"objects.own: .*m\.glb: images\[0\] must be a \.png, \.jpg, \.bmp, \.tga"
    with pytest.raises(InputError, match=message):
        read_scene(OWN)


def test_other_mesh_files_need_a_material(tmp_path, read_scene):
    trimesh.creation.box().export(tmp_path / "m.ply")
    message = r"missing key 'material'; only \.glb, \.gltf, .*\.usdz, \.obj files have"
    with pytest.raises(InputError, match=message):
        read_scene("[objects.m]\nfile = 'm.ply'\n")


def test_vertices_without_a_normal_get_that_of_their_faces(glb_path):
    header, binary = exported(square(), include_normals=True)
    accessor = header["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    view = header["bufferViews"][header["accessors"][accessor]["bufferView"]]
    start = view["byteOffset"]
    no_normal = bytes(12)
    glb_path.write_bytes(glb(header, binary[:start] + no_normal + binary[start + 12 :]))
    np.testing.assert_allclose(read(glb_path).mesh.normals, [[0, 0, 1]] * 4, atol=1e-9)


def test_a_node_tree_with_several_materials_is_one_object(glb_path, read_scene):
    turned = translation_matrix([0, 0, 2.0]) @ rotation_matrix(np.pi / 2, [0, 1, 0])
    mirror = np.diag([-1.0, 1, 1, 1])
    scene = trimesh.Scene()
    red, blue = square(name="red"), square(name="blue")
    scene.add_geometry(red, node_name="a")
    scene.add_geometry(blue, node_name="b", parent_node_name="a", transform=turned)
    scene.add_geometry(red, node_name="c", parent_node_name="b", transform=mirror)
    write(glb_path, scene)
    tree = read_scene(f"{OWN}up_axis = 'z'\n").objects[-1]
    mesh, names = tree.shape, tree.materials
    assert {name.removesuffix("-2") for name in names} == {"m.glb:blue", "m.glb:red"}
    assert len(mesh.faces) == 6
    corners = mesh.vertices[mesh.faces]
    blue = corners[mesh.surface == names.index("m.glb:blue")].reshape(-1, 3)
    box = [blue.min(axis=0), blue.max(axis=0)]
    np.testing.assert_allclose(box, [[0, 0, 1.5], [0, 1, 2.5]], atol=1e-6)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(np.abs(cross).sum(axis=1), 1, atol=1e-6)
    normals = mesh.normals[mesh.faces[:, 0]]
    np.testing.assert_allclose(cross @ [1, 0, 1], normals @ [1, 0, 1], atol=1e-6)


def test_color_factor_and_srgb_texture_are_multiplied(glb_path):
    stored = np.zeros((2, 2, 3))
    stored[0, 1] = [0.5, 1.0, 0.0]
    factor = [1.0, 0.5, 0.2, 1.0]
    look = square(baseColorTexture=picture(stored), baseColorFactor=factor)
    color = material_of(glb_path, look).base_color.pixels
    np.testing.assert_allclose(color[0, 1], [GREY_LINEAR, 128 / 255, 0], atol=3e-3)
    assert not color[1].any()


def test_metalness_and_roughness_are_the_blue_and_the_green_channel(glb_path):
    stored = picture([[[1.0, 0.2, 0.0], [0.0, 0.8, 1.0]]])
    factors = {"roughnessFactor": 0.5, "metallicFactor": 1.0}
    material = material_of(glb_path, square(metallicRoughnessTexture=stored, **factors))
    np.testing.assert_allclose(material.roughness.pixels, [[0.1, 0.4]], atol=2e-3)
    np.testing.assert_allclose(material.metallic.pixels, [[0.0, 1.0]])
    assert material.base_color == Color((1.0, 1.0, 1.0))


def test_alpha_becomes_opacity(glb_path):
    stored = np.ones((1, 3, 4))
    stored[0, :, 3] = alpha = [0.2, 0.6, 1.0]
    modes = {"OPAQUE": (1.0, None), "MASK": ([alpha], 0.4), "BLEND": ([alpha], None)}
    for mode, (opacity, cutoff) in modes.items():
        look = square(baseColorTexture=picture(stored), alphaMode=mode, alphaCutoff=0.4)
        material = material_of(glb_path, look)
        assert material.alpha_cutoff == cutoff
        value = getattr(material.opacity, "pixels", material.opacity)
        np.testing.assert_allclose(value, opacity, atol=2e-3)


def test_emission_is_factor_times_strength(glb_path):
    strength = with_extensions(emissive_strength={"emissiveStrength": 8.0})
    material = material_of(glb_path, square(emissiveFactor=[1.0, 0.5, 0.0]), strength)
    assert material.emission == Color((8.0, 4.0, 0.0))


def test_sides_and_glass(glb_path):
    assert material_of(glb_path, square(doubleSided=True)).two_sided
    clear = square(metallicFactor=0.0, roughnessFactor=0.0)
    passing = {"transmission": {"transmissionFactor": 1.0}, "ior": {"ior": 1.33}}
    pane = material_of(glb_path, clear, with_extensions(**passing))
    assert pane.thin_walled
    assert (pane.transmission, pane.ior) == (1.0, 1.33)
    solid = with_extensions(volume={"thicknessFactor": 1.0}, **passing)
    assert not material_of(glb_path, clear, solid).thin_walled


def test_a_texture_transform_rotates_counter_clockwise_as_seen():
    """Coordinates (u, v up) -> (u, v down) of glTF by hand: the point right of the origin moves up by 90 degrees."""
    transform = Transform(offset=[0.25, 0.5], rotation=np.pi / 2, scale=[2.0, 1.0])
    u, v_down = 0.25, 0.0
    scaled = np.array([2 * u, v_down])
    turned = np.array([scaled[1], -scaled[0]])  # up is negative v
    expected = [turned[0] + 0.25, 1 - (turned[1] + 0.5), 1]
    moved = transform.matrix() @ [u, 1 - v_down, 1]
    np.testing.assert_allclose(moved, expected, atol=1e-12)


def test_a_normal_map_is_scaled_and_stays_unit_length(glb_path):
    twice = {"materials/0/normalTexture/scale": 2.0}
    material = material_of(glb_path, square(normalTexture=NORMAL_MAP), twice)
    normal = 2 * material.normal.pixels[0, 0] - 1
    expected = np.array([1.2, 0, 0.8]) / np.hypot(1.2, 0.8)
    np.testing.assert_allclose(normal, expected, atol=0.01)


@pytest.mark.parametrize("colored", [False, True])
def test_a_part_without_texture_coordinates_leaves_those_of_others(glb_path, colored):
    """All parts have the file's own normals, and the second one no TEXCOORD_0."""
    scene = trimesh.Scene()
    scene.add_geometry(square(baseColorTexture=picture(np.eye(3)[None])))
    bare = trimesh.creation.box([1, 1, 1])
    if colored:
        colors = np.round(255 * (bare.vertices + 0.5))
        bare.visual.vertex_colors = colors.astype(np.uint8)
    scene.add_geometry(bare, transform=translation_matrix([0, 0, 3]))
    header, binary = exported(scene, include_normals=True)
    header["materials"].append({"pbrMetallicRoughness": {"metallicFactor": 0.0}})
    first, second = (mesh["primitives"][0] for mesh in header["meshes"])
    second["material"] = len(header["materials"]) - 1
    glb_path.write_bytes(glb(header, binary))
    assert {"NORMAL", "TEXCOORD_0"} <= first["attributes"].keys()
    assert "NORMAL" in second["attributes"]
    assert "TEXCOORD_0" not in second["attributes"]
    mesh = read(glb_path).mesh
    places = mesh.faces.ravel()
    corners = mesh.vertices[places]
    textured = corners[:, 2] < 1
    expected = corners[textured, :2] + [0.5, 0]
    np.testing.assert_allclose(mesh.uv[places][textured], expected, atol=1e-6)
    if colored:
        colors = mesh.attributes[VERTEX_COLOR.attribute][places, :3]
        expected = corners[~textured] - [-0.5, -0.5, 2.5]
        np.testing.assert_allclose(colors[~textured], expected, atol=1e-5)


def test_a_file_without_a_scene_has_its_nodes(glb_path):
    child = {"mesh": 0, "translation": [0, 0, 1]}
    parent = {"children": [0], "scale": [2, 2, 2]}
    values = {"scene": None, "scenes": None, "nodes": [child, parent]}
    mesh = read(write(glb_path, square(), values)).mesh
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [1, 2, 2], atol=1e-6)


FACTOR = [0.2, 0.4, 0.8]
COLORS = np.array([[1, 0, 0, 1], [0, 1, 0, 0.5], [0, 0, 1, 0], [1, 1, 1, 1]])


@pytest.mark.parametrize("channels", [3, 4])
def test_vertex_colors_are_mesh_attributes(glb_path, channels):
    """With opacity if they have four channels."""
    mode = {3: "OPAQUE", 4: "BLEND"}[channels]
    colors = COLORS[:, :channels]
    write_colored(glb_path, colors, alphaMode=mode, baseColorFactor=[*FACTOR, 0.2])
    model = read(glb_path)
    (material,) = model.materials.values()
    assert material.base_color == VertexColor("color", Color(tuple(FACTOR)))
    assert material.opacity == (1.0 if channels == 3 else VertexColor("color", 0.2))
    values = model.mesh.attributes[VERTEX_COLOR.attribute][:, :channels]
    np.testing.assert_allclose(values, colors, atol=1e-6)


def test_a_texture_is_a_factor_of_colors_of_vertices(glb_path):
    """Colours that are all white are none."""

    def color():
        (material,) = read(glb_path).materials.values()
        return material.base_color

    write_colored(glb_path, np.ones((4, 3)), baseColorTexture=WHITE)
    assert isinstance(color(), Bitmap)
    write_colored(glb_path, COLORS, baseColorTexture=WHITE)
    assert isinstance(color(), VertexColor)
    assert isinstance(color().factor, Bitmap)


@pytest.mark.parametrize(
    ("modes", "expected"),
    [
        ((10497, 33071), ("repeat", "clamp")),
        ((33648, 10497), ("mirror", "repeat")),
        ((33071, 33648), ("clamp", "mirror")),
        ((33071, 33071), "clamp"),
    ],
)
def test_textures_are_wrapped_along_each_axis(glb_path, modes, expected):
    values = {
        "samplers": [dict(zip(("wrapS", "wrapT"), modes, strict=True))],
        "textures/0/sampler": 0,
    }
    model = read(write(glb_path, square(baseColorTexture=WHITE), values))
    (material,) = model.materials.values()
    assert material.base_color.wrap == expected


def test_normal_maps_are_there_twice_where_texture_coordinates_are_mirrored(glb_path):
    """Two squares, the second one with u from right to left; both share all other maps."""
    color = picture(np.eye(3)[None])
    scene = trimesh.Scene()
    for height, mirror in enumerate(([1, 1], [-1, 1])):
        part = square(normalTexture=NORMAL_MAP, baseColorTexture=color)
        part.visual.uv = part.visual.uv * mirror + [height, 0]
        scene.add_geometry(part, transform=translation_matrix([0, 0, height]))
    one_material = {f"meshes/{i}/primitives/0/material": 0 for i in range(2)}
    model = read(write(glb_path, scene, one_material))
    assert list(model.materials) == ["m.glb:paint", "m.glb:paint-2"]
    upright, flipped = model.materials.values()
    assert (upright.mirrored, flipped.mirrored) == (False, True)
    assert upright.base_color is flipped.base_color
    assert upright.normal is flipped.normal
    heights = model.mesh.vertices[model.mesh.faces[:, 0], 2]
    np.testing.assert_array_equal(model.mesh.surface, heights > 0.5)


def test_what_cannot_be_rendered_is_named_in_one_line(glb_path):
    header, binary = exported(square())
    triangles = header["meshes"][0]["primitives"][0]
    points = {**triangles, "mode": 0}
    values = {
        **with_extensions(sheen={"sheenColorFactor": [1, 1, 1]}, anisotropy={}),
        "meshes/0/primitives": [{**triangles, "targets": [{}]}, points],
        "meshes/0/primitives/0/attributes/TEXCOORD_1": 2,
        "meshes/0/primitives/0/attributes/COLOR_1": 1,
        "nodes/0/skin": 0,
        "nodes/0/camera": 0,
        "cameras": [{"type": "perspective"}],
        "animations": [{"channels": [], "samplers": []}],
        "nodes/0/extensions/MSFT_lod": {},
        "extensions/KHR_lights_punctual": {"lights": []},
    }
    glb_path.write_bytes(glb(with_values(header, values), binary))
    with pytest.warns(MaterialWarning) as caught:
        assert len(read(glb_path).mesh.faces) == 2
    geometry = (
        "points and lines (left out), morph targets (the mesh without them), skins (the mesh as its nodes place it), "
        "animations (the pose of the nodes), cameras (those of the scene), COLOR_1 (not used), TEXCOORD_1 (not used), "
        "KHR_lights_punctual, MSFT_lod"
    )
    material = "KHR_materials_anisotropy, KHR_materials_sheen"
    (message,) = (str(warning.message) for warning in caught)
    assert message == f"{glb_path}: not rendered: {geometry}, {material}"


def test_the_files_that_a_file_names_have_a_common_limit(tmp_path, monkeypatch):
    """A header of some bytes could name a large file a thousand times."""
    header, binary = exported(square())
    (tmp_path / "m.bin").write_bytes(binary)
    path = tmp_path / "m.gltf"
    path.write_text(json.dumps({**header, "buffers": [{"uri": "m.bin"}] * 3}))
    read(path)
    limit = "twinlens.scenes.model_files.LARGEST_MESH_FILE"
    monkeypatch.setattr(limit, 3 * len(binary) - 1)
    message = r"m\.gltf: .*m\.bin: the file is larger than 0 MiB"
    with pytest.raises(FileError, match=message):
        read(path)


def files_of(scene, folder):
    return {path.relative_to(folder).as_posix() for path in scene.files}


def test_a_gltf_file_names_its_neighbours(tmp_path, read_scene):
    header, binary = exported(square(baseColorTexture=WHITE))
    (tmp_path / "parts").mkdir()
    names = ["parts/m.gltf", "parts/m.bin", "parts/white space.png"]
    gltf, buffer, image = (tmp_path / name for name in names)
    image.write_bytes(GREY_PNG)
    buffer.write_bytes(binary)
    uris = {"buffers/0/uri": "m.bin", "images": [{"uri": "white%20space.png"}]}
    gltf.write_text(json.dumps(with_values(header, uris)))
    scene = read_scene("[objects.own]\nfile = 'parts/m.gltf'\n")
    assert files_of(scene, tmp_path) == {"scene.toml", *names}


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


def write_obj(folder, obj=OBJ, mtl=MTL):
    """An .obj file, its materials and their picture."""
    (folder / "m.mtl").write_text(mtl)
    (folder / "tiles.png").write_bytes(GREY_PNG)
    path = folder / "m.obj"
    path.write_text(obj)
    return path


def test_an_obj_has_the_materials_of_its_mtl_file(tmp_path, read_scene):
    write_obj(tmp_path)
    scene = read_scene("[objects.own]\nfile = 'm.obj'\n")
    part = scene.objects[-1]
    assert part.materials == ("m.obj:red", "m.obj:tiles")
    assert part.shape.surface.tolist() == [0, 1]
    size = np.ptp(part.shape.vertices, axis=0)
    assert size.tolist() == [1, 1, 0]  # OBJ has no up axis: z, as it was
    red, tiles = (scene.materials[name] for name in part.materials)
    np.testing.assert_allclose(tiles.base_color.pixels, GREY_LINEAR, rtol=1e-6)
    assert tiles.specular == 0.0
    assert red.roughness == pytest.approx((2 / 12) ** 0.25)
    assert red.emission == Color((4.0, 2.0, 0.0))
    files = {"scene.toml", "m.obj", "m.mtl", "tiles.png"}
    assert files_of(scene, tmp_path) == files


def test_an_obj_may_have_faces_without_area(tmp_path):
    path = write_obj(tmp_path, OBJ + "usemtl red\nf 1/1 1/1 4/1\n")
    assert len(read(path).mesh.faces) == 3


@pytest.mark.parametrize(
    ("face", "message"),
    [
        ("f 0/1 2/2 3/3", "a face has the vertex number 0; OBJ counts from 1"),
        ("f 1/1 2/0 3/3", "a face has the vertex number 0; OBJ counts from 1"),
    ],
)
@pytest.mark.parametrize("reader", [read, read_mesh])
def test_vertex_numbers_that_would_be_misread_are_errors(
    tmp_path, reader, face, message
):
    path = write_obj(tmp_path, OBJ.replace("f 1/1 2/2 3/3", face))
    with pytest.raises(FileError, match=f"m.obj: {message}"):
        reader(path)


def test_keys_of_a_mtl_file_that_are_not_rendered_are_named(tmp_path):
    others = "bump -bm 2 b.png\nmap_Ns d.png\nKs 1 0.5 0.5\n"
    path = write_obj(tmp_path, mtl=MTL.replace("map_Kd", "map_Ks") + others)
    lost = r"m\.obj: not rendered: bump, map_ks, map_ns, the colour of Ks$"
    with pytest.warns(MaterialWarning, match=lost):
        read(path)


def test_files_in_other_folders_of_the_scene_are_found(tmp_path, read_scene):
    """Names in an .obj and an .mtl file are relative to the folder of each."""
    names = ["m/o/m.obj", "parts/m.mtl", "pictures/tiles.png"]
    obj, mtl, tiles = (tmp_path / name for name in names)
    for path in (obj, mtl, tiles):
        path.parent.mkdir(parents=True)
    obj.write_text(OBJ.replace("m.mtl", "../../parts/m.mtl"))
    mtl.write_text(MTL.replace("tiles.png", "../pictures/tiles.png"))
    tiles.write_bytes(GREY_PNG)
    own = "[objects.own]\nfile = 'm/o/m.obj'\n"
    assert files_of(read_scene(own), tmp_path) == {"scene.toml", *names}
    for name in ("../../../secret.mtl", "../../../parts/m.mtl"):
        obj.write_text(OBJ.replace("m.mtl", name))
        with pytest.raises(InputError, match=r"leads outside the folder '"):
            read_scene(own)


OUTSIDE = "../secret.png /etc/hostname link.png http://a.b/c.png C:/x.png a\\..\\..\\secret.png"


@pytest.mark.parametrize("name", OUTSIDE.split())
@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_files_outside_the_folder_are_refused(tmp_path, read_scene, suffix, name):
    secret = tmp_path.parent / "secret.png"
    secret.write_bytes(GREY_PNG)
    (tmp_path / "link.png").symlink_to(secret)
    write_obj(tmp_path, mtl=MTL.replace("tiles.png", name))
    image = {"images": [{"uri": name}]}
    write(tmp_path / "m.glb", square(baseColorTexture=WHITE), image)
    reasons = "leads outside|must be a file name|web addresses"
    with pytest.raises(InputError, match=rf"objects.own: .*({reasons})") as caught:
        read_scene(f"[objects.own]\nfile = 'm{suffix}'\n")
    assert "\n" not in str(caught.value)


HUGE = {"componentType": 5126, "count": 1 << 40, "type": "VEC4"}
SURFACE = "materials/0/pbrMetallicRoughness"
PRIMITIVE = "meshes/0/primitives/0"
HOSTILE = {
    "nodes": ({"nodes": [{"mesh": 0}] * 100_000}, "nodes: must be a list of at most 50000"),
    "loop": ({"nodes": [{"mesh": 0, "children": [0]}]}, "has two parents"),
    "materials": ({"materials": [{}] * 10_001}, "materials: must be a list of at most 10000"),
    "pose": ({"nodes": [{"scale": [1e200] * 3, "children": [1]}, {"scale": [1e200] * 3}]}, "has no finite pose"),
    "rotation": ({"nodes/0/rotation": [0, 0, 0, 0]}, "zero norm quaternions"),
    "nan": ({f"{SURFACE}/roughnessFactor": float("nan")}, "roughnessFactor: must be a finite number"),
    "range": ({f"{SURFACE}/metallicFactor": 7.0}, "metallicFactor: must be <= 1"),
    "bomb": ({"nodes": [{}], "accessors": [HUGE] * 3}, "accessors of .* are more than"),
    "view": ({"bufferViews/0/byteLength": 1 << 40}, "ends after its buffer"),
    "extension": ({"extensionsRequired": ["KHR_draco"]}, "requires KHR_draco, which"),
    "sparse": ({"accessors/1/sparse": {}}, r"accessors\[1\].sparse: missing keys 'count', 'indices', 'values'"),
    "texture": (
        {"materials/0/emissiveTexture": {"index": 99}, "materials/0/emissiveFactor": [1, 1, 1]},
        r"materials\[0\].emissiveTexture.index is 99, but the length of 'textures' is 0",
    ),
    "mesh": ({"nodes/0/mesh": 99}, r"nodes\[0\].mesh is 99, but the length of 'meshes' is 1"),
    "child": ({"nodes/0/children": [7]}, r"nodes\[0\].children\[0\] is 7, but the length of 'nodes' is 1"),
    "accessor": (
        {f"{PRIMITIVE}/attributes/POSITION": 99},
        r"meshes\[0\].primitives\[0\].attributes.POSITION is 99, but the length of 'accessors' is 3",
    ),
    "buffer": ({"bufferViews/0/buffer": 3}, r"bufferViews\[0\].buffer is 3, but the length of"),
    "scene": ({"scenes": []}, "scene is 0, but the length of 'scenes' is 0"),
    "indices": ({f"{PRIMITIVE}/indices": 1}, r"meshes\[0\]: indices must be SCALAR, of unsigned integers"),
    "version": ({"asset/version": "1.0"}, r"asset.version: must be 2.0, got '1.0'"),
    "asset": ({"asset": None}, "missing key 'asset'"),
    "coordinates": (
        {f"{PRIMITIVE}/attributes/TEXCOORD_0": None, "materials/0/emissiveTexture": {"index": 0}, "textures": [{}]},
        r"material 'paint' has textures, but a part of the mesh has no texture coordinates \(set 0\)",
    ),
}  # fmt: skip
"""Changes of the header, and the message."""


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_headers_are_errors_of_one_line(tmp_path, name):
    values, message = HOSTILE[name]
    write(tmp_path / "m.glb", square(), values)
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path / "m.glb")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "m.glb"))


@pytest.mark.parametrize("name", ["x" * 100_000, "\N{SNOWMAN}" * 200])
def test_long_names_are_errors_of_one_short_line(tmp_path, name):
    picture_name = {"mtl": MTL.replace("tiles.png", name)}
    material_name = {"obj": OBJ.replace("red", name)}
    for texts in (picture_name, material_name):
        path = write_obj(tmp_path, **texts)
        reasons = r"must be a file name relative|no file|m\.mtl|has no material"
        with pytest.raises(InputError, match=reasons) as caught:
            read(path)
        assert len(str(caught.value)) < 500


def test_a_picture_bomb_is_refused(glb_path, monkeypatch):
    write(glb_path, square(baseColorTexture=picture(np.ones((8, 5, 3)))))
    monkeypatch.setattr("twinlens.scenes.assets._MOST_PIXELS", 39)
    message = r"m\.glb: images\[0\]: a picture may have 1 to 39 pixels, got 5x8"
    with pytest.raises(FileError, match=message):
        read(glb_path)


def fuzz_file(cases):
    """Damaged bytes, or a header with other values; what is read is a mesh, and no file is left."""
    texture = picture(np.random.default_rng(0).random((4, 4, 3)))
    maps = {"baseColorTexture": texture, "normalTexture": texture}
    part = square(emissiveFactor=[1, 1, 1], alphaMode="MASK", **maps)
    factors = {"ior": {"ior": 1.4}, "transmission": {"transmissionFactor": 0.5}}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.glb"
        write(path, part, with_extensions(**factors))
        header, binary = exported(part)
        header = with_values(header, with_extensions(**factors))
        whole = path.read_bytes()

        def read_changed(data):
            path.write_bytes(data)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", MaterialWarning)
                mesh = read(path).mesh
            assert np.isfinite(mesh.vertices).all()
            assert mesh.faces.max() < len(mesh.vertices)

        texts = other_values(json.dumps(header).encode())
        headers = texts.map(lambda text: glb(json.loads(text), binary))
        fuzz(read_changed, damaged(whole) | headers, cases)
        assert list(Path(folder).iterdir()) == [path]


@pytest.mark.parametrize("cases", [100, pytest.param(10_000, marks=pytest.mark.slow)])
def test_damaged_files_are_read_or_refused_in_one_line(in_process, cases):  # noqa: F811
    in_process(fuzz_file, cases)
