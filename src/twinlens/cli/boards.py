"""What the commands that make boards share: their options, the run with its progress, and the last lines."""

import contextlib
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twinlens.cli.places import check_results
from twinlens.cli.progress import interrupt_note, progress_bar
from twinlens.errors import FileError, InputError

if TYPE_CHECKING:
    from twinlens.scoring import Board

MOST_GIB = 2**20
_WIDE = 132
_ENDLESS = 100_000
_NARROW = ("totbad2.0", "bad2.0", "avgerr", "invalid", "time")


class Listing(click.Option):
    """An option whose help tells a registry's NAMES, or a number, of the scoring room, opened only for that help."""

    def __init__(self, *arguments: Any, registry: str, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.registry = registry

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        from twinlens import scoring

        said = getattr(scoring, self.registry)
        text = f"{said:g}" if isinstance(said, float) else ", ".join(said)
        plain = self.help or ""
        self.help = plain.replace("NAMES", text)
        try:
            return super().get_help_record(ctx)
        finally:
            self.help = plain


_CHOICES = (
    click.option(
        "--protocol", "protocols", multiple=True, default=("middlebury-v3",), show_default=True,
        cls=Listing, registry="PROTOCOLS", help="Scoring rules: NAMES; may be given several times.",
    ),
    click.option(
        "--region", "regions", multiple=True, default=("all", "nonocc"), show_default=True,
        cls=Listing, registry="REGIONS", help="Where to score: NAMES; may be given several times.",
    ),
    click.option(
        "--time-limit", type=float, help="Seconds that one match may take, where a first one of a few rows, which may "
        "compile, does not count; matchers then run apart.  [default: 600 where an ONNX model or a Python function is "
        "among them]",
    ),
    click.option("--memory-limit", type=float, help="GiB of memory that a matcher may take; it then runs apart."),
    click.option("--json", "as_json", is_flag=True, help="Print the board as JSON."),
)  # fmt: skip


def OPTIONS(command: Callable[..., Any]) -> Callable[..., Any]:  # noqa: N802  a decorator kept beside its table
    """The options of scoring, as one decorator."""
    for option in reversed(_CHOICES):
        command = option(command)
    return command


def run_board(
    pairs: Sequence[Any],
    methods: Sequence[Any],
    output: Path,
    protocols: Sequence[str],
    regions: Sequence[str],
    time_limit: float | None = None,
    title: str = "twinlens leaderboard",
    memory_limit: float | None = None,
    warm_up_limit: float | None = None,
    retry_failed: bool = False,
) -> "Board":
    """Run, score and save OUTPUT/board.json with its maps, and write the page. Limits: seconds a call, GiB a process.

    What methods print goes to the error stream: ours may be read by a script. Raises OutputError, touching nothing,
    where another run is writing there.
    """
    from twinlens.report import write_page
    from twinlens.scoring import WARM_UP_LIMIT_S, MapFolder, Step, run_benchmark

    _check_names(getattr(pairs, "names", ()))
    maps = MapFolder(output / "maps")
    before: set[tuple[str, str]] = set()
    made: list[str] = []
    with _alone(output):
        aside = contextlib.redirect_stdout(sys.stderr)
        with progress_bar("matching") as report, aside, _saying_what_is_kept(output, made):

            def tell(step: Step) -> None:
                report(step.done / (step.total or step.done), f"{step.sample}: {step.method}")
                if step.skipped:
                    before.add((step.method, step.sample))
                else:
                    made.append(step.sample)

            board = run_benchmark(
                pairs, methods, protocol=protocols, regions=regions, progress=tell, time_limit=time_limit,
                memory_limit=_bytes(memory_limit), save=output / "board.json", on_map=maps.keep, on_drop=maps.drop,
                title=title, retry_failed=retry_failed,
                warm_up_limit=WARM_UP_LIMIT_S if warm_up_limit is None else warm_up_limit,
            )  # fmt: skip
        write_page(output / "index.html", board, pairs, maps)
    _tell_old_failures(board, before)
    return board


def _tell_old_failures(board: "Board", before: Set[tuple[str, str]]) -> None:
    """What went wrong in an earlier run may have been mended since: say that it was not tried again, and how to."""
    old = {(e.method, e.sample) for e in board.entries if not e.ok} & before
    if old:
        pairs = "1 failure" if len(old) == 1 else f"{len(old)} failures"
        click.echo(f"{pairs} of an earlier run kept, and not tried again; --retry-failed does", err=True)


@contextlib.contextmanager
def _saying_what_is_kept(output: Path, made: Sequence[str]) -> Iterator[None]:
    """A sample that cannot be read ends the run, and not what it has `made` before; nor does an interrupt."""
    try:
        with interrupt_note(lambda: "what was finished is kept" if made else ""):
            yield
    except InputError as error:
        if not made:
            raise
        kept = "the match made before is" if len(made) == 1 else f"the {len(made)} matches made before are"
        kind = FileError if isinstance(error, FileError) else InputError
        raise kind(
            f"{error}; {kept} kept in {output / 'board.json'}: once this is mended, the same command goes on from there"
        ) from error


@contextlib.contextmanager
def _alone(output: Path) -> Iterator[None]:
    """Be the only run that writes there; refuse a folder of other things. A running one may have no board.json yet."""
    from twinlens.scoring.resume import exclusive

    if not output.is_dir():
        check_results(output, "board.json")
    with exclusive(output):
        check_results(output, "board.json")
        yield


def _check_names(names: Sequence[str]) -> None:
    """Hours of matching had better not end at a name that is there twice."""
    double = next((name for name, count in Counter(names).items() if count > 1), None)
    if double is not None:
        raise InputError(f"two samples are named {double!r}: a board tells them apart by name; run one dataset alone")


def _bytes(gib: float | None) -> int | None:
    if gib is None:
        return None
    if not 0 < gib < MOST_GIB:
        raise InputError(f"--memory-limit is {gib:g} GiB: expected more than 0 and less than {MOST_GIB}")
    return int(gib * 2**30)


def print_board(
    board: "Board",
    output: Path,
    as_json: bool,
    asked: Sequence[str] | None = None,
    beside: Mapping[str, Any] | None = None,
) -> int:
    """The leaderboards, what failed, and where the page is; the exit code, 1 where every method failed everywhere.

    asked: the methods whose failures are listed, None for all: a board may hold those of many runs. beside: what the
    JSON says besides the board.
    """
    from twinlens.scoring import board_to_json, failures

    code = 1 if board.entries and not any(entry.ok for entry in board.entries) else 0
    if as_json:
        text = board_to_json(board)
        click.echo(json.dumps(json.loads(text) | dict(beside), indent=1) if beside else text)
        return code
    region = "nonocc" if "nonocc" in board.regions else next(iter(board.regions), "")
    for protocol in board.protocols if region else ():
        _print_table(board, protocol, region)
    for line in failures(board, asked):
        click.echo(f"failed: {line}")
    if not region:
        click.echo("nothing was scored: " + ("every method failed" if code else "no sample has these regions"))
    click.echo(f"page: {(output / 'index.html').resolve().as_uri()}")
    return code


def _print_table(board: "Board", protocol: str, region: str) -> None:
    """As wide as the terminal; a file has no width, so that nothing is cut there, and no line ends in blanks."""
    from rich.console import Console
    from rich.text import Text

    from twinlens.scoring import caption, leaderboard_table

    terminal = Console()
    if terminal.is_terminal:
        narrow = protocol == "middlebury-v3" and terminal.width < _WIDE
        terminal.print(leaderboard_table(board, protocol, region, columns=_NARROW if narrow else None))
        return
    table = leaderboard_table(board, protocol, region)
    title, table.title, table.caption = str(table.title), None, None
    endless = Console(width=_ENDLESS)
    with endless.capture() as text:
        endless.print(table)
    lines = [Text.from_markup(title).plain, *text.get().splitlines(), *caption(board, protocol, region).splitlines()]
    click.echo("\n".join(line.rstrip() for line in lines))
