"""The board's file: versioned JSON, validated when read, written atomically. NaN is null, infinity is "inf"."""

import json
import math
import os
import platform
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import pydantic

import twinlens
from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.record import decode_json, plain, read
from twinlens.errors import FileError, InputError, check_known, file_hint
from twinlens.schema import (
    NonNegative,
    Number,
    StrictModel,
    exactly,
    one_of,
    table_of,
)
from twinlens.scoring.board import (
    FAILURES,
    Board,
    Disagreement,
    Entry,
    MatchFailure,
)
from twinlens.scoring.evaluate import RegionScores
from twinlens.scoring.protocols import PROTOCOLS
from twinlens.scoring.sparsification import DENSITIES

FORMAT, VERSION = "twinlens-board", 1
UNSCORED = "unscored"  # key that `twinlens score --json` adds: maps that match no sample; `read_board` ignores it
COMPARED = "compared"  # key that --json with --by adds: groups of samples; `read_board` ignores it
MAX_BYTES = 256 * 2**20
WRITE_EVERY_S = 2.0
"""At least: the time of a write is proportional to the number of entries."""
MIXED = "entries of several machines or versions"

T = TypeVar("T")
_COUNT = (Annotated[int, pydantic.Field(ge=0, lt=2**53)], ...)
_SIZE = (Annotated[int, pydantic.Field(ge=1, lt=2**53)], ...)


def _bounded(value: float) -> float:
    # Sums over samples, and seconds per 10^9 pixels, would overflow.
    if 1e280 <= value < math.inf:
        raise InputError(f"must be < 1e280, got {value:g}")
    return float(value)


_Metric = Annotated[
    Annotated[
        float,
        pydantic.Field(ge=0, allow_inf_nan=True),
        pydantic.AfterValidator(_bounded),
    ]
    | None,
    pydantic.BeforeValidator(lambda value: math.inf if value == "inf" else value),
    pydantic.AfterValidator(lambda value: math.nan if value is None else value),
    pydantic.WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "minimum": 0},
                {"const": "inf"},
                {"type": "null"},
            ]
        }
    ),
]


_FailureTable: Any = table_of(
    MatchFailure,
    kind=(Annotated[str, one_of("failure", FAILURES)], ...),
    frames=(Annotated[list[str], pydantic.AfterValidator(tuple)], ()),
)
_RegionTable: Any = table_of(
    RegionScores, image=_COUNT, evaluated=_COUNT, estimated=_COUNT, metrics=(dict[str, _Metric], ...),
    sparsification=(Annotated[list[_Metric], exactly(len(DENSITIES), _Metric), pydantic.AfterValidator(tuple)], ()),
)  # fmt: skip


def _entry(**fields: Any) -> Entry:
    metrics = PROTOCOLS[fields["protocol"]].metrics
    for scores in fields["regions"].values():
        for metric in scores:
            check_known("metric", metric, metrics)
    return Entry(**fields)


_EntryTable: Any = table_of(
    Entry,
    _entry,
    protocol=(Annotated[str, one_of("protocol", PROTOCOLS)], ...),
    width=_SIZE,
    height=_SIZE,
    ndisp=_SIZE,
    min_disparity=(Annotated[int, pydantic.Field(gt=-(2**53), lt=2**53)], 0),
    seconds=(Annotated[NonNegative, pydantic.AfterValidator(_bounded)] | None, ...),
    failure=(_FailureTable | None, ...),
    regions=(dict[str, _RegionTable], ...),
    doubt=(str, ""),
)


_DisagreementTable: Any = table_of(Disagreement, compared=_COUNT, apart=(_Metric, ...))


class BoardModel(StrictModel):
    """board.json."""

    format: Literal["twinlens-board"]
    version: Literal[1]
    title: str
    meta: dict[str, str]
    protocols: dict[str, dict[str, str]]
    entries: list[_EntryTable]
    scenes: dict[str, str] = pydantic.Field(default={})
    recorded: dict[str, dict[str, str | Number]] = pydantic.Field(default={})
    disagreements: list[_DisagreementTable] = pydantic.Field(default=[])
    unscored: dict[str, list[str]] | None = None
    compared: dict[str, Any] | None = None


def board_to_json(board: Board) -> str:
    """The board as text."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "title": board.title,
        "meta": dict(board.meta),
        "protocols": {name: dict(PROTOCOLS[name].lines()) for name in board.protocols},
        "scenes": _of_samples(board, board.scenes),
        "recorded": _of_samples(board, board.recorded),
        "entries": [_record(entry) for entry in board.entries],
    }
    if board.disagreements:
        document["disagreements"] = [asdict(pair) for pair in board.disagreements]
    return (
        json.dumps(plain(document, nan_as_null=True), indent=1, allow_nan=False) + "\n"
    )


def _of_samples(board: Board, values: Mapping[str, T]) -> dict[str, T]:
    """The values of the samples that have one, in the order of the samples."""
    return {name: values[name] for name in board.samples if name in values}


def _record(entry: Entry) -> dict[str, Any]:
    """The entry as plain data, without frames, doubts and sparsification curves where there are none."""
    record = asdict(entry)
    if record["failure"] and not record["failure"]["frames"]:
        del record["failure"]["frames"]
    if not entry.doubt:
        del record["doubt"]
    for region in record["regions"].values():
        if not region["sparsification"]:
            del region["sparsification"]
    return record


def board_from_json(text: str | bytes, file: str | Path = "board") -> Board:
    """Read a board from `text`. Raises FileError, starting with `file`, if it is no valid board of this version."""
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    model = read(BoardModel, decode_json(data, str(file), FORMAT, VERSION), file)
    try:
        return Board(
            model.title,
            tuple(model.entries),
            model.meta,
            model.scenes,
            model.recorded,
            tuple(model.disagreements),
        )
    except InputError as error:
        raise FileError(f"{file}: {error}") from None


def read_board(path: str | os.PathLike[str]) -> Board:
    """Read a board.json or that of a folder. Raises FileError, with its path, if missing, above 256 MiB, or invalid."""
    path = Path(path) / "board.json" if Path(path).is_dir() else Path(path)
    if not path.exists():
        raise FileError(
            f"{path}: no such file; a board is a folder that `twinlens benchmark` writes, or its board.json"
            f"{file_hint(path)}"
        )
    if path.is_file() and path.stat().st_size > MAX_BYTES:
        raise FileError(
            f"{path}: larger than {MAX_BYTES / 2**20:g} MiB, the limit for a board"
        )
    return board_from_json(read_bytes(path), path)


def write_board(board: Board, path: str | os.PathLike[str]) -> None:
    """Write the board atomically; OutputError if it cannot be written."""
    write_file(path, board_to_json(board).encode("ascii"))


class BoardWriter:
    """A board, written to `path` every few seconds while it changes, and at the end of its `with` block.

    Writing adds versions and machine to the board's `meta`.
    """

    def __init__(self, board: Board, path: str | os.PathLike[str] | None) -> None:
        self.board, self._before, self._path = board, board, path
        self._changed, self._next_write = False, 0.0

    def __enter__(self) -> "BoardWriter":
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        if self._changed or error is None:
            self._write()

    def update(self, board: Board) -> None:
        """Replace the board; write it if the last write was `WRITE_EVERY_S` ago."""
        self.board, self._changed = board, True
        if time.monotonic() >= self._next_write:
            self._write()

    def _write(self) -> None:
        self.board, self._changed = replace(self.board, meta=self._meta()), False
        if self._path is not None:
            write_board(self.board, self._path)
            self._next_write = time.monotonic() + WRITE_EVERY_S

    def _meta(self) -> Mapping[str, str]:
        before = {id(entry) for entry in self._before.entries}
        old = [id(entry) in before for entry in self.board.entries]
        if old and all(old):
            return self._before.meta
        return _joined(self._before.meta, _machine()) if any(old) else _machine()


def _joined(before: Mapping[str, str], now: Mapping[str, str]) -> dict[str, str]:
    """Both descriptions in one. If they differ: all values of each key, separated by "; ", and the key `mixed`."""
    if dict(before) == dict(now):
        return dict(now)
    joined = {}
    for name in dict.fromkeys([*now, *before]):
        if name == "mixed":
            continue
        values = before.get(name, "unknown").split("; ")
        values.append(now.get(name, "unknown"))
        joined[name] = "; ".join(dict.fromkeys(values))
    return joined | {"mixed": MIXED}


def _machine() -> dict[str, str]:
    """Versions and machine, for readers of the times; nothing that identifies the machine."""
    return {
        "twinlens": twinlens.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "system": f"{platform.system()} {platform.machine()}",
        "processors": str(os.cpu_count()),
    }
