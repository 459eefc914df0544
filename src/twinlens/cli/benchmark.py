"""`twinlens benchmark`: matchers x samples -> board.json, a table and a page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from twinlens.cli.boards import (
    by_option,
    check_by,
    print_board,
    protocol_option,
    region_option,
    run_board,
)
from twinlens.cli.options import SECONDS, Positive, json_option, search_options
from twinlens.cli.places import PATH
from twinlens.matching import parse_methods, parse_program
from twinlens.matching.methods import MethodSpec
from twinlens.scoring import Board, open_pairs

DEFAULT_METHODS = "sad,ssd,zncc"
_FEW_LENSES = 6
FOREIGN_LIMIT_S = 600.0
"""Default time limit, seconds, if a network or a Python function is among the matchers."""


@click.command("benchmark")
@click.argument("datasets", nargs=-1, required=True, metavar="DATASET...")
@click.option("-o", "--output", required=True, type=PATH, help="Folder of the board.")
@click.option(
    "--methods", "methods", multiple=True,
    help="Comma-separated matchers, e.g. sad,mine=zncc:block_size=15,lr_check=1; see `twinlens methods`. Repeatable.  "
    f"[default: {DEFAULT_METHODS}]",
)  # fmt: skip
@click.option(
    "--command", "commands", multiple=True, metavar="[NAME=]COMMAND",
    help="A program that reads two PNG files and writes a PFM, e.g. mine='prog {left} {right} {out}'; "
    "{num_disparities} and {min_disparity} are replaced too. Not run by a shell. Repeatable.",
)  # fmt: skip
@click.option(
    "--time-limit", type=SECONDS,
    help="Seconds per match, warm-up excluded. Runs matchers in a subprocess.  [default: 600 if a network or a Python "
    "function is among them]",
)  # fmt: skip
@click.option(
    "--memory-limit",
    type=Positive(2.0**20),
    help="GiB per matcher. Runs matchers in a subprocess.",
)
@click.option("--warm-up-limit", type=SECONDS, default=120.0, show_default=True,
              help="Seconds for the first, untimed match of a method in a subprocess.")  # fmt: skip
@click.option(
    "--retry-failed", is_flag=True, help="Rerun matches that failed in an earlier run."
)
@search_options
@protocol_option
@region_option
@by_option
@json_option("the board")
def command(
    datasets: tuple[str, ...],
    output: Path,
    methods: tuple[str, ...],
    commands: tuple[str, ...],
    time_limit: float | None,
    memory_limit: float | None,
    by: tuple[str, ...],
    num_disparities: int | None,
    min_disparity: int | None,
    as_json: bool,
    **options: Any,
) -> int:
    """Run matchers on every pair of DATASET..., score them, and write OUTPUT/board.json and OUTPUT/index.html.

    A dataset is a folder made by `twinlens render` or `twinlens generate`, a downloaded folder of Middlebury, KITTI or
    ETH3D, "motorcycle", a real pair with measured truth, or a folder with im0.png and im1.png. Without truth, maps are
    compared with those of the right view, with the images and with each other (docs/real_pairs.md). Results already in
    OUTPUT/board.json are kept. A matcher that crashes, exceeds a limit, or returns no valid map fails on that pair
    only. The exit code is 1 if all matches failed.

    \b
    Example:  twinlens benchmark out motorcycle --methods sad,zncc:block_size=15 -o board
              twinlens benchmark out --command "mine=./prog --fast {left} {right} {out}" --time-limit 60 -o board
              twinlens benchmark out --methods sgm --by lens -o board
    """
    matchers = _matchers(methods, commands, time_limit)
    if time_limit is None and any(matcher.runs_user_code for matcher in matchers):
        time_limit = FOREIGN_LIMIT_S
    search = {"num_disparities": num_disparities, "min_disparity": min_disparity}
    pairs = open_pairs(datasets, search)
    check_by(pairs, by, output)
    board = run_board(
        pairs, matchers, output, time_limit=time_limit,
        memory_limit=None if memory_limit is None else memory_limit * 2**30,
        page_options=lambda _: {"by": "".join(by[:1])},
        **options,
    )  # fmt: skip
    names = [matcher.name for matcher in matchers]
    notes = _without_data(board, options)
    if not by:
        notes += _of_lenses(board)
    return print_board(board, output, as_json, names, by=by, notes=notes)


def _matchers(
    methods: Sequence[str], commands: Sequence[str], time_limit: float | None
) -> list[MethodSpec]:
    """The matchers of --methods, then those of --command; the default ones if neither names any."""
    texts = methods or (() if commands else (DEFAULT_METHODS,))
    matchers = parse_methods(texts) if texts else []
    return matchers + [parse_program(text, time_limit) for text in commands]


def _of_lenses(board: Board) -> list[str]:
    """A line if the means are over samples of a few lenses, which one may want to compare."""
    labels = [record.get("lens") for record in board.recorded.values()]
    lenses = sorted({str(label) for label in labels if label is not None})
    if not 2 <= len(lenses) <= _FEW_LENSES:
        return []
    return [
        f"the means are over {len(lenses)} lenses ({', '.join(lenses)}); --by lens compares them"
    ]


def _without_data(board: Board, options: Mapping[str, Any]) -> list[str]:
    """A line for each protocol and region that the user names and that no pair has the data for."""
    regions = set[str]().union(*map(board.regions_of, board.protocols))
    measured = {"protocols": set(board.protocols), "regions": regions}
    context = click.get_current_context()
    lines = []
    for option, names in measured.items():
        if context.get_parameter_source(option) != ParameterSource.COMMANDLINE:
            continue
        for name in options[option]:
            if name not in names:
                text = "no pair has the data that it needs, such as the true disparity"
                lines.append(f"--{option[:-1]} {name}: {text}")
    return lines
