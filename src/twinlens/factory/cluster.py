"""Making samples with many processes, on one machine or many: Dask distributed carries the work and minds its workers.

Every worker makes and writes whole samples, under the folder or bucket that all of them see, and sends back one row. A
worker that dies costs the sample it was making, which another makes again.
"""

import functools
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinlens.dataset import Sample
from twinlens.dataset.storage import is_whole, place
from twinlens.errors import BackendError, InputError, MissingExtraError
from twinlens.factory.entries import Entry, Failure
from twinlens.factory.generate import Engine, Report
from twinlens.factory.ledger import recovered_row, write_row
from twinlens.factory.plan import sample_name
from twinlens.factory.recipe import recipe_from_table
from twinlens.factory.sources import changed_files
from twinlens.factory.work import Work, check_tools, rendered, written
from twinlens.rendering import steady_memory, use_threads

_POLL_S = 0.25
_THREADS = 2  # of Dask in a local worker: one sample is written while the next is rendered
_AHEAD = 2  # samples given to the cluster for each of its threads: enough that none waits, few enough to forget


@dataclass(frozen=True)
class Order:
    """A `Work` as it travels: the recipe as it was written, and what the files hold that it leads to.

    `threads` to render with; None takes the worker's own.
    """

    written: Mapping[str, Any] = field(hash=False)
    path: str
    folder: str
    made_with: Mapping[str, Any] = field(hash=False)
    sources: Mapping[str, str] = field(hash=False)
    threads: int | None = None


def local_cluster(workers: int) -> Engine:
    """The engine of `workers` processes on this machine, which share its processors evenly.

    Raises MissingExtraError without Dask distributed.
    """
    distributed = _distributed()

    def engine(work: Work, indices: Sequence[int], report: Report, stop: Callable[[], bool]) -> Iterator[Any]:
        if not indices:
            return
        order = _order(work, threads=max(1, len(os.sched_getaffinity(0)) // workers))
        with _deaf_to_interrupts():
            local = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=_THREADS,
                processes=True,
                memory_limit=0,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
        with local as cluster, distributed.Client(cluster) as client:
            yield from _run(client, order, indices, report, stop)

    return engine


def remote_cluster(address: str) -> Engine:
    """The engine of a Dask cluster that is there already, by its scheduler's address, as ``tcp://host:8786``.

    Raises MissingExtraError without Dask distributed, BackendError when nobody answers at the address; both at once, so
    that a dataset is not begun which nobody makes.
    """
    distributed = _distributed()
    with _reached(distributed, address):
        pass

    def engine(work: Work, indices: Sequence[int], report: Report, stop: Callable[[], bool]) -> Iterator[Any]:
        with _reached(distributed, address) as client:
            yield from _run(client, _order(work), indices, report, stop)

    return engine


def _run(
    client: Any, order: Order, indices: Sequence[int], report: Report, stop: Callable[[], bool]
) -> Iterator[tuple[int, Entry]]:
    """Keep a few samples a thread with the cluster, and hand on what comes back."""
    from distributed import wait

    waiting = iter(indices)
    running: dict[Any, int] = {}
    lost: list[int] = []
    done = 0
    while not stop():
        window = _AHEAD * max(1, sum(client.nthreads().values()))
        while len(running) < window and (index := next(waiting, None)) is not None:
            running[client.submit(make_one, order, index, pure=False)] = index
        if not running:
            break
        try:
            finished = wait(list(running), timeout=_POLL_S, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            finished = set()
        for future in finished:
            index = running.pop(future)
            done += 1
            if (entry := _answer(future)) is None:
                lost.append(index)
            else:
                yield index, entry
        report(done / len(indices), f"({len(client.nthreads())} workers)")
    client.cancel(list(running))
    if lost:
        raise BackendError(
            f"sample {lost[0]} ended every worker that made it (out of memory?), as did {len(lost) - 1} others; "
            "all else is kept; give the workers more memory, or the samples less, and run the same command"
        )


def _answer(future: Any) -> Entry | None:
    """What became of a sample; None where it took its workers down. Raises what stopped a worker otherwise."""
    from distributed.scheduler import KilledWorker

    try:
        entry: Entry = future.result()
    except KilledWorker:
        return None
    return entry


_RENDERER = ThreadPoolExecutor(1, "twinlens-renderer")
"""The one thread of a worker that renders: a renderer's state belongs to its thread."""


def make_one(order: Order, index: int) -> Entry:
    """Make and write one sample, in a worker. One that is there whole, from a worker that died since, is kept."""
    work, made = _RENDERER.submit(_rendered, order, index, order.threads or _own_threads()).result()
    root = place(order.folder)
    if made is not None:
        return written(work, index, made)
    entry: Entry = recovered_row(root, work.recipe, index, work.made_with)
    write_row(root, index, entry)
    return entry


def _rendered(order: Order, index: int, threads: int) -> tuple[Work, Sample | Failure | None]:
    """The sample, why there is none, or None where it is written already."""
    work = _work(order, threads)
    if is_whole(place(order.folder) / sample_name(index)):
        return work, None
    return work, rendered(work, index)


@functools.lru_cache(1)
def _work(order: Order, threads: int) -> Work:
    use_threads(threads)
    steady_memory()
    work = Work(recipe_from_table(order.written, Path(order.path)), order.folder, order.made_with)
    check_tools(work)
    if changed := changed_files(order.sources, work.recipe.sources.digests):
        raise InputError(f"this worker has other files beside the recipe than the dataset's: {changed}")
    return work


def _own_threads() -> int:
    from distributed import get_worker

    return int(get_worker().state.nthreads)


def _order(work: Work, threads: int | None = None) -> Order:
    path = os.path.abspath(work.recipe.at.source.file)  # noqa: PTH100  a worker stands in another folder
    root = place(work.folder)
    folder = str(root.resolve())
    return Order(dict(work.recipe.written), path, folder, work.made_with, work.recipe.sources.digests, threads)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """What is started within ignores Ctrl-C, which a terminal sends to all of a command's processes at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _reached(distributed: Any, address: str) -> Iterator[Any]:
    try:
        client = distributed.Client(address, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        raise BackendError(f"no Dask scheduler answers at {address!r} ({error}); start one: dask scheduler") from error
    with client:
        yield client


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError("many workers need Dask distributed: pip install 'twinlens[cluster]'") from error
    return distributed
