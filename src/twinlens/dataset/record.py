"""sample.json and dataset.json: objects to plain JSON data, and the models that validate and rebuild them.

A dataclass becomes an object of its fields with its class's name under "type". Numbers are written with all digits, so
values read back equal; infinity is the string "inf". docs/format.md describes how large arrays are packed.
"""

import base64
import binascii
import dataclasses
import functools
import json
import math
import operator
import os
import types
import typing
import zlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray

from twinlens import camera, schema
from twinlens.camera import RecipeLens, Rig
from twinlens.dataset.files import read_bytes
from twinlens.dataset.storage import Where
from twinlens.errors import FileError, InputError

TYPES: dict[str, type] = {
    name: public for name, public in vars(camera).items() if isinstance(public, type)
}
TYPES |= {lens.__name__: lens for lens in typing.get_args(camera.RecipeLens)}
"""The dataclasses that a record can contain, by name: the public ones of twinlens.camera, and the lenses of recipes."""

RENAMED = {("Rig", "believed"): "calibrated"}
"""Fields that earlier versions wrote under another name."""

ADDED: dict[tuple[str, str], Any] = {
    ("Rig", "projectors"): (),
    ("Camera", "band"): "rgb",
    ("ThinLens", "defocus"): 0.0,
    ("Projector", "aperture_diameter"): 0.0,
    ("Projector", "focus_distance"): math.inf,
    ("Projector", "sequence"): (),
}
"""Fields that earlier versions do not have. They are left out at this value."""

LEFT_OUT = {("Rig", "motion")}
"""Fields that no record has: images and truth are of still rigs."""

PACKED_ABOVE, MAX_PACKED = 1024, 4096 * 4096
"""Arrays of more than the first and at most the second number of values are packed; the largest are aperture masks."""

_MAX_DEPTH = 64
_LEVELS: dict[int | None, str] = {255: "<u1", 65535: "<u2", None: "<f8"}

_NUMBER = Annotated[
    float,
    pydantic.BeforeValidator(
        lambda value: float(value) if value in ("inf", "-inf") else value
    ),
    pydantic.WithJsonSchema({"anyOf": [{"type": "number"}, {"enum": ["inf", "-inf"]}]}),
]

T = TypeVar("T")


class FileModel(pydantic.BaseModel):
    """Base of the models of files that twinlens writes: strict types, and unknown keys are ignored."""

    model_config = pydantic.ConfigDict(
        extra="ignore", frozen=True, strict=True, allow_inf_nan=False
    )


class PackedArray(schema.StrictModel):
    """A large array as `pack` writes it."""

    type: Literal["array"]
    shape: list[Annotated[int, pydantic.Field(ge=1)]] = pydantic.Field(
        min_length=1, max_length=4
    )
    levels: int | None
    zlib: str


def _unpacked(value: Any) -> Any:
    return unpack(value) if isinstance(value, Mapping) else value


_ARRAY = Annotated[
    Any,
    pydantic.BeforeValidator(
        _unpacked, json_schema_input_type=list[list[float]] | PackedArray
    ),
]


def read(
    model: type[T] | pydantic.TypeAdapter[T], data: Any, file: Where, key: str = ""
) -> T:
    """`schema.read` for files: raises FileError, one line with file, key and what is allowed."""
    try:
        return schema.read(model, data, str(file), key)
    except InputError as error:
        raise FileError(str(error)) from None


def read_part(
    model: pydantic.TypeAdapter[T], record: Mapping[str, Any], key: str, file: Where
) -> T:
    """`read` one key of a record. Raises FileError, also where the key is missing."""
    if key not in record:
        raise FileError(f"{file}: missing key {key!r}")
    return read(model, record[key], file, key)


def plain(value: Any, nan_as_null: bool = False) -> Any:
    """`value` as JSON data: dataclasses, mappings, sequences, arrays, numbers, paths and text, nested.

    With `nan_as_null`, NaN becomes None. Raises InputError for NaN without it, and for values of other types.

    >>> plain(camera.ThinLens(0.01, focus_distance=math.inf))["focus_distance"]
    'inf'
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain_dataclass(value, nan_as_null)
    if isinstance(value, Mapping):
        if wrong := [key for key in value if not isinstance(key, str)]:
            raise InputError(f"the keys of a record must be strings, got {wrong[0]!r}")
        return {key: plain(entry, nan_as_null) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), nan_as_null)
    if isinstance(value, (list, tuple)):
        return [plain(entry, nan_as_null) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if isinstance(value, float) and not math.isfinite(value):
        if math.isnan(value) and not nan_as_null:
            raise InputError("a record cannot hold NaN")
        return None if math.isnan(value) else str(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise InputError(
        f"a record holds numbers, strings, lists, mappings and dataclasses, got {type(value)}"
    )


def _plain_dataclass(value: Any, nan_as_null: bool) -> dict[str, Any]:
    """The class name under "type", and the fields; large arrays are packed, which readers unpack in fields only."""
    record: dict[str, Any] = {"type": type(value).__name__}
    for field in dataclasses.fields(value):
        key = record["type"], field.name
        if not field.init or key in LEFT_OUT:
            continue
        content = getattr(value, field.name)
        if key in ADDED and content == ADDED[key]:
            continue
        if _is_packed(content):
            record[field.name] = pack(content)
        else:
            record[field.name] = plain(content, nan_as_null)
    return record


def _is_packed(content: Any) -> bool:
    """Whether a field is an array that would be long as a list of decimals."""
    if not isinstance(content, np.ndarray) or content.dtype.kind != "f":
        return False
    return PACKED_ABOVE < content.size <= MAX_PACKED and not np.isnan(content).any()


def annotation_of(hint: Any) -> Any:
    """The pydantic annotation for a value of type `hint`, a dataclass of twinlens.camera or the type of a field."""
    if hint is float:
        return _NUMBER
    if hint in TYPES.values():
        return Annotated[
            _model(hint), pydantic.AfterValidator(lambda model: _rebuilt(hint, model))
        ]
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    # NumPy 2.5 declares NDArray by a `type` statement, which has a __value__.
    aliased = typing.get_origin(getattr(origin, "__value__", None))
    if np.ndarray in (origin, aliased):
        return _ARRAY
    if origin is tuple:
        return list[annotation_of(arguments[0])]  # type: ignore[misc]
    if origin in (typing.Union, types.UnionType):
        members = [annotation_of(kind) for kind in arguments if kind is not type(None)]
        union = functools.reduce(operator.or_, members)
        if len(members) > 1:
            union = Annotated[union, pydantic.Field(discriminator="type")]
        return union | None if type(None) in arguments else union
    return hint


@functools.cache
def _model(kind: type) -> type[pydantic.BaseModel]:
    """The model of a dataclass's fields and its "type"."""
    hints = typing.get_type_hints(kind)
    fields: dict[str, Any] = {"type": (Literal[kind.__name__], ...)}
    for field in dataclasses.fields(kind):
        if not field.init or (kind.__name__, field.name) in LEFT_OUT:
            continue
        hint = hints[field.name]
        if hint == kind | None:  # a Rig in a Rig, whose model does not exist yet
            optional = pydantic.AfterValidator(
                lambda value: value and RIG.validate_python(value)
            )
            fields[field.name] = (Annotated[Any, optional], None)
            continue
        defaults = {field.default, field.default_factory}
        if defaults == {dataclasses.MISSING}:
            default = pydantic.Field()
        else:
            default = pydantic.Field(default_factory=lambda: None)
        fields[field.name] = (annotation_of(hint), default)
    return pydantic.create_model(kind.__name__, __base__=_DescriptionModel, **fields)


class _DescriptionModel(schema.StrictModel):
    model_config = pydantic.ConfigDict(allow_inf_nan=True)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _rename(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        return {
            RENAMED.get((cls.__name__, key), key): value for key, value in data.items()
        }


def _rebuilt(kind: type[T], model: pydantic.BaseModel) -> T:
    try:
        return kind(
            **{name: getattr(model, name) for name in model.model_fields_set - {"type"}}
        )
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise InputError(f"{kind.__name__}: {error}") from None


RIG: pydantic.TypeAdapter[Rig] = pydantic.TypeAdapter(annotation_of(Rig))
LENS: pydantic.TypeAdapter[RecipeLens] = pydantic.TypeAdapter(annotation_of(RecipeLens))
"""For `read`: the Rig of `plain(rig)`, the lens of `plain(lens)`."""


def encode_json(record: Mapping[str, Any]) -> bytes:
    """The record as indented UTF-8 text, in its own order; lists of numbers are on one line."""
    return (_indented(plain(record), 0) + "\n").encode()


def read_json(path: Where, kind: str, version: int) -> dict[str, Any]:
    """The record of a file with ``"format": kind, "version": version``. Raises FileError."""
    return decode_json(read_bytes(path), str(path), kind, version)


def decode_json(data: bytes, path: str, kind: str, version: int) -> dict[str, Any]:
    """The record in the bytes of such a file. Raises FileError, whose message starts with `path`."""
    try:
        record = json.loads(data, parse_constant=_reject_constant)
        if _depth(record) > _MAX_DEPTH:
            raise InputError(f"nested more than {_MAX_DEPTH} levels deep")
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: not valid JSON ({error})") from None
    if not isinstance(record, dict) or record.get("format") != kind:
        raise FileError(f'{path}: not a {kind} file (it needs "format": "{kind}")')
    if record.get("version") != version:
        value = json.dumps(record.get("version"))[:40]
        raise FileError(
            f"{path}: has version {value}; this twinlens reads version {version}: update twinlens"
        )
    return record


def pack(array: NDArray[Any]) -> dict[str, Any]:
    """An array without NaN as one string: base64 of zlib of its numbers, in the shortest format that is exact."""
    array = np.asarray(array, np.float64)
    levels: int | None
    for levels in (255, 65535):
        numbers = np.rint(array * levels)
        if ((numbers >= 0) & (numbers <= levels)).all() and np.array_equal(
            numbers / levels, array
        ):
            break
    else:
        levels, numbers = None, array
    body = base64.b64encode(
        zlib.compress(numbers.astype(_LEVELS[levels]).tobytes(), 9)
    ).decode()
    return {"type": "array", "shape": list(array.shape), "levels": levels, "zlib": body}


def unpack(value: Mapping[str, Any]) -> NDArray[np.float64]:
    """The array of `pack(array)`. Raises InputError.

    >>> unpack(pack(np.array([[0.0, 1.0], [0.2, 0.25]])))
    array([[0.  , 1.  ],
           [0.2 , 0.25]])
    """
    packed = schema.read(PackedArray, value, "packed array")
    if packed.levels not in _LEVELS:
        raise InputError(
            f"packed array: levels must be 255, 65535 or null, got {packed.levels}"
        )
    dtype, count = np.dtype(_LEVELS[packed.levels]), math.prod(packed.shape)
    if count > MAX_PACKED:
        raise InputError(
            f"packed array: has {count} numbers, at most {MAX_PACKED} are allowed"
        )
    try:
        reader = zlib.decompressobj()
        data = reader.decompress(
            base64.b64decode(packed.zlib, validate=True), count * dtype.itemsize + 1
        )
    except (binascii.Error, ValueError, zlib.error) as error:
        raise InputError(f"packed array: damaged ({error})") from None
    if len(data) != count * dtype.itemsize or not reader.eof or reader.unused_data:
        raise InputError(
            f"packed array: damaged (its shape needs {count * dtype.itemsize} bytes)"
        )
    numbers = np.frombuffer(data, dtype).reshape(packed.shape).astype(np.float64)
    if np.isnan(numbers).any():
        raise InputError("packed array: damaged (it contains NaN)")
    return numbers if packed.levels is None else numbers / packed.levels


def _depth(value: Any) -> int:
    """The number of nested dicts and lists."""
    if isinstance(value, dict):
        value = list(value.values())
    if not isinstance(value, list):
        return 0
    return 1 + max((_depth(entry) for entry in value), default=0)


def _reject_constant(name: str) -> float:
    raise InputError(f'{name} is not JSON; write null for NaN, "inf" for infinity')


def _indented(value: Any, depth: int) -> str:
    if depth > _MAX_DEPTH:
        raise InputError(f"a record may be nested {_MAX_DEPTH} levels deep")
    if not isinstance(value, (dict, list)) or not any(
        isinstance(value, dict) or isinstance(entry, (dict, list)) for entry in value
    ):
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    gap, end = "\n" + " " * (depth + 1), "\n" + " " * depth
    separator = f",{gap}"
    if isinstance(value, list):
        entries = [_indented(entry, depth + 1) for entry in value]
        return f"[{gap}{separator.join(entries)}{end}]"
    entries = [
        f"{json.dumps(key, ensure_ascii=False)}: {_indented(entry, depth + 1)}"
        for key, entry in value.items()
    ]
    return "{" + gap + separator.join(entries) + end + "}"
