"""A scene while it is composed: objects, materials and lights are added; `scene` makes a `Scene` of them.

Every random decision has its own stream, named after what it decides: `Composition.rng("object", 3, "texture")`. A new
texture in the tables therefore moves no object.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twinlens.families.assets import Assets
from twinlens.families.draws import PALETTES, Palette, Rng, log_uniform, one_of
from twinlens.families.view import Triangles, View, ZBuffer, rasterize, triangles
from twinlens.geometry import Float, look_at, rigid
from twinlens.scenes.scene import Mesh, Plugin, Scene, SceneObject
from twinlens.seeds import generator

_ROUNDS = 5


@dataclass(eq=False)
class Composition:
    """The settings of a scene of `count` objects, drawn between two counts, and what was added to it so far.

    The picture is `width_px` wide with width/height = `aspect`; `look` sets the view. Lengths are in metres.
    """

    name: str
    root: np.random.SeedSequence
    assets: Assets
    depth_range: tuple[float, float] | None
    counts: tuple[int, int]
    aspect: float
    width_px: int
    count: int = field(init=False)
    palette: Palette = field(init=False)
    view: View = field(init=False)
    objects: list[SceneObject] = field(default_factory=list)
    materials: dict[str, Plugin] = field(default_factory=dict)
    lights: dict[str, Plugin] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.count = int(self.rng("count").integers(self.counts[0], self.counts[1] + 1))
        self.palette = one_of(self.rng("palette"), PALETTES)

    def rng(self, *part: str | int) -> Rng:
        """The random stream of one part of the scene, independent of all others."""
        entropy: Any = self.root.entropy
        return generator(entropy, *self.root.spawn_key, *map(str, part))

    def depth_ratio(self, low: float, high: float) -> float:
        """Far depth over near depth: as requested, or drawn between `low` and `high`."""
        if self.depth_range is not None:
            return self.depth_range[1] / self.depth_range[0]
        return log_uniform(self.rng("depth"), low, high)

    def look(self, eye: Float, target: Float, fov_x_deg: float) -> None:
        """Set the view: a camera at `eye` (3,) that looks at `target` (3,)."""
        self.view = View(look_at(eye, target), float(fov_x_deg), self.aspect, self.width_px)

    def add(
        self, name: str, mesh: Mesh, material: Plugin, pose: Float | None = None, emitter: Plugin | None = None
    ) -> None:
        """Add an object with its own material. Names become unique: bottle, bottle-2, ..."""
        plain = re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-") or "body"
        unique, number = plain, 1
        while unique in self.materials:
            number += 1
            unique = f"{plain}-{number}"
        self.materials[unique] = material
        world_from_object = np.eye(4) if pose is None else np.asarray(pose, dtype=np.float64)
        self.objects.append(SceneObject(unique, mesh, unique, world_from_object, emitter))

    def pixel_at(self, point: Float, least_depth: float = -np.inf) -> float:
        """Width in metres of a pixel at a world point (3,)."""
        return self.view.pixel(max(float(self.view.depth(point[None])[0]), least_depth))

    def triangles(self) -> list[Triangles]:
        """All objects' triangles in the world."""
        meshes = [(thing.shape, thing.world_from_object) for thing in self.objects]
        return [triangles(mesh, pose) for mesh, pose in meshes if isinstance(mesh, Mesh)]

    def z_buffer(self, others: Iterable[Mesh] = (), columns: int = 160) -> ZBuffer:
        """The z-buffer of all objects and of `others`, meshes in the world."""
        return rasterize(self.view, [*self.triangles(), *map(triangles, others)], columns)

    def backdrop_distance(self, backdrop: Callable[[float], list[Mesh]], far: float, start: float) -> float:
        """The distance of a backdrop at which the largest depth in the picture is `far` metres.

        `backdrop(distance)` returns its meshes in the world; the iteration begins at `start` metres.
        """
        distance = start
        for _ in range(_ROUNDS):
            found = self.z_buffer(backdrop(distance), 96).depth_range[1]
            if abs(found - far) < 0.005 * far:
                break
            distance = max(distance * far / found, 0.2 * start)
        return distance

    def scene(self, about: str) -> Scene:
        """The scene, scaled to the requested nearest depth.

        Scaling about the camera's centre changes no pixel and multiplies every depth. The baseline gives the nearest
        point a disparity of 6% to 12% of the picture's width.
        """
        objects, view = self.objects, self.view
        near, far = self.z_buffer().depth_range
        if self.depth_range is not None:
            scale = self.depth_range[0] / near
            grow = similarity(np.eye(3), (1 - scale) * view.eye, scale)
            objects = [replace(thing, world_from_object=grow @ thing.world_from_object) for thing in objects]
            near, far = near * scale, far * scale
        return Scene(
            name=self.name,
            objects=tuple(objects),
            materials=self.materials,
            lights=self.lights,
            world_from_left=view.world_from_cam,
            fov_x_deg=view.fov_x_deg,
            baseline=float(self.rng("baseline").uniform(0.06, 0.12) * 2 * view.half[0] * near),
            depth_range=(near, far),
            description=about,
        )


@dataclass(frozen=True)
class Family:
    """A kind of scene: a description, the default object count (min, max), and the function that composes a scene.

    `least_ratio` is the smallest far/near that `compose` supports.
    """

    about: str
    object_count: tuple[int, int]
    compose: Callable[[Composition], None]
    least_ratio: float


def similarity(turn: Float, position: Float, size: float) -> Float:
    """The pose (4, 4) that scales by `size`, rotates by `turn` (3, 3), then moves to `position` (3,)."""
    pose = rigid(turn, position)
    pose[:3, :3] *= size
    return pose
