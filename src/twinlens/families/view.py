"""What the left camera of a scene being composed sees: sizes of pixels, and an exact z-buffer of its triangles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float, inverse, transform_points

_NEAR = 1e-3  # of the picture's width: triangles are cut there


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
        """The pose, turned round."""
        return inverse(self.world_from_cam)

    @property
    def eye(self) -> Float:
        """Where it stands (3,)."""
        return self.world_from_cam[:3, 3]

    def depth(self, points: Float) -> Float:
        """Depth (N,) along the axis of world points (N, 3)."""
        z: Float = transform_points(self.cam_from_world, points)[..., 2]
        return z

    def pixel(self, depth: float) -> float:
        """Metres that a pixel covers at this depth."""
        return 2 * self.half[0] * depth / self.width_px

    def at(self, x: float, y: float, depth: float) -> Float:
        """The world point (3,) seen at (x, y), each in [-1, 1] from left to right and from top to bottom."""
        return transform_points(self.world_from_cam, np.array([x * self.half[0], y * self.half[1], 1.0]) * depth)

    def covered(self, depth: float) -> Float:
        """Width and height in metres of what the picture covers at this depth."""
        return 2 * depth * np.array(self.half)


@dataclass(frozen=True, eq=False)
class Seen:
    """A z-buffer: depth (H, W), +inf where nothing is hit, and the index of the body seen there, -1 for none."""

    depth: Float
    body: NDArray[np.int64]

    @property
    def depth_range(self) -> tuple[float, float]:
        """Nearest and farthest depth seen."""
        finite = self.depth[np.isfinite(self.depth)]
        return float(finite.min()), float(finite.max())

    def share(self, body: int) -> float:
        """The part of the picture that shows a body."""
        return float((self.body == body).mean())


def look(view: View, bodies: Sequence[tuple[Float, NDArray[np.uint32]]], columns: int = 160) -> Seen:
    """What `view` sees of world-space triangle meshes (vertices (V, 3), faces (F, 3)) at each pixel's centre.

    Triangles are cut at the near plane, then every pixel of each one's bounding box is tested by its edge functions.
    Source: Pineda, A Parallel Algorithm for Polygon Rasterization, SIGGRAPH 1988. Depth is 1/(a u + b v + c) there.
    """
    rows = max(1, round(columns / view.aspect))
    triangles, owner = _triangles(view, bodies)
    triangles, owner = _cut(triangles, owner, _NEAR)
    depth = np.full(rows * columns, np.inf)
    body = np.full(rows * columns, -1, dtype=np.int64)
    half = np.array(view.half)
    uv = (triangles[..., :2] / triangles[..., 2:] / half + 1) / 2 * (columns, rows) - 0.5
    tri, x, y = _candidates(uv, columns, rows)
    weights, area = _edges(uv[tri], x, y)
    inside = (weights * np.sign(area)[:, None] >= 0).all(axis=1) & (area != 0)
    tri, weights, area = tri[inside], weights[inside], area[inside]
    z = 1 / ((weights / area[:, None]) / triangles[tri, :, 2]).sum(axis=1)
    pixel = (y * columns + x)[inside]
    order = np.lexsort((owner[tri], -z))  # nearest last: it stays
    depth[pixel[order]] = z[order]
    body[pixel[order]] = owner[tri][order]
    return Seen(depth.reshape(rows, columns), body.reshape(rows, columns))


def _triangles(view: View, bodies: Sequence[tuple[Float, NDArray[np.uint32]]]) -> tuple[Float, NDArray[np.int64]]:
    """Corners (F, 3, 3) of all triangles in camera coordinates, and whose they are (F,)."""
    corners = [transform_points(view.cam_from_world, vertices)[faces] for vertices, faces in bodies]
    owner = np.repeat(np.arange(len(bodies)), [len(faces) for _, faces in bodies])
    return np.concatenate(corners), owner


def _cut(triangles: Float, owner: NDArray[np.int64], near: float) -> tuple[Float, NDArray[np.int64]]:
    """The parts of triangles beyond depth `near`: none, one or two triangles each."""
    beyond = triangles[..., 2] > near
    count = beyond.sum(axis=1)
    kept = [(triangles[count == 3], owner[count == 3])]
    for ahead in (1, 2):
        chosen = count == ahead
        odd = np.argmax(beyond[chosen] if ahead == 1 else ~beyond[chosen], axis=1)
        corner = np.take_along_axis(triangles[chosen], (odd[:, None] + np.arange(3))[..., None] % 3, axis=1)
        a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
        ab, ac = (a + (near * 1.0001 - a[:, 2:]) / (p[:, 2:] - a[:, 2:]) * (p - a) for p in (b, c))
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


def _edges(corners: Float, x: NDArray[np.int64], y: NDArray[np.int64]) -> tuple[Float, Float]:
    """Edge functions (N, 3), that of corner i opposite to it, and their sum, twice the area."""
    p = np.stack([x, y], axis=-1)[:, None] - corners
    following = p[:, [1, 2, 0]]
    last = p[:, [2, 0, 1]]
    weights = following[..., 0] * last[..., 1] - following[..., 1] * last[..., 0]
    return weights, weights.sum(axis=1)
