"""The board's file: versioned JSON, written whole or not at all, read strictly. NaN is null, infinity is "inf"."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twinlens.dataset.files import write_file
from twinlens.errors import FileError, InputError, unknown
from twinlens.scoring.board import Board, Entry, Failure
from twinlens.scoring.evaluate import RegionScores
from twinlens.scoring.protocols import PROTOCOLS

FORMAT = "twinlens-board"
VERSION = 1
MAX_BYTES = 256 * 2**20
BIGGEST = 1e300
UNSCORED = "unscored"
"""What `twinlens score --json` says besides the board: maps of no sample. They are no part of it."""

_BOARD = {"format": str, "version": int, "title": str, "meta": dict, "protocols": dict, "entries": list}
_ENTRY = {
    "method": str,
    "spec": str,
    "sample": str,
    "sample_sha256": str,
    "protocol": str,
    "width": int,
    "height": int,
    "ndisp": int,
    "seconds": (int, float, type(None)),
    "failure": (dict, type(None)),
    "regions": dict,
}
_FAILURE = {"kind": str, "message": str}
_REGION = {"image": int, "evaluated": int, "estimated": int, "metrics": dict}


def board_to_json(board: Board) -> str:
    """The board as text.

    >>> board_to_json(Board(title="empty")).splitlines()[1]
    ' "format": "twinlens-board",'
    """
    document = {
        "format": FORMAT,
        "version": VERSION,
        "title": board.title,
        "meta": dict(board.meta),
        "protocols": {name: dict(PROTOCOLS[name].lines()) for name in board.protocols},
        "entries": [_entry_document(entry) for entry in board.entries],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def board_from_json(text: str) -> Board:
    """The board that `text` describes.

    Raises
    ------
    InputError
        No JSON, another format or version, a key missing or unknown, a value of the wrong kind.

    >>> board_from_json(board_to_json(Board(title="empty"))).title
    'empty'
    """
    try:
        document = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not a board: {error or 'nested too deeply'}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f"not a board: expected a JSON object with format {FORMAT!r}")
    if document.get("version") != VERSION:
        raise InputError(f"board version {document.get('version')!r}: this twinlens reads version {VERSION}")
    document.pop(UNSCORED, None)
    _check(document, _BOARD, "the board")
    meta = {key: _text(value, f"meta {key!r}") for key, value in document["meta"].items()}
    entries = tuple(_entry(item, f"entry {i}") for i, item in enumerate(document["entries"]))
    return Board(document["title"], entries, meta)


def write_board(board: Board, path: str | os.PathLike[str]) -> None:
    """Write the board whole or not at all; OutputError if it cannot be written."""
    write_file(path, board_to_json(board).encode("ascii"))


def read_board(path: str | os.PathLike[str]) -> Board:
    """The board in that file; FileError, beginning with the path, if it is missing or is none."""
    source = Path(path)
    try:
        if source.stat().st_size > MAX_BYTES:
            raise FileError(f"{source}: larger than {MAX_BYTES // 2**20} MiB, no board is")
        return board_from_json(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(f"{source}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError:
        raise FileError(f"{source}: not a board: not UTF-8 text") from None
    except FileError:
        raise
    except InputError as error:
        raise FileError(f"{source}: {error}") from error


def json_number(value: float) -> float | str | None:
    """A number as JSON has it, which knows neither NaN nor infinity.

    >>> json_number(math.nan), json_number(math.inf), json_number(2.5)
    (None, 'inf', 2.5)
    """
    if math.isnan(value):
        return None
    return "inf" if math.isinf(value) else value


def _entry_document(entry: Entry) -> dict[str, Any]:
    plain = {key: getattr(entry, key) for key in (*_ENTRY, "min_disparity") if key not in ("failure", "regions")}
    failure = None if entry.failure is None else {"kind": entry.failure.kind, "message": entry.failure.message}
    return plain | {"failure": failure, "regions": {n: _region_document(r) for n, r in entry.regions.items()}}


def _region_document(scores: RegionScores) -> dict[str, Any]:
    counts = {"image": scores.image, "evaluated": scores.evaluated, "estimated": scores.estimated}
    return counts | {"metrics": {name: json_number(value) for name, value in scores.items()}}


def _no_constant(name: str) -> float:
    raise ValueError(f'{name} is no JSON; no value is null, infinity is "inf"')


def _check(document: Mapping[str, Any], keys: Mapping[str, Any], place: str) -> None:
    """Exactly the keys, each of its type; a bool is no number."""
    for key in document:
        if key not in keys:
            raise InputError(f"{place}: {unknown('key', key, keys)}")
    for key, kind in keys.items():
        if key not in document:
            raise InputError(f"{place}: key {key!r} is missing")
        value = document[key]
        if not isinstance(value, kind) or isinstance(value, bool):
            raise InputError(f"{place}: {key} is {value!r:.60}: expected {_names(kind)}")
        if isinstance(value, int | float) and not 0 <= value < BIGGEST:
            raise InputError(f"{place}: {key} is {value!r:.60}: expected a finite number, 0 or more")


def _names(kind: Any) -> str:
    kinds = kind if isinstance(kind, tuple) else (kind,)
    return " or ".join("null" if k is type(None) else k.__name__ for k in kinds)


def _text(value: Any, place: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"{place} is {value!r:.60}: expected text")
    return value


def _entry(item: Any, place: str) -> Entry:
    if not isinstance(item, dict):
        raise InputError(f"{place} is {item!r:.60}: expected an object")
    first = _first_disparity(item.get("min_disparity", 0), place)
    item = {key: value for key, value in item.items() if key != "min_disparity"}
    _check(item, _ENTRY, place)
    if item["protocol"] not in PROTOCOLS:
        raise InputError(f"{place}: {unknown('protocol', item['protocol'], PROTOCOLS)}")
    if not (item["width"] and item["height"] and item["ndisp"]):
        raise InputError(f"{place}: width, height and ndisp must be 1 or more")
    regions = {name: _region(name, scores, item["protocol"], place) for name, scores in item["regions"].items()}
    fields = item | {"failure": _failure(item["failure"], place), "regions": regions}
    return Entry(**fields, min_disparity=first)


def _first_disparity(value: Any, place: str) -> int:
    """The one number of an entry that may be negative, and that older boards lack: they began at 0."""
    if not isinstance(value, int) or isinstance(value, bool) or not -BIGGEST < value < BIGGEST:
        raise InputError(f"{place}: min_disparity is {value!r:.60}: expected a whole number")
    return value


def _failure(item: Any, place: str) -> Failure | None:
    if item is None:
        return None
    _check(item, _FAILURE, f"{place}, failure")
    return Failure(item["kind"], item["message"])


def _region(name: str, item: Any, protocol: str, place: str) -> RegionScores:
    place = f"{place}, region {name!r}"
    if not isinstance(item, dict):
        raise InputError(f"{place} is {item!r:.60}: expected an object")
    _check(item, _REGION, place)
    known = PROTOCOLS[protocol].metrics
    metrics = {}
    for metric, value in item["metrics"].items():
        if metric not in known:
            raise InputError(f"{place}: {unknown('metric', metric, known)}")
        metrics[metric] = _number(value, f"{place}, {metric}")
    return RegionScores(name, metrics, item["image"], item["evaluated"], item["estimated"])


def _number(value: Any, place: str) -> float:
    if value is None:
        return math.nan
    if value == "inf":
        return math.inf
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < BIGGEST:
        raise InputError(f'{place} is {value!r:.60}: expected a number of 0 or more, null or "inf"')
    return float(value)
