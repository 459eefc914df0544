"""Hits made exact: each ray is intersected again, in float64, with the very primitive that Mitsuba hit in float32.

Triangles by their plane; sphere, cylinder, disk and rectangle in their own unit space, in which they are the same for
every pose (t does not change under an affine map). Anything else keeps Mitsuba's answer. Pure numpy.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float

FAR_OFF = 1e-3  # relative: a refined t further than this from Mitsuba's is a grazing hit gone wrong


@dataclass(frozen=True, eq=False)
class Triangles:
    """A mesh: vertices (V, 3), faces (F, 3), vertex normals (V, 3) or None, all in the space of `world_from_local`."""

    vertices: Float
    faces: NDArray[np.uint32]
    normals: Float | None
    world_from_local: Float


@dataclass(frozen=True, eq=False)
class Quadric:
    """A unit shape (see UNIT_SHAPES) placed by an affine `world_from_local`."""

    kind: str
    world_from_local: Float


@dataclass(frozen=True, eq=False)
class Exact:
    """Refined hits: t (N,), geometric and shading normals (N, 3), unit, in world coordinates."""

    t: Float
    normal: Float
    shading_normal: Float


def refine(surface: Triangles | Quadric, origin: Float, directions: Float, prim: NDArray[np.uint32], t: Float) -> Exact:
    """Hits of origin + t directions with `surface`, near the parameters t (N,) that float32 found."""
    local_from_world: Float = np.linalg.inv(surface.world_from_local).astype(np.float64)
    o = local_from_world[:3, :3] @ origin + local_from_world[:3, 3]
    d = directions @ local_from_world[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = _triangles(surface, o, d, prim) if isinstance(surface, Triangles) else _unit(surface, o, d, t)
        good = np.abs(exact.t - t) <= FAR_OFF * t
    return Exact(
        np.where(good, exact.t, t),
        _to_world(local_from_world, exact.normal),
        _to_world(local_from_world, exact.shading_normal),
    )


def _to_world(local_from_world: Float, normals: Float) -> Float:
    turned: Float = normals @ local_from_world[:3, :3]  # the inverse transpose of world_from_local
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return turned


def _triangles(mesh: Triangles, o: Float, d: Float, prim: NDArray[np.uint32]) -> Exact:
    corners = mesh.vertices[mesh.faces[prim]]
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(ab, ac)
    t = _dot(a - o, normal) / _dot(d, normal)
    if mesh.normals is None:
        return Exact(t, normal, normal)
    weights = _barycentric(o + t[:, None] * d - a, ab, ac, normal)
    shading = np.einsum("nk,nkc->nc", weights, mesh.normals[mesh.faces[prim]])
    return Exact(t, normal, shading)


def _barycentric(p: Float, ab: Float, ac: Float, normal: Float) -> Float:
    area = _dot(normal, normal)
    b = _dot(np.cross(p, ac), normal) / area
    c = _dot(np.cross(ab, p), normal) / area
    return np.stack([1 - b - c, b, c], axis=1)


def _unit(surface: Quadric, o: Float, d: Float, t: Float) -> Exact:
    roots, normal_at = UNIT_SHAPES[surface.kind]
    candidates = roots(o, d)
    nearest = np.argmin(np.abs(np.nan_to_num(candidates, nan=np.inf) - t), axis=0)
    exact = np.take_along_axis(candidates, nearest[None], axis=0)[0]
    normal = normal_at(o + exact[:, None] * d)
    return Exact(exact, normal, normal)


def _quadratic(a: Float, half_b: Float, c: Float) -> Float:
    """Both roots (2, N) of a t^2 + 2 half_b t + c = 0 without cancellation; NaN where there is none."""
    q = -(half_b + np.copysign(np.sqrt(half_b**2 - a * c), half_b))
    return np.stack([q / a, c / q])


def _sphere(o: Float, d: Float) -> Float:
    return _quadratic(_dot(d, d), _dot(d, o), np.broadcast_to(o @ o - 1, len(d)))


def _cylinder(o: Float, d: Float) -> Float:
    return _sphere(o[:2], d[:, :2])  # the circle in the plane across the axis


def _plane(o: Float, d: Float) -> Float:
    t: Float = -o[2] / d[:, 2]
    return t[None]


def _along_z(p: Float) -> Float:
    return np.broadcast_to(np.array([0.0, 0.0, 1.0]), p.shape)


UNIT_SHAPES: dict[str, tuple[Callable[[Float, Float], Float], Callable[[Float], Float]]] = {
    "sphere": (_sphere, lambda p: p),
    "cylinder": (_cylinder, lambda p: p * (1.0, 1.0, 0.0)),
    "disk": (_plane, _along_z),
    "rectangle": (_plane, _along_z),
}
FLAT_SHAPES = ("disk", "rectangle")


def _dot(a: Float, b: Float) -> Float:
    product: Float = (a * b).sum(axis=-1)
    return product
