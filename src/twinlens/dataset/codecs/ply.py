"""Triangle meshes as binary PLY files, by trimesh."""

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
