"""Where samples are made: in this process, in worker processes of this machine, or on a Dask cluster.

An engine makes the samples of some indices and yields each one once it is on the disk. All engines make the same bytes.
"""

import functools
import gc
import math
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinlens.dataset import Place, Row, Sample, write_sample
from twinlens.dataset.record import plain
from twinlens.dataset.storage import is_whole
from twinlens.errors import (
    BackendError,
    InputError,
    MissingExtraError,
    OutputError,
    check_int,
)
from twinlens.factory.ledger import (
    Entry,
    Failure,
    recovered_row,
    repair_hint,
    row_info,
    write_row,
)
from twinlens.factory.plan import sample_name
from twinlens.factory.produce import sample_or_failure
from twinlens.factory.recipe import Recipe, differences, recipe_from_table
from twinlens.factory.sample import made_with
from twinlens.factory.sources import changed_files
from twinlens.machine import memory_bytes, processor_count
from twinlens.processes import Worker, blocked_interrupts, end_with_parent, is_lost
from twinlens.rendering import (
    Progress,
    backend,
    share_kernels,
    use_threads,
)

RENEWED_AFTER = 300
"""Samples that a worker process makes before a new one replaces it. LLVM keeps about 15 KiB for each random scene that
it compiled kernels for, until the process ends."""

_MOST_WORKERS = 4  # without --workers
_WORKER_BYTES = 2 << 30  # measured: 1.5 GiB at 704x528
_LEAST_SAMPLES = 10  # of a worker, which needs some seconds to start
_POLL_S = 0.25
_QUEUED = 2  # samples submitted for each thread of a Dask cluster, so that none waits
_TRIES = 3

Report = Callable[[float, str], None]
Results = Generator[tuple[int, Entry], None, None]
Made = tuple[Entry, list[Warning]]


@dataclass(frozen=True)
class Work:
    """The recipe, the folder of the dataset, and the backend and versions that its samples must be made with."""

    recipe: Recipe
    folder: Place
    made_with: Mapping[str, Any]


Engine = Callable[[Work, Sequence[int], Report], Results]
"""Makes the samples of some indices; yields (index, entry) when a sample is on the disk, in any order."""


def written(work: Work, index: int, made: Sample | Failure | None) -> Entry:
    """Write a sample's folder, unless another worker has written it (`made` is None then), and its row."""
    folder = work.folder / sample_name(index)
    entry: Entry | None = made if isinstance(made, Failure) else None
    if isinstance(made, Sample):
        try:
            entry = Row(
                folder.name,
                write_sample(folder, made),
                plain(row_info(plain(made.record))),
            )
        except OutputError:
            if not folder.exists():
                raise
            if not is_whole(folder):
                raise OutputError(
                    f"{folder}: exists and is not a whole sample; {repair_hint(folder)}"
                ) from None
    if entry is None:
        entry = recovered_row(work.folder, work.recipe, index, work.made_with)
    write_row(work.folder, index, entry)
    return entry


def in_process(work: Work, indices: Sequence[int], report: Report) -> Results:
    """The engine of the calling thread: a second thread writes a sample while the next one is rendered."""
    if work.recipe.kind == "family":
        share_kernels()
    writing: tuple[int, Future[Entry]] | None = None
    with ThreadPoolExecutor(1, "twinlens-writer") as writer, _fewer_objects_collected():
        for done, index in enumerate(indices):
            progress, note = reported(report, done, len(indices))
            made = sample_or_failure(work.recipe, index, progress, note)
            if writing is not None:
                yield writing[0], writing[1].result()
            writing = index, writer.submit(written, work, index, made)
        if writing is not None:
            yield writing[0], writing[1].result()


@contextmanager
def _fewer_objects_collected() -> Iterator[None]:
    """Skip all objects that exist now when garbage is collected within this context.

    There is a collection after each sample, and visiting the objects of all modules would take 80 ms each time.
    A calling program that has frozen its objects keeps them frozen: to unfreeze is possible for all objects only.
    """
    if gc.get_freeze_count():
        yield
        return
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def reported(
    report: Report, done: int, count: int
) -> tuple[Progress, Callable[[str], None]]:
    """`progress` and `note` of `make`, that report the sample after `done` of `count`."""
    last = ""

    def progress(part: float) -> None:
        report((done + min(part, 0.99)) / count, last)

    def note(text: str) -> None:
        nonlocal last
        last = text
        progress(0.0)

    note("")
    return progress, note


@dataclass(frozen=True)
class Order:
    """A `Work` that can be pickled. `threads` to render with; None: those of the Dask worker."""

    written: Mapping[str, Any] = field(hash=False)
    path: Path
    folder: Place
    made_with: Mapping[str, Any] = field(hash=False)
    sources: Mapping[str, str] = field(hash=False)
    threads: int | None = None

    @classmethod
    def of(cls, work: Work, threads: int | None = None) -> "Order":
        """With absolute paths: a worker has another working folder."""
        recipe = work.recipe
        path, folder = recipe.file.absolute(), work.folder.resolve()
        return cls(
            dict(recipe.written),
            path,
            folder,
            work.made_with,
            recipe.sources.digests,
            threads,
        )


def usual_engine(work: Work, indices: Sequence[int], report: Report) -> Results:
    """`in_process`, or worker processes where they are faster, or where their replacement returns memory."""
    count = usual_workers(work.recipe, len(indices))
    engine = worker_processes(count) if count else in_process
    return engine(work, indices, report)


def usual_workers(recipe: Recipe, samples: int) -> int:
    """Number of worker processes that suit so many samples on this machine; 0 is the calling process alone.

    Several help with LLVM and scenes that differ: one processor draws, builds and compiles a scene while the other
    processors of its process wait. CUDA has one device, which all processes would share.
    """
    if not recipe.varied_scenes:
        return 0
    several = min(
        _MOST_WORKERS,
        processor_count(),
        memory_bytes() // _WORKER_BYTES,
        samples // _LEAST_SAMPLES,
    )
    if several > 1 and backend().name == "llvm":
        return several
    return 1 if samples > RENEWED_AFTER else 0


def worker_processes(count: int) -> Engine:
    """The engine of `count` processes on this machine, which share its processors evenly.

    A process is replaced after `RENEWED_AFTER` samples, and when it dies; its sample is made again.

    Raises InputError for a count below 1.
    """
    check_int("number of worker processes", count, 1)

    def engine(work: Work, indices: Sequence[int], report: Report) -> Results:
        order = Order.of(work, threads=math.ceil(processor_count() / count))
        tasks: dict[Worker, Future[Made]] = {}  # the last sample of each worker

        def submit(index: int) -> Future[Made]:
            idle = [worker for worker, last in tasks.items() if last.done()]
            if idle:
                worker = idle[0]
                try:
                    tasks[worker] = worker.submit(make_one, order, index)
                    return tasks[worker]
                except RuntimeError:  # its process has died idle
                    del tasks[worker]
                    worker.stop()
                    worker.join()
            worker = _started_worker()
            tasks[worker] = worker.submit(make_one, order, index)
            return tasks[worker]

        try:
            yield from _collected(submit, lambda: count, indices, report)
        finally:
            for worker in tasks:
                worker.stop()
            for worker in tasks:
                worker.join()

    return engine


def _started_worker() -> Worker:
    """A running worker, which no Ctrl-C reaches: the command ends it. Its parent holds the lock of the folder."""
    with blocked_interrupts():
        worker = Worker(renewed_after=RENEWED_AFTER, initializer=end_with_parent)
        _ = worker.active  # starts the process
    return worker


def dask_cluster(address: str) -> Engine:
    """The engine of a running Dask cluster, by its scheduler's address, such as ``tcp://host:8786``.

    Raises MissingExtraError without Dask distributed, and BackendError when no scheduler answers.
    """
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError(
            "--scheduler needs Dask distributed: pip install 'twinlens[cluster]'"
        ) from error

    def connect() -> Any:
        try:
            return distributed.Client(address, timeout=10)
        except (OSError, TimeoutError, ValueError) as error:
            message = f"no Dask scheduler answers at {address!r} ({error}); start one: dask scheduler"
            raise BackendError(message) from error

    connect().close()

    def engine(work: Work, indices: Sequence[int], report: Report) -> Results:
        order = Order.of(work)
        with connect() as client:
            executor = client.get_executor(pure=False)
            queued = lambda: _QUEUED * max(1, sum(client.nthreads().values()))  # noqa: E731
            try:
                yield from _collected(
                    lambda i: executor.submit(make_one, order, i),
                    queued,
                    indices,
                    report,
                )
            finally:
                executor.shutdown(wait=False)

    return engine


_ENDS_AT_ONCE = (
    "worker processes end as soon as they start; a script needs the guard `if __name__ == "
    '"__main__":`, and more may be in the system\'s log'
)


def _collected(
    submit: Callable[[int], Future[Made]],
    most: Callable[[], int],
    indices: Sequence[int],
    report: Report,
) -> Results:
    """Keep up to `most()` samples submitted and yield what is finished. A sample that lost its worker is resubmitted.

    Warnings of workers are given again in this process, which prints them as its caller wants.
    Raises BackendError at the end for samples whose worker died `_TRIES` times.
    """
    waiting, tries = iter(indices), Counter[int]()
    running: dict[Future[Made], int] = {}
    done = 0
    while True:
        while len(running) < most() and (index := next(waiting, None)) is not None:
            running[submit(index)] = index
        if not running:
            break
        for future in wait(running, timeout=_POLL_S, return_when=FIRST_COMPLETED).done:
            index = running.pop(future)
            try:
                entry, caught = future.result()
            except Exception as error:
                # KilledWorker is by name, because it is of Dask, which need not be installed.
                if not is_lost(error) and type(error).__name__ != "KilledWorker":
                    raise
                tries[index] += 1
                if tries[index] < _TRIES:
                    running[submit(index)] = index
                elif isinstance(error, BrokenProcessPool):
                    raise BackendError(_ENDS_AT_ONCE) from error
            else:
                done += 1
                for warning in caught:
                    warnings.warn(warning, stacklevel=2)
                yield index, entry
        report(done / len(indices), "")
    _refuse_lost([index for index, count in tries.items() if count == _TRIES])


def _refuse_lost(lost: Sequence[int]) -> None:
    """Raise BackendError for samples, by index, whose workers died too often."""
    if lost:
        raise BackendError(
            f"the worker of sample {lost[0]} died {_TRIES} times (out of memory?), as did those of {len(lost) - 1} "
            "others; all other samples are kept; use fewer workers (--workers 1), give them more memory or make the "
            "images smaller, and run the same command to resume"
        )


_RENDERER = ThreadPoolExecutor(1, "twinlens-renderer")
"""The thread of a worker that renders: Dr.Jit keeps its state by thread, and Dask runs tasks in several."""


def make_one(order: Order, index: int) -> Made:
    """Make and write one sample, in a worker. One that a worker had finished before it died is kept."""
    threads = order.threads
    if threads is None:
        from distributed import get_worker

        threads = int(get_worker().state.nthreads)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        work, made = _RENDERER.submit(_rendered, order, index, threads).result()
    return written(work, index, made), [
        warning.category(str(warning.message)) for warning in caught
    ]


def _rendered(
    order: Order, index: int, threads: int
) -> tuple[Work, Sample | Failure | None]:
    """The sample, why there is none, or None where it is written already."""
    work = _work(order, threads)
    if is_whole(order.folder / sample_name(index)):
        return work, None
    return work, sample_or_failure(work.recipe, index)


@functools.lru_cache(1)
def _work(order: Order, threads: int) -> Work:
    """Prepare this worker. Raises InputError where its versions, backend or files are not the dataset's."""
    use_threads(threads)
    work = Work(
        recipe_from_table(order.written, order.path), order.folder, order.made_with
    )
    if changed := differences(work.made_with, plain(made_with())):
        raise InputError(
            f"this worker has another backend or other versions than the dataset: {'; '.join(changed)}"
        )
    if changed_sources := changed_files(order.sources, work.recipe.sources.digests):
        raise InputError(
            f"this worker has other source files than the dataset's: {changed_sources}"
        )
    if work.recipe.kind == "family":
        share_kernels()
    gc.freeze()  # collections after each sample would visit the objects of all modules, in 70 ms
    return work
