"""An image's rows shared out: strips of them, one after another or on several threads."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

FLOAT_ROWS = 64  # rounding depends on where a strip begins: float images are always cut in the same places


def cpu_count() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_strips(work: Callable[[int, int], None], height: int, rows: int, threads: int) -> None:
    """work(y0, y1) for every strip of at most `rows` rows, on as many threads, of which the caller's is one.

    An error, or an interrupt from the keyboard, ends it with the strips that are under way.
    """
    strips = [(y, min(y + rows, height)) for y in range(0, height, rows)]
    if threads <= 1 or len(strips) == 1:
        for strip in strips:
            work(*strip)
        return
    waiting = iter(strips)  # taken by several threads: a list's iterator hands each strip out once

    def run() -> None:
        for strip in waiting:
            work(*strip)

    helpers = min(threads, len(strips)) - 1
    with ThreadPoolExecutor(helpers) as pool:
        others = [pool.submit(run) for _ in range(helpers)]
        try:
            run()
            for other in others:
                other.result()
        finally:
            for _ in waiting:  # leaves nothing to take
                pass


def strip_rows(dtype: np.dtype[Any], height: int, threads: int) -> int:
    """Rows a strip has: an equal share for each thread, or a fixed number where sums round."""
    return FLOAT_ROWS if dtype.kind == "f" else -(-height // max(threads, 1))
