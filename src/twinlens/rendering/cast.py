"""First hits of many rays as numpy arrays.

Directions are not normalised: with z = 1 in the camera frame, the ray parameter t is the depth. Hits are Mitsuba's, in
float32; `twinlens.rendering.surfaces` refines them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.rendering.backends import backend, mitsuba
from twinlens.rendering.build import Body, BuiltScene

_MISS = float("inf")
_BUNDLE = 1 << 22  # rays traced at once; bounds the memory


@dataclass(frozen=True, eq=False)
class Hits:
    """First hits of N rays.

    body : int32 (N,), row of the scene's body table, -1 where nothing was hit.
    t : float64 (N,), the ray parameter, +inf where nothing was hit.
    prim : uint32 (N,), the triangle of a mesh.
    """

    body: NDArray[np.int32]
    t: Float
    prim: NDArray[np.uint32]


def cast(built: BuiltScene, origin: Float, directions: Float) -> Hits:
    """First hits along origin + t directions; origin (3,), directions (N, 3), world coordinates."""
    count = len(directions)
    hits = Hits(np.full(count, -1, np.int32), np.full(count, np.inf), np.zeros(count, np.uint32))
    trace = _trace_bundle if backend().is_jit else _trace_singly
    lengths = np.sqrt(np.einsum("nc,nc->n", directions, directions))
    for start in range(0, count, _BUNDLE):
        part = slice(start, start + _BUNDLE)
        unit = (directions[part] / lengths[part, None]).astype(np.float32)
        trace(built, origin, unit, Hits(hits.body[part], hits.t[part], hits.prim[part]))
    return Hits(hits.body, hits.t / lengths, hits.prim)


def _trace_bundle(built: BuiltScene, origin: Float, unit: NDArray[np.float32], out: Hits) -> None:
    import drjit as dr

    mi = mitsuba()
    ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(np.ascontiguousarray(unit.T)))
    pi = built.mi_scene.ray_intersect_preliminary(ray)
    shape, instance = (dr.reinterpret_array(mi.UInt32, pointer) for pointer in (pi.shape, pi.instance))
    dr.eval(pi.t, pi.prim_index, shape, instance)
    keys = np.where(np.asarray(instance) > 0, np.asarray(instance), np.asarray(shape))  # prefer the instance
    out.body[:] = _rows(_handle_table(built), keys)
    hit = keys > 0
    out.t[hit] = np.asarray(pi.t)[hit]
    out.prim[hit] = np.asarray(pi.prim_index)[hit]


def _rows(table: dict[int, int], keys: NDArray[np.uint32]) -> NDArray[np.int32]:
    """Rows of the body table for Dr.Jit's registry handles; -1 for handle 0, no shape."""
    rows_of_handles = np.full(max([int(keys.max(initial=0)), *table]) + 1, -1, dtype=np.int32)
    rows_of_handles[list(table)] = list(table.values())
    rows: NDArray[np.int32] = rows_of_handles[keys]
    return rows


def _handle_table(built: BuiltScene) -> dict[int, int]:
    """Dr.Jit's registry handle of each body's shape (or instance) -> row of the body table."""
    if "handles" not in built.cache:
        import drjit as dr

        mi = mitsuba()
        built.cache["handles"] = {
            int(np.asarray(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(_key(body))))[0]): row
            for row, body in enumerate(built.bodies)
        }
    table: dict[int, int] = built.cache["handles"]
    return table


def _key(body: Body) -> Any:
    """The Mitsuba object that identifies a body in a hit."""
    return body.shape if body.instance is None else body.instance


def _trace_singly(built: BuiltScene, origin: Float, unit: NDArray[np.float32], out: Hits) -> None:
    mi = mitsuba()
    rows = {_key(body): row for row, body in enumerate(built.bodies)}
    intersect, ray_type, vector = built.mi_scene.ray_intersect_preliminary, mi.Ray3f, mi.Vector3f
    start = mi.Point3f(origin)
    for i, (x, y, z) in enumerate(unit.tolist()):
        pi = intersect(ray_type(start, vector(x, y, z)))
        if pi.t != _MISS:
            out.body[i] = rows.get(pi.instance or pi.shape, -1)
            out.t[i] = pi.t
            out.prim[i] = pi.prim_index


def mitsuba_normals(built: BuiltScene, origin: Float, directions: Float) -> tuple[Float, Float]:
    """(geometric, shading) normals (N, 3) from Mitsuba, in float32, for shapes without a closed form."""
    mi = mitsuba()
    if backend().is_jit:
        towards = mi.Vector3f(np.ascontiguousarray(directions.T, dtype=np.float32))
        si = built.mi_scene.ray_intersect(mi.Ray3f(mi.Point3f(origin), towards))
        return np.asarray(si.n, dtype=np.float64).T, np.asarray(si.sh_frame.n, dtype=np.float64).T
    found = [
        built.mi_scene.ray_intersect(mi.Ray3f(mi.Point3f(origin), mi.Vector3f(*direction))) for direction in directions
    ]
    return np.array([si.n for si in found], dtype=np.float64), np.array(
        [si.sh_frame.n for si in found], dtype=np.float64
    )
