"""glTF 2.0 files: geometry, the node tree, and where materials and their pictures are.

The header is checked here; `gltf_arrays` decodes accessors and compressed geometry. trimesh holds the triangles of a
part, and opens no file.
"""

# ruff: noqa: N815 (keys are spelt as in glTF)

import base64
import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import unquote

import numpy as np
import pydantic
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twinlens.errors import FileError, InputError, located
from twinlens.geometry import Float
from twinlens.scenes.assets import LARGEST_MESH_FILE, read_limited
from twinlens.scenes.gltf_arrays import (
    ARRAY_EXTENSIONS,
    FACE_MODES,
    Accessor,
    Arrays,
    Draco,
    View,
    check_draco_size,
    draco_values,
    from_draco,
    triangles_of,
)
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
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_ATTRIBUTES = {
    "POSITION": ("VEC3",),
    "NORMAL": ("VEC3",),
    "COLOR_0": ("VEC3", "VEC4"),
}
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
    extensions: dict[str, Any] = pydantic.Field(default={})

    @property
    def is_fallback(self) -> bool:
        """Whether it has no data, as those of its views are compressed in another buffer."""
        tables = [self.extensions.get(name) for name in ARRAY_EXTENSIONS]
        return any(
            isinstance(table, dict) and table.get("fallback") for table in tables
        )


class _PrimitiveExtensions(Lenient):
    KHR_draco_mesh_compression: Draco | None = None


class _Primitive(Lenient):
    attributes: dict[str, _Index]
    indices: _Index | None = None
    material: _Index | None = None
    mode: int = 4
    extensions: _PrimitiveExtensions = _PrimitiveExtensions()


class _Mesh(Lenient):
    primitives: list[_Primitive]


_Matrix = Annotated[list[float], exactly(16, float)]
_Triple = Annotated[list[float], exactly(3, float)]
_Quaternion = Annotated[list[float], exactly(4, float)]


class _Instancing(Lenient):
    """EXT_mesh_gpu_instancing: accessors with a translation, rotation and scale for each copy of a node's mesh."""

    attributes: dict[str, _Index]


class _NodeExtensions(Lenient):
    EXT_mesh_gpu_instancing: _Instancing | None = None


_READ_EXTENSIONS = {*EXTENSIONS, *ARRAY_EXTENSIONS, *_NodeExtensions.model_fields}


class _Node(Lenient):
    mesh: _Index | None = None
    children: list[_Index] = pydantic.Field(default_factory=list)
    matrix: _Matrix | None = None
    translation: _Triple | None = None
    rotation: _Quaternion | None = None
    scale: _Triple | None = None
    extensions: _NodeExtensions = _NodeExtensions()

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
    bufferViews: list[View] = pydantic.Field(default=[])
    accessors: list[Accessor] = pydantic.Field(default=[])
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
    cameras: list[Any] = pydantic.Field(default=[])
    animations: list[Any] = pydantic.Field(default=[])
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
        total = 0
        for mesh, _ in self._placed:
            total += sum(self._face_count(part) for _, part in self._triangles(mesh))
        return total

    @property
    def lost(self) -> list[str]:
        """What is not rendered, besides parts of materials, and what is done instead."""
        header = self.header
        primitives: list[_Primitive] = []
        for mesh in sorted({mesh for mesh, _ in self._placed}):
            primitives += header.meshes[mesh].primitives
        node_keys = [node.model_extra or {} for node in header.nodes]
        present = {
            "points and lines (left out)": any(
                primitive.mode not in FACE_MODES for primitive in primitives
            ),
            "morph targets (the mesh without them)": any(
                "targets" in (primitive.model_extra or {}) for primitive in primitives
            ),
            "skins (the mesh as its nodes place it)": any(
                "skin" in keys for keys in node_keys
            ),
            "animations (the pose of the nodes)": bool(header.animations),
            "cameras (those of the scene)": any("camera" in keys for keys in node_keys),
            **{
                f"{name} (not used)": True
                for name in sorted(set().union(*map(self._unused, primitives)))
            },
        }
        return [
            *(name for name, is_there in present.items() if is_there),
            *sorted(self._unknown_extensions()),
        ]

    def _unused(self, primitive: _Primitive) -> set[str]:
        """The attributes of a primitive of triangles that nothing reads."""
        if primitive.mode not in FACE_MODES:
            return set()
        used = {*_ATTRIBUTES, "TANGENT", f"TEXCOORD_{self._coordinate_set(primitive)}"}
        # Joints and weights are named as a skin.
        names = {name for name in primitive.attributes if name not in used}
        return {name for name in names if not name.startswith(("JOINTS", "WEIGHTS"))}

    def _unknown_extensions(self) -> set[str]:
        """The extensions of everything but materials that are not read."""
        tables = self.header.model_dump(exclude={"materials"}, exclude_none=True)
        return set(_extensions_in(tables)) - _READ_EXTENSIONS

    def parts(self) -> list[Part]:
        """All placed primitives of triangles."""
        arrays = self._arrays  # their sizes are checked here
        decoded = {}
        for mesh in sorted({mesh for mesh, _ in self._placed}):
            for name, primitive in self._triangles(mesh):
                decoded[name] = self._decoded(arrays, f"meshes[{mesh}]", primitive)
        parts = []
        for mesh, pose in self._placed:
            for name, primitive in self._triangles(mesh):
                made, colors = decoded[name]
                has_normals = "NORMAL" in primitive.attributes
                part = Part(made, pose, primitive.material, has_normals, colors)
                parts.append(part)
        return parts

    def picture(self, index: int) -> bytes:
        """The encoded bytes of an image."""
        image = self.header.images[index]
        if image.bufferView is None:
            return read_uri(image.uri or "", self.open_file)
        arrays = Arrays(self.buffers, self.header.bufferViews, [])
        return arrays.view(image.bufferView)

    def _triangles(self, mesh: int) -> Iterator[tuple[str, _Primitive]]:
        for i, primitive in enumerate(self.header.meshes[mesh].primitives):
            if primitive.mode in FACE_MODES:
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
    def _arrays(self) -> Arrays:
        return Arrays(self.buffers, self.header.bufferViews, self.header.accessors)

    @cached_property
    def _placed(self) -> list[tuple[int, Float]]:
        """(mesh, pose in the file) of every node that has a mesh, and of every copy of it.

        A file without a scene has all its nodes, or all meshes once if it has no nodes.
        """
        header = self.header
        if not header.scenes and not header.nodes:
            return [(mesh, np.eye(4)) for mesh in range(len(header.meshes))]
        children = set[int]().union(*(node.children for node in header.nodes))
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
            if node.mesh is not None:
                with located(f"{self.path}: nodes[{index}]"):
                    copies = pose @ self._copies(node, MOST_NODES - len(placed))
                # A scale of 0 on all axes hides a part; on two axes nothing with an area is left.
                ranks = np.linalg.matrix_rank(copies[:, :3, :3])
                placed += [(node.mesh, copy) for copy in copies[ranks >= 2]]
            waiting += [(child, pose) for child in reversed(node.children)]
        return placed

    def _copies(self, node: _Node, most: int) -> Float:
        """node_from_copy (N, 4, 4) of the copies of a node's mesh: the identity without EXT_mesh_gpu_instancing."""
        table = node.extensions.EXT_mesh_gpu_instancing
        if table is None:
            return np.eye(4)[None]
        name = "EXT_mesh_gpu_instancing"
        kinds = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}
        used = {key: table.attributes[key] for key in kinds if key in table.attributes}
        accessors = {key: self.header.accessors[index] for key, index in used.items()}
        counts = {accessor.count for accessor in accessors.values()}
        is_fitting = all(accessors[key].type == kinds[key] for key in accessors)
        if len(counts) != 1 or not is_fitting:
            raise InputError(
                f"{name} needs TRANSLATION (VEC3), ROTATION (VEC4) or SCALE (VEC3), of one length"
            )
        (count,) = counts
        if count > most:
            raise InputError(f"{name} makes more than {MOST_NODES} copies of meshes")
        values = {key: self._arrays.values(index) for key, index in used.items()}
        if not all(np.isfinite(value).all() for value in values.values()):
            raise InputError(f"{name} has numbers that are not finite")
        turns = values.get("ROTATION", np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))
        if not turns.any(axis=1).all():
            raise InputError(f"{name} has a ROTATION of length 0")
        scales = values.get("SCALE", np.ones((count, 3)))
        copies = np.tile(np.eye(4), (count, 1, 1))
        copies[:, :3, :3] = Rotation.from_quat(turns).as_matrix() * scales[:, None]
        copies[:, :3, 3] = values.get("TRANSLATION", 0.0)
        return copies

    def _decoded(
        self, arrays: Arrays, mesh: str, primitive: _Primitive
    ) -> tuple[Any, Float | None]:
        """A primitive as trimesh's mesh, and the colours of its vertices. Raises FileError that names the mesh."""
        import trimesh

        with located(f"{self.path}: {mesh}"):
            kept = self._kept(primitive)
            self._check_attributes(kept)
            values, faces = self._arrays_of(arrays, primitive, kept)
        uv = values.get("TEXCOORD")
        visual = None
        if uv is not None:
            # glTF counts v from the top of the picture.
            visual = trimesh.visual.TextureVisuals(uv=uv * [1, -1] + [0, 1])
        made = trimesh.Trimesh(
            values["POSITION"],
            faces,
            vertex_normals=values.get("NORMAL"),
            visual=visual,
            process=False,
            validate=False,
        )
        return made, _rgba(values.get("COLOR_0"))

    def _arrays_of(
        self, arrays: Arrays, primitive: _Primitive, kept: dict[str, int]
    ) -> tuple[dict[str, Float], NDArray[np.int64]]:
        """The attributes of a primitive by the keys of `_kept`, and its triangles (F, 3)."""
        accessors = self.header.accessors
        draco = primitive.extensions.KHR_draco_mesh_compression
        stored: dict[str, NDArray[Any]] = {}
        faces = None
        if draco is not None:
            data = arrays.view(draco.bufferView)
            vertex_count = accessors[primitive.attributes["POSITION"]].count
            check_draco_size(data, vertex_count, self._face_count(primitive))
            stored, faces = from_draco(data, draco)
        names = {index: name for name, index in primitive.attributes.items()}
        values = {}
        for key, index in kept.items():
            name = names[index]
            values[key] = (
                draco_values(stored[name], accessors[index])
                if name in stored
                else arrays.values(index)
            )
            if not np.isfinite(values[key]).all():
                raise InputError(f"{name} has numbers that are not finite")
        count = len(values["POSITION"])
        if faces is not None and primitive.indices is not None:
            return values, np.asarray(faces, dtype=np.int64).reshape(-1, 3)
        indices = np.arange(count)
        if primitive.indices is not None:
            indices = arrays.indices(primitive.indices)
        return values, triangles_of(indices, primitive.mode)

    def _kept(self, primitive: _Primitive) -> dict[str, int]:
        """The accessors of the attributes that are read; TEXCOORD are the coordinates that the material uses."""
        attributes = primitive.attributes
        kept = {key: attributes[key] for key in _ATTRIBUTES if key in attributes}
        chosen = attributes.get(f"TEXCOORD_{self._coordinate_set(primitive)}")
        return kept if chosen is None else {**kept, "TEXCOORD": chosen}

    def _check_attributes(self, attributes: dict[str, int]) -> None:
        if "POSITION" not in attributes:
            raise InputError("has a primitive without POSITION")
        accessors = {
            key: self.header.accessors[index] for key, index in attributes.items()
        }
        for key, accessor in accessors.items():
            types = _ATTRIBUTES.get(key, ("VEC2",))
            is_fitting = accessor.count == accessors["POSITION"].count
            if accessor.type not in types or not is_fitting:
                allowed = f"{' or '.join(types)}, one for each position"
                raise InputError(f"{key} must be {allowed}")

    def _coordinate_set(self, primitive: _Primitive) -> int:
        """The set of texture coordinates that the material of a primitive uses."""
        if primitive.material is None:
            return 0
        return self.header.materials[primitive.material].coordinate_set


def _extensions_in(value: Any) -> Iterator[str]:
    """The names of all extensions in a part of a header."""
    children = value if isinstance(value, list) else []
    if isinstance(value, dict):
        extensions = value.get("extensions")
        yield from extensions if isinstance(extensions, dict) else ()
        children = [child for key, child in value.items() if key != "extensions"]
    for child in children:
        yield from _extensions_in(child)


def _rgba(values: Float | None) -> Float | None:
    """Colours (V, 4) in [0, 1] of colours (V, 3 or 4); None without any, or if all are 1."""
    if values is None:
        return None
    rgba = np.ones((len(values), 4))
    rgba[:, : values.shape[1]] = np.clip(values, 0.0, 1.0)
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
    if unknown := sorted(set(header.extensionsRequired) - _READ_EXTENSIONS):
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
        if buffer.uri is not None:
            buffers.append(read_uri(buffer.uri, open_file))
        elif binary is not None and i == 0:
            buffers.append(binary)
        elif buffer.is_fallback:
            buffers.append(b"")
        else:
            raise FileError(f"{path}: buffers[{i}] has no data")
    return Gltf(path, header, buffers, open_file)


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
