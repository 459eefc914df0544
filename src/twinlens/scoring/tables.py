"""A board as text: the terminal's table, CSV and LaTeX."""

import csv
import io
import math
from collections.abc import Collection, Mapping, Sequence

from rich.markup import escape
from rich.table import Table
from rich.text import Text

from twinlens.errors import InputError, unknown
from twinlens.scoring.board import Board, Entry, Mean
from twinlens.scoring.metrics import TIMES, find_metric
from twinlens.scoring.protocols import PROTOCOLS, Protocol
from twinlens.scoring.regions import REGIONS

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "middlebury-v3": ("totbad2.0", "bad0.5", "bad1.0", "bad2.0", "bad4.0", "avgerr", "rms", "A50", "A95", "invalid"),
    "eth3d": ("bad0.5", "bad1.0", "bad2.0", "bad4.0", "avgerr", "rms", "A50", "A95", "coverage"),
    "kitti2015": ("D1", "D1_est", "coverage"),
    "points": ("point_avgerr", "point_rms", "point_A50", "point_A90", "point_A99", "point_rel", "coverage"),
}
"""Default columns of a table, by protocol."""
Groups = Mapping[str, Collection[str]]
"""Title -> names of the samples of a group."""
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


def standings(
    board: Board,
    protocol: str,
    region: str = "all",
    *,
    sort: str | None = None,
    weights: Mapping[str, float] | None = None,
) -> list[Mean]:
    """The methods' means over samples, best first by the metric `sort` (default: the protocol's headline).

    Methods without a value come last, in the board's order.

    Raises
    ------
    InputError
        A protocol, region or metric that the board does not have.
    """
    rules = _rules(board, protocol, region)
    metric = find_metric(sort or rules.headline)
    if metric.name not in (*rules.metrics, *TIMES):
        raise unknown("metric", metric.name, (*rules.metrics, *TIMES))
    sign = 1.0 if metric.lower_is_better else -1.0

    def rank(mean: Mean) -> tuple[bool, float]:
        value = mean.metrics[metric.name]
        return math.isnan(value), 0.0 if math.isnan(value) else sign * value

    return sorted((board.mean(name, protocol, region, weights) for name in board.methods), key=rank)


def caption(board: Board, protocol: str, region: str, weights: Mapping[str, float] | None = None) -> str:
    """What a table's numbers mean, one line each: protocol, region, denominator, invalid, clip, resolution, mean."""
    rules = _rules(board, protocol, region)
    text = REGIONS[region].text if region in REGIONS else "defined by the caller"
    over = "weighted mean over samples" if weights else "plain mean over samples"
    lines = dict(rules.lines()) | {
        "region": f"{region}: {text}",
        "mean": f"{over}; none if a method failed or was not run on a sample",
    }
    order = ("protocol", "region", "denominator", "invalid", "clip", "resolution", "mean")
    return "\n".join(f"{name}: {lines[name]}" for name in order)


def leaderboard_table(
    board: Board,
    protocol: str,
    region: str = "all",
    *,
    sort: str | None = None,
    columns: Sequence[str] | None = None,
    weights: Mapping[str, float] | None = None,
) -> Table:
    """The leaderboard as a rich table, best first, the best value of each column in bold, with its caption."""
    ranked = standings(board, protocol, region, sort=sort, weights=weights)
    names = _columns(protocol, columns)
    table = Table(
        title=escape(f"{board.title} · {PROTOCOLS[protocol].title} · {region}"),
        caption=Text(caption(board, protocol, region, weights)),
        caption_justify="left",
        title_justify="left",
    )
    table.add_column("#", justify="right", style="dim")
    table.add_column("method", no_wrap=True)
    for name in names:
        table.add_column(f"{name}\n[dim]{find_metric(name).unit}[/]", justify="right")
    table.add_column("samples", justify="right")
    best = _best(ranked, names)
    for rank, mean in enumerate(ranked, start=1):
        cells = [_cell(mean, name, best) for name in names]
        table.add_row(str(rank), Text(mean.method), *cells, _coverage(mean))
    return table


def group_means(board: Board, protocol: str, region: str, groups: Groups) -> dict[str, dict[str, float]]:
    """Group -> method -> mean of the protocol's headline metric over the group's samples, best method first."""
    metric = _rules(board, protocol, region).headline
    return {
        name: {mean.method: mean.metrics[metric] for mean in standings(board.subset(samples), protocol, region)}
        for name, samples in groups.items()
    }


def comparison_table(board: Board, protocol: str, region: str, groups: Groups) -> Table:
    """The protocol's headline metric, one column per group of samples, the first group's best method first."""
    rules, values = _rules(board, protocol, region), group_means(board, protocol, region, groups)
    metric = find_metric(rules.headline)
    title = escape(f"{board.title} · {rules.title} · {region} · {metric.name} [{metric.unit}]")
    table = Table(title=title, title_justify="left")
    table.add_column("method", no_wrap=True)
    for name in groups:
        table.add_column(name, justify="right")
    for method in next(iter(values.values())):
        cells = [
            Text(metric.show(column[method]), style="bold" if method == next(iter(column)) else "")
            for column in values.values()
        ]
        table.add_row(Text(method), *cells)
    return table


def failures(board: Board, methods: Collection[str] | None = None) -> list[str]:
    """One line per failed pair (not per protocol): method, sample, kind and message.

    methods: names of the methods to list, None for all.
    """
    listed = [e for e in board.entries if methods is None or e.method in methods]
    found = {(e.method, e.sample): e.failure for e in listed if e.failure is not None}
    return [f"{method} on {sample}: {failure.kind} ({failure.message})" for (method, sample), failure in found.items()]


def board_csv(board: Board) -> str:
    """Every entry and region as a CSV row, in full precision; formulas of spreadsheets get a leading apostrophe."""
    metrics = tuple(dict.fromkeys(name for p in board.protocols for name in PROTOCOLS[p].metrics))
    head = ("method", "sample", "protocol", "region", "status", "reason", "image_pixels", "evaluated", "estimated")
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*head, *metrics, *(f"{name}_{find_metric(name).unit.split('/')[0]}" for name in TIMES)])
    for entry in board.entries:
        for region in entry.regions or ("",):
            writer.writerow(_csv_row(entry, region, metrics))
    return out.getvalue()


def board_latex(
    board: Board,
    protocol: str,
    region: str = "all",
    *,
    sort: str | None = None,
    columns: Sequence[str] | None = None,
    weights: Mapping[str, float] | None = None,
) -> str:
    """The leaderboard as a LaTeX table (package booktabs), the best value of each column in bold."""
    ranked = standings(board, protocol, region, sort=sort, weights=weights)
    names = _columns(protocol, columns)
    best = _best(ranked, names)
    head = " & ".join(["Method", *(_latex(f"{name} [{find_metric(name).unit}]") for name in names)])
    rows = [" & ".join([_latex(m.method), *(_latex_cell(m, name, best) for name in names)]) + r" \\" for m in ranked]
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_latex('. '.join(caption(board, protocol, region, weights).splitlines()))}.}}",
        rf"\begin{{tabular}}{{l{'r' * len(names)}}}",
        r"\toprule",
        rf"{head} \\",
        r"\midrule",
        *rows,
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _rules(board: Board, protocol: str, region: str) -> Protocol:
    if protocol not in board.protocols:
        raise unknown("protocol on this board", protocol, board.protocols)
    if region not in board.regions:
        raise unknown("region on this board", region, board.regions)
    return PROTOCOLS[protocol]


def _columns(protocol: str, columns: Sequence[str] | None) -> tuple[str, ...]:
    names = tuple(columns) if columns is not None else (*COLUMNS[protocol], "time")
    for name in names:
        if find_metric(name).name not in (*PROTOCOLS[protocol].metrics, *TIMES):
            raise InputError(f"{PROTOCOLS[protocol].title} does not measure {name!r}")
    return names


def _best(ranked: Sequence[Mean], names: Sequence[str]) -> dict[str, float]:
    best = {}
    for name in names:
        values = [m.metrics[name] for m in ranked if not math.isnan(m.metrics[name])]
        if values:
            best[name] = min(values) if find_metric(name).lower_is_better else max(values)
    return best


def _cell(mean: Mean, name: str, best: Mapping[str, float]) -> Text:
    value = mean.metrics[name]
    return Text(find_metric(name).show(value), style="bold" if value == best.get(name) else "")


def _coverage(mean: Mean) -> Text:
    """How many of the samples have scores."""
    if mean.counted == mean.total:
        return Text(str(mean.counted))
    failed = f", {len(mean.failed)} failed" if mean.failed else ""
    return Text(f"{mean.counted} of {mean.total}{failed}", style="red")


def _csv_row(entry: Entry, region: str, metrics: Sequence[str]) -> list[str]:
    scores, failure = entry.regions.get(region), entry.failure
    status = ["ok", ""] if failure is None else [failure.kind, failure.message]
    counts = ["", "", ""] if scores is None else [str(n) for n in (scores.image, scores.evaluated, scores.estimated)]
    numbers = [entry.value(region, name) for name in (*metrics, *TIMES)]
    text = [entry.method, entry.sample, entry.protocol, region, *status]
    safe = (f"'{t}" if t.startswith(_FORMULA_STARTS) else t for t in text)
    return [*safe, *counts, *("" if math.isnan(v) else repr(v) for v in numbers)]


_LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "|": r"\textbar{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    **{c: f"\\{c}" for c in "&%$#_{}"},
}


def _latex(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in " ".join(text.split()))


def _latex_cell(mean: Mean, name: str, best: Mapping[str, float]) -> str:
    shown = find_metric(name).show(mean.metrics[name]).replace("–", "--").replace("∞", r"$\infty$")
    return rf"\textbf{{{shown}}}" if mean.metrics[name] == best.get(name) else shown
