"""Clouds and surfaces as files that other programs open: PLY and GLB, in metres, colours included."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twinlens.dataset.files import write_file
from twinlens.dataset.storage import Where
from twinlens.reconstruction.surface import Cloud, Surface

if TYPE_CHECKING:
    from numpy.typing import NDArray

_GLTF = np.diag([1.0, -1.0, -1.0, 1.0])


def write_ply(path: Where, thing: Cloud | Surface) -> None:
    """Write a cloud or a surface as binary PLY: world axes as they are, metres, float32. Raises OutputError."""
    write_file(path, ply_bytes(thing))


def write_glb(path: Where, thing: Cloud | Surface, world_from_cam: "NDArray[Any] | None" = None) -> None:
    """Write `glb_bytes`. Raises OutputError."""
    write_file(path, glb_bytes(thing, world_from_cam))


def ply_bytes(thing: Cloud | Surface) -> bytes:
    """A binary PLY: world axes as they are, metres, float32."""
    return _bytes(_plain(thing), "ply")


def glb_bytes(thing: Cloud | Surface, world_from_cam: "NDArray[Any] | None" = None) -> bytes:
    """A binary glTF 2.0: metres, float32, vertex colours.

    glTF's axes are x right, y up, z towards the viewer. With `world_from_cam` (4, 4) it is turned so that this camera
    looks along -z and up is up, as a viewer expects; without, world z becomes up: (x, z, -y).
    """
    upright = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    gltf_from_world = upright if world_from_cam is None else _GLTF @ np.linalg.inv(world_from_cam)
    plain = _plain(thing)
    plain.apply_transform(gltf_from_world)
    return _bytes(plain, "glb")


def _plain(thing: Cloud | Surface) -> Any:
    import trimesh

    if isinstance(thing, Cloud):
        return trimesh.PointCloud(thing.points, colors=thing.colors)
    return trimesh.Trimesh(thing.vertices, thing.faces, vertex_colors=thing.colors, process=False)


def _bytes(plain: Any, kind: str) -> bytes:
    import trimesh

    whole = trimesh.Scene(plain) if kind == "glb" else plain
    return bytes(whole.export(file_type=kind))
