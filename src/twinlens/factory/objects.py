"""Objects that a recipe adds to its scenes or draws anew: the keys of a scene.toml's objects, and where they stand.

A table replaces keys of the object with its name in scene.toml, or is a whole object. Files are relative to the recipe.
"""

import graphlib
import itertools
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import numpy as np
from numpy.random import Generator as Rng
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter
from scipy.spatial import QhullError

from twinlens.camera import Rig
from twinlens.camera.truth import Truth
from twinlens.errors import InputError, check_known, format_value, located
from twinlens.factory.gates import Rejected, crossings
from twinlens.factory.sources import meshes_in
from twinlens.geometry import Float, inverse, rigid, transform_points
from twinlens.scenes import Mesh, Scene, SceneObject, read_toml
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.materials import AnyMaterial
from twinlens.scenes.objects import (
    ANALYTIC_SHAPES,
    MESH_SHAPES,
    MeshFile,
    ObjectBase,
    ObjectTable,
)
from twinlens.scenes.placement import Placement, rotation
from twinlens.scenes.plugins import MaterialTable
from twinlens.scenes.resting import (
    CLEARANCE,
    LevelFace,
    Placed,
    level_faces,
    near_triangles,
    random_point,
    world_triangles,
)
from twinlens.scenes.scene import free_name
from twinlens.scenes.stable_poses import StablePose, stable_poses
from twinlens.schema import Fraction, Number, StrictModel, exactly, read, satisfies
from twinlens.seeds import generator

_TRIES = 200
_SURFACE_POINTS = 256
_UPRIGHT = 0.9  # cosine of the largest tilt of an upright body
_LEAST_FRONT = 0.3  # length of a front axis seen from above, below which the next axis is the front
_RANGE = Annotated[
    list[Number],
    exactly(2, Number),
    satisfies(lambda ends: ends[0] < ends[1], "must be [low, high], got {}"),
]
Label = Annotated[
    str,
    Field(min_length=1, max_length=100),
    satisfies(
        lambda label: not re.search(r"\[\d+\]$", label),
        "must not end as the number of a copy, such as [2], got {}",
    ),
]
"""The name of an object's copies, without their numbers."""
_TURNS = ("rotate", "euler_deg", "look_at")
_MATERIAL: TypeAdapter[AnyMaterial] = TypeAdapter(MaterialTable)
_OBJECT: TypeAdapter[ObjectBase] = TypeAdapter(ObjectTable)
_SHAPES: dict[str, dict[str, Any]] = {**ANALYTIC_SHAPES, **MESH_SHAPES}
_OBJECT_KEYS = {"shape", *MeshFile.model_fields}.union(*_SHAPES.values())


class Placing(StrictModel):
    """Keys of a recipe's object besides those of an object in scene.toml.

    count : copies, each with its own draws.
    folder : a random mesh of this folder, in place of `file`.
    label : the name of its copies in the truth, and their category; by default the object's own, for meshes of a folder
        that of the mesh file.
    resting_on : the object on whose level faces it is placed, in a stable pose and clear of all other objects.
    within : [[x low, x high], [y low, y high]], the part of the world in metres that it is placed in.
    upright : use the stable pose in which its own z axis is closest to vertical, instead of a random one.
    looking_at : an object, or "camera", that its z axis turns to; at rest, its -y axis seen from above.
    in_view : least share of its surface's points inside the picture of every camera.
    """

    count: int = Field(1, ge=0, le=1000)
    folder: str | None = None
    label: Label | None = None
    resting_on: str | None = None
    within: Annotated[list[_RANGE], exactly(2, _RANGE)] | None = None
    upright: bool = False
    looking_at: str | None = None
    in_view: Fraction | None = None


class _ObjectKeys(Placing, Placement):
    """The keys of a recipe's object that editors know; its shape and its file have more (docs/scenes.md)."""

    model_config = ConfigDict(extra="allow")
    file: str | None = None
    shape: str | None = None
    material: str | dict[str, Any] | None = None


def _tables(value: Any) -> Any:
    if not isinstance(value, (Mapping, list)):
        raise InputError(
            f"must be a table of keys and values, got {format_value(value)}"
        )
    return [value] if isinstance(value, Mapping) else value


Objects = dict[
    str,
    Annotated[
        list[dict[str, Any]],
        BeforeValidator(_tables, _ObjectKeys),
    ],
]
"""The tables of each object's copies, as the plan of a sample has them, or one table."""


@dataclass(frozen=True, eq=False)
class Draft:
    """One copy of an object before it is placed: its table, its own material, and where their files are found."""

    name: str
    place: Placing
    table: ObjectBase
    material: AnyMaterial | None
    context: SceneContext
    drawn: SceneContext

    @property
    def files(self) -> list[Path]:
        """The files that were found so far: a mesh file may name others."""
        return [*self.context.files, *self.drawn.files]


def copy_names(
    objects: Mapping[str, Sequence[Mapping[str, Any]]],
) -> dict[str, list[str]]:
    """The names of the copies of each object in the truth: numbered where there is a count, or several of one label.

    A file or a label that ends in -1 is numbered too: without the [0] its number would count as that of a copy
    (`dataset.layouts.category`).

    >>> parts = [{"folder": "parts", "count": 2, "file": f"parts/{mesh}.glb"} for mesh in ("mug", "brick")]
    >>> copy_names({"part": parts, "lamp": [{"translate": [0, 0, 1]}]})
    {'part': ['mug[0]', 'brick[0]'], 'lamp': ['lamp']}
    """
    labels: dict[str, list[str]] = {}
    of_all: Counter[str] = Counter()
    for name, tables in objects.items():
        labels[name] = [_label(name, table) for table in tables]
        of_all.update(labels[name])
    used: Counter[str] = Counter()
    names: dict[str, list[str]] = {}
    for name, tables in objects.items():
        names[name] = []
        for label, table in zip(labels[name], tables, strict=True):
            is_alone = label == name or (
                of_all[label] == 1 and not re.search(r"-\d+$", label)
            )
            if is_alone and "count" not in table:
                names[name].append(label)
                continue
            names[name].append(f"{label}[{used[label]}]")
            used[label] += 1
    return names


def _label(name: str, table: Mapping[str, Any]) -> str:
    """What the copies of an object are called: its label, the mesh that was drawn from its folder, or its own name."""
    if isinstance(label := table.get("label"), str):
        return label
    if "folder" in table and isinstance(file := table.get("file"), str):
        # Brackets at the end would be taken for the number of a copy.
        return PurePosixPath(file).stem.replace("[", "(").replace("]", ")")
    return name


def drafts(
    name: str,
    tables: Sequence[Mapping[str, Any]],
    names: Sequence[str],
    scene_objects: Mapping[str, Any],
    home: Path,
    folder: Path,
    file: Path,
) -> list[Draft]:
    """The checked copies of the object `name`, of a scene whose scene.toml in `home` has `scene_objects`.

    names : of the copies (`copy_names`). Raises InputError naming `file` and the key.
    """
    checked_drafts = []
    for i, table in enumerate(tables):
        key = f"scene.objects.{name}" + (f"[{i}]" if len(tables) > 1 else "")
        new = bool({"file", "shape", "folder"} & table.keys())
        part = {word: table[word] for word in Placing.model_fields if word in table}
        place = read(Placing, part, file, key)
        with located(f"{file}: {key}"):
            values = _object_table(name, table, place, scene_objects, folder)
        # Files of a new object and of an inline material are relative to the recipe, those of a changed object to its
        # scene.
        context, drawn = SceneContext(folder if new else home), SceneContext(folder)
        material, inline = values.get("material"), None
        if isinstance(material, Mapping):
            inline = read(_MATERIAL, dict(material), file, f"{key}.material", drawn)
            values["material"] = name
        checked = read(_OBJECT, values, file, key, context)
        draft = Draft(names[i], place, checked, inline, context, drawn)
        checked_drafts.append(draft)
    return checked_drafts


def _object_table(
    name: str,
    table: Mapping[str, Any],
    place: Placing,
    scene_objects: Mapping[str, Any],
    folder: Path,
) -> dict[str, Any]:
    """The table of an object as scene.toml would have it: without the keys of `Placing`, with those of the scene."""
    values = {
        word: value for word, value in table.items() if word not in Placing.model_fields
    }
    for word in values.keys() - _OBJECT_KEYS:
        check_known("key", word, _OBJECT_KEYS | Placing.model_fields.keys())
    new = bool({"file", "shape", "folder"} & table.keys())
    if name not in scene_objects and not new:
        names = ", ".join(sorted(scene_objects))
        hint = f"; the scene has {names}" if scene_objects else ""
        raise InputError(
            f"a new object needs one of 'file', 'folder' and 'shape'{hint}"
        )
    values = _merged(dict(scene_objects.get(name, {})), values, new)
    # The plan of a sample has drawn the file; a recipe that is only checked has none yet.
    if place.folder is not None and "file" not in values:
        values = {**values, "file": meshes_in(folder, place.folder)[0]}
    _check_pose(place, table, values)
    return values


def _merged(
    base: dict[str, Any], changes: Mapping[str, Any], new: bool
) -> dict[str, Any]:
    """An object's table with some keys replaced; those that the new ones exclude are left out."""
    if new:
        base = {
            key: value for key, value in base.items() if key in ObjectBase.model_fields
        }
    if "matrix" in changes or (
        "matrix" in base.keys() - changes.keys()
        and {"translate", *_TURNS} & changes.keys()
    ):
        base = {
            key: value
            for key, value in base.items()
            if key not in ("matrix", "translate", *_TURNS)
        }
    if {*_TURNS} & changes.keys():
        base = {key: value for key, value in base.items() if key not in _TURNS}
    return {**base, **changes}


def _check_pose(
    place: Placing, table: Mapping[str, Any], values: dict[str, Any]
) -> None:
    """Raise InputError for keys that exclude each other; remove the position of an object that will rest elsewhere."""
    if place.resting_on is None:
        for key in ("within", "upright"):
            if key in table:
                raise InputError(f"{key!r} needs 'resting_on'")
    else:
        for key in ("translate", "matrix"):
            if key in table:
                raise InputError(
                    f"{key!r} and 'resting_on' exclude each other; 'within' limits the place"
                )
            values.pop(key, None)
        if values.get("instances"):
            raise InputError(
                "an object with instances cannot have 'resting_on'; use 'count'"
            )
    if place.looking_at is not None:
        if excluded := {*_TURNS, "matrix"} & table.keys():
            raise InputError(f"{min(excluded)!r} and 'looking_at' exclude each other")
        for key in (*_TURNS, "matrix"):
            values.pop(key, None)
    if "count" in table and values.get("instances"):
        raise InputError("'count' and 'instances' exclude each other")


def written_objects(scene: Path | None) -> tuple[Path, dict[str, Any]]:
    """The folder of a scene.toml, and its [objects] as written; none for None. Raises InputError for a Mitsuba file."""
    if scene is None:
        return Path(), {}
    if scene.suffix == ".xml":
        raise InputError(
            f"scene.objects: {scene.name} is a Mitsuba file; only scene.toml files and families have it"
        )
    return scene.parent, read_toml(scene).get("objects", {})


def with_objects(
    scene: Scene,
    objects: Mapping[str, Sequence[Mapping[str, Any]]],
    rig: Rig,
    seed: int,
    folder: Path,
    file: Path,
) -> Scene:
    """The scene with a recipe's objects in it, as one drawn sample has them. The same arguments give the same scene.

    folder : of the recipe, which names files relative to it.

    Raises Rejected where an object has no free place or is not in view, and InputError.
    """
    if not objects:
        return scene
    scene_file = scene.xml or (scene.files[0] if scene.files else None)
    home, scene_objects = written_objects(scene_file)
    names = copy_names(objects)
    copies = {
        name: drafts(name, tables, names[name], scene_objects, home, folder, file)
        for name, tables in objects.items()
    }
    kept = [body for body in scene.objects if body.name not in copies]
    _check_labels(names, [body.name for body in kept], file)
    stage = _Stage(scene, kept, rig, seed)
    for name in in_order(copies, file):
        stage.added[name] = []
        for i, draft in enumerate(copies[name]):
            with located(f"{file}: scene.objects.{name}"):
                stage.add(name, i, draft)
    with located(str(file)):
        return stage.scene_with(copies)


def _check_labels(
    names: Mapping[str, Sequence[str]], others: Sequence[str], file: Path
) -> None:
    """Raise InputError where a copy is called as another object of the scene."""
    for name, group in names.items():
        for copy_name in group:
            if copy_name in others:
                raise InputError(
                    f"{file}: scene.objects.{name}: {copy_name!r} is also an object of the scene; give a 'label'"
                )


def in_order(copies: Mapping[str, Sequence[Draft]], file: Path) -> list[str]:
    """The names of objects: those with a pose first, the others after those that they rest on or look at."""
    before: dict[str, set[str]] = {}
    posed = set()
    for name, group in copies.items():
        targets: set[str | None] = set()
        for draft in group:
            targets |= {draft.place.resting_on, draft.place.looking_at}
        before[name] = copies.keys() & targets
        rests = any(draft.place.resting_on for draft in group)
        if not before[name] and not rests:
            posed.add(name)
    for name in copies.keys() - posed:
        before[name] = before[name] | posed
    try:
        return list(graphlib.TopologicalSorter(before).static_order())
    except graphlib.CycleError as error:
        ring = " -> ".join(error.args[1])
        raise InputError(
            f"{file}: scene.objects: {ring} rest on or look at each other; remove one"
        ) from error


@dataclass(eq=False)
class _Stage:
    """The scene while objects are added to it.

    kept : the scene's objects that no object of the recipe replaces.
    added : the placed copies of the recipe's objects, by the object's name.
    rests : the pose and the place of the copies that rest on another object, by the copy's name.
    """

    scene: Scene
    kept: list[SceneObject]
    rig: Rig
    seed: int
    added: dict[str, list[SceneObject]] = field(default_factory=dict)
    rests: dict[str, Placed] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.materials = dict(self.scene.materials)
        self.triangles = {body.name: world_triangles(body) for body in self.kept}
        self.faces: dict[str, list[tuple[LevelFace, Placed | None]]] = {}
        self.shares: dict[str, Float] = {}
        # Copies of a file share its mesh, and copies of a mesh its stable poses, which take long to find.
        self.models: dict[str, SceneObject] = {}
        self.poses: dict[tuple[int, bytes], list[StablePose]] = {}

    def scene_with(self, copies: Mapping[str, Sequence[Draft]]) -> Scene:
        """The scene with the added objects: changed ones at their old places in the list, then new ones."""
        # The order of objects numbers them in the ground truth, so it is that of the files, not that of placing.
        order = dict.fromkeys([*(body.name for body in self.scene.objects), *copies])
        placed = {body.name: [body] for body in self.scene.objects} | self.added
        files = [*self.scene.files]
        for group in copies.values():
            for draft in group:
                files += draft.files
        return replace(
            self.scene,
            objects=tuple(body for name in order for body in placed[name]),
            materials=self.materials,
            depth_range=self.depth_range(),
            files=tuple(dict.fromkeys(files)),
        )

    def bodies(self, name: str) -> list[SceneObject]:
        """The objects of that name: all copies of one that was added."""
        return self.added.get(name) or [body for body in self.kept if body.name == name]

    def add(self, name: str, index: int, draft: Draft) -> None:
        """Place one copy."""
        table, place = draft.table, draft.place
        target = self.target(place.looking_at)
        if target is not None and place.resting_on is None:
            table = table.model_copy(update={"look_at": target.tolist()})
        body = self.built(table, draft)
        if place.resting_on is not None:
            rng = generator(self.seed, "objects", name, index)
            try:
                body = self.at_rest(body, place, target, rng)
            except Rejected as rejected:
                if self.is_too_large(body, place):
                    rejected.depends_on = name
                raise
        elif (
            place.in_view is not None
            and (share := self.share_in_view(body)) < place.in_view
        ):
            remedy = f"scene.objects.{name}.translate, or scene.objects.{name}.in_view"
            raise Rejected(
                "object out of view", f"{share:.1%} of {draft.name!r} in view", remedy
            )
        self.added[name].append(body)
        self.triangles[body.name] = world_triangles(body)

    def built(self, table: ObjectBase, draft: Draft) -> SceneObject:
        """The object of a table, at its own pose. Copies of a mesh file share one mesh and its materials."""
        file = getattr(table, "file", None)
        shared = file is not None and not table.merge
        key = (
            repr((file, table.model_dump(exclude=set(Placement.placing_keys))))
            if shared
            else draft.name
        )
        if key not in self.models:
            body = table.build(draft.context)
            names = {
                name: free_name(name, self.materials)
                for name in draft.context.materials
            }
            self.materials |= {
                names[name]: plugin for name, plugin in draft.context.materials.items()
            }
            own_material = (
                body.material
                if isinstance(body.material, str)
                else tuple(names[name] for name in body.material)
            )
            self.models[key] = replace(body, material=own_material)
        made = self.models[key]
        if draft.material is not None:
            material = free_name(draft.name, self.materials)
            self.materials[material] = draft.material
            made = replace(made, material=material)
        return replace(
            made,
            name=draft.name,
            world_from_object=table.world_from_object()
            if shared
            else made.world_from_object,
        )

    def target(self, name: str | None) -> Float | None:
        """The position of the camera or the middle of an object's bounding box, (3,)."""
        if name is None:
            return None
        if name == "camera":
            return self.rig.world_from_cams[0][:3, 3]
        points = np.concatenate(self.support(name, "looking_at")).reshape(-1, 3)
        return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)

    def support(self, name: str, key: str) -> list[Float]:
        """The triangles of the objects of that name. Raises InputError if there is none."""
        triangles: list[Float] = []
        for body in self.bodies(name):
            triangles += self.triangles[body.name]
        if not triangles and name in self.added:
            raise Rejected(
                f"no object for {key}",
                f"0 copies of {name!r}",
                f"scene.objects.{name}.count (larger)",
            )
        if not triangles:
            with located(key):
                check_known(
                    "object",
                    name,
                    [body.name for body in self.kept] + list(self.added),
                )
        return triangles

    def at_rest(
        self, body: SceneObject, place: Placing, target: Float | None, rng: Rng
    ) -> SceneObject:
        """The object in a stable pose at a random free place. Raises Rejected if none is found."""
        carrier = str(place.resting_on)
        faces = self.level(carrier)
        rest, vertices = self.stable(body, place, rng)
        near: dict[int, Float] = {}
        for _ in range(_TRIES):
            chosen = int(rng.choice(len(faces), p=self.shares[carrier]))
            face, below = faces[chosen]
            trial = _trial(rest, face, below, place, target, rng)
            # All of its support is on the face, and the tower that it joins does not tip over.
            if not (face.holds(trial.moved(rest.support)) and trial.balanced()):
                continue
            if chosen not in near:
                parts = list(itertools.chain.from_iterable(self.triangles.values()))
                near[chosen] = near_triangles(parts, face, rest)
            # It crosses no surface, and is not whole inside another body.
            middle = trial.place + trial.spin @ rest.centre
            if trial.meets(near[chosen]) or self.enclosed(middle):
                continue
            # First to its stable pose, then about the vertical; its lowest vertex comes to lie on the face.
            turn = trial.spin @ rest.turn
            low = float((vertices @ turn.T)[:, 2].min())
            pose = rigid(turn, trial.place - [0, 0, low])
            placed = replace(body, world_from_object=pose @ body.world_from_object)
            if place.in_view is None or self.share_in_view(placed) >= place.in_view:
                self.rests[body.name] = trial
                return placed
        raise self.no_free_place(body.name, place, rest)

    def is_too_large(self, body: SceneObject, place: Placing) -> bool:
        """Whether the support of an object, in any stable pose, is wider than its carrier at any turn."""
        low, high = self.span(str(place.resting_on))
        diagonal = float(np.hypot(*(high - low)))
        poses = self.poses_of(body, place)
        return all(np.ptp(pose.support, axis=0).max() > diagonal for pose in poses)

    def span(self, carrier: str) -> tuple[Float, Float]:
        """The smallest and largest x and y, (2,) each, of the level faces of an object."""
        faces = [face.triangles.reshape(-1, 2) for face, _ in self.level(carrier)]
        points = np.concatenate(faces)
        return points.min(axis=0), points.max(axis=0)

    def no_free_place(self, name: str, place: Placing, rest: StablePose) -> Rejected:
        """Why an object in a stable pose has no place on its carrier."""
        carrier = str(place.resting_on)
        low, high = self.span(carrier)
        wide = float(np.ptp(rest.footprint, axis=0).max())
        free = float((high - low).max())
        problem = f"{name!r}, {wide:.3g} m wide, on {carrier!r}, {free:.3g} m, in {_TRIES} tries"
        remedy = f"the 'count', 'within' or 'in_view' of objects on {carrier!r}"
        if wide > free:
            problem = f"{name!r} is {wide:.3g} m wide, {carrier!r} {free:.3g} m"
            remedy = f"the 'scale' of {name!r}, such as 0.001 for a file in millimetres"
        elif place.within is not None:
            first, last = np.transpose(place.within)
            if (last < low).any() or (first > high).any():
                spans = " and ".join(
                    f"{axis} {a:.3g} to {b:.3g}"
                    for axis, a, b in zip("xy", low, high, strict=True)
                )
                problem = f"'within' is off {carrier!r}, which spans {spans} m"
                remedy = f"the 'within' of {name!r}"
        return Rejected("no free place", problem, remedy)

    def level(self, carrier: str) -> list[tuple[LevelFace, Placed | None]]:
        """The level faces of all objects of that name, each with how its object lies."""
        if carrier not in self.faces:
            self.support(carrier, "resting_on")
            faces: list[tuple[LevelFace, Placed | None]] = []
            for body in self.bodies(carrier):
                rest = self.rests.get(body.name)
                for part in self.triangles[body.name]:
                    faces += [(face, rest) for face in level_faces(part)]
            if not faces:
                raise InputError(
                    f"resting_on: {carrier!r} has no level face; name an object with one"
                )
            area = np.array([face.area.sum() for face, _ in faces])
            self.faces[carrier], self.shares[carrier] = faces, area / area.sum()
        return self.faces[carrier]

    def stable(
        self, body: SceneObject, place: Placing, rng: Rng
    ) -> tuple[StablePose, Float]:
        """A stable pose of an object and its vertices (N, 3), relative to its own position and orientation."""
        poses = self.poses_of(body, place)
        weights = np.array([pose.probability for pose in poses])
        chosen = poses[int(rng.choice(len(poses), p=weights / weights.sum()))]
        _, vertices, _ = _solid(body)
        return chosen, vertices

    def poses_of(self, body: SceneObject, place: Placing) -> list[StablePose]:
        """The stable poses of an object, upright ones alone where asked for. Raises InputError if it has none."""
        key, vertices, faces = _solid(body)
        pose_key = hash(key), body.world_from_object.tobytes()
        if pose_key not in self.poses:
            size = float(np.ptp(vertices, axis=0).max())
            try:
                # A unit size, so that the tolerances of the search hold for meshes of any size.
                self.poses[pose_key] = stable_poses(Mesh(vertices / size, faces), size)
            except (QhullError, ZeroDivisionError, InputError) as error:
                raise InputError(
                    "resting_on: needs a mesh with an extent in all three dimensions"
                ) from error
        poses = self.poses[pose_key]
        if place.upright:
            poses = [pose for pose in poses if pose.up[2] > _UPRIGHT]
            poses = sorted(poses, key=lambda pose: -float(pose.up[2]))[:1]
        if not poses:
            remedy = (
                "remove 'upright', or turn it with 'euler_deg'"
                if place.upright
                else "check that the mesh is closed"
            )
            raise InputError(
                f"resting_on: {body.name!r} has no {'upright ' * place.upright}stable pose; {remedy}"
            )
        return poses

    def enclosed(self, point: Float) -> bool:
        """Whether a point (3,) is inside a closed object that does not enclose the camera too, as a room does."""
        eye = self.rig.world_from_cams[0][:3, 3]
        for part in itertools.chain.from_iterable(self.triangles.values()):
            low, high = part.min(axis=(0, 1)), part.max(axis=(0, 1))
            in_box = ((low < point) & (point < high)).all()
            if in_box and _inside(part, point) and not _inside(part, eye):
                return True
        return False

    def share_in_view(self, body: SceneObject) -> float:
        """The least share, over the cameras, of points of an object's surface that are inside the picture."""
        triangles = np.concatenate(world_triangles(body))
        first_edges = triangles[:, 1] - triangles[:, 0]
        second_edges = triangles[:, 2] - triangles[:, 0]
        area = np.linalg.norm(np.cross(first_edges, second_edges), axis=1)
        # Always the same points, so that the share depends on the pose alone.
        rng = generator(0, "surface")
        u, v = rng.random((2, _SURFACE_POINTS, 1))
        a, b, c = np.moveaxis(
            triangles[rng.choice(len(area), _SURFACE_POINTS, p=area / area.sum())], 1, 0
        )
        points = (
            a
            + np.where(u + v < 1, u, 1 - u) * (b - a)
            + np.where(u + v < 1, v, 1 - v) * (c - a)
        )
        pixels = [self.rig.project(i, points) for i in range(len(self.rig))]
        return min(
            float(camera.contains(view_pixels).mean())
            for camera, view_pixels in zip(self.rig.cameras, pixels, strict=True)
        )

    def depth_range(self) -> tuple[float, float]:
        """The scene's range of depths, extended to the vertices of the added objects in the first view."""
        near, far = self.scene.depth_range
        camera_from_world = inverse(self.rig.world_from_cams[0])
        for body in itertools.chain.from_iterable(self.added.values()):
            points = np.concatenate(self.triangles[body.name]).reshape(-1, 3)
            seen = points[self.rig.cameras[0].contains(self.rig.project(0, points))]
            depth = transform_points(camera_from_world, seen)[:, 2]
            near, far = min([near, *depth]), max([far, *depth])
        return float(near), float(far)


def _solid(body: SceneObject) -> tuple[bytes, Float, NDArray[np.uint32]]:
    """A key that identifies the shape of an object, its vertices (N, 3) at its own pose, and its triangles (F, 3).

    Raises InputError for other shapes than meshes and cubes.
    """
    if isinstance(body.shape, Mesh):
        vertices = transform_points(body.world_from_object, body.shape.vertices)
        return body.shape.vertices.tobytes(), vertices, body.shape.faces
    if body.shape["type"] == "cube":
        vertices = world_triangles(body)[0].reshape(-1, 3)
        faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
        return b"cube", vertices, faces
    raise InputError(
        f"resting_on: needs a mesh or a cube, got a {body.shape['type']}; use a mesh's shape"
    )


def _trial(
    rest: StablePose,
    face: LevelFace,
    below: Placed | None,
    place: Placing,
    target: Float | None,
    rng: Rng,
) -> Placed:
    """A random place on a face, turned to a target."""
    angle = float(rng.uniform(0, 2 * np.pi))
    point = (
        random_point(face, rng)
        if place.within is None
        else rng.uniform(*np.transpose(place.within))
    )
    if target is not None:
        front = (
            rest.turn[:2, 1] * -1
            if np.linalg.norm(rest.turn[:2, 1]) > _LEAST_FRONT
            else rest.turn[:2, 2]
        )
        away = target[:2] - point
        angle = math.atan2(away[1], away[0]) - math.atan2(front[1], front[0])
    spin = rotation([0, 0, 1], math.degrees(angle))[:3, :3]
    corner = point - spin[:2, :2] @ rest.support.mean(axis=0)
    return Placed(
        rest, spin, np.append(corner, face.height + CLEARANCE * rest.size), below
    )


def _inside(triangles: Float, point: Float) -> bool:
    """Whether rays from a point (3,) in two opposite directions both cross the triangles (F, 3, 3) an odd number of
    times: true inside a closed surface, and not next to an open one.
    """
    vertices = triangles.reshape(-1, 3)
    faces = np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3)
    return all(
        crossings(sign * vertices, faces, sign * point) % 2 == 1 for sign in (1, -1)
    )


def check_seen(
    objects: Mapping[str, Sequence[Mapping[str, Any]]], truths: Sequence[Truth]
) -> None:
    """Raise Rejected unless the first view shows a pixel of each copy of the objects with `in_view`."""
    numbers = {name: 1 + i for i, name in enumerate(truths[0].object_names)}
    names = copy_names(objects)
    for name, tables in objects.items():
        for table, copy_name in zip(tables, names[name], strict=True):
            number = numbers[copy_name]
            if table.get("in_view") and not (truths[0].object_id == number).any():
                raise Rejected(
                    "object hidden",
                    f"{copy_name!r} in view 0",
                    f"scene.objects.{name}.within or in_view",
                )
