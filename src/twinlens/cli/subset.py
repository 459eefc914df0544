"""`twinlens subset`: a new dataset of the samples of others."""

from collections.abc import Callable, Sequence
from typing import Any

import click
from rich.filesize import decimal

from twinlens.cli.options import Whole, json_option, print_result
from twinlens.cli.places import PLACE
from twinlens.cli.progress import interrupt_note, progress_bar
from twinlens.dataset import Dataset, Place, StoredSample
from twinlens.dataset.combine import Combined, combine
from twinlens.dataset.dropping import check_dropped, droppable
from twinlens.dataset.splits import assign, parse_shares
from twinlens.dataset.stored import ReadOnce
from twinlens.dataset.verify import missing_parts
from twinlens.errors import InputError, counted, located
from twinlens.scoring.conditions import (
    Condition,
    chosen,
    parse_condition,
    sample_values,
)


@click.command("subset")
@click.argument("sources", nargs=-1, required=True, type=PLACE, metavar="DATASET...")
@click.option(
    "-o", "--output", required=True, type=PLACE, help="Folder of the new dataset."
)
@click.option(
    "--where",
    multiple=True,
    metavar="CONDITION",
    help="Take only samples of which this holds, such as 'lens.f_number < 2'. Repeatable: all must hold.",
)
@click.option(
    "--drop",
    metavar="NAME,...",
    default="",
    help=f"Leave out these channels: {', '.join(droppable())}.",
)
@click.option(
    "--splits",
    metavar="NAME=SHARE,...",
    help="Assign new splits, such as train=0.8,test=0.2.",
)
@click.option(
    "--by",
    default="scene",
    show_default=True,
    metavar="NAME",
    help="With --splits: samples with the same recorded value are in the same split.",
)
@click.option(
    "--seed", type=Whole(0), default=0, show_default=True, help="Seed of --splits."
)
@click.option(
    "--link",
    is_flag=True,
    help="Make hard links instead of copies of files that do not change.",
)
@json_option("the result")
def command(
    sources: tuple[Place, ...],
    output: Place,
    where: tuple[str, ...],
    drop: str,
    splits: str | None,
    by: str,
    seed: int,
    link: bool,
    as_json: bool,
) -> None:
    """Write a new dataset of the samples of DATASET...: a part of one, or several merged.

    A CONDITION compares a recorded value, by its name in `twinlens benchmark --by` or docs/datasets.md, with a number
    (<, <=, >, >=, =, !=) or a text (=, !=). Of several lenses of a sample, one must satisfy all conditions. --splits
    keeps samples of one scene together.

    Samples keep their names if these differ; otherwise each DATASET is a folder of the new one. The run may be stopped
    at any time; the same command resumes it. Files are copied and checked, or linked and not read with --link.

    \b
    Example:  twinlens subset shard-1 shard-2 -o all --link
              twinlens subset all -o wide --where "lens.f_number < 2" --where "disparity_max < 192"
              twinlens subset all -o small --drop position,blur_circle_px --splits train=0.9,test=0.1
    """
    dropped = [name.strip() for name in drop.split(",") if name.strip()]
    with located("--drop"):
        check_dropped(dropped)
    with located("--where"):
        conditions = [parse_condition(text) for text in where]
    shares = None
    if splits is not None:
        with located("--splits"):
            shares = parse_shares(splits)
    datasets = [Dataset(source) for source in sources]
    _print_unfinished(sources)
    parts = _parts(datasets, conditions)
    how: dict[str, Any] = {
        "where": [str(condition) for condition in conditions],
        "splits": None,
    }
    options: dict[str, Any] = {"dropped": dropped, "link": link, "how": how}
    if shares is not None:
        how["splits"] = {"shares": shares, "by": by, "seed": seed}
        options["split_of"] = _splitter(shares, by, seed)
    kept = "finished samples are kept; run the same command to resume"
    with progress_bar("writing") as report, interrupt_note(lambda: kept):
        done = combine(parts, output, report=report, **options)
    _print(done, sum(map(len, datasets)), output, as_json)


def _print_unfinished(sources: Sequence[Place]) -> None:
    """Say which sources lack samples."""
    for source in sources:
        note = missing_parts(source)
        if note.startswith("dataset.json lists"):
            click.echo(f"twinlens: warning: {source}: {note}", err=True)


def _parts(
    datasets: Sequence[Dataset], conditions: Sequence[Condition]
) -> list[Dataset]:
    """The samples of each dataset of which the conditions hold. Raises InputError if there are none."""
    if not conditions:
        return [*datasets]
    with progress_bar("reading") as report, located("--where"):
        numbers = chosen(datasets, conditions, report)
    parts = [dataset[taken] for dataset, taken in zip(datasets, numbers, strict=True)]
    if not any(map(len, parts)):
        texts = " and ".join(map(str, conditions))
        raise InputError(f"--where {texts}: holds of no sample")
    return parts


def _splitter(
    shares: dict[str, float], by: str, seed: int
) -> Callable[[Sequence[StoredSample]], list[str]]:
    """The splits of samples, by the groups of a recorded value."""

    def split_of(samples: Sequence[StoredSample]) -> list[str]:
        with located("--splits"):
            return assign([_group(sample, by) for sample in samples], shares, seed)

    return split_of


def _group(sample: StoredSample, by: str) -> str:
    """The value of a sample by which splits are made. Raises InputError if it has none."""
    values = sample_values(ReadOnce.of(sample))
    if by not in values:
        known = ", ".join(values)
        raise InputError(
            f"--by {by}: is not recorded of sample {sample.name!r} (recorded: {known})"
        )
    return str(values[by])


def _print(done: Combined, of: int, output: Place, as_json: bool) -> None:
    if not done.made:
        text = f"{output}: {counted(done.samples, 'sample')}, complete already"
    else:
        copied = done.files - done.linked
        parts = [f"{done.samples} of {counted(of, 'sample')}"]
        if done.repeated:
            parts.append(f"{done.repeated} that were in two sources")
        parts.append(f"{counted(copied, 'file')} written, {decimal(done.bytes)}")
        if done.linked:
            parts.append(f"{done.linked} hard links")
        parts += [f"{name}: {count}" for name, count in done.splits.items()]
        text = f"{output}: {', '.join(parts)}"
    record: dict[str, Any] = {
        "dataset": str(output),
        "of": of,
        "samples": done.samples,
        "made": done.made,
        "repeated": done.repeated,
        "files": done.files,
        "linked": done.linked,
        "bytes": done.bytes,
        "splits": dict(done.splits),
    }
    print_result(as_json, record, text)
