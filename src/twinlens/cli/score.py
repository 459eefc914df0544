"""`twinlens score`: disparity maps that something else made, against the truth."""

import contextlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from twinlens.cli.boards import OPTIONS, print_board, run_board
from twinlens.cli.places import PATH, missing_output
from twinlens.errors import FileError, InputError

if TYPE_CHECKING:
    from twinlens.scoring import Board, RegionScores, Scores, Submission

FIRST_FEW = 3
_MAPS = (".pfm", ".png")
_FOR_BOARDS = "is for folders or zips scored against datasets; one map is scored where --mask says"
_FOR_ONE = "is for one map scored against one truth; a dataset brings its own"


@click.command("score")
@click.argument("submissions", nargs=-1, required=True, metavar="MAPS...", type=PATH)
@click.option("--truth", "truths", multiple=True, required=True, help="The dataset(s), or one truth map for one map.")
@click.option("-o", "--output", type=PATH, help="Folder of the board.  [needed, but for one map]")
@click.option("--mask", type=PATH, help="For one map: a PNG, 255 where both cameras see.")
@click.option("--ndisp", type=click.IntRange(min=1), help="For one map: estimates are clipped to [0, ndisp].")
@click.option(
    "--min-disparity", type=int, help="For one map: clip from here on.  [default: 0, or the truth's smallest below it]"
)
@OPTIONS
def command(
    submissions: tuple[Path, ...],
    truths: tuple[str, ...],
    output: Path | None,
    mask: Path | None,
    ndisp: int | None,
    min_disparity: int | None,
    protocols: tuple[str, ...],
    regions: tuple[str, ...],
    time_limit: float | None,
    memory_limit: float | None,
    as_json: bool,
) -> int:
    """Score MAPS against --truth.

    MAPS are folders or zips with one map a sample (<sample>.pfm, <sample>.png or <sample>/disp0.pfm; PNG as KITTI's;
    <sample>/lens-0.pfm, <sample>/lens-1.pfm where it has several lenses), each one entry of the leaderboard; or a
    single .pfm or .png against a single truth map.

    \b
    Example:  twinlens score my-maps.zip --truth out -o board
              twinlens score disp.pfm --truth out/staircase/disp0.pfm --mask out/staircase/mask0nocc.png
    """
    one = submissions[0].suffix.lower() in _MAPS and not submissions[0].is_dir()
    _refuse_what_does_not_apply(one)
    if one:
        if len(submissions) > 1 or len(truths) > 1 or len(protocols) > 1:
            raise InputError(
                "one map is scored against one truth by one --protocol; for more, give folders and datasets"
            )
        _refuse_dataset(submissions[0], truths[0])
        scores = _score_one(submissions[0], truths[0], mask, ndisp, min_disparity, protocols[0])
        _print_json(scores) if as_json else _print(scores)
        return 0
    if output is None:
        raise missing_output()
    return _score_many(submissions, truths, output, protocols, regions, as_json)


def _refuse_what_does_not_apply(one: bool) -> None:
    """An option that would change nothing is a mistake of whoever gave it."""
    idle = {
        name: f"--{name.replace('_', '-')}: score runs no matcher, it reads maps; benchmark has that limit"
        for name in ("time_limit", "memory_limit")
    }
    if one:
        idle |= {name: f"{option}: {_FOR_BOARDS}" for name, option in (("output", "-o"), ("regions", "--region"))}
    else:
        names = ("mask", "ndisp", "min_disparity")
        idle |= {name: f"--{name.replace('_', '-')}: {_FOR_ONE}" for name in names}
    context = click.get_current_context()
    for name, why in idle.items():
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT:
            raise InputError(why)


def _refuse_dataset(estimate: Path, truth: str) -> None:
    """A lone map does not say which of a dataset's samples it is of."""
    from twinlens.dataset import place

    where = place(truth)
    if where.is_dir() or (truth == "motorcycle" and not where.exists()):
        raise InputError(
            f"{truth} is a dataset, and {estimate} is one map: give one truth map, as --truth SAMPLE/disp0.pfm, or a "
            "folder of maps"
        )


def _score_many(
    submissions: Sequence[Path],
    truths: Sequence[str],
    output: Path,
    protocols: Sequence[str],
    regions: Sequence[str],
    as_json: bool,
) -> int:
    from twinlens.cli.benchmark import Chain, pairs_of
    from twinlens.scoring import open_submission
    from twinlens.scoring.board_file import UNSCORED

    methods = [open_submission(path) for path in submissions]
    parts = [pairs_of(name) for name in truths]
    _check_shared(methods, parts)
    strangers = _strangers(methods, parts)
    board = run_board(Chain(parts), methods, output, protocols, regions, retry_failed=True)  # reading a map is quick
    code = print_board(board, output, as_json, [method.name for method in methods], {UNSCORED: strangers})
    for line in (*_missing(board, parts), *_unscored(strangers)):
        click.echo(line, err=True)
    return code


def _strangers(methods: Sequence["Submission"], parts: Sequence[Sequence[Any]]) -> dict[str, tuple[str, ...]]:
    """For each submission the maps in it that are of no sample."""
    samples = {name: aliases for part in parts for name, aliases in _aliases(part).items()}
    return {method.name: method.unmatched_files(samples) for method in methods}


def _unscored(strangers: Mapping[str, Sequence[str]]) -> list[str]:
    """A line for each submission that holds such maps: how many, and the first few."""
    lines = []
    for method, files in strangers.items():
        if files:
            count = "1 map is" if len(files) == 1 else f"{len(files)} maps are"
            lines.append(f"{method}: {count} of no sample here, and not scored: {_first_few(files)}")
    return lines


def _first_few(names: Sequence[str]) -> str:
    more = f" and {len(names) - FIRST_FEW} more" if len(names) > FIRST_FEW else ""
    return ", ".join(names[:FIRST_FEW]) + more


def _check_shared(methods: Sequence["Submission"], parts: Sequence[Sequence[Any]]) -> None:
    """One file is the map of one sample alone: scored for two, of one name in two datasets, it is wrong for one."""
    samples = [named for part in parts for named in _aliases(part).items()]
    for method in methods:
        owners: dict[str, str] = {}
        for sample, aliases in samples:
            with contextlib.suppress(FileError):  # a map that is missing is told later, with all others
                file = method.file_of(sample, aliases)
                other = owners.setdefault(file, sample)
                if other != sample:
                    raise InputError(
                        f"{method.path}: {file} would be scored for both {other!r} and {sample!r}, samples that share "
                        "a name: score each dataset alone"
                    )


def _aliases(part: Sequence[Any]) -> dict[str, tuple[str, ...]]:
    """What the maps of each pair may be called besides its name."""
    return getattr(part, "aliases", None) or {pair.name: () for pair in part}


def _missing(board: "Board", parts: Sequence[Sequence[Any]]) -> list[str]:
    """For each submission that lacks maps one line: how many of how many, and what the first few are to be called."""
    from twinlens.scoring.samples import map_names

    files: dict[str, str] = {}
    for part in parts:
        files |= map_names(_aliases(part))
    lines = []
    for method in board.methods:
        failures = {e.sample: e.failure for e in board.entries if e.method == method and e.failure is not None}
        lost = [files[s] for s, failure in failures.items() if failure.kind == "missing" and s in files]
        if lost:
            lines.append(f"{method}: {len(lost)} of {len(files)} maps are missing: {_first_few(lost)}")
    return lines


def _score_one(
    estimate: Path, truth: str, mask: Path | None, ndisp: int | None, min_disparity: int | None, protocol: str
) -> "Scores":
    from twinlens.cli.images import read_disparity
    from twinlens.dataset import place, read_png
    from twinlens.scoring import evaluate, search_range

    true = read_disparity(place(truth))
    width = true.shape[1]
    if min_disparity is not None and not -width < min_disparity < width:
        raise InputError(
            f"--min-disparity {min_disparity}: {truth} is {width} pixels wide, so that disparities lie between "
            f"{1 - width} and {width - 1}"
        )
    return evaluate(
        read_disparity(estimate),
        true,
        None if mask is None else read_png(mask),
        ndisp,
        protocol=protocol,
        min_disparity=search_range(1, None, true)[1] if min_disparity is None else min_disparity,
    )


def _print_json(scores: "Scores") -> None:
    rows = {name: _row(region) for name, region in scores.regions.items()}
    click.echo(json.dumps({"protocol": scores.protocol.name, "regions": rows}, indent=1, allow_nan=False))


def _row(region: "RegionScores") -> dict[str, Any]:
    from twinlens.scoring import json_number

    return {name: json_number(value) for name, value in region.items()} | {"evaluated": region.evaluated}


def _print(scores: "Scores") -> None:
    from twinlens.scoring import find_metric

    click.echo(scores.protocol.title)
    for name, region in scores.regions.items():
        click.echo(f"{name}: {region.evaluated} of {region.image} pixels evaluated, {region.estimated} estimated")
        for metric, value in region.items():
            shown = find_metric(metric)
            click.echo(f"  {metric:<10} {shown.show(value):>10} {shown.unit}")
