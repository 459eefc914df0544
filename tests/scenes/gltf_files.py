"""Writes glTF files for tests: trimesh's exporter, and changes of the header that it cannot write."""

import copy
import json
import struct
from io import BytesIO

import numpy as np
import trimesh
from PIL import Image

SQUARE = [[-0.5, 0, 0], [0.5, 0, 0], [0.5, 1, 0], [-0.5, 1, 0]]
SQUARE_UV = [[0.0, 0.0], [1, 0], [1, 1], [0, 1]]


def square(**material):
    """A square of 1 m in the plane z = 0 of the file, facing +z, its texture upright along +y."""
    visual = trimesh.visual.TextureVisuals(
        uv=SQUARE_UV,
        material=trimesh.visual.material.PBRMaterial(**({"name": "paint"} | material)),
    )
    return trimesh.Trimesh(SQUARE, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)


def picture(texels):
    """An 8-bit picture of texels (H, W, C) in [0, 1], stored as given."""
    return Image.fromarray(np.round(255 * np.asarray(texels)).astype(np.uint8))


def png(texels):
    stream = BytesIO()
    picture(texels).save(stream, format="PNG")
    return stream.getvalue()


def glb(header, binary):
    """A .glb file of a header and a binary chunk. Source: glTF 2.0, chapter 4."""
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    start = struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A)
    return start + text + struct.pack("<II", len(binary), 0x004E4942) + binary


def unpacked(data):
    """The header and the binary chunk of a .glb file that trimesh wrote."""
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[20 + size + 8 :]


def with_values(header, values):
    """A header with the values of paths such as "materials/0/name"; None removes a key."""
    header = copy.deepcopy(header)
    for path, value in values.items():
        *above, key = path.split("/")
        table = header
        for part in above:
            is_list = isinstance(table, list)
            table = table[int(part)] if is_list else table.setdefault(part, {})
        if value is None:
            del table[key]
        else:
            table[key] = value
    return header


def exported(mesh, **options):
    """The header and the binary chunk of a trimesh mesh or scene."""
    scene = mesh if isinstance(mesh, trimesh.Scene) else trimesh.Scene(mesh)
    return unpacked(scene.export(file_type="glb", **options))


def write(path, mesh, values=None):
    """Export a trimesh mesh or scene as .glb, with `values` in its header."""
    header, binary = exported(mesh)
    path.write_bytes(glb(with_values(header, values or {}), binary))
    return path


def with_extensions(**extensions):
    """Values of a header: extensions KHR_materials_* of the first material."""
    folder = "materials/0/extensions/KHR_materials_"
    return {folder + name: table for name, table in extensions.items()}


def write_colored(path, colors, dtype="<f4", values=None, **material):
    """A square whose vertices have colours (4, 3 or 4), floats, or whole numbers of 8 or 16 bits that are normalized.

    trimesh writes colours for meshes without a texture only.
    """
    header, binary = exported(square(**material))
    data = np.asarray(colors, dtype=float)
    is_float = dtype == "<f4"
    if not is_float:
        data = np.round(data * np.iinfo(dtype).max)
    stored = data.astype(dtype)
    # Rows start at multiples of 4 bytes.
    row = -(-stored[0].nbytes // 4) * 4
    padded = b"".join(vertex.tobytes().ljust(row, b"\0") for vertex in stored)
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(padded)}
    view["byteStride"] = row
    kinds = {"<f4": 5126, "u1": 5121, "<u2": 5123}
    accessor = {"bufferView": len(header["bufferViews"]), "componentType": kinds[dtype]}
    accessor |= {"count": 4, "type": f"VEC{data.shape[1]}", "normalized": not is_float}
    attributes = header["meshes"][0]["primitives"][0]["attributes"]
    attributes["COLOR_0"] = len(header["accessors"])
    header["bufferViews"].append(view)
    header["accessors"].append(accessor)
    header["buffers"][0]["byteLength"] = len(binary) + len(padded)
    path.write_bytes(glb(with_values(header, values or {}), binary + padded))
    return path
