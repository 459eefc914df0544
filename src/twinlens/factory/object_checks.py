"""What can be checked of a recipe's objects before anything is drawn: their files, and the names that they refer to."""

import re
from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import Any

from twinlens.errors import InputError, check_known, located
from twinlens.factory.objects import (
    Draft,
    copy_names,
    drafts,
    in_order,
    written_objects,
)
from twinlens.factory.sources import meshes_in
from twinlens.families import FAMILIES
from twinlens.families.assets import SUFFIXES, named_by_mesh
from twinlens.families.kinds import KINDS
from twinlens.scenes import read_toml
from twinlens.scenes.model_files import WITH_MATERIALS


def check_objects(
    objects: Mapping[str, Sequence[Mapping[str, Any]]],
    subjects: Iterable[Path | str],
    file: Path,
) -> dict[str, bool]:
    """Check the objects of a recipe against each of its scene.toml files, or families by name.

    Returns the names of the files that the objects have, relative to the recipe, and whether each is a mesh that has
    its own materials. Raises InputError.
    """
    files = _ObjectFiles(file.parent.resolve())
    names = copy_names(objects)
    for subject in subjects if objects else ():
        scene = subject if isinstance(subject, Path) else None
        with located(str(file)):
            home, scene_objects = written_objects(scene)
        copies: dict[str, list[Draft]] = {}
        for name, tables in objects.items():
            where = f"{file}: scene.objects.{name}"
            with located(f"{file}: scene.objects"):
                _check_name(name, objects, scene_objects)
            for table in tables:
                if {"file", "folder"} <= table.keys():
                    raise InputError(f"{where}: 'file' and 'folder' exclude each other")
            copies[name] = drafts(
                name, tables, names[name], scene_objects, home, files.folder, file
            )
            for draft in copies[name]:
                files.add(draft, where)
        for name, group in copies.items():
            others = (scene_objects.keys() | copies.keys()) - {name}
            for draft in group:
                where = f"{file}: scene.objects.{name}"
                _check_references(draft, others, subject, where)
        in_order(copies, file)
    return files.has_materials


class _ObjectFiles:
    """Collects the files of a recipe's objects that are in the recipe's folder.

    `has_materials` : by the file's name below `folder`, whether it is a mesh with its own materials.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.has_materials: dict[str, bool] = {}
        # Meshes are read once for their files, though every scene and every copy asks for them.
        self._named: dict[tuple[Path, bool], list[Path]] = {}

    def add(self, draft: Draft, where: str) -> None:
        """Add the files of a copy. Raises InputError where a mesh has no material and gets none."""
        meshes: list[str] = []
        if draft.place.folder is not None:
            meshes = meshes_in(self.folder, draft.place.folder)
        keeps_material = not draft.table.material
        for mesh in meshes:
            if keeps_material and not mesh.lower().endswith(WITH_MATERIALS):
                raise InputError(f"{where}: missing key 'material'; {mesh} has none")
        paths = [path for path in draft.files if path.is_relative_to(self.folder)]
        paths += [self.folder / mesh for mesh in meshes]
        for path in paths:
            self._add_file(path, keeps_material)
            for named in self._named_by(path, keeps_material):
                self._add_file(named, False)

    def _add_file(self, path: Path, has_materials: bool) -> None:
        whole = path.resolve()
        if whole.is_relative_to(self.folder):
            name = whole.relative_to(self.folder).as_posix()
            before = self.has_materials.get(name, False)
            self.has_materials[name] = before or has_materials

    def _named_by(self, path: Path, keeps_material: bool) -> list[Path]:
        """The files that a mesh file names; none for another file."""
        if path.suffix.lower() not in SUFFIXES["meshes"]:
            return []
        key = path, keeps_material
        if key not in self._named:
            self._named[key] = named_by_mesh(path, keeps_material, self.folder)
        return self._named[key]


def _check_name(
    name: str,
    objects: Mapping[str, Sequence[Mapping[str, Any]]],
    scene_objects: Mapping[str, Any],
) -> None:
    """Raise InputError for an empty name, and for that of a copy of another object."""
    if not name.strip():
        raise InputError(f"an object needs a name, got {name!r}")
    if copied := re.fullmatch(r"(.+)\[\d+\]", name):
        several = [*objects.get(copied[1], ()), scene_objects.get(copied[1], {})]
        if any({"count", "instances"} & table.keys() for table in several):
            raise InputError(
                f"{name!r} is also the name of a copy of {copied[1]!r}; rename one"
            )


def _check_references(
    draft: Draft, objects: Set[str], subject: Path | str, where: str
) -> None:
    """Raise InputError where the scene or family has no object, or no material, that a draft names."""
    is_file = isinstance(subject, Path)
    for key, target in (
        ("resting_on", draft.place.resting_on),
        ("looking_at", draft.place.looking_at),
    ):
        if target is not None and (key, target) != ("looking_at", "camera"):
            with located(f"{where}.{key}"):
                _check_named("object", target, objects, "" if is_file else str(subject))
    material = draft.table.material
    if (
        draft.material is None and material and ":" not in material
    ):  # a colon: of a mesh file
        written = (
            read_toml(subject).get("materials", {}) if isinstance(subject, Path) else {}
        )
        with located(f"{where}.material"):
            _check_named(
                "material", material, written.keys(), "" if is_file else str(subject)
            )


def _check_named(what: str, name: str, written: Set[str], family: str) -> None:
    """Raise InputError for a name that is not known and that no object or material of the family has."""
    names = FAMILIES[family].names | KINDS.keys() if family else frozenset()
    if re.sub(r"(-\d+)+$", "", name) not in names:  # bottle-2 is a second bottle
        check_known(what, name, written | names)
