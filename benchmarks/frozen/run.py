"""The frozen benchmark: make its datasets, run its matchers, measure its images, and write the published page.

    python benchmarks/frozen/run.py [--work out/frozen] [--workers 2]

`bundled.toml` and `families.toml` in this folder are the recipes. Datasets and boards are kept in the work folder, and
the next run resumes them. README.md, results.json and the boards in this folder are the published results.
`ablations.py` continues with the same work folder.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import tables

from twinlens.cli.boards import run_board
from twinlens.cli.progress import progress_bar
from twinlens.dataset import Dataset
from twinlens.factory import generate, read_recipe, worker_processes
from twinlens.scoring import (
    Board,
    DatasetPairs,
    Pair,
    board_to_json,
    motorcycle,
    pair_statistics,
)

HERE = Path(__file__).parent
VERSION = 3
DATASETS = ("bundled", "families")
PROTOCOL, REGIONS = (
    "middlebury-v3",
    ("nonocc", "all", "discontinuity", "textureless", "occluded"),
)
PUBLISHED = ("nonocc", "all")
COSTS = ("sad", "ssd", "ncc", "zsad", "zssd", "zncc", "census", "rank")
METHODS = (
    *(f"{cost}:block_size={size}" for size in (7, 15) for cost in COSTS),
    "adaptive", "sgm4", "sgm", "sgm:cost=birchfield_tomasi,block_size=3", "opencv_bm", "opencv_sgbm",
)  # fmt: skip


def make_dataset(name: str, work: Path, workers: int) -> Dataset:
    """The dataset of a recipe of this folder, resumed if it is not complete."""
    folder = work / name
    recipe = read_recipe(HERE / f"{name}.toml")
    with progress_bar(f"generating {name}") as report:
        outcome = generate(
            recipe, folder, engine=worker_processes(workers), report=report
        )
    if not outcome.complete or outcome.failures:
        raise SystemExit(f"{folder}: {outcome.there} of {outcome.count} samples")
    return Dataset(folder)


def make_board(
    name: str, pairs: Sequence[Pair], work: Path, regions: Sequence[str] = REGIONS
) -> Board:
    """The board of all methods on some pairs, kept in the work folder."""
    title = f"twinlens frozen benchmark {VERSION}: {name}"
    return run_board(
        pairs, METHODS, work / "boards" / name, (PROTOCOL,), tuple(regions), title=title
    )


def arguments(description: str | None) -> argparse.Namespace:
    """The options that both scripts have."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--work",
        type=Path,
        default=Path("out/frozen"),
        help="folder of the datasets and boards",
    )
    parser.add_argument(
        "--workers", type=int, default=2, help="number of processes that render"
    )
    return parser.parse_args()


def main() -> None:
    options = arguments(__doc__)
    boards, statistics = {}, {}
    for name in DATASETS:
        pairs = DatasetPairs(make_dataset(name, options.work, options.workers))
        boards[name] = make_board(name, pairs, options.work)
        statistics[name] = {pair.name: pair_statistics(pair) for pair in pairs}
    boards["motorcycle"] = make_board("motorcycle", [motorcycle()], options.work)
    for name, board in boards.items():
        write_published(name, board)
    publish("statistics", statistics)


def write_published(name: str, board: Board) -> None:
    """Write a board with the regions that are published, without spaces."""
    entries = tuple(
        replace(e, regions={r: e.regions[r] for r in PUBLISHED if r in e.regions})
        for e in board.entries
    )
    plain = json.loads(board_to_json(replace(board, entries=entries)))
    (HERE / f"{name}.json").write_text(json.dumps(plain, separators=(",", ":")) + "\n")


def publish(key: str, value: object) -> None:
    """Replace one key of results.json, and write README.md from all published results."""
    file = HERE / "results.json"
    results = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps(results | {key: value}, indent=1, sort_keys=True) + "\n")
    (HERE / "README.md").write_text(tables.page())
    print(HERE / "README.md")


if __name__ == "__main__":
    main()
