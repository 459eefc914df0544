"""Where truths go wrong: planes seen edge on, mirrored and inside-out meshes, stretched instances, raw Mitsuba files.

Each case is (closed forms, SceneObject, Rig); the same numbers for the worker and for the tests.
"""

import numpy as np
import trimesh

from tests.rendering.rendering_bodies import Coin, Hull, Plate, unit
from tests.rendering.rendering_cases import moved, pose, turn
from twinlens.camera import Camera, Rig
from twinlens.geometry import look_at
from twinlens.scenes import Mesh, Scene, SceneObject

CAMERA = Camera(64, 48, 90.0, 90.0, 31.5, 23.5)


def rig() -> Rig:
    return Rig.stereo(CAMERA, 0.3, look_at([0.3, -5, 0.8], [0, 0, 0]))


def cases() -> dict[str, tuple]:
    return edge_on() | instances() | fine_balls()


def edge_on() -> dict[str, tuple]:
    """Rectangles and disks whose plane passes the right eye at a hundredth of a millimetre to a centimetre."""
    rng = np.random.default_rng(11)
    corners = {}
    for number in range(16):
        world_from_left = pose(turn(rng), rng.normal(size=3))
        lean = rng.uniform(1e-4, 1e-2) * rng.choice([-1, 1])
        axis = unit(np.array([1.0, 0.0, lean]))
        across = unit(np.cross([0, 1, 0], axis))
        at = np.array([0.5 - 3 * lean + 10 ** rng.uniform(-5, -2), 0.1, 3.0])
        placed = world_from_left @ pose(
            np.stack([across, np.cross(axis, across), axis], 1), at
        )
        x, y, z, centre = placed[:3].T
        body = Plate(centre, x, y) if number % 2 else Coin(centre, z, 1.0)
        scene_object = SceneObject(
            "flat", {"type": "rectangle" if number % 2 else "disk"}, "chalk", placed
        )
        corners[f"edge on {number}"] = (
            [body],
            scene_object,
            Rig.stereo(CAMERA, 0.5, world_from_left),
        )
    return corners


def instances() -> dict[str, tuple]:
    rng = np.random.default_rng(12)
    corners = {}
    for name, scale in (
        ("grown", 1.7),
        ("mirrored", [-1, 1, 1]),
        ("stretched", [1, 0.5, 2]),
    ):
        inner = pose(turn(rng), [0.05, 0, 0.1], [0.3, 0.4, 0.5])
        outer = pose(turn(rng), [0.1, 0.2, 0.3], scale)
        cube = trimesh.creation.box(extents=(2, 2, 2))
        body = Hull.of_triangles(
            moved(outer @ inner, np.asarray(cube.vertices)[cube.faces])
        )
        corners[f"{name} instance"] = (
            [body],
            SceneObject("cube", {"type": "cube"}, "chalk", inner, None, (outer,)),
            rig(),
        )
    return corners


def fine_balls() -> dict[str, tuple]:
    """A ball of 1280 triangles with smooth shading: unchanged, mirrored by its pose, and with reversed winding."""
    rng = np.random.default_rng(13)
    mesh = trimesh.creation.icosphere(subdivisions=3)
    points = np.asarray(mesh.vertices)
    faces = np.asarray(mesh.faces, dtype=np.uint32)
    corners = {}
    for name, scale, wound in (
        ("plain", 0.9, 1),
        ("mirrored", [-0.9, 0.9, 0.9], 1),
        ("inside out", 0.9, -1),
    ):
        placed = pose(turn(rng), [0, 0, 0], scale)
        shape = Mesh(
            points,
            np.ascontiguousarray(faces[:, ::wound]),
            np.asarray(mesh.vertex_normals),
        )
        corners[f"{name} ball"] = (
            [Hull.of_triangles(moved(placed, points[faces]))],
            SceneObject("ball", shape, "chalk", placed),
            rig(),
        )
    return corners


def scene(item: SceneObject) -> Scene:
    return Scene(
        "corner",
        (item,),
        {"chalk": {"type": "diffuse"}},
        rig().world_from_cams[0],
        (1.0, 9.0),
    )
