"""A scene while it is composed: objects, materials and lights are added; `scene` makes a `Scene` of them."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from twinlens.families.colors import Palette, draw_palette
from twinlens.families.draws import Rng
from twinlens.families.family import Request
from twinlens.families.view import Triangles, View, ZBuffer, rasterize, triangles
from twinlens.geometry import Float
from twinlens.scenes.scene import Mesh, Plugin, Scene, SceneObject

_IDENTITY = np.eye(4)
_ROUNDS = 5


@dataclass(eq=False)
class Composition:
    """The objects of a scene in metres, the view it is composed for, and its palette."""

    request: Request
    view: View
    palette: Palette = field(init=False)
    objects: list[SceneObject] = field(default_factory=list)
    materials: dict[str, Plugin] = field(default_factory=dict)
    lights: dict[str, Plugin] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.palette = draw_palette(self.rng("palette"))

    def rng(self, *part: str | int) -> Rng:
        """The random stream of one part of the scene."""
        return self.request.rng(*part)

    def add(
        self, name: str, mesh: Mesh, material: Plugin, pose: Float = _IDENTITY, emitter: Plugin | None = None
    ) -> None:
        """Add an object with its own material. Names become unique: bottle, bottle-2, ..."""
        unique = self._unique(name)
        self.materials[unique] = material
        self.objects.append(SceneObject(unique, mesh, unique, np.asarray(pose, dtype=np.float64), emitter))

    def _unique(self, name: str) -> str:
        """The name in letters that every file format accepts, numbered where it is taken."""
        plain = re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-") or "body"
        taken = {thing.name for thing in self.objects}
        numbered = (f"{plain}-{number}" for number in range(2, len(taken) + 3))
        return plain if plain not in taken else next(one for one in numbered if one not in taken)

    def pixel_at(self, point: Float, least_depth: float = -np.inf) -> float:
        """Width in metres of a pixel at a world point (3,)."""
        return self.view.pixel(max(self.view.depth_of(point), least_depth))

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
        if self.request.depth_range is not None:
            scale = self.request.depth_range[0] / near
            grow = np.diag([scale, scale, scale, 1.0])
            grow[:3, 3] = (1 - scale) * view.eye
            objects = [replace(thing, world_from_object=grow @ thing.world_from_object) for thing in objects]
            near, far = near * scale, far * scale
        return Scene(
            name=self.request.name,
            objects=tuple(objects),
            materials=self.materials,
            lights=self.lights,
            world_from_left=view.world_from_cam,
            fov_x_deg=view.fov_x_deg,
            baseline=float(self.rng("baseline").uniform(0.06, 0.12) * 2 * view.half[0] * near),
            depth_range=(near, far),
            description=about,
        )
