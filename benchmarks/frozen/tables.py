"""The published page of the frozen benchmark, from the boards and results.json in this folder."""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twinlens.scoring import (
    STATISTICS,
    Board,
    agreement,
    read_board,
    standings,
    summarize,
)

HERE = Path(__file__).parent
METRIC = "totbad2.0"
LENSES = ("pinhole", "lens")
RENDERED = [(name, lens) for name in ("bundled", "families") for lens in LENSES]


def page() -> str:
    """The text of README.md."""
    boards = {
        name: read_board(HERE / f"{name}.json")
        for name in ("bundled", "families", "motorcycle")
    }
    results = json.loads((HERE / "results.json").read_text())
    parts = [
        (HERE / "about.md").read_text(),
        "## Scores\n",
        SCORES,
        score_table(boards),
        "## Rankings\n",
        RANKINGS,
    ]
    parts += [
        ranking_table(boards),
        "## Image statistics\n",
        STATISTICS_TEXT,
        statistics_table(results["statistics"]),
    ]
    if "ablations" in results:
        parts += ["## Ablations\n", ABLATIONS, ablation_table(results["ablations"])]
    return "\n".join(parts)


def samples_of(board: Board, lens: str) -> list[str]:
    """The samples of a board through the pinhole, or through the lens."""
    is_pinhole = lens == "pinhole"
    return [name for name in board.samples if (" · pinhole" in name) == is_pinhole]


def with_samples(board: Board, samples: Sequence[str]) -> Board:
    """The part of a board with some of its samples."""
    kept = tuple(entry for entry in board.entries if entry.sample in samples)
    return dataclasses.replace(board, entries=kept)


def score_table(boards: dict[str, Board]) -> str:
    """Mean score of each method over the non-occluded pixels, the best of the bundled scenes first."""

    def mean(board: Board, method: str, samples: Sequence[str]) -> float:
        weights = {name: float(name in samples) for name in board.samples}
        return board.mean(method, board.protocols[0], "nonocc", weights).metrics[METRIC]

    columns = [
        (boards[name], samples_of(boards[name], lens)) for name, lens in RENDERED
    ]
    columns.append((boards["motorcycle"], list(boards["motorcycle"].samples)))
    methods = [
        row.method
        for row in standings(
            boards["bundled"], boards["bundled"].protocols[0], "nonocc"
        )
    ]
    rows = [
        [mean(board, method, samples) for board, samples in columns]
        for method in methods
    ]
    best = [
        min(row[i] for row in rows if not math.isnan(row[i]))
        for i in range(len(columns))
    ]
    heads = [*(f"{name}, {lens}" for name, lens in RENDERED), "Motorcycle (real)"]
    lines = [
        [
            f"`{method}`",
            *(
                f"**{v:.1f}**" if v == least else f"{v:.1f}"
                for v, least in zip(row, best, strict=True)
            ),
        ]
        for method, row in zip(methods, rows, strict=True)
    ]
    return markdown(["method", *heads], lines)


def ranking_table(boards: dict[str, Board]) -> str:
    """Agreement of the rankings of two boards."""
    lines = []
    for a, b in (
        ("bundled", "families"),
        ("bundled", "motorcycle"),
        ("families", "motorcycle"),
    ):
        found = agreement(boards[a], boards[b], metric=METRIC)
        halves = f"{found.reliability_a}, {found.samples_a} images of {found.scenes_a} scenes"
        lines.append([f"{a}, {b}", str(found.tau), str(found.rho), halves])
    return markdown(
        ["boards", "Kendall's tau-b", "Spearman's rho", "tau-b of halves of the first"],
        lines,
    )


def statistics_table(found: dict[str, dict[str, dict[str, float]]]) -> str:
    """Medians with 10 % and 90 % quantiles, beside those of real pairs."""
    rows = {name: list(found[name].values()) for name in ("bundled", "families")}
    rows["both"] = [*rows["bundled"], *rows["families"]]
    summaries = [summarize(each) for each in rows.values()]
    lines = []
    # Statistics that are newer than the results are left out.
    recorded = [name for name in STATISTICS if name in summaries[0]]
    for name in recorded:
        statistic = STATISTICS[name]
        measured = [span(summary[name]) for summary in summaries]
        lines.append(
            [f"`{name}`", *measured, span(statistic.real), verdict(name, rows["both"])]
        )
    return markdown(
        ["statistic", *rows, "24 real pairs", "all within, median near"], lines
    )


def verdict(name: str, rows: list[dict[str, float]]) -> str:
    """Share of all pairs within the 10 % to 90 % range of the real pairs; whether the median is near theirs.

    Near is within a third of that range.
    """
    middle, low, high = STATISTICS[name].real
    values = [row[name] for row in rows if math.isfinite(row[name])]
    inside = (
        sum(low <= value <= high for value in values) / len(values)
        if math.isfinite(low)
        else math.nan
    )
    near = abs(summarize(rows)[name][0] - middle) <= (high - low) / 3
    if math.isnan(inside):
        return ""
    return f"{100 * inside:.0f} %, {'yes' if near else 'no'}"


def ablation_table(rows: list[dict[str, Any]]) -> str:
    """What each ingredient changes: agreement with the full benchmark, and medians of four statistics."""
    shown = ("low_sd", "bias", "residual", "textureless", "correlation")
    lines = [
        [
            row["name"],
            row["dataset"],
            row["tau"],
            *(f"{row['statistics'][name]:.3g}" for name in shown),
        ]
        for row in rows
    ]
    return markdown(
        [
            "without",
            "dataset",
            "tau-b with the full ranking",
            *(f"`{name}`" for name in shown),
        ],
        lines,
    )


def span(values: Sequence[float]) -> str:
    """Median (10 % to 90 %)."""
    limits = "" if math.isnan(values[1]) else f" ({values[1]:.3g} to {values[2]:.3g})"
    return f"{values[0]:.3g}{limits}"


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose first column is text."""
    lines = [heads, ["---", *["---:"] * (len(heads) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


SCORES = """Percentage of the non-occluded pixels with known truth whose disparity is wrong by more than 2 px or unknown
(`totbad2.0`, protocol `middlebury-v3`), mean over the samples. Order: `bundled`.
"""
RANKINGS = """Rank correlation of the methods' mean ranks by the same metric, with 95 % intervals over scenes
([docs/realism.md](../../docs/realism.md#do-two-boards-rank-methods-alike)). Motorcycle is one pair: its ranking is
uncertain, and the intervals do not contain this uncertainty. No setting was chosen by it.
"""
STATISTICS_TEXT = """`twinlens statistics`, medians with 10 % and 90 % quantiles. The last column has the share of the
rendered pairs between the 10 % and 90 % quantiles of the real pairs, and whether the median of all rendered pairs is
within a third of that range from the real median.
"""
ABLATIONS = """`python benchmarks/frozen/ablations.py`: each ingredient left out alone, in images through the lens of
two samples of each dataset: `cards` and `fence` of the bundled scenes, and one of the family cards and one of flying.
The ranking is compared with that of the full benchmark on the same samples; 1 means that nothing changes. Then medians
of image statistics. Two samples give no interval: small differences may be due to chance.

Where lens or alignment change, the second image is rendered again, with other noise: compare the rows from "(nothing;
second image rendered again)" to "any difference of the cameras" with the first of them, and all others with
"everything". Level `typical` has equal exposure times. Only random scenes have plain surfaces to leave out.
"""
