"""A board as text: the terminal's table, CSV and LaTeX."""

import csv
import io
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from typing import Any, TypedDict, Unpack

from rich.markup import escape
from rich.table import Table
from rich.text import Text

from twinlens.scoring.board import Board, MatchFailure, Mean
from twinlens.scoring.grouping import (
    Comparison,
    Groups,
    compare_groups,
    groups_of_protocol,
    recorded_names,
    recorded_value,
)
from twinlens.scoring.metrics import TIMES, Metric, find_metric
from twinlens.scoring.protocols import PROTOCOLS
from twinlens.scoring.regions import REGIONS

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
    methods: Sequence[str] | None = None,
) -> list[Mean]:
    """The methods' means over samples, best first by the metric `sort`, by default the protocol's headline.

    methods: those of the board by default. Methods without a value come last, in this order. Raises InputError as
    `Board.rules` and `Board.mean` do.
    """
    _, metric = board.rules(protocol, region, sort)
    means = board.means(protocol, region, weights, methods=methods).values()
    sign = 1.0 if metric.lower_is_better else -1.0

    def order(mean: Mean) -> tuple[bool, float]:
        value = mean.metrics[metric.name]
        return math.isnan(value), sign * value

    return sorted(means, key=order)


def has_confidence(board: Board, protocol: str) -> bool:
    """Whether a method of the board has sparsification curves by this protocol."""
    for entry in board.entries:
        scores = entry.regions.values()
        if entry.protocol == protocol and any(s.sparsification for s in scores):
            return True
    return False


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
    order = [
        "protocol",
        "region",
        "denominator",
        "invalid",
        "clip",
        "resolution",
        "mean",
    ]
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
    means = {}
    for name, samples in groups.items():
        part = board.subset(samples)
        table = standings(part, protocol, region, methods=board.methods)
        means[name] = {mean.method: mean.metrics[metric.name] for mean in table}
    return means


def comparison_table(
    board: Board,
    protocol: str,
    region: str,
    groups: Groups,
    comparison: Comparison | None = None,
) -> Table:
    """The protocol's headline metric, one column per group of samples, the first group's best method first.

    With a `comparison` of these groups also the differences from the first group, with their intervals.
    """
    rules, metric = board.rules(protocol, region)
    columns = list(group_means(board, protocol, region, groups).values())
    title = f"{board.title} · {rules.title} · {region} · {metric.name} [{metric.unit}]"
    table = Table(title=escape(title), title_justify="left")
    table.add_column("method", no_wrap=True)
    for name in groups:
        table.add_column(escape(name), justify="right")
    first = next(iter(groups))
    differences = {} if comparison is None else comparison.differences
    for name in differences:
        basis = f"\n[dim]{comparison.basis(name)}[/]" if comparison else ""
        table.add_column(f"{escape(f'{name} - {first}')}{basis}", justify="right")
    for method in columns[0]:
        cells = []
        for means in columns:
            best = next(iter(means))
            style = "bold" if method == best else ""
            cells.append(Text(metric.show(means[method]), style=style))
        intervals = [of_group[method].interval for of_group in differences.values()]
        cells += [Text(interval.format(show=metric.show)) for interval in intervals]
        table.add_row(Text(method), *cells)
    return table


def comparison_record(board: Board, groups: Groups) -> dict[str, Any]:
    """Groups as plain data: their samples, and by protocol and region means and differences of each method."""
    record: dict[str, Any] = {"groups": {name: [*groups[name]] for name in groups}}
    for protocol in board.protocols:
        of_protocol = groups_of_protocol(board, protocol, groups)
        if not of_protocol:
            continue
        record[protocol] = {}
        for region in board.regions_of(protocol):
            comparison = compare_groups(board, protocol, region, of_protocol)
            record[protocol][region] = asdict(comparison)
    return record


def failures(board: Board, methods: Collection[str] | None = None) -> list[str]:
    """Lines for each kind of failure of each of these methods, None for all: the first sample, its message, the count.

    Below the line of an exception are the last frames of its traceback.
    """
    kinds: dict[tuple[str, str], dict[str, MatchFailure]] = {}
    for entry in board.entries:
        wanted = methods is None or entry.method in methods
        if entry.failure is not None and wanted:
            of_kind = kinds.setdefault((entry.method, entry.failure.kind), {})
            of_kind.setdefault(entry.sample, entry.failure)
    lines = []
    for (method, kind), samples in kinds.items():
        first, failure = next(iter(samples.items()))
        more = f" and {len(samples) - 1} more" if len(samples) > 1 else ""
        lines.append(f"{method} on {first}{more}: {kind} ({failure.message})")
        lines += [f"    {frame}" for frame in failure.frames]
    return lines


def map_warnings(board: Board, methods: Collection[str] | None = None) -> list[str]:
    """A line for each method, of these or of all, with a doubt about at least half of its maps (`Scores.doubt`)."""
    maps: dict[str, set[str]] = {}
    doubted: dict[tuple[str, str], set[str]] = {}
    for entry in board.entries:
        if entry.ok and (methods is None or entry.method in methods):
            maps.setdefault(entry.method, set()).add(entry.sample)
            if entry.doubt:
                doubted.setdefault((entry.method, entry.doubt), set()).add(entry.sample)
    lines = []
    for (method, doubt), samples in doubted.items():
        count = len(maps[method])
        if 2 * len(samples) >= count:
            maps_of = "its map" if count == 1 else f"{len(samples)} of {count} maps"
            lines.append(f"{method}, {maps_of}: {doubt}")
    return lines


def board_csv(board: Board) -> str:
    """Every entry and region as a CSV row, in full precision, with the sample's scene and recorded values at its end.

    Formulas of spreadsheets get a leading apostrophe.
    """
    names = [name for rules in board.protocols for name in PROTOCOLS[rules].metrics]
    metrics = tuple(dict.fromkeys(names))
    times = [f"{name}_{find_metric(name).unit.split('/')[0]}" for name in TIMES]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    recorded = recorded_names(board)
    writer.writerow([*_CSV_COLUMNS, *metrics, *times, *map(_csv_text, recorded)])
    for entry in board.entries:
        origin = [_csv_value(board, entry.sample, name) for name in recorded]
        status = ["ok", ""]
        if entry.failure is not None:
            status = [entry.failure.kind, entry.failure.message]
        for region in entry.regions or ("",):
            text = [entry.method, entry.sample, entry.protocol, region, *status]
            counts = ["", "", ""]
            if region in entry.regions:
                scores = entry.regions[region]
                sizes = scores.image, scores.evaluated, scores.estimated
                counts = [str(size) for size in sizes]
            values = [entry.value(region, name) for name in (*metrics, *TIMES)]
            numbers = ["" if math.isnan(value) else repr(value) for value in values]
            writer.writerow([*map(_csv_text, text), *counts, *numbers, *origin])
    return out.getvalue()


_CSV_COLUMNS = (
    *("method", "sample", "protocol", "region", "status", "reason"),
    *("image_pixels", "evaluated", "estimated"),
)


def _csv_value(board: Board, sample: str, name: str) -> str:
    """A recorded value of a sample; empty where there is none."""
    value = recorded_value(board, sample, name)
    if isinstance(value, str):
        return _csv_text(value)
    return "" if value is None else repr(value)


def _csv_text(text: str) -> str:
    """A spreadsheet would run a text that begins like a formula."""
    return f"'{text}" if text.startswith(_FORMULA_STARTS) else text


def board_latex(
    board: Board, protocol: str, region: str = "all", **ranking: Unpack[Ranking]
) -> str:
    """The leaderboard as a LaTeX table (package booktabs), the best value of each column in bold."""
    metrics, rows = _ranked(board, protocol, region, **ranking)
    titles = [_latex(f"{metric.name} [{metric.unit}]") for metric in metrics]
    head = " & ".join(["Method", *titles])
    text = caption(board, protocol, region, ranking.get("weights"))
    sentences = _latex(". ".join(text.splitlines()))
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{sentences}.}}",
        rf"\begin{{tabular}}{{l{'r' * len(metrics)}}}",
        r"\toprule",
        rf"{head} \\",
        r"\midrule",
    ]
    for mean, cells in rows:
        values = []
        for value, best in cells:
            shown = value.replace("–", "--").replace("∞", r"$\infty$")
            values.append(rf"\textbf{{{shown}}}" if best else shown)
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
    metrics = [board.rules(protocol, region, name)[1] for name in names]
    columns_of_cells = []
    for metric in metrics:
        values = [mean.metrics[metric.name] for mean in means]
        finite = [value for value in values if not math.isnan(value)]
        best_of = min if metric.lower_is_better else max
        best = best_of(finite, default=math.nan)
        columns_of_cells.append(
            [(metric.show(value), value == best) for value in values]
        )
    rows = [[cells[k] for cells in columns_of_cells] for k in range(len(means))]
    return metrics, list(zip(means, rows, strict=True))


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
