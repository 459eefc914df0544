"""`twinlens report`: the leaderboard page of an existing board."""

from pathlib import Path

import click

from twinlens.cli.places import HTML_FILE, PATH
from twinlens.report import write_page
from twinlens.scoring import MapFolder, open_pairs, read_board


@click.command("report")
@click.argument("board", type=PATH)
@click.argument("datasets", nargs=-1, metavar="[DATASET...]")
@click.option(
    "-o",
    "--output",
    type=HTML_FILE,
    help="The page.  [default: index.html next to the board]",
)
def command(board: Path, datasets: tuple[str, ...], output: Path | None) -> None:
    """Write the leaderboard page of BOARD (board.json or its folder), with images, truth and maps of DATASET...

    \b
    Example:  twinlens report board/board.json out motorcycle -o leaderboard.html
    """
    scores, folder = read_board(board), board if board.is_dir() else board.parent
    pairs = open_pairs(datasets).on(scores) if datasets else ()
    page = write_page(
        output or folder / "index.html", scores, pairs, MapFolder(folder / "maps")
    )
    click.echo(f"page: {page.resolve().as_uri()}")
