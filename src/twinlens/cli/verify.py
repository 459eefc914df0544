"""`twinlens verify`: checks of a dataset's files and of its truth."""

import click

from twinlens.cli.options import json_option, print_json
from twinlens.cli.places import PLACE
from twinlens.cli.progress import progress_bar
from twinlens.dataset import Place, verify_place
from twinlens.dataset.verify import missing_parts, repair_hint


@click.command("verify")
@click.argument("dataset", type=PLACE)
@json_option("the findings")
def command(dataset: Place, as_json: bool) -> int:
    """Check DATASET: checksums, array shapes, disparity against depth, and the truth of each view against the other.

    Lists the findings of each sample, and how to repair datasets of `twinlens generate`. The exit code is 1 if there
    are findings. Samples that `generate` has not made yet are reported but do not count as findings.

    \b
    Example:  twinlens verify out
    """
    findings: dict[str, list[str]] = {}
    try:
        with progress_bar("verifying") as report:
            findings.update(verify_place(dataset, report))
    finally:  # those so far if it is interrupted
        for name, lines in () if as_json else findings.items():
            for line in lines:
                click.echo(f"{name}: {line}")
    if note := missing_parts(dataset):
        click.echo(f"{dataset}: {note}", err=True)
    whole = findings.pop("dataset.json", [])
    damaged = sum(map(bool, findings.values()))
    if as_json:
        print_json(({"dataset.json": whole} if whole else {}) | findings)
    else:
        of_dataset = (
            f"; {_count(len(whole), 'finding')} of the dataset as a whole"
            if whole
            else ""
        )
        click.echo(
            f"{_count(len(findings), 'sample')}, {damaged} with findings{of_dataset}"
        )
    if repair := repair_hint(dataset, findings):
        click.echo(f"{dataset}: {repair}", err=True)
    return 1 if damaged or whole else 0


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
