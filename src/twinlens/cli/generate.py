"""`twinlens generate`: make a dataset from a recipe."""

import re
import textwrap
from dataclasses import asdict
from datetime import timedelta
from pathlib import Path
from typing import Any

import click
from rich.filesize import decimal

from twinlens import factory
from twinlens.cli.options import (
    Whole,
    json_option,
    print_json,
    rectify_hint,
    setting,
)
from twinlens.cli.places import PATH, PLACE
from twinlens.cli.progress import interrupt_note, progress_bar
from twinlens.dataset import Dataset, Place
from twinlens.errors import InputError, counted
from twinlens.factory.images_text import images_of_recipe
from twinlens.factory.recipe import Recipe
from twinlens.factory.workers import Engine
from twinlens.scoring import recipe_toml


@click.command("generate")
@click.argument("recipe", type=PATH)
@click.option(
    "-o",
    "--output",
    required=True,
    type=PLACE,
    help="Dataset folder or bucket address (s3://...).",
)
@click.option(
    "--dry-run",
    is_flag=True,
    help="Make one sample without writing it, and print the time and disk space needed.",
)
@click.option(
    "--limit", type=Whole(1), help="Make at most this many samples in this run."
)
@click.option(
    "--shard",
    default="1/1",
    show_default=True,
    help="i/n: make every n-th sample, starting with the i-th.",
)
@click.option(
    "--workers",
    type=Whole(1),
    help="Number of worker processes on this machine.  [default: up to 4 for random scenes]",
)
@click.option(
    "--scheduler",
    help="Use the Dask cluster of this scheduler, such as tcp://host:8786.",
)
@setting(factory.Shoot, "noise")
@click.option(
    "--denoise/--no-denoise", default=None, help="Override the recipe's `denoise`."
)
@json_option("the result")
def command(
    recipe: Path,
    output: Place,
    dry_run: bool,
    limit: int | None,
    as_json: bool,
    **options: Any,
) -> int:
    """Make the dataset that RECIPE (a .toml file) describes.

    The run may be stopped at any time. The same command resumes it, and the finished dataset has the same bytes as
    that of an uninterrupted run. OUTPUT/preview.png shows the samples made so far. If a random draw fails a quality
    gate, the sample is drawn again. A sample is left out if all its draws fail; it is reported at the end, and the exit
    code is 1. If every sample fails, nothing is kept.

    \b
    Example:  twinlens generate recipe.toml -o out
              twinlens generate recipe.toml -o out --dry-run
    """
    changes = {
        key: options[key] for key in ("denoise", "noise") if options[key] is not None
    }
    read = factory.read_recipe(recipe, changes)
    if dry_run:
        with progress_bar("trying a sample") as report:
            estimate = factory.estimate(read, output, report)
        _print_images(read, as_json)
        _print_estimate(estimate, output, as_json)
        return 0
    engine = _engine(options["workers"], options["scheduler"])
    shard = _shard(options["shard"])
    kept = "finished samples are kept; run the same command to resume"
    with progress_bar("generating") as report, interrupt_note(lambda: kept):
        outcome = factory.generate(
            read, output, limit=limit, shard=shard, report=report, engine=engine
        )
    _print_images(read, as_json)
    _print(outcome, output, as_json)
    if outcome.there:
        _print_rectify_hint(output)
    return 1 if outcome.failures else 0


def _print_images(recipe: Recipe, as_json: bool) -> None:
    """Print what images depend on most; not for programs."""
    if not as_json:
        click.echo(images_of_recipe(recipe.written))


def _engine(workers: int | None, scheduler: str | None) -> Engine:
    """Where samples are made: worker processes of this machine, or a Dask cluster."""
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler exclude each other")
    if scheduler:
        return factory.dask_cluster(scheduler)
    return factory.worker_processes(workers) if workers else factory.usual_engine


def _shard(text: str) -> tuple[int, int]:
    """(i, n) of --shard i/n."""
    part = re.fullmatch("([0-9]+)/([0-9]+)", text)
    if part is None or not 1 <= int(part[1]) <= int(part[2]):
        raise InputError(
            f"--shard must be i/n with i from 1 to n, such as 2/8, got {text!r}"
        )
    return int(part[1]), int(part[2])


def _print_rectify_hint(output: Place) -> None:
    """Print what to do if the first sample, and so probably all, has no disparity."""
    if hint := rectify_hint(Dataset(output)[0].rig, output):
        click.echo(hint, err=True)


def _print(outcome: factory.Outcome, output: Place, as_json: bool) -> None:
    if as_json:
        print_json({"dataset": str(output), **asdict(outcome)})
        return
    for failure in outcome.failures:
        last, draws = failure.rejections[-1], len(failure.rejections)
        why = (
            f"{draws} draws rejected; last reason: " if draws > 1 else ""
        ) + f"{last['reason']} ({last['found']})"
        click.echo(
            f"sample {failure.index} failed: {why}; change {failure.remedy}", err=True
        )
    rejected = ", ".join(
        f"{count} {reason}" for reason, count in outcome.rejections.items()
    )
    count = counted(outcome.count, "sample")
    made = f"{output}: {outcome.there} of {count}, {outcome.made} made by this run"
    click.echo(made + (f"; draws rejected: {rejected}" if rejected else ""))
    if outcome.left:
        click.echo(_rest_text(outcome), err=True)
    elif not outcome.there and outcome.failures:
        click.echo(
            f"{output}: nothing is kept, as every sample failed; change the recipe and run the same command again "
            "(--json lists the rejected draws)",
            err=True,
        )
    elif not outcome.complete:
        click.echo(
            "this shard is done; the dataset is complete when the other shards are done",
            err=True,
        )


def _rest_text(outcome: factory.Outcome) -> str:
    """What to do about the samples that are still to be made."""
    if not outcome.failures:
        return "run the same command to make the rest"
    rest = counted(outcome.left, "sample")
    if outcome.there:
        return (
            f"run the same command to make the {rest} left; those that failed are not made again with this recipe, and "
            "a changed one needs a new folder"
        )
    return (
        f"no sample is made so far, and the {rest} left may fail alike: change the recipe as said above, then run the "
        "same command again"
    )


def _print_estimate(estimate: factory.Estimate, output: Place, as_json: bool) -> None:
    if as_json:
        print_json({"dataset": str(output), **asdict(estimate)})
        return
    samples = counted(estimate.count, "sample")
    click.echo(f"{output}: {samples}, {estimate.before} made, {estimate.todo} to make")
    if estimate.next is None:
        return
    split = f", split {estimate.next['split']}" if estimate.next["split"] else ""
    click.echo(
        f"next: sample {estimate.next['index']}, {estimate.next['kind']} {estimate.next['scene']}{split}"
    )
    tables = dict.fromkeys(
        recipe_toml(estimate.next["drawn"]).strip().split("\n\n")
    )  # equal copies of an object once
    click.echo(textwrap.indent("\n\n".join(tables), "  "))
    rest = f"{timedelta(seconds=round(estimate.seconds))} (h:mm:ss) and {decimal(estimate.bytes)} on this machine"
    click.echo(
        f"one sample took {estimate.seconds_each:.1f} s and {decimal(estimate.bytes_each)}; the rest needs about {rest}"
    )
