"""Base class and error messages of the pydantic models that read files.

Models are used only where files are read (scene.toml, recipes, sample.json, boards). `read` turns pydantic's
list of validation errors into one `InputError` of one line: file, key, what is allowed, the value, the nearest key.
"""

import contextlib
import dataclasses
import math
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union

import pydantic
from pydantic_core import core_schema
from typing_extensions import TypeAliasType

from twinlens.errors import InputError, check_known, format_value, nearest
from twinlens.settings import Field, Setting, fields_of

T = TypeVar("T")

Number = Annotated[float, pydantic.AfterValidator(float)]
"""A number. A whole number is converted to float, which pydantic does not do in strict mode."""

Positive = Annotated[float, pydantic.Field(gt=0), pydantic.AfterValidator(float)]
NonNegative = Annotated[float, pydantic.Field(ge=0), pydantic.AfterValidator(float)]
Fraction = Annotated[float, pydantic.Field(ge=0, le=1), pydantic.AfterValidator(float)]


def number(least: float, most: float, above: bool = False) -> Any:
    """The type of a number in [least, most], or in (least, most] if `above`."""
    limits = (
        pydantic.Field(gt=least, le=most)
        if above
        else pydantic.Field(ge=least, le=most)
    )
    return Annotated[float, limits, pydantic.AfterValidator(float)]


def whole(least: int, most: int) -> Any:
    """The type of a whole number from `least` to `most`."""
    return Annotated[int, pydantic.Field(ge=least, le=most)]


class StrictModel(pydantic.BaseModel):
    """A frozen model that rejects unknown keys, NaN, infinity, and values of another type (`1` is not `true`)."""

    model_config = pydantic.ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _reject_unknown_keys(cls, data: Any) -> Any:
        names = [info.alias or name for name, info in cls.model_fields.items()]
        for key in data if isinstance(data, Mapping) else ():
            check_known("key", key, names)
        return data


def variants(
    base: type[StrictModel],
    tag: str,
    tables: Mapping[str, Mapping[str, Any]],
    default: str | None = None,
) -> list[type[StrictModel]]:
    """One model for each entry of `tables`: its name is the value of the key `tag`, its content the types of its keys.

    A key whose type admits None is optional. The model named `default` may be used without its tag.
    """

    def model(name: str, keys: Mapping[str, Any]) -> type[StrictModel]:
        fields: dict[str, Any] = {
            tag: (Literal[name], name if name == default else ...)
        }
        for key, kind in keys.items():
            fields[key] = (kind, None if type(None) in typing.get_args(kind) else ...)
        return pydantic.create_model(name, __base__=base, **fields)

    return [model(name, keys) for name, keys in tables.items()]


def tagged(
    name: str, tag: str, models: Iterable[type[StrictModel]], default: str | None = None
) -> Any:
    """The union of models selected by the key `tag`, `default` if it is missing; JSON Schemas define it as `name`."""
    union: Any = Annotated[Union[tuple(models)], pydantic.Field(discriminator=tag)]  # noqa: UP007
    alias = TypeAliasType(name, union)  # type: ignore[misc]  # the models are made at run time
    if default is None:
        return alias
    return Annotated[
        alias,
        pydantic.BeforeValidator(
            lambda t: {tag: default, **t} if isinstance(t, Mapping) else t
        ),
    ]


def table_of(
    cls: type[Any],
    /,
    make: Callable[..., Any] | None = None,
    *,
    title: str = "",
    **more: Any,
) -> Any:
    """The type of a table with the fields of a dataclass, and `more`, that is read as an instance of the dataclass.

    A field that is declared by a `Setting` is read by it. A nested dataclass is a nested table. A field in `more`,
    (type, default), replaces that of the dataclass. `make` is called with the keys of the table in place of the class,
    which gets its own fields only. JSON Schemas call the table `title`, by default after the class.
    """
    keys = _undeclared(cls) | {
        name: declared(field)
        for name, field in fields_of(cls).items()
        if name not in more
    }

    own_names = {item.name for item in dataclasses.fields(cls)}

    def instance(table: Any) -> Any:
        names_set = (
            table.model_fields_set if make else table.model_fields_set & own_names
        )
        return (make or cls)(**{name: getattr(table, name) for name in names_set})

    model: Any = pydantic.create_model(
        title or f"{cls.__name__}Table", __base__=StrictModel, **{**keys, **more}
    )
    return Annotated[model, pydantic.AfterValidator(instance)]


def _undeclared(cls: type[Any]) -> dict[str, tuple[Any, Any]]:
    """The types and defaults of the fields of a dataclass that no `Setting` declares."""
    hints = typing.get_type_hints(cls)
    keys = {}
    for item in dataclasses.fields(cls):
        kind = Number if hints[item.name] is float else hints[item.name]
        default = ... if item.default is dataclasses.MISSING else item.default
        if item.name not in fields_of(cls):
            keys[item.name] = (kind, default)
    return keys


@dataclasses.dataclass(frozen=True)
class Declared:
    """Reads a plain value by the declaration of a field of settings; the metadata of an `Annotated` type."""

    field: Field

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.no_info_plain_validator_function(self.field.read)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        setting = self.field.setting
        unit = f" [{setting.unit}]" if setting.unit else ""
        return {**_json_type(self.field), "description": f"{setting.help}{unit}"}


def setting(cls: type[Any], name: str, unit: str = "", scale: float = 1.0) -> Declared:
    """Reads one declared field of a dataclass, or that field in another unit, of which one is 1 / `scale`."""
    field = fields_of(cls)[name]
    return Declared(field.in_unit(unit, scale) if unit else field)


def declared(field: Field) -> tuple[Any, Any]:
    """(type, default) of a declared field, for `pydantic.create_model`."""
    default = ... if field.required else field.default
    if field.is_plain:
        kind: Any = Annotated[Any, Declared(field)]
    else:
        described = pydantic.Field(description=field.setting.help)
        kind = Annotated[table_of(field.kind), described]
    return (kind | None if field.optional else kind), default


def _json_type(field: Field) -> dict[str, Any]:
    """The JSON Schema of a plain field, without None."""
    setting = field.setting
    if setting.choices:
        return {"enum": list(setting.choices), "type": _JSON_TYPES[field.kind]}
    if not field.length:
        return {**_json_limits(setting), "type": _JSON_TYPES[field.kind]}
    return {
        "items": {**_json_limits(setting), "type": "number"},
        "maxItems": field.length,
        "minItems": field.length,
        "type": "array",
    }


_JSON_TYPES = {float: "number", int: "integer", bool: "boolean", str: "string"}


def _json_limits(setting: Setting) -> dict[str, float]:
    limits = {
        "exclusiveMaximum": setting.below,
        "exclusiveMinimum": setting.above,
        "maximum": setting.most,
        "minimum": 0.0 if setting.or_zero else setting.least,
    }
    return {name: limit for name, limit in limits.items() if math.isfinite(limit)}


def reads(
    kind: Any, then: Callable[[Any], Any] = lambda checked: checked
) -> pydantic.PlainValidator:
    """Validates against a type made at run time, for `Annotated`; `then` converts the result."""
    adapter: pydantic.TypeAdapter[Any] = pydantic.TypeAdapter(kind)

    def read_value(value: Any, info: pydantic.ValidationInfo) -> Any:
        return then(adapter.validate_python(value, context=info.context))

    return pydantic.PlainValidator(read_value, json_schema_input_type=kind)


def one_of(kind: str, choices: Iterable[str]) -> pydantic.PlainValidator:
    """Restricts a string to the names of a table, for `Annotated`. A short list of names is a `Literal` instead."""
    names = sorted(choices)

    def check(value: Any) -> Any:
        check_known(kind, value, names)
        return value

    return pydantic.PlainValidator(
        check, json_schema_input_type=TypeAliasType(kind.title(), Literal[tuple(names)])
    )


def satisfies(is_valid: Callable[[Any], Any], message: str) -> pydantic.AfterValidator:
    """Refuses values for which `is_valid` is false or raises ValueError; {} in the message is the value."""

    def check(value: Any) -> Any:
        with contextlib.suppress(ValueError):
            if is_valid(value):
                return value
        raise InputError(message.format(format_value(value)))

    return pydantic.AfterValidator(check)


NEAR_FAR = satisfies(
    lambda ends: ends[0] < ends[1],
    "must be [near, far] with near < far, in metres, got {}",
)


def exactly(
    count: int, item: Any, or_one: bool = False, name: str = ""
) -> pydantic.BeforeValidator:
    """Accepts a list of `count` values or, with `or_one`, one value for all; JSON Schemas define it as `name`."""
    listed: Any = Annotated[
        list[item], pydantic.Field(min_length=count, max_length=count)
    ]

    def check(value: Any) -> Any:
        if isinstance(value, list) and len(value) != count:
            raise InputError(_must_be(f"a list of exactly {count} values", value))
        return [value] * count if or_one and not isinstance(value, list) else value

    kind: Any = item | listed if or_one else listed
    return pydantic.BeforeValidator(
        check, json_schema_input_type=TypeAliasType(name, kind) if name else kind
    )


def read(
    model: type[T] | pydantic.TypeAdapter[T],
    data: Any,
    file: str | Path,
    key: str = "",
    context: Any = None,
    strict: bool | None = None,
) -> T:
    """Validate `data`, plain values as TOML or JSON has them, against `model`.

    `key` is the dotted path of `data` within the file. Validators get `context` as `info.context`. `strict` = False
    reads numbers and booleans from text too; by default the model decides.

    Raises InputError for the first error, in one line: file, key, what is allowed, and the value.
    """
    adapter = (
        model
        if isinstance(model, pydantic.TypeAdapter)
        else pydantic.TypeAdapter(model)
    )
    try:
        return adapter.validate_python(data, context=context, strict=strict)
    except pydantic.ValidationError as error:
        raise InputError(
            f"{file}: {_describe(error.errors(include_url=False), data, key)}"
        ) from error
    except RecursionError as error:
        raise InputError(f"{file}: {_at(key, 'nested too deep')}") from error


def dotted(parts: tuple[str | int, ...], start: str = "") -> str:
    """A key path as messages show it: rig.cameras[1].fx."""
    path = start
    for part in parts:
        if isinstance(part, int):
            path += f"[{part}]"
        else:
            name = part if part.isprintable() else repr(part)
            path += f".{name}" if path else name
    return path


def _describe(errors: list[Any], data: Any, start: str) -> str:
    """`key: message` of the first of pydantic's errors.

    An untagged union has one error for each member; that of the member with the value's type is used.
    """
    parts = _key_parts(errors[0]["loc"], data)
    if errors[0]["type"] == "missing":
        missing = [
            e["loc"][-1]
            for e in errors
            if e["type"] == "missing" and e["loc"][:-1] == errors[0]["loc"][:-1]
        ]
        names = ", ".join(repr(str(name)) for name in missing)
        return _at(
            dotted(parts, start),
            f"missing key{'s' if len(missing) > 1 else ''} {names}",
        )
    same = [
        error
        for error in errors
        if _key_parts(error["loc"], data)[: len(parts)] == parts
    ]
    deeper = [
        e
        for e in same
        if e["type"] not in _TYPES or len(_key_parts(e["loc"], data)) > len(parts)
    ]
    error = (deeper or errors)[0]
    parts = _key_parts(error["loc"], data)
    if error["type"] == "union_tag_invalid":
        parts = (*parts, error["ctx"]["discriminator"].strip("'"))
    choices = " or ".join(dict.fromkeys(map(_allowed, same)))
    return _at(
        dotted(parts, start),
        _message(error) if deeper else _must_be(choices, error["input"]),
    )


def _at(where: str, message: str) -> str:
    """`where: message`. "sensor prnu must be > 0" at `sensor`, from a check of the instance, is at `sensor.prnu`."""
    table, name, problem = (*message.split(" ", 2), "", "")[:3]
    if problem.startswith("must be ") and table == where.rpartition(".")[2]:
        return f"{where}.{name}: {problem}"
    return f"{where}: {message}" if where else message


def _key_parts(location: tuple[str | int, ...], data: Any) -> tuple[str | int, ...]:
    """The parts of a location that are keys of the data; the others name the members of unions.

    A part that is a value of its table names the member that this value selects, even if it is a key as well.
    """
    parts = []
    is_selected = False
    for part in location:
        is_key = isinstance(data, Mapping) and part in data
        if is_key and part in data.values() and not is_selected:
            is_selected = True
        elif is_key or (
            isinstance(data, list) and isinstance(part, int) and part < len(data)
        ):
            parts.append(part)
            data, is_selected = data[part], False
    return tuple(parts)


def _message(error: Any) -> str:
    kind, limits = error["type"], error.get("ctx", {})
    if kind == "union_tag_not_found":
        return f"missing key {limits['discriminator']}"
    if kind == "value_error":
        return str(limits["error"])
    if kind in ("literal_error", "union_tag_invalid"):
        value = limits.get("tag", error["input"])
        expected = limits.get("expected_tags", limits.get("expected"))
        choices = [
            part.strip().strip("'")
            for part in expected.replace(" or ", ", ").split(",")
        ]
        near = nearest(str(value), choices)
        return _must_be(f"one of {', '.join(choices)}", value) + (
            f"; did you mean {near!r}?" if near else ""
        )
    return _must_be(_allowed(error), error["input"])


def _must_be(allowed: str, value: Any) -> str:
    return f"must be {allowed}, got {format_value(value)}"


_TYPES = {
    "string_type": "a string",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "list_type": "a list",
    "tuple_type": "a list",
    **dict.fromkeys(
        ("dict_type", "model_type", "model_attributes_type", "dataclass_type"),
        "a table of keys and values",
    ),
}
_LIMITS = {
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "float_parsing": "a number",
    "bool_parsing": "true or false",
    "finite_number": "a finite number",
    "greater_than": "> {gt}",
    "greater_than_equal": ">= {ge}",
    "less_than": "< {lt}",
    "less_than_equal": "<= {le}",
    "too_short": "a list of at least {min_length} value{s}",
    "too_long": "a list of at most {max_length} value{s}",
}
"""What is allowed, by pydantic's error type; other types use pydantic's own message."""


def _allowed(error: Any) -> str:
    kind = error["type"]
    if kind in _TYPES or kind in _LIMITS:
        limits = {  # whole numbers with all their digits
            name: f"{limit:g}" if isinstance(limit, float) else str(limit)
            for name, limit in error.get("ctx", {}).items()
        }
        plural = (
            "" if "1" in (limits.get("min_length"), limits.get("max_length")) else "s"
        )
        return (_TYPES | _LIMITS)[kind].format(**limits, s=plural)
    return (
        str(error["msg"])
        .removeprefix("Input should be ")
        .removeprefix("Value should be ")
    )
