"""`twinlens benchmark`: matchers x samples -> board.json, a table and a page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from twinlens.cli.boards import board_options, memory_bytes, print_board, run_board
from twinlens.cli.places import PATH

DEFAULT_METHODS = "sad,ssd,zncc"
FOREIGN_LIMIT_S = 600.0
"""Default time limit with networks or functions, which must run in a worker process."""


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
    "--time-limit", type=float,
    help="Seconds per match, warm-up excluded. Runs matchers in a subprocess.  [default: 600 if a network or a Python "
    "function is among them]",
)  # fmt: skip
@click.option("--memory-limit", type=float, help="GiB per matcher. Runs matchers in a subprocess.")
@click.option("--warm-up-limit", type=float, default=120.0, show_default=True,
              help="Seconds per warm-up in a subprocess.")  # fmt: skip
@click.option("--retry-failed", is_flag=True, help="Rerun matches that failed in an earlier run.")
@board_options
def command(
    datasets: tuple[str, ...],
    output: Path,
    methods: tuple[str, ...],
    commands: tuple[str, ...],
    time_limit: float | None,
    memory_limit: float | None,
    warm_up_limit: float,
    retry_failed: bool,
    protocols: tuple[str, ...],
    regions: tuple[str, ...],
    as_json: bool,
) -> int:
    """Run matchers on every pair of DATASET..., score them, and write OUTPUT/board.json and OUTPUT/index.html.

    A dataset is a folder made by `twinlens render` or `twinlens generate`, a folder in Middlebury's layout, or
    "motorcycle", a real pair with measured truth. Results already in OUTPUT/board.json are kept. A matcher that
    crashes, exceeds a limit, or returns no valid map fails on that pair only. The exit code is 1 if all matches failed.

    \b
    Example:  twinlens benchmark out motorcycle --methods sad,zncc:block_size=15 -o board
              twinlens benchmark out --command "mine=./prog --fast {left} {right} {out}" --time-limit 60 -o board
    """
    from twinlens.scoring import open_pairs

    matchers = matchers_of(methods, commands, time_limit)
    if time_limit is None and any(getattr(matcher, "runs_user_code", False) for matcher in matchers):
        time_limit = FOREIGN_LIMIT_S
    board = run_board(
        open_pairs(datasets), matchers, output, protocols, regions, time_limit=time_limit,
        memory_limit=memory_bytes(memory_limit), warm_up_limit=warm_up_limit, retry_failed=retry_failed,
    )  # fmt: skip
    return print_board(board, output, as_json, [matcher.name for matcher in matchers])


def matchers_of(methods: Sequence[str], commands: Sequence[str], time_limit: float | None) -> list[Any]:
    """The matchers of --methods and the programs of --command; DEFAULT_METHODS without either."""
    from twinlens.scoring import named_methods, named_program

    texts = methods or (() if commands else (DEFAULT_METHODS,))
    named = named_methods(texts) if texts else []
    return [*named, *(named_program(text, time_limit) for text in commands)]
