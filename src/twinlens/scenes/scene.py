"""A scene as plain data: objects, materials, lights and a default camera pose.

`twinlens.rendering` builds a Mitsuba scene from it.
"""

import itertools
import re
from collections.abc import Container, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import (
    InputError,
    NotUsedWarning,
    check_known,
    check_number,
    counted,
    format_value,
    located,
)
from twinlens.geometry import Float, check_rigid
from twinlens.geometry.motion import Motion, check_time
from twinlens.scenes.materials import (
    AnyMaterial,
    Bitmap as Bitmap,
    Color as Color,
    Material,
    Plugin as Plugin,
    emission_of,
)
from twinlens.scenes.placement import rotation, translation

_EQUAL_SCALES = {"sphere": 3, "cylinder": 2}
"""How many axes of a shape need the same scale. Otherwise Mitsuba logs a warning and renders it without the stretch."""


class SceneWarning(NotUsedWarning):
    """A part of a file of a scene is ignored; the message names file and part."""


WHOLE_PATHS: Plugin = {"type": "path", "max_depth": -1, "rr_depth": 3}
"""The default integrator: paths of any length, which end at random once they carry little light. The mean is right."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: vertices float64 (V, 3) in object coordinates, faces uint32 (F, 3), uv float64 (V, 2) or None.

    With `normals` float64 (V, 3) shading is smooth; None leaves the faces flat. `surface` (F,) numbers the materials of
    its object; None is one material. `attributes` (V, C) are values that materials read by name, as a `VertexColor`.
    Raises InputError for other array shapes, values that are not finite, and faces with vertex numbers out of range.
    """

    vertices: Float
    faces: NDArray[np.uint32]
    normals: Float | None = None
    uv: Float | None = None
    surface: NDArray[np.uint16] | None = None
    attributes: Mapping[str, Float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = 0
        for name, width in (("vertices", 3), ("normals", 3), ("uv", 2)):
            if (values := getattr(self, name)) is None:
                continue
            try:
                rows = np.asarray(values, dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"a mesh's {name} must be numbers (N, {width}): {error}"
                ) from error
            if name == "vertices" and rows.ndim:
                count = len(rows)
            if rows.shape != (count, width):
                raise InputError(
                    f"a mesh's {name} must have the shape ({count}, {width}), got {rows.shape}"
                )
            if not np.isfinite(rows).all():
                row = int((~np.isfinite(rows)).any(axis=1).argmax())
                raise InputError(f"a mesh's {name} must be finite; row {row} is not")
            object.__setattr__(self, name, rows)
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise InputError(
                f"a mesh's faces must be integers (F, 3), got {faces.dtype} {faces.shape}"
            )
        if faces.size and not 0 <= faces.min() <= faces.max() < count:
            raise InputError(
                f"a mesh's faces must have vertex numbers 0 to {count - 1}, got {faces.min()} to {faces.max()}"
            )
        object.__setattr__(self, "faces", faces.astype(np.uint32, copy=False))


@dataclass(frozen=True, eq=False)
class SceneObject:
    """An object of the scene, with its own id in the ground truth.

    `shape` is a Mesh, or the plugin of an analytic shape (sphere, rectangle, disk, cylinder, cube). `material` is the
    name of one of the scene's materials, or the names of those that the mesh's `surface` numbers. An `emitter` makes
    the object a light source. With `instances` (4x4 poses) the
    object appears once per pose, placed by ``instance @ world_from_object``; each copy has its own id (``name[0]``,
    ``name[1]``, ...), and all share one geometry in memory. `merged` says that the mesh is several copies in one.

    Raises InputError where a sphere is stretched, or a cylinder other than along its axis from `p0` to `p1`.
    """

    name: str
    shape: Mesh | Plugin
    material: str | tuple[str, ...]
    world_from_object: Float = field(default_factory=lambda: np.eye(4))
    emitter: Plugin | None = None
    instances: tuple[Float, ...] = ()
    merged: bool = False

    @property
    def materials(self) -> tuple[str, ...]:
        """The names of its materials."""
        return (self.material,) if isinstance(self.material, str) else self.material

    def __post_init__(self) -> None:
        shape = self.shape
        if isinstance(shape, Mesh) or (kind := shape.get("type")) not in _EQUAL_SCALES:
            return
        along = np.asarray(shape.get("p1", (0, 0, 1)), float) - np.asarray(
            shape.get("p0", (0, 0, 0)), float
        )
        if not np.isfinite(along).all() or not along.any():
            raise InputError(
                f"a {kind} needs p0 and p1 finite and different, got {shape}"
            )
        local = np.linalg.qr(np.column_stack([along, np.eye(3)]))[0][
            :, [1, 2, 0]
        ]  # orthonormal, `along` last
        local = np.asarray(shape.get("to_world", np.eye(4)), float)[:3, :3] @ local
        for pose in (self.world_from_object, *self.instances):
            axes = np.asarray(pose)[:3, :3] @ local
            gram = axes.T @ axes
            scales = np.diag(gram)[: _EQUAL_SCALES[kind]]  # squared
            if (
                np.abs(gram - np.diag(np.diag(gram))).max() + np.ptp(scales)
                > 1e-6 * gram.max()
            ):
                name = f"object {self.name!r}: " if self.name else ""
                may = " (its axis may be longer)" if kind == "cylinder" else ""
                raise InputError(
                    f"{name}a {kind} needs a uniform scale{may}; use a mesh to stretch it"
                )


def free_name(name: str, taken: Container[str]) -> str:
    """`name`, or name-2, name-3, ... if it is taken.

    >>> free_name("nut", ["nut", "nut-2"])
    'nut-3'
    """
    names = itertools.chain(
        [name], (f"{name}-{number}" for number in itertools.count(2))
    )
    return next(candidate for candidate in names if candidate not in taken)


@dataclass(frozen=True, eq=False)
class Sky:
    """A panorama at infinity that lights a scene: float32 (H, W, 3), linear radiance, W = 2 H, top row straight up.

    turn_deg : rotation about the vertical z axis, from +x to +y. At 0, the middle column of the picture is towards -y,
        and the column at a quarter of its width towards +x.
    scale : factor of the radiance.
    nir : near infrared share of its light (`twinlens.scenes.bands`); None derives it from the colour.
    visible : whether cameras see it. A hidden sky gives light and reflections, and is black where a camera ray leaves
        the scene directly.
    record : where it comes from, plain data for sample.json.

    Raises InputError for other shapes, values that are negative or not finite, and a picture without light.
    """

    pixels: NDArray[np.float32]
    turn_deg: float = 0.0
    scale: float = 1.0
    visible: bool = True
    record: Mapping[str, Any] = field(default_factory=dict)
    nir: float | None = None

    def __post_init__(self) -> None:
        pixels = np.asarray(self.pixels)
        if (
            pixels.ndim != 3
            or pixels.shape[2] != 3
            or pixels.shape[0] < 3
            or pixels.shape[1] < 2
        ):
            raise InputError(
                f"a sky must be an image (H >= 3, W >= 2, 3), got the shape {pixels.shape}"
            )
        if not (np.isfinite(pixels).all() and (pixels >= 0).all() and pixels.any()):
            raise InputError("a sky must have finite values >= 0, and some light")
        check_number(
            "the turn_deg of a sky", self.turn_deg, "a finite number of degrees"
        )
        check_number("the scale of a sky", self.scale, "a finite number > 0", above=0)
        if self.nir is not None:
            check_number("the nir of a sky", self.nir, "a finite number >= 0", least=0)

    def plugin(self) -> dict[str, Any]:
        """The environment map of the renderer."""
        return {
            "type": "envmap",
            "bitmap": Bitmap(self.pixels),
            "to_world": rotation([0, 0, 1], self.turn_deg)
            @ rotation([1, 0, 0], 90.0),  # maps have y up, worlds z
            **({} if self.scale == 1 else {"scale": float(self.scale)}),
        }


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene and its default view.

    materials : by name.
    lights : emitters that are not objects (environment maps, point lights, the sun).
    world_from_left : (4, 4), the pose of the left camera.
    fov_x_deg, baseline : the horizontal field of view, and the baseline in metres.
    depth_range : (near, far) depths in metres in the default view. If `depth_range_known` is false, it is a renderer's
        default, and no focus or disparity range should be derived from it.
    xml : a checked Mitsuba file, in place of objects, materials and lights.
    files : the files that the scene was read from.
    rig : the table of the scene's cameras (`twinlens.scenes.rigs`); None is a rectified pair.
    sky : in place of `lights`.
    ambient : factor of all its light: lights, objects and materials that emit, sky. It does not scale projectors.
    motion : how objects and lights move. Their poses here are their placements; `at(time)` is the still scene that
        renders.
    """

    name: str
    objects: tuple[SceneObject, ...]
    materials: Mapping[str, AnyMaterial]
    world_from_left: Float
    depth_range: tuple[float, float]
    lights: Mapping[str, Plugin] = field(default_factory=dict)
    integrator: Plugin = field(default_factory=lambda: {**WHOLE_PATHS})
    fov_x_deg: float = 50.0
    baseline: float = 0.1
    description: str = ""
    xml: Path | None = None
    files: tuple[Path, ...] = ()
    depth_range_known: bool = True
    rig: Mapping[str, Any] | None = None
    sky: Sky | None = None
    ambient: float = 1.0
    motion: tuple[Motion, ...] = ()

    def __post_init__(self) -> None:
        check_number(
            "the ambient of a scene", self.ambient, "a finite number >= 0", least=0
        )
        object.__setattr__(
            self,
            "world_from_left",
            check_rigid(self.world_from_left, "world_from_left"),
        )
        near, far = self.depth_range
        if not 0 < near < far:
            raise InputError(
                f"scene {self.name!r}: depth_range must be 0 < near < far in metres, got [{near}, {far}]"
            )
        for scene_object in self.objects:
            with located(f"objects.{scene_object.name}.material"):
                for name in scene_object.materials:
                    check_known("material", name, self.materials)
        object.__setattr__(self, "motion", tuple(self.motion))
        _check_motions(self)

    @property
    def is_lit(self) -> bool:
        """Whether it has a light, an object or a material that emits light, or a sky; a Mitsuba file may have any."""
        if not self.ambient:
            return False
        if self.xml or self.sky or self.lights:
            return True
        for scene_object in self.objects:
            materials = [self.materials[name] for name in scene_object.materials]
            if materials and (scene_object.emitter or any(map(emission_of, materials))):
                return True
        return False

    def at(self, when: ArrayLike) -> "Scene":
        """The still scene at a time (seconds); or, of a pose (4, 4), the same scene with that pose of the left camera.

        Raises InputError outside the times of keyframes or trajectories, with the range that they cover.
        """
        if np.ndim(when) > 0:
            return replace(self, world_from_left=np.asarray(when, dtype=np.float64))
        time = check_time(when)
        if not self.motion:
            return self
        of_objects = {motion.object: motion for motion in self.motion if motion.object}
        of_lights = {motion.light: motion for motion in self.motion if motion.light}
        lights = {
            name: _light_at(light, of_lights[name], time)
            if name in of_lights
            else light
            for name, light in self.lights.items()
        }
        objects = tuple(_object_at(item, of_objects, time) for item in self.objects)
        return replace(self, objects=objects, lights=lights, motion=())

    def moving(self, *motions: Motion) -> "Scene":
        """The same scene with these motions beside those that it has. Raises InputError for what cannot move so."""
        return replace(self, motion=(*self.motion, *motions))

    def with_poses(self, poses: Mapping[str, ArrayLike]) -> "Scene":
        """The same scene with other poses `world_from_object` (4, 4) of some of its objects, by name.

        Meshes, textures and materials stay the same objects in memory, so that a renderer may update what it built.
        The pose of an object with `instances` moves all its copies: ``instance @ world_from_object``. Raises InputError
        for an unknown name, and for a pose that is not an invertible affine transform.
        """
        for name in poses:
            check_known(
                "object", name, [scene_object.name for scene_object in self.objects]
            )
        objects = tuple(
            replace(
                scene_object,
                world_from_object=_affine(poses[scene_object.name], scene_object.name),
            )
            if scene_object.name in poses
            else scene_object
            for scene_object in self.objects
        )
        return replace(self, objects=objects)

    def with_ambient(self, factor: float) -> "Scene":
        """The same scene with its light multiplied by this factor, >= 0. Raises InputError."""
        check_number("the ambient of a scene", factor, "a finite number >= 0", least=0)
        return replace(self, ambient=factor * self.ambient)

    def lit_by(self, sky: Sky, lamps: bool = True) -> "Scene":
        """The same scene with `sky` in place of its lights. Without `lamps`, objects that emit light are dark."""
        if lamps:
            return replace(self, sky=sky)
        objects = tuple(
            replace(scene_object, emitter=None) for scene_object in self.objects
        )
        materials = {
            name: _without_emission(material)
            for name, material in self.materials.items()
        }
        return replace(self, objects=objects, materials=materials, sky=sky)


def _object_at(
    item: SceneObject, motions: Mapping[str, Motion], time: float
) -> SceneObject:
    """An object, and its copies, where they are at a time."""
    whole = motions.get(item.name)
    if not item.instances:
        if whole is None:
            return item
        return replace(
            item, world_from_object=whole.pose_at(time, item.world_from_object)
        )
    instances = []
    for number, instance in enumerate(item.instances):
        motion = motions.get(copy_name(item.name, number), whole)
        if motion is not None:
            # The pose of a copy is instance @ world_from_object.
            origin = (instance @ item.world_from_object)[:3, 3]
            instance = motion.displacement(time, origin) @ instance
        instances.append(instance)
    return replace(item, instances=tuple(instances))


def copy_name(name: str, number: int) -> str:
    """The name of a copy of an object with instances."""
    return f"{name}[{number}]"


def _light_at(light: Plugin, motion: Motion, time: float) -> Plugin:
    """A point light or spot where it is at a time."""
    if light["type"] == "point":
        placement = translation(light.get("position", (0.0, 0.0, 0.0)))
        return {**light, "position": motion.pose_at(time, placement)[:3, 3].tolist()}
    placement = np.asarray(light.get("to_world", np.eye(4)), dtype=np.float64)
    return {**light, "to_world": motion.pose_at(time, placement)}


_MOVING_LIGHTS = ("point", "spot")
_NUMBERED = re.compile(r"(.+)(\[(?:0|[1-9][0-9]*)\])")
"""The name of a copy: that of its object, and its number."""


def _check_motions(scene: Scene) -> None:
    """Raise InputError for motions of what is not in the scene or cannot move, and for two motions of one body."""
    parts_of: dict[tuple[str, str], list[str]] = {}
    for number, motion in enumerate(scene.motion):
        with located(f"motion[{number}]"):
            if not isinstance(motion, Motion):
                raise InputError(f"must be a Motion, got {format_value(motion)}")
            kind, name, part = _moving_part(scene, motion)
            parts = parts_of.setdefault((kind, name), [])
            # The whole object, whose part is "", includes each of its copies.
            if part in parts or "" in parts or (parts and not part):
                raise InputError(f"{motion.subject} has a motion already")
            parts.append(part)


def _moving_part(scene: Scene, motion: Motion) -> tuple[str, str, str]:
    """("light", its name, "") or ("object", its name, "[i]" of a copy or ""), checked."""
    if motion.light is not None:
        _check_light_moves(scene, motion.light)
        return "light", motion.light, ""
    if motion.object is None:
        raise InputError(
            "names nothing that moves: add 'object' or 'light'; a rig moves by Rig.moving"
        )
    if scene.xml is not None:
        raise InputError(
            f"object {motion.object!r}: objects of a Mitsuba file cannot move"
        )
    objects = {item.name: item for item in scene.objects}
    name, part = motion.object, ""
    numbered = _NUMBERED.fullmatch(name)
    if name not in objects and numbered and numbered[1] in objects:
        name, part = numbered[1], numbered[2]
        copies = len(objects[name].instances)
        if not int(part[1:-1]) < copies:
            raise InputError(
                f"unknown copy {motion.object!r}: object {name!r} has {counted(copies, 'copy', 'copies')}, "
                "counted from 0"
            )
    check_known("object", name, objects)
    if objects[name].merged:
        raise InputError(
            f"object {name!r} is a merged mesh, whose copies have no poses: leave out 'merge' so that they can move"
        )
    return "object", name, part


def _check_light_moves(scene: Scene, name: str) -> None:
    check_known("light", name, scene.lights)
    kind = scene.lights[name].get("type")
    if kind not in _MOVING_LIGHTS:
        raise InputError(
            f"light {name!r} is {kind!r}, at infinity: only {' and '.join(_MOVING_LIGHTS)} lights can move"
        )


def _affine(pose: ArrayLike, name: str) -> Float:
    """A pose as float64 (4, 4)."""
    matrix = np.asarray(pose, dtype=np.float64)
    is_affine = matrix.shape == (4, 4) and matrix[3].tolist() == [0, 0, 0, 1]
    if not is_affine or not np.isfinite(matrix).all():
        raise InputError(
            f"the pose of {name!r} must be finite (4, 4) with the last row 0 0 0 1, got {matrix.tolist()}"
        )
    if np.linalg.det(matrix[:3, :3]) == 0:
        raise InputError(
            f"the pose of {name!r} must be invertible, its determinant is 0"
        )
    return matrix


def _without_emission(material: AnyMaterial) -> AnyMaterial:
    if emission_of(material) is None:
        return material
    assert isinstance(material, Material)
    return replace(material, emission=None)
