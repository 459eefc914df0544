"""`twinlens benchmark`: matchers x samples -> board.json, the table, and the page."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from twinlens.cli.boards import OPTIONS, Listing, print_board, run_board
from twinlens.cli.places import PATH
from twinlens.errors import InputError

DEFAULT_METHODS = "sad,ssd,zncc"
FOREIGN_LIMIT_S = 600.0
"""The default limit of a stranger's code: with a limit it runs in a process of its own, where it can do no harm."""


@click.command("benchmark")
@click.argument("datasets", nargs=-1, required=True, metavar="DATASET...")
@click.option("-o", "--output", required=True, type=PATH, help="Folder of the board.")
@click.option(
    "--methods", "methods", multiple=True,
    help="Matchers, commas between them, as sad,zncc:block_size=15,lr_check=1; may be given several times.  "
    f"[default: {DEFAULT_METHODS}]",
)  # fmt: skip
@click.option(
    "--command", "commands", multiple=True, metavar="[NAME=]COMMAND",
    help="Any program, as mine='prog {left} {right} {out}': reads two PNGs, writes a PFM; {num_disparities} is known "
    "too. No shell reads it. May be given several times.",
)  # fmt: skip
@click.option(
    "--warm-up-limit", type=float, cls=Listing, registry="WARM_UP_LIMIT_S",
    help="Under a limit: seconds that a method's first match of a few rows may take, which does not count.  "
    "[default: NAMES]",
)  # fmt: skip
@click.option("--retry-failed", is_flag=True, help="Run again what failed in an earlier run.")
@OPTIONS
def command(
    datasets: tuple[str, ...],
    output: Path,
    methods: tuple[str, ...],
    commands: tuple[str, ...],
    warm_up_limit: float | None,
    retry_failed: bool,
    protocols: tuple[str, ...],
    regions: tuple[str, ...],
    time_limit: float | None,
    memory_limit: float | None,
    as_json: bool,
) -> int:
    """Run matchers on every pair of DATASET..., score them, and write OUTPUT/board.json and OUTPUT/index.html.

    A dataset is a folder that `twinlens render` made, a folder in Middlebury's layout, or the word motorcycle: the
    real pair with measured truth that comes along. What OUTPUT/board.json holds already is not run again, its
    failures only with --retry-failed. A matcher that crashes, answers nonsense, takes longer than --time-limit or
    more than --memory-limit fails alone: the board says why. Where all fail everywhere the exit code is 1.

    \b
    Example:  twinlens benchmark out motorcycle --methods sad,zncc:block_size=15 -o board
              twinlens benchmark out --command "mine=./prog --fast {left} {right} {out}" --time-limit 60 -o board
    """
    matchers = matchers_of(methods, commands, time_limit)
    pairs = Chain([pairs_of(name) for name in datasets])
    if time_limit is None and any(getattr(matcher, "is_foreign", False) for matcher in matchers):
        time_limit = FOREIGN_LIMIT_S
    board = run_board(
        pairs, matchers, output, protocols, regions, time_limit,
        memory_limit=memory_limit, warm_up_limit=warm_up_limit, retry_failed=retry_failed,
    )  # fmt: skip
    return print_board(board, output, as_json, [matcher.name for matcher in matchers])


class Chain(Sequence[Any]):
    """Sequences one after the other; each item is fetched when it is asked for."""

    def __init__(self, parts: Sequence[Sequence[Any]]) -> None:
        self._parts = parts
        self._places = [(part, i) for part in parts for i in range(len(part))]

    @property
    def names(self) -> tuple[str, ...]:
        """The pairs' names, in order; no image is read where a part knows its names."""
        return tuple(name for part in self._parts for name in getattr(part, "aliases", None) or [p.name for p in part])

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, index: Any) -> Any:
        part, i = self._places[index]
        return part[i]


def pairs_of(name: str) -> Sequence[Any]:
    """The pairs of a dataset's folder, or of the one that comes along."""
    from twinlens.dataset import Dataset, motorcycle
    from twinlens.scoring import DatasetPairs

    if name == "motorcycle" and not Path(name).exists():
        return [motorcycle()]
    return DatasetPairs(Dataset(name))


def matchers_of(methods: Sequence[str], commands: Sequence[str], time_limit: float | None) -> list[Any]:
    """The named matchers and then the programs; DEFAULT_METHODS where neither is given."""
    from twinlens.scoring import named_methods, named_program

    texts = methods or (() if commands else (DEFAULT_METHODS,))
    named = named_methods(split_methods(texts)) if texts else []
    return [*named, *(named_program(text, time_limit) for text in commands)]


def split_methods(texts: Sequence[str]) -> list[str]:
    """The methods named, at commas that stand neither between one method's options nor inside quotes.

    >>> split_methods(["sad,zncc:block_size=15,lr_check=1,ssd"])
    ['sad', 'zncc:block_size=15,lr_check=1', 'ssd']
    >>> split_methods(["program:command='prog -s 3,4 {left} {right} {out}',sad"])
    ["program:command='prog -s 3,4 {left} {right} {out}'", 'sad']
    """
    from twinlens.matching import split_commas

    methods: list[str] = []
    for part in (part for text in texts for part in split_commas(text)):
        if methods and re.match(r"\w+\s*=", part):
            methods[-1] += f",{part}"
        else:
            methods.append(part)
    if not methods:
        raise InputError("--methods names no matcher")
    return methods
