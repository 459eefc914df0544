"""The numbers of glTF 2.0 files: accessors, also sparse, quantized or compressed ones, as NumPy arrays.

trimesh decodes accessors too, but neither sparse nor normalized ones, and of the compressions Draco alone. Source: glTF
2.0, chapter 3.6.2; KHR_mesh_quantization, EXT_meshopt_compression, KHR_draco_mesh_compression.
"""

# ruff: noqa: N815 (keys are spelt as in glTF)

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from twinlens.errors import InputError, import_extra
from twinlens.geometry import Float
from twinlens.scenes.gltf_materials import Lenient

_MOST_BYTES = 2 << 30  # of decoded accessors, and of decompressed views
_COLUMNS = {
    "SCALAR": 1,
    "VEC2": 2,
    "VEC3": 3,
    "VEC4": 4,
    "MAT2": 4,
    "MAT3": 9,
    "MAT4": 16,
}
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_UNSIGNED = (5121, 5123, 5125)
_TRIANGLES, _STRIP, _FAN = 4, 5, 6  # modes of primitives
_DRACO_METADATA = 0x8000  # flag
_DRACO_CLOUD, _DRACO_SEQUENTIAL = 0, 0  # a kind of geometry, a method of connectivity
FACE_MODES = (_TRIANGLES, _STRIP, _FAN)
ARRAY_EXTENSIONS = {
    "KHR_mesh_quantization",
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
}
"""The extensions of geometry that are read."""

_Index = Annotated[int, pydantic.Field(ge=0)]
_Count = Annotated[int, pydantic.Field(ge=1)]


class _Meshopt(Lenient):
    """EXT_meshopt_compression of a buffer view, and KHR_meshopt_compression, which has the same keys."""

    buffer: _Index
    byteOffset: _Index = 0
    byteLength: _Index
    byteStride: Annotated[int, pydantic.Field(ge=1, le=256)]
    count: _Count
    mode: Literal["ATTRIBUTES", "TRIANGLES", "INDICES"]
    filter: Literal["NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"] = "NONE"


class _ViewExtensions(Lenient):
    EXT_meshopt_compression: _Meshopt | None = None
    KHR_meshopt_compression: _Meshopt | None = None


class View(Lenient):
    """A part of a buffer; `byteStride` is the distance of its rows."""

    buffer: _Index
    byteOffset: _Index = 0
    byteLength: _Index
    byteStride: Annotated[int, pydantic.Field(ge=1, le=255)] | None = None
    extensions: _ViewExtensions = _ViewExtensions()

    @property
    def compressed(self) -> _Meshopt | None:
        """Where its compressed content is."""
        extensions = self.extensions
        return extensions.EXT_meshopt_compression or extensions.KHR_meshopt_compression


class _SparseIndices(Lenient):
    bufferView: _Index
    byteOffset: _Index = 0
    componentType: Literal[5121, 5123, 5125]


class _SparseValues(Lenient):
    bufferView: _Index
    byteOffset: _Index = 0


class _Sparse(Lenient):
    count: _Count
    indices: _SparseIndices
    values: _SparseValues


class Accessor(Lenient):
    """An array in a view."""

    bufferView: _Index | None = None
    byteOffset: _Index = 0
    componentType: Literal[5120, 5121, 5122, 5123, 5125, 5126]
    normalized: bool = False
    count: _Count
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    sparse: _Sparse | None = None

    @property
    def bytes(self) -> int:
        """The size of the decoded array."""
        size = np.dtype(_TYPES[self.componentType]).itemsize
        return self.count * _COLUMNS[self.type] * size


class Draco(Lenient):
    """KHR_draco_mesh_compression of a primitive; `attributes` are numbers in the compressed content."""

    bufferView: _Index
    attributes: dict[str, int]


@dataclass(eq=False)
class Arrays:
    """The accessors of a file by their index. Raises InputError for those that leave their view, or are too large."""

    buffers: Sequence[bytes]
    views: Sequence[View]
    accessors: Sequence[Accessor]
    _decompressed: dict[int, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        views = [view.compressed for view in self.views]
        sizes = [view.count * view.byteStride for view in views if view is not None]
        sizes += [accessor.bytes for accessor in self.accessors]
        if sum(sizes) > _MOST_BYTES:
            raise InputError(
                f"accessors of {sum(sizes) >> 20} MiB are more than {_MOST_BYTES >> 20} MiB"
            )

    def values(self, index: int) -> Float:
        """An accessor as float64 (count, columns), normalized integers in [0, 1] or [-1, 1]."""
        return _as_floats(self._stored(index), self.accessors[index].normalized)

    def indices(self, index: int) -> NDArray[np.int64]:
        """An accessor of vertex numbers as (count,)."""
        accessor = self.accessors[index]
        if accessor.type != "SCALAR" or accessor.componentType not in _UNSIGNED:
            raise InputError("indices must be SCALAR, of unsigned integers")
        return self._stored(index).ravel().astype(np.int64)

    def view(self, index: int) -> bytes:
        """The content of a view, decompressed."""
        view = self.views[index]
        if view.compressed is None:
            return self._part(view, index)
        if index not in self._decompressed:
            data = self._part(view.compressed, index)
            self._decompressed[index] = _from_meshopt(view.compressed, data)
        return self._decompressed[index]

    def _part(self, part: View | _Meshopt, index: int) -> bytes:
        end = part.byteOffset + part.byteLength
        if end > len(self.buffers[part.buffer]):
            raise InputError(
                f"bufferViews[{index}] ends after its buffer; is the file complete?"
            )
        return self.buffers[part.buffer][part.byteOffset : end]

    def _stored(self, index: int) -> NDArray[Any]:
        """An accessor as it is stored (count, columns). Without a view its numbers are 0."""
        accessor = self.accessors[index]
        columns = _COLUMNS[accessor.type]
        if accessor.bufferView is None:
            kind = np.dtype(_TYPES[accessor.componentType])
            stored = np.zeros((accessor.count, columns), dtype=kind)
        else:
            place = accessor.bufferView, accessor.byteOffset
            stored = self._rows(*place, accessor.componentType, accessor.count, columns)
        sparse = accessor.sparse
        if sparse is None:
            return stored
        numbers = sparse.indices
        rows = self._rows(
            numbers.bufferView,
            numbers.byteOffset,
            numbers.componentType,
            sparse.count,
            1,
        ).ravel()
        if rows.max() >= accessor.count:
            raise InputError(
                f"accessors[{index}].sparse: index {rows.max()}, but its count is {accessor.count}"
            )
        replaced = stored.copy()
        replaced[rows] = self._rows(
            sparse.values.bufferView,
            sparse.values.byteOffset,
            accessor.componentType,
            sparse.count,
            columns,
        )
        return replaced

    def _rows(
        self, view: int, start: int, kind: int, count: int, columns: int
    ) -> NDArray[Any]:
        """Numbers (count, columns) of a view, whose rows may be farther apart than they are long."""
        dtype = np.dtype(_TYPES[kind])
        length = dtype.itemsize * columns
        stride = self.views[view].byteStride or length
        data = self.view(view)
        end = start + stride * (count - 1) + length
        if end > len(data) or stride < length:
            raise InputError(
                f"bufferViews[{view}]: {count} rows of {length} bytes are more than it has"
            )
        if stride == length:
            flat = np.frombuffer(data, dtype, count * columns, start)
            return flat.reshape(count, columns)
        table = np.ndarray((count, length), np.uint8, data, start, (stride, 1))
        return np.ascontiguousarray(table).view(dtype)


class _DracoHeader:
    """Reads the first numbers of Draco data. Raises InputError where the data end.

    Source: Draco bitstream specification 2.2, "Draco Header", "Metadata Decoder", and "Connectivity Decoder".
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, count: int) -> bytes:
        """The next bytes."""
        taken = self._data[self._at : self._at + count]
        if len(taken) < count:
            raise InputError("the Draco data end early; is the file complete?")
        self._at += count
        return taken

    def number(self, count: int = 1) -> int:
        """The next number, of `count` bytes."""
        return int.from_bytes(self.take(count), "little")

    def varint(self) -> int:
        """The next number in LEB128: 7 bits a byte, the lowest first."""
        value = 0
        for shift in range(0, 64, 7):
            byte = self.number()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
        raise InputError("the Draco data have a number of more than 64 bits")

    def skip_metadata(self) -> None:
        """Skip the metadata of attributes, and those of the mesh."""
        for _ in range(self.varint()):
            self.varint()  # the number of the attribute
            self._skip_table()
        self._skip_table()

    def _skip_table(self) -> None:
        """Skip a table of names and values, and the tables in it."""
        left = 1
        while left:
            left -= 1
            for _ in range(self.varint()):
                self.take(self.number())
                self.take(self.varint())
            # Tables in a table follow it, each after its name, and have tables of their own.
            left += self.varint()
            if left:
                self.take(self.number())


def check_draco_size(data: bytes, vertex_count: int, face_count: int) -> None:
    """Raise InputError for Draco data of more vertices or triangles than their accessors have, before decoding.

    Few bytes may decode to billions of vertices. The vertices of EdgeBreaker are at most three a triangle.
    """
    header = _DracoHeader(data)
    if header.take(5) != b"DRACO":
        raise InputError("its compressed data are not Draco data")
    major, minor, kind, method = header.take(4)
    if (major, minor) < (2, 2):
        raise InputError(f"Draco {major}.{minor} is not 2.2; compress the mesh again")
    if header.number(2) & _DRACO_METADATA:
        header.skip_metadata()
    faces = vertices = 0
    if kind == _DRACO_CLOUD:
        vertices = header.number(4)
    elif method == _DRACO_SEQUENTIAL:
        faces, vertices = header.varint(), header.varint()
    else:
        header.number()  # the order of its symbols
        header.varint()  # vertices before those at seams are doubled
        faces = header.varint()
    if vertices > vertex_count:
        raise InputError(
            f"the Draco data have {vertices} vertices, its accessor {vertex_count}"
        )
    if faces > face_count:
        raise InputError(
            f"the Draco data have {faces} triangles, its accessor {face_count}"
        )


def from_draco(data: bytes, table: Draco) -> tuple[dict[str, NDArray[Any]], Any]:
    """The attributes (V, columns) of a compressed primitive by name, and its triangles (F, 3), None of a point cloud.

    Raises MissingExtraError without DracoPy.
    """
    decoded = import_extra("DracoPy", "gltf").decode(data)
    by_number = {item["unique_id"]: item["data"] for item in decoded.attributes}
    attributes = {}
    for name, number in table.attributes.items():
        if number not in by_number:
            raise InputError(f"the Draco data have no attribute {number}, {name}")
        values = np.asarray(by_number[number])
        attributes[name] = values.reshape(len(values), -1)
    return attributes, getattr(decoded, "faces", None)


def draco_values(stored: NDArray[Any], accessor: Accessor) -> Float:
    """An attribute of a Draco mesh as float64 (V, columns); it is normalized as its accessor says."""
    if len(stored) != accessor.count:
        raise InputError(
            f"the Draco data have {len(stored)} vertices, its accessor {accessor.count}"
        )
    return _as_floats(stored, accessor.normalized)


def triangles_of(indices: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """The triangles (F, 3) of a list, a strip or a fan of vertices; numbers that are left over are ignored.

    Every second triangle of a strip is turned, so that all face the same side. Those that repeat a vertex, which join
    strips, are left out. Source: glTF 2.0, 3.7.2.1.

    >>> triangles_of(np.arange(5), 5).tolist()
    [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    >>> triangles_of(np.arange(5), 6).tolist()
    [[1, 2, 0], [2, 3, 0], [3, 4, 0]]
    """
    if mode == _TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    if len(indices) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == _FAN:
        hub = np.full(len(indices) - 2, indices[0])
        return _with_three_vertices(np.stack([indices[1:-1], indices[2:], hub], 1))
    faces = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    faces[1::2] = faces[1::2, [0, 2, 1]]
    return _with_three_vertices(faces)


def _with_three_vertices(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    following = np.roll(faces, 1, axis=1)
    has_three = (faces != following).all(axis=1)
    return np.asarray(faces[has_three])


def _as_floats(stored: NDArray[Any], is_normalized: bool) -> Float:
    values = np.asarray(stored, dtype=np.float64)
    if not is_normalized or stored.dtype.kind == "f":
        return values
    # The least negative integer and the one after it are both -1.
    return np.maximum(values / np.iinfo(stored.dtype).max, -1.0)


def _from_meshopt(view: _Meshopt, data: bytes) -> bytes:
    """The content of a view. Raises MissingExtraError without meshopt."""
    meshopt = import_extra("meshopt", "gltf")
    arguments = view.count, view.byteStride, view.mode, view.filter
    return bytes(np.asarray(meshopt.decode_gltf_buffer(data, *arguments)).tobytes())
