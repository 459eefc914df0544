"""Checks of bodies at rest, independent of the placement code.

A point is inside a body where the surface's winding number, the sum of solid angles over 4 pi, is above 0.5.
Source: van Oosterom and Strackee, The Solid Angle of a Plane Triangle, IEEE TBME 30(2), 1983.
"""

import functools
import itertools
import re

import numpy as np
import pytest
from scipy.spatial import Delaunay, QhullError

from twinlens.families import random_scene, surfaces
from twinlens.families.things import THINGS
from twinlens.geometry import transform_points

SURROUNDINGS = {"table", "wall", "floor", "key-light", "fill-light", "sun"}


def compose_bare(family, seed, **options):
    """The scene of a seed with patterns of one texel: its places, shapes and lamps, in less time."""
    grey = np.full((1, 1, 3), 0.5, dtype=np.float32)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surfaces, "bake", lambda *_: grey.copy())
        patch.setattr(surfaces, "pattern", lambda *_: grey)
        patch.setattr(surfaces, "_on_texels", lambda *_: np.float32(0.5))
        return random_scene(family, seed, width=80, **options)


bare_scene = functools.lru_cache(maxsize=64)(compose_bare)


def in_world(item):
    """(vertices in the world, faces) of an object without copies, or of its first copy."""
    return copies(item)[0]


def copies(item):
    """(vertices in the world, faces) of each copy of an object."""
    mesh = item.shape
    poses = [pose @ item.world_from_object for pose in item.instances]
    return [
        (transform_points(pose, mesh.vertices), mesh.faces)
        for pose in poses or [item.world_from_object]
    ]


def is_thing(name):
    """Whether an object is one of the things of many parts."""
    return plain_name(name) in THINGS


def plain_name(name):
    """A name without the numbers that make it unique, and without that of a copy."""
    return re.sub(r"(-\d+)*(\[\d+\])?$", "", name)


def bodies(scene):
    """name -> (vertices in the world, faces) of the bodies and things on the table, each copy by itself."""
    listed = {}
    for item in scene.objects:
        if item.name in SURROUNDINGS:
            continue
        for number, copy in enumerate(copies(item)):
            name = f"{item.name}[{number}]" if item.instances else item.name
            listed[name] = copy
    return listed


def winding(points, body):
    """Winding number (N,) of a closed surface around points (N, 3)."""
    vertices, faces = body
    total = np.zeros(len(points))
    for start in range(0, len(points), 64):
        chunk = points[start : start + 64]
        a, b, c = (vertices[faces[:, i]][None] - chunk[:, None] for i in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        above = np.einsum("nfc,nfc->nf", a, np.cross(b, c))
        dot = lambda p, q: np.einsum("nfc,nfc->nf", p, q)  # noqa: E731
        below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
        total[start : start + 64] = (
            2 * np.arctan2(above, below).sum(axis=1) / (4 * np.pi)
        )
    return total


def inside(points, body):
    """Mask (N,) of the points inside a body."""
    low, high = body[0].min(axis=0), body[0].max(axis=0)
    found = ((points > low) & (points < high)).all(axis=1)
    found[found] = winding(points[found], body) > 0.5
    return found


def samples(body, count):
    """At most `count` points of a surface: vertices and centres of triangles."""
    vertices, faces = body
    points = np.concatenate([vertices[np.unique(faces)], vertices[faces].mean(axis=1)])
    return points[np.linspace(0, len(points) - 1, min(count, len(points))).astype(int)]


def pairs(scene, meet):
    """Pairs of names of bodies for which `meet` is true."""
    return [
        (name, other)
        for (name, body), (other, second) in itertools.permutations(bodies(scene).items(), 2)
        if meet(body, second)
    ]  # fmt: skip


def intersecting(scene, count=400):
    """Pairs of names of bodies of which the first has points inside the second."""
    return pairs(scene, lambda body, other: inside(samples(body, count), other).any())


def crossing(scene):
    """Pairs of names of bodies of which an edge of the first crosses a triangle of the second.

    Source: Moeller and Trumbore, Fast, Minimum Storage Ray/Triangle Intersection, JGT 2(1), 1997.
    """

    def meet(body, other):
        (vertices, faces), (others, other_faces) = body, other
        return _crosses(vertices[faces], others[other_faces])

    return pairs(scene, meet)


def _crosses(edged, faced):
    edged, faced = _near(edged, faced), _near(faced, edged)
    if not len(edged) or not len(faced):
        return False
    start = np.moveaxis(edged, 1, 0).reshape(-1, 3)
    along = np.moveaxis(np.roll(edged, -1, axis=1), 1, 0).reshape(-1, 3) - start
    u_axis, v_axis = faced[:, 1] - faced[:, 0], faced[:, 2] - faced[:, 0]
    across = np.cross(along[:, None], v_axis)
    offset = start[:, None] - faced[:, 0]
    turned = np.cross(offset, u_axis)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1 / (u_axis * across).sum(axis=-1)
        u, v = (
            scale * (offset * across).sum(axis=-1),
            scale * (along[:, None] * turned).sum(axis=-1),
        )
        t = scale * (v_axis * turned).sum(axis=-1)
        return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)).any())


def _near(triangles, others):
    low, high = others.min(axis=(0, 1)), others.max(axis=(0, 1))
    return triangles[
        (triangles.max(axis=1) >= low).all(axis=1)
        & (triangles.min(axis=1) <= high).all(axis=1)
    ]


def floating(scene, table):
    """Names of bodies without support, and of those below the table's top at height `table`.

    A lowest point is supported where the point 0.1% of the body's size below it is in the table or in another body. The
    centre of mass, of a body that is not closed that of its surface, must lie above the supported points. The feet of
    things are flat and slanted: their points within 1% of the size are lowest.
    """
    import trimesh

    found = bodies(scene)
    out = []
    for name, (vertices, faces) in found.items():
        size = np.ptp(vertices, axis=0).max()
        near = (1e-2 if is_thing(name) else 1e-4) * size
        lowest = vertices[vertices[:, 2] < vertices[:, 2].min() + near]
        lowest = np.unique(np.round(lowest, 9), axis=0)
        under = lowest - [0, 0, near + 1e-3 * size]
        carried = under[:, 2] < table
        for other, body in found.items():
            if other != name:
                carried |= inside(under, body)
        solid = trimesh.Trimesh(vertices, faces, process=True)
        centre = (solid.center_mass if solid.is_watertight else solid.centroid)[:2]
        try:
            balanced = Delaunay(lowest[carried, :2]).find_simplex(centre) >= 0
        except (QhullError, ValueError):
            balanced = False
        if not balanced or vertices[:, 2].min() < table:
            out.append(name)
    return out


def table_height(scene):
    """The height of the table's top."""
    (table,) = (item for item in scene.objects if item.name == "table")
    vertices, _ = in_world(table)
    return vertices[:, 2].max()


def camera_inside(scene):
    """Names of closed bodies that contain the camera."""
    eye = scene.world_from_left[None, :3, 3]
    return [
        item.name
        for item in scene.objects
        for copy in copies(item)
        if inside(eye, copy)[0]
    ]
