"""How the kernels are compiled: cached on disk where the machine allows it, in memory where it does not."""

from collections.abc import Callable
from typing import Any, cast

import numba

Function = Callable[..., Any]


def jit(function: Function) -> Function:
    """Compile `function` without the interpreter lock, its machine code kept on disk for the next process.

    It lies in NUMBA_CACHE_DIR, beside the source, or in the user's cache directory.
    numba refuses to decorate at all when none of these places can be written (an installation that is read-only, a
    user without a home); the kernels are then compiled anew in each process.
    """
    try:
        return cast("Function", numba.njit(nogil=True, cache=True, error_model="numpy")(function))
    except RuntimeError:
        return cast("Function", numba.njit(nogil=True, error_model="numpy")(function))


def inlined(function: Function) -> Function:
    """Paste `function` into the kernels that call it: a call would count references to every array it is given."""
    return cast("Function", numba.njit(inline="always")(function))
