"""Settings that are declared once: frozen dataclasses whose fields state their meaning, unit and range.

    @dataclass(frozen=True)
    class Exposure(Settings, noun="exposure"):
        time: Annotated[float, Setting("Exposure time.", "seconds", least=1e-30, most=1e9)]

Everything else reads this declaration: construction in Python (`Settings`), recipes, records and their JSON Schemas
(`schema.table_of`), `NAME=VALUE` texts (`parse_pairs`) and options of commands (`cli.options.setting`). Imports no
library, so that every room can declare its settings.
"""

import dataclasses
import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Collection, Iterable, Mapping
from numbers import Integral, Real
from typing import Any, ClassVar, Self

from twinlens.errors import (
    InputError,
    as_float,
    check_known,
    format_value,
    nearest,
    unknown,
)

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
"""A finite decimal number in a text."""

_WORDS = {"true": True, "yes": True, "on": True, "1": True}
_WORDS |= {"false": False, "no": False, "off": False, "0": False}
_COUNTS = {2: "two", 3: "three", 4: "four"}


@dataclasses.dataclass(frozen=True)
class Setting:
    """What a field of `Settings` means and which values it may have; the metadata of an `Annotated` type.

    help : one sentence.
    unit : plural, as "seconds"; empty for factors and names.
    least, above, most, below : limits of a number, or of each number of a tuple. `least` and `most` are allowed.
    choices : the allowed strings or whole numbers, if these are few.
    infinite : whether a number may be infinite.
    or_zero : whether 0 is allowed although it is outside the limits.
    odd : whether a whole number must be odd.
    """

    help: str
    unit: str = ""
    _: dataclasses.KW_ONLY
    least: float = -math.inf
    above: float = -math.inf
    most: float = math.inf
    below: float = math.inf
    choices: Collection[Any] = ()
    infinite: bool = False
    or_zero: bool = False
    odd: bool = False

    @property
    def range(self) -> str:
        """The limits in words, such as "from 0 to 10" or "> 0"; empty without limits."""
        words = self._limits
        if self.infinite:
            words += ", or inf"
        return f"{words}, or 0" if self.or_zero else words

    @property
    def _limits(self) -> str:
        if math.isfinite(self.least) and math.isfinite(self.most):
            return f"from {_digits(self.least)} to {_digits(self.most)}"
        if math.isfinite(self.least) and math.isfinite(self.below):
            return f"from {_digits(self.least)} to below {_digits(self.below)}"
        limits = {
            ">": self.above,
            ">=": self.least,
            "<": self.below,
            "<=": self.most,
        }
        return " and ".join(
            f"{sign} {_digits(limit)}"
            for sign, limit in limits.items()
            if math.isfinite(limit)
        )

    def admits(self, number: float) -> bool:
        """Whether a number is within the limits; NaN never is."""
        if self.or_zero and number == 0:
            return True
        if math.isinf(number) and not self.infinite:
            return False
        if self.odd and number % 2 != 1:
            return False
        in_open_limits = (self.above < number or math.isinf(self.above)) and (
            number < self.below or math.isinf(self.below)
        )
        return in_open_limits and self.least <= number <= self.most


@dataclasses.dataclass(frozen=True)
class Field:
    """A declared field: its name, type without None, whether it may be None, `Setting` and default, ... for none."""

    name: str
    kind: Any
    optional: bool
    setting: Setting
    default: Any = ...

    @property
    def required(self) -> bool:
        return self.default is ...

    @property
    def length(self) -> int:
        """The number of entries of a tuple of fixed length, or 0."""
        return len(self._entries)

    @property
    def _entries(self) -> tuple[Any, ...]:
        entries = typing.get_args(self.kind)
        is_fixed = typing.get_origin(self.kind) is tuple and Ellipsis not in entries
        return entries if is_fixed else ()

    @property
    def is_plain(self) -> bool:
        """Whether a value is a number, a bool, a string or a tuple of numbers, and not an object."""
        return self.kind in (float, int, bool, str) or self.length > 0

    @property
    def allowed(self) -> str:
        """The allowed values in words, which complete "must be"."""
        words = self._allowed_kind
        return f"{words}, or none" if self.optional else words

    @property
    def _allowed_kind(self) -> str:
        if self.setting.choices:
            return f"one of {', '.join(map(str, self.setting.choices))}"
        if self.kind is bool:
            return "true or false"
        if self.kind is str:
            return "a string"
        if not self.is_plain:
            return _class_names(self.kind)
        return self._allowed_numbers

    @property
    def _allowed_numbers(self) -> str:
        setting = self.setting
        if self.length:
            words = f"{_COUNTS[self.length]} numbers"
        else:
            words = "a whole number" if self.kind is int else "a number"
        if setting.odd:
            words = "an odd whole number"
        if setting.unit:
            words += f" of {setting.unit}"
        if setting.range:
            words += f" {setting.range}"
        elif self.kind is float and not setting.infinite:
            words = words.replace("a number", "a finite number", 1)
        return words

    @property
    def note(self) -> str:
        """The unit and the range, for help texts: "seconds, > 0"; empty without both."""
        words = self.setting.range.removeprefix("from ")
        if self.kind is int and self.setting.choices:
            words = " or ".join(map(str, self.setting.choices))
        return ", ".join(part for part in (self.setting.unit, words) if part)

    def checked(self, value: Any, noun: str = "") -> Any:
        """`value`, a tuple where the field is one. Raises InputError, which `noun` begins, unless it is allowed."""
        if value is None and self.optional:
            return None
        if self.length:
            numbers = _as_floats(value)
            if len(numbers) == self.length and all(map(self.setting.admits, numbers)):
                return numbers
        elif self._admits(value):
            return value
        raise self.error(value, noun)

    def error(self, value: Any, noun: str = "") -> InputError:
        """The error for a value that is not allowed, with the nearest of the choices."""
        name = f"{noun} {self.name} " if noun else ""
        near = None
        if isinstance(value, str) and self.kind is str:
            near = nearest(value, self.setting.choices)
        hint = f"; did you mean {near!r}?" if near else ""
        if self.setting.odd and isinstance(value, Integral) and value % 2 == 0:
            hint = f"; use {value - 1} or {value + 1}"
        return InputError(
            f"{name}must be {self.allowed}, got {format_value(value)}{hint}"
        )

    def _admits(self, value: Any) -> bool:
        if self.kind is float:
            is_number = isinstance(value, Real) and not _is_bool(value)
            return is_number and self.setting.admits(as_float(value))
        if self.kind is int:
            is_whole = isinstance(value, Integral) and not _is_bool(value)
            return (
                is_whole
                and self._is_choice(value)
                and self.setting.admits(as_float(value))
            )
        if self.kind is bool:
            return _is_bool(value)
        if self.kind is str:
            return isinstance(value, str) and self._is_choice(value)
        return _is_instance(value, self.kind)

    def _is_choice(self, value: Any) -> bool:
        return not self.setting.choices or value in self.setting.choices

    def read(self, value: Any) -> Any:
        """A plain value, as TOML and JSON have it: whole numbers become floats, and lists become tuples."""
        value = self.checked(value)
        return float(value) if self.kind is float and value is not None else value

    def in_unit(self, unit: str, scale: float) -> "Field":
        """The field of a number in another unit: values and limits are multiplied by `scale`."""
        setting = dataclasses.replace(
            self.setting,
            unit=unit,
            least=self.setting.least * scale,
            above=self.setting.above * scale,
            most=self.setting.most * scale,
            below=self.setting.below * scale,
        )
        return dataclasses.replace(self, setting=setting)

    def parse(self, text: str) -> Any:
        """The plain value of a text; the text itself where it cannot be read, which `checked` then refuses."""
        if self.optional and text == "none":
            return None
        if self.kind is bool:
            return _WORDS.get(text.lower(), text)
        if self.kind is int:
            return _parse_whole(text)
        if self.kind is float:
            return parse_number(text)
        if self.length:
            return [parse_number(part) for part in text.split("/")]
        return text


class Settings:
    """Base of the frozen dataclasses whose fields are declared by a `Setting`.

    Construction checks every declared field. Messages begin with the `noun` of the class. The docstring of a class is
    completed by a list of its declared fields.
    """

    noun: ClassVar[str] = ""

    def __init_subclass__(cls, noun: str = "", **rest: Any) -> None:
        super().__init_subclass__(**rest)
        if noun:
            cls.noun = noun
        lines = [f"{name} : {setting.help}" for name, setting in _own_settings(cls)]
        if lines and cls.__doc__:
            cls.__doc__ = "\n\n".join([inspect.cleandoc(cls.__doc__), "\n".join(lines)])

    def __post_init__(self) -> None:
        for name, field in fields_of(type(self)).items():
            value = getattr(self, name)
            checked = field.checked(value, self.noun)
            if checked is not value:
                object.__setattr__(self, name, checked)

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields changed, checked again. Raises InputError for an unknown field."""
        names = [item.name for item in dataclasses.fields(self) if item.init]  # type: ignore[arg-type]
        for name in changes:
            check_known(f"{self.noun} field", name, names)
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]


_FIELDS: dict[type[Any], Mapping[str, Field]] = {}


def fields_of(cls: type[Any]) -> Mapping[str, Field]:
    """The declared fields of a dataclass by name, in order."""
    if cls not in _FIELDS:
        _FIELDS[cls] = _read_fields(cls)
    return _FIELDS[cls]


def _read_fields(cls: type[Any]) -> Mapping[str, Field]:
    hints = typing.get_type_hints(cls, include_extras=True)
    fields = {}
    for item in dataclasses.fields(cls):
        setting = _setting_of(hints[item.name])
        if setting is None or not item.init:
            continue
        kind = typing.get_args(hints[item.name])[0]
        default = ... if item.default is dataclasses.MISSING else item.default
        if item.default_factory is not dataclasses.MISSING:
            default = item.default_factory()
        fields[item.name] = Field(
            item.name,
            _without_none(kind),
            kind != _without_none(kind),
            setting,
            default,
        )
    return fields


def parse_pairs(
    text: str, fields: Mapping[str, Field], form: str = "NAME=VALUE,NAME=VALUE"
) -> dict[str, Any]:
    """The plain values of `a=1,b=2` by their names. A / separates the numbers of a tuple.

    form : describes the text in errors. Raises InputError for an unknown name and for one that is given twice; values
    are checked where they are used.
    """
    values: dict[str, Any] = {}
    for part in text.split(","):
        name, _, value = (piece.strip() for piece in part.partition("="))
        if not (name and value):
            raise InputError(f"must be {form}; got {part!r}")
        if name in values:
            raise InputError(f"{name} is given twice")
        if name not in fields:
            raise unknown("parameter", name, fields)
        values[name] = fields[name].parse(value)
    return values


def _own_settings(cls: type[Any]) -> Iterable[tuple[str, Setting]]:
    for name, hint in inspect.get_annotations(cls).items():
        if setting := _setting_of(hint):
            yield name, setting


def _setting_of(hint: Any) -> Setting | None:
    for item in getattr(hint, "__metadata__", ()):
        if isinstance(item, Setting):
            return item
    return None


def _without_none(kind: Any) -> Any:
    """The members of a union without None."""
    if typing.get_origin(kind) not in (typing.Union, types.UnionType):
        return kind
    members = [
        member for member in typing.get_args(kind) if member is not types.NoneType
    ]
    return typing.Union[tuple(members)]  # noqa: UP007  of members known at run time


def _class_names(kind: Any) -> str:
    """The classes of a union in words: "a Disk or a Polygon", "a tuple of Mismatch"."""
    members = typing.get_args(kind)
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return " or ".join(_class_names(member) for member in members)
    if typing.get_origin(kind) is tuple:
        return f"a tuple of {members[0].__name__}"
    article = "an" if kind.__name__[0] in "AEIOU" else "a"
    return f"{article} {kind.__name__}"


def _is_instance(value: Any, kind: Any) -> bool:
    origin = typing.get_origin(kind)
    if origin in (typing.Union, types.UnionType):
        return any(_is_instance(value, member) for member in typing.get_args(kind))
    if origin is Callable:
        return callable(value)
    if origin is tuple:
        entry = typing.get_args(kind)[0]
        return isinstance(value, tuple) and all(_is_instance(v, entry) for v in value)
    return isinstance(value, kind)


def _is_bool(value: Any) -> bool:
    # NumPy is not imported here; its bool is neither Real nor a subclass of bool
    return isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")


def _as_floats(values: Any) -> tuple[float, ...]:
    """The values of a sequence as floats, NaN for others; empty if it is no sequence of values."""
    if isinstance(values, (str, bytes, Mapping)):
        return ()
    try:
        return tuple(as_float(value) for value in values)
    except TypeError:
        return ()


def parse_number(text: str) -> float | str:
    """The number of a text, which spaces may surround, or the text where it is none."""
    return float(text) if re.fullmatch(f"{NUMBER}|[-+]?inf", text.strip()) else text


def _parse_whole(text: str) -> int | str:
    """The whole number of a text, also of "6.0", or the text where it is none."""
    whole = re.fullmatch(r"([-+]?[0-9]+)(\.0*)?", text.strip())
    return int(whole[1]) if whole else text


def _digits(limit: float) -> str:
    return f"{limit:g}" if isinstance(limit, float) else str(limit)
