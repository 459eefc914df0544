"""How many candidates are tried at a time: a range of disparities shared out to vectors of fixed lengths."""

from collections.abc import Iterator
from dataclasses import dataclass

LANE_COUNTS = (16, 32, 64, 128)  # powers of two: LLVM takes vectors of other lengths apart, number by number
LANE_BITS = 4096
FIXED_BITS = 1024  # what a pixel costs beside its lanes, in bits of lanes
SHARED = 2


@dataclass(frozen=True)
class Pass:
    """n lanes, of which lane 0 holds the candidate `first`, counted from the range's; begin..end may win."""

    first: int
    n: int
    begin: int
    end: int


def _allowed(bits: int) -> list[int]:
    return [n for n in LANE_COUNTS if n * bits <= LANE_BITS]


def _steps(candidates: int, bits: int) -> list[int]:
    """The lanes of each pass, of least cost in all; every pass after the first repeats the last two before it."""
    best: dict[int, tuple[int, list[int]]] = {}

    def cheapest(left: int) -> tuple[int, list[int]]:
        if left not in best:
            choices = []
            for n in _allowed(bits):
                price, rest = cheapest(left - (n - SHARED)) if left > n else (0, [])
                choices.append((price + n * bits + FIXED_BITS, [n, *rest]))
            best[left] = min(choices, key=lambda choice: choice[0])
        return best[left]

    longest = max(_allowed(bits))
    whole = max(0, candidates - 8 * longest) // (longest - SHARED)
    return [longest] * whole + cheapest(candidates - whole * (longest - SHARED))[1]


def winning(candidates: int, bits: int) -> Iterator[Pass]:
    """Passes in search of winners, for costs of so many bits: neighbours share two lanes.

    So each pass sees the neighbours of every cost that may win in it.
    """
    steps, first = _steps(candidates, bits), 0
    for index, n in enumerate(steps):
        yield Pass(first, n, int(index > 0), n - int(index < len(steps) - 1))
        first += n - SHARED


def filling(candidates: int, bits: int) -> Iterator[Pass]:
    """Passes that write every candidate's cost, and as few beyond them as there can be."""
    first = 0
    while first < candidates:
        left = candidates - first
        fits = [n for n in _allowed(bits) if n <= left]
        n = max(fits) if fits else min(LANE_COUNTS)
        yield Pass(first, n, 0, n)
        first += n
