"""The intrinsics of a camera: calibration matrix, distortion, image size and pixel size.

`Camera.rays` and `Camera.project` are all that rendering and ground truth need of a camera. They hold for any field of
view. Ideal coordinates, (x, y) of a direction (x, y, 1), exist only for cameras that see less than 90 degrees from the
axis: `Camera.unproject` has them, and `Camera.is_wide` says where they do not cover the image.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.distortion import (
    PERSPECTIVE,
    Distortion,
    FilmProjection,
    PlaneMap,
    check_invertible,
)
from twinlens.errors import (
    InputError,
    check_int,
    check_number,
    format_value,
    located,
)
from twinlens.geometry import Float, homogeneous, image_border, rigid
from twinlens.optics import fx_from_fov
from twinlens.settings import Setting, Settings

BANDS = ("rgb", "nir", "rgb+nir")
"""What a camera sees: visible light, the near infrared behind a filter, or both, without any filter."""

MAX_SIDE = 65536
"""The largest width or height of an image, pixels."""

_OUTSIDE_PX = -1e4  # value of a map without a source pixel: outside the image for any interpolation kernel


@dataclass(frozen=True)
class Camera(Settings, noun="camera"):
    """Intrinsics of one camera. A pixel (u, v) looks along (x, y, 1), x = (u - cx)/fx, y = (v - cy)/fy, undistorted.

    With a fisheye's distortion it may look 90 degrees and more from the axis: `rays` has its direction.

    The focal length in pixels is the film distance over the pixel pitch. The principal point may be outside the image;
    pixel centres are at integers. Only light and diffraction depend on the pixel pitch; geometry and blur do not.

    Raises InputError when a value is out of range, and for a distortion that folds the image over itself.
    """

    width: Annotated[
        int, Setting("Width of the image.", "pixels", least=1, most=MAX_SIDE)
    ]
    height: Annotated[
        int, Setting("Height of the image.", "pixels", least=1, most=MAX_SIDE)
    ]
    fx: Annotated[
        float, Setting("Horizontal focal length.", "pixels", least=1e-3, most=1e9)
    ]
    fy: Annotated[
        float, Setting("Vertical focal length.", "pixels", least=1e-3, most=1e9)
    ]
    cx: Annotated[
        float, Setting("Column of the principal point.", "pixels", least=-1e9, most=1e9)
    ]
    cy: Annotated[
        float, Setting("Row of the principal point.", "pixels", least=-1e9, most=1e9)
    ]
    distortion: Annotated[Distortion | None, Setting("Distortion of the lens.")] = None
    pixel_pitch_um: Annotated[
        float, Setting("Width of a pixel.", "micrometres", least=1e-3, most=1e6)
    ] = 5.0
    band: Annotated[
        str,
        Setting(
            "Visible light, near infrared, or both; only images depend on it.",
            choices=BANDS,
        ),
    ] = "rgb"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.projection is not PERSPECTIVE:
            check_invertible(self.projection, self.K, self.width, self.height)

    @classmethod
    def from_fov(
        cls, width: int, height: int, fov_x_deg: float, pixel_pitch_um: float = 5.0
    ) -> "Camera":
        """A centred camera with square pixels and the given horizontal field of view, edge to edge of the image.

        >>> round(Camera.from_fov(640, 480, fov_x_deg=90).fx, 6)
        320.0
        """
        check_size(width, height)
        check_number(
            "fov_x_deg",
            fov_x_deg,
            "between 0 and 180 degrees",
            least=1e-6,
            most=180 - 1e-6,
        )
        fx = fx_from_fov(width, fov_x_deg)
        return cls(
            width,
            height,
            fx,
            fx,
            0.5 * (width - 1),
            0.5 * (height - 1),
            pixel_pitch_um=pixel_pitch_um,
        )

    @property
    def K(self) -> Float:  # noqa: N802
        """The calibration matrix px_from_cam, (3, 3)."""
        return np.array(
            [[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]]
        )

    @property
    def bands(self) -> tuple[str, ...]:
        """The bands that it sees, of "rgb" and "nir"."""
        return tuple(self.band.split("+"))

    @property
    def film_distance(self) -> float:
        """v = fx * pixel pitch, in metres."""
        return self.fx * self.pixel_pitch_um * 1e-6

    @property
    def fov_x_deg(self) -> float:
        """Horizontal field of view between the image's edges, in the row of the principal point, degrees."""
        edges = [(-0.5, self.cy), (self.width - 0.5, self.cy)]
        x, _, z = self.rays(edges).T
        left, right = np.arctan2(x, z)
        return math.degrees(right - left)

    @property
    def projection(self) -> FilmProjection:
        """How directions become film points: the distortion, or the perspective without one."""
        return self.distortion or PERSPECTIVE

    @cached_property
    def is_wide(self) -> bool:
        """Whether a pixel looks 90 degrees or more from the axis, where no (x, y, 1) exists."""
        border = image_border(self.width, self.height, margin=0.5)
        return bool((self.rays(border)[..., 2] <= 0).any())

    def project(self, points_cam: ArrayLike) -> Float:
        """Pixels (..., 2) of camera-frame points (..., 3).

        NaN for points without an image: beyond the fold of a distortion, and z <= 0 unless the camera is a fisheye.
        """
        film = self.projection.project(points_cam)
        return np.asarray(film * (self.fx, self.fy) + (self.cx, self.cy))

    def rays(self, pixels: ArrayLike) -> Float:
        """Unit viewing directions (..., 3) of pixels (..., 2), camera frame: times the distance, the point.

        Every pixel of the image has one. Far outside the image a distortion may have none: NaN.

        >>> Camera.from_fov(64, 48, fov_x_deg=90).rays([31.5, 23.5]).tolist()
        [0.0, 0.0, 1.0]
        """
        return self.projection.unproject(self._film(pixels))

    def unproject(self, pixels: ArrayLike) -> Float:
        """Viewing directions (..., 3) of pixels (..., 2), camera frame, with z = 1: times the depth, the point.

        Every pixel of the image has one unless the camera `is_wide`. x and y are NaN where there is none: at 90 degrees
        and more from the axis, and where a distortion has no ray far outside the image.
        """
        return homogeneous(self.projection.undistort(self._film(pixels)))

    def _film(self, pixels: ArrayLike) -> Float:
        """Film points (..., 2), in units of the focal length, of pixels (..., 2)."""
        centred = np.asarray(pixels, dtype=np.float64) - (self.cx, self.cy)
        return np.asarray(centred / (self.fx, self.fy))

    def projection_jacobian(self, points_cam: ArrayLike) -> Float:
        """d(u, v)/d(X, Y, Z), pixels per metre, (..., 2, 3) at camera-frame points (..., 3).

        diag(fx, fy) D [[1, 0, -x], [0, 1, -y]] / Z, with the Jacobian D of the distortion at (x, y).
        Raises InputError for points that are not finite, not in front of the camera, or beyond a distortion's fold.
        """
        points = np.asarray(points_cam, dtype=np.float64)
        if not (np.isfinite(points).all() and (points[..., 2] > 0).all()):
            raise InputError(
                "a projection's derivative needs finite points with z > 0: leave out the others"
            )
        xy, z = points[..., :2] / points[..., 2:], points[..., 2, None, None]
        # d(x, y)/d(X, Y, Z) = [[1, 0, -x], [0, 1, -y]] / Z; the chain rule adds the distortion and the focal lengths.
        inner = np.zeros((*points.shape[:-1], 2, 3))
        inner[..., :2], inner[..., 2] = np.eye(2), -xy
        if not isinstance(self.projection, PlaneMap):
            raise InputError(
                f"a projection's derivative needs a planar projection, got {format_value(self.projection)}"
            )
        if not self.projection.valid(xy).all():
            raise InputError(
                "a projection's derivative needs points before the fold: leave out the others"
            )
        inner = self.projection.jacobian(xy) @ inner
        return np.asarray(np.array([[self.fx], [self.fy]]) * inner / z)

    def pixel_grid(self) -> Float:
        """The centres (u, v) of all pixels, (H, W, 2)."""
        v, u = np.mgrid[: self.height, : self.width]
        return np.stack([u, v], axis=-1).astype(np.float64)

    def contains(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """Whether pixels (..., 2) are in the image, [-0.5, W-0.5) x [-0.5, H-0.5); False for NaN."""
        u, v = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
        return np.asarray(
            (u >= -0.5) & (u < self.width - 0.5) & (v >= -0.5) & (v < self.height - 0.5)
        )


def undistort_maps(
    camera: Camera, to_camera: Camera, to_from_camera: ArrayLike | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(map_x, map_y), float32 (H, W) of `to_camera`: the pixel of `camera` in the same direction, for `cv2.remap`.

    `to_from_camera` (3, 3) rotates directions of `camera` into `to_camera`, as a rectifying rotation; none by default.
    A pixel that `camera` does not see maps to -10000, far outside the image. Raises InputError for arguments that are
    not cameras, and for a matrix that is not a rotation.
    """
    for value in (camera, to_camera):
        if not isinstance(value, Camera):
            raise InputError(
                f"undistort_maps needs two cameras, got {format_value(value)}"
            )
    with located("to_from_camera"):
        pose = rigid(
            np.eye(3) if to_from_camera is None else to_from_camera, np.zeros(3)
        )
    directions = to_camera.rays(to_camera.pixel_grid()) @ pose[:3, :3]
    pixels = np.nan_to_num(camera.project(directions), nan=_OUTSIDE_PX).astype(
        np.float32
    )
    return pixels[..., 0].copy(), pixels[..., 1].copy()


def check_size(width: int, height: int) -> None:
    """Raise InputError unless both are whole numbers of pixels from 1 to `MAX_SIDE`."""
    for name, value in (("width", width), ("height", height)):
        check_int(f"camera {name} in pixels", value, 1, MAX_SIDE)
