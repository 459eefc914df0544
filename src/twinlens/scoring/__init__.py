"""Scoring of disparity maps: metrics, regions, protocols, and leaderboards. Works without mitsuba."""

from twinlens.scoring.agreement import agreement as agreement
from twinlens.scoring.benchmark import Step as Step, run_benchmark as run_benchmark
from twinlens.scoring.board import Board as Board, Entry as Entry
from twinlens.scoring.board_file import (
    board_to_json as board_to_json,
    read_board as read_board,
    write_board as write_board,
)
from twinlens.scoring.confidences import (
    ConfidenceScores as ConfidenceScores,
    score_confidences as score_confidences,
)
from twinlens.scoring.consistency import (
    check_views as check_views,
    of_right_map as of_right_map,
    photometric_residual as photometric_residual,
    with_disagreements as with_disagreements,
)
from twinlens.scoring.evaluate import Scores as Scores, evaluate as evaluate
from twinlens.scoring.grouping import (
    Groups as Groups,
    compare_groups as compare_groups,
    groupings as groupings,
    groups_by as groups_by,
    groups_of_protocol as groups_of_protocol,
)
from twinlens.scoring.metrics import METRICS as METRICS, find_metric as find_metric
from twinlens.scoring.pair_statistics import (
    STATISTICS as STATISTICS,
    pair_statistics as pair_statistics,
    summarize as summarize,
)
from twinlens.scoring.protocols import (
    CONSISTENCY as CONSISTENCY,
    PROTOCOLS as PROTOCOLS,
)
from twinlens.scoring.reasons import Reason as Reason, reason_of as reason_of
from twinlens.scoring.recipe_fit import (
    fit_recipe as fit_recipe,
    recipe_toml as recipe_toml,
)
from twinlens.scoring.regions import REGIONS as REGIONS, region_masks as region_masks
from twinlens.scoring.samples import (
    DatasetPairs as DatasetPairs,
    Pair as Pair,
    ScoredSample as ScoredSample,
    load_pair as load_pair,
    motorcycle as motorcycle,
    open_pairs as open_pairs,
    search_range as search_range,
    with_search as with_search,
)
from twinlens.scoring.sparsification import (
    Sparsification as Sparsification,
    sparsification as sparsification,
)
from twinlens.scoring.submission import (
    MapFolder as MapFolder,
    open_submission as open_submission,
)
from twinlens.scoring.tables import (
    board_csv as board_csv,
    board_latex as board_latex,
    caption as caption,
    comparison_record as comparison_record,
    comparison_table as comparison_table,
    failures as failures,
    group_means as group_means,
    leaderboard_table as leaderboard_table,
    map_warnings as map_warnings,
    standings as standings,
)
