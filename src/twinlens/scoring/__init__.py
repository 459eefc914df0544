"""Scoring of disparity maps: metrics, regions, protocols, and leaderboards. Works without mitsuba."""

from twinlens.scoring.agreement import Agreement, CorrelationInterval, Move, agreement
from twinlens.scoring.benchmark import Step, run_benchmark
from twinlens.scoring.board import FAILURES, Board, Entry, Failure, Mean
from twinlens.scoring.board_file import board_from_json, board_to_json, json_number, read_board, write_board
from twinlens.scoring.evaluate import RegionScores, Scores, evaluate
from twinlens.scoring.methods import NamedMethod, named_method, named_methods, named_program
from twinlens.scoring.metrics import METRICS, Metric, find_metric
from twinlens.scoring.pair_statistics import STATISTICS, Statistic, pair_statistics, summarize
from twinlens.scoring.protocols import PROTOCOLS, Protocol, find_protocol, interpolate_background
from twinlens.scoring.regions import REGIONS, Region, region_masks
from twinlens.scoring.runners import WARM_UP_LIMIT_S
from twinlens.scoring.samples import DatasetPairs, Pair, Sample, fingerprint, load_pair, open_pairs, search_range
from twinlens.scoring.submission import MapFolder, Submission, open_submission
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
    "FAILURES",
    "METRICS",
    "PROTOCOLS",
    "REGIONS",
    "STATISTICS",
    "WARM_UP_LIMIT_S",
    "Agreement",
    "Board",
    "CorrelationInterval",
    "DatasetPairs",
    "Entry",
    "Failure",
    "Groups",
    "MapFolder",
    "Mean",
    "Metric",
    "Move",
    "NamedMethod",
    "Pair",
    "Protocol",
    "Region",
    "RegionScores",
    "Sample",
    "Scores",
    "Statistic",
    "Step",
    "Submission",
    "agreement",
    "board_csv",
    "board_from_json",
    "board_latex",
    "board_to_json",
    "caption",
    "comparison_table",
    "evaluate",
    "failures",
    "find_metric",
    "find_protocol",
    "fingerprint",
    "group_means",
    "interpolate_background",
    "json_number",
    "leaderboard_table",
    "load_pair",
    "named_method",
    "named_methods",
    "named_program",
    "open_pairs",
    "open_submission",
    "pair_statistics",
    "read_board",
    "region_masks",
    "run_benchmark",
    "search_range",
    "standings",
    "summarize",
    "write_board",
]
