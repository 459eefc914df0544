"""NumPy arrays whose memory Dr.Jit takes over without one kernel for each of them.

Dr.Jit reads NumPy arrays in place. Its kernels contain whether the memory is aligned, and where each row of a
two-dimensional array begins, so that equal computations would be compiled again for other memory or other lengths.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_ALIGNMENT = 64
"""Bytes, those of the widest registers."""

Value = TypeVar("Value", np.float32, np.int32, np.uint32)


def aligned(values: NDArray[Value]) -> NDArray[Value]:
    """A copy of `values` (N,) at a multiple of 64 bytes."""
    size = values.itemsize
    memory = np.empty(len(values) + _ALIGNMENT // size, dtype=values.dtype)
    start = -memory.ctypes.data % _ALIGNMENT // size
    memory[start : start + len(values)] = values
    return memory[start : start + len(values)]
