"""glTF 2.0 files: geometry, the node tree, and where materials and their pictures are.

The header is checked here. Only buffers, accessors and primitives reach trimesh, which decodes them; trimesh opens no
picture and no other file.
"""

# ruff: noqa: N815 (keys are spelt as in glTF)

import base64
import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import unquote

import numpy as np
import pydantic
from scipy.spatial.transform import Rotation

from twinlens.errors import FileError, InputError
from twinlens.geometry import Float
from twinlens.scenes.assets import LARGEST_MESH_FILE, read_limited
from twinlens.scenes.gltf_materials import (
    EXTENSIONS,
    Image,
    Lenient,
    PbrMaterial,
    SampledImage,
    Sampler,
)
from twinlens.schema import dotted, exactly, read, satisfies

MOST_NODES = 50_000
_MOST_MATERIALS = 10_000
_MOST_BYTES = 2 << 30  # of decoded accessors
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_COLUMNS = {
    "SCALAR": 1,
    "VEC2": 2,
    "VEC3": 3,
    "VEC4": 4,
    "MAT2": 4,
    "MAT3": 9,
    "MAT4": 16,
}
_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_ATTRIBUTES = {
    "POSITION": ("VEC3",),
    "NORMAL": ("VEC3",),
    "TEXCOORD_0": ("VEC2",),
    "COLOR_0": ("VEC3", "VEC4"),
}
_TRIANGLES = (4, 5)  # modes: a list, a strip

_INDICES = (5121, 5123, 5125)  # unsigned bytes, shorts, integers
_TABLES = {
    "buffer": "buffers",
    "bufferView": "bufferViews",
    "indices": "accessors",
    "attributes": "accessors",
    "mesh": "meshes",
    "children": "nodes",
    "nodes": "nodes",
    "scene": "scenes",
    "material": "materials",
    "index": "textures",
    "source": "images",
    "sampler": "samplers",
}
"""The table of the header that a key's value is an index of."""

_Index = Annotated[int, pydantic.Field(ge=0)]


class _Asset(Lenient):
    version: Annotated[
        str,
        satisfies(lambda version: version.split(".")[0] == "2", "must be 2.0, got {}"),
    ]


class _Buffer(Lenient):
    uri: str | None = None


class _View(Lenient):
    buffer: _Index
    byteOffset: _Index = 0
    byteLength: _Index
    byteStride: Annotated[int, pydantic.Field(ge=1, le=255)] | None = None


class _Accessor(Lenient):
    bufferView: _Index | None = None
    byteOffset: _Index = 0
    componentType: Literal[5120, 5121, 5122, 5123, 5125, 5126]
    count: Annotated[int, pydantic.Field(ge=1)]
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]


class _Primitive(Lenient):
    attributes: dict[str, _Index]
    indices: _Index | None = None
    material: _Index | None = None
    mode: int = 4


class _Mesh(Lenient):
    primitives: list[_Primitive]


_Matrix = Annotated[list[float], exactly(16, float)]
_Triple = Annotated[list[float], exactly(3, float)]
_Quaternion = Annotated[list[float], exactly(4, float)]


class _Node(Lenient):
    mesh: _Index | None = None
    children: list[_Index] = pydantic.Field(default_factory=list)
    matrix: _Matrix | None = None
    translation: _Triple | None = None
    rotation: _Quaternion | None = None
    scale: _Triple | None = None

    def pose(self) -> Float:
        """parent_from_node (4, 4): `matrix`, or translation, rotation by the quaternion x, y, z, w, scale."""
        if self.matrix is not None:
            return np.array(self.matrix, dtype=np.float64).reshape(4, 4).T
        turn = Rotation.from_quat(self.rotation or [0.0, 0.0, 0.0, 1.0]).as_matrix()
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn * (self.scale or 1.0), self.translation or 0.0
        return pose


class _Scene(Lenient):
    nodes: list[_Index] = pydantic.Field(default_factory=list)


class Header(Lenient):
    """The keys of a glTF header that are read; others are ignored."""

    asset: _Asset
    buffers: list[_Buffer] = pydantic.Field(default=[])
    bufferViews: list[_View] = pydantic.Field(default=[])
    accessors: list[_Accessor] = pydantic.Field(default=[])
    meshes: list[_Mesh] = pydantic.Field(default=[])
    nodes: Annotated[list[_Node], pydantic.Field(max_length=MOST_NODES)] = (
        pydantic.Field(default=[])
    )
    scenes: list[_Scene] = pydantic.Field(default=[])
    scene: _Index | None = None
    materials: Annotated[
        list[PbrMaterial], pydantic.Field(max_length=_MOST_MATERIALS)
    ] = pydantic.Field(default=[])
    textures: list[SampledImage] = pydantic.Field(default=[])
    images: list[Image] = pydantic.Field(default=[])
    samplers: list[Sampler] = pydantic.Field(default=[])
    extensionsRequired: list[str] = pydantic.Field(default=[])


@dataclass(frozen=True, eq=False)
class Part:
    """A primitive as trimesh has it, its pose in the file, its material (None: glTF's default), and what it has.

    `colors` are those of vertices with opacity, (V, 4) in [0, 1]; None without any, or if all are white.
    """

    mesh: Any
    pose: Float
    material: int | None
    has_normals: bool
    colors: Float | None


@dataclass(frozen=True, eq=False)
class Gltf:
    """An opened file. `open_file` gives the content of a file that it names."""

    path: Path
    header: Header
    buffers: list[bytes]
    open_file: Callable[[str], bytes]

    @property
    def face_count(self) -> int:
        """Triangles of all placed primitives; a mesh may be placed many times."""
        return sum(
            self._face_count(primitive)
            for mesh, _ in self._placed
            for _, primitive in self._triangles(mesh)
        )

    @property
    def lost(self) -> list[str]:
        """What is not rendered, besides parts of materials."""
        primitives = [
            item
            for mesh, _ in self._placed
            for item in self.header.meshes[mesh].primitives
        ]
        tables = [
            (item.model_extra or {}).get("extensions")
            for item in (self.header, *self.header.nodes, *primitives)
        ]
        unknown = {
            name for table in tables if isinstance(table, dict) for name in table
        }
        present = {
            "points, lines and triangle fans": any(
                item.mode not in _TRIANGLES for item in primitives
            ),
            "morph targets": any(
                "targets" in (item.model_extra or {}) for item in primitives
            ),
            "skins": any(
                "skin" in (item.model_extra or {}) for item in self.header.nodes
            ),
        }
        return [*(name for name, has in present.items() if has), *sorted(unknown)]

    def parts(self) -> list[Part]:
        """All placed primitives of triangles."""
        loaded = self._geometry()
        parts = []
        for mesh, pose in self._placed:
            for name, primitive in self._triangles(mesh):
                if name not in loaded:
                    continue
                decoded = loaded[name]
                color = decoded.visual.vertex_attributes.get("color")
                colors = None if color is None else _rgba(np.asarray(color))
                parts.append(
                    Part(
                        decoded,
                        pose,
                        primitive.material,
                        "NORMAL" in primitive.attributes,
                        colors,
                    )
                )
        return parts

    def picture(self, index: int) -> bytes:
        """The encoded bytes of an image."""
        image = self.header.images[index]
        if image.bufferView is None:
            return read_uri(image.uri or "", self.open_file)
        view = self.header.bufferViews[image.bufferView]
        return self.buffers[view.buffer][
            view.byteOffset : view.byteOffset + view.byteLength
        ]

    def _triangles(self, mesh: int) -> Iterator[tuple[str, _Primitive]]:
        for i, primitive in enumerate(self.header.meshes[mesh].primitives):
            if primitive.mode in _TRIANGLES:
                yield f"{mesh}/{i}", primitive

    def _face_count(self, primitive: _Primitive) -> int:
        accessor = (
            primitive.attributes["POSITION"]
            if primitive.indices is None
            else primitive.indices
        )
        count = self.header.accessors[accessor].count
        return count // 3 if primitive.mode == 4 else max(count - 2, 0)

    @cached_property
    def _placed(self) -> list[tuple[int, Float]]:
        """(mesh, pose in the file) of every node that has a mesh.

        A file without a scene has all its nodes, or all meshes once if it has no nodes.
        """
        header = self.header
        if not header.scenes and not header.nodes:
            return [(mesh, np.eye(4)) for mesh in range(len(header.meshes))]
        children = {child for node in header.nodes for child in node.children}
        roots = [node for node in range(len(header.nodes)) if node not in children]
        placed: list[tuple[int, Float]] = []
        seen: set[int] = set()
        top = header.scenes[header.scene or 0].nodes if header.scenes else roots
        waiting = [(node, np.eye(4)) for node in reversed(top)]
        while waiting:
            index, parent = waiting.pop()
            if index in seen:
                raise FileError(f"{self.path}: nodes[{index}] has two parents")
            seen.add(index)
            node = header.nodes[index]
            with np.errstate(all="ignore"):
                pose = parent @ node.pose()
            if not np.isfinite(pose).all():
                raise FileError(f"{self.path}: nodes[{index}] has no finite pose")
            # A scale of 0 on all axes hides a part; on two axes nothing with an area is left.
            if node.mesh is not None and np.linalg.matrix_rank(pose[:3, :3]) >= 2:
                placed.append((node.mesh, pose))
            waiting += [(child, pose) for child in reversed(node.children)]
        return placed

    def _geometry(self) -> Any:
        """trimesh's meshes by "mesh/primitive"."""
        import trimesh

        header = self.header
        size = sum(
            accessor.count * _COLUMNS[accessor.type] * _BYTES[accessor.componentType]
            for accessor in header.accessors
        )
        if size > _MOST_BYTES:
            raise FileError(
                f"{self.path}: accessors of {size >> 20} MiB are more than {_MOST_BYTES >> 20} MiB"
            )
        meshes = [
            {"name": name, "primitives": [self._checked(f"meshes[{index}]", primitive)]}
            for index in sorted({mesh for mesh, _ in self._placed})
            for name, primitive in self._triangles(index)
        ]
        cleaned = {
            "asset": {"version": "2.0"},
            "buffers": [{"uri": str(i)} for i in range(len(self.buffers))],
            "bufferViews": [
                view.model_dump(exclude_none=True) for view in header.bufferViews
            ],
            "accessors": [
                accessor.model_dump(exclude_none=True) for accessor in header.accessors
            ],
            "meshes": meshes,
            # Without a material trimesh reads no texture coordinates.
            "materials": [{}],
        }
        stream = BytesIO(json.dumps(cleaned).encode())
        buffers = {str(i): data for i, data in enumerate(self.buffers)}
        return trimesh.load_scene(
            stream, file_type="gltf", resolver=buffers, process=False
        ).geometry

    def _checked(self, mesh: str, primitive: _Primitive) -> dict[str, Any]:
        """A primitive's table with the attributes that are read, checked. Raises FileError that names the mesh."""
        attributes = {
            **primitive.attributes,
            "TEXCOORD_0": self._coordinates(primitive),
        }
        kept = {
            key: attributes[key]
            for key in _ATTRIBUTES
            if attributes.get(key) is not None
        }
        self._check_attributes(mesh, kept)
        table = {"attributes": kept, "mode": primitive.mode, "material": 0}
        if primitive.indices is None:
            return table
        numbers = self.header.accessors[primitive.indices]
        if numbers.type != "SCALAR" or numbers.componentType not in _INDICES:
            raise FileError(
                f"{self.path}: {mesh}: indices must be SCALAR, of unsigned integers"
            )
        return {**table, "indices": primitive.indices}

    def _check_attributes(self, mesh: str, attributes: dict[str, Any]) -> None:
        if "POSITION" not in attributes:
            raise FileError(f"{self.path}: {mesh} has a primitive without POSITION")
        accessors = {
            key: self.header.accessors[index] for key, index in attributes.items()
        }
        for key, accessor in accessors.items():
            if (
                accessor.type not in _ATTRIBUTES[key]
                or accessor.count != accessors["POSITION"].count
            ):
                allowed = f"{' or '.join(_ATTRIBUTES[key])}, one for each position"
                raise FileError(f"{self.path}: {mesh}: {key} must be {allowed}")
            if "sparse" in (accessor.model_extra or {}):
                raise FileError(
                    f"{self.path}: {mesh}: {key} is sparse, which twinlens cannot read; export without it"
                )

    def _coordinates(self, primitive: _Primitive) -> int | None:
        """The accessor of the texture coordinates that the material uses."""
        chosen = (
            0
            if primitive.material is None
            else self.header.materials[primitive.material].coordinate_set
        )
        accessor = primitive.attributes.get(f"TEXCOORD_{chosen}")
        if (
            accessor is not None
            and self.header.accessors[accessor].componentType != 5126
        ):
            raise FileError(
                f"{self.path}: texture coordinates must be float32; export the file without quantization"
            )
        return accessor


def _rgba(values: Any) -> Float | None:
    """Colours (V, 4) in [0, 1] of floats or normalized integers (V, 3 or 4); None if all are 1."""
    scale = 1.0 if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)
    rgba = np.ones((len(values), 4))
    rgba[:, : values.shape[1]] = np.clip(values / scale, 0.0, 1.0)
    return None if (rgba == 1).all() else rgba


def read_uri(uri: str, open_file: Callable[[str], bytes]) -> bytes:
    """The content of a data URI, or of a file."""
    if not uri.startswith("data:"):
        return open_file(unquote(uri))
    kind, _, data = uri.partition(",")
    if not kind.endswith(";base64"):
        raise InputError("a data URI must be base64")
    return base64.b64decode(data, validate=True)


def read_header(path: Path) -> tuple[Header, bytes | None]:
    """The header of a .glb or .gltf file, and the binary part of a .glb file. Raises FileError."""
    data = read_limited(path, LARGEST_MESH_FILE)
    text, binary = (
        _chunks(path, data) if path.suffix.lower() == ".glb" else (data, None)
    )
    return read(Header, json.loads(text), path), binary


def named_by(header: Header) -> list[str]:
    """The names of files in a header."""
    uris = [
        *(item.uri for item in header.buffers),
        *(item.uri for item in header.images),
    ]
    return [unquote(uri) for uri in uris if uri and not uri.startswith("data:")]


def open_gltf(path: Path, open_file: Callable[[str], bytes]) -> Gltf:
    """The checked header and the buffers of a .glb or .gltf file. Raises FileError."""
    header, binary = read_header(path)
    if unknown := sorted(set(header.extensionsRequired) - EXTENSIONS):
        raise FileError(
            f"{path}: requires {', '.join(unknown)}, which twinlens cannot read; export without it"
        )
    for where, table, index in _indices(header):
        if index >= (count := len(getattr(header, table))):
            raise FileError(
                f"{path}: {dotted(where)} is {index}, but the length of {table!r} is {count}"
            )
    buffers = []
    for i, buffer in enumerate(header.buffers):
        if buffer.uri is None and (binary is None or i > 0):
            raise FileError(f"{path}: buffers[{i}] has no data")
        buffers.append(
            binary if buffer.uri is None else read_uri(buffer.uri, open_file)
        )
    for i, view in enumerate(header.bufferViews):
        if view.byteOffset + view.byteLength > len(buffers[view.buffer] or b""):
            raise FileError(
                f"{path}: bufferViews[{i}] ends after its buffer; is the file complete?"
            )
    return Gltf(path, header, [data or b"" for data in buffers], open_file)


def _indices(
    value: Any, where: tuple[str | int, ...] = (), table: str = ""
) -> Iterator[tuple[Any, str, int]]:
    """The place, the table and the value of every index in a header or a part of it."""
    if isinstance(value, pydantic.BaseModel):
        for name in type(value).model_fields:
            yield from _indices(
                getattr(value, name), (*where, name), _TABLES.get(name, "")
            )
    elif isinstance(value, list | dict):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _indices(item, (*where, key), table)
    elif table and isinstance(value, int):
        yield where, table, value


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON and binary chunks of a .glb file. Source: glTF 2.0, chapter 4."""
    if len(data) < 20 or data[:4] != b"glTF":
        raise FileError(f"{path}: not a binary glTF file")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise FileError(f"{path}: glTF version {version} is not supported, only 2")
    if length > len(data):
        raise FileError(
            f"{path}: has {len(data)} of {length} bytes; is the file complete?"
        )
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > len(data):
            raise FileError(
                f"{path}: a chunk ends after the file; is the file complete?"
            )
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if _JSON not in chunks:
        raise FileError(f"{path}: has no JSON chunk")
    return chunks[_JSON], chunks.get(_BIN)
