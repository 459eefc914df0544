"""Compile kernels with Numba and keep the machine code on disk where the machine allows it."""

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numba

Function = Callable[..., Any]


@functools.cache
def source_digest() -> str:
    """Digest of all kernel sources.

    Numba's file cache checks only the file that defines a function, not the files that it imports.
    """
    files = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[
        :12
    ]


def jit(function: Function) -> Function:
    """Compile `function` to run without the interpreter lock and cache the machine code on disk.

    The cache files are in NUMBA_CACHE_DIR, next to the source or in the user's cache directory. Their names contain the
    function's qualified name, so the digest in it invalidates them when any kernel source changes. Numba raises
    RuntimeError if none of these directories is writable; the kernels are then compiled in each process.
    """
    function.__qualname__ += f"_{source_digest()}"
    options = {"nogil": True, "error_model": "numpy"}
    try:
        return cast("Function", numba.njit(cache=True, **options)(function))
    except RuntimeError:
        return cast("Function", numba.njit(**options)(function))


def inlined(function: Function) -> Function:
    """Compile `function` as a part of each kernel that calls it."""
    return cast("Function", numba.njit(inline="always")(function))
