"""`twinlens describe`: the card and the metadata of a dataset that is there."""

from typing import TYPE_CHECKING

import click

from twinlens.cli.places import PLACE

if TYPE_CHECKING:
    from twinlens.dataset import Place


@click.command("describe")
@click.argument("dataset", type=PLACE)
@click.option("--name", help="Of the dataset.  [default: its folder's]")
@click.option("--description", help="A sentence or more.")
@click.option("--license", "license", help="As CC-BY-4.0, or the address of a licence's text.")
@click.option("--creator", help="Who made it.")
@click.option("--url", help="Where it can be had.")
@click.option("--published", help="The date, as 2026-01-31.")
@click.option("--cite-as", help="A BibTeX entry.")
def command(dataset: "Place", **given: str | None) -> None:
    """Write DATASET's card (README.md with pictures and statistics) and its Croissant metadata (croissant.json).

    What is said here is kept in dataset.json, and need not be said again. Every dataset that twinlens makes is
    described already; do it again after changing one.

    \b
    Example:  twinlens describe out --license CC-BY-4.0 --creator "Ada Lovelace"
    """
    from twinlens.dataset import About, describe

    said = About.of({key: value for key, value in given.items() if value is not None})
    for file in describe(dataset, said):
        click.echo(str(dataset / file))
