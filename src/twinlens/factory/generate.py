"""Making a dataset: every sample of a recipe that is not in the folder yet. A run may be stopped and resumed.

recipe -> Ledger (what the folder holds) -> engine -> (index, entry) -> Ledger -> dataset.json, preview.png, card
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from twinlens.dataset import remove_unfinished, sample_files, write_card, write_croissant
from twinlens.dataset.lock import locked
from twinlens.dataset.storage import Where, place
from twinlens.errors import InputError
from twinlens.factory.ledger import Entry, Failure, Ledger
from twinlens.factory.plan import plan
from twinlens.factory.preview import Preview
from twinlens.factory.produce import check_backend
from twinlens.factory.recipe import Recipe
from twinlens.factory.sample import made_with
from twinlens.factory.workers import Engine, Report, Work, in_process, rendered

_WRITE_EVERY_S = 5.0
_WRITE_SHARE = 0.02  # of the time at most goes into dataset.json, which grows with the dataset


@dataclass(frozen=True)
class Outcome:
    """The state of a dataset after a run.

    count : samples of the recipe.
    made : samples that this run made.
    before, there : samples in the folder before and after, those of other shards included.
    failures : samples all of whose draws were rejected.
    rejections : rejected draws by reason.
    complete : whether every sample is made or failed.
    left : samples of this shard that are still to be made.
    """

    count: int
    made: int
    before: int
    there: int
    failures: tuple[Failure, ...]
    rejections: dict[str, int]
    complete: bool
    left: int = 0


def generate(
    recipe: Recipe,
    folder: Where,
    *,
    limit: int | None = None,
    shard: tuple[int, int] = (1, 1),
    engine: Engine = in_process,
    report: Report = lambda fraction, now: None,
) -> Outcome:
    """Make every sample of `recipe` that is not in `folder` yet. After any stop the same call resumes.

    Parameters
    ----------
    limit : int, optional
        Make at most so many samples.
    shard : (i, n)
        Make only every n-th sample, starting with the i-th (1 to n). n such runs make the whole dataset, at the same
        time and on several machines if they share the folder. The last one to finish writes dataset.json.
    engine : Engine
        `in_process`, `worker_processes(count)` or `dask_cluster(address)`.
    report : callable
        Called with the fraction done and a text.

    Raises
    ------
    InputError
        `folder` holds another dataset.
    FileError
        A sample in `folder` lacks a file.
    OutputError
        `folder` cannot be written, or another run writes there.
    BackendError
        This machine's backend cannot render the lenses of the first sample; nothing is written then.
    """
    _check(limit, shard)
    root = place(folder)
    recipe.sources.hash_files()
    tools = made_with()
    if shard[0] <= recipe.count:
        check_backend(recipe, shard[0] - 1)
    shared = shard != (1, 1)
    with locked(root, shared, remedy="wait for it, or split the work with --shard"):
        ledger = Ledger(root, recipe, tools)
        if not shared:
            remove_unfinished(root)
        ledger.recover()
        ledger.check_files()
        if not ledger.has_file:
            ledger.write()
        before, known, made = len(ledger.entries.made), len(ledger.entries), 0
        todo = _share(ledger.missing(), shard)[:limit]
        work = Work(recipe, str(root), ledger.made_with)
        try:
            results = engine(work, todo, _of_whole(report, known, recipe.count, len(todo)))
            with _Upkeep(ledger, exclusive=not shared) as upkeep, closing(results):
                for index, entry in results:
                    upkeep.add(index, entry)
                    made += not isinstance(entry, Failure)
        finally:
            if not shared:
                remove_unfinished(root)
        if shared:
            ledger.recover()
        elif ledger.is_complete:
            finish(ledger)
    if ledger.is_complete and shared:
        with locked(root, wait=True):  # several shards may find at the same time that everything is made
            finish(ledger)
    there = len(ledger.entries.made)
    return Outcome(
        count=recipe.count,
        made=made if shared else there - before,
        before=before,
        there=there,
        failures=tuple(ledger.entries.failures),
        rejections=ledger.entries.rejections(),
        complete=ledger.is_complete,
        left=len(_share(ledger.missing(), shard)),
    )


def finish(ledger: Ledger) -> None:
    """Write the final dataset.json, preview, card and metadata; remove the files that only unfinished datasets need."""
    broken = unusable_assets(ledger.recipe)
    ledger.write(**({"skipped_assets": broken} if ledger.recipe.assets else {}))
    Preview(ledger.folder, ledger.recipe.count).write(ledger.entries.made)
    if ledger.entries.made:
        write_card(ledger.folder)
        write_croissant(ledger.folder)
    ledger.clear()


def unusable_assets(recipe: Recipe) -> list[dict[str, str]]:
    """The files in the recipe's asset folders that cannot be used, and why; each is read."""
    from twinlens.families import Assets

    found = []
    for kind, files in recipe.sources.asset_files.items():
        for name, path in files.items():
            single: dict[str, Any] = {kind: (path,)}
            for broken, reason in Assets(**single).check().broken:
                found.append({"kind": kind, "file": name, "reason": reason.replace(str(broken), name)})
    return found


class _Upkeep:
    """Adds entries to the ledger and, unless other shards write too, keeps dataset.json and the preview current."""

    def __init__(self, ledger: Ledger, exclusive: bool) -> None:
        self._ledger, self._exclusive = ledger, exclusive
        self._preview = Preview(ledger.folder, ledger.recipe.count)
        self._due = time.monotonic() + _WRITE_EVERY_S

    def __enter__(self) -> "_Upkeep":
        return self

    def __exit__(self, *_: object) -> None:
        if self._exclusive:
            self._write()

    def add(self, index: int, entry: Entry) -> None:
        self._ledger.entries[index] = entry
        if self._exclusive and time.monotonic() >= self._due:
            self._write()

    def _write(self) -> None:
        start = time.monotonic()
        self._ledger.write()
        self._preview.write(self._ledger.entries.made)
        now = time.monotonic()
        self._due = now + max(_WRITE_EVERY_S, (now - start) / _WRITE_SHARE)


def _share(indices: Sequence[int], shard: tuple[int, int]) -> list[int]:
    """The samples that a shard makes."""
    return [index for index in indices if index % shard[1] == shard[0] - 1]


def _check(limit: int | None, shard: tuple[int, int]) -> None:
    if limit is not None and limit < 1:
        raise InputError(f"limit must be 1 or more, got {limit}")
    if not 1 <= shard[0] <= shard[1]:
        raise InputError(f"a shard is i/n with i from 1 to n, got {shard[0]}/{shard[1]}")


def _of_whole(report: Report, known: int, count: int, todo: int) -> Callable[[float, str], None]:
    """Report the fraction of this run's samples, and in the text the number of all."""
    return lambda fraction, now: report(fraction, f"{known + round(fraction * todo)}/{count} {now}".strip())


@dataclass(frozen=True)
class Estimate:
    """Samples of the recipe, in the folder, and to make; the next one's spec; seconds and bytes of one and of all."""

    count: int
    before: int
    todo: int
    next: dict[str, Any] | None
    seconds_each: float = math.nan
    bytes_each: int = 0
    seconds: float = 0.0
    bytes: int = 0


def estimate(recipe: Recipe, folder: Where) -> Estimate:
    """Make the next sample of `recipe`, write nothing, and extrapolate its time and size.

    It is made twice and the second time is measured: the first compiles kernels that all samples share.
    """
    root = place(folder)
    ledger = Ledger(root, recipe, made_with())
    ledger.recover()
    ledger.check_files()
    missing = ledger.missing()
    before = recipe.count - len(missing)
    if not missing:
        return Estimate(recipe.count, before, 0, None)
    work = Work(recipe, str(root), ledger.made_with)
    rendered(work, missing[0])
    start = time.perf_counter()
    made = rendered(work, missing[0])
    if isinstance(made, Failure):
        last = made.rejections[-1]
        raise InputError(f"{recipe.file}: sample {made.index} fails: {last['found']}; change {made.remedy}")
    size = sum(map(len, sample_files(made).values()))
    seconds = time.perf_counter() - start
    spec = plan(recipe, missing[0], made.record["spec"]["attempt"]).plain()
    todo = len(missing)
    return Estimate(recipe.count, before, todo, spec, seconds, size, seconds * todo, size * todo)
