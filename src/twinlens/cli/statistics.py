"""`twinlens statistics`: what the images of a dataset look like, beside real pairs."""

import json
import math
from pathlib import Path

import click

from twinlens.cli.places import PATH
from twinlens.errors import InputError


@click.command("statistics")
@click.argument("datasets", nargs=-1, required=True, metavar="DATASET...")
@click.option("-o", "--output", type=PATH, help="Write a figure, a PNG or SVG file.")
@click.option("--json", "as_json", is_flag=True, help="Print the statistics of each pair and their summary as JSON.")
def command(datasets: tuple[str, ...], output: Path | None, as_json: bool) -> None:
    """Measure noise, texture and left-right differences of the pairs of DATASET..., beside those of 24 real pairs.

    DATASET is a folder with images and true disparity, or "motorcycle". Prints medians with 10 % and 90 % quantiles.

    \b
    Example:  twinlens statistics out -o statistics.png
              twinlens statistics motorcycle --json
    """
    from twinlens.cli.progress import progress_bar
    from twinlens.dataset.files import write_file
    from twinlens.report.statistics_figure import statistics_figure
    from twinlens.scoring import STATISTICS, json_number, open_pairs, pair_statistics, summarize

    if output is not None and output.suffix.lower() not in (".png", ".svg"):
        raise InputError(f"--output {output}: must end in .png or .svg")
    pairs = open_pairs(datasets)
    rows = {}
    with progress_bar("measuring") as report:
        for i, pair in enumerate(pairs):
            report(i / len(pairs), pair.name)
            rows[pair.name] = pair_statistics(pair)
    summary = summarize(list(rows.values()))
    if output is not None:
        write_file(output, statistics_figure(list(rows.values()), output.suffix.lower()[1:]))
    if as_json:
        document = {
            "pairs": {name: {key: json_number(v) for key, v in row.items()} for name, row in rows.items()},
            "summary": {name: [json_number(v) for v in values] for name, values in summary.items()},
            "real": {
                name: None if s.real is None else [json_number(v) for v in s.real] for name, s in STATISTICS.items()
            },
        }
        click.echo(json.dumps(document, indent=1, allow_nan=False))
        return
    click.echo(f"{'statistic':18}{'unit':9}{f'{len(rows)} pairs':28}{'24 real pairs':28}")
    for name, statistic in STATISTICS.items():
        measured, real = (_text(values) for values in (summary[name], statistic.real))
        click.echo(f"{name:18}{statistic.unit:9}{measured:28}{real:28}{statistic.text}")
    if output is not None:
        click.echo(f"figure: {output}")


def _text(values: tuple[float, float, float] | None) -> str:
    """Median (10 % to 90 %)."""
    if values is None or math.isnan(values[0]):
        return "-"
    return f"{values[0]:.3g}" + ("" if math.isnan(values[1]) else f" ({values[1]:.3g} to {values[2]:.3g})")
