"""Checks of options that several matchers share; each raises InputError with the value and what is allowed."""

import numbers
from typing import Any

import numpy as np

from twinlens.errors import InputError


def whole(name: str, value: Any, least: int | None = None) -> int:
    """A whole number, at least `least`."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise InputError(f"{name} is {value!r}; it must be a whole number")
    if least is not None and value < least:
        raise InputError(f"{name} is {value}; it must be at least {least}")
    return int(value)


def check_block_size(name: str, value: Any) -> int:
    """The side of a window centred on a pixel: a positive odd whole number."""
    side = whole(name, value, 1)
    if side % 2 == 0:
        raise InputError(f"{name} is {side}; a window centred on a pixel is odd: use {side - 1} or {side + 1}")
    return side


def amount(name: str, value: Any, *, above: bool = False) -> float:
    """A finite number >= 0, or above 0."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not np.isfinite(float(value)):
        raise InputError(f"{name} is {value!r}; it must be a number")
    if float(value) < 0 or (above and float(value) == 0):
        raise InputError(f"{name} is {value}; it must be {'above 0' if above else '>= 0'}")
    return float(value)
