"""Process an image in strips of rows, on one or several threads."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

FLOAT_ROWS = 64  # float sums depend on where a strip begins, so float images are always cut in the same places


def cpu_count() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_strips(work: Callable[[int, int], None], height: int, rows: int, threads: int) -> None:
    """Call work(y0, y1) for every strip of at most `rows` rows, on `threads` threads including the caller's.

    After an error or a KeyboardInterrupt no further strip is started.
    """
    strips = [(y, min(y + rows, height)) for y in range(0, height, rows)]
    if threads <= 1 or len(strips) == 1:
        for strip in strips:
            work(*strip)
        return
    waiting = iter(strips)  # shared by the threads: a list's iterator returns each strip once

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
            for _ in waiting:  # leave nothing to the other threads
                pass


def strip_rows(dtype: np.dtype[Any], height: int, threads: int) -> int:
    """Rows of a strip: an equal share for each thread, or a fixed number where sums are rounded."""
    return FLOAT_ROWS if dtype.kind == "f" else -(-height // max(threads, 1))
