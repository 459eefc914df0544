"""Objects of a scene file: a shape with its measures, a material, a place, perhaps a light and copies."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.errors import FileError, InputError
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.assets import asset
from twinlens.scenes.paint import texture
from twinlens.scenes.placement import instances, placement
from twinlens.scenes.plugins import SHAPES, area_emitter, parameters
from twinlens.scenes.scene import Mesh, Plugin, SceneObject
from twinlens.scenes.table import (
    At,
    Parser,
    Table,
    boolean,
    choice,
    listed,
    number,
    scalar_or_vector,
    text,
    vector,
    whole,
)

_LENGTH = number(above=0.0)
_SIDES = whole(3, 4096)
_MOST_FACES = 20_000_000
_LARGEST_MESH_FILE = 2 << 30
_ROUND = {"sphere": 3, "cylinder": 2}  # how many of a shape's own axes, from the first, must be scaled alike
MESH_FILES = {".ply", ".obj", ".glb", ".stl"}


def _points(width: int) -> Parser[Float]:
    """A list of two or more points, (N, width)."""
    read = listed(vector(width), 2, 100_000)
    return lambda at, value: np.array(read(at, value))


def _heights(at: At, value: Any) -> Any:
    pixels = texture(at, value).pixels
    return pixels if pixels.ndim == 2 else pixels.mean(axis=2)


def _height_field(extents: Float, height: Any, amplitude: float, grid: list[int] | None = None) -> Mesh:
    rows, columns = height.shape
    nx, ny = grid or (min(columns, 257), min(rows, 257))
    picked = height[np.linspace(0, rows - 1, ny).astype(int)][:, np.linspace(0, columns - 1, nx).astype(int)]
    return shapes.height_field(extents, amplitude * picked)


@dataclass(frozen=True)
class Body:
    """A mesh-making function and its keys: the parser of each, and those that must be given."""

    make: Callable[..., Mesh]
    keys: Mapping[str, Parser[Any]]
    needs: tuple[str, ...] = ()


def _created(name: str, keys: Mapping[str, Parser[Any]], *needs: str) -> Body:
    return Body(lambda **given: shapes.creation(name, **given), keys, needs)


BODIES: dict[str, Body] = {
    "box": Body(shapes.box, {"extents": scalar_or_vector(3, _LENGTH), "tile": _LENGTH}, ("extents",)),
    "rounded_box": Body(
        shapes.rounded_box,
        {"extents": scalar_or_vector(3, _LENGTH), "radius": _LENGTH, "subdivisions": whole(1, 64), "tile": _LENGTH},
        ("extents", "radius"),
    ),
    "icosphere": _created("icosphere", {"radius": _LENGTH, "subdivisions": whole(0, 7)}),
    "uv_sphere": _created("uv_sphere", {"radius": _LENGTH}),
    "icosahedron": _created("icosahedron", {}),
    "capsule": _created("capsule", {"radius": _LENGTH, "height": _LENGTH}),
    "solid_cylinder": _created(
        "cylinder", {"radius": _LENGTH, "height": _LENGTH, "sections": _SIDES}, "radius", "height"
    ),
    "cone": Body(shapes.cone, {"radius": _LENGTH, "height": _LENGTH, "sections": _SIDES}, ("radius", "height")),
    "annulus": _created(
        "annulus",
        {"r_min": _LENGTH, "r_max": _LENGTH, "height": _LENGTH, "sections": _SIDES},
        *("r_min", "r_max", "height"),
    ),
    "torus": _created(
        "torus",
        {"major_radius": _LENGTH, "minor_radius": _LENGTH, "major_sections": _SIDES, "minor_sections": _SIDES},
        *("major_radius", "minor_radius"),
    ),
    "lathe": Body(
        shapes.lathe,
        {"profile": _points(2), "segments": _SIDES, "smooth": boolean, "samples": whole(1, 64)},
        ("profile",),
    ),
    "tube": Body(
        shapes.tube,
        {
            "points": _points(3),
            "radius": lambda at, value: (listed(_LENGTH, 2) if isinstance(value, list) else _LENGTH)(at, value),
            "sides": _SIDES,
            "smooth": boolean,
            "closed": boolean,
        },
        ("points", "radius"),
    ),
    "height_field": Body(
        _height_field,
        {
            "extents": vector(2, _LENGTH),
            "height": _heights,
            "amplitude": number(),
            "grid": listed(whole(2, 2049), 2, 2),
        },
        ("extents", "height", "amplitude"),
    ),
    "bent_sheet": Body(
        shapes.bent_sheet,
        {"extents": vector(2, _LENGTH), "angle_deg": number(0.1, 360.0), "segments": whole(1, 4096)},
        ("extents", "angle_deg"),
    ),
}


def scene_object(at: At, name: str, value: Any) -> SceneObject:
    """One entry of [objects]."""
    table: Table[Any] = Table(at, value)
    if table.has("file") == table.has("shape"):
        raise at.wrong("needs either 'shape' (a name) or 'file' (a mesh file), not both")
    shape = _mesh_file(table) if table.has("file") else _named_shape(table)
    pose = placement(table)
    _check_scale(at, shape, pose)
    shape = _tiled(table, shape)
    thing = SceneObject(
        name=name,
        shape=shape,
        material=table.take("material", text),
        world_from_object=pose,
        emitter=table.take("emitter", area_emitter, None),
        instances=table.take("instances", instances, ()),
    )
    for i, copy in enumerate(thing.instances):
        _check_scale(at / "instances" / i, shape, copy)
    if thing.instances and thing.emitter is not None:
        raise at.wrong("an object with instances cannot shine; make the lights objects of their own")
    merge = table.take("merge", boolean, False)
    table.done()
    return _merged(at, thing) if merge else thing


def _merged(at: At, thing: SceneObject) -> SceneObject:
    """The object's copies as one mesh with one id: for grass and gravel, of which nobody asks which blade was hit."""
    mesh = thing.shape
    if not isinstance(mesh, Mesh) or not thing.instances:
        raise (at / "merge").wrong("joins the instances of a mesh; this object is no mesh or has no instances")
    if len(mesh.faces) * len(thing.instances) > _MOST_FACES:
        raise (at / "merge").wrong(f"makes more than {_MOST_FACES} triangles; keep the instances apart")
    copies = [shapes.transformed(mesh, copy @ thing.world_from_object) for copy in thing.instances]
    return replace(thing, shape=shapes.merged(copies), world_from_object=np.eye(4), instances=())


def _named_shape(table: Table[Any]) -> Mesh | Plugin:
    kind = table.take("shape", choice(*SHAPES, *BODIES))
    if kind in SHAPES:
        return {"type": kind, **parameters(table, SHAPES[kind])}
    body = BODIES[kind]
    given = {key: table.take(key, parser) for key, parser in body.keys.items() if table.has(key)}
    for key in body.needs:
        if key not in given:
            raise table.at.wrong(f"a {kind} needs the key {key!r}")
    _check_body(table.at, kind, given)
    try:
        return body.make(**given)
    except InputError as error:
        raise table.at.wrong(str(error)) from error


def _check_body(at: At, kind: str, given: Mapping[str, Any]) -> None:
    """What no single key can know."""
    if kind == "rounded_box" and given["radius"] > 0.5 * min(given["extents"]):
        raise (at / "radius").wrong(f"must be at most half the shortest side, got {given['radius']:g}")
    if kind == "annulus" and given["r_min"] >= given["r_max"]:
        raise (at / "r_min").wrong("must be less than r_max")
    if kind == "torus" and given["minor_radius"] >= given["major_radius"]:
        raise (at / "minor_radius").wrong("must be less than major_radius")
    if kind == "lathe" and (given["profile"][:, 0] < 0).any():
        raise (at / "profile").wrong("radii must be >= 0")
    if kind == "lathe" and not np.diff(given["profile"], axis=0).any():
        raise (at / "profile").wrong("needs two different points")
    if kind == "tube":
        points, radius = given["points"], given["radius"]
        if isinstance(radius, list) and len(radius) != len(points):
            raise (at / "radius").wrong(f"needs one value for each of the {len(points)} points, got {len(radius)}")
        if (np.diff(points, axis=0) == 0).all(axis=1).any():
            raise (at / "points").wrong("two neighbours coincide")


def _check_scale(at: At, shape: Mesh | Plugin, pose: Float) -> None:
    """Mitsuba's round shapes stay round: it would warn on a terminal and draw something else.

    A sphere must be scaled evenly; a cylinder across its axis, which is z where `p0` and `p1` do not turn it; a disk
    may become an ellipse.
    """
    if isinstance(shape, Mesh) or shape["type"] not in _ROUND:
        return
    kind = shape["type"]
    alike = 3 if _turned_cylinder(shape) else _ROUND[kind]
    gram = pose[:3, :3].T @ pose[:3, :3]
    skew = np.abs(gram - np.diag(np.diag(gram))).max()
    if skew + np.ptp(np.diag(gram)[:alike]) > 1e-6 * gram.max():
        along = ", or along its z axis alone" if kind == "cylinder" and alike == 2 else ""
        raise (at / "scale").wrong(f"a {kind} keeps its form; scale it evenly{along}, or use a mesh (uv_sphere, lathe)")


def _turned_cylinder(shape: Plugin) -> bool:
    """Whether `p0` and `p1` lay a cylinder's axis off z; each has Mitsuba's default where it is not given."""
    axis = np.subtract(shape.get("p1", (0.0, 0.0, 1.0)), shape.get("p0", (0.0, 0.0, 0.0)))
    return bool(np.abs(axis[:2]).max() > 1e-9 * np.abs(axis).max())


def _tiled(table: Table[Any], shape: Mesh | Plugin) -> Mesh | Plugin:
    """A mesh's texture coordinates times `uv_scale` plus `uv_offset`: textures repeat that often, and start there."""
    if not table.has("uv_scale") and not table.has("uv_offset"):
        return shape
    scale = table.take("uv_scale", scalar_or_vector(2, _LENGTH), np.ones(2))
    offset = table.take("uv_offset", vector(2), np.zeros(2))
    if not isinstance(shape, Mesh) or shape.uv is None:
        raise table.at.wrong("'uv_scale' and 'uv_offset' work on meshes; give the texture a 'repeat' instead")
    return replace(shape, uv=shape.uv * scale + offset)


def _mesh_file(table: Table[Any]) -> Mesh:
    path = table.take("file", asset)
    crease = 0.0 if table.take("face_normals", boolean, False) else table.take("crease_deg", number(0.0, 180.0), 30.0)
    return read_mesh(path, crease)


def read_mesh(path: Path, crease_deg: float = 30.0) -> Mesh:
    """All triangles of a .ply, .obj, .glb or .stl file as one mesh. Materials in the file, and files it names, are not
    read.

    Raises FileError when the file is damaged, too large, of another kind, or holds no finite triangle.
    """
    if path.suffix.lower() not in MESH_FILES:
        raise FileError(f"{path}: meshes may be {', '.join(sorted(MESH_FILES))}, got {path.suffix!r}")
    try:
        return _read_mesh(path, crease_deg)
    except FileError:
        raise
    except Exception as error:  # trimesh raises what it likes on damaged files; all of it is this file's fault
        reason = " ".join(str(error).split())
        raise FileError(f"{path}: cannot be read as a {path.suffix} mesh ({reason})") from error


def _read_mesh(path: Path, crease_deg: float) -> Mesh:
    import trimesh

    if path.stat().st_size > _LARGEST_MESH_FILE:
        raise FileError(f"{path}: a mesh file has at most {_LARGEST_MESH_FILE >> 20} MiB")
    with path.open("rb") as stream:  # a stream has no folder: nothing next to the file can be named by it
        loaded = trimesh.load_scene(stream, file_type=path.suffix[1:].lower(), process=False)
    _check_parts(path, loaded)
    made = loaded.to_mesh()
    if not len(made.faces) or not np.isfinite(made.vertices).all():
        raise FileError(f"{path}: holds no triangles with finite corners")
    return shapes.from_trimesh(made, crease_deg)


def _check_parts(path: Path, loaded: Any) -> None:
    """Before the parts of a file are joined: one may be placed many times, and a joined one borrows others' corners."""
    for part in loaded.geometry.values():
        faces = getattr(part, "faces", ())
        if len(faces) and not 0 <= np.min(faces) <= np.max(faces) < len(part.vertices):
            raise FileError(f"{path}: a face names a corner that is not among the {len(part.vertices)} there are")
    placed = (loaded.geometry[loaded.graph[node][1]] for node in loaded.graph.nodes_geometry)
    count = sum(len(getattr(part, "faces", ())) for part in placed)
    if count > _MOST_FACES:
        raise FileError(f"{path}: {count} triangles are more than {_MOST_FACES}; simplify the mesh")
