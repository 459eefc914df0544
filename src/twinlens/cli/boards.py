"""Options, run and output of the commands that make leaderboards."""

import contextlib
import itertools
import json
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from twinlens import scoring
from twinlens.cli.options import print_json
from twinlens.cli.places import check_results
from twinlens.cli.progress import interrupt_note, progress_bar
from twinlens.dataset.files import locked
from twinlens.errors import InputError, located
from twinlens.report import write_page
from twinlens.scoring.board_file import COMPARED
from twinlens.scoring.grouping import DIFFERENCES
from twinlens.scoring.protocols import AGREE_PX

_WIDE, _ENDLESS = 132, 100_000
_NARROW = ("totbad2.0", "bad2.0", "avgerr", "invalid", "time")
protocol_option = click.option(
    "--protocol", "protocols", multiple=True, default=("middlebury-v3",), show_default=True,
    help=f"Scoring rules: {', '.join(scoring.PROTOCOLS)}. Repeatable.",
)  # fmt: skip
region_option = click.option(
    "--region", "regions", multiple=True, default=("all", "nonocc"), show_default=True,
    help=f"Regions to score: {', '.join(scoring.REGIONS)}. Repeatable.",
)  # fmt: skip

by_option = click.option(
    "--by", multiple=True, metavar="NAME",
    help="Compare groups of samples by a recorded value: lens, scene, family, sensor, mismatch, dataset, or a key of "
    "the recipe such as rig.baseline; see docs/benchmark.md. Repeatable.",
)  # fmt: skip


def check_by(pairs: scoring.DatasetPairs, by: Sequence[str], output: Path) -> None:
    """Raise InputError, before anything is run, for a value of --by that makes no groups of the pairs.

    Samples of an earlier run, in OUTPUT/board.json, stay on the board and count too.
    """
    file = output / "board.json"
    earlier = scoring.read_board(file) if by and file.exists() else None
    for name in by:
        with located("--by"):
            pairs.check_groups(name, earlier)


def map_folders(folder: Path) -> tuple[scoring.MapFolder, scoring.MapFolder]:
    """The maps of a board's folder: of the left views, and of the right views, which only pairs without truth have."""
    return scoring.MapFolder(folder / "maps"), scoring.MapFolder(folder / "maps-right")


def run_board(
    pairs: Sequence[Any],
    methods: Sequence[Any],
    output: Path,
    protocols: Sequence[str],
    regions: Sequence[str],
    *,
    title: str = "twinlens leaderboard",
    page_options: Callable[[scoring.Board], Mapping[str, Any]] = lambda board: {},
    **options: Any,
) -> scoring.Board:
    """Run and score `methods`, write OUTPUT/board.json and the maps, then the page, and return the board.

    page_options: further arguments of `write_page`. options: further arguments of `run_benchmark`. Raises OutputError,
    before anything is written, if another run writes there.
    """
    maps, right_maps = map_folders(output)
    steps = _Steps()
    with locked(output):
        check_results(output, "board.json")
        with progress_bar("matching") as report, _note(output, steps.finished):

            def drop(method: str, sample: str) -> None:
                maps.drop(method, sample)
                right_maps.drop(method, sample)

            def progress(step: scoring.Step) -> None:
                done = step.done / (step.total or step.done)
                report(done, f"{step.sample}: {step.method}")
                steps.add(step)

            board = scoring.run_benchmark(
                pairs, methods, protocol=protocols, regions=regions, progress=progress, save=output / "board.json",
                on_map=maps.keep, on_right_map=right_maps.keep, on_drop=drop, title=title, **options,
            )  # fmt: skip
        if scoring.CONSISTENCY in board.protocols:
            board = scoring.with_disagreements(board, maps)
            scoring.write_board(board, output / "board.json")
        write_page(
            output / "index.html", board, pairs, maps, right_maps=right_maps,
            **page_options(board),
        )  # fmt: skip
    _print_kept_failures(board, steps.skipped)
    return board


class _Steps:
    """What a run did: `finished`, the sample of each match; `skipped`, (method, sample) of earlier matches."""

    def __init__(self) -> None:
        self.finished: list[str] = []
        self.skipped: set[tuple[str, str]] = set()

    def add(self, step: scoring.Step) -> None:
        if step.skipped:
            self.skipped.add((step.method, step.sample))
        else:
            self.finished.append(step.sample)


def _print_kept_failures(board: scoring.Board, skipped: set[tuple[str, str]]) -> None:
    """Print how many of the skipped matches, (method, sample), had failed in an earlier run."""
    failed = {(entry.method, entry.sample) for entry in board.entries if not entry.ok}
    if kept := len(failed & skipped):
        click.echo(
            f"earlier failures kept: {kept}; use --retry-failed to rerun them", err=True
        )


@contextlib.contextmanager
def _note(output: Path, finished: Sequence[str]) -> Iterator[None]:
    """Add to an interrupt, or to an error of a sample that cannot be read, that finished matches are kept."""
    try:
        with interrupt_note(
            lambda: "finished matches are kept; rerun to resume" if finished else ""
        ):
            yield
    except InputError as error:
        if not finished:
            raise
        kept = f"{len(finished)} finished matches are in {output / 'board.json'}: fix this and rerun to resume"
        raise type(error)(f"{error}; {kept}") from error


def print_board(
    board: scoring.Board,
    output: Path,
    as_json: bool,
    methods: Collection[str] | None = None,
    extra: Mapping[str, Any] | None = None,
    groups: scoring.Groups | None = None,
    notes: Sequence[str] = (),
    by: Sequence[str] = (),
) -> int:
    """Print the leaderboards, the failures and the page's address; return the exit code, 1 if nothing has scores.

    methods: those whose failures are listed, None for all. extra: further keys of the JSON. groups: print means over
    these groups of samples in place of means over all, and the `notes`. by: recorded values by whose groups to compare
    the methods, after the means over all.
    """
    code = 1 if board.entries and not any(entry.ok for entry in board.entries) else 0
    groupings = {name: scoring.groups_by(board, name) for name in by}
    if as_json:
        record = json.loads(scoring.board_to_json(board)) | dict(extra or {})
        print_json(record | _comparisons(board, groupings))
        return code
    for protocol in board.protocols:
        _print_tables(board, protocol, groups, groupings)
    for line in without_truth(board):
        click.echo(line)
    for note in notes:
        click.echo(note)
    for line in scoring.failures(board, methods):
        click.echo(line if line.startswith(" ") else f"failed: {line}")
    if not board.regions:
        reason = "every method failed" if code else "no sample has these regions"
        click.echo(f"nothing was scored: {reason}")
    click.echo(f"page: {(output / 'index.html').resolve().as_uri()}")
    return code


def _print_tables(
    board: scoring.Board,
    protocol: str,
    groups: scoring.Groups | None,
    groupings: Mapping[str, scoring.Groups],
) -> None:
    """Print the means of a protocol in the region that matters most, and those of the groups of `groupings`."""
    regions = board.regions_of(protocol)
    if not regions:
        return
    region = "nonocc" if "nonocc" in regions else regions[0]
    _print_table(board, protocol, region, groups)
    for name, all_groups in groupings.items():
        samples = scoring.groups_of_protocol(board, protocol, all_groups)
        if samples:
            _print_table(board, protocol, region, samples, by=name)


def _comparisons(
    board: scoring.Board, groupings: Mapping[str, scoring.Groups]
) -> dict[str, Any]:
    """The key of the JSON that compares groups by recorded values, if there are any."""
    if not groupings:
        return {}
    records = {
        name: scoring.comparison_record(board, groups)
        for name, groups in groupings.items()
    }
    return {COMPARED: records}


def without_truth(board: scoring.Board) -> list[str]:
    """What is to be said of a board with pairs without truth: how many there are, and how often methods disagree."""
    compared = board.samples_of(scoring.CONSISTENCY)
    scored = {
        entry.sample
        for entry in board.entries
        if scoring.PROTOCOLS[entry.protocol].needs_truth
    }
    blind = [sample for sample in compared if sample not in scored]
    lines = []
    if blind:
        listed = ", ".join(blind[:3]) + (", ..." if len(blind) > 3 else "")
        lines.append(
            f"without truth: {len(blind)} of {len(board.samples)} pairs ({listed}); their maps are compared, not scored"
        )
    for first, second in itertools.combinations(board.methods, 2):
        shares = [
            pair.apart
            for pair in board.disagreements
            if {pair.first, pair.second} == {first, second}
            and math.isfinite(pair.apart)  # NaN: no pixel has both estimates
        ]
        if shares:
            share = sum(shares) / len(shares)
            lines.append(
                f"{first} and {second}: on average {share:.1f} % of their estimates are more than {AGREE_PX:g} px apart"
            )
    return lines


def _print_table(
    board: scoring.Board,
    protocol: str,
    region: str,
    groups: scoring.Groups | None,
    by: str = "",
) -> None:
    """Print a table, with columns chosen for the terminal's width; without a terminal, all columns untruncated.

    by: the recorded value that makes the groups, for their differences.
    """
    terminal = Console()
    narrow = (
        terminal.is_terminal and protocol == "middlebury-v3" and terminal.width < _WIDE
    )
    table = scoring.leaderboard_table(
        board, protocol, region, columns=_NARROW if narrow else None
    )
    if groups is not None:
        comparison = (
            scoring.compare_groups(board, protocol, region, groups) if by else None
        )
        table = scoring.comparison_table(board, protocol, region, groups, comparison)
        table.title = f"{table.title} · by {escape(by)}" if by else table.title
    if terminal.is_terminal:
        terminal.print(table)
        return
    title, table.title, table.caption = str(table.title), None, None
    endless = Console(width=_ENDLESS)
    with endless.capture() as text:
        endless.print(table)
    lines = [
        Text.from_markup(title).plain,
        *text.get().splitlines(),
        *(DIFFERENCES if by else scoring.caption(board, protocol, region)).splitlines(),
    ]
    click.echo("\n".join(line.rstrip() for line in lines))
