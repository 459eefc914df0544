"""What can be checked of a recipe's objects before anything is drawn: their files, and the names that they refer to."""

import re
from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import Any

from twinlens.errors import InputError, check_known, located
from twinlens.factory.objects import Draft, drafts, in_order, written_objects
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
    folder = file.parent.resolve()
    found: dict[str, bool] = {}
    named: dict[tuple[Path, bool], list[Path]] = {}
    for subject in subjects if objects else ():
        with located(str(file)):
            home, known = written_objects(
                subject if isinstance(subject, Path) else None
            )
        copies: dict[str, list[Draft]] = {}
        for name, tables in objects.items():
            with located(f"{file}: scene.objects"):
                _check_name(name, objects, known)
            for table in tables:
                if {"file", "folder"} <= table.keys():
                    raise InputError(
                        f"{file}: scene.objects.{name}: 'file' and 'folder' exclude each other"
                    )
            copies[name] = drafts(name, tables, known, home, folder, file)
            for draft in copies[name]:
                meshes = (
                    []
                    if draft.place.folder is None
                    else meshes_in(folder, draft.place.folder)
                )
                bare = [
                    mesh for mesh in meshes if not mesh.lower().endswith(WITH_MATERIALS)
                ]
                if bare and not draft.table.material:
                    raise InputError(
                        f"{file}: scene.objects.{name}: missing key 'material'; {bare[0]} has none"
                    )
                own = [path for path in draft.files if path.is_relative_to(folder)] + [
                    folder / mesh for mesh in meshes
                ]
                has_own = not draft.table.material
                for path in own:
                    key = path, has_own
                    if key not in named and path.suffix.lower() in SUFFIXES["meshes"]:
                        named[key] = named_by_mesh(path, has_own, folder)
                    below = [
                        each
                        for each in (path, *named.get(key, ()))
                        if each.resolve().is_relative_to(folder)
                    ]
                    for each in below:
                        part = each.resolve().relative_to(folder).as_posix()
                        found[part] = found.get(part, False) or (
                            each == path and has_own
                        )
        for name, group in copies.items():
            for draft in group:
                things = (known.keys() | copies.keys()) - {name}
                _check_references(
                    draft, things, subject, f"{file}: scene.objects.{name}"
                )
        in_order(copies, file)
    return found


def _check_name(
    name: str,
    objects: Mapping[str, Sequence[Mapping[str, Any]]],
    known: Mapping[str, Any],
) -> None:
    """Raise InputError for an empty name, and for that of a copy of another object."""
    if not name.strip():
        raise InputError(f"an object needs a name, got {name!r}")
    if copied := re.fullmatch(r"(.+)\[\d+\]", name):
        several = [*objects.get(copied[1], ()), known.get(copied[1], {})]
        if any({"count", "instances"} & table.keys() for table in several):
            raise InputError(
                f"{name!r} is also the name of a copy of {copied[1]!r}; rename one"
            )


def _check_references(
    draft: Draft, things: Set[str], subject: Path | str, where: str
) -> None:
    """Raise InputError where the scene or family has no object, or no material, that a draft names."""
    own = isinstance(subject, Path)
    for key, other in (
        ("resting_on", draft.place.resting_on),
        ("looking_at", draft.place.looking_at),
    ):
        if other is not None and (key, other) != ("looking_at", "camera"):
            with located(f"{where}.{key}"):
                _check_named("object", other, things, "" if own else str(subject))
    material = draft.table.material
    if (
        draft.material is None and material and ":" not in material
    ):  # a colon: of a mesh file
        written = (
            read_toml(subject).get("materials", {}) if isinstance(subject, Path) else {}
        )
        with located(f"{where}.material"):
            _check_named(
                "material", material, written.keys(), "" if own else str(subject)
            )


def _check_named(what: str, name: str, known: Set[str], family: str) -> None:
    """Raise InputError for a name that is not known and that no object or material of the family has."""
    names = FAMILIES[family].names | KINDS.keys() if family else frozenset()
    if re.sub(r"(-\d+)+$", "", name) not in names:  # bottle-2 is a second bottle
        check_known(what, name, known | names)
