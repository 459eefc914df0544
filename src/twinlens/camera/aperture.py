"""Aperture shapes in the square [-1, 1]^2 around the optical axis; a lens scales them by its radius A/2.

Coordinates are the camera's (x right, y down), seen from behind the lens. Each shape has

- ``transmission(x, y)``: the share of light that passes at a point, 0 to 1; arrays of any shape;
- ``area_fraction``: its open area relative to the full disk of the same diameter, exact;
- ``sample(u1, u2)``: points (x, y) distributed as the transmission, from uniform numbers in [0, 1).

Sampling needs no rejection and is continuous where the shape allows it, so that it preserves stratification. It runs on
any array library: `xp` has its functions.
"""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.settings import Setting, Settings

_LARGEST_MASK_SIDE = 4096  # cells: float32 random numbers distinguish so many


@dataclass(frozen=True)
class ArrayFunctions:
    """Functions of one array library, named as in NumPy except for the last two.

    One formula of an aperture or a lens then runs on NumPy and in the renderer, which `camera` does not import.

    gather : the values ``table[index]`` of a NumPy table, with floating-point indices.
    constant : a number that the library's compiler treats as an input. NumPy has no compiler.
    """

    sqrt: Callable[[Any], Any]
    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    abs: Callable[[Any], Any]
    floor: Callable[[Any], Any]
    minimum: Callable[[Any, Any], Any]
    where: Callable[[Any, Any, Any], Any]
    gather: Callable[[Float, Any], Any]
    constant: Callable[[float], Any]


NUMPY = ArrayFunctions(
    sqrt=np.sqrt,
    sin=np.sin,
    cos=np.cos,
    abs=np.abs,
    floor=np.floor,
    minimum=np.minimum,
    where=np.where,
    gather=lambda table, index: table[np.asarray(index, dtype=np.intp)],
    constant=float,
)


def concentric(u1: Any, u2: Any, xp: ArrayFunctions = NUMPY) -> tuple[Any, Any]:
    """The concentric map of the unit square to the disk: (radius, turn), both in [0, 1]; turn 1 is a full circle.

    Area-preserving and continuous. Source: Shirley and Chiu, A low distortion map between disk and square, 1997.
    """
    a, b = 2.0 * u1 - 1.0, 2.0 * u2 - 1.0
    # In the left and right quarters of the square the radius is |a| and the angle grows with b / a, in the others the
    # reverse. The opposite quarter is half a turn away.
    wide = xp.abs(a) > xp.abs(b)
    signed = xp.where(wide, a, b)
    ratio = xp.where(wide, b, a) / xp.where(signed == 0.0, 1.0, signed)
    turn = xp.where(wide, 0.125 * ratio, 0.25 - 0.125 * ratio)
    turn = xp.where(signed < 0.0, turn + 0.5, turn)
    return xp.abs(signed), xp.where(turn < 0.0, turn + 1.0, turn)


def on_ring(
    u1: Any, u2: Any, inner2: Any, outer2: Any, xp: ArrayFunctions
) -> tuple[Any, Any]:
    """Points (x, y) uniform in the ring between the squared radii `inner2` and `outer2`, by the concentric map."""
    radius, turn = concentric(u1, u2, xp)
    return _from_polar(xp.sqrt(inner2 + (outer2 - inner2) * radius * radius), turn, xp)


def _from_polar(radius: Any, turn: Any, xp: ArrayFunctions) -> tuple[Any, Any]:
    return radius * xp.cos(2 * math.pi * turn), radius * xp.sin(2 * math.pi * turn)


def invert_cdf(
    table: Float, cells: int, start: Any, u: Any, xp: ArrayFunctions
) -> tuple[Any, Any]:
    """The cell of the cumulative distribution ``table[start:start + cells + 1]`` that contains u, and u's place in it.

    A bisection of fixed length, which compilers unroll. A cell of zero probability is never chosen.
    """
    low, high = 0.0 * u, 0.0 * u + cells
    for _ in range(cells.bit_length()):
        middle = xp.floor(0.5 * (low + high))
        right = xp.gather(table, start + middle) <= u
        low = xp.where(right, middle, low)
        high = xp.where(right, high, middle)
    low = xp.minimum(low, cells - 1.0)
    left_edge = xp.gather(table, start + low)
    right_edge = xp.gather(table, start + low + 1.0)
    span = right_edge - left_edge
    return low, xp.minimum((u - left_edge) / xp.where(span > 0.0, span, 1.0), 1.0)


@dataclass(frozen=True)
class Disk:
    """The full circle."""

    name: ClassVar[str] = "disk"
    area_fraction: ClassVar[float] = 1.0

    def transmission(self, x: ArrayLike, y: ArrayLike) -> Float:
        return np.asarray(
            np.square(x, dtype=float) + np.square(y, dtype=float) <= 1.0, np.float64
        )

    def sample(self, u1: Any, u2: Any, xp: ArrayFunctions = NUMPY) -> tuple[Any, Any]:
        return _from_polar(*concentric(u1, u2, xp), xp)


@dataclass(frozen=True)
class Polygon(Settings, noun="polygon aperture"):
    """The opening of diaphragm blades: a regular polygon with its corners on the unit circle.

    Its edges are arcs of ellipses about the axis, ``(a cos t, b sin t), |t| <= beta`` in the frame of each blade, with
    alpha = pi/blades, beta = roundness * alpha, a = cos(alpha)/cos(beta) and b = sin(alpha)/sin(beta). Equal steps of t
    sweep equal areas, so that sampling has a closed form. Raises InputError when a value is out of range.
    """

    name: ClassVar[str] = "polygon"
    blades: Annotated[int, Setting("Number of blades.", least=3, most=1000)]
    rotation_deg: Annotated[
        float,
        Setting(
            "Direction of the first corner, from +x (right) towards +y (down).",
            "degrees",
            least=-1e6,
            most=1e6,
        ),
    ] = 0.0
    roundness: Annotated[
        float, Setting("0 for straight edges, 1 for a circle.", least=0, most=1)
    ] = 0.0

    @property
    def area_fraction(self) -> float:
        """sinc(2 alpha) / sinc(2 beta), with sinc t = sin(t)/t.

        >>> round(Polygon(4).area_fraction * math.pi, 12)
        2.0
        """
        alpha, beta = self._half_angles
        return _sinc(2 * alpha) / _sinc(2 * beta)

    @property
    def _half_angles(self) -> tuple[float, float]:
        alpha = math.pi / self.blades
        return alpha, self.roundness * alpha

    def transmission(self, x: ArrayLike, y: ArrayLike) -> Float:
        alpha, beta = self._half_angles
        # The point in the frame of the blade that it is nearest to, as in `sample`.
        radius = np.hypot(x, y)
        angle = np.arctan2(y, x) - math.radians(self.rotation_deg)
        off_middle = np.mod(angle, 2 * alpha) - alpha
        along = radius * np.cos(off_middle) * math.cos(beta) / math.cos(alpha)
        across = radius * np.sin(off_middle) * math.sin(beta) / math.sin(alpha)
        return np.asarray(along**2 + across**2 <= 1.0, np.float64)

    def sample(self, u1: Any, u2: Any, xp: ArrayFunctions = NUMPY) -> tuple[Any, Any]:
        alpha, beta = self._half_angles
        # A turn covers the blades one after another; within a blade, step is -1 to 1 from corner to corner.
        radius, turn = concentric(u1, u2, xp)
        blade = xp.minimum(xp.floor(turn * self.blades), self.blades - 1.0)
        step = 2.0 * (turn * self.blades - blade) - 1.0
        # The point in the frame of the blade, whose x axis goes through the middle of its edge; then turned in place.
        along = math.cos(alpha) / math.cos(beta) * radius * xp.cos(beta * step)
        edge = step if beta == 0 else xp.sin(beta * step) / math.sin(beta)
        across = math.sin(alpha) * radius * edge
        middle = (2.0 * blade + 1.0) * alpha + math.radians(self.rotation_deg)
        cos, sin = xp.cos(middle), xp.sin(middle)
        return along * cos - across * sin, along * sin + across * cos


@dataclass(frozen=True)
class Annulus(Settings, noun="annulus aperture"):
    """The ring from radius `inner` to 1, as of a mirror lens."""

    name: ClassVar[str] = "annulus"
    inner: Annotated[
        float, Setting("Inner radius over the outer one.", least=0, most=1 - 1e-6)
    ]

    @property
    def area_fraction(self) -> float:
        """1 - inner^2."""
        return 1.0 - self.inner**2

    def transmission(self, x: ArrayLike, y: ArrayLike) -> Float:
        radius2 = np.square(x, dtype=float) + np.square(y, dtype=float)
        return np.asarray((radius2 >= self.inner**2) & (radius2 <= 1.0), np.float64)

    def sample(self, u1: Any, u2: Any, xp: ArrayFunctions = NUMPY) -> tuple[Any, Any]:
        return on_ring(u1, u2, self.inner**2, 1.0, xp)


@dataclass(frozen=True, eq=False)
class MaskAperture:
    """A grey-scale mask: a coded aperture, or any image. Masks with equal cells are equal and hash equal.

    mask : (H, W), transmission of square cells, row 0 at the top (y = -1): float in [0, 1], bool, or uint8/uint16
    scaled from 0..255 and 0..65535. The longer side spans the aperture's diameter, the shorter one is centred.
    Raises InputError for an empty or black mask, NaN, and values outside [0, 1].
    """

    name: ClassVar[str] = "mask"
    mask: Float
    _row_cdf: Float = field(init=False, repr=False)
    _cell_cdf: Float = field(init=False, repr=False)

    def __init__(self, mask: ArrayLike) -> None:
        cells = _checked_mask(mask)
        rows = cells.sum(axis=1)
        row_cdf = np.append(0.0, np.cumsum(rows))
        cell_cdf = np.hstack([np.zeros((len(rows), 1)), np.cumsum(cells, axis=1)])
        cell_cdf /= np.where(rows > 0, cell_cdf[:, -1], 1.0)[:, None]
        for name, table in (
            ("mask", cells),
            ("_row_cdf", row_cdf / row_cdf[-1]),
            ("_cell_cdf", cell_cdf.ravel()),
        ):
            table.setflags(write=False)
            object.__setattr__(self, name, table)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MaskAperture) and np.array_equal(self.mask, other.mask)

    def __hash__(self) -> int:
        return hash((self.mask.shape, self.digest))

    @property
    def digest(self) -> str:
        """SHA-256 of the cells, hexadecimal, which names the mask in a record."""
        return hashlib.sha256(self.mask.tobytes()).hexdigest()

    @property
    def area_fraction(self) -> float:
        """Sum of the transmissions times the area of a cell, over pi; 4/pi for a clear square.

        >>> round(MaskAperture([[1.0]]).area_fraction * math.pi, 12)
        4.0
        """
        return float(self.mask.sum()) * self._cell**2 / math.pi

    @property
    def _cell(self) -> float:
        cells: int = max(self.mask.shape)
        return 2.0 / cells

    def transmission(self, x: ArrayLike, y: ArrayLike) -> Float:
        height, width = self.mask.shape
        column = np.floor(np.asarray(x, dtype=np.float64) / self._cell + 0.5 * width)
        row = np.floor(np.asarray(y, dtype=np.float64) / self._cell + 0.5 * height)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        safe_row = np.where(inside, row, 0).astype(np.intp)
        safe_column = np.where(inside, column, 0).astype(np.intp)
        return np.where(inside, self.mask[safe_row, safe_column], 0.0)

    def sample(self, u1: Any, u2: Any, xp: ArrayFunctions = NUMPY) -> tuple[Any, Any]:
        # A row by the light of the rows, then a cell by that of the row; what is left of u1 and u2 is the place within.
        height, width = self.mask.shape
        row, down = invert_cdf(self._row_cdf, height, 0.0, u2, xp)
        column, right = invert_cdf(self._cell_cdf, width, row * (width + 1.0), u1, xp)
        x = (column + right - 0.5 * width) * self._cell
        y = (row + down - 0.5 * height) * self._cell
        return x, y


Aperture = Disk | Polygon | Annulus | MaskAperture

FULL_DISK = Disk()


def _checked_mask(mask: ArrayLike) -> Float:
    try:
        cells = np.asarray(mask)
    except (TypeError, ValueError) as error:
        raise InputError(
            "aperture mask must be one array (H, W) of numbers, got rows of unequal length"
        ) from error
    if cells.ndim != 2 or not cells.size or max(cells.shape) > _LARGEST_MASK_SIDE:
        allowed = (
            f"a grey-scale image (H, W) of at most {_LARGEST_MASK_SIDE} cells a side"
        )
        raise InputError(f"aperture mask must be {allowed}, got shape {cells.shape}")
    if cells.dtype.kind not in "bufi":
        raise InputError(f"aperture mask must hold numbers, got {cells.dtype}")
    clear = 1.0
    if cells.dtype in (np.uint8, np.uint16):
        clear = float(np.iinfo(cells.dtype).max)
    cells = cells.astype(np.float64) / clear
    if not ((cells >= 0) & (cells <= 1)).all():
        raise InputError(
            "aperture mask must hold transmissions from 0 to 1, got NaN, negative or larger values"
        )
    if not cells.any():
        raise InputError(
            "aperture mask is black: at least one cell must transmit light"
        )
    return np.ascontiguousarray(cells)


def _sinc(t: float) -> float:
    return math.sin(t) / t if t else 1.0
