"""`twinlens statistics`: what the images of a dataset look like, beside real pairs."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from twinlens.cli.options import json_option, print_json
from twinlens.cli.places import FIGURE_FILE
from twinlens.cli.progress import progress_bar
from twinlens.dataset import Dataset
from twinlens.dataset.files import write_file
from twinlens.dataset.storage import place
from twinlens.errors import InputError
from twinlens.report.plots import pair_figure
from twinlens.scoring import (
    STATISTICS,
    Pair,
    fit_recipe,
    open_pairs,
    pair_statistics,
    recipe_toml,
    summarize,
)


@click.command("statistics")
@click.argument("datasets", nargs=-1, required=True, metavar="DATASET...")
@click.option(
    "-o", "--output", type=FIGURE_FILE, help="Write a figure, a PNG or SVG file."
)
@click.option(
    "--like",
    help="Fit the recipe of DATASET to the pairs of this folder; print it below the statistics.",
)
@json_option("the statistics of each pair and their summary")
def command(
    datasets: tuple[str, ...], output: Path | None, like: str | None, as_json: bool
) -> None:
    """Measure noise, texture and left-right differences of the pairs of DATASET..., beside those of 24 real pairs.

    DATASET is a folder with images, or "motorcycle". Prints medians with 10 % and 90 % quantiles. Of pairs without true
    disparity, only those statistics that need none. With --like, the output is a recipe whose comments are the
    statistics.

    \b
    Example:  twinlens statistics out -o statistics.png
              twinlens statistics motorcycle --json
              twinlens statistics out --like my-pairs > like.toml
    """
    if like is not None:
        _check_like(datasets)
    sets = [open_pairs(datasets)]
    if like:
        sets.append(open_pairs([like]))
    recipe: dict[str, Any] = {}
    notes: Sequence[str] = ()
    with progress_bar("measuring") as report:
        blind: list[str] = []
        measured = [_measured(pairs, report, blind) for pairs in sets]
        report(1.0, "recipe")
        if like:
            recipe, notes = fit_recipe(Dataset(datasets[0]), sets[1])
    summaries = [summarize(list(pairs.values())) for pairs in measured]
    if output is not None:
        figure = pair_figure(list(measured[0].values()), output.suffix.lower()[1:])
        write_file(output, figure)
    if as_json:
        fit = {"recipe": recipe, "notes": notes} if like else {}
        print_json(_record(measured, summaries) | fit)
        return
    lines = _table([len(pairs) for pairs in measured], summaries)
    lines += _missing(measured[0], blind)
    if output is not None:
        lines.append(f"figure: {output}")
    if not like:
        click.echo("\n".join(lines))
        return
    for line in (*lines, *notes):
        click.echo(f"# {line}")
    click.echo(recipe_toml(recipe), nl=False)


def _record(measured: Sequence[Any], summaries: Sequence[Any]) -> dict[str, Any]:
    """The statistics of the dataset, of the real pairs, and of the pairs of --like, as plain data."""
    record = {"pairs": measured[0], "summary": summaries[0]}
    record["real"] = {name: s.real for name, s in STATISTICS.items()}
    if len(measured) > 1:
        record["like"] = {"pairs": measured[1], "summary": summaries[1]}
    return record


def _check_like(datasets: Sequence[str]) -> None:
    """Raise errors unless --like can fit the recipe of the datasets."""
    if len(datasets) > 1:
        raise click.UsageError("--like fits the recipe of one DATASET")
    if not (place(datasets[0]) / "dataset.json").is_file():
        raise InputError(
            f"{datasets[0]}: has no dataset.json; --like needs a dataset of `twinlens generate`"
        )


def _measured(
    pairs: Sequence[Pair], report: Callable[[float, str], None], blind: list[str]
) -> dict[str, dict[str, float]]:
    """The statistics of each pair, by its name; the names of those without truth are added to `blind`."""
    measured = {}
    for i, pair in enumerate(pairs):
        report(i / len(pairs), pair.name)
        measured[pair.name] = pair_statistics(pair)
        if pair.disp0 is None:
            blind.append(pair.name)
    return measured


def _missing(measured: Mapping[str, Any], blind: Sequence[str]) -> list[str]:
    """The lines that say which pairs have no truth, and which statistics they lack."""
    if not blind:
        return []
    names = [name for name, statistic in STATISTICS.items() if statistic.needs_truth]
    listed = ", ".join(blind[:3]) + (", ..." if len(blind) > 3 else "")
    return [
        f"without truth: {len(blind)} of {len(measured)} pairs ({listed}); these statistics need it: {', '.join(names)}"
    ]


def _table(
    counts: Sequence[int],
    summaries: Sequence[Mapping[str, tuple[float, float, float]]],
) -> list[str]:
    """The lines of a table: for each statistic its values in the datasets, and in real pairs.

    counts : pairs of each dataset; those after the first are of `--like`.
    """
    titles = [f"{count} pair{'s' * (count != 1)}" for count in counts]
    titles[1:] = [f"like: {title}" for title in titles[1:]]
    rows = [("statistic", "unit", *titles, "24 real pairs", "")]
    for name, statistic in STATISTICS.items():
        values = [_text(summary[name]) for summary in summaries]
        rows.append(
            (name, statistic.unit, *values, _text(statistic.real), statistic.text)
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [f"{text:{width}}" for text, width in zip(row, widths, strict=True)]
        lines.append("  ".join(cells).rstrip())
    return lines


def _text(values: tuple[float, float, float]) -> str:
    """Median (10 % to 90 %), without the range if it is unknown or empty, as of one pair."""
    median, low, high = values
    if math.isnan(median):
        return "-"
    text = f"{median:.3g}"
    return f"{text} ({low:.3g} to {high:.3g})" if low < high else text
