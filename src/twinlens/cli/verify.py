"""`twinlens verify`: is a dataset what its records say, and is its truth true?"""

import json
from pathlib import Path

import click


@click.command("verify")
@click.argument("dataset", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def command(dataset: Path, as_json: bool) -> int:
    """Check DATASET: checksums, shapes, disparity against depth, each view's truth against the other's.

    Names each sample and what is wrong with it; exit code 1 if anything is.

    \b
    Example:  twinlens verify out
    """
    from twinlens.dataset import Dataset, verify_dataset

    findings = dict(verify_dataset(Dataset(dataset)))
    wrong = sum(map(bool, findings.values()))
    if as_json:
        click.echo(json.dumps(findings, indent=1))
    else:
        for name, found in findings.items():
            for line in found:
                click.echo(f"{name}: {line}")
        click.echo(f"{len(findings)} samples, {wrong} with findings")
    return 1 if wrong else 0
