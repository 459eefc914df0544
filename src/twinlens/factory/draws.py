"""Distributions: what a value of a recipe may be instead of a constant; docs/recipes.md shows each kind.

A template is a table in which any leaf may be one of these. Each leaf draws from its own random stream, named by its
key path, so that adding a distribution to a recipe does not change the values of the others.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator
from scipy.special import ndtr, ndtri

from twinlens.errors import InputError, format_value, nearest
from twinlens.schema import (
    NonNegative,
    Number,
    Positive,
    StrictModel,
    dotted,
    exactly,
    read,
    satisfies,
)

_DEEPEST = 12
_LEAST_SHARE = 1e-6  # of a normal distribution within its clip; below, float64 does not resolve its values


_ORDERED = satisfies(
    lambda ends: ends[0] <= ends[1] and np.isfinite(ends[1] - ends[0]),
    "must be [low, high] with low <= high, got {}",
)
_CONSTANT = satisfies(
    lambda values: not leaves(template(values, "")),
    "the values of a distribution must be constants, not distributions",
)
Whole = Annotated[int, Field(ge=-(2**53), le=2**53)]
Values = Annotated[list[Any], Field(min_length=1, max_length=1000), _CONSTANT]


class Distribution(StrictModel):
    """A random value; the first key of its table names the kind."""

    @property
    def kind(self) -> str:
        """The key of `KINDS`."""
        return next(iter(type(self).model_fields))

    @property
    def values(self) -> list[Any]:
        """The ends of the range, or all values."""
        return list(getattr(self, self.kind))

    def draw(self, rng: np.random.Generator) -> Any:
        """One value. `plan` chooses those of a sweep and of a list per scene."""
        return self.values[0]


class Uniform(Distribution):
    """Any number between two."""

    uniform: Annotated[list[Number], exactly(2, Number), _ORDERED]

    def draw(self, rng: np.random.Generator) -> Any:
        low, high = self.uniform
        return low + (high - low) * float(rng.random())


class LogUniform(Distribution):
    """Any number between two positive ones, uniform in the logarithm."""

    log_uniform: Annotated[list[Positive], exactly(2, Positive), _ORDERED]

    def draw(self, rng: np.random.Generator) -> Any:
        low, high = np.log(self.log_uniform)
        return float(
            np.clip(
                np.exp(low + (high - low) * rng.random()),
                self.values[0],
                self.values[1],
            )
        )


class Integers(Distribution):
    """Any whole number between two, both included."""

    integers: Annotated[list[Whole], exactly(2, Whole), _ORDERED]

    def draw(self, rng: np.random.Generator) -> Any:
        return int(rng.integers(self.integers[0], self.integers[1], endpoint=True))


class Normal(Distribution):
    """Mean and standard deviation of a normal distribution, truncated to a range."""

    normal: Annotated[list[Number], exactly(2, Number)]
    clip: Annotated[list[Number], exactly(2, Number), _ORDERED]

    @model_validator(mode="after")
    def _check(self) -> "Normal":
        mean, deviation = self.normal
        if not deviation > 0:
            raise InputError(
                f"normal must be [mean, standard deviation > 0], got {self.normal}"
            )
        below = self._shares()
        if not below[1] - below[0] >= _LEAST_SHARE:
            raise InputError(
                f"clip {self.clip} excludes nearly all of a normal around {mean:g} +- {deviation:g}"
            )
        return self

    @property
    def values(self) -> list[Any]:
        return self.clip

    def draw(self, rng: np.random.Generator) -> Any:
        below, (mean, deviation) = self._shares(), self.normal
        share = below[0] + (below[1] - below[0]) * rng.random()
        return float(
            np.clip(mean + deviation * ndtri(share), self.clip[0], self.clip[1])
        )

    def _shares(self) -> Any:
        """The distribution function at the ends of `clip`, (2,)."""
        mean, deviation = self.normal
        return ndtr((np.array(self.clip) - mean) / deviation)


class Choice(Distribution):
    """One of several values, equally often or by weights."""

    choice: Values
    weights: list[NonNegative] | None = None

    @model_validator(mode="after")
    def _check(self) -> "Choice":
        if self.weights is not None:
            normalized(self.weights, len(self.choice))
        return self

    def draw(self, rng: np.random.Generator) -> Any:
        count = len(self.choice)
        return self.choice[
            int(rng.choice(count, p=normalized(self.weights or [1.0] * count, count)))
        ]


class Sweep(Distribution):
    """One value after the other, by the index of the sample."""

    sweep: Values


class PerScene(Distribution):
    """One value for each scene or family of the recipe, in their order."""

    per_scene: Values


KINDS: dict[str, type[Distribution]] = {
    next(iter(kind.model_fields)): kind
    for kind in (Uniform, LogUniform, Integers, Normal, Choice, Sweep, PerScene)
}
"""Every distribution, by the key that names it."""


@dataclass(frozen=True, eq=False)
class Leaf:
    """A distribution in a template; `key` is its path there."""

    key: str
    distribution: Distribution

    @property
    def kind(self) -> str:
        """The key of `KINDS`."""
        return self.distribution.kind


def template(value: Any, file: str | Path, key: str = "", depth: int = 0) -> Any:
    """`value` with each table that names a distribution replaced by a `Leaf`. Raises InputError naming file and key."""
    if depth > _DEEPEST:
        raise InputError(f"{file}: {key}: is nested more than {_DEEPEST} deep")
    if isinstance(value, Mapping):
        kind = next((kind for kind in KINDS if kind in value), None)
        if kind is not None:
            return Leaf(key, read(KINDS[kind], value, file, key))
        return {
            name: template(entry, file, dotted((name,), key), depth + 1)
            for name, entry in value.items()
        }
    if isinstance(value, list):
        return [
            template(entry, file, dotted((i,), key), depth + 1)
            for i, entry in enumerate(value)
        ]
    return value


def leaves(tree: Any) -> list[Leaf]:
    """Every distribution in a template, in order."""
    collected: list[Leaf] = []
    resolve(tree, collected.append)
    return collected


def resolve(tree: Any, choose: Callable[[Leaf], Any]) -> Any:
    """The template with `choose(leaf)` in place of every distribution."""
    if isinstance(tree, Leaf):
        return choose(tree)
    if isinstance(tree, dict):
        return {key: resolve(entry, choose) for key, entry in tree.items()}
    if isinstance(tree, list):
        return [resolve(entry, choose) for entry in tree]
    return tree


def corners(tree: Any) -> Iterator[Any]:
    """Tables to check a template with.

    The first has the first value of every distribution. Each of the others has another value of one distribution.
    """
    yield resolve(tree, lambda leaf: leaf.distribution.values[0])
    for varied in leaves(tree):
        for value in varied.distribution.values[1:]:
            chosen = {varied.key: value}

            def choose(leaf: Any, chosen: dict[Any, Any] = chosen) -> Any:
                return chosen.get(leaf.key, leaf.distribution.values[0])

            yield resolve(tree, choose)


def hint(message: str, tree: Any) -> str:
    """What to add to the error message of a template's value: the distribution that was meant, or a better one.

    >>> hint("baseline: must be a number, got {'unifrom': [0.1, 0.2]}", {})
    "; did you mean the distribution 'uniform'?"
    """
    key, _, problem = message.partition(": ")
    if table := re.search(r"must be .*, got \{(.*)", problem):
        for word in re.findall(r"'(\w+)':", table[1]):
            if meant := nearest(word, KINDS):
                return f"; did you mean the distribution {meant!r}?"
        return f"; distributions are {', '.join(KINDS)}"
    kinds = {leaf.key: leaf.kind for leaf in leaves(tree)}
    if "must be a whole number" in problem and kinds.get(key) in (
        "uniform",
        "log_uniform",
        "normal",
    ):
        return f"; {kinds[key]!r} draws any number, use {{ integers = [low, high] }}"
    return ""


def normalized(
    weights: list[float], count: int
) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """`count` weights divided by their sum. Raises InputError for another number of weights, or if all are 0."""
    if len(weights) != count:
        raise InputError(
            f"weights: must have length {count}, got {format_value(weights)}"
        )
    largest = max(weights)
    if not largest > 0:
        raise InputError(
            f"weights: at least one must be > 0, got {format_value(weights)}"
        )
    shares = np.array(weights) / largest
    return np.asarray(shares / shares.sum())
