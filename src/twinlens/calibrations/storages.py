"""Numbers in the calibration files of other programs: OpenCV's FileStorage (YAML, XML, JSON) and plain YAML.

Only values are read: no tag of YAML makes an object, and XML may not have document types. Sources: OpenCV's
documentation of FileStorage and `modules/core/src/persistence_*.cpp`, whose YAML 1.0 has no space after a colon where a
matrix follows, and writes .Nan and .Inf.
"""

import gzip
import itertools
import json
import re
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
import yaml

from twinlens.errors import FileError, InputError, file_hint, format_value
from twinlens.geometry import Float

_MOST_CHARACTERS = 1 << 24
_MATRIX = "opencv-matrix"
# OpenCV writes %YAML:1.0, and no space between a colon and a tag. Two of its files may be joined in one.
_YAML_HEAD = re.compile(r"^%YAML[^\n]*\n(---[^\n]*\n)?", re.MULTILINE)
_YAML_END = re.compile(r"^\.\.\.[^\n]*\n?", re.MULTILINE)
_NO_SPACE = re.compile(r"^(\s*\w+):(?=!!)", re.MULTILINE)
_MOST_NUMBERS = 10_000
_NOT_NUMBERS = {".nan": "nan", ".inf": "inf", "-.inf": "-inf", "+.inf": "inf"}


class _Loader(yaml.SafeLoader):
    """Plain values without aliases, which can make a short file huge. A matrix becomes the mapping of its keys."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise InputError("has an alias (*); write the values themselves")
        return super().compose_node(parent, index)


def _without_tag(loader: Any, _tag: str, node: Any) -> Any:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    return loader.construct_scalar(node)


_Loader.add_multi_constructor("", _without_tag)


def read_text(path: Path) -> str:
    """The content of a UTF-8 file, without a byte order mark. Raises FileError that names it.

    A file whose name ends in .gz is unpacked, as OpenCV's FileStorage writes it.
    """
    try:
        if path.suffix.lower() == ".gz":
            with gzip.open(path) as packed:
                return packed.read(_MOST_CHARACTERS + 1).decode("utf-8-sig")
        return path.read_text("utf-8-sig")
    except FileNotFoundError:
        raise FileError(f"{path}: no such file{file_hint(path)}") from None
    except UnicodeDecodeError:
        raise FileError(f"{path}: not a text file") from None
    except (OSError, EOFError, zlib.error, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"{path}: cannot be read ({reason})") from None


def read_storage(path: Path) -> dict[str, Any]:
    """The values at the top level of a file in YAML, XML or JSON, by their names.

    Matrices of OpenCV are float64 arrays of two dimensions. Raises FileError.
    """
    text = read_text(path)
    if len(text) > _MOST_CHARACTERS:
        raise FileError(f"{path}: is too large for a calibration")
    start = text.lstrip()[:1]
    try:
        values = _READERS.get(start, _from_yaml)(text)
        if not isinstance(values, dict):
            raise InputError("has no names with values")
        return {str(name): _matrix(name, value) for name, value in values.items()}
    except (yaml.YAMLError, expat.ExpatError) as error:
        reason = " ".join(str(error).split())
        raise FileError(
            f"{path}: cannot be read as YAML, XML or JSON: {reason[:200]}"
        ) from None
    except RecursionError:
        raise FileError(f"{path}: is nested too deeply") from None
    except (ValueError, OverflowError) as error:
        raise FileError(f"{path}: {error}") from None


def numbers(value: Any, name: str) -> Float:
    """Finite numbers (N,) of a list or a matrix. Raises InputError that names it."""
    if isinstance(value, Mapping) and "data" in value:  # as ROS writes matrices
        value = value["data"]
    flat = value.ravel().tolist() if isinstance(value, np.ndarray) else value
    if isinstance(flat, (int, float, str)):
        flat = [flat]
    if not isinstance(flat, list):
        raise InputError(f"{name} must be numbers, got {format_value(value)}")
    try:
        array = _array(flat)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be numbers, got {format_value(value)}") from None
    if not np.isfinite(array).all():
        raise InputError(f"{name} is not finite: it has {_first_odd(array)}")
    return array


def number(value: Any, name: str) -> float:
    """A finite number. Raises InputError that names it."""
    flat = numbers(value, name)
    if len(flat) != 1:
        raise InputError(f"{name} must be one number, got {len(flat)}")
    return float(flat[0])


def matrix(value: Any, name: str, rows: int, columns: int) -> Float:
    """A matrix of finite numbers. Raises InputError that names it."""
    flat = numbers(value, name)
    if len(flat) != rows * columns:
        raise InputError(f"{name} must be {rows}x{columns} numbers, got {len(flat)}")
    return flat.reshape(rows, columns)


def _first_odd(array: Float) -> str:
    return str(array[~np.isfinite(array)][0])


def _flattened(items: list[Any]) -> Iterator[Any]:
    for item in items:
        if isinstance(item, list):
            yield from _flattened(item)
        else:
            yield item


def _array(items: Any) -> Float:
    """The numbers (N,) of nested lists. Raises TypeError, ValueError or OverflowError for other values."""
    flat = list(itertools.islice(_flattened(list(items)), _MOST_NUMBERS + 1))
    if len(flat) > _MOST_NUMBERS:
        raise ValueError
    return np.array([_number(item) for item in flat], dtype=np.float64)


def _number(value: Any) -> float:
    if isinstance(value, bool):
        raise TypeError
    text = value.strip().lower() if isinstance(value, str) else value
    return float(_NOT_NUMBERS.get(text, text))


def _matrix(name: Any, value: Any) -> Any:
    """A matrix of OpenCV as an array; other values as they are."""
    if not (isinstance(value, dict) and {"rows", "cols", "data"} <= value.keys()):
        return value
    if isinstance(value["data"], str | bytes):
        raise InputError(
            f"{name} is stored in base64; write it as text, without FileStorage::BASE64"
        )
    size = f"{value['rows']}x{value['cols']}"
    try:
        return _array(value["data"]).reshape(int(value["rows"]), int(value["cols"]))
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} is not a matrix of {size[:40]} numbers") from None


def _from_yaml(text: str) -> Any:
    body = _YAML_END.sub("", _YAML_HEAD.sub("", text))
    stream = yaml.load_all(_NO_SPACE.sub(r"\1: ", body), Loader=_Loader)
    # rostopic ends a message with ---, which begins an empty document.
    documents = [document for document in stream if document is not None]
    if len(documents) > 1:
        raise InputError(
            f"holds {len(documents)} messages, separated by lines of ---; keep one"
        )
    return documents[0] if documents else None


def _from_json(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        # OpenCV writes .Nan, which YAML has and JSON has not; JSON is YAML otherwise.
        return _from_yaml(text)


def _from_xml(text: str) -> dict[str, Any]:
    builder = TreeBuilder()
    parser = expat.ParserCreate()

    def reject(*_: Any) -> None:
        raise InputError("a calibration needs no <!DOCTYPE>; remove it")

    parser.StartDoctypeDeclHandler = reject
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text.lstrip().encode(), True)
    root = builder.close()
    if root.tag != "opencv_storage":
        raise InputError(f"starts with <{root.tag}>, not with <opencv_storage>")
    return {child.tag: _xml_value(child) for child in root}


def _xml_value(element: Element) -> Any:
    if element.get("type_id") == _MATRIX:
        table: dict[str, Any] = {child.tag: (child.text or "") for child in element}
        table["data"] = table.get("data", "").split()
        return table
    if len(element):
        return {child.tag: _xml_value(child) for child in element}
    text = (element.text or "").strip()
    if text.startswith('"'):
        return text.strip('"')
    words = text.split()
    return words[0] if len(words) == 1 else words


_READERS = {"<": _from_xml, "{": _from_json}
"""By the first character; other files are YAML."""
