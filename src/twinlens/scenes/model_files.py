"""Mesh files with their materials: glTF (.glb, .gltf), USD, and OBJ with its .mtl file.

Files that a mesh file names are opened only below the folder of the `SceneContext`: that of the scene or recipe.
"""

import contextlib
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, warn_not_used
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.assets import (
    LARGEST_MESH_FILE,
    USD_FILES,
    SceneContext,
    check_face_count,
    check_faces,
    find_named,
    folder_of,
    no_triangles,
    read_limited,
    reading,
    without_normals,
)
from twinlens.scenes.gltf import Gltf, Part, named_by, open_gltf, read_header
from twinlens.scenes.gltf_materials import (
    VERTEX_COLOR,
    PbrMaterial,
    Textures,
    material_of,
)
from twinlens.scenes.materials import Material
from twinlens.scenes.obj_files import obj_materials, open_obj
from twinlens.scenes.scene import Mesh, SceneWarning, free_name
from twinlens.scenes.usd_process import open_usd

GLTF_FILES = (".glb", ".gltf")
HAVE_MATERIALS_ALONE = (*GLTF_FILES, *USD_FILES)
WITH_MATERIALS = (*HAVE_MATERIALS_ALONE, ".obj")


class MaterialWarning(SceneWarning):
    """A part of a file's material cannot be rendered; the message names it."""


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh in the file's coordinates, in metres; `materials` are those that its `surface` numbers, in order.

    up_axis : the axis of the file that points up, "y" or "z".
    """

    mesh: Mesh
    materials: Mapping[str, Material]
    up_axis: str = "z"


def read_model(
    path: Path,
    context: SceneContext,
    crease_deg: float | None = None,
    with_materials: bool = True,
) -> Model:
    """The mesh and the materials of a .glb, .gltf or .obj file, named ``file:material``.

    The file's own normals are used unless `crease_deg` is given; without both, edges over 30 degrees are sharp. Gives a
    `MaterialWarning` that names what cannot be rendered. Raises FileError.
    """
    if path.suffix.lower() in USD_FILES:
        return _read_usd(path, context, crease_deg, with_materials)
    open_file = _opener(path, context)
    with reading(path, "mesh"):
        is_gltf = path.suffix.lower() in GLTF_FILES
        parts, tables, textures = (_open_gltf if is_gltf else open_obj)(path, open_file)
        meshes = part_meshes(parts, crease_deg)
        materials: dict[str, Material] = {}
        if with_materials:
            shown = (folder_of(path, context) / path.name).as_posix()
            meshes, materials = _painted(parts, meshes, tables, textures, shown)
        else:
            meshes = [replace(mesh, attributes={}) for mesh in meshes]
    lost = ", ".join(dict.fromkeys(without_normals(textures.lost, crease_deg)))
    if lost:
        warnings.warn(f"{path}: not rendered: {lost}", MaterialWarning, stacklevel=2)
    up_axis = "y" if is_gltf else "z"
    return Model(shapes.merged(meshes), materials, up_axis)


def _read_usd(
    path: Path, context: SceneContext, crease_deg: float | None, with_materials: bool
) -> Model:
    with reading(path, "mesh"):
        file = open_usd(path, context, with_materials)
        meshes = part_meshes(file.parts, crease_deg)
        materials: dict[str, Material] = {}
        if with_materials:
            shown = (folder_of(path, context) / path.name).as_posix()
            meshes, materials = _numbered(
                [part.material or 0 for part in file.parts],
                meshes,
                file.materials,
                [f"{shown}:{name}" for name in file.names],
            )
    warn_not_used(path, file.lost, MaterialWarning)
    return Model(shapes.merged(meshes), materials, file.up_axis)


def _numbered(
    numbers: list[int], meshes: list[Mesh], made: list[Material], names: list[str]
) -> tuple[list[Mesh], dict[str, Material]]:
    """The meshes with their `surface`, and the materials that are used; one with normal maps may be there twice."""
    places: dict[tuple[int, bool], int] = {}
    materials: dict[str, Material] = {}
    numbered = []
    for number, mesh in zip(numbers, meshes, strict=True):
        mirrored = np.zeros(len(mesh.faces), dtype=bool)
        if made[number].has_normal_maps:
            mirrored = _is_mirrored(mesh)
        surface = np.empty(len(mesh.faces), dtype=np.uint16)
        for side in np.unique(mirrored).tolist():
            if (number, side) not in places:
                places[number, side] = len(materials)
                name = free_name(names[number], materials)
                materials[name] = replace(made[number], mirrored=side)
            surface[mirrored == side] = places[number, side]
        numbered.append(replace(mesh, surface=surface))
    return numbered, materials


def _painted(
    parts: list[Part],
    meshes: list[Mesh],
    tables: list[PbrMaterial],
    textures: Textures,
    file: str,
) -> tuple[list[Mesh], dict[str, Material]]:
    """The meshes of parts with their `surface` and attributes, and the materials that are used.

    A material is there once for each combination of colours per vertex and mirrored texture coordinates.
    """
    places: dict[tuple[int | None, bool], int] = {}
    made: list[Material] = []
    names: list[str] = []
    numbers = []
    for part, mesh in zip(parts, meshes, strict=True):
        table = PbrMaterial() if part.material is None else tables[part.material]
        _check_coordinates(part, table)
        key = part.material, bool(mesh.attributes)
        if key not in places:
            places[key] = len(made)
            made.append(material_of(table, textures, colored=key[1]))
            names.append(f"{file}:{table.name or part.material or 0}")
        numbers.append(places[key])
    return _numbered(numbers, meshes, made, names)


def _check_coordinates(part: Part, table: PbrMaterial) -> None:
    """Raise InputError for a part without the texture coordinates that its material needs."""
    if table.has_textures and getattr(part.mesh.visual, "uv", None) is None:
        where = f"a part of the mesh has no texture coordinates (set {table.coordinate_set}) for them"
        raise InputError(
            f"material {(table.name or part.material)!r} has textures, but {where}; give the object a 'material'"
        )


def _is_mirrored(mesh: Mesh) -> NDArray[np.bool_]:
    """Whether the texture coordinates of each face are a mirror image of it, bool (F,)."""
    if mesh.uv is None:
        return np.zeros(len(mesh.faces), dtype=bool)
    a, b, c = (mesh.uv[mesh.faces[:, i]] for i in range(3))
    return np.asarray(np.linalg.det(np.stack([b - a, c - a], axis=1)) < 0)


def _opener(path: Path, context: SceneContext) -> Callable[[str], bytes]:
    """A function from the name of a file, as the mesh file has it, to its content; the size of all is limited."""
    left = LARGEST_MESH_FILE

    def open_file(name: str) -> bytes:
        nonlocal left
        data = read_limited(find_named(name, path, context), left)
        left -= len(data)
        return data

    return open_file


def named_files(path: Path, context: SceneContext) -> list[Path]:
    """The files that a .glb, .gltf or .obj file names; not all of them if it is damaged."""
    with contextlib.suppress(InputError), reading(path, "mesh"):
        if path.suffix.lower() in USD_FILES:
            open_usd(path, context)
            return list(dict.fromkeys(context.files))
        is_gltf = path.suffix.lower() in GLTF_FILES
        names = (
            named_by(read_header(path)[0])
            if is_gltf
            else obj_materials(path, _opener(path, context))[2]
        )
        for name in names:
            find_named(name, path, context)
    return list(dict.fromkeys(context.files))


Opened = tuple[list[Part], list[PbrMaterial], Textures]


def _open_gltf(path: Path, open_file: Callable[[str], bytes]) -> Opened:
    file = open_gltf(path, open_file)
    textures = Textures(
        file.header.textures, file.header.samplers, file.picture, file.lost
    )
    return file_parts(file), file.header.materials, textures


def file_parts(file: Gltf) -> list[Part]:
    """The parts of a glTF file. Raises FileError for no triangles or too many."""
    check_face_count(file.path, file.face_count)
    parts = file.parts()
    for part in parts:
        check_faces(file.path, part.mesh)
    if not any(len(part.mesh.faces) for part in parts):
        raise no_triangles(file.path, file.lost)
    return [part for part in parts if len(part.mesh.faces)]


def part_meshes(parts: list[Part], crease_deg: float | None) -> list[Mesh]:
    """Parts placed in their file, with their own normals if they have any and `crease_deg` is None.

    Without (u, v) a part gets longitude and height: `shapes.merged` keeps (u, v) only if all parts have them. Normals
    of a mesh that is placed many times are made once.
    """
    made: dict[tuple[int, int], Mesh] = {}
    placed = []
    for part in parts:
        key = id(part.mesh), id(part.colors)
        if key not in made:
            made[key] = _part_mesh(part, crease_deg)
        placed.append(_placed(made[key], part.pose))
    return placed


def _part_mesh(part: Part, crease_deg: float | None) -> Mesh:
    """A part in its own coordinates."""
    attributes = {}
    if part.colors is not None:
        attributes = {VERTEX_COLOR.attribute: part.colors}
    if part.has_normals and crease_deg is None:
        return _with_own_normals(part.mesh, attributes)
    crease = 30.0 if crease_deg is None else crease_deg
    return shapes.from_trimesh(part.mesh, crease, attributes)


def _placed(mesh: Mesh, pose: Float) -> Mesh:
    linear = pose[:3, :3]
    if np.linalg.matrix_rank(linear) < 3:
        return shapes.flattened(mesh, pose)
    placed = shapes.transformed(mesh, pose)
    if np.linalg.det(linear) < 0:
        return replace(placed, faces=placed.faces[:, ::-1])
    return placed


def _with_own_normals(made: Any, attributes: dict[str, Float]) -> Mesh:
    """A trimesh mesh with the normals of its file; those of length 0 become the mean of their faces' normals."""
    vertices = np.array(made.vertices, dtype=np.float64)
    faces = np.array(made.faces, dtype=np.uint32)
    normals = np.array(made.vertex_normals, dtype=np.float64)
    missing = ~normals.any(axis=1)
    if missing.any():
        sums = np.zeros_like(normals)
        of_corners = np.repeat(shapes.face_cross(vertices, faces), 3, axis=0)
        np.add.at(sums, faces.ravel(), of_corners)
        has_area = sums.any(axis=1, keepdims=True)
        normals[missing] = np.where(has_area, sums, [0.0, 0.0, 1.0])[missing]
    uv = getattr(made.visual, "uv", None)
    if uv is None:
        bare = Mesh(vertices, faces, normals, attributes=attributes)
        return shapes.with_longitude(bare)
    return Mesh(vertices, faces, normals, np.array(uv), attributes=attributes)
