"""Objects of a scene file: a shape with its parameters, a material, a placement, and optionally a light and copies."""

import itertools
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
import pydantic

from twinlens.errors import InputError, counted
from twinlens.scenes import shapes
from twinlens.scenes.assets import (
    MESH_FILES,
    MOST_FACES,
    Asset,
    SceneContext,
    read_mesh,
)
from twinlens.scenes.model_files import (
    HAVE_MATERIALS_ALONE,
    WITH_MATERIALS,
    Model,
    read_model,
)
from twinlens.scenes.placement import (
    Coordinate,
    Copies,
    CopyGrid,
    Length,
    Placement,
    Scale,
    Vector2,
    Vector3,
    rotation,
)
from twinlens.scenes.plugins import AreaLight
from twinlens.scenes.scene import Mesh, Plugin, SceneObject
from twinlens.scenes.texture_tables import TextureMap
from twinlens.schema import Positive, exactly, number, tagged, variants, whole

_SIDES = whole(3, 4096) | None
_GRID_SIDE = Annotated[int, pydantic.Field(ge=2, le=2049)]
_POINTS = pydantic.Field(min_length=2, max_length=100_000)
Area = Annotated[list[Length], exactly(2, Length)]


class ObjectBase(Placement):
    """Keys of every object."""

    material: str
    emitter: AreaLight | None = None
    instances: Copies | None = None
    merge: bool = False

    def build(self, context: SceneContext) -> SceneObject:
        """The object of the scene, without a name. Raises InputError for combinations of keys that are not possible."""
        mesh, material = self.looks(context)
        pose, instances = self.world_from_object(), self.instances or ()
        copies = (
            instances.poses()
            if isinstance(instances, CopyGrid)
            else tuple(copy.world_from_object() for copy in instances)
        )
        scene_object = SceneObject("", mesh, material, pose, self.emitter, copies)
        if copies and self.emitter is not None:
            raise InputError(
                "an object with instances cannot have an emitter; make each light an object"
            )
        if not self.merge:
            return scene_object
        if not isinstance(mesh, Mesh) or not copies:
            raise InputError(
                "'merge' joins the instances of a mesh; this object is no mesh or has no instances"
            )
        if len(mesh.faces) * len(copies) > MOST_FACES:
            raise InputError(
                f"'merge' makes more than {MOST_FACES} triangles; keep the instances apart"
            )
        merged = shapes.merged(
            [shapes.transformed(mesh, copy @ pose) for copy in copies]
        )
        return replace(
            scene_object,
            shape=merged,
            world_from_object=np.eye(4),
            instances=(),
            merged=True,
        )

    def looks(
        self, context: SceneContext
    ) -> tuple[Mesh | Plugin, str | tuple[str, ...]]:
        """The shape in the object's own coordinates, and the names of its materials."""
        return self.geometry(), self.material

    def geometry(self) -> Mesh | Plugin:
        """The shape in the object's own coordinates."""
        raise NotImplementedError


class AnalyticBase(ObjectBase):
    """A shape that Mitsuba intersects exactly, under Mitsuba's parameter names."""

    flip_normals: bool = False

    def geometry(self) -> Plugin:
        keys = self.model_fields_set - ObjectBase.model_fields.keys() - {"shape"}
        kind = self.shape  # type: ignore[attr-defined]  # every shape has one
        return {"type": kind, **{key: value for key, value in self if key in keys}}


class MeshBase(ObjectBase):
    """A mesh. Its texture coordinates are multiplied by `uv_scale`, then `uv_offset` is added."""

    uv_scale: Annotated[list[Positive], exactly(2, Positive, or_one=True)] | None = None
    uv_offset: Vector2 | None = None

    def geometry(self) -> Mesh:
        return self.mapped(self.mesh())

    def mapped(self, mesh: Mesh) -> Mesh:
        """`mesh` with its texture coordinates scaled and moved."""
        if self.uv_scale is None and self.uv_offset is None:
            return mesh
        if mesh.uv is None:
            raise InputError(
                "'uv_scale' and 'uv_offset' need a mesh with texture coordinates"
            )
        return replace(
            mesh,
            uv=mesh.uv * (self.uv_scale or [1.0, 1.0]) + (self.uv_offset or [0.0, 0.0]),
        )

    def mesh(self) -> Mesh:
        """The mesh from the keys that were given, by a function of `twinlens.scenes.shapes`, or else by trimesh's."""
        kind = self.shape  # type: ignore[attr-defined]  # every mesh but one of a file has one
        keys = self.model_fields_set - MeshBase.model_fields.keys() - {"shape"}
        name = "cylinder" if kind == "solid_cylinder" else kind
        made: Mesh = getattr(shapes, name, partial(shapes.creation, name))(
            **{key: getattr(self, key) for key in keys}
        )
        return made

    @pydantic.model_validator(mode="after")
    def _check_measures(self) -> "MeshBase":
        values = vars(self)
        for less, more in (("r_min", "r_max"), ("minor_radius", "major_radius")):
            if less in values and values[less] >= values[more]:
                raise InputError(f"{less} must be less than {more}")
        if values.get("shape") == "rounded_box" and values["radius"] > 0.5 * min(
            values["extents"]
        ):
            raise InputError(
                f"radius must be at most half the shortest side, got {values['radius']:g}"
            )
        if "profile" in values and min(radius for radius, _ in values["profile"]) < 0:
            raise InputError("profile: radii must be >= 0")
        if "profile" in values and all(
            point == values["profile"][0] for point in values["profile"]
        ):
            raise InputError("profile: needs two different points")
        if values.get("shape") == "tube":
            points, radius = values["points"], values["radius"]
            if isinstance(radius, list) and len(radius) != len(points):
                raise InputError(
                    f"radius: needs one value for each of {counted(len(points), 'point')}, got {len(radius)}"
                )
            if any(a == b for a, b in itertools.pairwise(points)):
                raise InputError("points: two neighbours are equal")
        return self


class MeshFile(MeshBase):
    """A .ply, .stl, .obj, .glb or .gltf file, with its own materials unless `material` is given.

    Edges over `crease_deg` stay sharp; `face_normals` makes all of them sharp. `up_axis` is that of the file: "y" in
    glTF, else "z".
    """

    file: Asset
    material: str = ""
    face_normals: bool = False
    crease_deg: (
        Annotated[float, pydantic.Field(ge=0, le=180), pydantic.AfterValidator(float)]
        | None
    ) = None
    up_axis: Literal["y", "z"] | None = None

    @pydantic.model_validator(mode="after")
    def _check_file(self) -> "MeshFile":
        suffix = self.file.suffix.lower()
        if suffix not in MESH_FILES:
            raise InputError(
                f"file: meshes may be {', '.join(sorted(MESH_FILES))}, got {self.file.name!r}"
            )
        if not self.material and suffix not in WITH_MATERIALS:
            raise InputError(
                f"missing key 'material'; only {', '.join(WITH_MATERIALS)} files have materials"
            )
        return self

    def looks(
        self, context: SceneContext
    ) -> tuple[Mesh | Plugin, str | tuple[str, ...]]:
        suffix = self.file.suffix.lower()
        crease_deg = 0.0 if self.face_normals else self.crease_deg
        key = self.file, crease_deg, not self.material
        if key not in context.models:
            context.models[key] = (
                read_model(
                    self.file, context, crease_deg, with_materials=not self.material
                )
                if suffix in HAVE_MATERIALS_ALONE or not self.material
                else Model(read_mesh(self.file, crease_deg), {})
            )
        model: Model = context.models[key]
        context.materials.update(model.materials)
        mesh = self.mapped(model.mesh)
        if (self.up_axis or model.up_axis) == "y":
            mesh = shapes.transformed(mesh, rotation([1.0, 0.0, 0.0], 90.0))
        return mesh, self.material or tuple(model.materials)


_FLIP = {"flip_normals": bool | None}
ANALYTIC_SHAPES: dict[str, dict[str, Any]] = {
    "sphere": {"center": Vector3 | None, "radius": Length | None, **_FLIP},
    "cylinder": {
        "p0": Vector3 | None,
        "p1": Vector3 | None,
        "radius": Length | None,
        **_FLIP,
    },
    **dict.fromkeys(("rectangle", "disk", "cube"), _FLIP),
}
_ROUND = {"radius": Length, "height": Length, "sections": _SIDES}
_BOX = {"extents": Scale, "tile": Length | None}
_GRID = Annotated[list[_GRID_SIDE], exactly(2, _GRID_SIDE)] | None
MESH_SHAPES: dict[str, dict[str, Any]] = {
    "box": _BOX,
    "rounded_box": {**_BOX, "radius": Length, "subdivisions": whole(1, 64) | None},
    "icosphere": {"radius": Length | None, "subdivisions": whole(0, 7) | None},
    "uv_sphere": {"radius": Length | None},
    "icosahedron": {},
    "capsule": {"radius": Length | None, "height": Length | None},
    "solid_cylinder": _ROUND,
    "cone": _ROUND,
    "annulus": {"r_min": Length, "r_max": Length, "height": Length, "sections": _SIDES},
    "torus": {
        **dict.fromkeys(("major_radius", "minor_radius"), Length),
        **dict.fromkeys(("major_sections", "minor_sections"), _SIDES),
    },
    "lathe": {
        "profile": Annotated[list[Vector2], _POINTS],
        "segments": _SIDES,
        "smooth": bool | None,
        "samples": whole(1, 64) | None,
    },
    "tube": {
        "points": Annotated[list[Vector3], _POINTS],
        "radius": Length | list[Length],
        "sides": _SIDES,
        "smooth": bool | None,
        "closed": bool | None,
    },
    "height_field": {
        "extents": Area,
        "height": TextureMap,
        "amplitude": Coordinate,
        "grid": _GRID,
    },
    "bent_sheet": {
        "extents": Area,
        "angle_deg": number(0.1, 360),
        "segments": whole(1, 4096) | None,
    },
}


_VARIANTS = [
    *variants(AnalyticBase, "shape", ANALYTIC_SHAPES),
    *variants(MeshBase, "shape", MESH_SHAPES),
]
_SHAPE_OBJECT = tagged("ShapeObject", "shape", _VARIANTS)
_ADAPTER: pydantic.TypeAdapter[ObjectBase] = pydantic.TypeAdapter(_SHAPE_OBJECT)


def _read_table(value: Any, info: Any) -> ObjectBase:
    if isinstance(value, Mapping) and ("file" in value) == ("shape" in value):
        raise InputError(
            "needs exactly one of 'shape' (a name) and 'file' (a mesh file)"
        )
    if isinstance(value, Mapping) and "file" in value:
        return MeshFile.model_validate(value, context=info.context)
    return _ADAPTER.validate_python(value, context=info.context)


_TABLE: Any = _SHAPE_OBJECT | MeshFile
ObjectTable = Annotated[
    ObjectBase, pydantic.PlainValidator(_read_table, json_schema_input_type=_TABLE)
]
"""The keys of an object, checked; files are found but not read before `ObjectBase.build`."""
Object = Annotated[
    SceneObject,
    pydantic.PlainValidator(
        lambda value, info: _read_table(value, info).build(info.context),
        json_schema_input_type=_TABLE,
    ),
]
"""An entry of [objects]; its name is set where the file is read."""
