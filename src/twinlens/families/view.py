"""What the left camera of a scene sees while the scene is composed: pixel sizes, and a z-buffer of its triangles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float, inverse, transform_points
from twinlens.scenes.scene import Mesh

Triangles = tuple[Float, NDArray[np.uint32]]
"""Vertices (V, 3) in the world, and faces (F, 3)."""

_NEAR = 1e-3  # metres: triangles are clipped at this depth


@dataclass(frozen=True, eq=False)
class View:
    """A pinhole camera: its pose (4, 4), horizontal field of view, width over height, and pixels across."""

    world_from_cam: Float
    fov_x_deg: float
    aspect: float
    width_px: int = 640

    @property
    def half(self) -> tuple[float, float]:
        """(x, y) of the picture's right and lower edge at depth 1."""
        x = math.tan(math.radians(self.fov_x_deg) / 2)
        return x, x / self.aspect

    @cached_property
    def cam_from_world(self) -> Float:
        """The inverse of the pose."""
        return inverse(self.world_from_cam)

    @property
    def eye(self) -> Float:
        """The camera's centre (3,) in the world."""
        return self.world_from_cam[:3, 3]

    def depth(self, points: Float) -> Float:
        """Depth (N,) along the axis of world points (N, 3)."""
        return np.asarray(transform_points(self.cam_from_world, points)[..., 2])

    def pixel(self, depth: float) -> float:
        """Width of a pixel in metres at this depth."""
        return 2 * self.half[0] * depth / self.width_px

    def at(self, x: float, y: float, depth: float) -> Float:
        """The world point (3,) at (x, y) of the picture, each in [-1, 1] from left to right and from top to bottom."""
        return transform_points(self.world_from_cam, np.array([x * self.half[0], y * self.half[1], 1.0]) * depth)

    def covered(self, depth: float) -> Float:
        """Width and height in metres of the picture's field at this depth."""
        return 2 * depth * np.array(self.half)


@dataclass(frozen=True, eq=False)
class ZBuffer:
    """Depth (H, W), +inf where nothing is hit, and the index (H, W) of the mesh seen there, -1 for none."""

    depth: Float
    index: NDArray[np.int64]

    @property
    def depth_range(self) -> tuple[float, float]:
        """Smallest and largest finite depth."""
        finite = self.depth[np.isfinite(self.depth)]
        return float(finite.min()), float(finite.max())


def triangles(mesh: Mesh, pose: Float | None = None) -> Triangles:
    """A mesh's triangles in the world."""
    return mesh.vertices if pose is None else transform_points(pose, mesh.vertices), mesh.faces


def rasterize(view: View, meshes: Sequence[Triangles], columns: int = 160) -> ZBuffer:
    """The z-buffer of world-space meshes, sampled at pixel centres, `columns` pixels wide.

    Triangles are clipped at the near plane; every pixel of a triangle's bounding box is tested with its edge functions,
    and 1/depth is interpolated linearly. Source: Pineda, A Parallel Algorithm for Polygon Rasterization, SIGGRAPH 1988.
    """
    rows = max(1, round(columns / view.aspect))
    corners = np.concatenate([transform_points(view.cam_from_world, vertices)[faces] for vertices, faces in meshes])
    owner = np.repeat(np.arange(len(meshes)), [len(faces) for _, faces in meshes])
    corners, owner = _clipped(corners, owner)
    depth = np.full(rows * columns, np.inf)
    index = np.full(rows * columns, -1, dtype=np.int64)
    uv = (corners[..., :2] / corners[..., 2:] / np.array(view.half) + 1) / 2 * (columns, rows) - 0.5
    tri, x, y = _candidates(uv, columns, rows)
    to_corner = np.stack([x, y], axis=-1)[:, None] - uv[tri]
    following, last = to_corner[:, [1, 2, 0]], to_corner[:, [2, 0, 1]]
    weights = following[..., 0] * last[..., 1] - following[..., 1] * last[..., 0]  # edge functions
    area = weights.sum(axis=1)  # twice the triangle's
    inside = (weights * np.sign(area)[:, None] >= 0).all(axis=1) & (area != 0)
    tri, weights, area = tri[inside], weights[inside], area[inside]
    z = 1 / ((weights / area[:, None]) / corners[tri, :, 2]).sum(axis=1)
    pixel = (y * columns + x)[inside]
    order = np.lexsort((owner[tri], -z))  # the nearest is written last
    depth[pixel[order]] = z[order]
    index[pixel[order]] = owner[tri][order]
    return ZBuffer(depth.reshape(rows, columns), index.reshape(rows, columns))


def _clipped(corners: Float, owner: NDArray[np.int64]) -> tuple[Float, NDArray[np.int64]]:
    """The parts of triangles (F, 3, 3) beyond the near plane: none, one or two triangles each."""
    beyond = corners[..., 2] > _NEAR
    count = beyond.sum(axis=1)
    kept = [(corners[count == 3], owner[count == 3])]
    for ahead in (1, 2):
        chosen = count == ahead
        odd = np.argmax(beyond[chosen] if ahead == 1 else ~beyond[chosen], axis=1)
        corner = np.take_along_axis(corners[chosen], (odd[:, None] + np.arange(3))[..., None] % 3, axis=1)
        a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
        ab, ac = (a + (_NEAR * 1.0001 - a[:, 2:]) / (p[:, 2:] - a[:, 2:]) * (p - a) for p in (b, c))
        made = [(a, ab, ac)] if ahead == 1 else [(ab, b, c), (ab, c, ac)]
        kept += [(np.stack(parts, axis=1), owner[chosen]) for parts in made]
    return np.concatenate([t for t, _ in kept]), np.concatenate([o for _, o in kept])


def _candidates(uv: Float, columns: int, rows: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """(triangle, x, y) of every pixel in the bounding box of every triangle."""
    limit = np.array([columns, rows])
    low = np.clip(np.ceil(uv.min(axis=1)), 0, limit).astype(np.int64)
    high = np.clip(np.floor(uv.max(axis=1)), -1, limit - 1).astype(np.int64)
    size = np.maximum(high - low + 1, 0)
    count = size.prod(axis=1)
    tri = np.repeat(np.arange(len(uv)), count)
    step = np.arange(len(tri)) - np.repeat(np.cumsum(count) - count, count)
    width = size[tri, 0]
    return tri, low[tri, 0] + step % width, low[tri, 1] + step // width
