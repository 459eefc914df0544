"""recipe.toml: the description of a dataset. docs/recipes.md shows every key.

One part of a recipe is the same for all samples (`seed`, `count`, scenes, gates, splits). The other is drawn for each
sample: `Recipe.drawn` is a template in which any value may be a distribution. It is checked with every value at which a
distribution begins, ends or chooses.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model

from twinlens.dataset.metadata import About
from twinlens.errors import InputError, format_value, unknown
from twinlens.factory.draws import NonNegative, Number, corners, hint, normalized, template
from twinlens.factory.gates import Gates
from twinlens.factory.lenses import mask_file
from twinlens.factory.settings import Settings, check_settings
from twinlens.factory.sources import Sources
from twinlens.scenes import bundled_scenes, read_toml
from twinlens.schema import StrictModel, read


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


def _word(name: str) -> str:
    usable = name and name.isprintable() and name == name.strip() and name[0] != "." and not set(name) & {"/", "\\"}
    if not usable:
        raise InputError(f"a split's name must be usable as a folder's, such as train, got {format_value(name)}")
    return name


def _shares(splits: dict[str, float]) -> dict[str, float]:
    for name in splits:
        _word(name)
    if not splits or abs(sum(splits.values()) - 1.0) > 1e-6:
        raise InputError(f"the shares must add up to 1, got {format_value(splits)}")
    return splits


def _family(name: str) -> str:
    from twinlens.families import FAMILIES

    if name not in FAMILIES:
        raise unknown("family", name, FAMILIES)
    return name


def _no_duplicates(names: list[str]) -> list[str]:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(f"{name!r} is listed twice; 'weights' sets how often each is drawn")
    return names


Names = Annotated[list[str], Field(min_length=1, max_length=1000), AfterValidator(_no_duplicates)]
Folders = Annotated[list[str], Field(min_length=1)] | str
Fraction = Annotated[Number, Field(ge=0, le=1)]


class AssetsTable(StrictModel):
    """Folders of files that families draw from, relative to the recipe."""

    meshes: Folders | None = None
    textures: Folders | None = None
    hdris: Folders | None = None


class _Constants(StrictModel):
    seed: int = Field(ge=0, le=2**63 - 1)
    count: int = Field(ge=1, le=10_000_000)
    scenes: Names | None = None
    families: Annotated[list[Annotated[str, AfterValidator(_family)]], AfterValidator(_no_duplicates)] | None = None
    weights: list[NonNegative] | None = None
    ndisp: int | None = Field(None, ge=1, le=65536)
    keep: list[Literal["radiance"]] = Field(default_factory=list)
    gates: Gates = Field(default_factory=lambda: Gates.model_validate({}))
    splits: Annotated[dict[str, Fraction], AfterValidator(_shares)] | None = None
    assets: AssetsTable = AssetsTable()
    about: dict[str, Any] | None = None


DRAWN = tuple(Settings.model_fields)
"""The keys of a recipe that are drawn for every sample."""

_DRAWN_FIELDS: dict[str, Any] = dict.fromkeys(DRAWN, (Any, None))
RecipeTable: Any = create_model("RecipeTable", __base__=_Constants, **_DRAWN_FIELDS)


@dataclass(frozen=True)
class Subject:
    """What a sample shows: a scene by name or file, or a random scene of a family."""

    kind: str  # scene | family
    name: str


@dataclass(frozen=True, eq=False)
class Recipe:
    """A checked recipe. `written` is the content of the file."""

    file: Path
    written: Mapping[str, Any]
    seed: int
    count: int
    subjects: tuple[Subject, ...]
    weights: tuple[float, ...] | None
    drawn: Mapping[str, Any]
    ndisp: int | None
    keep: tuple[str, ...]
    gates: Gates
    splits: Mapping[str, float]
    assets: Mapping[str, tuple[str, ...]]
    masks: tuple[str, ...]

    @property
    def makes_scenes(self) -> bool:
        """Whether families make a scene for each sample; otherwise scenes are read from files."""
        return self.subjects[0].kind == "family"

    @cached_property
    def sources(self) -> Sources:
        """The files that the recipe names; they are read on first use."""
        scenes = tuple(subject.name for subject in self.subjects if subject.kind == "scene")
        return Sources(self.file.parent, scenes, self.assets, self.masks)


def read_recipe(path: str | os.PathLike[str]) -> Recipe:
    """Read a recipe. Raises InputError naming the file, the key, and what is allowed."""
    path = Path(path)
    return recipe_from_table(read_toml(path), path)


def recipe_from_table(written: Mapping[str, Any], path: Path = Path("recipe.toml")) -> Recipe:
    """The recipe of a table as TOML has it; `path` is named in messages, and other files are relative to it."""
    table = read(RecipeTable, dict(written), path)
    subjects = _subjects(table, path)
    weights = table.weights
    if weights is not None:
        weights = tuple(float(share) for share in _located(path, "", lambda: normalized(table.weights, len(subjects))))
    if table.about is not None:
        _located(path, "", lambda: About.of(table.about))
    families = [subject.name for subject in subjects if subject.kind == "family"]
    assets = {kind: tuple(_listed(names)) for kind, names in table.assets.model_dump(exclude_none=True).items()}
    _check_assets(assets, bool(families), path)
    drawn = {key: template(written[key], path, key) for key in DRAWN if key in written}
    return Recipe(
        file=path,
        written=dict(written),
        seed=table.seed,
        count=table.count,
        subjects=subjects,
        weights=weights,
        ndisp=table.ndisp,
        keep=tuple(table.keep),
        gates=table.gates,
        splits=table.splits or {},
        assets=assets,
        drawn=drawn,
        masks=_check_drawn(drawn, path, families),
    )


def _located(path: Path, key: str, make: Any) -> Any:
    """What `make()` returns; InputErrors are prefixed with the file and the key."""
    try:
        return make()
    except InputError as error:
        raise InputError(f"{path}: {key}{': ' if key else ''}{error}") from error


def _check_drawn(drawn: Mapping[str, Any], path: Path, families: list[str]) -> tuple[str, ...]:
    """Check every value that a distribution may begin, end or choose with, each with the others' first.

    Returns the mask files that lenses name.
    """
    checked = []
    for table in corners(drawn):
        try:
            checked.append(check_settings(table, path, families))
        except InputError as error:
            raise type(error)(f"{error}{hint(str(error).removeprefix(f'{path}: '), drawn)}") from error
    wide = any(lens.aperture_diameter > 0 for _, lenses in checked for lens in lenses)
    if any(settings.diffraction for settings, _ in checked) and not wide:
        raise InputError(
            f"{path}: diffraction: has no effect, every lens is a pinhole; add [[lenses]] with an aperture or remove it"
        )
    masks = (mask_file(lens) for settings, _ in checked for lens in settings.lenses)
    return tuple(dict.fromkeys(Path(name).as_posix() for name in masks if name))


def _subjects(table: Any, path: Path) -> tuple[Subject, ...]:
    if (table.scenes is None) == (table.families is None):
        raise InputError(
            f"{path}: needs exactly one of 'scenes' (bundled names or files) and 'families' (random scenes), as "
            'scenes = ["staircase"]'
        )
    if table.families is not None:
        return tuple(Subject("family", name) for name in table.families)
    for i, name in enumerate(table.scenes):
        _located(path, f"scenes[{i}]", lambda name=name: _check_scene(name, path.parent))
    return tuple(Subject("scene", name) for name in table.scenes)


def _check_scene(name: str, folder: Path) -> None:
    if name in bundled_scenes() or (name not in ("", ".") and _exists(folder / name)):
        return
    if Path(name).suffix or any(letter in name for letter in "/\\"):
        raise InputError(f"no such file next to the recipe, in {folder.absolute()}: {name!r}")
    raise InputError(f"{unknown('scene', name, bundled_scenes())}, nor a scene file next to the recipe")


def _check_assets(assets: Mapping[str, tuple[str, ...]], families: bool, path: Path) -> None:
    """Each folder must exist and have a file of its kind; the files' contents are checked when they are drawn."""
    if assets and not families:
        raise InputError(f"{path}: assets: can be used with 'families' only")
    from twinlens.families import Assets

    for kind, names in assets.items():
        for name in names:
            folder = path.parent / name
            if not _exists(folder):
                raise InputError(f"{path}: assets.{kind}: no folder {name!r} next to the recipe")
            try:
                Assets.from_folders(**{kind: [folder]})
            except InputError as error:
                message = str(error).removeprefix(f"{kind}: ").replace(repr(str(folder)), repr(name))
                raise InputError(f"{path}: assets.{kind}: {message}") from None


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def differences(old: Mapping[str, Any], new: Mapping[str, Any], key: str = "") -> list[str]:
    """Where two recipes differ: one `key: old -> new` each. `count` and `about` may differ.

    >>> differences({"spp": 16, "rig": {"baseline": 0.1}}, {"spp": 16, "rig": {"baseline": 0.2}})
    ['rig.baseline: 0.1 -> 0.2']
    """
    found = []
    for name in dict.fromkeys([*old, *new]):
        if not key and name in ("count", "about"):
            continue
        a, b = old.get(name, _ABSENT), new.get(name, _ABSENT)
        path = f"{key}.{name}" if key else str(name)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found += differences(a, b, path)
        elif a != b:
            found.append(f"{path}: {_shown(a)} -> {_shown(b)}")
    return found


_ABSENT = object()


def _shown(value: Any) -> str:
    return "absent" if value is _ABSENT else format_value(value)
