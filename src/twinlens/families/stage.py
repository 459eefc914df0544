"""A scene being put together: bodies, their materials and lights, as they come; then a `Scene`."""

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twinlens.families.view import Seen, View, look
from twinlens.geometry import Float, rigid, transform_points
from twinlens.scenes.scene import Mesh, Plugin, Scene, SceneObject

_IDENTITY = np.eye(4)


@dataclass(eq=False)
class Stage:
    """Collects objects in metres. Names are made unique: bottle, bottle-2, ..."""

    objects: list[SceneObject] = field(default_factory=list)
    materials: dict[str, Plugin] = field(default_factory=dict)
    lights: dict[str, Plugin] = field(default_factory=dict)

    def add(
        self, name: str, mesh: Mesh, material: Plugin, pose: Float = _IDENTITY, emitter: Plugin | None = None
    ) -> SceneObject:
        """Put a body with a material of its own into the scene."""
        unique = self._unique(name)
        self.materials[unique] = material
        self.objects.append(SceneObject(unique, mesh, unique, np.asarray(pose, dtype=np.float64), emitter))
        return self.objects[-1]

    def _unique(self, name: str) -> str:
        """The name, of letters that any file format takes, numbered where it is taken."""
        plain = re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-") or "body"
        taken = {thing.name for thing in self.objects}
        numbered = (f"{plain}-{number}" for number in range(2, len(taken) + 3))
        return plain if plain not in taken else next(one for one in numbered if one not in taken)

    def seen(self, view: View, columns: int = 160) -> Seen:
        """The z-buffer of everything so far."""
        return look(view, [world(thing) for thing in self.objects], columns)

    def scene(self, name: str, view: View, baseline: float, depth_range: tuple[float, float], about: str) -> Scene:
        """All of it, seen from `view`."""
        return Scene(
            name=name,
            objects=tuple(self.objects),
            materials=self.materials,
            lights=self.lights,
            world_from_left=view.world_from_cam,
            fov_x_deg=view.fov_x_deg,
            baseline=baseline,
            depth_range=depth_range,
            description=about,
        )


def world(thing: SceneObject) -> tuple[Float, NDArray[np.uint32]]:
    """A mesh object's triangles in the world."""
    mesh = thing.shape
    assert isinstance(mesh, Mesh)
    return transform_points(thing.world_from_object, mesh.vertices), mesh.faces


def placed(turn: Float, position: Float, size: float) -> Float:
    """The pose (4, 4) that scales, turns and moves."""
    pose = rigid(turn, position)
    pose[:3, :3] *= size
    return pose
