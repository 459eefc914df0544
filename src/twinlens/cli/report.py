"""`twinlens report`: a measured board, and the datasets it was measured on, as one page."""

from pathlib import Path

import click

from twinlens.cli.places import PATH


@click.command("report")
@click.argument("board", type=PATH)
@click.argument("datasets", nargs=-1, metavar="[DATASET...]")
@click.option("-o", "--output", type=PATH, help="The page.  [default: index.html beside the board]")
def command(board: Path, datasets: tuple[str, ...], output: Path | None) -> None:
    """Make the leaderboard page of BOARD (a board.json, or its folder). DATASET... add their images, truth and maps.

    \b
    Example:  twinlens report board/board.json out motorcycle -o leaderboard.html
    """
    from twinlens.cli.benchmark import Chain, pairs_of
    from twinlens.report import write_page
    from twinlens.scoring import MapFolder, read_board

    if board.is_dir():
        board = board / "board.json"
    scores = read_board(board)
    pairs = Chain([pairs_of(name) for name in datasets])
    page = write_page(output or board.parent / "index.html", scores, pairs, MapFolder(board.parent / "maps"))
    click.echo(f"page: {page.resolve().as_uri()}")
