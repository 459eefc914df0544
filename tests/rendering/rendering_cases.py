"""One scene in two tongues: as twinlens data, and as closed forms. And the rigs around it. Imports no renderer."""

from dataclasses import dataclass

import numpy as np
import trimesh

from tests.rendering.rendering_bodies import Ball, Coin, Hull, Plate, Soup, Tube, unit
from twinlens.camera import Camera, Rig
from twinlens.geometry import look_at
from twinlens.scenes import Mesh, Scene, SceneObject

MATERIALS = {
    "chalk": {"type": "diffuse"},
    "card": {"type": "twosided", "bsdf": {"type": "diffuse"}},
    "lacquer": {"type": "plastic"},
    "brass": {"type": "roughconductor", "alpha": 0.1},
    "silver": {"type": "conductor"},
    "glass": {"type": "dielectric"},
    "pane": {"type": "thindielectric"},
    "net": {"type": "mask", "opacity": 0.5, "bsdf": {"type": "diffuse"}},
    "paint": {"type": "principled", "roughness": 0.3},
}
KINDS = {
    "chalk": "diffuse",
    "card": "diffuse",
    "lacquer": "glossy",
    "brass": "glossy",
    "silver": "mirror",
    "glass": "transmissive",
    "pane": "transmissive",
    "net": "diffuse",
    "paint": "glossy",
}


@dataclass(frozen=True)
class Thing:
    """One object: its closed forms (one per instance), its centre, and its SceneObject."""

    bodies: list
    centre: np.ndarray
    scene_object: SceneObject


def turn(rng) -> np.ndarray:
    """A random rotation, by Gram and Schmidt."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


def pose(rotation, shift, scale=1.0) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.asarray(scale)
    matrix[:3, 3] = shift
    return matrix


def things() -> list[Thing]:
    """Every kind of shape, turned and scattered at random in a box a few metres wide, before a slanted wall."""
    rng = np.random.default_rng(20)
    spots = iter(
        rng.permutation(
            [
                (x, y, z)
                for x in (-1.1, 0, 1.1)
                for y in (-0.9, 0.9)
                for z in (-0.8, 0.8)
            ]
        )
    )
    makers = [
        ball,
        ball_of_parameters,
        tube,
        tube_of_parameters,
        plate,
        coin,
        crate,
        box,
        shards,
        gems,
        pearls,
    ]
    return [wall(rng)] + [
        make(rng, next(spots) + rng.uniform(-0.15, 0.15, 3)) for make in makers
    ]


def wall(rng) -> Thing:
    corners = np.array(
        [[-2.2, 2.6, -1.5], [1.9, 1.7, -1.7], [2.1, 2.3, 1.6], [-1.8, 2.9, 1.4]]
    )
    corners[3] = corners[0] + corners[2] - corners[1]
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    return Thing(
        [Soup(corners[faces])],
        corners.mean(0),
        SceneObject("wall", Mesh(corners, faces), "chalk"),
    )


def ball(rng, at) -> Thing:
    placed = pose(turn(rng), at, 0.4)
    return Thing(
        [Ball(at, 0.4)], at, SceneObject("ball", {"type": "sphere"}, "glass", placed)
    )


def ball_of_parameters(rng, at) -> Thing:
    """Centre and radius inside the plugin, then a pose on top."""
    placed = pose(turn(rng), rng.normal(size=3))
    local = placed[:3, :3].T @ (at - placed[:3, 3])
    plugin = {"type": "sphere", "center": local.tolist(), "radius": 0.33}
    return Thing(
        [Ball(at, 0.33)],
        at,
        SceneObject("ball of parameters", plugin, "silver", placed),
    )


def tube(rng, at) -> Thing:
    rotation = turn(rng)
    placed = pose(rotation, at, [0.25, 0.25, 0.8])
    body = Tube(at, rotation[:, 2], 0.8, 0.25)
    return Thing(
        [body],
        at + 0.4 * rotation[:, 2],
        SceneObject("tube", {"type": "cylinder"}, "card", placed),
    )


def tube_of_parameters(rng, at) -> Thing:
    axis = unit(rng.normal(size=3))
    plugin = {
        "type": "cylinder",
        "p0": at.tolist(),
        "p1": (at + 0.7 * axis).tolist(),
        "radius": 0.2,
    }
    return Thing(
        [Tube(at, axis, 0.7, 0.2)],
        at + 0.35 * axis,
        SceneObject("pipe", plugin, "brass"),
    )


def plate(rng, at) -> Thing:
    rotation = turn(rng)
    placed = pose(rotation, at, [0.5, 0.3, 1.0])
    body = Plate(at, 0.5 * rotation[:, 0], 0.3 * rotation[:, 1])
    return Thing(
        [body], at, SceneObject("plate", {"type": "rectangle"}, "lacquer", placed)
    )


def coin(rng, at) -> Thing:
    rotation = turn(rng)
    placed = pose(rotation, at, 0.4)
    return Thing(
        [Coin(at, rotation[:, 2], 0.4)],
        at,
        SceneObject("coin", {"type": "disk"}, "pane", placed),
    )


def crate(rng, at) -> Thing:
    placed = pose(turn(rng), at, [0.4, 0.2, 0.3])
    return Thing(
        [hull_of_box(placed)], at, SceneObject("crate", {"type": "cube"}, "net", placed)
    )


def box(rng, at) -> Thing:
    """A mesh, mirrored by its pose."""
    placed = pose(turn(rng), at, [-0.7, 0.5, 0.4])
    mesh = trimesh.creation.box()
    shape = Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.uint32))
    return Thing(
        [hull_of_box(placed @ np.diag([0.5, 0.5, 0.5, 1]))],
        at,
        SceneObject("box", shape, "paint", placed),
    )


def shards(rng, at) -> Thing:
    """Forty random triangles that occlude and intersect each other."""
    corners = rng.uniform(-0.3, 0.3, (40, 1, 3)) + rng.normal(0, 0.12, (40, 3, 3)) + at
    shape = Mesh(corners.reshape(-1, 3), np.arange(120, dtype=np.uint32).reshape(-1, 3))
    return Thing([Soup(corners)], at, SceneObject("shards", shape, "chalk"))


def gems(rng, at) -> Thing:
    """Three instances of one tessellated sphere."""
    mesh = trimesh.creation.icosphere(subdivisions=1)
    inner = pose(turn(rng), [0.02, 0.01, -0.03], 0.22)
    outer = [
        pose(turn(rng), at + np.array([0.5 * i - 0.5, 0.1 * i, 0.2 * i]))
        for i in range(3)
    ]
    corners = np.asarray(mesh.vertices)[mesh.faces]
    bodies = [Hull.of_triangles(moved(o @ inner, corners)) for o in outer]
    shape = Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.uint32))
    return Thing(
        bodies, at, SceneObject("gems", shape, "chalk", inner, instances=tuple(outer))
    )


def pearls(rng, at) -> Thing:
    """Two instances of one analytic sphere."""
    inner = pose(turn(rng), [0.05, 0.0, 0.02], 0.2)
    outer = [pose(turn(rng), at + i * np.array([0.3, 0.0, 0.35])) for i in range(2)]
    bodies = [Ball((o @ inner)[:3, 3], 0.2) for o in outer]
    scene_object = SceneObject(
        "pearls", {"type": "sphere"}, "brass", inner, instances=tuple(outer)
    )
    return Thing(bodies, at, scene_object)


def hull_of_box(placed) -> Hull:
    """The six faces of the cube [-1, 1]^3 after a rotation and three scales."""
    ends = np.concatenate([placed[:3, :3].T, -placed[:3, :3].T])
    normals = unit(ends)
    return Hull(normals, normals @ placed[:3, 3] + np.linalg.norm(ends, axis=1))


def moved(matrix, points):
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def scene() -> Scene:
    objects = tuple(thing.scene_object for thing in things())
    lights = {"sky": {"type": "constant"}}
    return Scene(
        "every shape",
        objects,
        MATERIALS,
        look_at([0, -5, 0], [0, 0, 0]),
        (1.0, 12.0),
        lights,
    )


def bodies() -> list:
    return [body for thing in things() for body in thing.bodies]


def rigs() -> list[Rig]:
    """Rectified pairs from everywhere: wide ones, then one long lens at each thing; doffs, fx and fy at random."""
    rng = np.random.default_rng(5)
    wide = [
        pair(rng, rng.uniform(-0.3, 0.3, 3), 5.0, (110, 150), (96, 72))
        for _ in range(5)
    ]
    return wide + [
        pair(rng, thing.centre, 5.0, (300, 800), (72, 54)) for thing in things()
    ]


def pair(rng, target, distance, focal, size) -> Rig:
    way = unit(rng.normal(size=3) * (1, 0.6, 0.6) + (0, -1.5, 0))
    up = unit(rng.normal(size=3))
    pose_left = look_at(target + distance * way * rng.uniform(0.8, 1.2), target, up)
    fx, fy = rng.uniform(*focal, 2)
    width, height = size
    cx, cy = 0.5 * (np.array(size) - 1) + rng.uniform(-8, 8, 2)
    left = Camera(width, height, fx, fy, cx, cy)
    right = left.replace(cx=cx + rng.uniform(-12, 12), width=width - 5)
    baseline = rng.uniform(5, 25) * distance / fx
    return Rig.stereo(left, baseline, pose_left, right=right)


def crossed_rig() -> Rig:
    """Three cameras on an arc that look at the middle: no two are rectified, and they differ in size."""
    centres = [
        np.array([5 * np.sin(a), -5 * np.cos(a), 0.4 * a]) for a in (-0.25, 0.0, 0.3)
    ]
    cameras = [
        Camera(60 + 4 * i, 50 - 3 * i, 70.0 + 5 * i, 80.0 - 3 * i, 30.25 + i, 24.0)
        for i in range(3)
    ]
    return Rig(
        cameras, [look_at(centre, [0.1, 0, 0], (0.1, 0, 1)) for centre in centres]
    )
