"""USD files (.usd, .usda, .usdc, .usdz): meshes and materials of UsdPreviewSurface, by usd-core.

The stage is read at its earliest time, in metres, with its own up axis. Source: OpenUSD's documentation of UsdGeom and
UsdShade, and the UsdPreviewSurface proposal, version 2.6.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import FileError, InputError, counted
from twinlens.geometry import Float
from twinlens.scenes.assets import check_face_count, no_triangles
from twinlens.scenes.gltf import Part
from twinlens.scenes.materials import Color, Material
from twinlens.scenes.polygons import triangulated
from twinlens.scenes.usd_layers import Find, UsdFiles
from twinlens.scenes.usd_materials import Surfaces

_MOST_PRIMS = 200_000
_SIDES = 64  # of round shapes
_AXES = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}
"""Where x, y, z come from for a shape around z that is turned to an axis."""
_SILENT = {
    *("", "Xform", "Scope", "Material", "Shader", "NodeGraph", "GeomSubset"),
    *("Mesh", "Cube", "Sphere", "Cylinder", "Cone", "Capsule", "Skeleton", "SkelRoot"),
    "PointInstancer",
}
"""Types of prims that are read, or that only group others."""
_LIGHTS = (
    "Distant",
    "Dome",
    "Rect",
    "Sphere",
    "Disk",
    "Cylinder",
    "Geometry",
    "Portal",
)
_NAMED = {
    "Camera": "cameras (those of the scene)",
    "SkelAnimation": "skins (the mesh as it is stored)",
    **{f"{kind}Light": "lights (those of the scene)" for kind in _LIGHTS},
}


@dataclass(eq=False)
class UsdModel:
    """The parts of a stage, the material that each is numbered by, and what is not rendered.

    up_axis : "y" or "z".
    """

    parts: list[Part]
    names: list[str]
    materials: list[Material]
    up_axis: str
    lost: list[str] = field(default_factory=list)


def read_stage(
    path: Path,
    find: Find,
    allow: Callable[[int], None],
    with_materials: bool = True,
) -> UsdModel:
    """The meshes of a USD file, read in this process. Raises FileError.

    allow: called with the size in bytes of each layer before it is opened, and of each picture once it is decoded.

    usd-core may crash or run forever on a damaged file; `usd_process.open_usd` bounds that.
    """
    from pxr import Sdf, Usd, UsdGeom

    files = UsdFiles(path, Sdf, find, allow)
    stage = Usd.Stage.Open(str(path))
    if stage is None:
        raise FileError(f"{path}: not a USD file; is it complete?")
    reader = _Reader(stage, Surfaces(files), with_materials)
    parts = list(reader.parts())
    if not parts:
        raise no_triangles(path, reader.lost)
    up_axis = str(UsdGeom.GetStageUpAxis(stage)).lower()
    surfaces = reader.surfaces
    lost = [*reader.lost, *surfaces.lost]
    return UsdModel(parts, surfaces.names, surfaces.materials, up_axis, lost)


class _Reader:
    def __init__(self, stage: Any, surfaces: Surfaces, with_materials: bool) -> None:
        from pxr import Usd, UsdGeom

        self.stage = stage
        self.surfaces = surfaces
        self.lost: list[str] = []
        self._with_materials = with_materials
        self._time = Usd.TimeCode.EarliestTime()
        self._poses = UsdGeom.XformCache(self._time)
        self._metres = float(UsdGeom.GetStageMetersPerUnit(stage))
        self._faces = 0
        self._prims = 0

    def parts(self) -> Iterator[Part]:
        """The parts of all visible prims of the purposes default and render."""
        from pxr import Usd

        root = self.stage.GetPseudoRoot()
        return self._below(root, Usd.PrimDefaultPredicate, in_prototype=False)

    def _below(self, root: Any, chosen: Any, in_prototype: bool) -> Iterator[Part]:
        """The parts of a prim and of those below it that a predicate of USD chooses."""
        from pxr import Usd, UsdGeom

        prims = iter(Usd.PrimRange(root, Usd.TraverseInstanceProxies(chosen)))
        for prim in prims:
            self._prims += 1
            if self._prims > _MOST_PRIMS:
                raise InputError(f"has more than {_MOST_PRIMS} prims")
            imageable = UsdGeom.Imageable(prim)
            if not imageable:
                self._name(prim)
                continue
            is_hidden = imageable.ComputeVisibility(self._time) == "invisible"
            if is_hidden or imageable.ComputePurpose() in ("guide", "proxy"):
                prims.PruneChildren()
                continue
            self._name(prim)
            if prim.IsA(UsdGeom.PointInstancer):
                # The prims below are its prototypes, which have no place of their own.
                prims.PruneChildren()
                if in_prototype:
                    self.lost.append("a PointInstancer below another (left out)")
                else:
                    yield from self._copies(UsdGeom.PointInstancer(prim))
                continue
            yield from self._parts_of(prim)

    def _copies(self, instancer: Any) -> Iterator[Part]:
        """The parts of all prototypes of a PointInstancer, at each of its points."""
        from pxr import Usd

        world_from_copies, of_prototype = self._copy_poses(instancer)
        prototypes = instancer.GetPrototypesRel().GetTargets()
        # Prototypes may be prims that no traversal of the stage finds: those without a definition.
        chosen = Usd.PrimIsActive & Usd.PrimIsLoaded & ~Usd.PrimIsAbstract
        for number, path in enumerate(prototypes):
            root = self.stage.GetPrimAtPath(path)
            poses = world_from_copies[of_prototype == number]
            if not root or not len(poses):
                continue
            world_from_root = self._pose(root)
            if np.linalg.matrix_rank(world_from_root) < 4:
                raise InputError(f"{path}: a prototype needs a pose with an inverse")
            root_from_world = np.linalg.inv(world_from_root)
            for part in self._below(root, chosen, in_prototype=True):
                self._count(len(part.mesh.faces) * (len(poses) - 1))
                for world_from_copy in poses:
                    pose = world_from_copy @ root_from_world @ part.pose
                    yield replace(part, pose=pose)

    def _copy_poses(self, instancer: Any) -> tuple[Float, NDArray[np.int64]]:
        """world_from_copy (N, 4, 4) in metres of the visible points of a PointInstancer, and their prototypes (N,)."""
        where = str(instancer.GetPath())
        of_prototype = _whole(instancer.GetProtoIndicesAttr().Get(self._time))
        if len(of_prototype) > _MOST_PRIMS:
            raise InputError(f"{where}: has more than {_MOST_PRIMS} points")
        count = len(instancer.GetPrototypesRel().GetTargets())
        if len(of_prototype) and not 0 <= of_prototype.min() <= of_prototype.max() < count:  # fmt: skip
            raise InputError(f"{where}: protoIndices has a prototype that is missing")
        with_own_pose, all_points = instancer.IncludeProtoXform, instancer.IgnoreMask
        stored = instancer.ComputeInstanceTransformsAtTime(
            self._time, self._time, with_own_pose, all_points
        )
        if len(stored) != len(of_prototype):
            raise InputError(f"{where}: positions do not fit protoIndices")
        # USD multiplies rows by matrices.
        copies = np.array(stored, dtype=np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        mask = np.array(instancer.ComputeMaskAtTime(self._time), dtype=bool)
        is_there = mask if len(mask) else np.ones(len(copies), dtype=bool)
        poses = self._pose(instancer.GetPrim()) @ copies[is_there]
        if not np.isfinite(poses).all():
            raise InputError(f"{where}: points have no finite pose")
        return poses, of_prototype[is_there]

    def _name(self, prim: Any) -> None:
        """Note a prim of a type that is not rendered."""
        kind = str(prim.GetTypeName())
        if kind not in _SILENT:
            self.lost.append(_NAMED.get(kind, f"{kind} (left out)"))

    def _parts_of(self, prim: Any) -> Iterator[Part]:
        from pxr import UsdGeom

        if prim.IsA(UsdGeom.Mesh):
            yield from self._mesh_parts(UsdGeom.Mesh(prim))
            return
        made = _shape(prim, self._time)
        if made is not None:
            self._count(len(made.faces))
            material, _ = self._material(prim, None)
            yield Part(made, self._pose(prim), material, False, None)

    def _count(self, faces: int) -> None:
        self._faces += faces
        check_face_count(self.surfaces.files.path, self._faces)

    def _pose(self, prim: Any) -> Float:
        """world_from_prim (4, 4) in metres; USD multiplies rows by matrices."""
        pose = np.array(self._poses.GetLocalToWorldTransform(prim), dtype=np.float64).T
        scaled = np.diag([self._metres] * 3 + [1.0]) @ pose
        if not np.isfinite(scaled).all():
            raise InputError(f"{prim.GetPath()} has no finite pose")
        return np.asarray(scaled)

    def _material(self, prim: Any, mesh: Any) -> tuple[int, str]:
        """The number of the material of a prim, and the primvar of its texture coordinates."""
        from pxr import UsdShade

        if not self._with_materials:
            return self.surfaces.plain(None, False), "st"
        bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if bound:
            return self.surfaces.of(bound)
        color = _uniform_color(mesh, self._time) if mesh is not None else None
        has_colors = mesh is not None and color is None and _has_colors(mesh)
        if mesh is not None and mesh.GetDisplayOpacityPrimvar().HasValue():
            self.lost.append("displayOpacity (opaque)")
        return self.surfaces.plain(color, has_colors), "st"

    def _mesh_parts(self, mesh: Any) -> Iterator[Part]:
        """One part for each material of a mesh."""
        from pxr import UsdShade

        prim = mesh.GetPrim()
        where = str(prim.GetPath())
        surface = _Polygons(mesh, self._time, where)
        self._count(surface.triangle_count)
        if mesh.GetSubdivisionSchemeAttr().Get() != "none":
            self.lost.append("subdivision (the control mesh)")
        if prim.HasAPI("SkelBindingAPI") and prim.HasAttribute(
            "primvars:skel:jointIndices"
        ):
            self.lost.append("skins (the mesh as it is stored)")
        pose = self._pose(prim)
        left = np.ones(surface.polygon_count, dtype=bool)
        groups: list[tuple[Any, NDArray[np.bool_]]] = []
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            indices = _whole(subset.GetIndicesAttr().Get(self._time))
            if len(indices) and not 0 <= indices.min() <= indices.max() < len(left):
                raise InputError(f"{where}: a subset has a face that does not exist")
            chosen = np.zeros_like(left)
            chosen[indices] = True
            groups.append((subset.GetPrim(), chosen & left))
            left &= ~chosen
        groups.append((prim, left))
        for owner, chosen in groups:
            if chosen.any():
                material, primvar = self._material(owner, mesh)
                yield from surface.part(chosen, pose, material, primvar, self.surfaces)


class _Polygons:
    """The polygons of a mesh as triangles of corners: numbers in the list of all corners of its faces."""

    def __init__(self, mesh: Any, time: Any, where: str) -> None:
        self.mesh, self._time, self._where = mesh, time, where
        points = _array(mesh.GetPointsAttr().Get(time), 3)
        counts = _whole(mesh.GetFaceVertexCountsAttr().Get(time))
        indices = _whole(mesh.GetFaceVertexIndicesAttr().Get(time))
        self._vertices = indices
        if not np.isfinite(points).all():
            raise InputError(f"{where}: points are not finite")
        is_whole = len(counts) == 0 or counts.min() >= 0
        if not is_whole or counts.sum() != len(indices):
            raise InputError(f"{where}: faceVertexCounts do not fit faceVertexIndices")
        if len(indices) and not 0 <= indices.min() <= indices.max() < len(points):
            raise InputError(f"{where}: a face refers to a point that does not exist")
        self.points = points
        self.polygon_count = len(counts)
        self.triangle_count = int(np.maximum(counts - 2, 0).sum())
        self._counts = counts
        holes = _whole(mesh.GetHoleIndicesAttr().Get(time))
        self._is_there = ~np.isin(np.arange(len(counts)), holes)

    @cached_property
    def _triangles(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The corners (T, 3) of all triangles, and the polygon (T,) of each. Made once their number is checked."""
        return triangulated(self._counts, self._vertices, self.points)

    def _chosen_triangles(
        self, chosen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """`_triangles` of the chosen polygons without holes, counter-clockwise as seen from outside."""
        corners, polygons = self._triangles
        kept = (chosen & self._is_there)[polygons]
        corners, polygons = corners[kept], polygons[kept]
        if self.mesh.GetOrientationAttr().Get() == "leftHanded":
            corners = corners[:, ::-1]
        return corners, polygons

    def part(
        self,
        chosen: NDArray[np.bool_],
        pose: Float,
        material: int,
        primvar: str,
        surfaces: Surfaces,
    ) -> Iterator[Part]:
        """The chosen polygons (P,) as a part, unless there are none."""
        import trimesh
        from trimesh.visual import TextureVisuals

        corners, polygons = self._chosen_triangles(chosen)
        if not len(corners):
            return
        flat, of_polygon = corners.ravel(), np.repeat(polygons, 3)
        uv = self._texture_coordinates(primvar, flat, of_polygon)
        if uv is None and surfaces.has_textures(material):
            raise InputError(
                f"{self._where}: its material {surfaces.names[material]!r} has textures, "
                f"but the mesh has no texture coordinates {primvar!r}"
            )
        normals = self._normals(flat, of_polygon)
        colors = None
        if surfaces.has_colors(material):
            colors = self._values("displayColor", 3, flat, of_polygon)
        # Corners that are equal in all of these become one vertex.
        columns = [self._vertices[flat][:, None].astype(np.float64)]
        columns += [values for values in (uv, normals, colors) if values is not None]
        first, numbers = _distinct_rows(np.hstack(columns))
        mesh = trimesh.Trimesh(
            self.points[self._vertices[flat[first]]],
            numbers.reshape(-1, 3),
            vertex_normals=None if normals is None else normals[first],
            visual=None if uv is None else TextureVisuals(uv=uv[first]),
            process=False,
            validate=False,
        )
        rgba = None if colors is None else _opaque(colors[first])
        yield Part(mesh, pose, material, normals is not None, rgba)

    def _texture_coordinates(
        self, primvar: str, corners: NDArray[np.int64], polygons: NDArray[np.int64]
    ) -> Float | None:
        """Texture coordinates of corners, by the name that the material reads, else by the usual one."""
        uv = self._values(primvar, 2, corners, polygons)
        if uv is None and primvar != "st":
            uv = self._values("st", 2, corners, polygons)
        return uv

    def _normals(
        self, corners: NDArray[np.int64], polygons: NDArray[np.int64]
    ) -> Float | None:
        """Normals of corners, those of a primvar before those of the attribute."""
        normals = self._values("normals", 3, corners, polygons)
        if normals is not None:
            return normals
        attribute = self.mesh.GetNormalsAttr()
        stored = _array(attribute.Get(self._time), 3)
        if not len(stored):
            return None
        kind = str(self.mesh.GetNormalsInterpolation())
        return self._at_corners("normals", stored, kind, corners, polygons)

    def _values(
        self,
        name: str,
        columns: int,
        corners: NDArray[np.int64],
        polygons: NDArray[np.int64],
    ) -> Float | None:
        """The values of a primvar at corners (C, columns), None without it."""
        from pxr import UsdGeom

        primvar = UsdGeom.PrimvarsAPI(self.mesh).FindPrimvarWithInheritance(name)
        if not primvar or not primvar.HasValue():
            return None
        stored = _array(primvar.ComputeFlattened(self._time), columns)
        if not len(stored):
            return None
        kind = str(primvar.GetInterpolation())
        return self._at_corners(name, stored, kind, corners, polygons)

    def _at_corners(
        self,
        name: str,
        stored: Float,
        interpolation: str,
        corners: NDArray[np.int64],
        polygons: NDArray[np.int64],
    ) -> Float:
        numbers = {
            "constant": np.zeros_like(corners),
            "uniform": polygons,
            "vertex": self._vertices[corners],
            "varying": self._vertices[corners],
            "faceVarying": corners,
        }.get(interpolation)
        if numbers is None or (len(numbers) and numbers.max() >= len(stored)):
            raise InputError(
                f"{self._where}: {name} has {counted(len(stored), 'value')}, too few for its interpolation "
                f"{interpolation}"
            )
        values = stored[numbers]
        if not np.isfinite(values).all():
            raise InputError(f"{self._where}: {name} is not finite")
        return np.asarray(values)


def _array(values: Any, columns: int) -> Float:
    """Numbers (N, columns) of an attribute, of which there are none without a value. Raises InputError."""
    if values is None:
        return np.zeros((0, columns))
    array = np.asarray(values, dtype=np.float64)
    if array.size % columns:
        raise InputError(f"an attribute of {array.shape} needs {columns} columns")
    return array.reshape(-1, columns)


def _whole(values: Any) -> NDArray[np.int64]:
    """Whole numbers (N,) of an attribute."""
    return np.array(() if values is None else values, dtype=np.int64).ravel()


def _uniform_color(mesh: Any, time: Any) -> Color | None:
    """The only displayColor of a mesh."""
    stored = mesh.GetDisplayColorPrimvar()
    if not stored.HasValue():
        return None
    values = _array(stored.ComputeFlattened(time), 3)
    if len(values) != 1:
        return None
    r, g, b = np.clip(values[0], 0.0, 1.0).tolist()
    return Color((r, g, b))


def _has_colors(mesh: Any) -> bool:
    return bool(mesh.GetDisplayColorPrimvar().HasValue())


def _shape(prim: Any, time: Any) -> Any:
    """trimesh's mesh of a cube or a round shape; None of other prims."""
    import trimesh
    from pxr import UsdGeom

    def value(name: str) -> float:
        number = float(prim.GetAttribute(name).Get(time))
        if not 0 < number < 1e9:
            raise InputError(f"{prim.GetPath()}: {name} must be > 0, got {number}")
        return number

    creation = trimesh.creation
    if prim.IsA(UsdGeom.Cube):
        return creation.box([value("size")] * 3)
    if prim.IsA(UsdGeom.Sphere):
        return creation.uv_sphere(value("radius"), count=[_SIDES // 2, _SIDES])
    if prim.IsA(UsdGeom.Cylinder):
        made = creation.cylinder(value("radius"), value("height"), sections=_SIDES)
    elif prim.IsA(UsdGeom.Cone):
        made = creation.cone(value("radius"), value("height"), sections=_SIDES)
        made.apply_translation([0, 0, -value("height") / 2])
    elif prim.IsA(UsdGeom.Capsule):
        count = [_SIDES, _SIDES]
        made = creation.capsule(value("height"), value("radius"), count=count)
        made.apply_translation([0, 0, -made.bounds.mean(axis=0)[2]])
    else:
        return None
    order = _AXES[str(prim.GetAttribute("axis").Get(time))]
    return trimesh.Trimesh(made.vertices[:, order], made.faces, process=False)


def _opaque(colors: Float) -> Float:
    """Colours (N, 3), clipped to [0, 1], with an opacity of 1: (N, 4)."""
    return np.hstack([np.clip(colors, 0.0, 1.0), np.ones((len(colors), 1))])


def _distinct_rows(values: Float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first of each set of equal rows, and the number of the set of each row.

    Corners of one vertex that agree in everything are one vertex, so that smooth surfaces stay connected.
    """
    _, first, numbers = np.unique(
        values, axis=0, return_index=True, return_inverse=True
    )
    return first, numbers
