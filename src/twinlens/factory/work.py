"""Making samples in this process: one thread renders, another encodes and writes what was rendered before.

The queue between them holds one sample, so that memory does not grow where the disk is slower than the renderer.
"""

import queue
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twinlens.dataset import Row, Sample, write_sample
from twinlens.dataset.record import plain
from twinlens.dataset.storage import is_whole, place
from twinlens.errors import InputError, OutputError
from twinlens.factory.entries import Entry, Failure
from twinlens.factory.ledger import recovered_row, remedy, row_info, write_row
from twinlens.factory.plan import sample_name
from twinlens.factory.produce import Exhausted, make
from twinlens.factory.recipe import Recipe, differences
from twinlens.factory.sample import made_with
from twinlens.rendering import forget_kernels, steady_memory


@dataclass(frozen=True)
class Work:
    """What a worker needs to know: the recipe, where the dataset lies, and what its samples must be made with."""

    recipe: Recipe
    folder: str
    made_with: Mapping[str, Any]


class Stopped(BaseException):
    """Raised in the middle of a sample by a run that was asked to stop."""


def rendered(work: Work, index: int, progress: Callable[[float], None] | None = None) -> Sample | Failure:
    """The sample, or why there is none."""
    try:
        return make(work.recipe, index, progress)
    except Exhausted as spent:
        return Failure(index, plain(spent.rejections), spent.remedy)
    finally:
        if work.recipe.makes_scenes:
            forget_kernels()  # of a scene that will not come again


def written(work: Work, index: int, made: Sample | Failure) -> Entry:
    """Put a sample on the disk, and its row beside the dataset.

    A sample that has come to be there meanwhile is kept: another worker, thought lost, may have made it.
    """
    root = place(work.folder)
    entry: Entry
    if isinstance(made, Failure):
        entry = made
    else:
        folder = root / sample_name(index)
        try:
            entry = Row(sample_name(index), write_sample(folder, made), plain(row_info(plain(made.record))))
        except OutputError:
            if not is_whole(folder):
                if folder.exists():
                    raise OutputError(f"{folder}: is there and is no whole sample; {remedy(folder)}") from None
                raise
            entry = recovered_row(root, work.recipe, index, work.made_with)
    write_row(root, index, entry)
    return entry


def check_tools(work: Work) -> None:
    """Raise InputError where this process would render with other tools than the dataset was begun with."""
    changed = differences(work.made_with, plain(made_with()))
    if changed:
        raise InputError(f"this worker renders with other tools than the dataset's: {'; '.join(changed)}")


def work_here(
    work: Work, indices: Sequence[int], report: Callable[[float, str], None], stop: Callable[[], bool]
) -> Iterator[tuple[int, Entry]]:
    """The engine of this process; see `twinlens.factory.generate.Engine`."""
    done = 0
    steady_memory()

    def progress(fraction: float) -> None:
        if stop():
            raise Stopped
        report((done + min(fraction, 0.99)) / len(indices), "")

    with _Writer(work) as writer:
        try:
            for index in indices:
                progress(0.0)
                writer.put(index, rendered(work, index, progress))
                done += 1
                yield from writer.finished()
        except Stopped:
            pass
        writer.drain()
        yield from writer.finished()


class _Writer:
    """A thread that writes samples; what it raises is raised again by the next call."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._waiting: queue.Queue[tuple[int, Sample | Failure] | None] = queue.Queue(maxsize=1)
        self._done: queue.SimpleQueue[tuple[int, Entry]] = queue.SimpleQueue()
        self._failed: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="twinlens-writer", daemon=True)

    def __enter__(self) -> "_Writer":
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._waiting.put(None)
        self._thread.join()
        if kind is None:
            self._raise()

    def put(self, index: int, made: Sample | Failure) -> None:
        self._raise()
        self._waiting.put((index, made))

    def drain(self) -> None:
        """Wait until everything is written."""
        self._waiting.join()
        self._raise()

    def finished(self) -> Iterator[tuple[int, Entry]]:
        """What has been written since the last call."""
        while not self._done.empty():
            yield self._done.get()

    def _run(self) -> None:
        while (job := self._waiting.get()) is not None:
            try:
                if self._failed is None:
                    self._done.put((job[0], written(self._work, *job)))
            except BaseException as error:  # told to the thread that renders
                self._failed = error
            finally:
                self._waiting.task_done()
                del job

    def _raise(self) -> None:
        if self._failed is not None:
            raise self._failed
