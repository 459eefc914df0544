"""Patterns for projectors: float32 (H, W) arrays in [0, 1], where 1 is a fully lit pixel."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera.intrinsics import check_size
from twinlens.errors import InputError, check_int, check_known, check_number

Pattern = NDArray[np.float32]
AXES = ("u", "v")
"""Across the columns, or down the rows."""


def white(width: int, height: int) -> Pattern:
    """All pixels lit."""
    check_size(width, height)
    return np.ones((height, width), dtype=np.float32)


def dots(width: int, height: int, density: float = 0.1, size: int = 1, seed: int = 0) -> Pattern:
    """Pseudo-random square dots of `size` pixels on a grid of that step; `density` is the share of lit cells.

    Exactly round(density * cells) cells are lit, so the pattern's mean does not depend on the seed.
    """
    check_number("the density of dots", density, "a number from 0 to 1", least=0, most=1)
    check_int("the seed of dots", seed, 0)
    rows, columns = _cells(width, height, size)
    cells = np.zeros(rows * columns, dtype=np.float32)
    lit = np.random.default_rng(seed).permutation(len(cells))[: round(density * len(cells))]
    cells[lit] = 1.0
    return _enlarged(cells.reshape(rows, columns), size, width, height)


def dot_grid(width: int, height: int, period: int = 8, size: int = 1) -> Pattern:
    """Square dots of `size` pixels, one in the corner of every `period` x `period` pixels."""
    check_size(width, height)
    check_int("the period of a dot grid in pixels", period, 2)
    check_int("the size of a dot in pixels", size, 1, period - 1)
    lit = [np.arange(count) % period < size for count in (height, width)]
    return np.outer(*lit).astype(np.float32)


def stripes(width: int, height: int, period: int = 16, axis: str = "u") -> Pattern:
    """Stripes of half a `period`, in pixels: the first is lit. They alternate along `axis`."""
    check_int("the period of stripes in pixels", period, 2)
    return along(width, height, axis, lambda position: 2 * (position % period) < period)


def checker(width: int, height: int, size: int = 16) -> Pattern:
    """A checkerboard with squares of `size` pixels: the first is lit."""
    rows, columns = _cells(width, height, size)
    cells = (np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0).astype(np.float32)
    return _enlarged(cells, size, width, height)


PATTERNS: dict[str, Callable[..., Pattern]] = {
    "white": white,
    "dots": dots,
    "dot_grid": dot_grid,
    "stripes": stripes,
    "checker": checker,
}
"""The patterns that have a name: functions of width, height and options."""


def named(name: str, width: int, height: int, **options: Any) -> Pattern:
    """A pattern of `PATTERNS`. Raises InputError for an unknown name or option.

    >>> float(named("dots", 20, 10, density=0.25).mean())
    0.25
    """
    check_known("pattern", name, PATTERNS)
    try:
        return PATTERNS[name](width, height, **options)
    except TypeError as error:
        raise InputError(f"pattern {name!r}: {error}") from error


def along(width: int, height: int, axis: str, value: Callable[[NDArray[np.int64]], Any]) -> Pattern:
    """The pattern that has `value(position)` at each column ("u") or row ("v")."""
    check_size(width, height)
    check_known("axis", axis, AXES)
    values = np.asarray(value(np.arange(width if axis == "u" else height)), dtype=np.float32)
    return np.array(np.broadcast_to(values if axis == "u" else values[:, None], (height, width)))


def _cells(width: int, height: int, size: int) -> tuple[int, int]:
    """Rows and columns of the cells of `size` pixels that cover the pattern."""
    check_size(width, height)
    check_int("the size of a cell in pixels", size, 1, max(width, height))
    return -(-height // size), -(-width // size)


def _enlarged(cells: Pattern, size: int, width: int, height: int) -> Pattern:
    return cells.repeat(size, axis=0).repeat(size, axis=1)[:height, :width].copy()
