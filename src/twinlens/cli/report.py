"""`twinlens report`: the leaderboard page of an existing board."""

from pathlib import Path

import click

from twinlens.cli.boards import map_folders
from twinlens.cli.places import HTML_FILE, PATH
from twinlens.errors import located
from twinlens.report import write_page
from twinlens.scoring import groups_by, open_pairs, read_board


@click.command("report")
@click.argument("board", type=PATH)
@click.argument("datasets", nargs=-1, metavar="[DATASET...]")
@click.option(
    "-o",
    "--output",
    type=HTML_FILE,
    help="The page.  [default: index.html next to the board]",
)
@click.option(
    "--by",
    default="",
    metavar="NAME",
    help="Recorded value whose groups the page compares at first.  [default: lens]",
)
def command(
    board: Path, datasets: tuple[str, ...], output: Path | None, by: str
) -> None:
    """Write the leaderboard page of BOARD (board.json or its folder), with images, truth and maps of DATASET...

    \b
    Example:  twinlens report board/board.json out motorcycle -o leaderboard.html
    """
    scores, folder = read_board(board), board if board.is_dir() else board.parent
    if by:
        with located("--by"):
            groups_by(scores, by)
    pairs = open_pairs(datasets).on(scores) if datasets else ()
    maps, right_maps = map_folders(folder)
    page = write_page(
        output or folder / "index.html",
        scores,
        pairs,
        maps,
        right_maps=right_maps,
        by=by,
    )
    click.echo(f"page: {page.resolve().as_uri()}")
