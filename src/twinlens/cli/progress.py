"""A progress bar on a terminal for work that takes longer than two seconds; silence anywhere else."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

_PATIENCE_S = 2.0


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[float, str], None]]:
    """A function (fraction done, what is being done now) to call as work goes on.

    The bar appears on the error stream, once two seconds have passed, and leaves no trace.
    """
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"), TimeRemainingColumn(),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip
    task = bar.add_task(what, total=1.0)
    begun, shown = time.monotonic(), False

    def report(fraction: float, now: str = "") -> None:
        nonlocal shown
        if not shown and time.monotonic() - begun > _PATIENCE_S:
            bar.start()
            shown = True
        bar.update(task, completed=fraction, description=f"{what} {now}".strip())

    try:
        yield report
    finally:
        bar.stop()
