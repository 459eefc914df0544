"""A progress bar on a terminal for work that takes longer than two seconds; elsewhere a line now and then."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from twinlens.errors import is_interrupt

_DELAY_S = 2.0
LOG_EVERY_S = 30.0


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[float, str], None]]:
    """Yield a function to call with the fraction done and the current item.

    The bar appears on stderr after two seconds and is removed at the end. Without a terminal, stderr gets a line every
    LOG_EVERY_S seconds or less often. What is printed within the block, as matchers and studies of users do, goes to
    stderr too.
    """
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"), TimeRemainingColumn(),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip
    task = bar.add_task(what, total=1.0)
    start, shown = time.monotonic(), False
    logged = start

    def report(fraction: float, now: str = "") -> None:
        nonlocal shown, logged
        if not console.is_terminal:
            moment = time.monotonic()
            if moment - logged >= LOG_EVERY_S:
                logged = moment
                print(_line(what, now, fraction, moment - start), file=sys.stderr)
            return
        if not shown and time.monotonic() - start > _DELAY_S:
            bar.start()
            shown = True
        bar.update(task, completed=fraction, description=f"{what} {now}".strip())

    try:
        with redirect_stdout(sys.stderr):
            yield report
    finally:
        bar.stop()


def _line(what: str, now: str, fraction: float, seconds: float) -> str:
    """What is done, and about how long the rest takes at the same speed.

    >>> _line("generating", "3/12", 0.25, 60.0), _line("matching", "", 0.0, 30.0)
    ('generating 3/12: 25 %, about 0:03:00 left', 'matching: 0 %')
    """
    text = f"{what} {now}".strip() + f": {100 * fraction:.0f} %"
    if not fraction:
        return text
    rest = timedelta(seconds=round(seconds * (1 - fraction) / fraction))
    return f"{text}, about {rest} left"


@contextmanager
def interrupt_note(kept: Callable[[], str]) -> Iterator[None]:
    """Add a text, which may be empty, to the message of an interrupt within the block."""
    try:
        yield
    except BaseException as error:
        if not is_interrupt(error):
            raise
        raise KeyboardInterrupt(kept()) from error
