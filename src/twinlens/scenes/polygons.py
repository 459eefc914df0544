"""Triangles of the polygons and strips of OBJ and PLY files.

trimesh divides a polygon into a fan of triangles around its first vertex, which also covers the notches of a concave
polygon. A file with such polygons is therefore rewritten before trimesh reads it, with triangles by ear clipping.
Convex polygons stay as they are. So a quad that is not planar is split along the diagonal from its first vertex,
unless its projection along its mean normal is concave.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
_STRIPS = "tristrips"
_NEXT_STRIP = -1
_PLY_READ = {"x", "y", "z", "texture_u", "texture_v", "u", "v", "s", "t"}
_PLY_NORMALS = {"nx", "ny", "nz"}
_PLY_COLORS = {"red", "green", "blue", "alpha"}
_PLY_START = re.compile(rb"ply(\r\n?)")
_STRAIGHT = 1e-9  # radians: a turn to the wrong side that rounding explains


def concave(polygons: Float) -> NDArray[np.bool_]:
    """Whether polygons of one number of vertices are concave: (P,) of vertices (P, N, 3); False for those without area.

    Turns are those of the projection along Newell's normal. A polygon is convex if all turns are to the left, and add
    up to one.

    >>> dart = [[0.0, 0, 0], [2, 1, 0], [0, 2, 0], [1, 1, 0]]
    >>> square = [[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]
    >>> concave(np.array([dart, square])).tolist()
    [True, False]
    """
    edges = np.roll(polygons, -1, axis=1) - polygons
    normals = _newell_normals(polygons)
    lengths = np.linalg.norm(normals, axis=1)
    extents = np.ptp(polygons, axis=1).max(axis=1)
    has_area = lengths > 1e-12 * extents**2
    # An edge of a repeated vertex has no direction: each edge turns to the next one that has a length.
    following = _next_edges(edges)
    cross = np.einsum("pni,pi->pn", np.cross(edges, following), normals)
    cross /= np.where(has_area, lengths, 1.0)[:, None]
    along = np.einsum("pni,pi->pn", edges, normals)
    along_next = np.einsum("pni,pi->pn", following, normals)
    squared = np.where(has_area, lengths, 1.0)[:, None] ** 2
    dot = (edges * following).sum(axis=2) - along * along_next / squared
    turns = np.arctan2(cross, dot)
    is_convex = (turns > -_STRAIGHT).all(axis=1) & (turns.sum(axis=1) < 3 * math.pi)
    return np.asarray(has_area & ~is_convex)


def _newell_normals(polygons: Float) -> Float:
    """Twice the area vectors (P, 3) of polygons (P, N, 3). Source: Newell's method."""
    away = polygons - polygons[:, :1]
    crosses = np.cross(away, np.roll(away, -1, axis=1))
    return np.asarray(crosses.sum(axis=1))


def _next_edges(edges: Float) -> Float:
    """For each edge (P, N, 3) the next one around its polygon that has a length."""
    following = np.roll(edges, -1, axis=1)
    for _ in range(edges.shape[1] - 2):
        is_empty = ~following.any(axis=2, keepdims=True)
        if not is_empty.any():
            break
        following = np.where(is_empty, np.roll(following, -1, axis=1), following)
    return following


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
    if not concave(points[None])[0]:
        return None
    outline = _projected(points)
    import mapbox_earcut

    ends = np.array([len(outline)], dtype=np.uint32)
    corners = mapbox_earcut.triangulate_float64(outline, ends)
    return np.asarray(corners, dtype=np.uint32).reshape(-1, 3)


def _projected(points: Float) -> Float:
    """The outline (N, 2), counter-clockwise, in the plane across Newell's normal."""
    [normal] = _newell_normals(points[None])
    normal = normal / np.linalg.norm(normal)
    across = np.eye(3)[np.argmin(np.abs(normal))]
    x_axis = np.cross(across, normal)
    x_axis /= np.linalg.norm(x_axis)
    y_axis = np.cross(normal, x_axis)
    return np.ascontiguousarray((points - points[0]) @ np.stack([x_axis, y_axis]).T)


def _triangles_of_concave(
    polygons: Sequence[NDArray[np.int64]], points: Float
) -> dict[int, NDArray[np.uint32]]:
    """The triangles of the concave ones among polygons, by their number. Polygons of one size are examined together."""
    numbers: dict[int, list[int]] = {}
    for number, corners in enumerate(polygons):
        if len(corners) > 3:
            numbers.setdefault(len(corners), []).append(number)
    made = {}
    for group in numbers.values():
        vertices = points[np.stack([polygons[number] for number in group])]
        for place in np.flatnonzero(concave(vertices)):
            triangles = concave_triangles(vertices[place])
            if triangles is not None:
                made[group[place]] = triangles
    return made


def triangulated(
    counts: NDArray[np.int64], vertices: NDArray[np.int64], points: Float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (T, 3) of polygons, as numbers of their corners, and the polygon (T,) of each.

    counts : the number of corners of each polygon (P,). vertices : the number in `points` (V, 3) of each corner (C,).
    """
    starts = np.concatenate([[0], np.cumsum(counts)])[:-1]
    polygons = np.split(vertices, starts[1:]) if len(counts) else []
    concave_ones = _triangles_of_concave(polygons, points)
    is_fan = counts >= 3
    is_fan[list(concave_ones)] = False
    fans = np.flatnonzero(is_fan)
    # The triangle k of a fan has the corners 0, k + 1, k + 2 of its polygon.
    of_triangles = np.repeat(fans, counts[fans] - 2)
    firsts = np.concatenate([[0], np.cumsum(counts[fans] - 2)])[:-1]
    step = np.arange(len(of_triangles)) - np.repeat(firsts, counts[fans] - 2)
    corners = starts[of_triangles][:, None] + np.stack(
        [np.zeros_like(step), step + 1, step + 2], axis=1
    )
    made, owners = [corners], [of_triangles]
    for number, triangles in concave_ones.items():
        made.append(starts[number] + triangles.astype(np.int64))
        owners.append(np.full(len(triangles), number))
    return np.concatenate(made), np.concatenate(owners)


def triangulated_obj(lines: list[str]) -> list[str]:
    """The lines of an OBJ file, with triangles instead of its concave polygons; words are separated by one space."""
    lines_of_polygons = [
        number
        for number, line in enumerate(lines)
        if line.startswith("f ") and line.count(" ") > 3
    ]
    if not lines_of_polygons:
        return lines
    vertices = _obj_vertices(lines)
    words = [lines[number].split()[1:] for number in lines_of_polygons]
    polygons = [_corner_indices(corners, len(vertices)) for corners in words]
    made = list(lines)
    for place, triangles in _triangles_of_concave(polygons, vertices).items():
        corners = words[place]
        faces = []
        for face in triangles:
            words_of_face = ["f", *(corners[i] for i in face)]
            faces.append(" ".join(words_of_face))
        made[lines_of_polygons[place]] = "\n".join(faces)
    return made


def _obj_vertices(lines: list[str]) -> Float:
    positions = [line.split()[1:4] for line in lines if line.startswith("v ")]
    return np.array(positions, dtype=np.float64).reshape(-1, 3)


def _corner_indices(corners: list[str], count: int) -> NDArray[np.int64]:
    """The vertices (N,) of the corners v/vt/vn of a face; none where trimesh will report an invalid number."""
    try:
        numbers = np.array([int(corner.split("/")[0]) for corner in corners])
    except (ValueError, OverflowError):
        return np.zeros(0, dtype=np.int64)
    # Numbers count from 1; negative ones count from the last vertex.
    indices = np.where(numbers > 0, numbers - 1, numbers + count)
    if indices.min() < 0 or indices.max() >= count:
        return np.zeros(0, dtype=np.int64)
    return indices


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
    """A PLY file with triangles instead of its polygons and strips; `data` itself if trimesh reads it rightly.

    trimesh reads faces that are convex and all have one number of corners. A file that is rewritten has its vertices
    and faces alone. Files that this function does not understand are returned as they are, so that trimesh reports the
    error. Raises InputError for a file that ends too early, and for a face with a vertex that does not exist.
    """
    data = with_line_feeds(data)
    header, elements, order = _ply_header(data)
    by_name = {element.name: element for element in elements}
    vertices = by_name.get("vertex")
    # A file of strips has no faces, or an empty list of them.
    faces, strips = by_name.get("face"), by_name.get(_STRIPS)
    if faces is None or (strips is not None and not faces.rows):
        faces = strips
    if faces is None or vertices is None or vertices.has_lists:
        return data
    names = [item.name for item in faces.properties]
    index = next((names.index(name) for name in _INDEX_LISTS if name in names), None)
    if index is None or _has_only_triangles(data[header:], elements, order):
        return data
    columns, rows = _ply_rows(_Numbers(data[header:], order), elements, vertices, faces)
    if not {"x", "y", "z"} <= columns.keys():
        return data
    points = np.stack([columns[axis] for axis in "xyz"], axis=1).astype(np.float64)
    if faces is strips:
        corners = strip_triangles([row[index] for row in rows])
        checked = _checked_face(corners, len(points))
        of_index = replace(faces, properties=[faces.properties[index]])
        return _ply_text(vertices, columns, of_index, [[face] for face in checked])
    polygons = [_checked_face(row[index], len(points)) for row in rows]
    triangles = _triangles_of_concave(polygons, points)
    is_mixed = len({len(polygon) for polygon in polygons}) > 1
    if not is_mixed and not triangles:
        return data
    made: list[list[NDArray[Any]]] = []
    for number, row in enumerate(rows):
        made += _divided(row, len(row[index]), triangles.get(number))
    return _ply_text(vertices, columns, faces, made)


def with_line_feeds(data: bytes) -> bytes:
    """A PLY file whose header, and whose text, has lines that end as Unix's do; old ones end in a carriage return.

    >>> with_line_feeds(b"ply\\rformat ascii 1.0\\rend_header\\r1\\r")
    b'ply\\nformat ascii 1.0\\nend_header\\n1\\n'
    """
    # The first line shows how lines end: the first byte of binary numbers may be a line feed too.
    ending = _PLY_START.match(data)
    end = -1 if ending is None else data.find(b"end_header" + ending[1])
    if ending is None or end < 0:
        return data
    start = end + len(b"end_header" + ending[1])
    header, body = data[:start], data[start:]
    if b"format ascii" in header:
        body = body.replace(ending[1], b"\n")
    return header.replace(ending[1], b"\n") + body


def _ply_rows(
    numbers: _Numbers, elements: list[_Element], vertices: _Element, faces: _Element
) -> tuple[dict[str, NDArray[Any]], list[list[NDArray[Any]]]]:
    """The columns of the vertices and the rows of the faces, from the numbers of all elements up to both."""
    columns: dict[str, NDArray[Any]] = {}
    rows: list[list[NDArray[Any]]] = []
    last = max(elements.index(vertices), elements.index(faces))
    for element in elements[: last + 1]:
        if element is vertices:
            columns = numbers.take_rows(element)
        elif element is faces or element.has_lists:
            taken = [numbers.take_row(element) for _ in range(element.rows)]
            rows = taken if element is faces else rows
        else:
            numbers.take_rows(element)
    return columns, rows


def strip_triangles(strips: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    """The triangles (T, 3) of strips of vertices, with -1 between two strips of one list.

    Every second triangle of a strip is turned, so that all face the same side. Those with a repeated vertex, which join
    strips, are left out.

    >>> strip_triangles([np.array([0, 1, 2, 3, -1, 4, 5, 6])]).tolist()
    [[0, 1, 2], [2, 1, 3], [4, 5, 6]]
    """
    made = [np.zeros((0, 3), np.int64)]
    for listed in strips:
        ends = np.flatnonzero(listed == _NEXT_STRIP)
        for part in np.split(listed.astype(np.int64), ends):
            strip = part[part != _NEXT_STRIP]
            corners = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
            corners[1::2, :2] = corners[1::2, 1::-1]
            made.append(corners)
    triangles = np.concatenate(made)
    a, b, c = triangles.T
    return np.asarray(triangles[(a != b) & (b != c) & (a != c)])


def ply_not_used(data: bytes) -> list[str]:
    """What a PLY file has besides positions, texture coordinates and faces, with what is done instead."""
    _, elements, _ = _ply_header(with_line_feeds(data))
    names: dict[str, set[str]] = {}
    for element in elements:
        names[element.name] = {column.name for column in element.properties}
    of_vertices = names.pop("vertex", set()) - _PLY_READ
    read_of_faces = {*_INDEX_LISTS, "texcoord"}
    has_faces = any(item.name == "face" and item.rows for item in elements)
    of_faces = names.pop("face", set()) - read_of_faces
    if not has_faces:
        of_faces |= names.pop(_STRIPS, set()) - set(_INDEX_LISTS)
    parts = []
    if of_vertices & _PLY_NORMALS:
        parts.append("normals")
    for owner, others in (("vertices", of_vertices), ("faces", of_faces)):
        if others & _PLY_COLORS:
            parts.append(f"colours of {owner} (the object's material)")
        rest = sorted(others - _PLY_COLORS - _PLY_NORMALS)
        parts += [f"{name!r} of {owner} (left out)" for name in rest]
    parts += [f"element {name!r} (left out)" for name in sorted(names)]
    header = data[: data.find(b"end_header")]
    if b"comment TextureFile" in header:
        parts.append("its picture (the object's material)")
    return parts


def _checked_face(face: NDArray[Any], count: int) -> NDArray[np.int64]:
    """The vertices of a face. Raises InputError for one that does not exist."""
    if len(face) and not 0 <= face.min() <= face.max() < count:
        raise InputError(f"a face refers to a vertex outside 0 to {count - 1}")
    return face.astype(np.int64)


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
