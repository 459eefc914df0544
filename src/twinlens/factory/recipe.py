"""recipe.toml: what a dataset is to be made of. Read strictly: a mistake is named by its place, with the nearest key.

A recipe has a part that is the same for every sample (`seed`, `count`, which scenes, gates, splits) and a part that is
drawn for each: a table (`Recipe.drawn`) in which any value may be a distribution. That part is checked here at every
value that its distributions begin, end or choose with. docs/recipes.md shows every key.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from twinlens.dataset.about import About
from twinlens.errors import InputError, unknown
from twinlens.factory.draws import corners, hints, normalised, template
from twinlens.factory.gates import Gates, gates_from_table
from twinlens.factory.settings import DRAWN, check_settings
from twinlens.factory.sources import Sources
from twinlens.scenes import bundled_scenes
from twinlens.scenes.table import At, Source, Table, choice, listed, number, show, text, whole
from twinlens.scenes.toml_file import read_toml

_LARGEST_COUNT = 10_000_000
_LARGEST_SEED = 2**63 - 1
KEEP = ("radiance",)
ASSETS = ("meshes", "textures", "hdris")


@dataclass(frozen=True)
class Subject:
    """What a sample is of: a scene by name or file, or a family that each sample is another member of."""

    kind: str  # scene | family
    name: str


@dataclass(frozen=True, eq=False)
class Recipe:
    """A recipe that was read and checked. `written` is the file's own content, `at` where it stands."""

    at: At
    written: Mapping[str, Any]
    seed: int
    count: int
    subjects: tuple[Subject, ...]
    weights: tuple[float, ...] | None
    drawn: Mapping[str, Any]
    ndisp: int | None = None
    keep: tuple[str, ...] = ()
    gates: Gates = field(default_factory=Gates)
    splits: Mapping[str, float] = field(default_factory=dict)
    assets: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def file(self) -> Path:
        """The recipe's path, as messages name it."""
        return self.at.source.file

    @property
    def folder(self) -> Path:
        """What paths in the recipe are relative to."""
        return self.at.source.folder

    @property
    def makes_scenes(self) -> bool:
        """Whether families make a scene for each sample; else scenes come from files."""
        return self.subjects[0].kind == "family"

    @cached_property
    def sources(self) -> Sources:
        """The files that it leads to; what they hold is read when it is first asked for."""
        scenes = tuple(subject.name for subject in self.subjects if subject.kind == "scene")
        masks = tuple(dict.fromkeys(path.as_posix() for path in self.at.source.assets))
        return Sources(self.folder, scenes, self.assets, masks)


def read_recipe(path: str | os.PathLike[str]) -> Recipe:
    """The recipe in a file. Raises InputError naming the file, the place, and what would be right."""
    path = Path(path)
    return recipe_from_table(read_toml(path), path)


def recipe_from_table(written: Mapping[str, Any], path: Path = Path("recipe.toml")) -> Recipe:
    """The recipe of a table as TOML has it; `path` is what messages name and files are found beside."""
    at = At(Source(path))
    keys: Table[Any] = Table(at, written)
    subjects, weights = _subjects(keys, path.parent)
    recipe = Recipe(
        at=at,
        written=dict(written),
        seed=keys.take("seed", whole(0, _LARGEST_SEED)),
        count=keys.take("count", whole(1, _LARGEST_COUNT)),
        subjects=subjects,
        weights=weights,
        ndisp=keys.take("ndisp", whole(1, 65536), None),
        keep=tuple(keys.take("keep", listed(choice(*KEEP)), [])),
        gates=keys.take("gates", gates_from_table, Gates()),
        splits=keys.take("splits", _splits, {}),
        assets=keys.take("assets", lambda at, value: _assets(at, value, path.parent), {}),
        drawn={key: keys.take(key, template) for key in DRAWN if keys.has(key)},
    )
    keys.take("about", _about, None)
    keys.done()
    if recipe.assets and subjects[0].kind == "scene":
        raise (at / "assets").wrong("belongs to 'families'; a scene from a file is as it is")
    _check_drawn(recipe)
    return recipe


def _check_drawn(recipe: Recipe) -> None:
    """Every value that is sure to come, each with the others' first: what reads well here will be planned well."""
    families = [subject.name for subject in recipe.subjects if subject.kind == "family"]
    at = At(replace(recipe.at.source, hint=hints(recipe.drawn)))
    diffraction = width = False
    for drawn in corners(recipe.drawn):
        asked = check_settings(drawn, at, bool(families))
        diffraction, width = diffraction or asked.diffraction, width or asked.lens_has_width
        for name in families:
            _check_depths(at / "scene" / "depth_range", name, asked.depth_range)
    if diffraction and not width:
        raise (at / "diffraction").wrong(
            "every lens here is a pinhole of no width, where it changes nothing; add [[lenses]] with an aperture, or "
            "leave it out"
        )


def _check_depths(at: At, family: str, depths: tuple[float, float] | None) -> None:
    from twinlens.families import FAMILIES

    if depths is None:
        return
    near, far = depths
    least = FAMILIES[family].least_ratio
    if not far >= least * near:
        raise at.wrong(f"a {family} scene needs far >= {least:g} near, got [{near:g}, {far:g}]")


def _subjects(keys: Table[Any], folder: Path) -> tuple[tuple[Subject, ...], tuple[float, ...] | None]:
    if keys.has("scenes") and keys.has("families"):
        raise keys.at.wrong("has both 'scenes' and 'families': scenes are read from files, families made; keep one")
    if not keys.has("scenes") and not keys.has("families"):
        raise keys.at.wrong("needs 'scenes' or 'families', as scenes = [\"staircase\"]")
    key = "scenes" if keys.has("scenes") else "families"
    read = (lambda at, value: _scene(at, value, folder)) if key == "scenes" else _family
    subjects = keys.take(key, listed(read, 1, 1000))
    for i, subject in enumerate(subjects):
        if subject in subjects[:i]:
            raise (keys.at / key / i).wrong(f"names {subject.name!r} twice; 'weights' says how often each comes")
    weights = keys.take("weights", listed(number(low=0.0), len(subjects), len(subjects)), None)
    if weights is not None:
        weights = tuple(float(share) for share in normalised(keys.at / "weights", weights))
    return tuple(subjects), weights


def _scene(at: At, value: Any, folder: Path) -> Subject:
    name = text(at, value)
    if name in bundled_scenes():
        return Subject("scene", name)
    try:
        found = (folder / name).exists() and name not in ("", ".")
    except (OSError, ValueError):
        found = False
    if not found:
        raise at.wrong(_not_there(name, folder))
    return Subject("scene", name)


def _not_there(name: str, folder: Path) -> str:
    """A name that reads as a path is meant as one, and no bundled scene is near it."""
    if Path(name).suffix or any(letter in name for letter in "/\\"):
        return f"no such file beside the recipe, in {folder.absolute()}: {name!r}"
    return f"{unknown('scene', name, bundled_scenes())}, nor a scene file beside the recipe"


def _family(at: At, value: Any) -> Subject:
    from twinlens.families import FAMILIES

    return Subject("family", choice(*FAMILIES)(at, value))


def _splits(at: At, value: Any) -> dict[str, float]:
    shares = {name: number(0.0, 1.0)(at / name, share) for name, share in Table[Any](at, value).rest().items()}
    for name in shares:
        if not _is_word(name):
            raise at.wrong(
                f"the name of a split is a word, as train, without / and \\ or a dot before, got {show(name)}"
            )
    if not shares or abs(sum(shares.values()) - 1.0) > 1e-6:
        raise at.wrong(f"the shares must add up to 1, got {show(value)}")
    return shares


def _is_word(name: str) -> bool:
    """Whether a name is a label to read, and could be a folder's."""
    written = name and name.isprintable() and name == name.strip()
    return bool(written) and not name.startswith(".") and not any(letter in name for letter in "/\\")


def _assets(at: At, value: Any, folder: Path) -> dict[str, tuple[str, ...]]:
    keys: Table[Any] = Table(at, value)
    given = {kind: keys.take(kind, _folders) for kind in ASSETS if keys.has(kind)}
    keys.done()
    for kind, names in given.items():
        for name in names:
            if not _is_there(folder / name):
                raise (at / kind).wrong(f"no folder {name!r} beside the recipe")
            _check_kind(at / kind, kind, folder, name)
    return given


def _check_kind(at: At, kind: str, folder: Path, name: str) -> None:
    """Raise InputError for a folder without any file of the kind; what the files hold is found when they are drawn."""
    from twinlens.families import Assets

    try:
        Assets.from_folders(**{kind: [folder / name]})
    except InputError as error:
        said = str(error).removeprefix(f"{kind}: ").replace(repr(str(folder / name)), repr(name))
        raise at.wrong(said) from None


def _about(at: At, value: Any) -> About:
    try:
        return About.of(value)
    except InputError as error:
        raise at.wrong(str(error)) from error


def _folders(at: At, value: Any) -> tuple[str, ...]:
    return (text(at, value),) if isinstance(value, str) else tuple(listed(text, 1)(at, value))


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def differences(old: Mapping[str, Any], new: Mapping[str, Any], place: str = "") -> list[str]:
    """Where two recipes, as written, differ: one `place: old -> new` each. `count` and `about` may differ.

    >>> differences({"spp": 16, "rig": {"baseline": 0.1}}, {"spp": 16, "rig": {"baseline": 0.2}})
    ['rig.baseline: 0.1 -> 0.2']
    """
    found = []
    for key in dict.fromkeys([*old, *new]):
        if not place and key in _MAY_DIFFER:
            continue
        a, b = old.get(key, _NOTHING), new.get(key, _NOTHING)
        where = f"{place}.{key}" if place else str(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found += differences(a, b, where)
        elif a != b:
            found.append(f"{where}: {_said(a)} -> {_said(b)}")
    return found


_NOTHING = object()
_MAY_DIFFER = ("count", "about")


def _said(value: Any) -> str:
    return "not said" if value is _NOTHING else show(value)
