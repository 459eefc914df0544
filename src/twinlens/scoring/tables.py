"""A board as text: the terminal's table, CSV and LaTeX."""

import csv
import io
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypedDict, Unpack

from rich.markup import escape
from rich.table import Table
from rich.text import Text

from twinlens.scoring.board import Board, Mean
from twinlens.scoring.metrics import TIMES, Metric, find_metric
from twinlens.scoring.protocols import PROTOCOLS
from twinlens.scoring.regions import REGIONS

Groups = Mapping[str, Collection[str]]
"""Title -> names of the samples of a group."""
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


class Ranking(TypedDict, total=False):
    """The order and the columns of a table: as for `standings`, and the metrics, those of the protocol by default."""

    sort: str | None
    columns: Sequence[str] | None
    weights: Mapping[str, float] | None


def standings(
    board: Board,
    protocol: str,
    region: str = "all",
    *,
    sort: str | None = None,
    weights: Mapping[str, float] | None = None,
) -> list[Mean]:
    """The methods' means over samples, best first by the metric `sort`, by default the protocol's headline.

    Methods without a value come last, in the board's order. Raises InputError as `Board.rules` and `Board.mean` do.
    """
    _, metric = board.rules(protocol, region, sort)
    means = [board.mean(name, protocol, region, weights) for name in board.methods]
    sign = 1.0 if metric.lower_is_better else -1.0
    return sorted(
        means,
        key=lambda mean: (
            math.isnan(mean.metrics[metric.name]),
            sign * mean.metrics[metric.name],
        ),
    )


def has_confidence(board: Board, protocol: str) -> bool:
    """Whether a method of the board has sparsification curves by this protocol."""
    entries = (entry for entry in board.entries if entry.protocol == protocol)
    return any(
        scores.sparsification for entry in entries for scores in entry.regions.values()
    )


def caption(
    board: Board, protocol: str, region: str, weights: Mapping[str, float] | None = None
) -> str:
    """What a table's numbers mean, one line each: protocol, region, denominator, invalid, clip, resolution, mean."""
    text = REGIONS[region].text if region in REGIONS else "defined by the caller"
    over = "weighted mean over samples" if weights else "plain mean over samples"
    lines = {
        **board.rules(protocol, region)[0].lines(),
        "region": f"{region}: {text}",
        "mean": f"{over}; none if a method failed or was not run on a sample",
    }
    order = (
        "protocol",
        "region",
        "denominator",
        "invalid",
        "clip",
        "resolution",
        "mean",
    )
    return "\n".join(f"{name}: {lines[name]}" for name in order)


def leaderboard_table(
    board: Board, protocol: str, region: str = "all", **ranking: Unpack[Ranking]
) -> Table:
    """The leaderboard as a rich table, best first, the best value of each column in bold, with its caption."""
    metrics, rows = _ranked(board, protocol, region, **ranking)
    table = Table(
        title=escape(f"{board.title} · {PROTOCOLS[protocol].title} · {region}"),
        caption=Text(caption(board, protocol, region, ranking.get("weights"))),
        caption_justify="left",
        title_justify="left",
    )
    table.add_column("#", justify="right", style="dim")
    table.add_column("method", no_wrap=True)
    for metric in metrics:
        table.add_column(f"{metric.name}\n[dim]{metric.unit}[/]", justify="right")
    table.add_column("samples", justify="right")
    for rank, (mean, cells) in enumerate(rows, start=1):
        samples = Text(str(mean.counted))
        if mean.counted < mean.total:
            failed = f", {len(mean.failed)} failed" if mean.failed else ""
            samples = Text(f"{mean.counted} of {mean.total}{failed}", style="red")
        values = [Text(text, style="bold" if best else "") for text, best in cells]
        table.add_row(str(rank), Text(mean.method), *values, samples)
    return table


def group_means(
    board: Board, protocol: str, region: str, groups: Groups
) -> dict[str, dict[str, float]]:
    """Group -> method -> mean of the protocol's headline metric over the group's samples, best method first."""
    _, metric = board.rules(protocol, region)
    return {
        name: {
            mean.method: mean.metrics[metric.name]
            for mean in standings(board.subset(samples), protocol, region)
        }
        for name, samples in groups.items()
    }


def comparison_table(board: Board, protocol: str, region: str, groups: Groups) -> Table:
    """The protocol's headline metric, one column per group of samples, the first group's best method first."""
    (rules, metric), values = (
        board.rules(protocol, region),
        group_means(board, protocol, region, groups),
    )
    title = escape(
        f"{board.title} · {rules.title} · {region} · {metric.name} [{metric.unit}]"
    )
    table = Table(title=title, title_justify="left")
    table.add_column("method", no_wrap=True)
    for name in groups:
        table.add_column(name, justify="right")
    for method in next(iter(values.values())):
        cells = [
            Text(
                metric.show(column[method]),
                style="bold" if method == next(iter(column)) else "",
            )
            for column in values.values()
        ]
        table.add_row(Text(method), *cells)
    return table


def failures(board: Board, methods: Collection[str] | None = None) -> list[str]:
    """One line per kind of failure of each of these methods, None for all: the first sample, its message, the count."""
    found: dict[tuple[str, str], dict[str, str]] = {}
    for e in board.entries:
        if e.failure is not None and (methods is None or e.method in methods):
            found.setdefault((e.method, e.failure.kind), {}).setdefault(
                e.sample, e.failure.message
            )
    lines = []
    for (method, kind), samples in found.items():
        first, message = next(iter(samples.items()))
        more = f" and {len(samples) - 1} more" if len(samples) > 1 else ""
        lines.append(f"{method} on {first}{more}: {kind} ({message})")
    return lines


def board_csv(board: Board) -> str:
    """Every entry and region as a CSV row, in full precision; formulas of spreadsheets get a leading apostrophe."""
    metrics = tuple(
        dict.fromkeys(name for p in board.protocols for name in PROTOCOLS[p].metrics)
    )
    counts = ("image", "evaluated", "estimated")
    head = (
        "method",
        "sample",
        "protocol",
        "region",
        "status",
        "reason",
        "image_pixels",
        *counts[1:],
    )
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        [
            *head,
            *metrics,
            *(f"{name}_{find_metric(name).unit.split('/')[0]}" for name in TIMES),
        ]
    )
    for entry in board.entries:
        failure = (
            ["ok", ""]
            if entry.failure is None
            else [entry.failure.kind, entry.failure.message]
        )
        for region in entry.regions or ("",):
            text = [entry.method, entry.sample, entry.protocol, region, *failure]
            scores = entry.regions.get(region)
            numbers = [entry.value(region, name) for name in (*metrics, *TIMES)]
            writer.writerow(
                [
                    *(
                        f"'{each}" if each.startswith(_FORMULA_STARTS) else each
                        for each in text
                    ),
                    *(
                        "" if scores is None else getattr(scores, name)
                        for name in counts
                    ),
                    *("" if math.isnan(number) else repr(number) for number in numbers),
                ]
            )
    return out.getvalue()


def board_latex(
    board: Board, protocol: str, region: str = "all", **ranking: Unpack[Ranking]
) -> str:
    """The leaderboard as a LaTeX table (package booktabs), the best value of each column in bold."""
    metrics, rows = _ranked(board, protocol, region, **ranking)
    head = " & ".join(
        ["Method", *(_latex(f"{metric.name} [{metric.unit}]") for metric in metrics)]
    )
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_latex('. '.join(caption(board, protocol, region, ranking.get('weights')).splitlines()))}.}}",
        rf"\begin{{tabular}}{{l{'r' * len(metrics)}}}",
        r"\toprule",
        rf"{head} \\",
        r"\midrule",
    ]
    for mean, cells in rows:
        shown = [
            (text.replace("–", "--").replace("∞", r"$\infty$"), best)
            for text, best in cells
        ]
        values = [rf"\textbf{{{text}}}" if best else text for text, best in shown]
        lines.append(" & ".join([_latex(mean.method), *values]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}"]) + "\n"


def _ranked(
    board: Board,
    protocol: str,
    region: str,
    columns: Sequence[str] | None = None,
    **ranking: Any,
) -> tuple[list[Metric], list[tuple[Mean, list[tuple[str, bool]]]]]:
    """The metrics of the columns, and for each mean, best first, its cells: the text, and whether it is the best."""
    means = standings(board, protocol, region, **ranking)
    rules = PROTOCOLS[protocol]
    areas = rules.auc_metrics if has_confidence(board, protocol) else ()
    names = (*rules.columns, *areas, "time") if columns is None else columns
    metrics, cells = [board.rules(protocol, region, name)[1] for name in names], []
    for metric in metrics:
        values = [mean.metrics[metric.name] for mean in means]
        best = (min if metric.lower_is_better else max)(
            (v for v in values if not math.isnan(v)), default=math.nan
        )
        cells.append([(metric.show(value), value == best) for value in values])
    return metrics, [
        (mean, [column[k] for column in cells]) for k, mean in enumerate(means)
    ]


_TEXT = {
    "\\": "backslash",
    "~": "asciitilde",
    "^": "asciicircum",
    "|": "bar",
    "<": "less",
    ">": "greater",
}
_LATEX = str.maketrans(
    {c: f"\\{c}" for c in "&%$#_{}"}
    | {c: rf"\text{name}{{}}" for c, name in _TEXT.items()}
)


def _latex(text: str) -> str:
    return " ".join(text.split()).translate(_LATEX)
