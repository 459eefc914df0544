"""The board file during a run: its lock, resuming an earlier board, periodic writing, the machine's description."""

import contextlib
import os
import platform
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

import twinlens
from twinlens.dataset.lock import locked
from twinlens.scoring.board import Board
from twinlens.scoring.board_file import read_board, write_board

WRITE_EVERY_S = 2.0
"""Minimum interval between writes: each write takes time in proportion to the number of entries."""
MIXED = "entries of several machines or versions"


@contextlib.contextmanager
def exclusive(folder: Path, file: str = "") -> Iterator[None]:
    """Lock `folder`, or one board `file` in it, against other runs; creates the folder, and removes it if left empty.

    Raises OutputError if another run holds the lock or the folder cannot be created.
    """
    created = [each for each in (folder, *folder.parents) if not each.is_dir()]
    try:
        with locked(folder, file=file):
            yield
    finally:
        for each in created:
            with contextlib.suppress(OSError):
                each.rmdir()


def resumed(save: str | os.PathLike[str] | None, board: Board | None, title: str) -> Board:
    """The board to continue: `board`, else the one in the file, else an empty one; with the new title.

    Raises
    ------
    FileError
        The file is not a board.
    """
    if board is None and save is not None and Path(save).exists():
        board = read_board(save)
    return replace(board or Board(), title=title)


def machine() -> dict[str, str]:
    """Versions and machine, for readers of the times; nothing that identifies the machine."""
    return {
        "twinlens": getattr(twinlens, "__version__", "unknown"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "system": f"{platform.system()} {platform.machine()}",
        "processors": str(os.cpu_count()),
    }


def joined(before: Mapping[str, str], now: Mapping[str, str]) -> dict[str, str]:
    """Both descriptions in one: all values of each key, and the key `mixed` if they differ.

    >>> joined({"numpy": "1"}, {"numpy": "1"}), joined({"numpy": "1"}, {"numpy": "2"})["numpy"]
    ({'numpy': '1'}, '1; 2')
    """
    if dict(before) == dict(now):
        return dict(now)
    names = (name for name in dict.fromkeys([*now, *before]) if name != "mixed")
    found = {name: [*before.get(name, "unknown").split("; "), now.get(name, "unknown")] for name in names}
    return {name: "; ".join(dict.fromkeys(values)) for name, values in found.items()} | {"mixed": MIXED}


class BoardWriter:
    """Writes a growing board to `save`: every few seconds, and at the end of its `with` block, also on an exception."""

    def __init__(self, before: Board, save: str | os.PathLike[str] | None) -> None:
        self._old = {id(entry): entry for entry in before.entries}
        self._meta = before.meta
        self._save = save
        self._unsaved: Board | None = None
        self._next = 0.0

    def __enter__(self) -> "BoardWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self._write()

    def update(self, board: Board) -> None:
        """Keep this board; write it if the last write was `WRITE_EVERY_S` ago."""
        self._unsaved = board
        if time.monotonic() >= self._next:
            self._write()

    def finish(self, board: Board) -> Board:
        """Write the board, even without new entries, and return it with its `meta`."""
        self._unsaved = board
        self._write()
        return self._with_meta(board)

    def _write(self) -> None:
        board, self._unsaved = self._unsaved, None
        if board is not None and self._save is not None:
            write_board(self._with_meta(board), self._save)
            self._next = time.monotonic() + WRITE_EVERY_S

    def _with_meta(self, board: Board) -> Board:
        old = [id(entry) in self._old for entry in board.entries]
        if old and all(old):
            return replace(board, meta=self._meta)
        return replace(board, meta=joined(self._meta, machine()) if any(old) else machine())
