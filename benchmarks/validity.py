"""Do the frozen boards rank methods as your real pairs do, and are their errors as large?

    python benchmarks/validity.py FOLDER [FOLDER ...] [--work out/validity]

FOLDER holds rectified pairs with true disparity: a folder of twinlens, or a download of Middlebury, ETH3D or KITTI
(docs/realism.md), or the word `motorcycle`. The 22 methods of the frozen benchmark match every pair, with the settings
of that benchmark. A stopped run goes on where it was. In the work folder:

- `index.html`: the page of the comparison, with its figures. `real/index.html` is the board of the real pairs.
- `validity.json`: the figures of the page.

The page has, for each frozen board, Kendall's tau-b of its ranking with that of the real pairs, beside tau-b between
random halves of the real pairs, which no other board can be expected to exceed by much; log2(synthetic / real) of each
method's mean error; and the statistics of the pairs.

Choose no setting by this result: a benchmark that was tuned on the pairs that judge it proves nothing.
"""

import argparse
import base64
import html
import io
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinlens.cli.boards import run_board
from twinlens.errors import TwinlensError
from twinlens.scoring import (
    STATISTICS,
    Board,
    agreement,
    open_pairs,
    pair_statistics,
    read_board,
    summarize,
)

FROZEN = Path(__file__).parent / "frozen"
sys.path.append(str(FROZEN))

import run as frozen  # noqa: E402  (benchmarks/frozen/run.py)
import tables  # noqa: E402  (benchmarks/frozen/tables.py)

REGION = "nonocc"
WATCHED = "sgm"  # the method whose spread over images is shown


@dataclass(frozen=True)
class Comparison:
    """One frozen board, or its part through one lens, beside the real pairs.

    tau : Kendall's tau-b of the methods' mean ranks, with its 95 % interval.
    levels : log2 of the mean error on this board over that on the real pairs, by method.
    spread : median, 10 % and 90 % quantile over images of the error of `WATCHED`, in percent.
    """

    name: str
    tau: tuple[float, float, float]
    levels: dict[str, float]
    spread: tuple[float, float, float]


def frozen_boards() -> dict[str, Board]:
    """The published boards, each through both lenses and through one of them."""
    boards = {}
    for name in frozen.DATASETS:
        whole = read_board(FROZEN / f"{name}.json")
        for lens in tables.LENSES:
            samples = tables.samples_of(whole, lens)
            boards[f"{name}, {lens}"] = tables.with_samples(whole, samples)
        boards[name] = whole
    return boards


def errors(board: Board) -> dict[str, float]:
    """Mean share of wrong pixels of each method, in percent."""
    means = board.means(frozen.PROTOCOL, REGION)
    return {method: mean.metrics[tables.METRIC] for method, mean in means.items()}


def spread(board: Board) -> tuple[float, float, float]:
    """Median, 10 % and 90 % quantile over the images of a board, in percent."""
    values = [
        entry.regions[REGION].metrics[tables.METRIC]
        for entry in board.entries
        if entry.method == WATCHED and REGION in entry.regions
    ]
    middle, low, high = np.quantile(values, (0.5, 0.1, 0.9))
    return float(middle), float(low), float(high)


def compare(name: str, board: Board, real: Board) -> Comparison:
    found = agreement(
        board, real, protocol=frozen.PROTOCOL, region=REGION, metric=tables.METRIC
    )
    on_board, on_real = errors(board), errors(real)
    levels = {
        method: math.log2(on_board[method] / on_real[method])
        for method in frozen.METHODS
        if on_board.get(method, 0) > 0 and on_real.get(method, 0) > 0
    }
    tau = found.tau.value, found.tau.low, found.tau.high
    return Comparison(name, tau, levels, spread(board))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", metavar="FOLDER")
    parser.add_argument("--work", type=Path, default=Path("out/validity"))
    options = parser.parse_args()
    try:
        pairs = open_pairs(options.folders)
        real = run_board(
            pairs,
            frozen.METHODS,
            options.work / "real",
            (frozen.PROTOCOL,),
            (REGION,),
            title="real pairs",
        )
        statistics = [pair_statistics(pair) for pair in pairs]
    except TwinlensError as error:
        raise SystemExit(f"validity.py: {error}") from error
    comparisons = [compare(name, b, real) for name, b in frozen_boards().items()]
    reliability = agreement(
        real, real, protocol=frozen.PROTOCOL, region=REGION, metric=tables.METRIC
    ).reliability_a
    page = page_of(real, comparisons, str(reliability), summarize(statistics))
    (options.work / "index.html").write_text(page)
    document = {
        "real": {"errors": errors(real), "spread": spread(real)},
        "reliability": reliability.value,
        "boards": {c.name: vars(c) for c in comparisons},
        "statistics": summarize(statistics),
    }
    (options.work / "validity.json").write_text(json.dumps(document, indent=1) + "\n")
    print(text_table(comparisons, str(reliability)))
    print(options.work / "index.html")


def text_table(comparisons: Sequence[Comparison], reliability: str) -> str:
    """What the terminal shows."""
    lines = [f"tau-b between random halves of the real pairs: {reliability}"]
    for c in comparisons:
        mean, deviation = level(c)
        lines.append(
            f"{c.name:18} tau-b {interval(c.tau):20} level {mean:+.2f} (s.d. {deviation:.2f})"
        )
    return "\n".join(lines)


def level(comparison: Comparison) -> tuple[float, float]:
    """Mean and standard deviation over methods of log2(synthetic / real)."""
    values = list(comparison.levels.values())
    return float(np.mean(values)), float(np.std(values))


def interval(values: tuple[float, float, float]) -> str:
    value, low, high = values
    if not math.isfinite(value):
        return "-"
    limits = f" ({low:.2f} to {high:.2f})" if math.isfinite(low) else ""
    return f"{value:.2f}{limits}"


STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 75em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; display: block; overflow-x: auto }
th, td { text-align: right; padding: .2em .8em; border-bottom: 1px solid #ddd; white-space: nowrap }
th:first-child, td:first-child { text-align: left }
img { max-width: 100% }
"""


def page_of(
    real: Board,
    comparisons: Sequence[Comparison],
    reliability: str,
    statistics: Mapping[str, tuple[float, float, float]],
) -> str:
    """The page, which needs no other file."""
    count = len(real.samples)
    pairs_text = "one real pair" if count == 1 else f"{count} real pairs"
    ranking = [
        [c.name, interval(c.tau), "{:+.2f} ({:.2f})".format(*level(c)), span(c.spread)]
        for c in comparisons
    ]
    ranking.append(["real pairs", reliability, "0", span(spread(real))])
    on_real = errors(real)
    levels = [
        [
            method,
            f"{on_real.get(method, math.nan):.1f} %",
            *(f"{c.levels.get(method, math.nan):+.2f}" for c in comparisons),
        ]
        for method in sorted(frozen.METHODS, key=lambda m: on_real.get(m, math.inf))
    ]
    recorded = json.loads((FROZEN / "results.json").read_text())["statistics"]
    rendered = {name: summarize(list(recorded[name].values())) for name in recorded}
    pairs_table = [
        [
            name,
            span(statistics.get(name, (math.nan,) * 3)),
            *(span(of.get(name, (math.nan,) * 3)) for of in rendered.values()),
            span(statistic.real),
        ]
        for name, statistic in STATISTICS.items()
    ]
    parts = [
        f"<h1>Frozen benchmark {frozen.VERSION} beside {pairs_text}</h1>",
        "<h2>Rankings and levels</h2>",
        f"<p>{RANKINGS}</p>",
        table(
            ["board", "tau-b with the real pairs", "log2(synthetic / real)", "sgm, %"],
            ranking,
        ),
        FEW if reliability == "-" else "",
        figure(comparisons, on_real),
        "<h2>Each method</h2>",
        f"<p>{LEVELS}</p>",
        table(["method", "real pairs", *(c.name for c in comparisons)], levels),
        "<h2>Statistics of the pairs</h2>",
        "<p>Median (10 % to 90 % quantile). A dash: not recorded for that board.</p>",
        table(
            ["statistic", "these pairs", *rendered, "24 public pairs"],
            pairs_table,
        ),
    ]
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width'>"
        f"<title>validity</title><style>{STYLE}</style>{''.join(parts)}</html>\n"
    )


RANKINGS = """Share of non-occluded pixels with an error above 2 px or no estimate (totbad2.0). tau-b is Kendall's, of
the methods' mean ranks, with 95 % intervals over scenes; in the last row between random halves of the real pairs. The
level is the mean over methods of log2 of the mean error on the board over that on the real pairs, with its standard
deviation: 0 is as hard, -1 half as hard. The last column has the median error of sgm over the images, with 10 % and
90 % quantiles."""
FEW = """<p>The intervals do not contain the uncertainty of the real pairs, which are fewer than four scenes."""
LEVELS = "Mean error on the real pairs, and log2(synthetic / real), the best method on the real pairs first."


def span(values: Sequence[float]) -> str:
    return "-" if math.isnan(values[0]) else tables.span(values)


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        inner = "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells)
        return f"<tr>{inner}</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f"<table>{line(heads, 'th')}{body}</table>"


def figure(comparisons: Sequence[Comparison], on_real: Mapping[str, float]) -> str:
    """Error on each whole board against that on the real pairs, one point a method."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(7, 5), layout="constrained")
    axes = drawing.subplots()
    for comparison in comparisons:
        if comparison.name not in frozen.DATASETS:
            continue
        x = np.array([on_real[method] for method in comparison.levels])
        y = x * np.exp2(list(comparison.levels.values()))
        axes.loglog(x, y, "o", label=comparison.name)
    limits = min(axes.get_xlim()[0], axes.get_ylim()[0]), axes.get_xlim()[1]
    axes.plot(limits, limits, color="grey", lw=1, label="as hard")
    axes.set(xlabel="real pairs, wrong pixels (%)", ylabel="board, wrong pixels (%)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    axes.legend()
    buffer = io.BytesIO()
    drawing.savefig(buffer, format="png", dpi=144)
    data = base64.b64encode(buffer.getvalue()).decode()
    return f"<p><img alt='error on the boards and on the real pairs' src='data:image/png;base64,{data}'>"


if __name__ == "__main__":
    main()
