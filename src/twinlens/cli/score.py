"""`twinlens score`: score disparity maps made by other programs."""

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
from twinlens.cli.options import DISPARITY, Whole, json_option, print_json
from twinlens.cli.places import PATH, missing_output
from twinlens.dataset import place, read_disparity, read_png
from twinlens.errors import FileError, InputError, file_hint
from twinlens.scoring import (
    Scores,
    evaluate,
    open_pairs,
    open_submission,
    search_range,
)
from twinlens.scoring.board_file import UNSCORED
from twinlens.scoring.protocols import find_protocol

FIRST_FEW = 3  # file names listed in a warning
_MAPS = (".pfm", ".png")
_FOR_BOARDS = {"output": "-o", "regions": "--region", "by": "--by"}
_FOR_ONE_MAP = {
    "mask": "--mask",
    "ndisp": "--ndisp",
    "min_disparity": "--min-disparity",
}


@click.command("score")
@click.argument("submissions", nargs=-1, required=True, metavar="MAPS...", type=PATH)
@click.option(
    "--truth",
    "truths",
    multiple=True,
    required=True,
    help="Dataset, or the truth of one map. Repeatable.",
)
@click.option(
    "-o",
    "--output",
    type=PATH,
    help="Folder of the board.  [required, except for one map]",
)
@click.option(
    "--mask", type=PATH, help="For one map: PNG, 255 where visible in both cameras."
)
@click.option(
    "--ndisp", type=Whole(1), help="For one map: estimates are clipped to [0, ndisp]."
)
@click.option(
    "--min-disparity", type=DISPARITY, help="For one map: lower end of the clipping range.  [default: 0, or the "
    "truth's minimum if negative]",
)  # fmt: skip
@protocol_option
@region_option
@by_option
@json_option("the board")
def command(
    submissions: tuple[Path, ...],
    truths: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> int:
    """Score MAPS against --truth.

    Each of MAPS is a folder or zip file with one map per sample, and becomes one row of the leaderboard. Names of maps:
    <sample>.pfm, <sample>.png (as in KITTI) or <sample>/disp0.pfm; <sample>/lens-0.pfm, <sample>/lens-1.pfm, ... for
    several lenses. MAPS may also be a single .pfm or .png, which is scored against a single truth map.

    \b
    Example:  twinlens score my-maps.zip --truth out -o board
              twinlens score disp.pfm --truth out/staircase/disp0.pfm --mask out/staircase/mask0nocc.png
    """
    for path in submissions:
        if not path.exists():
            raise FileError(f"{path}: no such file or folder{file_hint(path)}")
    one_map = submissions[0].suffix.lower() in _MAPS and not submissions[0].is_dir()
    if one_map:
        _check_truth_maps(truths, submissions[0])
        _refuse(_FOR_BOARDS, "folders or zip files scored against datasets")
    else:
        _refuse(_FOR_ONE_MAP, "one map scored against one truth map")
        return _score_submissions(submissions, truths, as_json, options)
    if len(submissions) > 1 or len(truths) > 1 or len(options["protocols"]) > 1:
        raise InputError(
            "one map is scored against one truth by one --protocol; for more, give folders and datasets"
        )
    _print(_score_map(submissions[0], truths[0], options), as_json)
    return 0


def _check_truth_maps(truths: Sequence[str], estimate: Path) -> None:
    """Raise InputError for a dataset among the truths of one map."""
    for truth in truths:
        bundled = truth == "motorcycle" and not place(truth).exists()
        if bundled or place(truth).is_dir():
            raise InputError(
                f"{truth} is a dataset, and {estimate} is one map: give one truth map, as --truth "
                "SAMPLE/disp0.pfm, or a folder of maps"
            )


def _refuse(options: Mapping[str, str], purpose: str) -> None:
    """Raise InputError where the command line has one of these options, which serve another purpose."""
    context = click.get_current_context()
    for name, option in options.items():
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT:
            raise InputError(f"{option}: is only for {purpose}")


def _score_submissions(
    paths: Sequence[Path], truths: Sequence[str], as_json: bool, options: dict[str, Any]
) -> int:
    submissions, output = [open_submission(path) for path in paths], options["output"]
    if output is None:
        raise missing_output()
    pairs = open_pairs(truths)
    check_by(pairs, options["by"], output)
    for submission in submissions:
        submission.check_unambiguous(pairs.aliases)
    unmatched = {
        submission.name: submission.unmatched_files(pairs.aliases)
        for submission in submissions
    }
    board = run_board(
        pairs,
        submissions,
        output,
        options["protocols"],
        options["regions"],
        retry_failed=True,
        page_options=lambda _: {"by": "".join(options["by"][:1])},
    )
    code = print_board(
        board,
        output,
        as_json,
        [submission.name for submission in submissions],
        {UNSCORED: unmatched},
        by=options["by"],
    )
    for submission in submissions:
        missing = submission.missing_files(pairs.aliases)
        extra = unmatched[submission.name]
        count = f"missing maps: {len(missing)} of {len(pairs)}"
        _warn_of_files(submission.name, count, missing)
        count = f"maps that match no sample: {len(extra)}"
        _warn_of_files(submission.name, count, extra)
    return code


def _warn_of_files(submission: str, count: str, names: Sequence[str]) -> None:
    """Print the first few of some files on the error stream, if there are any."""
    if not names:
        return
    hidden = len(names) - FIRST_FEW
    more = f" and {hidden} more" if hidden > 0 else ""
    click.echo(
        f"{submission}: {count} ({', '.join(names[:FIRST_FEW])}{more})", err=True
    )


def _score_map(estimate: Path, truth: str, options: dict[str, Any]) -> Scores:
    name = options["protocols"][0]
    if find_protocol(name).needs_calibration:
        raise InputError(
            f"--protocol {name}: needs the pair's calibration; score a folder of maps, with --truth DATASET"
        )
    true, mask, low = read_disparity(truth), options["mask"], options["min_disparity"]
    width = true.shape[1]
    if low is not None and not -width < low < width:
        raise InputError(
            f"--min-disparity {low}: expected {1 - width} to {width - 1} for {truth}"
        )
    return evaluate(
        read_disparity(estimate), true, None if mask is None else read_png(mask), options["ndisp"],
        protocol=name,
        min_disparity=search_range(1, None, true)[1] if low is None else low,
    )  # fmt: skip


def _print(scores: Scores, as_json: bool) -> None:
    if as_json:
        rows = {
            name: {**region, "evaluated": region.evaluated}
            for name, region in scores.regions.items()
        }
        print_json({"protocol": scores.protocol.name, "regions": rows})
        return
    click.echo(scores)
