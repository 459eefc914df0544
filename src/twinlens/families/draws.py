"""Random draws shared by all families."""

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

T = TypeVar("T")
Rng = np.random.Generator


def one_of(rng: Rng, options: Sequence[T]) -> T:
    """One of the options, all equally likely."""
    return options[int(rng.integers(len(options)))]


def weighted(rng: Rng, options: Sequence[T], weights: Sequence[float]) -> T:
    """One of the options, with a probability proportional to its weight."""
    p = np.array(weights)
    return options[int(rng.choice(len(options), p=p / p.sum()))]


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """A number whose logarithm is uniform between those of `low` and `high`."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))
