"""Lenses and apertures as recipes and the command line write them.

A recipe has lengths of lenses in millimetres, and a focus distance in metres or by name. A lens without a spelling of
its own here is written with the fields of its class: `kind = "NAME"` and its fields in a recipe, where `aperture` is a
table as `shape` is for others, and `NAME:FIELD=VALUE,...` on the command line, where --aperture has the shape.
"""

import math
import re
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import numpy as np
from pydantic import BeforeValidator, Field, PlainValidator, model_validator

from twinlens.camera import (
    Annulus,
    Camera,
    Disk,
    MaskAperture,
    Pinhole,
    Polygon,
    RecipeLens,
    ThinLens,
)
from twinlens.camera.aperture import FULL_DISK, Aperture
from twinlens.camera.lens import F_NUMBER, BareAperture
from twinlens.camera.truth import Truth
from twinlens.dataset import read_image
from twinlens.errors import (
    FileError,
    InputError,
    format_value,
    located,
    nearest,
    unknown,
)
from twinlens.optics import middle_focus
from twinlens.scenes import Scene
from twinlens.schema import Declared, Fraction, StrictModel, read, setting, table_of
from twinlens.seeds import generator
from twinlens.settings import (
    NUMBER,
    Field as DeclaredField,
    Setting,
    fields_of,
    parse_number,
    parse_pairs,
)

_Side = Field(min_length=1, max_length=4096)
Find = Callable[[str], Path]
"""The path of a file that a lens names."""


@dataclass(frozen=True)
class View:
    """What a lens is made for: the camera behind it, the scene in front, and a seed for choosing what to focus on."""

    scene: Scene
    camera: Camera
    truths: Sequence[Truth]
    seed: int = 0


class MaskTable(StrictModel):
    """A grey picture, or its numbers: rows from the top, 0 closed, 1 open."""

    kind: Literal["mask"]
    file: str | None = None
    cells: Annotated[list[Annotated[list[Fraction], _Side]], _Side] | None = None

    @model_validator(mode="after")
    def _check(self) -> "MaskTable":
        if (self.file is None) == (self.cells is None):
            raise InputError(
                "a mask needs exactly one of 'file' (a grey image) and 'cells' (rows of numbers, 0 to 1)"
            )
        if self.file is not None and not (self.file and self.file.isprintable()):
            raise InputError(
                f"file must be the name of a picture next to the recipe, got {format_value(self.file)}"
            )
        return self


_DISK: Any = table_of(Disk, kind=(Literal["disk"], ...))
_POLYGON: Any = table_of(Polygon, kind=(Literal["polygon"], ...))
_ANNULUS: Any = table_of(Annulus, kind=(Literal["annulus"], ...))
ShapeTable: Any = Annotated[
    _DISK | _POLYGON | _ANNULUS | MaskTable, Field(discriminator="kind")
]
"""The shape of an aperture: the aperture, or a mask whose file is read later."""

_LEAST_SEEN = 0.005  # of the image: an object that is large enough to focus on
_Aperture = Annotated[float, setting(ThinLens, "aperture_diameter", "millimetres", 1e3)]
_FOCUS_NAMES = ("near", "middle", "far", "centre", "object")
_FOCUS_DISTANCE = fields_of(ThinLens)["focus_distance"]


def _read_focus(value: Any) -> Any:
    if not isinstance(value, str):
        return _FOCUS_DISTANCE.read(value)
    if value not in _FOCUS_NAMES:
        names = ", ".join(_FOCUS_NAMES)
        near = nearest(value, _FOCUS_NAMES)
        hint = f"; did you mean {near!r}?" if near else ""
        raise InputError(
            f"must be metres as a number, such as 2.5 or inf, or one of {names}, got {value!r}{hint}"
        )
    return value


Focus = Annotated[
    float | str,
    PlainValidator(
        _read_focus,
        json_schema_input_type=Annotated[float, Declared(_FOCUS_DISTANCE)]
        | Literal[_FOCUS_NAMES],
    ),
]
"""A depth in metres, or a name in `FOCUSES`."""


class ThinTable(StrictModel):
    """A thin lens by its aperture or its f-number."""

    kind: Literal["thin"]
    aperture_mm: _Aperture | None = None
    f_number: Annotated[float, Declared(F_NUMBER)] | None = None
    focus: Focus = "middle"
    shape: ShapeTable = Field(default_factory=Disk)

    @model_validator(mode="after")
    def _check(self) -> "ThinTable":
        if (self.aperture_mm is None) == (self.f_number is None):
            raise InputError(
                "a thin lens needs exactly one of 'aperture_mm' and 'f_number'"
            )
        return self


class HoleTable(StrictModel):
    """A bare hole, without a lens."""

    kind: Literal["hole"]
    aperture_mm: _Aperture
    film_mm: Annotated[
        float, setting(BareAperture, "film_distance", "millimetres", 1e3)
    ]
    shape: ShapeTable = Field(default_factory=Disk)


SPELLINGS: dict[str, Any] = {
    "pinhole": table_of(Pinhole, kind=(Literal["pinhole"], "pinhole")),
    "thin": ThinTable,
    "hole": HoleTable,
}
"""The tables of recipes for the lenses that are not written by the fields of their class, by `kind`."""
_SPELLED = (Pinhole, ThinLens, BareAperture)


def lens_tables(
    lenses: Iterable[type[Any]] = typing.get_args(RecipeLens),
) -> dict[str, Any]:
    """The type of the table of each kind of lens; those without a spelling have the fields of their class."""
    tables = dict(SPELLINGS)
    for lens in lenses:
        if lens not in _SPELLED:
            tables[lens.name] = _table_of_fields(lens)
    return tables


@dataclass(frozen=True)
class _ShapedLens:
    """The class of a lens with an aperture, its fields, and the table of the aperture, whose mask may be in a file."""

    lens: type[Any]
    values: Mapping[str, Any]
    aperture: Any


def _table_of_fields(lens: type[Any]) -> Any:
    """The type of the table of a lens with the fields of its class."""
    keys: dict[str, Any] = {"kind": (Literal[lens.name], ...)}
    if "aperture" not in fields_of(lens):
        return table_of(lens, **keys)

    def shaped(kind: str, aperture: Any = FULL_DISK, **values: Any) -> _ShapedLens:
        return _ShapedLens(lens, values, aperture)

    keys["aperture"] = (ShapeTable, Field(default_factory=Disk))
    return table_of(lens, shaped, **keys)


def lens_table(tables: Mapping[str, Any]) -> Any:
    """The type of the table of a lens of any kind."""
    union: Any = Union[tuple(tables.values())]  # noqa: UP007  of types made at run time
    return Annotated[union, Field(discriminator="kind")]


LensTable: Any = lens_table(lens_tables())


def make_lens(table: Any, view: View | None, find: Find = Path) -> RecipeLens:
    """The lens of a LensTable. Without a view, a focus that depends on the scene is 1 m: enough to check the table."""
    if isinstance(table, _ShapedLens):
        made = make_aperture(table.aperture, find)
        return table.lens(**table.values, aperture=made)  # type: ignore[no-any-return]
    if not isinstance(table, (ThinTable, HoleTable)):
        return table  # type: ignore[no-any-return]  # a lens
    shape = make_aperture(table.shape, find)
    if isinstance(table, HoleTable):
        return BareAperture(1e-3 * table.aperture_mm, 1e-3 * table.film_mm, shape)
    focus = table.focus
    if isinstance(focus, str):
        focus = FOCUSES[focus](view) if view else 1.0
        if view and not 0 < focus < math.inf:
            where = f"in scene {view.scene.name!r}"
            raise InputError(
                f"focus {table.focus!r} finds nothing to focus on {where}; give metres instead"
            )
    if table.aperture_mm is not None:
        return ThinLens(1e-3 * table.aperture_mm, focus, shape)
    film_distance = view.camera.film_distance if view else 1e-3
    return ThinLens.from_f_number(table.f_number or 1.0, focus, film_distance, shape)


def make_aperture(shape: Any, find: Find = Path) -> Aperture:
    """The aperture of a ShapeTable. The picture of a mask is grey: white is open, black closed. Raises FileError."""
    if not isinstance(shape, MaskTable):
        return shape  # type: ignore[no-any-return]
    if shape.file is None:
        return MaskAperture(shape.cells or [])
    path = find(shape.file)
    mask = read_image(path)
    if mask.ndim == 3:
        if not (mask == mask[..., :1]).all():
            raise FileError(
                f"{path}: is coloured; an aperture mask is a grey picture, white where light passes"
            )
        mask = mask[..., 0]
    try:
        return MaskAperture(np.ascontiguousarray(mask))
    except InputError as error:
        raise FileError(f"{path}: {error}") from error


def _known_range(view: View) -> tuple[float, float]:
    """The scene's depth range, or that of the first view."""
    if view.scene.depth_range_known:
        return view.scene.depth_range
    depth = view.truths[0].depth[view.truths[0].hit]
    if depth.size:
        return (float(depth.min()), float(depth.max()))
    return (math.inf, math.inf)


def _object(view: View) -> float:
    """The median depth of a random object that covers enough of the first view."""
    truth = view.truths[0]
    pixels = np.bincount(truth.object_id.ravel(), minlength=2)
    pixels[0] = 0
    seen = np.flatnonzero(pixels >= _LEAST_SEEN * truth.object_id.size)
    if not seen.size:
        return math.inf
    chosen = seen[generator(view.seed, "focus").integers(seen.size)]
    return float(np.median(truth.depth[truth.object_id == chosen]))


FOCUSES: dict[str, Callable[[View], float]] = {
    "near": lambda view: _known_range(view)[0],
    "middle": lambda view: middle_focus(*_known_range(view)),
    "far": lambda view: _known_range(view)[1],
    "centre": lambda view: float(
        view.truths[0].depth[tuple(side // 2 for side in view.truths[0].depth.shape)]
    ),
    "object": _object,
}
"""Focus distances by name: of the scene's depth range, of the first view's central pixel, or of some object in it."""


def _as_list(value: Any) -> Any:
    if isinstance(value, Mapping):
        raise InputError(
            "must be a list of tables: write [[lenses]] above each lens, not [lenses]"
        )
    return value


Lenses = Annotated[
    list[LensTable], Field(min_length=1, max_length=100), BeforeValidator(_as_list)
]


_FOCUS = rf"(?:@(?P<focus>{NUMBER}|[-+]?inf))?"
_FORMS = {
    "pinhole": ("pinhole", "pinhole"),
    "thin": ("thin:DIAMETER_MM[@FOCUS_M]", f"thin:(?P<aperture_mm>[^@]+){_FOCUS}"),
    "f/": ("f/N[@FOCUS_M]", f"f/(?P<f_number>[^@]+){_FOCUS}"),
    "hole": (
        "hole:DIAMETER_MM@FILM_MM",
        "hole:(?P<aperture_mm>[^@]+)@(?P<film_mm>[^@]+)",
    ),
}


def lens_forms(
    lenses: Iterable[type[Any]] = typing.get_args(RecipeLens),
) -> dict[str, str]:
    """How each kind of lens is written on the command line: those of `_FORMS`, then lenses with their fields."""
    forms = {kind: form for kind, (form, _) in _FORMS.items()}
    for lens in lenses:
        if lens not in _SPELLED:
            forms[lens.name] = f"{lens.name}:{_pairs_form(lens)}"
    return forms


def _pairs_form(lens: type[Any]) -> str:
    """The fields of a lens that a text can give, those with a default in brackets: `width=METRES[,bend=VALUE]`."""
    form = ""
    for field in _plain_fields(lens):
        unit = field.setting.unit
        value = unit.upper() if unit.isalpha() else "VALUE"  # not for "1/m"
        pair = f"{',' if form else ''}{field.name}={value}"
        form += pair if field.required else f"[{pair}]"
    return form


def _plain_fields(lens: type[Any]) -> list[DeclaredField]:
    return [field for field in fields_of(lens).values() if field.is_plain]


LENS_HELP = (
    " | ".join(lens_forms().values()) + "; may be given several times. "
    "The default focus is at the middle of the scene's disparities."
)
_FILE = DeclaredField(
    "file", str, False, Setting("A grey image, white where light passes.")
)
_APERTURES: dict[str, tuple[str, Mapping[str, DeclaredField]]] = {
    "disk": ("disk", {}),
    "polygon": ("polygon:BLADES[:ROTATION_DEG[:ROUNDNESS]]", fields_of(Polygon)),
    "annulus": ("annulus:INNER", fields_of(Annulus)),
    "mask": ("mask:FILE", {"file": _FILE}),
}
APERTURE_HELP = (
    " | ".join(form for form, _ in _APERTURES.values())
    + ". Shape of the opening of every lens and hole. "
    "ROUNDNESS is 0 to 1, INNER a fraction of the radius, FILE a grey image, white where light passes."
)


def parse_lens(
    text: str,
    view: View,
    aperture: Aperture | None = None,
    lenses: Iterable[type[Any]] = typing.get_args(RecipeLens),
) -> RecipeLens:
    """A lens in the syntax of LENS_HELP; `aperture` is the shape of its opening.

    lenses : the classes of lenses; those without a form of their own have that of `lens_forms`.

    Raises InputError where the text has no focus distance and the scene no depth range.
    """
    where = f"--lens {text!r}"
    kind = "f/" if text.startswith("f/") else text.partition(":")[0]
    of_fields = {lens.name: lens for lens in lenses if lens not in _SPELLED}
    if kind in of_fields:
        return _with_shape(_lens_of_fields(of_fields[kind], text, where), aperture)
    if kind not in _FORMS:
        if meant := re.fullmatch(r"[fF]/?([0-9.].*)", text):
            raise InputError(
                f"{where}: an f-number is f/N[@FOCUS_M]; did you mean 'f/{meant[1]}'?"
            )
        forms = lens_forms(lenses)
        raise InputError(
            f"{where}: {unknown('lens', kind, forms)}; a lens is one of {' | '.join(forms.values())}"
        )
    table = _table_of_form(kind, text, where)
    needs_focus = kind in ("thin", "f/") and "focus" not in table
    if needs_focus and not view.scene.depth_range_known:
        raise InputError(
            f"{where}: the scene has no depth range; add the focus distance, such as {text}@2.5"
        )
    checked = read(LensTable, table, where)
    with located(where):
        lens = make_lens(checked, view)
    return _with_shape(lens, aperture)


def _table_of_form(kind: str, text: str, where: str) -> dict[str, Any]:
    """The table of a lens in one of `_FORMS`. Raises InputError where the text does not have that form."""
    form, pattern = _FORMS[kind]
    match = re.fullmatch(pattern, text)
    if match is None:
        raise InputError(f"{where}: must be {form}")
    table: dict[str, Any] = {"kind": "thin" if kind == "f/" else kind}
    for key, value in match.groupdict().items():
        if value is None:
            continue
        number = parse_number(value)
        if isinstance(number, str):
            raise InputError(f"{where}: must be {form}, and {value!r} is no number")
        table[key] = number
    return table


def _lens_of_fields(lens: type[Any], text: str, where: str) -> RecipeLens:
    """A lens in the syntax `NAME:FIELD=VALUE,...`."""
    name, _, rest = text.partition(":")
    plain = {field.name: field for field in _plain_fields(lens)}
    values: dict[str, Any] = {"kind": name}
    with located(where):
        if rest:
            values |= parse_pairs(rest, plain, f"{name}:{_pairs_form(lens)}")
    table = read(_table_of_fields(lens), values, where)
    with located(where):
        return make_lens(table, None)


def _with_shape(lens: RecipeLens, aperture: Aperture | None) -> RecipeLens:
    """The lens with the shape of --aperture. Raises InputError for an open lens whose shape is fixed."""
    if aperture is None or isinstance(lens, Pinhole):
        return lens
    if "aperture" in fields_of(type(lens)):
        return lens.replace(aperture=aperture)
    if aperture != FULL_DISK:
        raise InputError(f"--aperture: the shape of the lens {lens.name!r} is fixed")
    return lens


def parse_aperture(text: str) -> Aperture:
    """An aperture's shape in the syntax of APERTURE_HELP."""
    where = f"--aperture {text!r}"
    kind, _, rest = text.partition(":")
    if kind not in _APERTURES:
        raise InputError(f"{where}: {unknown('aperture', kind, _APERTURES)}")
    form, fields = _APERTURES[kind]
    parts: list[str] = []
    if rest:
        parts = [rest] if kind == "mask" else rest.split(":")
    if len(parts) > len(fields) or (fields and not parts):
        raise InputError(f"{where}: must be {form}")
    values = {
        field.name: field.parse(part)
        for field, part in zip(fields.values(), parts, strict=False)
    }
    shape = read(ShapeTable, {"kind": kind, **values}, where)
    with located(where):
        return make_aperture(shape)


def format_lens(lens: RecipeLens) -> str:
    """A lens in the syntax of LENS_HELP, lengths to four digits, without the shape of its opening.

    >>> format_lens(ThinLens(aperture_diameter=0.012, focus_distance=2.0))
    'thin:12@2'
    """
    if isinstance(lens, Pinhole):
        return lens.name
    if isinstance(lens, BareAperture):
        return f"hole:{1e3 * lens.diameter:.4g}@{1e3 * lens.film_distance:.4g}"
    if isinstance(lens, ThinLens):
        return f"thin:{1e3 * lens.aperture_diameter:.4g}@{lens.focus_distance:.4g}"
    values = [
        f"{name}={getattr(lens, name)}"
        for name, field in fields_of(type(lens)).items()
        if field.is_plain
    ]
    return f"{lens.name}:{','.join(values)}"
