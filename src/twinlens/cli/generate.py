"""`twinlens generate`: a dataset from a recipe, stopped and continued at will."""

import json
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twinlens.cli.interrupts import once_more
from twinlens.cli.places import ADDRESS, PATH
from twinlens.cli.progress import progress_bar
from twinlens.cli.renewal import Progress, Renewal, earlier
from twinlens.errors import InputError

if TYPE_CHECKING:
    from twinlens.factory import Outcome, Recipe

RENEWED_AFTER = 300
"""Samples of new scenes that one process makes at least: see `twinlens.cli.renewal`."""


@click.command("generate")
@click.argument("recipe", type=PATH)
@click.option(
    "-o", "--output", required=True, type=ADDRESS, help="Folder of the dataset, or a bucket's address (s3://...)."
)
@click.option("--dry-run", is_flag=True, help="Make one sample, write nothing; tell what would be made, time and disk.")
@click.option("--limit", type=click.IntRange(min=1), help="Make at most so many samples now.")
@click.option("--shard", default="1/1", show_default=True, help="i/n: make every n-th sample, from the i-th on.")
@click.option("--workers", type=click.IntRange(min=1), help="Make them in so many processes of this machine (Dask).")
@click.option("--scheduler", help="Make them on the Dask cluster of this scheduler, as tcp://host:8786.")
@click.option("--json", "as_json", is_flag=True, help="Print what was made as JSON.")
@click.pass_obj
def command(
    renewable: bool | None,
    recipe: Path,
    output: str,
    dry_run: bool,
    limit: int | None,
    shard: str,
    workers: int | None,
    scheduler: str | None,
    as_json: bool,
) -> int:
    """Make the dataset that RECIPE (a .toml file) describes.

    Stop it whenever you like, or let the machine do it: the same command goes on where it stopped, and what it ends
    with is the same to the byte. Look at OUTPUT/preview.png meanwhile. A sample is drawn anew until it passes the
    quality gates; one that never does is left out and told at the end, with exit code 1.

    \b
    Example:  twinlens generate recipe.toml -o out
              twinlens generate recipe.toml -o out --dry-run
    """
    from twinlens.factory import generate, read_recipe

    done, content = earlier(), _content(recipe)
    read = read_recipe(recipe)
    if dry_run:
        return _tell_estimate(read, output, as_json)
    engine, part = _engine(workers, scheduler), _shard(shard)
    renewable = bool(renewable) and not engine and content is not None and _compiles(read)
    with progress_bar("generating") as report, _stop_on_signal() as stop:
        while True:
            left = None if limit is None else limit - done.tried
            batch = _batch(done, left) if renewable else left
            outcome = generate(read, output, limit=batch, shard=part, report=report, stop=stop.is_set, **engine)
            done = _after(done, outcome, batch or 0)
            if batch == left or not outcome.left or stop.is_set():
                break
            if _content(recipe) == content:
                raise Renewal(done)
            renewable = False  # a fresh process would read another recipe than this one did
    outcome = replace(outcome, made=done.made, before=done.before or 0)
    _tell(outcome, output, as_json)
    if outcome.interrupted or (stop.is_set() and outcome.left):
        raise KeyboardInterrupt("what was finished is kept" if outcome.there else "")
    return 1 if outcome.failures else 0


def _content(recipe: Path) -> bytes | None:
    """What the file holds; None for what can be read only once, as a pipe."""
    return recipe.read_bytes() if recipe.is_file() else None


def _compiles(recipe: "Recipe") -> bool:
    """Whether each sample has kernels of its own, of which memory is kept."""
    from twinlens.rendering import backend

    return recipe.makes_scenes and backend().is_jit


def _batch(done: Progress, left: int | None) -> int:
    """How many samples this process makes: the larger the dataset, the more is read again to go on."""
    most = max(RENEWED_AFTER, done.there // 3)
    return most if left is None else min(most, left)


def _after(done: Progress, outcome: "Outcome", tried: int) -> Progress:
    before = outcome.before if done.before is None else done.before
    return Progress(done.tried + tried, done.made + outcome.made, before, outcome.there)


def _engine(workers: int | None, scheduler: str | None) -> dict[str, Any]:
    if workers is not None and scheduler is not None:
        raise InputError("--workers starts a cluster of its own, --scheduler uses another; keep one")
    if workers is None and scheduler is None:
        return {}
    from twinlens.factory.cluster import local_cluster, remote_cluster

    return {"engine": local_cluster(workers) if workers is not None else remote_cluster(str(scheduler))}


def _shard(text: str) -> tuple[int, int]:
    part, slash, whole = text.partition("/")
    if not (slash and part.isdecimal() and whole.isdecimal() and 1 <= int(part) <= int(whole)):
        raise InputError(f"--shard must read i/n with i from 1 to n, as 2/8, got {text!r}")
    return int(part), int(whole)


@contextmanager
def _stop_on_signal() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C (or SIGTERM, which batch systems send) sets; the second ends at once.

    A signal that the process was started to ignore stays ignored.
    """
    stop = threading.Event()

    def asked(*_: object) -> None:
        if stop.is_set():
            once_more(before[signal.SIGINT])
        stop.set()

    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {kind: signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)}
    heard = [kind for kind, handler in before.items() if handler is not signal.SIG_IGN]
    try:
        for kind in heard:
            signal.signal(kind, asked)
        yield stop
    finally:
        for kind in heard:
            signal.signal(kind, before[kind])


def _tell(outcome: "Outcome", output: str, as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps({"dataset": output, **asdict(outcome)}, indent=1))
        return
    for failure in outcome.failures:
        last, draws = failure.rejections[-1], len(failure.rejections)
        tried = f", {draws} draws turned away, the last because" if draws > 1 else ""
        click.echo(
            f"sample {failure.index}: not made{tried}: {last['reason']} ({last['found']}); change {failure.remedy}",
            err=True,
        )
    click.echo(
        f"{output}: {outcome.there} of {outcome.count} samples, {outcome.made} of them made now{_turned(outcome)}"
    )
    if not outcome.complete:
        click.echo(_next(outcome), err=True)


def _next(outcome: "Outcome") -> str:
    if outcome.left or outcome.interrupted:
        return "the same command goes on from here"
    return "this shard is done; the dataset is finished once the other shards are made"


def _turned(outcome: "Outcome") -> str:
    if not outcome.rejections:
        return ""
    return "; turned away: " + ", ".join(f"{count} {reason}" for reason, count in outcome.rejections.items())


def _tell_estimate(recipe: "Recipe", output: str, as_json: bool) -> int:
    from twinlens.factory import estimate

    told = estimate(recipe, output)
    if as_json:
        click.echo(json.dumps({"dataset": output, **asdict(told)}, indent=1))
        return 0
    samples = f"{told.count} sample{'' if told.count == 1 else 's'}"
    click.echo(f"{output}: {samples}, {told.before} of them there, {told.todo} to make")
    if told.next is not None:
        for line in _drawn(told.next):
            click.echo(line)
        click.echo(
            f"one took {told.seconds_each:.1f} s and {_size(told.bytes_each)}: "
            f"about {_clock(told.seconds)} and {_size(told.bytes)} in all, on this machine alone"
        )
    return 0


def _drawn(spec: Mapping[str, Any]) -> Iterator[str]:
    """A sample's values, one a line, each by its place in the recipe."""
    split = f", of the split {spec['split']}" if spec["split"] else ""
    yield f"the next would be sample {spec['index']}, of the {spec['kind']} {spec['scene']}{split}:"
    for place, value in _flat("", spec["drawn"]):
        yield f"  {place} = {value}"


def _flat(place: str, value: Any) -> Iterator[tuple[str, str]]:
    """The numbers and words of a tree, each with its place.

    >>> dict(_flat("", {"rig": {"baseline": 0.123456789}, "lenses": [{"kind": "thin"}]}))
    {'rig.baseline': '0.123457', 'lenses[0].kind': '"thin"'}
    """
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _flat(f"{place}.{key}" if place else key, part)
    elif isinstance(value, list) and any(isinstance(part, (Mapping, list)) for part in value):
        for k, part in enumerate(value):
            yield from _flat(f"{place}[{k}]", part)
    else:
        yield place, f"{value:.6g}" if isinstance(value, float) else json.dumps(value)


def _size(count: float) -> str:
    """Bytes, in the unit that leaves a number to read.

    >>> _size(2.5e9), _size(999_999_999), _size(23_400), _size(0)
    ('2.50 GB', '1000.0 MB', '0.02 MB', '0.00 MB')
    """
    if count >= 1e9:
        return f"{count / 1e9:.2f} GB"
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count / 1e6:.2f} MB"


def _clock(seconds: float) -> str:
    """Hours and minutes; seconds where it is less.

    >>> _clock(7380), _clock(42)
    ('2 h 03 min', '42 s')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{int(seconds // 3600)} h {int(seconds % 3600 // 60):02d} min"
