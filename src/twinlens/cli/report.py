"""`twinlens report`: the leaderboard page of an existing board."""

from collections.abc import Iterator
from pathlib import Path

import click

from twinlens.cli.places import HTML_FILE, PATH
from twinlens.errors import InputError
from twinlens.report import write_page
from twinlens.scoring import Board, MapFolder, Pair, open_pairs, read_board
from twinlens.scoring.samples import fingerprint


@click.command("report")
@click.argument("board", type=PATH)
@click.argument("datasets", nargs=-1, metavar="[DATASET...]")
@click.option("-o", "--output", type=HTML_FILE, help="The page.  [default: index.html next to the board]")
def command(board: Path, datasets: tuple[str, ...], output: Path | None) -> None:
    """Write the leaderboard page of BOARD (board.json or its folder), with images, truth and maps of DATASET...

    \b
    Example:  twinlens report board/board.json out motorcycle -o leaderboard.html
    """
    if board.is_dir():
        board = board / "board.json"
    scores, maps = read_board(board), MapFolder(board.parent / "maps")
    page = write_page(output or board.parent / "index.html", scores, _pairs_on(scores, datasets), maps)
    click.echo(f"page: {page.resolve().as_uri()}")


def _pairs_on(board: Board, datasets: tuple[str, ...]) -> Iterator[Pair]:
    """The pairs of the datasets that the board scores. Raises InputError if there is none, or if one has changed."""
    pairs = open_pairs(datasets)
    shared = [k for k, name in enumerate(pairs.aliases) if name in board.samples]
    if datasets and not shared:
        raise InputError(f"{', '.join(datasets)}: no sample is on the board; it has {', '.join(board.samples[:3])}")
    for k in shared:
        pair = pairs[k]
        board.check_sample(pair.name, fingerprint(pair))
        yield pair
