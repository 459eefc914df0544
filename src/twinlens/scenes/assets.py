"""Files that a scene names: paths below the scene's own folder only, pictures and meshes read into arrays.

A scene file from an untrusted source must not open other files of the machine: absolute paths, ``..`` and symbolic
links that leave the folder are rejected before anything is opened. A file is read only as the format of its suffix.
Libraries that detect the format from the content would pass a renamed file to any of their readers (Pillow runs
Ghostscript on PostScript).
"""

import logging
import os
import posixpath
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import (
    FileError,
    InputError,
    MissingExtraError,
    counted,
    file_hint,
    format_value,
    warn_not_used,
)
from twinlens.pictures import (
    kind_of_picture,
    lost_of_tiff,
    opened,
    silent,
    stored_values,
)
from twinlens.scenes import shapes
from twinlens.scenes.materials import AnyMaterial
from twinlens.scenes.obj_numbers import with_positive_numbers
from twinlens.scenes.polygons import ply_not_used, triangulated_obj, triangulated_ply
from twinlens.scenes.scene import Mesh, SceneWarning

USD_FILES = (".usd", ".usda", ".usdc", ".usdz")
MESH_FILES = {".ply", ".obj", ".glb", ".gltf", ".stl", *USD_FILES}
MOST_FACES = 20_000_000
LARGEST_MESH_FILE = 2 << 30  # bytes, and of all files that it names
_MOST_PIXELS = 1 << 27
_MOST_CHANNELS = 64
_MOST_VALUES = 1 << 29
_LARGEST_PICTURE_FILE = 1 << 30  # bytes
_LONGEST_REASON = 300
_OBJ_ZERO = re.compile(r"[ /][+-]?0+(?![^ /])")
_OBJ_FACE = re.compile(r"f( [+-]?\d+(/[+-]?\d*){0,2})+ ?")
_OBJ_CORNER = re.compile(r" ([+-]?\d+)(?:/([+-]?\d+))?")
_OBJ_READ = {"v", "vt", "vn", "f", "g", "o", "s", "usemtl", "mtllib"}
_MOST_POSITION_WORDS = 4  # x, y, z and a weight
_COMMENT = re.compile(r"(^|\s)#.*")  # names such as "Material__#25" have the sign too
_CONTINUED = re.compile(r"\\\r?\n")
# trimesh logs tracebacks of damaged files; without any handler, Python would print them.
logging.getLogger("trimesh").addHandler(logging.NullHandler())
_PICTURE_KINDS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".bmp": "BMP",
    ".tga": "TGA",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".webp": "WEBP",
}
_MITSUBA_LACKS = {".tif", ".tiff", ".webp"}


@dataclass(frozen=True, eq=False)
class SceneContext:
    """What the models of a scene file need while they are read: folder of the file, named textures.

    `files` and `materials` collect the files found, and the materials of mesh files by name; `models` are the mesh
    files that were read, which several objects may have.
    """

    folder: Path
    textures: dict[str, Any] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)
    materials: dict[str, AnyMaterial] = field(default_factory=dict)
    models: dict[Any, Any] = field(default_factory=dict)


def find_asset(name: str, context: SceneContext) -> Path:
    """The path of an existing file below the scene's folder, noted in `context.files`. Raises InputError."""
    named = (
        isinstance(name, str)
        and 0 < len(name) < 256
        and not ("\0" in name or "\\" in name)
    )
    if not named or PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive:
        rule = "must be a file name relative to the file that names it, with forward slashes"
        raise InputError(f"{rule}, got {format_value(name)}")
    folder = context.folder.resolve()
    path = (folder / name).resolve()
    if not path.is_relative_to(folder):
        raise InputError(
            f"{name!r} leads outside the folder {folder.name!r}; copy the file below it"
        )
    if ".." in PurePosixPath(name).parts:
        raise InputError(
            f"{name!r}: '..' is not allowed; write {path.relative_to(folder).as_posix()!r}"
        )
    if not os.path.isfile(path):  # noqa: PTH113 (a name that is too long is no file; Path.is_file raises)
        raise InputError(f"no file {name!r} in the folder {folder.name!r}")
    context.files.append(path)
    return path


def find_named(name: str, path: Path, context: SceneContext) -> Path:
    """The file that the file at `path` names; `..` may lead to other folders below the context's."""
    if "://" in name:
        raise InputError(
            f"web addresses are not read; save the file beside this one, got {format_value(name)}"
        )
    return find_asset(
        posixpath.normpath(folder_of(path, context) / name) if name else "", context
    )


def folder_of(path: Path, context: SceneContext) -> Path:
    """The folder of a mesh file, relative to the context's."""
    return path.parent.resolve().relative_to(context.folder.resolve())


def _sky(name: Any, info: Any) -> str:
    path = find_asset(name, info.context)
    check_mitsuba_opens(path)
    read_sky(path)
    return str(path)


Asset = Annotated[
    Path,
    pydantic.PlainValidator(
        lambda name, info: find_asset(name, info.context), json_schema_input_type=str
    ),
]
"""The name of a file below the scene's folder."""

Sky = Annotated[str, pydantic.PlainValidator(_sky, json_schema_input_type=str)]
"""The name of a picture below the scene's folder that Mitsuba accepts as an environment map."""


def linear_from_srgb(encoded: ArrayLike) -> NDArray[np.float32]:
    """Linear light from sRGB-encoded values in [0, 1]; float32, same shape. Source: IEC 61966-2-1:1999."""
    v = np.asarray(encoded, dtype=np.float64)
    return np.where(
        v <= 0.04045, v / 12.92, ((np.maximum(v, 0.04045) + 0.055) / 1.055) ** 2.4
    ).astype(np.float32)


def read_picture(path: Path, raw: bool = False) -> NDArray[np.float32]:
    """A picture as linear float32 (H, W, 3). Integers, as in .png and .jpg, are decoded from sRGB unless `raw`.

    Raises FileError for a damaged or too large file, and for negative or non-finite values.
    """
    pixels, encoded = decode_picture(path)
    if not np.isfinite(pixels).all() or (pixels < 0).any():
        raise FileError(f"{path}: a texture needs finite values >= 0 in every pixel")
    return linear_from_srgb(pixels) if encoded and not raw else pixels


def decode_picture(path: Path) -> tuple[NDArray[np.float32], bool]:
    """The stored values (H, W, 3) of a picture, and whether they are sRGB-encoded. Raises FileError."""
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise FileError(
            f"{path}: pictures may be {', '.join(sorted(_READERS))}, got {path.suffix!r}"
        )
    with reading(path, "picture"):
        return reader(path)


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Turns the many types of exceptions that libraries raise on damaged files into FileError."""
    try:
        yield
    except InputError as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise FileError(f"{path}: {reason[:_LONGEST_REASON]}") from error
    except MissingExtraError as error:
        raise MissingExtraError(f"{path}: {error}") from error
    except Exception as error:
        try:
            text = " ".join(str(error).split())[:_LONGEST_REASON]
            reason = text or type(error).__name__
        except UnicodeDecodeError:  # a library's text of bytes of the file
            reason = type(error).__name__
        raise FileError(
            f"{path}: cannot be read as a {path.suffix} {kind} ({reason})"
        ) from error


def read_limited(path: Path, limit: int) -> bytes:
    """The content of a file of at most `limit` bytes. Raises FileError."""
    try:
        if path.stat().st_size > limit:
            raise FileError(f"{path}: the file is larger than {limit >> 20} MiB")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise FileError(
            f"{path}: cannot be read ({error.strerror}){file_hint(path)}"
        ) from error
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from error


def read_sky(path: Path) -> NDArray[np.float32]:
    """A picture that Mitsuba accepts as an environment map. Raises FileError."""
    pixels = read_picture(path)
    rows, columns = pixels.shape[:2]
    if rows < 3 or columns < 2:  # Mitsuba's own limit
        raise FileError(
            f"{path}: an environment map needs 2x3 pixels or more, got {columns}x{rows}"
        )
    return pixels


def check_mitsuba_opens(path: Path) -> None:
    """Raise FileError for a picture of a kind that Mitsuba cannot open by itself."""
    if path.suffix.lower() in _MITSUBA_LACKS:
        others = sorted(_READERS.keys() - _MITSUBA_LACKS)
        raise FileError(
            f"{path}: Mitsuba opens this file by itself, and only {', '.join(others)}; convert it"
        )


def check_picture_size(name: object, width: int, height: int) -> None:
    """Raise FileError for a picture of no or too many pixels."""
    if not (width > 0 and height > 0 and width * height <= _MOST_PIXELS):
        raise FileError(
            f"{name}: a picture may have 1 to {_MOST_PIXELS} pixels, got {width}x{height}"
        )


def _read_with_pillow(path: Path) -> tuple[NDArray[np.float32], bool]:
    data = read_limited(path, _LARGEST_PICTURE_FILE)
    kind = _PICTURE_KINDS[path.suffix.lower()]
    _check_kind(path, data, kind)
    with opened(data, kind) as image:
        check_picture_size(path, image.width, image.height)
        lost = [*lost_of_tiff(image), *_lost_alpha(image)]
        values = stored_values(image, data, "RGB")
    warn_not_used(path, lost, SceneWarning)
    colors = values[..., [0, 0, 0]] if values.shape[2] < 3 else values[..., :3]
    if colors.dtype == np.float32:
        return np.asarray(colors, np.float32), False
    most = np.float32(65535 if colors.dtype == np.uint16 else 255)
    return colors.astype(np.float32) / most, True


def _check_kind(path: Path, data: bytes, kind: str) -> None:
    """Raise FileError for a picture whose content is of another kind than its name says."""
    stored = kind_of_picture(data)
    if stored != kind:
        remedy = f"; it is a {stored} picture: rename it" if stored else ""
        raise FileError(f"{path}: is not a {kind} picture{remedy}")


def _lost_alpha(image: Any) -> list[str]:
    """The alpha channel of a picture of Pillow, if it is not opaque everywhere."""
    if not image.has_transparency_data:
        return []
    alpha = image.convert("RGBA").getchannel("A")
    is_opaque = alpha.getextrema()[0] == 255
    return [] if is_opaque else ["its alpha channel (opaque; a 'mask' takes opacity)"]


def _read_exr(path: Path) -> tuple[NDArray[np.float32], bool]:
    import OpenEXR

    with OpenEXR.File(
        str(path), header_only=True
    ) as file:  # all parts and channels are read, without a limit of size
        if len(file.parts) != 1:
            raise FileError(f"{path}: needs one part, got {len(file.parts)}")
        header = dict(file.header())  # closing the file empties its own
    if header["type"] not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        raise FileError(f"{path}: deep pictures are not supported; flatten it")
    if len(header["channels"]) > _MOST_CHANNELS:
        raise FileError(
            f"{path}: at most {_MOST_CHANNELS} channels are supported, got {len(header['channels'])}"
        )
    (left, top), (right, bottom) = (corner.tolist() for corner in header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    check_picture_size(path, width, height)
    if width * height * len(header["channels"]) > _MOST_VALUES:
        raise FileError(
            f"{path}: {len(header['channels'])} channels of {width}x{height} pixels are too many values"
        )
    with silent(), OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {
            name: np.asarray(channel.pixels, dtype=np.float32)
            for name, channel in file.channels().items()
        }
    names = "RGB" if {"R", "G", "B"} <= channels.keys() else "YYY"
    if not set(names) <= channels.keys():
        raise FileError(
            f"{path}: needs the channels R, G, B or Y, got {', '.join(sorted(channels))}"
        )
    return np.ascontiguousarray(
        np.stack([channels[name] for name in names], axis=-1)
    ), False


def _read_hdr(path: Path) -> tuple[NDArray[np.float32], bool]:
    """Radiance RGBE. Source: G. Ward, Real Pixels, Graphics Gems II, 1991."""
    data = read_limited(path, _LARGEST_PICTURE_FILE)
    head, _, body = data.partition(b"\n\n")
    size, _, body = body.partition(b"\n")
    words = size.split()
    if (
        not data.startswith(b"#?")
        or len(words) != 4
        or (words[0], words[2]) != (b"-Y", b"+X")
    ):
        raise FileError(f"{path}: not a Radiance picture in -Y +X order")
    height, width = int(words[1]), int(words[3])
    check_picture_size(path, width, height)
    if b"FORMAT=32-bit_rle_rgbe" not in head:
        raise FileError(f"{path}: needs FORMAT=32-bit_rle_rgbe")
    rgbe = _unpack_rgbe(np.frombuffer(body, dtype=np.uint8), height, width)
    scale = np.where(
        rgbe[..., 3:] > 0, np.exp2(rgbe[..., 3:].astype(np.float32) - 136), 0
    )
    return (rgbe[..., :3] * scale).astype(np.float32), False


def _unpack_rgbe(body: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint8]:
    """(H, W, 4) from run-length-encoded scanlines, or from flat pixels where the file is not encoded."""
    if not (8 <= width < 32768 and body[:2].tolist() == [2, 2]):
        if len(body) < height * width * 4:
            raise InputError(
                f"ends after {len(body)} of {height * width * 4} bytes of pixels; copy the file again"
            )
        return body[: height * width * 4].reshape(height, width, 4)
    out = np.empty((height, 4, width), dtype=np.uint8)
    cursor = 0
    for line in out:
        if body[cursor : cursor + 4].tolist() != [2, 2, width >> 8, width & 255]:
            raise ValueError("a scanline does not start with its width")
        cursor += 4
        for channel in line:
            done = 0
            while done < width:
                count = int(body[cursor])
                count, taken = (count - 128, 1) if count > 128 else (count, count)
                if not 0 < count <= width - done:
                    raise ValueError("a run is longer than its scanline")
                channel[done : done + count] = body[cursor + 1 : cursor + 1 + taken]
                done += count
                cursor += 1 + taken
    return np.moveaxis(out, 1, 2)


_READERS = {
    **dict.fromkeys(_PICTURE_KINDS, _read_with_pillow),
    ".exr": _read_exr,
    ".hdr": _read_hdr,
}


def read_mesh(path: Path, crease_deg: float | None = None) -> Mesh:
    """All triangles of a mesh file as one mesh; edges over `crease_deg` (30) stay sharp, all of them for 0.

    Materials and other files it names are ignored. Gives a `SceneWarning` that names other parts that are not used,
    the normals of the file only without `crease_deg`. Raises FileError for a damaged or too large file.
    """
    if path.suffix.lower() not in MESH_FILES:
        raise FileError(
            f"{path}: meshes may be {', '.join(sorted(MESH_FILES))}, got {path.suffix!r}"
        )
    with reading(path, "mesh"):
        import trimesh

        data, not_used = _mesh_data(path)
        # A stream has no folder, so that the file cannot name its neighbours.
        stream = BytesIO(data)
        loaded = trimesh.load_scene(
            stream, file_type=path.suffix[1:].lower(), process=False
        )
        for part in loaded.geometry.values():  # joining the parts shifts vertex numbers
            check_faces(path, part)
        placed = (
            loaded.geometry[loaded.graph[node][1]]
            for node in loaded.graph.nodes_geometry
        )
        check_face_count(path, sum(len(getattr(part, "faces", ())) for part in placed))
        made = loaded.to_mesh()
        if not len(made.faces):
            raise no_triangles(path, not_used)
        if not np.isfinite(made.vertices).all():
            raise FileError(f"{path}: has vertices that are not finite")
        mesh = shapes.from_trimesh(made, 30.0 if crease_deg is None else crease_deg)
    warn_not_used(path, without_normals(not_used, crease_deg), SceneWarning)
    return mesh


def _mesh_data(path: Path) -> tuple[bytes, list[str]]:
    """The bytes of a mesh file, with its polygons as triangles, and what of it is not used."""
    data = read_limited(path, LARGEST_MESH_FILE)
    kind = path.suffix.lower()
    if kind == ".obj":
        lines = obj_lines(path, data)
        return "\n".join(lines).encode(), obj_not_used(lines)
    if kind == ".ply":
        return triangulated_ply(data), ply_not_used(data)
    if kind == ".stl":
        _check_facets(path, data)
    if kind == ".stl" and _has_facet_colors(data):
        return data, ["colours of facets (the object's material)"]
    return data, []


def without_normals(not_used: list[str], crease_deg: float | None) -> list[str]:
    """Parts of a file that are not used; its "normals" are among them only where nothing else was asked for."""
    named = {"normals": "normals (edges over 30 degrees are sharp; see crease_deg)"}
    if crease_deg is not None:
        not_used = [part for part in not_used if part != "normals"]
    return [named.get(part, part) for part in not_used]


def _check_facets(path: Path, stl: bytes) -> None:
    """Raise FileError for a binary STL file that ends before its last facet."""
    is_text = stl[:512].lstrip()[:5].lower() == b"solid" and b"facet" in stl.lower()
    count = int.from_bytes(stl[80:84], "little")
    present = max(0, (len(stl) - 84) // 50)
    if not is_text and present < count:
        raise FileError(
            f"{path}: has {present} of {counted(count, 'facet')}; is the file complete?"
        )


def _has_facet_colors(stl: bytes) -> bool:
    """Whether a binary STL file has attributes, in which some programs keep colours."""
    count = int.from_bytes(stl[80:84], "little")
    if len(stl) != 84 + 50 * count:
        return False
    facets = np.frombuffer(stl[84:], dtype=np.uint8).reshape(count, 50)
    return bool(facets[:, 48:].any())


def text_lines(data: bytes) -> list[str]:
    """The lines of an OBJ or .mtl file, words separated by one space, without comments; "\\" continues a line.

    >>> text_lines(b"\\tusemtl  wood #25 \\r\\nf 1 2 \\\\\\n  3\\nnewmtl wood__#25")
    ['usemtl wood', 'f 1 2 3', 'newmtl wood__#25']
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:  # of older programs, in which every byte is a letter
        text = data.decode("latin-1")
    text = _CONTINUED.sub(" ", text)
    return [" ".join(_COMMENT.sub("", line).split()) for line in text.splitlines()]


def obj_lines(path: Path, data: bytes) -> list[str]:
    """The lines of an OBJ file, words separated by one space, without comments, and without concave polygons.

    Raises FileError for vertex numbers that trimesh misreads.
    """
    try:
        lines = with_positive_numbers(text_lines(data))
    except InputError as error:
        raise FileError(f"{path}: {error}") from None
    faces = [line for line in lines if line.startswith("f ")]
    if any(map(_OBJ_ZERO.search, faces)):
        raise FileError(f"{path}: a face has the vertex number 0; OBJ counts from 1")
    _check_obj_faces(path, lines)
    _check_positions(path, lines)
    return triangulated_obj(lines)


def _check_obj_faces(path: Path, lines: list[str]) -> None:
    """Raise FileError for a face that is not of numbers, or that refers to a vertex that is not in the file."""
    starts = [line[:3] for line in lines]
    counts = {
        "vertex": sum(start.startswith("v ") for start in starts),
        "texture coordinate": starts.count("vt "),
    }
    for line in lines:
        if not line.startswith("f "):
            continue
        if not _OBJ_FACE.fullmatch(line):
            raise FileError(f"{path}: the face {line[:60]!r} is not of vertex numbers")
        for corner in _OBJ_CORNER.findall(line):
            for text, (name, count) in zip(corner, counts.items(), strict=True):
                # Files without texture coordinates may number them all the same.
                if text and count and abs(int(text)) > count:
                    raise FileError(
                        f"{path}: the face {line[:60]!r} refers to {name} {text}; the file has {count}"
                    )


def _check_positions(path: Path, lines: list[str]) -> None:
    """Raise FileError for a vertex that is not three or more numbers with decimal points."""
    for line in lines:
        if not line.startswith("v "):
            continue
        words = line.split(" ")[1:]
        try:
            is_position = len([float(word) for word in words]) >= 3
        except ValueError:
            is_position = False
        if not is_position:
            raise FileError(
                f"{path}: the vertex {line[:60]!r} must be three numbers, such as v 0.5 0 1"
            )


def obj_not_used(lines: list[str]) -> list[str]:
    """What the lines of an OBJ file have besides positions, texture coordinates, faces and materials."""
    keywords = {line.partition(" ")[0] for line in lines if line}
    parts = []
    smooth = [line for line in lines if line.startswith("s ")]
    is_smooth = any(line not in ("s off", "s 0") for line in smooth)
    if "vn" in keywords or is_smooth:
        parts.append("normals")
    if any(
        line.count(" ") > _MOST_POSITION_WORDS for line in lines if line[:2] == "v "
    ):
        parts.append("colours of vertices (the material)")
    others = sorted(keywords - _OBJ_READ)
    named = {"l": "lines", "p": "points"}
    return [*parts, *(f"{named.get(key, key)} (left out)" for key in others)]


def check_faces(path: Path, part: Any) -> None:
    """Raise FileError if a face of trimesh's mesh refers to a missing vertex."""
    faces = getattr(part, "faces", ())
    if len(faces) and not 0 <= np.min(faces) <= np.max(faces) < len(part.vertices):
        raise FileError(
            f"{path}: a face refers to a vertex outside 0 to {len(part.vertices) - 1}"
        )


def no_triangles(path: Path, not_used: Iterable[str]) -> FileError:
    """The error of a file without a triangle, which names what it has instead."""
    others = ", ".join(dict.fromkeys(not_used))
    return FileError(
        f"{path}: has no triangles" + (f"; it has {others}" if others else "")
    )


def check_face_count(path: Path, count: int) -> None:
    """Raise FileError for too many triangles, counted as placed: one part may be placed many times."""
    if count > MOST_FACES:
        raise FileError(
            f"{path}: {count} triangles are more than {MOST_FACES}; simplify the mesh"
        )
