"""Making a dataset: every sample that is not there yet, in this process or by many; stopped and continued at will.

recipe -> Ledger (what is there) -> make, one by one --queue--> Writer (a thread: encode, write, keep the row)
                                 -> or a cluster's workers, each making and writing
                                 -> dataset.json, preview.png, card: now and then, and at the end
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from twinlens.dataset import remove_unfinished
from twinlens.dataset.lock import WAIT, locked
from twinlens.dataset.storage import Where, place
from twinlens.errors import InputError
from twinlens.factory.entries import Entry, Failure
from twinlens.factory.finish import finish
from twinlens.factory.ledger import Ledger
from twinlens.factory.preview import Preview
from twinlens.factory.produce import check_backend
from twinlens.factory.recipe import Recipe
from twinlens.factory.sample import made_with
from twinlens.factory.work import Work, work_here

_WRITE_EVERY_S = 5.0
_WRITE_SHARE = 0.02  # of the time may go into dataset.json, which grows with the dataset

Report = Callable[[float, str], None]
Engine = Callable[[Work, Sequence[int], Report, Callable[[], bool]], Iterator[tuple[int, Entry]]]
"""Makes samples: (index, what became of it) as each is on the disk. Stops early where the last argument says so."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended: samples asked for, made by this run, there before and there now (other shards' too); those that
    failed; whether it is complete, or was interrupted; and how many samples of its own share are left to make."""

    count: int
    made: int
    before: int
    there: int
    failures: tuple[Failure, ...]
    rejections: dict[str, int]
    complete: bool
    interrupted: bool
    left: int = 0


def generate(
    recipe: Recipe,
    folder: Where,
    *,
    limit: int | None = None,
    shard: tuple[int, int] = (1, 1),
    engine: Engine = work_here,
    report: Report = lambda fraction, now: None,
    stop: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Make every sample of `recipe` that is not in `folder` yet. The same call goes on after any stop.

    Parameters
    ----------
    limit : int, optional
        Make at most so many samples now.
    shard : (i, n)
        Make every n-th sample alone, from the i-th (1 to n) on: n such runs, at once and on different machines if they
        share the folder, make the whole. The one that finds every sample made writes dataset.json.
    engine : Engine
        This process, unless a cluster's is given: `twinlens.factory.cluster`.
    report : callable
        Is told the fraction done and what is being done.
    stop : callable
        Asked between passes: True drops the sample in the making, leaves all others whole, and ends the run.

    Raises InputError where `folder` holds another dataset, FileError where a sample there lacks a file, OutputError
    where it cannot be written; and, before anything is, BackendError where the backend that works here cannot
    photograph through the lenses of the first sample.
    """
    _check(limit, shard)
    root = place(folder)
    recipe.sources.take_stock()  # what cannot be read is told before anything is written
    tools = made_with()  # and so is a backend that does not work here
    if shard[0] <= recipe.count:
        check_backend(recipe, shard[0] - 1)  # the first sample's lenses, too
    shared = shard != (1, 1)
    with locked(root, shared, remedy=f"{WAIT}, or split the work by --shard"):
        ledger = Ledger(root, recipe, tools)
        if not shared:
            remove_unfinished(root)
        ledger.recover()
        ledger.refuse_damaged()
        if not ledger.has_file:
            ledger.write()
        before, known, made = len(ledger.entries.made), len(ledger.entries), 0
        todo = _share(ledger.missing(), shard)[:limit]
        with _Upkeep(ledger, alone=not shared) as upkeep:
            work = Work(recipe, str(root), ledger.made_with)
            for index, entry in engine(work, todo, _of_whole(report, known, recipe.count, len(todo)), stop):
                upkeep.took(index, entry)
                made += not isinstance(entry, Failure)
        if shared or stop():
            ledger.recover()
        if ledger.is_complete and not shared:
            finish(ledger)
    if ledger.is_complete and shared:
        with locked(root, wait=True):  # several shards may find that all is made: one after the other
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
        interrupted=stop() and not ledger.is_complete,
        left=len(_share(ledger.missing(), shard)),
    )


def _share(indices: Sequence[int], shard: tuple[int, int]) -> list[int]:
    """Those of the samples that a shard makes."""
    return [index for index in indices if index % shard[1] == shard[0] - 1]


class _Upkeep:
    """Takes entries into the ledger, and keeps dataset.json and the preview fresh without spending much on them."""

    def __init__(self, ledger: Ledger, alone: bool) -> None:
        self._ledger, self._alone = ledger, alone
        self._preview = Preview(ledger.folder, ledger.recipe.count)
        self._due = time.monotonic() + _WRITE_EVERY_S

    def __enter__(self) -> "_Upkeep":
        return self

    def __exit__(self, *_: object) -> None:
        if self._alone:
            self._write()

    def took(self, index: int, entry: Entry) -> None:
        self._ledger.entries[index] = entry
        if self._alone and time.monotonic() >= self._due:
            self._write()

    def _write(self) -> None:
        begun = time.monotonic()
        self._ledger.write()
        self._preview.write(self._ledger.entries.made)
        now = time.monotonic()
        self._due = now + max(_WRITE_EVERY_S, (now - begun) / _WRITE_SHARE)


def _check(limit: int | None, shard: tuple[int, int]) -> None:
    if limit is not None and limit < 1:
        raise InputError(f"the limit must be 1 sample or more, got {limit}")
    if not 1 <= shard[0] <= shard[1]:
        raise InputError(f"a shard is i/n with i from 1 to n, got {shard[0]}/{shard[1]}")


def _of_whole(report: Report, before: int, count: int, todo: int) -> Report:
    """The fraction of this run's samples, told with how many samples there are."""
    return lambda fraction, now: report(fraction, f"{before + round(fraction * todo)}/{count} {now}".strip())
