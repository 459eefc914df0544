"""recipe.toml: the description of a dataset. docs/recipes.md shows every key.

One part of a recipe is the same for all samples (`seed`, `count`, scenes, gates, splits). The other is drawn for each
sample: `Recipe.drawn` is a template in which any value may be a distribution. It is checked with every value at which a
distribution begins, ends or chooses.
"""

import itertools
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    create_model,
    model_validator,
)

from twinlens.camera import RecipeLens
from twinlens.dataset.metadata import About
from twinlens.errors import (
    InputError,
    counted,
    file_hint,
    format_value,
    located,
    unknown,
)
from twinlens.factory.draws import corners, hint, leaves, normalized, template
from twinlens.factory.gates import Gates
from twinlens.factory.lenses import MaskTable
from twinlens.factory.object_checks import check_objects
from twinlens.factory.settings import RecipeSettings, check_settings
from twinlens.factory.sources import Sources, listed
from twinlens.families import ALL, FAMILIES, family_names
from twinlens.families.assets import MESH_SHARE
from twinlens.scenes import bundled_folder, bundled_scenes, read_toml
from twinlens.scenes.rigs import file_names
from twinlens.schema import Fraction, NonNegative, StrictModel, one_of, read


def _check_splits(splits: dict[str, float]) -> dict[str, float]:
    for name in splits:
        printable = name.isprintable() and name == name.strip()
        if (
            not printable
            or not 0 < len(name.encode()) <= 255
            or name.startswith(".")
            or "/" in name
            or "\\" in name
        ):
            raise InputError(
                f"a split's name must be usable as a folder's, such as train, got {format_value(name)}"
            )
    if not splits or abs(sum(splits.values()) - 1.0) > 1e-6:
        raise InputError(f"the shares must add up to 1, got {format_value(splits)}")
    return splits


Family = Annotated[str, one_of("family", [ALL, *FAMILIES])]


def _check_unique(names: list[str]) -> list[str]:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(
                f"{name!r} is listed twice; 'weights' sets how often each is drawn"
            )
    return names


def _check_scene(name: str, info: Any) -> str:
    folder = info.context
    if name in bundled_scenes() or (
        name not in ("", ".") and os.path.lexists(folder / name)
    ):
        return name
    if Path(name).suffix or any(letter in name for letter in "/\\"):
        raise InputError(
            f"no such file next to the recipe, in {folder.absolute()}: {name!r}{file_hint(folder / name)}"
        )
    raise InputError(
        f"{unknown('scene', name, bundled_scenes())}, nor a scene file next to the recipe"
    )


def _check_assets(names: list[str], info: Any) -> list[str]:
    """Each folder must exist and have a file of its kind; the files' contents are checked when they are drawn."""
    kind = str(info.field_name)
    for name in names:
        _check_listed(kind, name, info.context)
    return names


def _check_listed(kind: str, name: str, folder: Path) -> None:
    if not os.path.lexists(folder / name):
        raise InputError(
            f"no file or folder {name!r} next to the recipe{file_hint(folder / name)}"
        )
    listed(kind, name, folder)


Subject = Annotated[str, AfterValidator(_check_scene)]


def _as_list(value: Any) -> Any:
    if not isinstance(value, (str, list)):
        raise InputError(
            f"must be a string or a list of strings, got {format_value(value)}"
        )
    return [value] if isinstance(value, str) else value


_listed = BeforeValidator(_as_list, str | list[str])
Folders = Annotated[
    list[str], Field(min_length=1), AfterValidator(_check_assets), _listed
]


class AssetsTable(StrictModel):
    """Folders of files that families draw from, relative to the recipe."""

    meshes: Folders | None = None
    textures: Folders | None = None
    hdris: Folders | None = None
    keep_scale: bool = False
    keep_material: bool = False
    mesh_share: Fraction = MESH_SHARE

    @model_validator(mode="after")
    def _check(self) -> "AssetsTable":
        for key in ("mesh_share", "keep_scale", "keep_material"):
            if key in self.model_fields_set and self.meshes is None:
                raise InputError(f"{key!r} needs 'meshes'")
        return self


def _check_families(families: list[str] | None, info: Any) -> list[str] | None:
    if families is not None and info.data.get("scenes") is not None:
        raise InputError("give 'scenes' or 'families', not both")
    if families is None and info.data.get("scenes") is None:
        raise InputError(
            "a recipe needs 'seed', 'count', and exactly one of 'scenes' (bundled names or files) and 'families' "
            '(random scenes), as scenes = ["staircase"]'
        )
    return families and _check_unique(family_names(families))


class _Constants(StrictModel):
    # Scenes and families come first: a table without both, such as an empty one, gets the message that names all.
    scenes: (
        Annotated[
            list[Subject],
            Field(min_length=1, max_length=1000),
            AfterValidator(_check_unique),
        ]
        | None
    ) = None
    families: Annotated[list[Family] | None, AfterValidator(_check_families)] = Field(
        None, min_length=1, validate_default=True
    )
    seed: int = Field(ge=0, le=2**63 - 1)
    count: int = Field(ge=1, le=10_000_000)
    weights: list[NonNegative] | None = None
    ndisp: int | None = Field(None, ge=1, le=65536)
    keep: list[Literal["models", "radiance"]] = Field(default_factory=list)
    gates: Gates = Field(default_factory=lambda: Gates.model_validate({}))
    splits: Annotated[dict[str, Fraction], AfterValidator(_check_splits)] | None = None
    assets: AssetsTable = AssetsTable()
    about: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _check(self) -> "_Constants":
        if self.weights is not None:
            normalized(self.weights, len(self.scenes or self.families or ()))
        if self.about is not None:
            About.of(self.about)
        if self.families is None and self.assets != AssetsTable():
            raise InputError("assets: can be used with 'families' only")
        return self


DRAWN = tuple(RecipeSettings.model_fields)
"""The keys of a recipe that are drawn for every sample."""

RecipeTable: Any = create_model(
    "RecipeTable", __base__=_Constants, **dict.fromkeys(DRAWN, (Any, None))
)  # type: ignore[call-overload]


@dataclass(frozen=True, eq=False)
class Recipe:
    """A checked recipe. `written` is the content of the file; `names` are those of its scenes or families.

    In both, the families of "all" are listed.

    `random_places` : whether objects get random places or meshes.
    """

    file: Path
    written: Mapping[str, Any]
    seed: int
    count: int
    kind: Literal["scene", "family"]
    names: tuple[str, ...]
    weights: tuple[float, ...] | None
    drawn: Mapping[str, Any]
    ndisp: int | None
    keep: tuple[str, ...]
    gates: Gates
    splits: Mapping[str, float]
    sources: Sources
    random_places: bool = False

    @property
    def varied_scenes(self) -> bool:
        """Whether samples have scenes of their own: of a family, or with objects that are drawn."""
        drawn = any(leaf.key.startswith("scene.objects") for leaf in leaves(self.drawn))
        return self.kind == "family" or self.random_places or drawn


def read_recipe(
    path: str | os.PathLike[str], changes: Mapping[str, Any] | None = None
) -> Recipe:
    """Read a recipe, with some keys changed. Raises InputError naming the file, the key, and what is allowed."""
    path = Path(path)
    return recipe_from_table({**read_toml(path), **(changes or {})}, path)


def recipe_from_table(
    written: Mapping[str, Any], path: Path = Path("recipe.toml")
) -> Recipe:
    """The recipe of a table as TOML has it; `path` is named in messages, and other files are relative to it."""
    table = read(RecipeTable, dict(written), path, context=path.parent)
    names = table.families or table.scenes
    if table.families is not None:
        # Datasets record the families by name: another version may have more of them.
        written = {**written, "families": table.families}
    assets_table = table.assets.model_dump(exclude_none=True)
    keep = {
        key: assets_table.pop(key)
        for key in ("keep_scale", "keep_material", "mesh_share")
    }
    assets = {kind: tuple(folders) for kind, folders in assets_table.items()}
    drawn = {key: template(written[key], path, key) for key in DRAWN if key in written}
    _check_per_scene(drawn, len(names), path)
    named, skies, random_places = _check_drawn(drawn, path, table)
    sources = Sources(
        path.parent, tuple(table.scenes or ()), assets, named, skies, **keep
    )
    _check_credits(table.about or {}, sources, path)
    weights = None
    if table.weights is not None:
        weights = tuple(map(float, normalized(table.weights, len(names))))
    return Recipe(
        file=path,
        written=dict(written),
        seed=table.seed,
        count=table.count,
        kind="scene" if table.families is None else "family",
        names=tuple(names),
        weights=weights,
        drawn=drawn,
        ndisp=table.ndisp,
        keep=tuple(table.keep),
        gates=table.gates,
        splits=table.splits or {},
        sources=sources,
        random_places=random_places,
    )


def _check_per_scene(drawn: Mapping[str, Any], count: int, path: Path) -> None:
    """Raise InputError unless each list of `per_scene` has as many values as there are scenes or families."""
    for leaf in leaves(drawn):
        if leaf.kind == "per_scene" and len(leaf.distribution.values) != count:
            raise InputError(
                f"{path}: {leaf.key}: per_scene needs {counted(count, 'value')}, one for each scene or family of the "
                f"recipe, got {len(leaf.distribution.values)}"
            )


def _check_credits(about: Mapping[str, Any], sources: Sources, path: Path) -> None:
    """Raise InputError for a credit that covers no file of the recipe."""
    for k, credit in enumerate(About.of(about).credits):
        if not any(map(credit.covers, sources.files)):
            raise InputError(
                f"{path}: about.credits[{k}].files: {credit.files!r} is none of the recipe's files"
            )


@dataclass(frozen=True)
class _Corner:
    """A checked corner of a template: its settings, its lenses, and the files of its objects.

    object_files : by name, whether the object is the recipe's own file.
    """

    settings: RecipeSettings
    lenses: list[RecipeLens]
    object_files: Mapping[str, bool]

    @property
    def has_random_places(self) -> bool:
        """Whether objects get random places or meshes."""
        tables = itertools.chain.from_iterable(self.objects.values())
        return any({"resting_on", "folder"} & table.keys() for table in tables)

    @property
    def objects(self) -> Mapping[str, Any]:
        return self.settings.scene.objects

    @property
    def named_files(self) -> list[str]:
        """The masks of apertures, the patterns of projectors and the calibration, as the recipe names them."""
        shapes = [getattr(lens, "shape", None) for lens in self.settings.lenses]
        masks = [
            shape.file
            for shape in shapes
            if isinstance(shape, MaskTable) and shape.file
        ]
        return [*masks, *file_names(self.settings.rig)]


def _check_corner(table: Mapping[str, Any], path: Path, recipe: Any) -> _Corner:
    """Check one corner of a template, alone. Raises InputError."""
    families = recipe.families or []
    scenes = [_scene_file(path.parent / name, name) for name in recipe.scenes or ()]
    settings, lenses = check_settings(table, path, families)
    for name in settings.scene.objects:
        written = table["scene"]["objects"][name]
        if not isinstance(written, Mapping):
            raise InputError(
                f"{path}: scene.objects.{name}: must be one table, got {format_value(written)}"
            )
    files = check_objects(settings.scene.objects, scenes or families, path)
    return _Corner(settings, lenses, files)


def _check_drawn(
    drawn: Mapping[str, Any], path: Path, recipe: Any
) -> tuple[dict[str, bool], tuple[str, ...], bool]:
    """Check the `corners` of a template.

    Returns the files that lenses and objects name, those of skies, and whether it has objects at random places.
    """
    checked = []
    for table in corners(drawn):
        try:
            checked.append(_check_corner(table, path, recipe))
        except InputError as error:
            message = str(error).removeprefix(f"{path}: ")
            raise type(error)(f"{error}{hint(message, drawn)}") from error
    _check_effects(checked, path, recipe.gates)
    files: dict[str, bool] = {}
    for corner in checked:
        files |= {Path(name).as_posix(): False for name in corner.named_files}
    for corner in checked:
        for name, is_own in corner.object_files.items():
            files[name] = files.get(name, False) or is_own
    skies = dict.fromkeys(
        corner.settings.sky.file for corner in checked if corner.settings.sky
    )
    for name in skies:
        with located(f"{path}: sky.file"):
            _check_listed("hdris", name, path.parent)
    random_places = any(corner.has_random_places for corner in checked)
    return files, tuple(skies), random_places


def _check_effects(checked: list[_Corner], path: Path, gates: Gates) -> None:
    """Refuse a limit of the noise that is not measured, and options that need an aperture that no lens has."""
    for corner in checked:
        settings = corner.settings
        is_measured = settings.spp >= 2 and (settings.denoise or settings.noise)
        if gates.noise is not None and not is_measured:
            raise InputError(
                f"{path}: gates.noise: the noise is measured with spp >= 2 and denoise = true or noise only"
            )
    lenses = itertools.chain.from_iterable(corner.lenses for corner in checked)
    if any(lens.aperture_diameter > 0 for lens in lenses):
        return
    for key in ("diffraction", "dual_pixel"):
        if any(getattr(corner.settings, key) for corner in checked):
            remedy = "add [[lenses]] with an aperture or remove it"
            raise InputError(
                f"{path}: {key}: has no effect, every lens is a pinhole; {remedy}"
            )


def _scene_file(path: Path, name: str) -> Path:
    path = bundled_folder() / name if name in bundled_scenes() else path
    return path / "scene.toml" if path.is_dir() else path


def differences(
    old: Mapping[str, Any], new: Mapping[str, Any], key: str = ""
) -> list[str]:
    """Where two recipes differ: one `key: old -> new` each. `count` and `about` may differ.

    >>> differences({"spp": 16, "rig": {"baseline": 0.1}}, {"spp": 16, "rig": {"baseline": 0.2}})
    ['rig.baseline: 0.1 -> 0.2']
    """
    changes = []
    for name in dict.fromkeys([*old, *new]):
        path = f"{key}.{name}" if key else str(name)
        if path in ("count", "about"):
            continue
        a, b = old.get(name), new.get(name)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            changes += differences(a, b, path)
        elif a != b:
            texts = (
                format_value(table[name]) if name in table else "absent"
                for table in (old, new)
            )
            changes.append(f"{path}: {' -> '.join(texts)}")
    return changes
