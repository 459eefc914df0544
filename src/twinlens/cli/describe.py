"""`twinlens describe`: the card and the metadata of a dataset."""

import click

from twinlens.cli.places import PLACE
from twinlens.dataset import About, Place, describe


@click.command("describe")
@click.argument("dataset", type=PLACE)
@click.option("--name", help="Name of the dataset.  [default: stereo dataset]")
@click.option("--description", help="One or more sentences.")
@click.option(
    "--license",
    "license",
    help="A licence, such as CC-BY-4.0, or the address of its text.",
)
@click.option("--creator", help="Author or organisation.")
@click.option("--url", help="Address of the dataset.")
@click.option("--published", help="Date of publication, such as 2026-01-31.")
@click.option("--cite-as", help="A BibTeX entry.")
def command(dataset: Place, **fields: str | None) -> None:
    """Write DATASET's card (README.md with pictures and statistics) and its Croissant metadata (croissant.json).

    The options are stored in dataset.json and kept by later runs. Datasets made by twinlens already have both files;
    run this command to change the options or after changing the dataset.

    \b
    Example:  twinlens describe out --license CC-BY-4.0 --creator "Your Name"
    """
    about = About.of({key: value for key, value in fields.items() if value is not None})
    for file in describe(dataset, about):
        click.echo(str(dataset / file))
