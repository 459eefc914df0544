"""One camera's inside: how pixels and directions belong together (K and distortion), and the size of its pixels."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from twinlens.camera.distortion import Distortion, check_invertible
from twinlens.errors import InputError, check_number, format_value
from twinlens.geometry import Float, film_from_cam, px_from_film

_LARGEST_SIDE = 65536


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera. A pixel (u, v) looks along (x, y, 1), x = (u - cx)/fx, y = (v - cy)/fy, undistorted.

    Parameters
    ----------
    width, height : int
        Image size in pixels.
    fx, fy : float
        Focal lengths in pixels: the film distance over the pixel pitch, > 0.
    cx, cy : float
        Principal point in pixels, pixel centres at integers; it may lie outside the image.
    distortion : BrownConrady, KannalaBrandt or None
        Of the lens; it must not fold the image over.
    pixel_pitch_um : float
        Width of a pixel in micrometres. Only light and diffraction ask for it; geometry and blur do not.

    Raises InputError when a value is out of range.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion | None = None
    pixel_pitch_um: float = 5.0

    def __post_init__(self) -> None:
        _check_size(self.width, self.height)
        for name, least, most in (("fx", 1e-3, 1e9), ("fy", 1e-3, 1e9), ("pixel_pitch_um", 1e-3, 1e6)):
            check_number(f"camera {name}", getattr(self, name), f"from {least:g} to {most:g}", least=least, most=most)
        for name in ("cx", "cy"):
            allowed = "a number of pixels, at most 1e9 either way"
            check_number(f"camera {name}", getattr(self, name), allowed, least=-1e9, most=1e9)
        if not isinstance(self.distortion, Distortion | None):
            raise InputError(
                f"camera distortion must be BrownConrady, KannalaBrandt or None, got {format_value(self.distortion)}"
            )
        check_invertible(self)

    @classmethod
    def from_fov(cls, width: int, height: int, fov_x_deg: float, pixel_pitch_um: float = 5.0) -> "Camera":
        """A centred camera with square pixels and the given horizontal field of view, edge to edge of the image.

        >>> round(Camera.from_fov(640, 480, fov_x_deg=90).fx, 6)
        320.0
        """
        _check_size(width, height)
        check_number("fov_x_deg", fov_x_deg, "between 0 and 180 degrees", least=1e-6, most=180 - 1e-6)
        fx = 0.5 * width / math.tan(0.5 * math.radians(fov_x_deg))
        return cls(width, height, fx, fx, 0.5 * (width - 1), 0.5 * (height - 1), pixel_pitch_um=pixel_pitch_um)

    @property
    def K(self) -> Float:  # noqa: N802
        """The calibration matrix px_from_cam, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def film_distance(self) -> float:
        """v = fx * pixel pitch, in metres."""
        return self.fx * self.pixel_pitch_um * 1e-6

    @property
    def fov_x_deg(self) -> float:
        """Horizontal field of view between the image's edges, in the row of the principal point, degrees."""
        left, right = np.arctan(self.unproject([(-0.5, self.cy), (self.width - 0.5, self.cy)])[:, 0])
        return math.degrees(right - left)

    def project(self, points_cam: ArrayLike) -> Float:
        """Pixels (..., 2) of camera-frame points (..., 3).

        NaN for points that no pixel sees: z <= 0, or beyond the fold of a distortion.
        """
        xy = film_from_cam(points_cam, 1.0)
        if self.distortion is not None:
            xy = self.distortion.distort(np.where(self.distortion.valid(xy)[..., None], xy, np.nan))
        return px_from_film(xy, (self.fx, self.fy), (self.cx, self.cy))

    def unproject(self, pixels: ArrayLike) -> Float:
        """Directions (..., 3) in the camera frame, z = 1, along which pixels (..., 2) look: times depth, the point.

        Every pixel of the image has one; far outside it a distortion may have none, and x and y are NaN.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        xy = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        if self.distortion is not None:
            xy = self.distortion.undistort(xy)
        return np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)

    def pixel_grid(self) -> Float:
        """The centres (u, v) of all pixels, (H, W, 2)."""
        v, u = np.mgrid[: self.height, : self.width]
        return np.stack([u, v], axis=-1).astype(np.float64)

    def contains(self, pixels: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Whether pixels (..., 2) lie on the image, [-0.5, W-0.5) x [-0.5, H-0.5); NaN does not."""
        u, v = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
        inside: np.ndarray[tuple[int, ...], np.dtype[np.bool_]] = (
            (u >= -0.5) & (u < self.width - 0.5) & (v >= -0.5) & (v < self.height - 0.5)
        )
        return inside

    def replace(self, **changes: object) -> "Camera":
        """A copy with some fields changed, checked again."""
        return replace(self, **changes)  # type: ignore[arg-type]


def _check_size(width: int, height: int) -> None:
    for name, value in (("width", width), ("height", height)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 1 <= value <= _LARGEST_SIDE:
            raise InputError(
                f"camera {name} must be a whole number of pixels from 1 to {_LARGEST_SIDE}, got {format_value(value)}"
            )
