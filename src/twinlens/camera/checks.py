"""One test of a number for every dataclass of the room: a value out of range, or no number, is one line."""

import math
from typing import Any

import numpy as np

from twinlens.errors import InputError


def check_number(name: str, value: Any, allowed: str, above: float = -math.inf, least: float = -math.inf) -> None:
    """Raise InputError unless `value` is a finite real number > above and >= least; `allowed` says so in words."""
    is_number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not (is_number and math.isfinite(value) and value > above and value >= least):
        raise InputError(f"{name} must be {allowed}, got {value!r}")
