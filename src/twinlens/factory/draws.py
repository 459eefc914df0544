"""Distributions: what a value of a recipe may be instead of a number.

    baseline = { uniform = [0.05, 0.2] }                   # any value between the two
    spp = { integers = [16, 64] }                          # any whole number, both ends included
    aperture_mm = { log_uniform = [1, 20] }                # each factor as likely as the next
    tilt = { normal = [0, 2], clip = [-5, 5] }             # mean, deviation; drawn within clip, not piled up at it
    preset = { choice = ["phone", "machine_vision"], weights = [1, 3] }
    focus = { sweep = [1, 2, 4] }                          # in turn: all sweeps together make a full factorial

A `template` is a table in which any leaf may be one of these. Each leaf draws from a stream of its own, named by its
place in the recipe, so that a quantity added to a recipe leaves the others' values as they were.
"""

import difflib
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from twinlens.scenes.table import At, Hint, Table, listed, number, show

_DEEPEST = 12
_MOST_CHOICES = 1000
_LEAST_SHARE = 1e-6  # of a normal distribution that its clip must keep: below, float64 no longer tells its values apart
_LARGEST_WHOLE = 2**53


@dataclass(frozen=True, eq=False)
class Distribution:
    """One quantity's distribution. `place` names it in the recipe; `values` are its ends, or all it may be."""

    kind: str
    place: str
    values: tuple[Any, ...]
    draw: Callable[[np.random.Generator], Any]

    @property
    def is_sweep(self) -> bool:
        """Whether its values come in turn, by the sample's index, and not by chance."""
        return self.kind == "sweep"


def template(at: At, value: Any, depth: int = 0) -> Any:
    """`value` with every table that names a distribution read as one. Raises InputError naming the place."""
    if depth > _DEEPEST:
        raise at.wrong(f"is nested more than {_DEEPEST} deep")
    if isinstance(value, Mapping):
        kinds = [kind for kind in KINDS if kind in value]
        if kinds:
            return KINDS[kinds[0]](at, Table(at, value))
        return {key: template(at / key, entry, depth + 1) for key, entry in value.items()}
    if isinstance(value, list):
        return [template(at / i, entry, depth + 1) for i, entry in enumerate(value)]
    return value


def leaves(tree: Any) -> Iterator[Distribution]:
    """Every distribution in a template, in its order."""
    if isinstance(tree, Distribution):
        yield tree
    elif isinstance(tree, (dict, list)):
        for entry in tree.values() if isinstance(tree, dict) else tree:
            yield from leaves(entry)


def resolve(tree: Any, choose: Callable[[Distribution], Any]) -> Any:
    """The template with `choose`'s answer in place of every distribution."""
    if isinstance(tree, Distribution):
        return choose(tree)
    if isinstance(tree, dict):
        return {key: resolve(entry, choose) for key, entry in tree.items()}
    if isinstance(tree, list):
        return [resolve(entry, choose) for entry in tree]
    return tree


def corners(tree: Any) -> Iterator[Any]:
    """Tables to check a template by: every distribution at its first value, then each in turn at each of the others."""
    yield resolve(tree, lambda leaf: leaf.values[0])
    for one in leaves(tree):
        for value in one.values[1:]:
            yield resolve(tree, lambda leaf, one=one, value=value: value if leaf is one else leaf.values[0])  # type: ignore[misc]


def stream(seed: int, *key: int | str) -> np.random.Generator:
    """Random numbers of one purpose: independent between seeds and keys."""
    words = tuple(zlib.crc32(part.encode()) if isinstance(part, str) else part for part in key)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=words))


def _uniform(at: At, table: Table[Any]) -> Distribution:
    low, high = _range(at / "uniform", table.take("uniform", listed(number(), 2, 2)))
    table.done()
    return Distribution("uniform", at.path, (low, high), lambda rng: low + (high - low) * float(rng.random()))


def _log_uniform(at: At, table: Table[Any]) -> Distribution:
    low, high = _range(at / "log_uniform", table.take("log_uniform", listed(number(above=0.0), 2, 2)))
    table.done()
    logs = np.log([low, high])

    def draw(rng: np.random.Generator) -> float:
        return float(np.clip(np.exp(logs[0] + (logs[1] - logs[0]) * rng.random()), low, high))

    return Distribution("log_uniform", at.path, (low, high), draw)


def _integers(at: At, table: Table[Any]) -> Distribution:
    low, high = _range(at / "integers", table.take("integers", listed(_whole, 2, 2)))
    table.done()
    return Distribution("integers", at.path, (low, high), lambda rng: int(rng.integers(low, high, endpoint=True)))


def _normal(at: At, table: Table[Any]) -> Distribution:
    mean, deviation = table.take("normal", listed(number(), 2, 2))
    if not deviation > 0:
        raise (at / "normal").wrong(f"must be [mean, standard deviation > 0], got {[mean, deviation]}")
    low, high = _range(at / "clip", table.take("clip", listed(number(), 2, 2)))
    table.done()
    below = ndtr((np.array([low, high]) - mean) / deviation)
    if not below[1] - below[0] >= _LEAST_SHARE:
        raise (at / "clip").wrong(f"[{low:g}, {high:g}] leaves nothing of a normal around {mean:g} +- {deviation:g}")

    def draw(rng: np.random.Generator) -> float:
        share = below[0] + (below[1] - below[0]) * rng.random()
        return float(np.clip(mean + deviation * ndtri(share), low, high))

    return Distribution("normal", at.path, (low, high), draw)


def _choice(at: At, table: Table[Any]) -> Distribution:
    values = tuple(table.take("choice", listed(_plain, 1, _MOST_CHOICES)))
    weights = table.take("weights", listed(number(low=0.0), len(values), len(values)), [1.0] * len(values))
    table.done()
    shares = normalised(at / "weights", weights)
    return Distribution("choice", at.path, values, lambda rng: values[int(rng.choice(len(values), p=shares))])


def _sweep(at: At, table: Table[Any]) -> Distribution:
    values = tuple(table.take("sweep", listed(_plain, 1, _MOST_CHOICES)))
    table.done()
    return Distribution("sweep", at.path, values, lambda rng: values[0])


KINDS: dict[str, Callable[[At, Table[Any]], Distribution]] = {
    "uniform": _uniform,
    "log_uniform": _log_uniform,
    "integers": _integers,
    "normal": _normal,
    "choice": _choice,
    "sweep": _sweep,
}
"""Every distribution, by the key that names it."""


_ANY_NUMBER = ("uniform", "log_uniform", "normal")


def hints(tree: Any) -> Hint:
    """What to say more of a value of the wrong kind in a template: which distribution was meant, or does better.

    >>> hints({})("rig.baseline", {"unifrom": [0.1, 0.2]}, float)
    "; did you mean the distribution 'uniform'?"
    """
    kinds = {leaf.place: leaf.kind for leaf in leaves(tree)}

    def hint(place: str, value: Any, kind: type) -> str:
        if isinstance(value, Mapping):
            return _meant(value)
        if kind is int and kinds.get(place) in _ANY_NUMBER:
            return f"; {kinds[place]!r} draws any number, {{ integers = [low, high] }} whole ones"
        return ""

    return hint


def _meant(table: Mapping[str, Any]) -> str:
    near = [found for key in table for found in difflib.get_close_matches(str(key), KINDS, n=1)]
    return f"; did you mean the distribution {near[0]!r}?" if near else f"; distributions are {', '.join(KINDS)}"


def normalised(at: At, weights: list[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Weights as shares that sum to 1. Raises InputError when all are 0."""
    largest = max(weights)
    if not largest > 0:
        raise at.wrong("at least one weight must be > 0")
    shares = np.array(weights) / largest
    return np.asarray(shares / shares.sum())


def _range(at: At, ends: list[Any]) -> tuple[Any, Any]:
    low, high = ends
    if not low <= high or not np.isfinite(high - low):
        raise at.wrong(f"must be [low, high] with low <= high, got {show(ends)}")
    return low, high


def _whole(at: At, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) > _LARGEST_WHOLE:
        raise at.wrong(f"must be a whole number, got {show(value)}")
    return value


def _plain(at: At, value: Any) -> Any:
    """A value to choose: anything but another distribution."""
    if any(True for _ in leaves(template(at, value))):
        raise at.wrong("a distribution within a distribution; write its values out")
    return value
