"""Objects of a scene file: a shape with its parameters, a material, a placement, and optionally a light and copies."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

import annotated_types
import numpy as np
import pydantic

from twinlens.errors import InputError
from twinlens.scenes import shapes
from twinlens.scenes.assets import MOST_FACES, Asset, read_mesh
from twinlens.scenes.placement import Copies, Placement, Scale, Vector2, Vector3, copy_poses
from twinlens.scenes.plugins import AreaLight
from twinlens.scenes.scene import Bitmap, Mesh, Plugin, SceneObject, check_uniform_scale
from twinlens.scenes.texture_tables import TextureMap
from twinlens.schema import Number, Positive, repeated, tagged, variants


def _whole(low: int, high: int) -> Any:
    return Annotated[int, pydantic.Field(ge=low, le=high)]


_SIDES = _whole(3, 4096) | None
_GRID_SIDE = Annotated[int, pydantic.Field(ge=2, le=2049)]
Area = Annotated[list[Positive], annotated_types.Len(2, 2)]
_POINTS = annotated_types.Len(2, 100_000)


class ObjectBase(Placement):
    """Keys of every object."""

    material: str
    emitter: AreaLight | None = None
    instances: Copies | None = None
    merge: bool = False

    def build(self, name: str) -> SceneObject:
        """The object of the scene. Raises InputError for combinations of keys that are not possible."""
        thing = SceneObject(
            name=name,
            shape=self.geometry(),
            material=self.material,
            world_from_object=self.world_from_object(),
            emitter=self.emitter,
            instances=copy_poses(self.instances),
        )
        check_uniform_scale(thing)
        if thing.instances and thing.emitter is not None:
            raise InputError("an object with instances cannot have an emitter; make each light an object")
        return _merged(thing) if self.merge else thing

    def geometry(self) -> Mesh | Plugin:
        """The shape in the object's own coordinates."""
        raise NotImplementedError


def _merged(thing: SceneObject) -> SceneObject:
    """The object's copies as one mesh with one id, for grass and gravel."""
    mesh = thing.shape
    if not isinstance(mesh, Mesh) or not thing.instances:
        raise InputError("'merge' joins the instances of a mesh; this object is no mesh or has no instances")
    if len(mesh.faces) * len(thing.instances) > MOST_FACES:
        raise InputError(f"'merge' makes more than {MOST_FACES} triangles; keep the instances apart")
    copies = [shapes.transformed(mesh, copy @ thing.world_from_object) for copy in thing.instances]
    return replace(thing, shape=shapes.merged(copies), world_from_object=np.eye(4), instances=())


class AnalyticBase(ObjectBase):
    """A shape that Mitsuba intersects exactly, under Mitsuba's parameter names."""

    flip_normals: bool = False

    def geometry(self) -> Plugin:
        given = self.model_fields_set - ObjectBase.model_fields.keys() - {"shape"}
        parameters = {key: getattr(self, key) for key in type(self).model_fields if key in given}
        return {"type": self.shape} | parameters  # type: ignore[attr-defined]  # every shape has one


class MeshBase(ObjectBase):
    """A mesh. Its texture coordinates are multiplied by `uv_scale`, then `uv_offset` is added."""

    uv_scale: Annotated[list[Positive], annotated_types.Len(2, 2), repeated(2, Positive)] | None = None
    uv_offset: Vector2 | None = None

    def geometry(self) -> Mesh:
        mesh = self.mesh()
        if self.uv_scale is None and self.uv_offset is None:
            return mesh
        if mesh.uv is None:
            raise InputError("'uv_scale' and 'uv_offset' need a mesh with texture coordinates")
        return replace(mesh, uv=mesh.uv * (self.uv_scale or [1.0, 1.0]) + (self.uv_offset or [0.0, 0.0]))

    def mesh(self) -> Mesh:
        """The mesh from the keys that were given, by the function of `_MAKERS`, or else by trimesh's creation."""
        kind = self.shape  # type: ignore[attr-defined]  # every mesh but one of a file has one
        given = self.model_fields_set - MeshBase.model_fields.keys() - {"shape"}
        return _MAKERS.get(kind, partial(shapes.creation, kind))(**{key: getattr(self, key) for key in given})

    @pydantic.model_validator(mode="after")
    def _check_shape(self) -> "MeshBase":
        _check_measures(vars(self))
        return self


def _check_measures(given: Mapping[str, Any]) -> None:
    """Checks that need more than one key, of all the mesh shapes."""
    for less, more in (("r_min", "r_max"), ("minor_radius", "major_radius")):
        if less in given and given[less] >= given[more]:
            raise InputError(f"{less} must be less than {more}")
    if given.get("shape") == "rounded_box" and given["radius"] > 0.5 * min(given["extents"]):
        raise InputError(f"radius must be at most half the shortest side, got {given['radius']:g}")
    if "profile" in given and min(radius for radius, _ in given["profile"]) < 0:
        raise InputError("profile: radii must be >= 0")
    if "profile" in given and all(point == given["profile"][0] for point in given["profile"]):
        raise InputError("profile: needs two different points")
    if given.get("shape") == "tube":
        points, radius = given["points"], given["radius"]
        if isinstance(radius, list) and len(radius) != len(points):
            raise InputError(f"radius: needs one value for each of the {len(points)} points, got {len(radius)}")
        if any(a == b for a, b in itertools.pairwise(points)):
            raise InputError("points: two neighbours are equal")


class MeshFile(MeshBase):
    """A .ply, .obj, .glb or .stl file. Edges over `crease_deg` stay sharp; `face_normals` makes all of them sharp."""

    file: Asset
    face_normals: bool = False
    crease_deg: Annotated[Number, pydantic.Field(ge=0, le=180)] = 30.0

    def mesh(self) -> Mesh:
        return read_mesh(self.file, 0.0 if self.face_normals else self.crease_deg)


_ANALYTIC: dict[str, dict[str, Any]] = {
    "sphere": {"center": Vector3 | None, "radius": Positive | None},
    "cylinder": {"p0": Vector3 | None, "p1": Vector3 | None, "radius": Positive | None},
    "rectangle": {},
    "disk": {},
    "cube": {},
}
ANALYTIC_SHAPES = {name: {**keys, "flip_normals": bool | None} for name, keys in _ANALYTIC.items()}
MESH_SHAPES: dict[str, dict[str, Any]] = {
    "box": {"extents": Scale, "tile": Positive | None},
    "rounded_box": {
        "extents": Scale,
        "radius": Positive,
        "subdivisions": _whole(1, 64) | None,
        "tile": Positive | None,
    },
    "icosphere": {"radius": Positive | None, "subdivisions": _whole(0, 7) | None},
    "uv_sphere": {"radius": Positive | None},
    "icosahedron": {},
    "capsule": {"radius": Positive | None, "height": Positive | None},
    "solid_cylinder": {"radius": Positive, "height": Positive, "sections": _SIDES},
    "cone": {"radius": Positive, "height": Positive, "sections": _SIDES},
    "annulus": {"r_min": Positive, "r_max": Positive, "height": Positive, "sections": _SIDES},
    "torus": {
        "major_radius": Positive,
        "minor_radius": Positive,
        "major_sections": _SIDES,
        "minor_sections": _SIDES,
    },
    "lathe": {
        "profile": Annotated[list[Vector2], _POINTS],
        "segments": _SIDES,
        "smooth": bool | None,
        "samples": _whole(1, 64) | None,
    },
    "tube": {
        "points": Annotated[list[Vector3], _POINTS],
        "radius": Positive | list[Positive],
        "sides": _SIDES,
        "smooth": bool | None,
        "closed": bool | None,
    },
    "height_field": {
        "extents": Area,
        "height": TextureMap,
        "amplitude": Number,
        "grid": Annotated[list[_GRID_SIDE], annotated_types.Len(2, 2)] | None,
    },
    "bent_sheet": {
        "extents": Area,
        "angle_deg": Annotated[Number, pydantic.Field(ge=0.1, le=360)],
        "segments": _whole(1, 4096) | None,
    },
}


def _height_field(extents: list[float], height: Bitmap, amplitude: float, grid: list[int] | None = None) -> Mesh:
    heights = height.pixels if height.pixels.ndim == 2 else height.pixels.mean(axis=2)
    rows, columns = heights.shape
    nx, ny = grid or (min(columns, 257), min(rows, 257))
    picked = heights[np.linspace(0, rows - 1, ny).astype(int)][:, np.linspace(0, columns - 1, nx).astype(int)]
    return shapes.height_field(np.array(extents), amplitude * picked)


_MAKERS: dict[str, Callable[..., Mesh]] = {
    "solid_cylinder": partial(shapes.creation, "cylinder"),
    "height_field": _height_field,
    **{name: getattr(shapes, name) for name in ("box", "rounded_box", "cone", "lathe", "tube", "bent_sheet")},
}
"""The functions that make meshes; other shapes are trimesh's."""

_SHAPE_OBJECT = tagged(
    "shape", [*variants(AnalyticBase, "shape", ANALYTIC_SHAPES), *variants(MeshBase, "shape", MESH_SHAPES)]
)
_ADAPTER: pydantic.TypeAdapter[ObjectBase] = pydantic.TypeAdapter(_SHAPE_OBJECT)


def _read_object(value: Any, info: Any) -> SceneObject:
    given = value if isinstance(value, Mapping) else {}
    if value == given and ("file" in given) == ("shape" in given):
        raise InputError("needs exactly one of 'shape' (a name) and 'file' (a mesh file)")
    if "file" in given:
        return MeshFile.model_validate(value, context=info.context).build("")
    return _ADAPTER.validate_python(value, context=info.context).build("")


Object = Annotated[SceneObject, pydantic.PlainValidator(_read_object, json_schema_input_type=_SHAPE_OBJECT | MeshFile)]
"""An entry of [objects]; its name is set where the file is read."""
