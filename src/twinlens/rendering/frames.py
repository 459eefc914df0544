"""The frame in which a scene is built: around what a rig sees, in units of its size. Pure data, without the renderer.

Mitsuba computes in float32, and lifts rays off surfaces by about 1e-4 of their largest coordinate plus one unit. So
coordinates must be small against what is seen, and large against one unit, wherever the scene stands and however large
it is. A point p of the world, float64 metres, is s (p - o) in the frame. The scale s is a power of two, which rounds
nothing. A camera's own axes stay in metres: with `frame_from_cam`, a lens needs no conversion.

Light: radiance and irradiance are the same in all frames. The intensity of a point, W/sr, lights a surface by the
inverse square of its distance, so that it is multiplied by s^2; so is the power of a projector.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from twinlens.geometry import Float
from twinlens.scenes import Bitmap, Color, Mesh, Plugin, Scene, SceneObject
from twinlens.scenes.materials import AnyMaterial, Material

_SIZE = 64.0
"""Units of the root mean square distance of what is seen from the origin: it is then about 100 units across."""

_LEAST_SPREAD = 1e-3  # of what is seen, relative to its distance
_UNKNOWN_SCALE = 16.0  # units per metre, where no depths are known

_POINTS = ("point", "spot")
"""Lights that stand at a point."""


@dataclass(frozen=True)
class SceneFrame:
    """Axes parallel to the world's, at `origin` (metres), with `scale` units per metre, a power of two."""

    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0

    @cached_property
    def from_world(self) -> Float:
        """frame_from_world, an affine (4, 4)."""
        matrix = np.diag([self.scale, self.scale, self.scale, 1.0])
        matrix[:3, 3] = -self.scale * np.array(self.origin)
        return matrix

    @cached_property
    def to_world(self) -> Float:
        """world_from_frame, an affine (4, 4)."""
        matrix = np.diag([1 / self.scale, 1 / self.scale, 1 / self.scale, 1.0])
        matrix[:3, 3] = self.origin
        return matrix

    def points(self, in_world: Float) -> Float:
        """Points (..., 3) of the world in the frame. The difference comes first: it is exact for near points."""
        in_frame: Float = self.scale * (in_world - np.array(self.origin))
        return in_frame

    def points_in_world(self, points: Float) -> Float:
        """Points (..., 3) of the frame in the world."""
        in_world: Float = points / self.scale + np.array(self.origin)
        return in_world

    def affine(self, world_from_model: Float) -> Float:
        """frame_from_model (4, 4), of a pose in the world. The model keeps its own units."""
        placed = np.array(world_from_model, dtype=np.float64)
        placed[:3, :3] *= self.scale
        placed[:3, 3] = self.points(placed[:3, 3])
        return placed

    def rigid(self, world_from_cam: Float) -> Float:
        """The pose (4, 4) of axes in units of the frame: the rotation stays, the place is converted."""
        placed = np.array(world_from_cam, dtype=np.float64)
        placed[:3, 3] = self.points(placed[:3, 3])
        return placed


WORLD = SceneFrame()
"""The world's own axes, in metres."""


def default_frame(scene: Scene) -> SceneFrame:
    """The frame of a scene's default view, from its pose, its field of view and the depths that its file states."""
    pose = scene.world_from_left
    near, far = scene.depth_range
    if not scene.depth_range_known:
        return SceneFrame(_vector(pose[:3, 3]), _UNKNOWN_SCALE)
    # The depth at which the largest relative distance from it, |z - depth| / z, is least: the harmonic mean.
    depth = 2 / (1 / near + 1 / far)
    half_width = math.tan(math.radians(scene.fov_x_deg) / 2)
    spread = depth * max((far - near) / (far + near), half_width) / math.sqrt(3)
    return SceneFrame(_vector(pose[:3, 3] + depth * pose[:3, 2]), _scale_of(spread))


def best_frame(points: Float, distances: Float, grid: SceneFrame) -> SceneFrame:
    """The frame of surface points (N, 3) that cameras see at `distances` (N,).

    Its origin o has the least mean square of |p - o| / distance: what matters is an error's size in pixels. It is
    rounded to steps from the origin of `grid`, so that rigs close to each other have one frame, wherever the scene is.
    """
    weights = 1 / np.square(distances)
    weights /= weights.sum()
    relative = points - np.array(grid.origin)
    centre = weights @ relative
    spread = math.sqrt(weights @ np.square(relative - centre).sum(axis=1))
    typical_distance = 1 / math.sqrt(np.mean(1 / np.square(distances)))
    scale = _scale_of(max(spread, _LEAST_SPREAD * typical_distance))
    step = _SIZE / 2 / scale
    return SceneFrame(
        _vector(np.array(grid.origin) + step * np.round(centre / step)), scale
    )


def offset_cost(frame: SceneFrame, points: Float, distances: Float) -> float:
    """How far Mitsuba lifts rays off surface points, relative to their distances from the cameras, up to a factor."""
    lift = np.linalg.norm(points - np.array(frame.origin), axis=1) + 1 / frame.scale
    return math.sqrt(np.mean(np.square(lift / distances)))


def _scale_of(spread: float) -> float:
    """The power of two that makes `spread` metres about `_SIZE` units."""
    return 2.0 ** round(math.log2(_SIZE / spread))


def _vector(values: Float) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def in_frame(scene: Scene, frame: SceneFrame) -> Scene:
    """The objects, lights and materials of a scene file in a frame; its cameras stay as they are."""
    if frame == WORLD:
        return scene
    materials = {
        name: _material(material, frame.scale)
        for name, material in scene.materials.items()
    }
    return replace(
        scene,
        objects=tuple(_object(item, frame) for item in scene.objects),
        materials=materials,
        lights={name: _light(light, frame) for name, light in scene.lights.items()},
    )


def _object(item: SceneObject, frame: SceneFrame) -> SceneObject:
    pose = item.world_from_object
    if not item.instances:
        return replace(item, world_from_object=frame.affine(pose))
    # Copies share one shape in the axes of a group: around its middle, in the size that it has in the frame.
    group_from_object = np.eye(4)
    group_from_object[:3, :3] = frame.scale * pose[:3, :3]
    group_from_object[:3, 3] = -group_from_object[:3, :3] @ _middle(item.shape)
    object_from_group = np.linalg.inv(group_from_object)
    instances = tuple(
        frame.affine(instance @ pose) @ object_from_group for instance in item.instances
    )
    return replace(item, world_from_object=group_from_object, instances=instances)


def _middle(shape: Mesh | Plugin) -> Float:
    """The middle (3,) of a mesh's box, in its own axes; the origin of an analytic shape, and of a mesh without any."""
    if not isinstance(shape, Mesh) or not len(shape.vertices):
        return np.zeros(3)
    middle: Float = (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)) / 2
    return middle


def _light(light: Plugin, frame: SceneFrame) -> Plugin:
    """A light at a point in the frame; others are at infinity."""
    if light["type"] not in _POINTS:
        return light
    intensity = _times(light.get("intensity", 1.0), frame.scale**2)
    placed = {**light, "intensity": intensity}
    if light["type"] == "point":
        position = np.asarray(light.get("position", (0.0, 0.0, 0.0)), dtype=np.float64)
        return {**placed, "position": frame.points(position).tolist()}
    pose = np.asarray(light.get("to_world", np.eye(4)), dtype=np.float64)
    return {**placed, "to_world": frame.rigid(pose)}


def _times(value: Any, factor: float) -> Any:
    """A value of a light, a number or a colour or a picture, times a factor."""
    if isinstance(value, Bitmap):
        return replace(value, pixels=np.float32(factor) * value.pixels)
    if isinstance(value, Color):
        red, green, blue = (factor * channel for channel in value.rgb)
        return replace(value, rgb=(red, green, blue))
    return factor * value


def _material(material: AnyMaterial, scale: float) -> AnyMaterial:
    """A material whose bumps, which are lengths, are in units of the frame."""
    if not isinstance(material, Material):
        return _plugin(material, scale)
    if material.bump is None:
        return material
    return replace(material, bump_scale=material.bump_scale * scale)


def _plugin(plugin: Plugin, scale: float) -> Plugin:
    """A BSDF, and those in it, with bumps in units of the frame."""
    placed = {
        key: _plugin(value, scale) if isinstance(value, Mapping) else value
        for key, value in plugin.items()
    }
    if plugin.get("type") == "bumpmap":
        placed["scale"] = scale * plugin.get("scale", 1.0)
    return placed
