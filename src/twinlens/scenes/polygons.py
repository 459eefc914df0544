"""Triangles of the polygons of OBJ and PLY files.

trimesh divides a polygon into a fan of triangles around its first vertex, which also covers the notches of a concave
polygon. A file with such polygons is therefore rewritten before trimesh reads it, with triangles by ear clipping.
Convex polygons stay as they are. So a quad that is not planar is split along the diagonal from its first vertex,
unless its projection along its mean normal is concave.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.geometry import Float

_PLY_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_PLY_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDEX_LISTS = ("vertex_index", "vertex_indices")
_STRAIGHT = 1e-9  # radians: a turn to the wrong side that rounding explains


def concave_triangles(points: Float) -> NDArray[np.uint32] | None:
    """Corners (T, 3) of the triangles of a concave polygon with the vertices (N, 3), None if it is convex.

    The triangles have the orientation of the polygon. Holes may be joined to the outline by two coincident edges.
    Source: the outline is projected along Newell's normal; ear clipping of the library mapbox_earcut.

    >>> dart = np.array([[0.0, 0, 0], [2, 1, 0], [0, 2, 0], [1, 1, 0]])
    >>> concave_triangles(dart).tolist()
    [[3, 0, 1], [3, 1, 2]]
    >>> concave_triangles(dart[:3]) is None
    True
    """
    outline = _projected(points)
    if outline is None or _is_convex(outline):
        return None
    import mapbox_earcut

    ends = np.array([len(outline)], dtype=np.uint32)
    corners = mapbox_earcut.triangulate_float64(outline, ends)
    return np.asarray(corners, dtype=np.uint32).reshape(-1, 3)


def _projected(points: Float) -> Float | None:
    """The outline (N, 2), counter-clockwise, in the plane across Newell's normal; None if its area is zero."""
    following = np.roll(points, -1, axis=0)
    normal = np.cross(points - points[0], following - points[0]).sum(axis=0)
    length = np.linalg.norm(normal)
    extent = np.ptp(points, axis=0).max()
    if not length > 1e-12 * extent**2:
        return None
    normal = normal / length
    across = np.eye(3)[np.argmin(np.abs(normal))]
    x_axis = np.cross(across, normal)
    x_axis /= np.linalg.norm(x_axis)
    y_axis = np.cross(normal, x_axis)
    return np.ascontiguousarray((points - points[0]) @ np.stack([x_axis, y_axis]).T)


def _is_convex(outline: Float) -> bool:
    """Whether all turns of a counter-clockwise outline (N, 2) are to the left, and add up to one."""
    edges = np.roll(outline, -1, axis=0) - outline
    edges = edges[edges.any(axis=1)]  # repeated vertices
    following = np.roll(edges, -1, axis=0)
    cross = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    dot = (edges * following).sum(axis=1)
    turns = np.arctan2(cross, dot)
    return bool((turns > -_STRAIGHT).all() and turns.sum() < 3 * math.pi)


def triangulated_obj(lines: list[str]) -> list[str]:
    """The lines of an OBJ file, with triangles instead of its concave polygons; words are separated by one space."""
    polygons = [
        number
        for number, line in enumerate(lines)
        if line.startswith("f ") and line.count(" ") > 3
    ]
    if not polygons:
        return lines
    vertices = _obj_vertices(lines)
    made = list(lines)
    for number in polygons:
        corners = lines[number].split()[1:]
        points = _corner_points(corners, vertices)
        triangles = None if points is None else concave_triangles(points)
        if triangles is not None:
            faces = [" ".join(["f", *(corners[i] for i in face)]) for face in triangles]
            made[number] = "\n".join(faces)
    return made


def _obj_vertices(lines: list[str]) -> Float:
    positions = [line.split()[1:4] for line in lines if line.startswith("v ")]
    return np.array(positions, dtype=np.float64).reshape(-1, 3)


def _corner_points(corners: list[str], vertices: Float) -> Float | None:
    """The vertices (N, 3) of the corners v/vt/vn of a face; None where trimesh will report an invalid number."""
    try:
        numbers = [int(corner.split("/")[0]) for corner in corners]
    except ValueError:
        return None
    # Numbers count from 1; negative ones count from the last vertex.
    indices = [number - 1 if number > 0 else number for number in numbers]
    if max(indices) >= len(vertices) or min(indices) < -len(vertices):
        return None
    return vertices[indices]


@dataclass
class _Property:
    """A number, or a list with the type `count` of its length."""

    name: str
    type: str
    count: str | None


@dataclass
class _Element:
    name: str
    rows: int
    properties: list[_Property]

    @property
    def has_lists(self) -> bool:
        return any(item.count for item in self.properties)


class _Numbers:
    """The numbers of the body of a PLY file, one after the other; `order` is "" for text."""

    def __init__(self, body: bytes, order: str) -> None:
        self.order = order
        self._body = body
        self._words = [] if order else body.split()
        self._start = 0

    def take(self, kind: str, count: int) -> NDArray[Any]:
        """The next `count` numbers of a type. Raises InputError where the file ends."""
        if not self.order:
            words = self._words[self._start : self._start + count]
            self._start += count
            taken = np.array(words, dtype=np.float64).astype(kind)
        else:
            dtype = np.dtype(self.order + kind)
            end = self._start + count * dtype.itemsize
            taken = np.frombuffer(self._body[self._start : end], dtype=dtype)
            self._start = end
        if len(taken) < count:
            raise InputError("ends before its last face; copy the file again")
        return taken

    def take_rows(self, element: _Element) -> dict[str, NDArray[Any]]:
        """The columns of an element without lists."""
        columns = [(item.name, item.type) for item in element.properties]
        if not self.order:
            words = self.take("f8", element.rows * len(columns))
            table = words.reshape(element.rows, len(columns))
            return {
                name: table[:, i].astype(kind) for i, (name, kind) in enumerate(columns)
            }
        dtype = np.dtype([(name, self.order + kind) for name, kind in columns])
        raw = self.take("u1", element.rows * dtype.itemsize)
        table = np.frombuffer(raw.tobytes(), dtype=dtype)
        return {name: table[name] for name, _ in columns}

    def take_row(self, element: _Element) -> list[NDArray[Any]]:
        """One row of an element: an array of a value for each number, of all values for each list."""
        row = []
        for item in element.properties:
            count = 1 if item.count is None else int(self.take(item.count, 1)[0])
            row.append(self.take(item.type, count))
        return row


def triangulated_ply(data: bytes) -> bytes:
    """A PLY file with triangles instead of its polygons; `data` itself if trimesh reads it rightly.

    trimesh reads faces that are convex and all have one number of corners. A file that is rewritten has its vertices
    and faces alone. Files that this function does not understand are returned
    as they are, so that trimesh reports the error. Raises InputError for a file that ends too early.
    """
    header, elements, order = _ply_header(data)
    faces = next((item for item in elements if item.name == "face"), None)
    vertices = next((item for item in elements if item.name == "vertex"), None)
    if faces is None or vertices is None or vertices.has_lists:
        return data
    names = [item.name for item in faces.properties]
    index = next((names.index(name) for name in _INDEX_LISTS if name in names), None)
    if index is None or _has_only_triangles(data[header:], elements, order):
        return data
    numbers = _Numbers(data[header:], order)
    columns: dict[str, NDArray[Any]] = {}
    rows: list[list[NDArray[Any]]] = []
    for element in elements[: elements.index(faces) + 1]:
        if element is faces:
            rows = [numbers.take_row(faces) for _ in range(faces.rows)]
        elif element.has_lists:
            for _ in range(element.rows):
                numbers.take_row(element)
        else:
            table = numbers.take_rows(element)
            columns = table if element is vertices else columns
    if not {"x", "y", "z"} <= columns.keys():
        return data
    points = np.stack([columns[axis] for axis in "xyz"], axis=1).astype(np.float64)
    triangles = [_triangles(row[index], points) for row in rows]
    is_mixed = len({len(row[index]) for row in rows}) > 1
    if not is_mixed and all(corners is None for corners in triangles):
        return data
    made: list[list[NDArray[Any]]] = []
    for row, corners in zip(rows, triangles, strict=True):
        made += _divided(row, len(row[index]), corners)
    return _ply_text(vertices, columns, faces, made)


def _triangles(face: NDArray[Any], points: Float) -> NDArray[np.uint32] | None:
    """The triangles of a face that is concave, None for others. Raises InputError for a vertex that does not exist."""
    if len(face) and not 0 <= face.min() <= face.max() < len(points):
        raise InputError(f"a face refers to a vertex outside 0 to {len(points) - 1}")
    if len(face) < 4:
        return None
    return concave_triangles(points[face.astype(np.int64)])


def _divided(
    row: list[NDArray[Any]], count: int, triangles: NDArray[np.uint32] | None
) -> list[list[NDArray[Any]]]:
    """The rows of the triangles of a face with `count` corners, a fan unless `triangles` are given.

    Lists of values per corner are divided too.
    """
    if triangles is None:
        fan = [(0, i, i + 1) for i in range(1, count - 1)]
        triangles = np.array(fan, dtype=np.uint32).reshape(-1, 3)
    made = []
    for corners in triangles:
        part = []
        for values in row:
            per_corner = count > 1 and len(values) >= count and len(values) % count == 0
            if per_corner:
                values = values.reshape(count, -1)[corners].ravel()
            part.append(values)
        made.append(part)
    return made


def _has_only_triangles(body: bytes, elements: list[_Element], order: str) -> bool:
    """Whether a binary file has vertices, then faces of one list, and all lists have three numbers."""
    if not order or [item.name for item in elements[:2]] != ["vertex", "face"]:
        return False
    vertices, faces = elements[:2]
    if len(faces.properties) != 1:
        return False
    sizes = [np.dtype(item.type).itemsize for item in vertices.properties]
    indices = faces.properties[0]
    row = np.dtype(
        [("count", order + str(indices.count)), ("corners", order + indices.type, 3)]
    )
    start = vertices.rows * sum(sizes)
    end = start + faces.rows * row.itemsize
    if len(body) < end:
        return False
    return bool((np.frombuffer(body[start:end], dtype=row)["count"] == 3).all())


def _ply_header(data: bytes) -> tuple[int, list[_Element], str]:
    """Where the body starts, the elements and the byte order. No elements if the header is not understood."""
    end = data.find(b"end_header")
    start = data.find(b"\n", end) + 1
    if end < 0 or start == 0:
        return 0, [], ""
    order = ""
    elements: list[_Element] = []
    for line in data[:end].decode("ascii", "replace").splitlines():
        match line.split():
            case ["format", name, *_]:
                order = _PLY_FORMATS.get(name, "")
            case ["element", name, rows] if rows.isdigit():
                elements.append(_Element(name, int(rows), []))
            case ["property", "list", count, kind, name] if elements:
                if count not in _PLY_TYPES or kind not in _PLY_TYPES:
                    return 0, [], ""
                item = _Property(name, _PLY_TYPES[kind], _PLY_TYPES[count])
                elements[-1].properties.append(item)
            case ["property", kind, name] if elements:
                if kind not in _PLY_TYPES:
                    return 0, [], ""
                elements[-1].properties.append(_Property(name, _PLY_TYPES[kind], None))
    return start, elements, order


def _ply_text(
    vertices: _Element,
    columns: dict[str, NDArray[Any]],
    faces: _Element,
    rows: list[list[NDArray[Any]]],
) -> bytes:
    """A PLY file of text with the given vertices and faces; numbers have all their digits."""
    lines = ["ply", "format ascii 1.0", f"element vertex {vertices.rows}"]
    lines += [
        f"property {_type_name(item.type)} {item.name}" for item in vertices.properties
    ]
    lines.append(f"element face {len(rows)}")
    for item in faces.properties:
        list_type = "" if item.count is None else "list uint "
        lines.append(f"property {list_type}{_type_name(item.type)} {item.name}")
    lines.append("end_header")
    table = [columns[item.name].tolist() for item in vertices.properties]
    lines += [" ".join(map(repr, values)) for values in zip(*table, strict=True)]
    for row in rows:
        words: list[str] = []
        for item, values in zip(faces.properties, row, strict=True):
            if item.count is not None:
                words.append(str(len(values)))
            words += map(repr, values.tolist())
        lines.append(" ".join(words))
    return ("\n".join(lines) + "\n").encode()


def _type_name(kind: str) -> str:
    """The name in PLY files of a NumPy type."""
    return next(name for name, value in _PLY_TYPES.items() if value == kind)
