"""Forms that glTF files have besides lists of float32: sparse, quantized, compressed, strips and fans.

The right values are those of the same model saved plainly, or of another library.
"""

import json
import struct
import sys
from io import BytesIO
from pathlib import Path

import DracoPy
import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import cKDTree
from shapely import Polygon

from tests.scenes.gltf_files import (
    exported,
    glb,
    picture,
    square,
    with_values,
)
from twinlens.errors import FileError, MissingExtraError
from twinlens.scenes.assets import SceneContext, linear_from_srgb
from twinlens.scenes.model_files import read_model

FORMS = Path(__file__).parent / "gltf_forms"
BYTE, UNSIGNED_BYTE, SHORT, UNSIGNED_SHORT = range(5120, 5124)
UNSIGNED_INT, FLOAT = 5125, 5126
CODES = {
    BYTE: "i1",
    UNSIGNED_BYTE: "u1",
    SHORT: "<i2",
    UNSIGNED_SHORT: "<u2",
    UNSIGNED_INT: "<u4",
    FLOAT: "<f4",
}


def read(path):
    return read_model(path, SceneContext(path.parent))


def of_faces(model):
    """The mean position, texture coordinates of the picture, and normal of each triangle, and the picture."""
    [material] = model.materials.values()
    to_uv = material.base_color.to_uv[np.ix_([0, 1, 3], [0, 1, 3])]
    mesh = model.mesh
    uv = np.column_stack([mesh.uv, np.ones(len(mesh.uv))]) @ to_uv.T
    means = [
        values[mesh.faces].mean(axis=1) for values in (mesh.vertices, uv, mesh.normals)
    ]
    return *means, material.base_color.pixels


@pytest.mark.parametrize("name", sorted(path.name for path in FORMS.glob("g*.glb")))
def test_a_compressed_file_has_the_mesh_of_the_plain_one(name):
    """Within half a step of 14 bits of 0.3 m for positions, 12 bits of 3 for (u, v) and 8 bits for normals."""
    centres, uv, normals, pixels = of_faces(read(FORMS / "plain.glb"))
    made = of_faces(read(FORMS / name))
    distances, nearest = cKDTree(centres).query(made[0])
    assert sorted(nearest) == list(range(48))
    assert distances.max() < np.sqrt(3) / 2 * 0.3 / (2**14 - 1)
    np.testing.assert_allclose(made[1], uv[nearest], atol=0.5 * 3 / (2**12 - 1))
    np.testing.assert_allclose(made[2], normals[nearest], atol=1 / 127)
    np.testing.assert_array_equal(made[3], pixels)


@pytest.mark.parametrize(
    ("module", "name"),
    [("DracoPy", "gltf-transform-draco.glb"), ("meshopt", "gltfpack-cz.glb")],
)
def test_a_missing_library_is_named_with_its_extra(monkeypatch, module, name):
    monkeypatch.setitem(sys.modules, module, None)
    message = rf"{name}: {module} is not installed; pip install 'twinlens\[gltf\]'"
    with pytest.raises(MissingExtraError, match=message):
        read(FORMS / name)


GRID = np.array([[x, y, x * y / 9] for y in range(4) for x in range(4)], np.float32)
CELLS = np.array([i for i in range(11) if i % 4 < 3])[:, None]
GRID_FACES = np.vstack([np.add(CELLS, [0, 1, 5]), np.add(CELLS, [0, 5, 4])]).astype(
    np.uint32
)
DRACO = {
    "sequential": {"compression_level": 0},
    "edgebreaker": {"compression_level": 1},
    "valence": {"compression_level": 10},
    "ordered": {"preserve_order": True},
    "metadata": {
        "create_metadata": True,
        "generic_attributes": {"a": GRID, "bc": GRID},
    },
}


def draco_glb(data, vertices=16, indices=54):
    accessor = {"componentType": FLOAT, "type": "VEC3", "count": vertices}
    numbers = {"componentType": UNSIGNED_INT, "type": "SCALAR", "count": indices}
    extension = {"bufferView": 0, "attributes": {"POSITION": 0}}
    primitive = {
        "attributes": {"POSITION": 0},
        "indices": 1,
        "extensions": {"KHR_draco_mesh_compression": extension},
    }
    header = {
        "asset": {"version": "2.0"},
        "extensionsRequired": ["KHR_draco_mesh_compression"],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "accessors": [accessor, numbers],
        "meshes": [{"primitives": [primitive]}],
    }
    return glb(header, data)


@pytest.mark.parametrize("form", DRACO)
def test_draco_data_are_decoded(tmp_path, form):
    """The area of a grid of 3 x 3 cells by all methods of connectivity, within the rounding to 14 bits."""
    data = DracoPy.encode(GRID, GRID_FACES, **DRACO[form])
    path = tmp_path / "m.glb"
    path.write_bytes(draco_glb(data))
    mesh = read(path).mesh
    expected = trimesh.Trimesh(GRID, GRID_FACES).area
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).area == pytest.approx(
        expected, rel=1e-3
    )


@pytest.mark.parametrize(
    ("form", "counts", "message"),
    [
        *((form, {"indices": 51}, "have 18 triangles, its accessor 17") for form in DRACO),
        ("sequential", {"vertices": 15}, "have 16 vertices, its accessor 15"),
        ("ordered", {"vertices": 3}, "have 16 vertices, its accessor 3"),
        ("cloud", {"vertices": 15}, "have 16 vertices, its accessor 15"),
    ],
)  # fmt: skip
def test_draco_data_larger_than_their_accessors_are_not_decoded(
    tmp_path, monkeypatch, form, counts, message
):
    faces = None if form == "cloud" else GRID_FACES
    data = DracoPy.encode(GRID, faces, **DRACO.get(form, {}))
    refused_unread(tmp_path, monkeypatch, draco_glb(data, **counts), message)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"", "the Draco data end early"),
        (lambda data: data[:12], "the Draco data end early"),
        (lambda data: b"draco" + data[5:], "not Draco data"),
        (lambda data: data[:6] + b"\1" + data[7:], r"Draco 2\.1 is not 2\.2"),
        (lambda data: data[:12] + b"\xff" * 20, "more than 64 bits"),
        # The header alone declares 2^28 - 1 triangles.
        (lambda data: data[:13] + b"\xff\xff\xff\x7f", "have 268435455 triangles"),
    ],
)
def test_damaged_draco_data_are_not_decoded(tmp_path, monkeypatch, change, message):
    data = change(DracoPy.encode(GRID, GRID_FACES))
    refused_unread(tmp_path, monkeypatch, draco_glb(data), message)


def refused_unread(tmp_path, monkeypatch, content, message):
    monkeypatch.setattr("DracoPy.decode", lambda data: pytest.fail("was decoded"))
    path = tmp_path / "m.glb"
    path.write_bytes(content)
    with pytest.raises(FileError, match=rf"m\.glb: .*{message}"):
        read(path)


class Binary:
    """A binary chunk with its views and accessors."""

    def __init__(self):
        self.data = b""
        self.views = []
        self.accessors = []

    def view(self, array):
        self.data += bytes(-len(self.data) % 4)
        size = len(array.tobytes())
        self.views.append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": size}
        )
        self.data += array.tobytes()
        return len(self.views) - 1

    def accessor(self, values, kind, code=FLOAT, **keys):
        array = np.asarray(values).astype(CODES[code])
        table = {"componentType": code, "count": len(array), "type": kind, **keys}
        self.accessors.append({"bufferView": self.view(array), **table})
        return len(self.accessors) - 1

    def write(self, path, *primitives, **more):
        header = {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": len(self.data)}],
            "bufferViews": self.views,
            "accessors": self.accessors,
            "meshes": [{"primitives": list(primitives)}],
            **more,
        }
        path.write_bytes(glb(header, self.data))
        return path


def area(mesh):
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return cross.sum(axis=0) / 2


OUTLINE = np.array([[0, 0, 0], [3, 0, 0], [4, 2, 0], [2, 4, 0], [-1, 2, 0]])


@pytest.mark.parametrize("code", [UNSIGNED_BYTE, UNSIGNED_SHORT, UNSIGNED_INT, None])
def test_a_fan_covers_its_polygon_and_faces_as_it_does(tmp_path, code):
    binary = Binary()
    primitive = {
        "mode": 6,
        "attributes": {"POSITION": binary.accessor(OUTLINE, "VEC3")},
    }
    if code is not None:
        primitive["indices"] = binary.accessor(np.arange(5), "SCALAR", code)
    mesh = read(binary.write(tmp_path / "m.glb", primitive)).mesh
    assert len(mesh.faces) == 3
    np.testing.assert_allclose(area(mesh), [0, 0, Polygon(OUTLINE[:, :2]).area])


@pytest.mark.parametrize(
    "strip", [[0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 3, 4, 4, 4, 5, 6, 7], [2, 0, 1]]
)
def test_a_strip_has_the_triangles_of_trimesh(tmp_path, strip):
    rng = np.random.default_rng(3)
    points = np.float32(rng.random((8, 3)))
    binary = Binary()
    attributes = {"POSITION": binary.accessor(points, "VEC3")}
    indices = binary.accessor(strip, "SCALAR", UNSIGNED_BYTE)
    primitive = {"mode": 5, "attributes": attributes, "indices": indices}
    mesh = read(binary.write(tmp_path / "m.glb", primitive)).mesh
    faces = trimesh.util.triangle_strips_to_faces([np.array(strip)])
    other = trimesh.Trimesh(points, faces, process=False)
    other.update_faces(other.area_faces > 0)
    assert len(mesh.faces) == len(other.faces)
    np.testing.assert_allclose(
        mesh.vertices[mesh.faces].mean(axis=1), other.triangles_center, atol=1e-6
    )


@pytest.mark.parametrize(
    ("code", "most", "normalized"),
    [
        (UNSIGNED_BYTE, 255, True),
        (UNSIGNED_SHORT, 65535, True),
        (SHORT, 32767, True),
        (UNSIGNED_SHORT, 1, False),
    ],
)
def test_texture_coordinates_may_be_integers(tmp_path, code, most, normalized):
    binary = Binary()
    stored = np.round(np.array([[0, 1], [1, 1], [1, 0]]) * most)
    primitive = {
        "material": 0,
        "attributes": {
            "POSITION": binary.accessor(OUTLINE[:3], "VEC3"),
            "TEXCOORD_0": binary.accessor(stored, "VEC2", code, normalized=normalized),
        },
    }
    mesh = read(binary.write(tmp_path / "m.glb", primitive, materials=[{}])).mesh
    np.testing.assert_allclose(mesh.uv, [[0, 0], [1, 0], [1, 1]], atol=1e-12)


@pytest.mark.parametrize(
    ("code", "factor", "normalized"),
    [
        (BYTE, 1 / 127, True),
        (UNSIGNED_BYTE, 1 / 255, True),
        (SHORT, 1, False),
        (UNSIGNED_SHORT, 1 / 65535, True),
    ],
)
def test_positions_may_be_integers(tmp_path, code, factor, normalized):
    binary = Binary()
    points = np.array([[0, 0, 0], [100, 0, 0], [0, 50, 120]])
    position = binary.accessor(points, "VEC3", code, normalized=normalized)
    primitive = {"attributes": {"POSITION": position}}
    used = ["KHR_mesh_quantization"]
    path = binary.write(tmp_path / "m.glb", primitive, extensionsRequired=used)
    np.testing.assert_allclose(read(path).mesh.vertices, points * factor, rtol=1e-12)


@pytest.mark.parametrize("code", [UNSIGNED_BYTE, UNSIGNED_SHORT, UNSIGNED_INT])
@pytest.mark.parametrize("is_based", [True, False])
def test_sparse_positions_and_indices(tmp_path, code, is_based):
    """Rows 1 and 3 are replaced; without a view the others are 0."""
    binary = Binary()
    base = np.arange(12.0).reshape(4, 3)
    position = binary.accessor(base, "VEC3")
    rows = binary.view(np.array([1, 3]).astype(CODES[code]))
    values = binary.view(np.float32([[5, 6, 7], [1, 9, 3]]))
    binary.accessors[position]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": rows, "componentType": code},
        "values": {"bufferView": values},
    }
    if not is_based:
        del binary.accessors[position]["bufferView"]
    numbers = binary.accessor([0, 1, 1], "SCALAR", UNSIGNED_SHORT)
    third = {
        "bufferView": binary.view(np.array([2], "u1")),
        "componentType": UNSIGNED_BYTE,
    }
    three = {"bufferView": binary.view(np.array([3], "<u2"))}
    binary.accessors[numbers]["sparse"] = {
        "count": 1,
        "indices": third,
        "values": three,
    }
    primitive = {"attributes": {"POSITION": position}, "indices": numbers}
    mesh = read(binary.write(tmp_path / "m.glb", primitive)).mesh
    expected = [base[0] * is_based, [5, 6, 7], [1, 9, 3]]
    np.testing.assert_allclose(mesh.vertices[mesh.faces[0]], expected)


def test_a_sparse_row_beyond_the_accessor_is_an_error(tmp_path):
    binary = Binary()
    position = binary.accessor(OUTLINE[:3], "VEC3")
    rows = {
        "bufferView": binary.view(np.array([3], "u1")),
        "componentType": UNSIGNED_BYTE,
    }
    values = {"bufferView": binary.view(np.float32([[5, 6, 7]]))}
    binary.accessors[position]["sparse"] = {
        "count": 1,
        "indices": rows,
        "values": values,
    }
    path = binary.write(tmp_path / "m.glb", {"attributes": {"POSITION": position}})
    with pytest.raises(
        FileError,
        match=r"meshes\[0\]: accessors\[0\].sparse: index 3, but its count is 3",
    ):
        read(path)


def with_picture(data, extension, is_only):
    """A square whose texture is a picture of an extension, and a black .png one for other programs unless `is_only`."""
    header, binary = exported(square(baseColorTexture=picture(np.zeros((2, 2, 3)))))
    binary += bytes(-len(binary) % 4)
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)}
    texture = {"extensions": {extension: {"source": 1}}}
    if not is_only:
        texture["source"] = 0
    values = {
        "bufferViews": [*header["bufferViews"], view],
        "images": [*header["images"], {"bufferView": len(header["bufferViews"])}],
        "textures": [texture],
        "buffers": [{"byteLength": len(binary) + len(data)}],
        **({"extensionsRequired": [extension]} if is_only else {}),
    }
    return glb(with_values(header, values), binary + data)


@pytest.mark.parametrize("is_only", [True, False])
def test_a_webp_picture_goes_before_its_substitute(tmp_path, is_only):
    colors = np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 1.0]]])
    stream = BytesIO()
    picture(colors).save(stream, format="WEBP", lossless=True)
    path = tmp_path / "m.glb"
    path.write_bytes(with_picture(stream.getvalue(), "EXT_texture_webp", is_only))
    [material] = read(path).materials.values()
    np.testing.assert_array_equal(material.base_color.pixels, colors)


KTX2 = Path(__file__).parent / "ktx2"
BASISU = "KHR_texture_basisu"


@pytest.mark.parametrize("name", sorted(path.stem for path in KTX2.glob("*.ktx2")))
def test_a_ktx2_picture_has_the_texels_of_basisu(tmp_path, name):
    path = tmp_path / "m.glb"
    data = with_picture((KTX2 / f"{name}.ktx2").read_bytes(), BASISU, True)
    header, binary = parts_of(data)
    blended = {"materials/0/alphaMode": "BLEND"}
    path.write_bytes(glb(with_values(header, blended), binary))
    [material] = read(path).materials.values()
    with Image.open(KTX2 / f"{name}.png") as stored:
        right = np.asarray(stored.convert("RGBA")) / 255
    colors = linear_from_srgb(right[..., :3])
    np.testing.assert_allclose(material.base_color.pixels, colors, atol=1e-6)
    # basisu unpacks the alpha of ETC1S by way of another code, which rounds.
    np.testing.assert_allclose(material.opacity.pixels, right[..., 3], atol=1.01 / 255)


def parts_of(data):
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def test_a_ktx2_picture_goes_after_one_without_loss(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    path = tmp_path / "m.glb"
    path.write_bytes(with_picture((KTX2 / "uastc.ktx2").read_bytes(), BASISU, False))
    [material] = read(path).materials.values()
    assert not material.base_color.pixels.any()


def test_a_ktx2_picture_names_the_library_that_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    path = tmp_path / "m.glb"
    path.write_bytes(with_picture((KTX2 / "etc1s.ktx2").read_bytes(), BASISU, True))
    message = r"m\.glb: opengl_basisu is not installed; pip install 'twinlens\[gltf\]'"
    with pytest.raises(MissingExtraError, match=message):
        read(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:16], r"images\[1\] ends within its header"),
        (lambda data: data[:200], r"images\[1\]: "),
        (lambda data: data[:20] + b"\xff\xff\xff\x7f" + data[24:], "may have 1 to"),
        # Its format is VK_FORMAT_R8G8B8A8_SRGB, texels without Basis Universal.
        (lambda data: data[:12] + b"\x2b\0\0\0" + data[16:], r"images\[1\]: "),
    ],
)
def test_a_damaged_ktx2_picture_is_refused(tmp_path, change, message):
    path = tmp_path / "m.glb"
    data = change((KTX2 / "uastc.ktx2").read_bytes())
    path.write_bytes(with_picture(data, BASISU, True))
    with pytest.raises(FileError, match=message):
        read(path)
