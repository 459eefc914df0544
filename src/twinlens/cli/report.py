"""`twinlens report`: the leaderboard page of an existing board."""

from pathlib import Path

import click

from twinlens.cli.places import HTML_FILE, PATH
from twinlens.report import write_page
from twinlens.scoring import MapFolder, open_pairs, read_board


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
    pairs = open_pairs(datasets).on(scores) if datasets else ()
    page = write_page(output or board.parent / "index.html", scores, pairs, maps)
    click.echo(f"page: {page.resolve().as_uri()}")
