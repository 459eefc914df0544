"""From a composition to a scene of the depths that were asked for: a backdrop where the far end is, then one scale.

Scaling everything about the camera's centre changes no pixel and multiplies every depth, so the near end is met by a
scale, and the far end by where the backdrop stands before it.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twinlens.families.family import Request
from twinlens.families.stage import Stage, world
from twinlens.families.view import Seen, View, look
from twinlens.geometry import Float
from twinlens.scenes.scene import Mesh, Scene

_ROUNDS = 5


def solve_far(view: View, fixed: Stage, backdrop: Callable[[float], list[Mesh]], far: float, start: float) -> float:
    """The distance at which a backdrop must stand for the farthest depth seen to be `far` metres."""
    others = [world(thing) for thing in fixed.objects]
    distance = start
    for _ in range(_ROUNDS):
        seen = look(view, [*others, *((mesh.vertices, mesh.faces) for mesh in backdrop(distance))], 96)
        found = seen.depth_range[1]
        if abs(found - far) < 0.005 * far:
            break
        distance = max(distance * far / found, 0.2 * start)
    return distance


def finished(request: Request, stage: Stage, view: View, about: str) -> Scene:
    """The scene, scaled to the nearest depth asked for, with a stereo base that suits it."""
    seen = stage.seen(view)
    near, far = seen.depth_range
    if request.depth_range is not None:
        scale = request.depth_range[0] / near
        stage = scaled(stage, view.eye, scale)
        near, far = near * scale, far * scale
    return stage.scene(request.name, view, baseline(request, view, near), (near, far), about)


def baseline(request: Request, view: View, near: float) -> float:
    """A base in metres that gives the nearest point a disparity of 6% to 12% of the picture's width."""
    return float(request.rng("baseline").uniform(0.06, 0.12) * 2 * view.half[0] * near)


def scaled(stage: Stage, centre: Float, scale: float) -> Stage:
    """Everything `scale` times as large and as far from `centre`."""
    grow = np.diag([scale, scale, scale, 1.0])
    grow[:3, 3] = (1 - scale) * centre
    objects = [replace(thing, world_from_object=grow @ thing.world_from_object) for thing in stage.objects]
    return Stage(objects, stage.materials, stage.lights)


def ratio(request: Request, least: float, most: float) -> float:
    """Far over near: as asked, or drawn."""
    if request.depth_range is not None:
        return request.depth_range[1] / request.depth_range[0]
    return math.exp(request.rng("depth").uniform(math.log(least), math.log(most)))


def blocked(seen: Seen, bodies: int) -> Float:
    """The part of the picture that each body shows."""
    return np.bincount(seen.body[seen.body >= 0].ravel(), minlength=bodies) / seen.body.size
