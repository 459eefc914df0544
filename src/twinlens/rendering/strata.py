"""Multi-jittered samples for film positions that are sheared afterwards: stratified within every pixel they end in.

Mitsuba's samplers stratify the samples of one pixel of the film. Sheared for another focus, a pixel collects samples
that started in many pixels, and random orders would leave nothing of the strata. So here sample m of every pixel has
the same stratum in every dimension, and the same place in its pixel and in the aperture: under any shear each
pixel of the image collects sample m of exactly one pixel, and so all strata once. Further dimensions are jittered
within their strata pixel by pixel, so that light and shadow are grainy, not banded.

After Kensler, Correlated Multi-Jittered Sampling, Pixar Technical Memo 13-01, 2013.
"""

import functools
import math
from typing import Any

from twinlens.rendering.backends import mitsuba

_DIMENSION = 0x9E3779B9  # odd: keys of dimensions do not meet
_WITHIN = 0x55555555  # tells the order within strata from the jitter
_ROUNDS = 6


def strata(wanted: int) -> tuple[int, int]:
    """(columns, rows) of a grid of at least `wanted` cells, no more than thrice as wide as high, as few as can be.

    >>> strata(32), strata(11), strata(1)
    ((8, 4), (4, 3), (1, 1))
    """
    rows = range(math.isqrt(wanted), 0, -1)
    grids = [(math.ceil(wanted / r), r) for r in rows if math.ceil(wanted / r) <= 3 * r]
    return min(grids, key=lambda grid: grid[0] * grid[1])


def shared_strata(wanted: int) -> Any:
    """A Mitsuba sampler of at least `wanted` samples a pixel; `sample_count` tells how many."""
    return _sampler_class()(*strata(wanted))


@functools.cache
def _sampler_class() -> Any:
    """Its base exists only once a variant is set."""
    import drjit as dr

    mi = mitsuba()

    class SharedStrata(mi.Sampler):  # type: ignore[misc, name-defined]
        """See the module. The first two pairs drawn are the film position and the aperture point."""

        def __init__(self, columns: int, rows: int) -> None:
            super().__init__(mi.Properties())
            self.columns, self.rows = columns, rows
            self.set_sample_count(columns * rows)

        def seed(self, seed: int, wavefront_size: int) -> None:
            """Start a pass: ray i is sample i % sample_count of pixel i // sample_count."""
            self.ray = dr.arange(mi.UInt32, wavefront_size)
            self.sample = self.ray % self.sample_count()
            self.key = dr.opaque(mi.UInt32, seed)
            self.dimension = dr.opaque(mi.UInt32, 0)

        def next_1d(self, active: Any = True) -> Any:
            key, stratum = self._stratum()
            return (mi.Float(stratum) + _unit(mi.sample_tea_32(self.ray, key, _ROUNDS)[0])) / self.sample_count()

        def next_2d(self, active: Any = True) -> Any:
            return self._pair(self.ray, self.ray // self.sample_count())

        def next_shared_2d(self) -> Any:
            """A pair that is the same for sample m of every pixel."""
            return self._pair(self.sample, dr.zeros(mi.UInt32))

        def _stratum(self) -> tuple[Any, Any]:
            key = self.key + self.dimension * _DIMENSION
            self.dimension += 1
            return key, mi.permute_kensler(self.sample, self.sample_count(), key)

        def _pair(self, jitter: Any, order: Any) -> Any:
            """Rook-like within the strata too: sub-columns follow the rows, sub-rows the columns, both shuffled."""
            key, stratum = self._stratum()
            column, row = stratum % self.columns, stratum // self.columns
            shuffle = mi.sample_tea_32(order, key ^ _WITHIN, _ROUNDS)
            across = mi.permute_kensler(row, self.rows, shuffle[0])
            down = mi.permute_kensler(column, self.columns, shuffle[1])
            jitter = mi.sample_tea_32(jitter, key, _ROUNDS)
            x = (mi.Float(column) + (mi.Float(across) + _unit(jitter[0])) / self.rows) / self.columns
            y = (mi.Float(row) + (mi.Float(down) + _unit(jitter[1])) / self.columns) / self.rows
            return mi.Point2f(x, y)

        def to_string(self) -> str:
            return f"SharedStrata[{self.columns} x {self.rows}]"

    def _unit(bits: Any) -> Any:
        return mi.Float(bits >> 8) * 2.0**-24

    return SharedStrata
