"""Writes glTF files for tests: trimesh's exporter, and changes of the header that it cannot write."""

import json
import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

SQUARE = [[-0.5, 0, 0], [0.5, 0, 0], [0.5, 1, 0], [-0.5, 1, 0]]
SQUARE_UV = [[0.0, 0.0], [1, 0], [1, 1], [0, 1]]


def square(**material: Any) -> trimesh.Trimesh:
    """A square of 1 m in the plane z = 0 of the file, facing +z, its texture upright along +y."""
    visual = trimesh.visual.TextureVisuals(
        uv=SQUARE_UV,
        material=trimesh.visual.material.PBRMaterial(**({"name": "paint"} | material)),
    )
    return trimesh.Trimesh(SQUARE, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)


def picture(texels: Any) -> Image.Image:
    """An 8-bit picture of texels (H, W, C) in [0, 1], stored as given."""
    return Image.fromarray(np.round(255 * np.asarray(texels)).astype(np.uint8))


def png(texels: Any) -> bytes:
    stream = BytesIO()
    picture(texels).save(stream, format="PNG")
    return stream.getvalue()


def glb(header: dict[str, Any], binary: bytes) -> bytes:
    """A .glb file of a header and a binary chunk. Source: glTF 2.0, chapter 4."""
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    chunks = (
        struct.pack("<II", len(text), 0x4E4F534A)
        + text
        + struct.pack("<II", len(binary), 0x004E4942)
        + binary
    )
    return struct.pack("<4sII", b"glTF", 2, size) + chunks


def unpacked(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The header and the binary chunk of a .glb file that trimesh wrote."""
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[20 + size + 8 :]


def write(
    path: Path, what: Any, change: Callable[[dict[str, Any]], object] | None = None
) -> Path:
    """Export a trimesh mesh or scene as .glb, after `change` of its header."""
    scene = what if isinstance(what, trimesh.Scene) else trimesh.Scene(what)
    header, binary = unpacked(scene.export(file_type="glb"))
    if change is not None:
        change(header)
    path.write_bytes(glb(header, binary))
    return path


def with_extensions(**extensions: Any) -> Callable[[dict[str, Any]], None]:
    """A change that adds extensions KHR_materials_* to the first material."""
    named = {f"KHR_materials_{name}": table for name, table in extensions.items()}
    return lambda header: (
        header["materials"][0].setdefault("extensions", {}).update(named)
    )
