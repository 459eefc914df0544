"""`ArrayMath` of Dr.Jit, so that aperture shapes are sampled by the one formula they have, and tables on film."""

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba


class DrJitMath:
    """See `twinlens.camera.warp.ArrayMath`."""

    sqrt = staticmethod(dr.sqrt)
    sin = staticmethod(dr.sin)
    cos = staticmethod(dr.cos)
    abs = staticmethod(dr.abs)
    floor = staticmethod(dr.floor)
    minimum = staticmethod(dr.minimum)
    where = staticmethod(dr.select)

    def __init__(self) -> None:
        self._tables: dict[int, tuple[Float, Any]] = {}

    def gather(self, table: Float, index: Any) -> Any:
        """``table[index]``; a table goes to the device once."""
        mi = mitsuba()
        if id(table) not in self._tables:
            self._tables[id(table)] = table, mi.Float(np.ascontiguousarray(table, dtype=np.float32))
        return dr.gather(mi.Float, self._tables[id(table)][1], mi.UInt32(index))


class CornerTable:
    """Two numbers given at the (W + 1) x (H + 1) corners of the pixels, bilinear between them."""

    def __init__(self, corners: NDArray[np.float64]) -> None:
        mi = mitsuba()
        self._rows, self._columns = corners.shape[:2]
        self._values = mi.Float(np.ascontiguousarray(corners, dtype=np.float32).ravel())

    def __call__(self, across: Any, down: Any) -> Any:
        """The value (Point2f) at `across`, `down` in pixels from the top left corner of the image."""
        mi = mitsuba()
        column = dr.clip(dr.floor(across), 0, self._columns - 2)
        row = dr.clip(dr.floor(down), 0, self._rows - 2)
        index = mi.UInt32(row) * self._columns + mi.UInt32(column)
        corner = [
            dr.gather(mi.Point2f, self._values, index + step) for step in (0, 1, self._columns, self._columns + 1)
        ]
        right, below = across - column, down - row
        return dr.lerp(dr.lerp(corner[0], corner[1], right), dr.lerp(corner[2], corner[3], right), below)
