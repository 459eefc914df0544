"""`twinlens statistics`: what the images of a dataset look like, beside real pairs."""

import math
from pathlib import Path

import click

from twinlens.cli.options import json_option, print_json
from twinlens.cli.places import FIGURE_FILE
from twinlens.cli.progress import progress_bar
from twinlens.dataset.files import write_file
from twinlens.report.plots import pair_figure
from twinlens.scoring import STATISTICS, open_pairs, pair_statistics, summarize


@click.command("statistics")
@click.argument("datasets", nargs=-1, required=True, metavar="DATASET...")
@click.option("-o", "--output", type=FIGURE_FILE, help="Write a figure, a PNG or SVG file.")
@json_option("the statistics of each pair and their summary")
def command(datasets: tuple[str, ...], output: Path | None, as_json: bool) -> None:
    """Measure noise, texture and left-right differences of the pairs of DATASET..., beside those of 24 real pairs.

    DATASET is a folder with images and true disparity, or "motorcycle". Prints medians with 10 % and 90 % quantiles.

    \b
    Example:  twinlens statistics out -o statistics.png
              twinlens statistics motorcycle --json
    """
    pairs = open_pairs(datasets)
    rows = {}
    with progress_bar("measuring") as report:
        for i, pair in enumerate(pairs):
            report(i / len(pairs), pair.name)
            rows[pair.name] = pair_statistics(pair)
    summary = summarize(list(rows.values()))
    if output is not None:
        write_file(output, pair_figure(list(rows.values()), output.suffix.lower()[1:]))
    if as_json:
        print_json({"pairs": rows, "summary": summary, "real": {name: s.real for name, s in STATISTICS.items()}})
        return
    lines = [("statistic", "unit", f"{len(rows)} pair{'s' * (len(rows) != 1)}", "24 real pairs", "")]
    for name, statistic in STATISTICS.items():
        lines.append((name, statistic.unit, _text(summary[name]), _text(statistic.real), statistic.text))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        click.echo("  ".join(f"{text:{width}}" for text, width in zip(line, widths, strict=True)).rstrip())
    if output is not None:
        click.echo(f"figure: {output}")


def _text(values: tuple[float, float, float]) -> str:
    """Median (10 % to 90 %)."""
    if math.isnan(values[0]):
        return "-"
    return f"{values[0]:.3g}" + ("" if math.isnan(values[1]) else f" ({values[1]:.3g} to {values[2]:.3g})")
