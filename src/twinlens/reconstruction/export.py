"""PLY and GLB files of point clouds and surfaces, in metres, with colours."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twinlens.dataset.files import write_file
from twinlens.dataset.storage import Where
from twinlens.reconstruction.surface import Cloud, Surface

if TYPE_CHECKING:
    from numpy.typing import NDArray

_GLTF = np.diag([1.0, -1.0, -1.0, 1.0])


def write_ply(path: Where, thing: Cloud | Surface) -> None:
    """Write `ply_bytes`. Raises OutputError."""
    write_file(path, ply_bytes(thing))


def write_glb(path: Where, thing: Cloud | Surface, world_from_cam: "NDArray[Any] | None" = None) -> None:
    """Write `glb_bytes`. Raises OutputError."""
    write_file(path, glb_bytes(thing, world_from_cam))


def ply_bytes(thing: Cloud | Surface) -> bytes:
    """A binary PLY in world axes, metres, float32."""
    return _bytes(_trimesh(thing), "ply")


def glb_bytes(thing: Cloud | Surface, world_from_cam: "NDArray[Any] | None" = None) -> bytes:
    """A binary glTF 2.0: metres, float32, vertex colours.

    glTF's axes are x right, y up, z towards the viewer. With `world_from_cam` (4, 4) the camera looks along -z with
    its up direction along y; without it, the world's z axis is up: (x, z, -y).
    """
    upright = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    gltf_from_world = upright if world_from_cam is None else _GLTF @ np.linalg.inv(world_from_cam)
    plain = _trimesh(thing)
    plain.apply_transform(gltf_from_world)
    return _bytes(plain, "glb")


def _trimesh(thing: Cloud | Surface) -> Any:
    import trimesh

    if isinstance(thing, Cloud):
        return trimesh.PointCloud(thing.points, colors=thing.colors)
    return trimesh.Trimesh(thing.vertices, thing.faces, vertex_colors=thing.colors, process=False)


def _bytes(plain: Any, kind: str) -> bytes:
    import trimesh

    whole = trimesh.Scene(plain) if kind == "glb" else plain
    return bytes(whole.export(file_type=kind))
