"""sample.json and dataset.json: plain data that a person can read, and the way back to cameras, lenses and rigs.

A dataclass becomes an object of its fields with its class's name under "type", so a record says everything that made a
sample and reads back to equal values: numbers are written with all their digits. JSON has no infinity, so it is the
text "inf".
"""

import dataclasses
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twinlens import camera
from twinlens.camera import Camera, Lens, Rig
from twinlens.dataset.files import read_bytes
from twinlens.dataset.packed import LARGE, MOST, pack, unpack
from twinlens.dataset.packed import TYPE as PACKED
from twinlens.dataset.storage import Where
from twinlens.errors import FileError, InputError, unknown

TYPES: dict[str, type] = {
    public.__name__: public for public in (getattr(camera, name) for name in camera.__all__) if isinstance(public, type)
}
"""What a record can be read back to: the public dataclasses of the camera room, by the name under "type"."""

RENAMED = {("Rig", "believed"): "calibrated"}
"""Fields that earlier versions wrote under another name."""

_DEEPEST = 64


def plain(value: Any) -> Any:
    """`value` as what JSON can say: dataclasses, mappings, sequences, arrays, numbers, paths and text, nested.

    Large arrays that are fields of dataclasses are packed. Raises InputError for anything else, NaN among it.

    >>> plain(camera.ThinLens(0.01, focus_distance=math.inf))["focus_distance"]
    'inf'
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: _field(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
        return {"type": type(value).__name__} | fields
    if isinstance(value, Mapping):
        return {_key(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return _scalar(value)


def from_plain(value: Any) -> Any:
    """The dataclasses back from `plain`'s answer; lists stay lists where no dataclass takes them.

    Raises InputError for a type or a field that is not known, or a value that its class refuses.
    """
    if isinstance(value, list):
        return [from_plain(entry) for entry in value]
    if not isinstance(value, Mapping):
        return value
    if "type" not in value:
        return {key: from_plain(entry) for key, entry in value.items()}
    return _built(value)


def rig_from_plain(value: Any) -> Rig:
    """The Rig back from `plain(rig)`, or InputError."""
    rig = from_plain(value)
    if not isinstance(rig, Rig) or not all(isinstance(each, Camera) for each in rig.cameras):
        raise InputError('a rig must read {"type": "Rig", "cameras": [...], "world_from_cams": [...]}')
    return rig


def lens_from_plain(value: Any) -> Lens:
    """The lens back from `plain(lens)`, or InputError."""
    lens = from_plain(value)
    if not isinstance(lens, Lens) or type(lens.aperture) not in TYPES.values():
        raise InputError(f'a lens must be an object with a "type" of {", ".join(c.__name__ for c in Lens.__args__)}')
    return lens


def encode_json(record: Mapping[str, Any]) -> bytes:
    """The record as indented UTF-8 text, in its own order; small lists of numbers stand on one line."""
    return (_laid_out(plain(record), 0) + "\n").encode()


def encode_json_listing(record: Mapping[str, Any], name: str, entries: Iterable[Mapping[str, Any]]) -> Iterator[bytes]:
    """The pieces of ``encode_json({**record, name: [*entries]})``, one entry at a time in memory.

    >>> b"".join(encode_json_listing({"a": 1}, "b", iter([{"c": 2}]))) == encode_json({"a": 1, "b": [{"c": 2}]})
    True
    """
    head = _laid_out({**plain(record), name: []}, 0)
    yield head[: -len("]\n}")].encode()
    gap = "\n  "
    for entry in entries:
        yield (gap + _laid_out(plain(entry), 2)).encode()
        gap = ",\n  "
    yield ("]\n}\n" if gap == "\n  " else "\n ]\n}\n").encode()


def read_json(path: Where, kind: str, version: int) -> dict[str, Any]:
    """The record in a file that says ``"format": kind, "version": version``. Raises FileError."""
    return decode_json(read_bytes(path), str(path), kind, version)


def decode_json(data: bytes, path: str, kind: str, version: int) -> dict[str, Any]:
    """The record in the bytes of such a file. Raises FileError beginning with `path`."""
    try:
        record = json.loads(data, parse_constant=_no_constant)
        _check_depth(record)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: not valid JSON ({error})") from None
    if not isinstance(record, dict) or record.get("format") != kind:
        raise FileError(f'{path}: not a {kind} file (it must say "format": "{kind}")')
    if record.get("version") != version:
        given = json.dumps(record.get("version"))[:40]
        raise FileError(f"{path}: is of version {given}, and this twinlens reads version {version}; update twinlens")
    return record


def relative_name(name: Any, where: Where) -> str:
    """`name` if it is a plain relative path with /, staying below its folder; else FileError beginning with `where`."""
    parts = name.split("/") if isinstance(name, str) else [""]
    if any(part in ("", ".", "..") or "\\" in part or "\0" in part for part in parts) or Path(name).is_absolute():
        raise FileError(f"{where}: {name!r} is not a plain relative name")
    return str(name)


def _field(value: Any) -> Any:
    large = isinstance(value, np.ndarray) and value.dtype.kind == "f" and LARGE < value.size <= MOST
    return pack(value) if large and not np.isnan(value).any() else plain(value)


def _scalar(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if isinstance(value, float) and not math.isfinite(value):
        if math.isnan(value):
            raise InputError("a record cannot hold NaN")
        return "inf" if value > 0 else "-inf"
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise InputError(f"a record holds plain data (numbers, text, lists, mappings, dataclasses), got {type(value)}")


def _key(key: Any) -> str:
    if not isinstance(key, str):
        raise InputError(f"the names in a record must be text, got {key!r}")
    return key


def _built(value: Mapping[str, Any]) -> Any:
    name = value["type"]
    if name == PACKED:
        return unpack(value)
    if not isinstance(name, str) or name not in TYPES:
        raise unknown("type", str(name), TYPES)
    known = [field.name for field in dataclasses.fields(TYPES[name]) if field.init]
    value = {RENAMED.get((name, key), key): entry for key, entry in value.items()}
    for key in value:
        if key not in known and key != "type":
            raise unknown(f"field of {name}", key, known)
    arguments = {key: from_plain(entry) for key, entry in value.items() if key != "type"}
    try:
        return TYPES[name](**{key: _infinite(entry) for key, entry in arguments.items()})
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise InputError(f"{name}: {error}") from None


def _infinite(value: Any) -> Any:
    return float(value) if isinstance(value, str) and value in ("inf", "-inf") else value


def _check_depth(value: Any) -> None:
    level = [value]
    for _ in range(_DEEPEST):
        level = [entry for each in level for entry in _entries(each)]
    if level:
        raise ValueError(f"nested more than {_DEEPEST} deep")


def _entries(value: Any) -> list[Any]:
    return list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else []


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _laid_out(value: Any, depth: int) -> str:
    if depth > _DEEPEST:
        raise InputError(f"a record may be nested {_DEEPEST} deep")
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if not isinstance(value, (dict, list)) or not value or (isinstance(value, list) and _is_row(value)):
        return flat
    gap, end = "\n" + " " * (depth + 1), "\n" + " " * depth
    if isinstance(value, list):
        return "[" + gap + f",{gap}".join(_laid_out(entry, depth + 1) for entry in value) + end + "]"
    entries = (f"{json.dumps(key, ensure_ascii=False)}: {_laid_out(entry, depth + 1)}" for key, entry in value.items())
    return "{" + gap + f",{gap}".join(entries) + end + "}"


def _is_row(values: list[Any]) -> bool:
    return not any(isinstance(value, (dict, list)) for value in values)
