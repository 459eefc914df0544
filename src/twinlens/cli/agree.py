"""`twinlens agree`: compare the rankings of two leaderboards."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from twinlens.cli.options import Whole, json_option, print_json
from twinlens.cli.places import FIGURE_FILE, PATH
from twinlens.dataset.files import write_file
from twinlens.errors import counted
from twinlens.report.plots import agreement_figure
from twinlens.scoring import agreement
from twinlens.scoring.agreement import Agreement

MOVES = 5  # methods listed, those whose rank differs most


@click.command("agree")
@click.argument("board_a", type=PATH)
@click.argument("board_b", type=PATH)
@click.option(
    "--protocol", help="Scoring rules.  [default: the first that both boards have]"
)
@click.option(
    "--region",
    default="nonocc",
    show_default=True,
    help="Region whose scores are compared.",
)
@click.option(
    "--metric", help="Metric to rank by.  [default: the protocol's headline metric]"
)
@click.option(
    "--seed", type=Whole(0), default=0, show_default=True, help="Seed of the bootstrap."
)
@click.option(
    "-o", "--output", type=FIGURE_FILE, help="Write a figure, a PNG or SVG file."
)
@json_option("the result")
def command(
    board_a: Path, board_b: Path, output: Path | None, as_json: bool, **options: Any
) -> None:
    """Compare how two boards rank the methods that both have, three or more.

    BOARD_A and BOARD_B are board.json files or their folders. Prints Kendall's tau-b and Spearman's rho of the methods'
    mean ranks, with 95 % bootstrap intervals over scenes, and how well each board agrees with itself.

    \b
    Example:  twinlens agree board real-board -o agreement.png
    """
    result = agreement(board_a, board_b, **options)
    names = str(board_a), str(board_b)
    if output is not None:
        write_file(output, agreement_figure(result, names, output.suffix.lower()[1:]))
    if as_json:
        print_json(asdict(result))
        return
    _print(result, names)
    if output is not None:
        click.echo(f"figure: {output}")


def _print(result: Agreement, names: tuple[str, str]) -> None:
    """Print the agreement of two boards with these names."""
    click.echo(
        f"{counted(len(result.moves), 'method')} ranked by {result.metric}, {result.region}, {result.protocol}"
    )
    click.echo(f"Kendall's tau-b  {result.tau}\nSpearman's rho   {result.rho}")
    click.echo("tau-b between random halves of the scenes of one board:")
    click.echo(
        f"  {names[0]}: {result.reliability_a}; samples: {result.samples_a}, scenes: {result.scenes_a}"
    )
    click.echo(
        f"  {names[1]}: {result.reliability_b}; samples: {result.samples_b}, scenes: {result.scenes_b}"
    )
    for note in result.notes(names):
        click.echo(note)
    ranks = [
        (move.method, f"{move.rank_a:.1f}", f"{move.rank_b:.1f}")
        for move in result.moves[:MOVES]
    ]
    differ = [f"  {method}: {a} and {b}" for method, a, b in ranks if a != b]
    click.echo(
        "\n".join(["largest differences of mean rank:", *differ])
        if differ
        else "no mean ranks differ"
    )
