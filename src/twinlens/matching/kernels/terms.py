"""What a pixel adds to its window's sum, and what score the sum becomes: the measures, in lanes."""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from twinlens.matching.kernels.lanes import convert, distance, larger, load, ones, splat


def term(kind: str, a: Any, b: Any, like: Any) -> Any:
    """The pixel term of a measure, in the dtype of `like`: what the window's box sum adds up."""


@overload(term, prefer_literal=True, inline="always", strict=False)
def _term(kind: Any, a: Any, b: Any, like: Any) -> Any:
    if not isinstance(kind, types.StringLiteral):
        return None
    return {
        "absolute": lambda kind, a, b, like: convert(distance(a, b), like),
        "square": lambda kind, a, b, like: convert(distance(a, b), like) * convert(distance(a, b), like),
        "product": lambda kind, a, b, like: convert(a, like) * convert(b, like),
        "hamming": lambda kind, a, b, like: convert(ones(a ^ b), like),
    }.get(kind.literal_value, lambda kind, a, b, like: like)


def score(
    kind: str, window: Any, area: Any, total: Any, scale: Any, totals: Any, scales: Any, at: int, like: Any
) -> Any:
    """A measure, lower is better, from the window's sum and the two windows' own statistics.

    `total` and `scale` are the left window's, `totals` and `scales` the right ones', reversed, read from `at` on; the
    scales are in the dtype of `like`.
    """


@overload(score, prefer_literal=True, inline="always", strict=False)
def _score(
    kind: Any, window: Any, area: Any, total: Any, scale: Any, totals: Any, scales: Any, at: Any, like: Any
) -> Any:
    if not isinstance(kind, types.StringLiteral):
        return None
    n = window.n

    def plain(kind, window, area, total, scale, totals, scales, at, like):
        return window

    def zncc(kind, window, area, total, scale, totals, scales, at, like):
        covariance = splat(total, window) * load(totals, at, n) - convert(splat(area, window), window) * window
        return convert(covariance, like) * (load(scales, at, n) * splat(scale, like))

    def zncc_of_right(kind, window, area, total, scale, totals, scales, at, like):
        # The left window's scale is the same for all candidates: whole numbers choose the same winner without it.
        covariance = splat(total, window) * load(totals, at, n) - convert(splat(area, window), window) * window
        return convert(covariance, like) * load(scales, at, n)

    def ncc(kind, window, area, total, scale, totals, scales, at, like):
        return convert(window, like) * (load(scales, at, n) * splat(-scale, like))

    def zssd(kind, window, area, total, scale, totals, scales, at, like):
        offset = splat(total, window) - load(totals, at, n)
        return convert(splat(area, window), window) * window - offset * offset

    def jaccard(kind, window, area, total, scale, totals, scales, at, like):
        sad = convert(window, like)
        union = splat(scale, like) + load(scales, at, n) + sad
        return (sad + sad) / larger(union, splat(tiny(like), like))

    scorings = zncc, zncc_of_right, ncc, zssd, jaccard
    return {"sum": plain, **{function.__name__: function for function in scorings}}[kind.literal_value]


def tiny(like: Any) -> Any:
    """The smallest normal number of the lanes' dtype: what a denominator of zero becomes."""


@overload(tiny, inline="always", strict=False)
def _tiny(like: Any) -> Any:
    smallest = np.finfo(str(like.dtype)).tiny
    return lambda like: smallest
