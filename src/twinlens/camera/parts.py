"""Parts of an aperture, each of which forms an image of its own: dual pixels, quad pixels, light fields, any masks.

Parts are given by masks over the square [-1, 1]^2 around the aperture, in the coordinates of `aperture` (x right, y
down, seen from behind the lens): the share of the light at each point that goes to each part. A part's image is its
contribution to the whole image, so the images of parts whose shares add up to 1 everywhere add up to the whole image.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens import optics
from twinlens.camera.aperture import NUMPY, Aperture, ArrayFunctions
from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import Lens, Paraxial, require_paraxial
from twinlens.camera.truth import Truth
from twinlens.errors import InputError, check_int, check_known, format_value
from twinlens.geometry import Float

_MOST_CELLS = 1 << 20
_POINTS = 1024  # a side, for means over the aperture


class Parts:
    """Base of the ways to divide an aperture; `masks` is float64 (P, H, W), row 0 at the top (y = -1)."""

    masks: Float

    def __len__(self) -> int:
        return len(self.masks)

    def shares(self, x: Any, y: Any, xp: ArrayFunctions = NUMPY) -> list[Any]:
        """The share of each part at points of the square; for NumPy and other libraries as `Aperture.sample`."""
        # The cell of a point in the flattened masks; points on the right and lower edges belong to the last cells.
        height, width = self.masks.shape[1:]
        column = xp.minimum(xp.floor((0.5 * x + 0.5) * width), width - 1.0)
        row = xp.minimum(xp.floor((0.5 * y + 0.5) * height), height - 1.0)
        cell = row * width + column
        cell = xp.where(cell < 0.0, 0.0, cell)
        return [xp.gather(mask.reshape(-1), cell) for mask in self.masks]

    def light(self, aperture: Aperture) -> tuple[Float, Float]:
        """The fraction (P,) of the aperture's light in each part, and the centroids (P, 2) of that light.

        Centroids are in units of the aperture's radius, NaN for a part without light; exact to about 1e-4.
        """
        # Points from evenly spread random numbers stand for equal amounts of light.
        u1, u2 = (np.mgrid[:_POINTS, :_POINTS].reshape(2, -1) + 0.5) / _POINTS
        x, y = aperture.sample(u1, u2)
        shares = np.array(self.shares(x, y))
        total = shares.sum(axis=1)
        with np.errstate(invalid="ignore"):
            centroids = shares @ np.stack([x, y], axis=-1) / total[:, None]
        return total / len(x), centroids


@dataclass(frozen=True)
class Dual(Parts):
    """Two halves, as of a dual-pixel sensor: left and right, or top and bottom with ``axis="y"``."""

    axis: str = "x"

    def __post_init__(self) -> None:
        check_known("Dual: axis", self.axis, ["x", "y"])

    @property
    def masks(self) -> Float:  # type: ignore[override]
        return np.eye(2).reshape((2, 1, 2) if self.axis == "x" else (2, 2, 1))


@dataclass(frozen=True)
class Grid(Parts):
    """The n x n equal squares of the aperture's square, row by row. Squares outside the aperture have no light."""

    n: int

    def __post_init__(self) -> None:
        check_int("Grid: n", self.n, 1, 32)

    @property
    def masks(self) -> Float:  # type: ignore[override]
        return np.eye(self.n**2).reshape(-1, self.n, self.n)


@dataclass(frozen=True)
class Quad(Grid):
    """Four quarters: top left, top right, bottom left, bottom right."""

    n: int = field(default=2, init=False)


@dataclass(frozen=True, eq=False)
class Masks(Parts):
    """Any parts: P masks of equal shape (H, W) that stretch over the aperture's square, with shares from 0 to 1.

    Raises InputError where the shares of a point add up to more than 1.
    """

    masks: Float

    def __init__(self, masks: Sequence[ArrayLike]) -> None:
        try:
            shares = np.array(masks, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(
                "parts must be masks of numbers with equal shapes (H, W)"
            ) from error
        if shares.ndim != 3 or not 0 < shares.size <= _MOST_CELLS:
            raise InputError(
                f"parts must be masks (P, H, W) of at most {_MOST_CELLS} cells, got {shares.shape}"
            )
        if not ((shares >= 0) & (shares.sum(axis=0) <= 1 + 1e-9)).all():
            got = f"shares from {shares.min():g} to {shares.max():g}, sums up to {shares.sum(axis=0).max():g}"
            raise InputError(
                f"parts must have shares from 0 to 1 that add up to 1 at most, got {got}"
            )
        shares.setflags(write=False)
        object.__setattr__(self, "masks", shares)


def aperture_points(
    lens: Paraxial, parts: Parts | None = None, n: int = 24
) -> tuple[Float, Float]:
    """Points (n^2, 2) of the aperture in metres, each with the same area, and the share (P, n^2) of each part in them.

    They are the `ApertureSamples` of depth from defocus. Without parts P is 1 and the shares are 1. n points resolve
    blur up to about n / 2 pixels.

    >>> from twinlens.camera import Dual, ThinLens
    >>> points, shares = aperture_points(ThinLens(0.02, 1.0), Dual())
    >>> points.shape, shares.shape, bool((shares[0] == (points[:, 0] < 0)).all())
    ((576, 2), (2, 576), True)
    """
    require_paraxial(lens, "a division of the aperture into points")
    check_int("n", n, 1)
    if parts is not None:
        check_parts(parts, lens)
    x, y = lens.aperture.sample(*((np.mgrid[:n, :n].reshape(2, -1) + 0.5) / n))
    shares = np.ones((1, n * n)) if parts is None else np.array(parts.shares(x, y))
    return 0.5 * lens.aperture_diameter * np.stack([x, y], axis=-1), shares


def check_parts(parts: Parts, lens: Lens) -> None:
    """Raise InputError unless `parts` are parts of an aperture, and `lens` has one."""
    if not isinstance(parts, Parts):
        raise InputError(
            f"parts must be Dual, Quad, Grid or Masks, got {format_value(parts)}"
        )
    divided = require_paraxial(lens, "an image of the parts of an aperture")
    if divided.aperture_diameter == 0:
        raise InputError("parts need a lens with an aperture; a pinhole has none")


def dual_pixel_disparity(
    truth: Truth | ArrayLike, camera: Camera, lens: Paraxial, axis: str = "x"
) -> NDArray[np.float32]:
    """True disparity of the halves of an aperture, float32 (H, W), pixels; +inf where nothing was hit.

    d = f b (1/z - k) for the depth z along the chief ray of each pixel, with the distance b of the centroids of the
    halves' light, 4/(3 pi) of the diameter of a disk; f is fx for left and right halves, fy for ``axis="y"``. A point
    that the whole lens images at u is at u + d/2 in the left image and at u - d/2 in the right one, if the aperture is
    symmetric. d is positive nearer than the focus, 0 in focus, and b/A of the signed blur circle.

    `truth` is that of the view, or its depth (H, W) in metres, +inf where nothing was hit.

    Raises InputError for a lens without an aperture, one with no light in a half, and depths that are not positive.
    """
    if not isinstance(camera, Camera):
        raise InputError(f"camera must be a Camera, got {format_value(camera)}")
    halves = Dual(axis)
    check_parts(halves, lens)
    depth = np.asarray(truth.depth if isinstance(truth, Truth) else truth)
    column = "xy".index(axis)
    first, second = halves.light(lens.aperture)[1][:, column]
    if not np.isfinite(second - first):
        raise InputError("dual pixels need an aperture with light in both halves")
    width = 0.5 * lens.aperture_diameter * float(second - first)
    disparity = optics.circle_of_confusion_px(
        depth, width, (camera.fx, camera.fy)[column], lens.vergence
    )
    return np.where(np.isposinf(depth), np.inf, disparity).astype(np.float32)
