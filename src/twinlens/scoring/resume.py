"""What a run of before leaves, and what this one leaves to the next: a board's file, and who measured what is in it."""

import os
import platform
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

import twinlens
from twinlens.scoring.board import Board
from twinlens.scoring.board_json import read_board, write_board

WRITE_EVERY_S = 2.0
"""A file of every pair grows with each, so writing it after each would take the square of their number."""
MIXED = "entries of several machines or versions"


def resumed(save: str | os.PathLike[str] | None, board: Board | None, title: str) -> Board:
    """The board to go on with: the one given, else the one in the file, else an empty one; `title` is its new title.

    Raises
    ------
    FileError
        The file holds no board.
    """
    if board is None and save is not None and Path(save).exists():
        board = read_board(save)
    return replace(board or Board(), title=title)


def machine() -> dict[str, str]:
    """What a reader of the times needs to know of the machine, and nothing that names it."""
    return {
        "twinlens": getattr(twinlens, "__version__", "unknown"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "system": f"{platform.system()} {platform.machine()}",
        "processors": str(os.cpu_count()),
    }


def joined(before: Mapping[str, str], now: Mapping[str, str]) -> dict[str, str]:
    """Both descriptions in one, every value that either has, and a note `mixed` where they differ.

    >>> joined({"numpy": "1"}, {"numpy": "1"}), joined({"numpy": "1"}, {"numpy": "2"})["numpy"]
    ({'numpy': '1'}, '1; 2')
    """
    if dict(before) == dict(now):
        return dict(now)
    names = (name for name in dict.fromkeys([*now, *before]) if name != "mixed")
    found = {name: [*before.get(name, "unknown").split("; "), now.get(name, "unknown")] for name in names}
    return {name: "; ".join(dict.fromkeys(values)) for name, values in found.items()} | {"mixed": MIXED}


class Keeper:
    """Says of a growing board whose measurements are in it, and writes it to `save`: now and then, and at the end.

    Leaving its `with`, for whatever reason, writes what is not yet written.
    """

    def __init__(self, before: Board, save: str | os.PathLike[str] | None) -> None:
        self._old = {id(entry): entry for entry in before.entries}
        self._meta = before.meta
        self._save = save
        self._unsaved: Board | None = None
        self._next = 0.0

    def __enter__(self) -> "Keeper":
        return self

    def __exit__(self, *_: object) -> None:
        self._write()

    def keep(self, board: Board) -> None:
        """The board has grown; it is written if the last time is `WRITE_EVERY_S` ago."""
        self._unsaved = board
        if time.monotonic() >= self._next:
            self._write()

    def finished(self, board: Board) -> Board:
        """The board with its `meta`; written, if only to have a file."""
        self._unsaved = board
        self._write()
        return self._signed(board)

    def _write(self) -> None:
        board, self._unsaved = self._unsaved, None
        if board is not None and self._save is not None:
            write_board(self._signed(board), self._save)
            self._next = time.monotonic() + WRITE_EVERY_S

    def _signed(self, board: Board) -> Board:
        old = [id(entry) in self._old for entry in board.entries]
        if old and all(old):
            return replace(board, meta=self._meta)
        return replace(board, meta=joined(self._meta, machine()) if any(old) else machine())
