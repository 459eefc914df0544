"""The board's file: versioned JSON, written atomically and validated when read. NaN is null, infinity is "inf"."""

import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from twinlens.dataset.files import write_file
from twinlens.errors import FileError, InputError, format_value, unknown
from twinlens.schema import StrictModel, read
from twinlens.scoring.board import FAILURES, Board, Entry, Failure
from twinlens.scoring.evaluate import RegionScores
from twinlens.scoring.protocols import PROTOCOLS

FORMAT = "twinlens-board"
VERSION = 1
MAX_BYTES = 256 * 2**20
BIGGEST = 1e300
UNSCORED = "unscored"
"""Key that `twinlens score --json` adds to the board: maps that match no sample. `read_board` ignores it."""

_Count = Annotated[int, pydantic.Field(ge=0, lt=2**53)]
_Size = Annotated[int, pydantic.Field(ge=1, lt=2**53)]
_Number = Annotated[float, pydantic.Field(ge=0)]


def _metric(value: Any) -> float:
    if value is None:
        return math.nan
    if value == "inf":
        return math.inf
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < BIGGEST:
        raise InputError(f'must be a number >= 0, null or "inf", got {format_value(value)}')
    return float(value)


_Metric = Annotated[
    float,
    pydantic.PlainValidator(_metric),
    pydantic.WithJsonSchema({"anyOf": [{"type": "number", "minimum": 0}, {"const": "inf"}, {"type": "null"}]}),
]


class _FailureModel(StrictModel):
    kind: str
    message: str

    @pydantic.field_validator("kind")
    @classmethod
    def _check_kind(cls, kind: str) -> str:
        return _known("failure", kind, FAILURES)


class _RegionModel(StrictModel):
    image: _Count
    evaluated: _Count
    estimated: _Count
    metrics: dict[str, _Metric]


class _EntryModel(StrictModel):
    method: str
    spec: str
    sample: str
    sample_sha256: str
    protocol: str
    width: _Size
    height: _Size
    ndisp: _Size
    min_disparity: Annotated[int, pydantic.Field(gt=-(2**53), lt=2**53)] = 0
    seconds: _Number | None
    failure: _FailureModel | None
    regions: dict[str, _RegionModel]

    @pydantic.field_validator("protocol")
    @classmethod
    def _check_protocol(cls, protocol: str) -> str:
        return _known("protocol", protocol, PROTOCOLS)

    @pydantic.model_validator(mode="after")
    def _check_metrics(self) -> "_EntryModel":
        for region in self.regions.values():
            for metric in region.metrics:
                _known("metric", metric, PROTOCOLS[self.protocol].metrics)
        return self

    def entry(self) -> Entry:
        """The entry that this describes."""
        regions = {
            name: RegionScores(name, r.metrics, r.image, r.evaluated, r.estimated) for name, r in self.regions.items()
        }
        failure = None if self.failure is None else Failure(self.failure.kind, self.failure.message)
        plain = {name: getattr(self, name) for name in _EntryModel.model_fields}
        return Entry(**(plain | {"failure": failure, "regions": regions}))


class BoardModel(StrictModel):
    """board.json."""

    format: Literal["twinlens-board"]
    version: Literal[1]
    title: str
    meta: dict[str, str]
    protocols: dict[str, dict[str, str]]
    entries: list[_EntryModel]
    unscored: dict[str, list[str]] | None = None


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


def board_from_json(text: str, file: str | Path = "board") -> Board:
    """The board that `text` describes; `file` is named in errors.

    Raises
    ------
    InputError
        Not JSON, another format or version, a key missing or unknown, a value of the wrong type.

    >>> board_from_json(board_to_json(Board(title="empty"))).title
    'empty'
    """
    try:
        document = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: not a board: {error or 'nested too deeply'}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f"{file}: not a board: expected a JSON object with format {FORMAT!r}")
    if document.get("version") != VERSION:
        raise InputError(f"{file}: board version {document.get('version')!r}: this twinlens reads version {VERSION}")
    model = read(BoardModel, document, file)
    try:
        return Board(model.title, tuple(entry.entry() for entry in model.entries), model.meta)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error


def write_board(board: Board, path: str | os.PathLike[str]) -> None:
    """Write the board atomically; OutputError if it cannot be written."""
    write_file(path, board_to_json(board).encode("ascii"))


def read_board(path: str | os.PathLike[str]) -> Board:
    """The board in that file; FileError, starting with the path, if it is missing or invalid."""
    source = Path(path)
    try:
        if source.stat().st_size > MAX_BYTES:
            raise FileError(f"{source}: larger than {MAX_BYTES // 2**20} MiB, the limit for a board")
        return board_from_json(source.read_text(encoding="utf-8"), source)
    except OSError as error:
        raise FileError(f"{source}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError:
        raise FileError(f"{source}: not a board: not UTF-8 text") from None
    except FileError:
        raise
    except InputError as error:
        raise FileError(str(error)) from error


def json_number(value: float) -> float | str | None:
    """A number as JSON, which has neither NaN nor infinity.

    >>> json_number(math.nan), json_number(math.inf), json_number(2.5)
    (None, 'inf', 2.5)
    """
    if math.isnan(value):
        return None
    return "inf" if math.isinf(value) else value


def _entry_document(entry: Entry) -> dict[str, Any]:
    names = [name for name in _EntryModel.model_fields if name not in ("failure", "regions")]
    regions = {
        name: {
            **{count: getattr(scores, count) for count in ("image", "evaluated", "estimated")},
            "metrics": {metric: json_number(value) for metric, value in scores.items()},
        }
        for name, scores in entry.regions.items()
    }
    failure = None if entry.failure is None else asdict(entry.failure)
    return {name: getattr(entry, name) for name in names} | {"failure": failure, "regions": regions}


def _refuse_constant(name: str) -> float:
    raise ValueError(f'{name} is not JSON; write null for NaN, "inf" for infinity')


def _known(what: str, name: str, names: Iterable[str] | Mapping[str, Any]) -> str:
    if name not in names:
        raise unknown(what, name, list(names))
    return name
