"""Area-preserving maps of the unit square, for NumPy and for other array libraries.

The functions use Python's operators and the methods of `ArrayMath`. `NUMPY` implements it; the renderer has another
implementation for its arrays.
"""

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


class ArrayMath(Protocol):
    """Element-wise functions of an array library, as in NumPy; `gather` is ``table[index]``, with float indices."""

    def sqrt(self, x: Any, /) -> Any: ...
    def sin(self, x: Any, /) -> Any: ...
    def cos(self, x: Any, /) -> Any: ...
    def abs(self, x: Any, /) -> Any: ...
    def floor(self, x: Any, /) -> Any: ...
    def minimum(self, a: Any, b: Any, /) -> Any: ...
    def where(self, condition: Any, a: Any, b: Any, /) -> Any: ...
    def gather(self, table: Float, index: Any, /) -> Any: ...


class NumpyMath:
    """`ArrayMath` of NumPy."""

    sqrt = staticmethod(np.sqrt)
    sin = staticmethod(np.sin)
    cos = staticmethod(np.cos)
    abs = staticmethod(np.abs)
    floor = staticmethod(np.floor)
    minimum = staticmethod(np.minimum)
    where = staticmethod(np.where)

    @staticmethod
    def gather(table: Float, index: ArrayLike) -> Float:
        """``table[index]``."""
        taken: Float = table[np.asarray(index, dtype=np.intp)]
        return taken


NUMPY: ArrayMath = NumpyMath()


def concentric(u1: Any, u2: Any, xp: ArrayMath = NUMPY) -> tuple[Any, Any]:
    """The concentric map of the unit square to the disk: (radius, turn), both in [0, 1]; turn 1 is a full circle.

    Area-preserving and continuous. Source: Shirley and Chiu, A low distortion map between disk and square, 1997.
    """
    a, b = 2.0 * u1 - 1.0, 2.0 * u2 - 1.0
    wide = xp.abs(a) > xp.abs(b)
    signed = xp.where(wide, a, b)
    ratio = xp.where(wide, b, a) / xp.where(signed == 0.0, 1.0, signed)
    turn = xp.where(wide, 0.125 * ratio, 0.25 - 0.125 * ratio)
    turn = xp.where(signed < 0.0, turn + 0.5, turn)
    return xp.abs(signed), xp.where(turn < 0.0, turn + 1.0, turn)


def on_ring(u1: Any, u2: Any, inner2: Any, outer2: Any, xp: ArrayMath) -> tuple[Any, Any]:
    """Points (x, y) uniform in the ring between the squared radii `inner2` and `outer2`, by the concentric map.

    >>> [float(c) for c in on_ring(1.0, 0.5, 0.25, 1.0, NUMPY)]
    [1.0, 0.0]
    """
    radius, turn = concentric(u1, u2, xp)
    radius = xp.sqrt(inner2 + (outer2 - inner2) * radius * radius)
    return radius * xp.cos(2 * math.pi * turn), radius * xp.sin(2 * math.pi * turn)


def invert_cdf(table: Float, cells: int, start: Any, u: Any, xp: ArrayMath) -> tuple[Any, Any]:
    """The cell of the cumulative distribution ``table[start:start + cells + 1]`` that contains u, and u's place in it.

    A bisection of fixed length, which compilers unroll. The table rises from 0 to 1; u is in [0, 1). A cell of zero
    probability is never chosen.
    """
    low, high = 0.0 * u, 0.0 * u + cells
    for _ in range(cells.bit_length()):
        middle = xp.floor(0.5 * (low + high))
        right = xp.gather(table, start + middle) <= u
        low = xp.where(right, middle, low)
        high = xp.where(right, high, middle)
    low = xp.minimum(low, cells - 1.0)
    left_edge, right_edge = xp.gather(table, start + low), xp.gather(table, start + low + 1.0)
    span = right_edge - left_edge
    return low, xp.minimum((u - left_edge) / xp.where(span > 0.0, span, 1.0), 1.0)
