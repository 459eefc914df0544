"""Base class and error messages of the pydantic models that read files.

A model stands where a file is read (scene.toml, recipes, sample.json, boards) and nowhere else. `read` turns pydantic's
list of validation errors into one `InputError` of one line: file, key, what is allowed, the value, the nearest key.
"""

import difflib
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import pydantic

from twinlens.errors import InputError, format_value, unknown

Model = TypeVar("Model", bound=pydantic.BaseModel)


class StrictModel(pydantic.BaseModel):
    """A frozen model that rejects unknown keys, NaN, infinity, and values of another type (`1` is not `true`)."""

    model_config = pydantic.ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, arbitrary_types_allowed=True
    )


def read(model: type[Model], data: Any, file: str | Path, key: str = "", context: Any = None) -> Model:
    """Validate `data`, plain values as TOML or JSON has them, against `model`.

    Parameters
    ----------
    model : subclass of pydantic.BaseModel
    data : object
        The value read from the file, usually a dict.
    file : str or Path
        Named in error messages.
    key : str
        Dotted path of `data` within the file, "" at its root.
    context : object
        Passed to the model's validators as `info.context`.

    Raises
    ------
    InputError
        One line: file, key, what is allowed, and the value. Only the first error is reported.
    """
    try:
        return model.model_validate(data, context=context)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise InputError(f"{file}: {_describe(first, model, key)}") from error


def dotted(parts: tuple[str | int, ...], start: str = "") -> str:
    """A key path as messages show it.

    >>> dotted(("cameras", 1, "fx"), "rig")
    'rig.cameras[1].fx'
    """
    path = start
    for part in parts:
        if isinstance(part, int):
            path += f"[{part}]"
        else:
            name = part if part.isprintable() else repr(part)
            path += f".{name}" if path else name
    return path


def _describe(error: Any, model: type[pydantic.BaseModel], start: str) -> str:
    """`key: message` of one pydantic error."""
    location, parents = _walk(error["loc"], model)
    kind, value, limits = error["type"], error["input"], error.get("ctx", {})
    if kind == "extra_forbidden":
        known = [key for parent in parents for key in _fields(parent)]
        return _at(dotted(location[:-1], start), str(unknown("key", str(location[-1]), known)))
    if kind == "missing":
        return _at(dotted(location[:-1], start), f"missing key {str(location[-1])!r}")
    if kind == "union_tag_not_found":
        return _at(dotted(location, start), f"missing key {limits['discriminator']}")
    if kind == "union_tag_invalid":
        kind, value, limits = "literal_error", limits["tag"], {"expected": limits["expected_tags"]}
        location = (*location, error["ctx"]["discriminator"].strip("'"))
    where = dotted(location, start)
    if kind == "value_error":
        return _at(where, str(limits["error"]))
    if kind == "literal_error":
        allowed = _literals(limits["expected"])
        near = difflib.get_close_matches(str(value), allowed, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        return _at(where, f"must be one of {', '.join(allowed)}, got {format_value(value)}{hint}")
    return _at(where, f"must be {_allowed(kind, limits, error['msg'])}, got {format_value(value)}")


def _at(where: str, message: str) -> str:
    return f"{where}: {message}" if where else message


_KINDS = {
    "string_type": "a string",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table of keys and values",
    "model_type": "a table of keys and values",
    "model_attributes_type": "a table of keys and values",
    "greater_than": "> {gt:g}",
    "greater_than_equal": ">= {ge:g}",
    "less_than": "< {lt:g}",
    "less_than_equal": "<= {le:g}",
    "too_short": "a list of at least {min_length} values",
    "too_long": "a list of at most {max_length} values",
}
"""What is allowed, by pydantic's error type; other types use pydantic's own message."""


def _allowed(kind: str, limits: Mapping[str, Any], message: str) -> str:
    if kind in _KINDS:
        return _KINDS[kind].format(**limits)
    return message.removeprefix("Input should be ").removeprefix("Value should be ")


def _literals(expected: str) -> list[str]:
    """The choices in pydantic's text "'a', 'b' or 'c'"."""
    return [part.strip().strip("'") for part in expected.replace(" or ", ", ").split(",")]


def _walk(location: tuple[str | int, ...], model: Any) -> tuple[tuple[str | int, ...], list[Any]]:
    """(location without the tags of unions, which are not keys of the file; the types found at its parent)."""
    kept: list[str | int] = []
    options, parents = [model], [model]
    for part in location:
        members = [one for option in options for one in _options(option)]
        following = [found for option in members for found in _children(option, part)]
        tagged = [one for one in members if _has_tag(one, part)]
        if not following and tagged:
            options = tagged
            continue
        kept.append(part)
        options, parents = following, members
    return tuple(kept), parents


def _has_tag(option: Any, tag: str | int) -> bool:
    """Whether a union's member is the one that pydantic calls `tag`: by a Literal field, or by the type's name."""
    literals = [value for each in _fields(option).values() for value in typing.get_args(each)]
    return tag in literals or tag == getattr(option, "__name__", None)


def _fields(option: Any) -> dict[str, Any]:
    """Keys of a model and the types of their values; {} for what is not a model."""
    if isinstance(option, type) and issubclass(option, pydantic.BaseModel):
        return {info.alias or name: info.annotation for name, info in option.model_fields.items()}
    return {}


def _options(annotation: Any) -> list[Any]:
    """The members of a union, or the annotation alone; `Annotated` is removed."""
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        return _options(typing.get_args(annotation)[0])
    if origin in (typing.Union, types.UnionType):
        return [one for member in typing.get_args(annotation) for one in _options(member)]
    return [annotation]


def _children(annotation: Any, part: str | int) -> list[Any]:
    """The types that the value at `part` of a value of this type may have."""
    found: list[Any] = []
    for option in _options(annotation):
        fields, arguments = _fields(option), typing.get_args(option)
        if part in fields:
            found.append(fields[str(part)])
        elif isinstance(part, str) and typing.get_origin(option) in (dict, Mapping) and arguments:
            found.append(arguments[1])
        elif isinstance(part, int) and typing.get_origin(option) in (list, tuple) and arguments:
            found.append(arguments[min(part, len(arguments) - 1)] if arguments[-1] is not ... else arguments[0])
    return found
