"""`twinlens describe`: the card and the metadata of a dataset that is there."""

from typing import TYPE_CHECKING

import click

from twinlens.cli.places import PLACE

if TYPE_CHECKING:
    from twinlens.dataset import Place


@click.command("describe")
@click.argument("dataset", type=PLACE)
@click.option("--name", default="", help="Of the dataset.  [default: its folder's]")
@click.option("--description", default="", help="A sentence or more.")
@click.option("--license", "license_", default="", help="As CC-BY-4.0, or the address of a licence's text.")
@click.option("--creator", default="", help="Who made it.")
@click.option("--url", default="", help="Where it can be had.")
@click.option("--published", default="", help="The date, as 2026-01-31.")
@click.option("--cite-as", default="", help="A BibTeX entry.")
def command(
    dataset: "Place", name: str, description: str, license_: str, creator: str, url: str, published: str, cite_as: str
) -> None:
    """Write DATASET's card (README.md with pictures and statistics) and its Croissant metadata (croissant.json).

    What is said here is kept in dataset.json, and need not be said again. Every dataset that twinlens makes is
    described already; do it again after changing one.

    \b
    Example:  twinlens describe out --license CC-BY-4.0 --creator "Ada Lovelace"
    """
    from twinlens.dataset import About, describe

    said = About(name, description, license_, creator, url, published, cite_as)
    for file in describe(dataset, said):
        click.echo(str(dataset / file))
