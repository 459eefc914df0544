"""`twinlens benchmark`: matchers x samples -> board.json, the table, and the page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from twinlens.cli.boards import OPTIONS, print_board, run_board
from twinlens.errors import InputError

DEFAULT_METHODS = "sad,ssd,zncc"


@click.command("benchmark")
@click.argument("datasets", nargs=-1, required=True, metavar="DATASET...")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder of the board.")
@click.option(
    "--methods", "methods", multiple=True, default=(DEFAULT_METHODS,), show_default=True,
    help="Matchers, commas between names; one with several options stands in a --methods of its own.",
)  # fmt: skip
@OPTIONS
def command(
    datasets: tuple[str, ...],
    output: Path,
    methods: tuple[str, ...],
    protocols: tuple[str, ...],
    regions: tuple[str, ...],
    time_limit: float | None,
    as_json: bool,
) -> None:
    """Run matchers on every pair of DATASET..., score them, and write OUTPUT/board.json and OUTPUT/index.html.

    A dataset is a folder that `twinlens render` made, a folder in Middlebury's layout, or the word motorcycle: the
    real pair with measured truth that comes along. What OUTPUT/board.json holds already is not run again.

    \b
    Example:  twinlens benchmark out motorcycle --methods sad,zncc:block_size=15 -o board
    """
    from twinlens.scoring import named_methods

    pairs = Chain([pairs_of(name) for name in datasets])
    board = run_board(pairs, named_methods(split_methods(methods)), output, protocols, regions, time_limit)
    print_board(board, output, as_json)


class Chain(Sequence[Any]):
    """Sequences one after the other; each item is fetched when it is asked for."""

    def __init__(self, parts: Sequence[Sequence[Any]]) -> None:
        self._places = [(part, i) for part in parts for i in range(len(part))]

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


def split_methods(texts: Sequence[str]) -> list[str]:
    """The methods named, at commas that do not stand between one method's options.

    >>> split_methods(["sad,zncc:block_size=15,lr_check=1,ssd"])
    ['sad', 'zncc:block_size=15,lr_check=1', 'ssd']
    """
    methods: list[str] = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        if methods and "=" in part and ":" not in part:
            methods[-1] += f",{part}"
        elif part:
            methods.append(part)
    if not methods:
        raise InputError("--methods names no matcher")
    return methods
