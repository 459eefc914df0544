"""`twinlens verify`: is a dataset what its records say, and is its truth true?"""

import json
from typing import TYPE_CHECKING

import click

from twinlens.cli.places import PLACE
from twinlens.cli.progress import progress_bar

if TYPE_CHECKING:
    from twinlens.dataset import Place


@click.command("verify")
@click.argument("dataset", type=PLACE)
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def command(dataset: "Place", as_json: bool) -> int:
    """Check DATASET: checksums, shapes, disparity against depth, each view's truth against the other's.

    Names each sample and what is wrong with it, and how to mend what `twinlens generate` made; exit code 1 if anything
    is wrong. Samples that are still to be made are told, and are nothing wrong.

    \b
    Example:  twinlens verify out
    """
    from twinlens.dataset import cure, unchecked, unfinished

    findings = _findings(dataset, as_json)
    for more in filter(None, (unchecked(dataset), unfinished(dataset))):
        click.echo(f"{dataset}: {more}", err=True)
    whole, wrong = findings.pop("dataset.json", []), sum(map(bool, findings.values()))
    if as_json:
        click.echo(json.dumps(({"dataset.json": whole} if whole else {}) | findings, indent=1))
    else:
        samples = f"{len(findings)} sample{'' if len(findings) == 1 else 's'}"
        click.echo(f"{samples}, {wrong} with findings" + _of_the_whole(len(whole)))
    if way := cure(dataset, findings):
        click.echo(f"{dataset}: {way}", err=True)
    return 1 if wrong or whole else 0


def _of_the_whole(count: int) -> str:
    return f"; {count} finding{'' if count == 1 else 's'} of the dataset as a whole" if count else ""


def _findings(dataset: "Place", quiet: bool) -> dict[str, list[str]]:
    """Of dataset.json and of each sample, printed as they are found."""
    from twinlens.dataset import verify_place

    found = {}
    with progress_bar("verifying") as report:
        for name, lines in verify_place(dataset, report):
            found[name] = lines
            if not quiet:
                for line in lines:
                    click.echo(f"{name}: {line}")
    return found
