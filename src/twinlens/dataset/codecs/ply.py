"""Triangle meshes as binary PLY files, by trimesh; coloured points as binary PLY files."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.files import read_bytes
from twinlens.dataset.storage import Where
from twinlens.errors import FileError


def encode_ply(
    vertices: NDArray[Any], faces: NDArray[Any], text: bool = False
) -> bytes:
    """A PLY file of vertices (V, 3), float32, and faces (F, 3); with `text`, readable and with vertex normals."""
    import trimesh

    encoding = (
        {"encoding": "ascii", "vertex_normal": True} if text else {"encoding": "binary"}
    )
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return mesh.export(file_type="ply", **encoding)  # type: ignore[no-any-return]


_POINT = np.dtype([("position", "<f4", 3), ("color", "u1", 3)])


def encode_points(points: NDArray[Any], colors: NDArray[np.uint8]) -> bytes:
    """A binary PLY file of points (N, 3), float32, with colours (N, 3), red, green, blue."""
    coordinates = [f"property float {axis}" for axis in "xyz"]
    channels = [f"property uchar {color}" for color in ("red", "green", "blue")]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(points)}",
        *coordinates,
        *channels,
        "end_header\n",
    ]
    rows = np.zeros(len(points), _POINT)
    rows["position"], rows["color"] = points, colors
    return "\n".join(header).encode() + rows.tobytes()


def read_ply(path: Where) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) and faces (F, 3) of a PLY file. Raises FileError."""
    import trimesh

    data = read_bytes(path)
    try:
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type="ply", process=False)
        return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    # trimesh raises many types on damaged files.
    except Exception as error:
        raise FileError(
            f"{path}: not a readable PLY file ({' '.join(str(error).split())})"
        ) from None
