"""Builds the Mitsuba scene of a `Scene`, once. Rendering and ground truth use only the result.

A built scene has one band of light (`scenes.bands`). Its objects can take new poses without being loaded again.
"""

import contextlib
import itertools
import threading
import weakref
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import BackendError, InputError
from twinlens.geometry import Float
from twinlens.rendering.arrays import aligned
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.frames import WORLD, SceneFrame, in_frame
from twinlens.rendering.materials import (
    bsdf_of,
    emitter_of,
    material_kind,
    vertex_attributes,
)
from twinlens.rendering.xml_frames import place, scale_lights
from twinlens.scenes import Bitmap, Color, Mesh, Plugin, Scene, SceneObject
from twinlens.scenes.scene import copy_name
from twinlens.scenes.shapes import transformed
from twinlens.scenes.xml_file import checked_xml

_INSTANCE = 1 << 10  # Mitsuba 3.9 has no name for this shape type

_MOST_FRAMES = 3  # of a scene, whose built scenes are kept

_cache: "weakref.WeakKeyDictionary[Scene, dict[SceneFrame, BuiltScene]]" = (
    weakref.WeakKeyDictionary()
)
_building = threading.Lock()


@dataclass(frozen=True, eq=False)
class Body:
    """A shape in the world, with its ids in the ground truth.

    `shape` is the Mitsuba shape whose geometry is hit, `instance` the Mitsuba instance that places it, if any; both are
    in the frame of the built scene. `model` and `world_from_model` (4x4, affine) are those of its scene file, in the
    world; None for a shape of a Mitsuba file. `surface` is the part of `model` with this material, and
    `group_from_model` (4x4) the pose of a shape in the group whose instance it is.
    """

    object_id: int
    material_id: int
    material_kind: int
    shape: Any
    instance: Any = None
    model: Mesh | Plugin | None = None
    world_from_model: Float | None = None
    surface: Mesh | Plugin | None = None
    group_from_model: Float | None = None

    @property
    def hit_object(self) -> Any:
        """The Mitsuba object that identifies the body in a hit."""
        return self.shape if self.instance is None else self.instance


@dataclass(frozen=True, eq=False)
class BuiltScene:
    """A loaded Mitsuba scene and its bodies: all that rendering and ground truth know of a Scene.

    integrator : the scene's own, or one in its place. `rendering.integrators` hides the sky from it.
    object_names, material_names : entry i has the id i + 1.
    name : of the scene, for messages.
    frame : of all coordinates in the Mitsuba scene.
    path : the options `max_depth` and `rr_depth` of its path integrator; None if it is another one, or of a Mitsuba
        file: then our own integrators cannot take its place.
    sky_visible : whether camera rays that hit nothing see the sky.
    parts : the shapes and lights of the Mitsuba scene; None for a file whose parts cannot be used again.
    projected : the integrator that adds the light of projectors, which are not in the scene; None if there is none.
    cache : what others derive from the scene, by name; emptied where objects move.
    """

    mi_scene: Any
    integrator: Any
    bodies: list[Body]
    object_names: tuple[str, ...]
    material_names: tuple[str, ...]
    name: str = ""
    frame: SceneFrame = WORLD
    path: Mapping[str, int] | None = None
    sky_visible: bool = True
    parts: Mapping[str, Any] | None = None
    projected: Any = None
    cache: dict[str, Any] = field(default_factory=dict)

    def follows_rays(self) -> bool:
        """Whether images are of rays from the camera, whose samples are known: not if light is traced from lamps."""
        return isinstance(self.integrator, mitsuba().SamplingIntegrator)

    def with_integrator(self, integrator: Any, **changes: Any) -> "BuiltScene":
        """This scene with another integrator."""
        return replace(self, integrator=integrator, **changes)


def build(scene: Scene, frame: SceneFrame = WORLD) -> BuiltScene:
    """The Mitsuba scene of `scene` in a frame. The frames used last are cached as long as the Scene exists."""
    with _building:
        in_frames = _cache.setdefault(scene, {})
        # The first key is the one that has not been used for longest.
        built = in_frames.pop(frame, None) or _built(scene, frame)
        in_frames[frame] = built
        if len(in_frames) > _MOST_FRAMES:
            del in_frames[next(iter(in_frames))]
        return built


def build_moved(scene: Scene, before: Scene, frame: SceneFrame = WORLD) -> BuiltScene:
    """The built scene of `before`, whose objects take the poses that they have in `scene`.

    As `move_built`. Raises InputError where the scenes differ in more than poses, and for Mitsuba files.
    """
    move_built(scene, before)
    return build(scene, frame)


def move_built(scene: Scene, before: Scene) -> None:
    """Give what was built of `before` in any frame to `scene`, with the poses of its objects.

    The scenes must differ in these poses alone. Nothing is loaded again; `before` would be built again.

    Raises InputError where the scenes differ in more than poses, and for Mitsuba files.
    """
    _check_moved(scene, before)
    with _building:
        in_frames = _cache.pop(before, {})
        for of_frame in in_frames.values():
            _move(of_frame, scene)
        _cache[scene] = in_frames


def _built(scene: Scene, frame: SceneFrame) -> BuiltScene:
    is_file = scene.xml is not None
    built = _build_xml(scene, frame) if is_file else _build_objects(scene, frame)
    if scene.ambient != 1:
        _scale_light(built.mi_scene, scene.ambient)
    return built


def _check_moved(scene: Scene, before: Scene) -> None:
    """Raise InputError unless two scenes of scene files differ in the poses of objects alone."""
    same = scene.xml is None and len(scene.objects) == len(before.objects)
    for name in ("materials", "lights", "integrator", "sky", "ambient"):
        same &= getattr(scene, name) is getattr(before, name)
    for new, old in zip(scene.objects, before.objects, strict=False):
        same &= new.shape is old.shape and new.emitter is old.emitter
        same &= new.material == old.material
        same &= len(new.instances) == len(old.instances)
    if not same:
        raise InputError(
            f"{scene.name}: only the poses of objects may differ from the scene that was built, and a Mitsuba file has"
            " none; use build"
        )


def _move(built: BuiltScene, scene: Scene) -> None:
    """Place the objects of a built scene where those of `scene` are."""
    poses = _poses_of(scene)
    for row, body in enumerate(built.bodies):
        pose = poses[body.object_id - 1]
        assert body.world_from_model is not None  # only Mitsuba files have such bodies
        if np.array_equal(pose, body.world_from_model):
            continue
        parameters = mitsuba().traverse(body.hit_object)
        for name, value in _placement(body, built.frame.affine(pose)).items():
            parameters[name] = value
        parameters.update()
        built.bodies[row] = replace(body, world_from_model=pose)
    # The first call computes the bounds of the scene again, the second gives them to the sky.
    for _ in range(2):
        built.mi_scene.parameters_changed()
    built.cache.clear()


def _placement(body: Body, frame_from_model: Float) -> dict[str, Any]:
    """The parameters of a body's Mitsuba shape or instance that place it."""
    mi = mitsuba()
    assert body.surface is not None
    if body.instance is not None and body.group_from_model is not None:
        # The shape in the group has the object's own pose already.
        frame_from_group = frame_from_model @ np.linalg.inv(body.group_from_model)
        return {"to_world": mi.Transform4f(frame_from_group)}
    if isinstance(body.surface, Mesh):
        return _mesh_buffers(body.surface, frame_from_model)
    # Mitsuba folds other keys of the plugin into its pose, such as the radius of a sphere.
    plugin = _placed_plugin(body.surface, frame_from_model)
    loaded = mi.traverse(mi.load_dict(mitsuba_value(plugin)))
    if "to_world" in loaded:
        return {"to_world": loaded["to_world"]}
    # A cube is a mesh, whose vertices have the pose already.
    names = ("vertex_positions", "vertex_normals", "faces")
    return {name: loaded[name] for name in names}


def _need_two_threads() -> None:
    """Use two rendering threads or more from now on. With one, Mitsuba 3.9 never finishes decoding an EXR file.

    The second thread stays: Dr.Jit sometimes waits forever for the end of a thread that is about to sleep.
    """
    mitsuba()  # chooses the LLVM library, which must happen before Dr.Jit is imported
    import drjit

    if drjit.thread_count() < 2:
        drjit.set_thread_count(2)


def _build_objects(scene: Scene, frame: SceneFrame) -> BuiltScene:
    from twinlens.rendering.textures import register_textures  # sets up the backend

    register_textures()

    placed = in_frame(scene, frame)
    materials = {
        name: _load(bsdf_of(material), f"material {name!r}")
        for name, material in placed.materials.items()
    }
    # Made before lamps: the id of an environment map is a literal of kernels, and should be equal in all scenes.
    plugins = placed.lights if scene.sky is None else {"sky": scene.sky.plugin()}
    lights = {
        f"light{i:04d}": _load(plugins[name], f"light {name!r}")
        for i, name in enumerate(plugins)
    }
    parts: dict[str, Any] = {"type": "scene", "embree_use_robust_intersections": True}
    bodies, names = _bodies(placed, materials, parts)
    parts |= lights
    mi_scene = mitsuba().load_dict(parts, optimize=False)
    shapes = {shape.id(): shape for shape in mi_scene.shapes()}
    for key, body in bodies.items():
        if shapes[key] is not body.shape:
            bodies[key] = replace(body, instance=shapes[key])
    poses = _poses_of(scene)
    for key, body in bodies.items():
        bodies[key] = replace(body, world_from_model=poses[body.object_id - 1])
    sky_visible = scene.sky is None or scene.sky.visible
    integrator = _load(scene.integrator, "integrator")
    return BuiltScene(
        name=scene.name,
        frame=frame,
        mi_scene=mi_scene,
        integrator=integrator,
        path=_path_options(scene.integrator),
        sky_visible=sky_visible,
        bodies=list(bodies.values()),
        object_names=tuple(names),
        material_names=tuple(materials),
        parts=parts,
    )


def _bodies(
    scene: Scene, materials: dict[str, Any], parts: dict[str, Any]
) -> tuple[dict[str, Body], list[str]]:
    """The bodies by the id of their shape or instance in the scene, and the names of all copies of objects.

    The bodies have no pose in the world yet. The shapes are added to `parts`, the dictionary of the scene.
    """
    bodies: dict[str, Body] = {}
    names: list[str] = []
    for index, scene_object in enumerate(scene.objects):
        leaves = _leaves(scene_object, scene, materials)
        for number, (material, surface, leaf) in enumerate(leaves):
            body = Body(
                object_id=len(names) + 1,  # of its first copy
                material_id=1 + list(materials).index(material),
                material_kind=material_kind(leaf.bsdf(), scene.materials[material]),
                shape=leaf,
                model=scene_object.shape,
                surface=surface,
                group_from_model=scene_object.world_from_object,
            )
            label = f"{index:04d}-{number}" if number else f"{index:04d}"
            copies = dict(_parts(scene_object, label, leaf, parts))
            parts |= copies
            bodies |= _copies(body, copies)
        names += _copy_names(scene_object)
    return bodies, names


def _copies(body: Body, keys: Iterable[str]) -> dict[str, Body]:
    """The copies of an object's surface, by the ids of their parts; each is an object of its own."""
    return {
        key: replace(body, object_id=body.object_id + i) for i, key in enumerate(keys)
    }


def _copy_names(scene_object: SceneObject) -> list[str]:
    """The names of an object's copies in the ground truth, one for each of `_poses`."""
    if not scene_object.instances:
        return [scene_object.name]
    return [copy_name(scene_object.name, i) for i in range(len(scene_object.instances))]


def _poses_of(scene: Scene) -> list[Float]:
    """The world_from_model of each copy of all objects, by object id - 1."""
    poses: list[Float] = []
    for scene_object in scene.objects:
        poses += _poses(scene_object)
    return poses


def _poses(scene_object: SceneObject) -> list[Float]:
    """The world_from_model of each copy of an object."""
    if not scene_object.instances:
        return [scene_object.world_from_object]
    return [pose @ scene_object.world_from_object for pose in scene_object.instances]


def _path_options(plugin: Plugin) -> dict[str, int] | None:
    """The options of a scene's path integrator, None if it is another one or hides lamps."""
    if plugin["type"] != "path" or plugin.get("hide_emitters"):
        return None
    return {key: plugin[key] for key in ("max_depth", "rr_depth") if key in plugin}


def _parts(
    scene_object: SceneObject, label: str, leaf: Any, parts: dict[str, Any]
) -> Iterator[tuple[str, Any]]:
    """(key, Mitsuba part) of each copy of a leaf; instances share a shape group, which is added to `parts`."""
    if not scene_object.instances:
        yield f"object{label}", leaf
        return
    mi = mitsuba()
    group = mi.load_dict({"type": "shapegroup", "leaf": leaf})
    parts[f"group{label}"] = group
    for i, pose in enumerate(scene_object.instances):
        yield (
            f"object{label}_{i:05d}",
            {
                "type": "instance",
                "to_world": mi.ScalarTransform4f(pose),
                "group": group,
            },
        )


def _leaves(
    scene_object: SceneObject, scene: Scene, bsdfs: Mapping[str, Any]
) -> Iterator[tuple[str, Mesh | Plugin, Any]]:
    """The material, the geometry and the Mitsuba shape of each surface of an object."""
    mesh = scene_object.shape
    for number, material in enumerate(scene_object.materials):
        emitter = scene_object.emitter or emitter_of(scene.materials[material])
        if emitter is not None and scene_object.instances:
            raise InputError(
                f"object {scene_object.name!r}: an object with instances cannot shine, as {material!r} does"
            )
        shape = mesh
        if (
            isinstance(mesh, Mesh)
            and mesh.surface is not None
            and len(scene_object.materials) > 1
        ):
            shape = _subset(mesh, mesh.surface == number)
            if not len(shape.faces):
                continue
        if isinstance(shape, Mesh) and shape.attributes:
            attributes = vertex_attributes(scene.materials[material], shape)
            shape = replace(shape, attributes=attributes)
        leaf = _leaf(
            replace(scene_object, shape=shape, emitter=emitter), bsdfs[material]
        )
        yield material, shape, leaf


def _subset(mesh: Mesh, chosen: NDArray[np.bool_]) -> Mesh:
    """The chosen faces (F,) of a mesh, and their vertices."""
    used, faces = np.unique(mesh.faces[chosen], return_inverse=True)
    normals, uv = (
        None if values is None else values[used] for values in (mesh.normals, mesh.uv)
    )
    attributes = {name: values[used] for name, values in mesh.attributes.items()}
    return Mesh(
        mesh.vertices[used],
        faces.reshape(-1, 3).astype(np.uint32),
        normals,
        uv,
        attributes=attributes,
    )


def _leaf(scene_object: SceneObject, bsdf: Any) -> Any:
    emitter = (
        None
        if scene_object.emitter is None
        else _load(scene_object.emitter, f"emitter of object {scene_object.name!r}")
    )
    if isinstance(scene_object.shape, Mesh):
        return mitsuba_mesh(
            scene_object.name,
            scene_object.shape,
            scene_object.world_from_object,
            bsdf,
            emitter,
        )
    plugin = _placed_plugin(scene_object.shape, scene_object.world_from_object)
    plugin["bsdf"] = bsdf
    if emitter is not None:
        plugin["emitter"] = emitter
    return _load(plugin, f"shape of object {scene_object.name!r}")


def _placed_plugin(shape: Plugin, world_from_object: Float) -> dict[str, Any]:
    """An analytic shape with its `to_world`, where it may have a pose and a place of its own in the object.

    All that moves it is multiplied in float64: Mitsuba would do so in float32.
    """
    placed = dict(shape)
    place = np.eye(4)
    if "center" in placed:  # of a sphere
        place[:3, 3] = placed.pop("center")
    elif "p0" in placed:  # one end of a cylinder; the other one is at z = 1 by default
        place[:3, 3] = placed["p0"]
        end = np.asarray(placed.get("p1", (0.0, 0.0, 1.0)), dtype=np.float64)
        placed |= {"p0": [0.0, 0.0, 0.0], "p1": (end - place[:3, 3]).tolist()}
    object_from_shape = np.asarray(shape.get("to_world", np.eye(4)), dtype=np.float64)
    placed["to_world"] = world_from_object @ object_from_shape @ place
    return placed


def mitsuba_mesh(
    name: str, mesh: Mesh, world_from_object: Float, bsdf: Any, emitter: Any
) -> Any:
    """A Mitsuba mesh in world coordinates, transformed in float64."""
    mi = mitsuba()
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    if emitter is not None:
        properties["emitter"] = emitter
    made = mi.Mesh(
        name,
        vertex_count=len(mesh.vertices),
        face_count=len(mesh.faces),
        has_vertex_normals=mesh.normals is not None,
        has_vertex_texcoords=mesh.uv is not None,
        props=properties,
    )
    buffers = mi.traverse(made)
    for name_, values in _mesh_buffers(mesh, world_from_object).items():
        buffers[name_] = values
    if mesh.uv is not None:
        buffers["vertex_texcoords"] = aligned(_flat32(mesh.uv))
    for key, values in mesh.attributes.items():
        made.add_attribute(key, values.shape[1], _flat32(values))
    buffers.update()
    return made


def _mesh_buffers(mesh: Mesh, world_from_object: Float) -> dict[str, NDArray[Any]]:
    """The buffers of a Mitsuba mesh that depend on its pose."""
    faces = np.asarray(mesh.faces, dtype=np.uint32)
    if np.linalg.det(world_from_object[:3, :3]) < 0:
        faces = faces[:, ::-1]  # keeps the orientation of a mirrored mesh
    placed = transformed(mesh, world_from_object)
    buffers: dict[str, NDArray[Any]] = {
        "vertex_positions": _flat32(placed.vertices),
        "faces": np.ascontiguousarray(faces).ravel(),
    }
    if placed.normals is not None:
        buffers["vertex_normals"] = _flat32(placed.normals)
    return buffers


def _flat32(values: Float) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32).ravel()


def mitsuba_value(value: Any, textures: dict[int, Any] | None = None) -> Any:
    """A plugin tree with the values of `twinlens.scenes` converted to Mitsuba's. A Bitmap used twice is one texture."""
    mi, textures = mitsuba(), {} if textures is None else textures
    if isinstance(value, Color):
        return {"type": "rgb", "value": list(value.rgb)}
    if isinstance(value, Bitmap):
        if id(value) not in textures:
            textures[id(value)] = mi.load_dict(_bitmap(value))
        return textures[id(value)]
    if isinstance(value, np.ndarray) and value.shape == (4, 4):
        return mi.ScalarTransform4f(value)
    if isinstance(value, Mapping):
        is_sky = value.get("type") == "envmap"  # takes a bitmap, not a texture plugin
        return {
            key: mi.Bitmap(np.ascontiguousarray(part.pixels, dtype=np.float32))
            if is_sky and isinstance(part, Bitmap)
            else mitsuba_value(part, textures)
            for key, part in value.items()
            if key != "nir"
        }
    if isinstance(value, str) and value.lower().endswith(".exr"):
        _need_two_threads()
    return value


def _bitmap(texture: Bitmap) -> dict[str, Any]:
    mi = mitsuba()
    upside = np.ascontiguousarray(
        texture.pixels[::-1], dtype=np.float32
    )  # Mitsuba's row 0 is v = 0
    to_uv = np.asarray(texture.to_uv)[np.ix_([0, 1, 3], [0, 1, 3])]
    bitmap = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(upside),
        "raw": True,
        "filter_type": texture.filter,
    }
    if isinstance(texture.wrap, str):
        placed = {"wrap_mode": texture.wrap, "to_uv": mi.ScalarTransform3f(to_uv)}
        return {**bitmap, **placed}
    u, v = texture.wrap
    repeating = {**bitmap, "wrap_mode": "repeat"}
    return {
        "type": "wrapped",
        "texture": repeating,
        "wrap_u": u,
        "wrap_v": v,
        "u_row": to_uv[0].tolist(),
        "v_row": to_uv[1].tolist(),
    }


def _load(plugin: Plugin, what: str) -> Any:
    with _input_errors(f"{what}: Mitsuba rejects {plugin.get('type')!r}"):
        return mitsuba().load_dict(mitsuba_value(plugin), optimize=False)


@contextlib.contextmanager
def _input_errors(message: str) -> Iterator[None]:
    try:
        yield
    except BackendError:
        raise  # a RuntimeError too, and not about the input
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].strip()
        remedies = [remedy for part, remedy in _REMEDIES.items() if part in reason]
        raise InputError("; ".join([f"{message}: {reason}", *remedies])) from error


_REMEDIES = {
    "Only materials without a transmission component": (
        "'twosided' takes no mask and no glass: put it below the mask, and leave it out for glass, which has two sides"
    )
}
"""What to do about an error of Mitsuba."""


_SCALES = {"scale", "sun_scale", "sky_scale"}
_EMISSION = {
    ".".join(parts)
    for parts in itertools.product(
        ("radiance", "intensity", "irradiance"), ("value", "data", "scale")
    )
}


def _scale_light(mi_scene: Any, factor: float) -> None:
    """Multiply what all emitters of a scene emit. Raises InputError where a texture of one has another use."""
    import drjit as dr

    traverse = mitsuba().traverse
    bsdfs = dict.fromkeys(shape.bsdf() for shape in mi_scene.shapes())
    used = set()
    for bsdf in bsdfs:
        if bsdf is not None:
            used.update(traverse(bsdf).hierarchy)
    for emitter in mi_scene.emitters():
        parameters = traverse(emitter)
        keys = _SCALES.intersection(parameters.keys()) or _EMISSION.intersection(
            parameters.keys()
        )
        if not keys or any(dr.is_integral_v(parameters[key]) for key in keys):
            what = (
                "light with a picture of 8 bits"
                if keys
                else f"light of type {type(emitter).__name__}"
            )
            raise InputError(
                f"ambient cannot scale a {what}; give it a colour or a picture in .exr"
            )
        if not used.isdisjoint(parameters.hierarchy):
            raise InputError(
                "ambient cannot scale a light whose picture has another use; give it one of its own"
            )
        used.update(parameters.hierarchy)
        for key in keys:
            parameters[key] = parameters[key] * factor
        parameters.update()


def _build_xml(scene: Scene, frame: SceneFrame) -> BuiltScene:
    """A checked Mitsuba file: ids in the order of its shapes, materials by their names."""
    _need_two_threads()
    assert scene.xml is not None
    root, _ = checked_xml(scene.xml)
    if frame != WORLD:
        frame = place(root, frame)
    text = ElementTree.tostring(root, encoding="unicode")
    with _input_errors(f"{scene.xml}: Mitsuba rejects it"):
        mi_scene = mitsuba().load_string(text, optimize=False)
    if frame.scale != 1:
        scale_lights(mi_scene, frame.scale)
    integrator = mi_scene.integrator()
    mi_scene, parts = _parts_of_file(scene, mi_scene)
    bodies, names, materials = _bodies_of_file(mi_scene)
    sky_visible = scene.sky is None or scene.sky.visible
    if integrator is None:
        integrator = _load(scene.integrator, "integrator")
    return BuiltScene(
        name=str(scene.xml),
        frame=frame,
        mi_scene=mi_scene,
        integrator=integrator,
        path=None,
        sky_visible=sky_visible,
        bodies=bodies,
        object_names=names,
        material_names=materials,
        parts=parts,
    )


def _parts_of_file(scene: Scene, mi_scene: Any) -> tuple[Any, dict[str, Any] | None]:
    """The scene of a Mitsuba file, lit by the sky if it has one, and its parts, from which others are made.

    There are no parts of a file with instances: Mitsuba does not expose the shapes that these place.
    """
    has_instances = any(shape.shape_type() == _INSTANCE for shape in mi_scene.shapes())
    if has_instances and scene.sky is not None:
        raise InputError(
            f"{scene.xml}: has instances; a sky can light only Mitsuba files without any"
        )
    if has_instances:
        return mi_scene, None
    parts = {f"object{i:04d}": shape for i, shape in enumerate(mi_scene.shapes())}
    parts["type"] = "scene"
    if scene.sky is not None:
        parts["sky"] = _load(scene.sky.plugin(), "sky")
        return mitsuba().load_dict(parts, optimize=False), parts
    # The lights of surfaces come with their shapes.
    on_surface = int(mitsuba().EmitterFlags.Surface)
    lights = [
        light for light in mi_scene.emitters() if not int(light.flags()) & on_surface
    ]
    parts |= {f"light{i:04d}": light for i, light in enumerate(lights)}
    return mi_scene, parts


def _bodies_of_file(
    mi_scene: Any,
) -> tuple[list[Body], tuple[str, ...], tuple[str, ...]]:
    """The bodies of a Mitsuba file, and the names of its objects and materials, in the order of its shapes."""
    bodies: list[Body] = []
    names: list[str] = []
    materials: dict[str, int] = {}
    for number, shape in enumerate(mi_scene.shapes(), start=1):
        name = shape.id() or f"shape{number}"
        bsdf = shape.bsdf()
        material = materials.setdefault(
            bsdf.id() or f"material of {name}", len(materials) + 1
        )
        if shape.shape_type() == _INSTANCE:
            # Mitsuba exposes neither the shape nor the material of an instance.
            body = Body(number, material, 0, shape=None, instance=shape)
        else:
            body = Body(number, material, material_kind(bsdf), shape)
        bodies.append(body)
        names.append(name)
    return bodies, tuple(names), tuple(materials)
