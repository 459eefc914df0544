"""Chooses the frame in which the scene of a request is built (`rendering.frames`), from what its rig sees.

The frame of the scene's default view serves most rigs, so that they share one built scene. A few rays from each camera
find how far away surfaces are. Where another frame is much better, the scene is built in that one. The choice depends
on the scene and the rig alone, not on what was rendered before.
"""

import weakref
from dataclasses import replace

import numpy as np

from twinlens.camera import Rig
from twinlens.geometry import Float, rotate
from twinlens.rendering.build import BuiltScene, build, move_built
from twinlens.rendering.frames import (
    SceneFrame,
    best_frame,
    default_frame,
    offset_cost,
)
from twinlens.rendering.tracing import Rays, intersect
from twinlens.scenes import Scene

_RAYS_ACROSS = (48, 36)  # of each camera
_NEAR = 4.0  # distances of the default view, in which its frame is good enough to look around
_WORSE = 2.0  # than the best frame, of one that is kept
_LEAST_DISTANCE = 1e-6  # of a surface from its camera, relative to the largest one

_frames: "weakref.WeakKeyDictionary[Scene, weakref.WeakKeyDictionary[Rig, SceneFrame]]" = weakref.WeakKeyDictionary()


_stills: "weakref.WeakKeyDictionary[Scene, tuple[float, Scene]]" = (
    weakref.WeakKeyDictionary()
)
"""Of a moving scene, the time and the still scene at which it is built now."""


def built_at(scene: Scene, time: float, rig: Rig) -> BuiltScene:
    """A scene as it is at a time (seconds), built in the frame of the still `rig`, for ground truth.

    A moving scene is built once: the next call moves the objects of what this call returns. Lights stay where they are
    placed, for ground truth does not depend on them.
    """
    if not scene.motion:
        return built_for(scene, rig)
    last_time, still = _stills.get(scene, (None, None))
    if still is None or time != last_time:
        last = still
        still = replace(scene.at(time), lights=scene.lights)
        if last is not None:
            move_built(still, last)
        _stills[scene] = time, still
    return built_for(still, rig)


def built_for(scene: Scene, rig: Rig) -> BuiltScene:
    """The scene, built in the frame of `rig`."""
    return build(scene, frame_of(scene, rig))


def frame_of(scene: Scene, rig: Rig) -> SceneFrame:
    """The frame for what `rig` sees of the scene. Builds the scene, unless it is built already."""
    of_rigs = _frames.setdefault(scene, weakref.WeakKeyDictionary())
    if rig not in of_rigs:
        of_rigs[rig] = _chosen(scene, rig)
    return of_rigs[rig]


def _chosen(scene: Scene, rig: Rig) -> SceneFrame:
    default = default_frame(scene)
    first = _first_look(scene, rig, default)
    points, distances = _seen(build(scene, first), rig)
    if not len(points):
        return first
    best = best_frame(points, distances, default)
    limit = _WORSE * offset_cost(best, points, distances)
    is_good = offset_cost(first, points, distances) <= limit
    return first if is_good else best


def _first_look(scene: Scene, rig: Rig, default: SceneFrame) -> SceneFrame:
    """A frame in which rays from the cameras find the surfaces around them: the default, or one around a camera."""
    centres = np.array([pose[:3, 3] for pose in rig.world_from_cams])
    middle = np.array(default.origin)
    distance = float(np.linalg.norm(scene.world_from_left[:3, 3] - middle))
    reach = _NEAR * max(distance, 1 / default.scale)
    if (np.linalg.norm(centres - middle, axis=1) <= reach).all():
        return default
    x, y, z = centres.mean(axis=0).tolist()
    return SceneFrame((x, y, z), default.scale)


def _seen(built: BuiltScene, rig: Rig) -> tuple[Float, Float]:
    """Surface points (N, 3) that cameras see along a grid of chief rays, and their distances (N,) from the camera."""
    points, distances = [], []
    for camera, pose in zip(rig.cameras, rig.world_from_cams, strict=True):
        columns, rows = (
            np.linspace(0, size - 1, min(size, count)).round()
            for size, count in zip(
                (camera.width, camera.height), _RAYS_ACROSS, strict=True
            )
        )
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        bearings = camera.rays(pixels)
        bearings = bearings[np.isfinite(bearings).all(axis=1)]
        rays = Rays.from_point(pose[:3, 3], rotate(pose, bearings))
        distance = intersect(built, rays).t
        is_hit = np.isfinite(distance)
        points.append(rays[is_hit].at(distance[is_hit]))
        distances.append(distance[is_hit])
    all_distances = np.concatenate(distances)
    least = _LEAST_DISTANCE * float(all_distances.max(initial=0.0))
    return np.concatenate(points), np.maximum(all_distances, least)
