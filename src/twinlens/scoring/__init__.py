"""Scoring of disparity maps: metrics, regions, protocols, and leaderboards. Works without mitsuba."""

from twinlens.scoring.agreement import agreement
from twinlens.scoring.benchmark import Step, run_benchmark
from twinlens.scoring.board import Board, Entry
from twinlens.scoring.board_file import board_to_json, json_number, read_board
from twinlens.scoring.evaluate import Scores, evaluate
from twinlens.scoring.metrics import METRICS, find_metric
from twinlens.scoring.pair_statistics import STATISTICS, pair_statistics, summarize
from twinlens.scoring.protocols import PROTOCOLS
from twinlens.scoring.regions import REGIONS, region_masks
from twinlens.scoring.samples import DatasetPairs, Pair, Sample, load_pair, open_pairs, search_range
from twinlens.scoring.submission import MapFolder, open_submission
from twinlens.scoring.tables import (
    Groups,
    board_csv,
    board_latex,
    caption,
    comparison_table,
    failures,
    group_means,
    leaderboard_table,
    standings,
)

__all__ = [
    "METRICS",
    "PROTOCOLS",
    "REGIONS",
    "STATISTICS",
    "Board",
    "DatasetPairs",
    "Entry",
    "Groups",
    "MapFolder",
    "Pair",
    "Sample",
    "Scores",
    "Step",
    "agreement",
    "board_csv",
    "board_latex",
    "board_to_json",
    "caption",
    "comparison_table",
    "evaluate",
    "failures",
    "find_metric",
    "group_means",
    "json_number",
    "leaderboard_table",
    "load_pair",
    "open_pairs",
    "open_submission",
    "pair_statistics",
    "read_board",
    "region_masks",
    "run_benchmark",
    "search_range",
    "standings",
    "summarize",
]
