"""Point clouds and triangle meshes of one depth map, with the colours of its image."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_number
from twinlens.geometry import Float
from twinlens.reconstruction.views import DepthView

_MOST_SAMPLES = 50_000_000


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points float64 (N, 3), world metres; colours uint8 (N, 3) or None. Raises InputError unless all are finite."""

    points: Float
    colors: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        _check("a cloud's points", self.points, self.colors)

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh: vertices float64 (V, 3), world metres, faces int64 (F, 3), counter-clockwise seen from the
    camera, colours uint8 (V, 3) or None. Raises InputError unless all are finite and every face has its vertices.
    """

    vertices: Float
    faces: NDArray[np.int64]
    colors: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        _check("a surface's vertices", self.vertices, self.colors)
        corners = self.faces
        if corners.ndim != 2 or corners.shape[1] != 3 or (corners.size and not corners.min() >= 0):
            raise InputError(f"a surface's faces must be (F, 3) indices of vertices, got shape {corners.shape}")
        if corners.size and corners.max() >= len(self.vertices):
            raise InputError(f"a face refers to vertex {corners.max()} of {len(self.vertices)}")


def points_of(view: DepthView) -> Cloud:
    """One point per pixel of known depth, row by row from the top left."""
    known = view.known
    return Cloud(view.positions()[known], None if view.image is None else view.image[known])


def mesh_of(view: DepthView, max_angle_deg: float = 85.0) -> Surface:
    """Two triangles for each four neighbouring pixels of known depth, except across depth discontinuities.

    A triangle is omitted when the angle between its normal and the viewing ray exceeds `max_angle_deg`: a depth step
    between neighbouring pixels of more than tan(max_angle) pixel footprints z / fx (11 at 85 degrees).
    """
    check_number("max_angle_deg", max_angle_deg, "between 0 and 90 degrees", above=0, below=90)
    known = view.known
    positions = np.where(known[..., None], view.positions(), 0.0).reshape(-1, 3)
    faces = _grid_faces(*known.shape)
    faces = faces[known.reshape(-1)[faces].all(axis=1)]
    faces = faces[_facing(positions, faces, view.world_from_cam[:3, 3]) >= math.cos(math.radians(max_angle_deg))]
    used = np.unique(faces)
    renamed = np.zeros(len(positions), dtype=np.int64)
    renamed[used] = np.arange(len(used))
    colors = None if view.image is None else view.image.reshape(-1, 3)[used]
    return Surface(positions[used], renamed[faces], colors)


def sampled(surface: Surface, spacing: float, seed: int = 0) -> Cloud:
    """Random points uniform on the triangles of a surface, at least one per `spacing` squared (metres) of area.

    Colours are interpolated between the corners. Raises InputError for more than 50 million points.
    """
    check_number("spacing", spacing, "a positive number of metres", above=0)
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    counts = np.ceil(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1) / spacing**2).astype(np.int64)
    if counts.sum() > _MOST_SAMPLES:
        count = f"{counts.sum()} points, more than {_MOST_SAMPLES}"
        raise InputError(f"a spacing of {spacing} m makes {count}: use a wider spacing")
    face = np.repeat(np.arange(len(counts)), counts)
    r, s = np.random.default_rng(seed).random((2, len(face)))
    shares = np.stack([1 - np.sqrt(r), np.sqrt(r) * (1 - s), np.sqrt(r) * s], axis=1)  # uniform: Osada et al. 2002
    corners = surface.faces[face]
    points = np.einsum("nk,nkc->nc", shares, surface.vertices[corners])
    if surface.colors is None:
        return Cloud(points)
    mixed = np.einsum("nk,nkc->nc", shares, surface.colors[corners].astype(np.float64))
    return Cloud(points, np.rint(mixed).astype(np.uint8))


def _grid_faces(height: int, width: int) -> NDArray[np.int64]:
    index = np.arange(height * width, dtype=np.int64).reshape(height, width)
    a, b, c, d = (part.reshape(-1) for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    return np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])


def _facing(vertices: Float, faces: NDArray[np.int64], eye: Float) -> Float:
    """Cosine (F,) of the angle between each face's normal and the direction to the eye."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    ray = eye - (a + b + c) / 3
    size = np.linalg.norm(normal, axis=1) * np.linalg.norm(ray, axis=1)
    cosine: Float = np.divide(np.einsum("nc,nc->n", normal, ray), size, out=np.zeros(len(faces)), where=size > 0)
    return cosine


def _check(name: str, points: Float, colors: NDArray[np.uint8] | None) -> None:
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"{name} must be finite (N, 3), got shape {points.shape}")
    if colors is not None and (colors.shape != points.shape or colors.dtype != np.uint8):
        raise InputError(f"{name} need colours uint8 {points.shape}, got {colors.dtype} {colors.shape}")
