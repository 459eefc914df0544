"""The sensor: rays of a camera in Dr.Jit, from a film position and an aperture point.

The direction (x, y, 1) of a pixel and the aperture point a give the ray o = a, d = (x - k ax, y - k ay, 1) in the
camera frame of `twinlens.geometry`, with k the vergence. All values are opaque to the compiler, so that cameras and
lenses share kernels. Importing this module sets up the backend.
"""

import functools
from collections.abc import Iterable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

opaque = functools.partial(dr.opaque, mi.Float)


def sampling_functions() -> SimpleNamespace:
    """As `twinlens.camera.aperture.NUMPY`; `gather` copies each table to the device once."""
    tables: dict[int, tuple[Float, Any]] = {}

    def gather(table: Float, index: Any) -> Any:
        if id(table) not in tables:
            tables[id(table)] = (
                table,
                mi.Float(np.ascontiguousarray(table, dtype=np.float32)),
            )
        return dr.gather(mi.Float, tables[id(table)][1], mi.UInt32(index))

    return SimpleNamespace(
        sqrt=dr.sqrt, sin=dr.sin, cos=dr.cos, abs=dr.abs, floor=dr.floor, minimum=dr.minimum, where=dr.select,
        gather=gather,
    )  # fmt: skip


class CornerTable:
    """Bilinear interpolation of two values given at the (W + 1) x (H + 1) corners of the pixels."""

    def __init__(self, corners: NDArray[np.float64]) -> None:
        self._rows, self._columns = corners.shape[:2]
        self._values = mi.Float(np.ascontiguousarray(corners, dtype=np.float32).ravel())

    def __call__(self, across: Any, down: Any) -> Any:
        """The values (Point2f) at `across`, `down` pixels from the top left corner of the image."""
        column = dr.clip(dr.floor(across), 0, self._columns - 2)
        row = dr.clip(dr.floor(down), 0, self._rows - 2)
        index = mi.UInt32(row) * self._columns + mi.UInt32(column)
        steps = (0, 1, self._columns, self._columns + 1)
        corner = [dr.gather(mi.Point2f, self._values, index + step) for step in steps]
        right, below = across - column, down - row
        return dr.lerp(
            dr.lerp(corner[0], corner[1], right),
            dr.lerp(corner[2], corner[3], right),
            below,
        )


class RayGenerator:
    """Generates the rays of one camera at one pose."""

    def __init__(self, camera: Camera, world_from_cam: Float) -> None:
        self.principal = opaque(camera.cx), opaque(camera.cy)
        self.focal = opaque(camera.fx), opaque(camera.fy)
        self.undistorted = None
        if camera.distortion is not None:
            rows, columns = np.mgrid[: camera.height + 1, : camera.width + 1]
            self.undistorted = CornerTable(
                camera.unproject(np.stack([columns, rows], axis=-1) - 0.5)[..., :2]
            )
        self.x, self.y, self.z, self.origin = (
            mi.Vector3f(*(opaque(world_from_cam[row, column]) for row in range(3)))
            for column in range(4)
        )

    def ray(self, u: Any, v: Any, ax: Any, ay: Any, k: Any) -> tuple[Any, Any]:
        """Origin and unit direction in the world, from pixels (u, v) and metres (ax, ay), at vergence `k` in 1/m."""
        x, y = (
            (u - self.principal[0]) / self.focal[0],
            (v - self.principal[1]) / self.focal[1],
        )
        if self.undistorted is not None:
            x, y = self.undistorted(u + 0.5, v + 0.5)
        direction = (x - k * ax) * self.x + (y - k * ay) * self.y + self.z
        return mi.Point3f(self.origin + ax * self.x + ay * self.y), dr.normalize(
            direction
        )


class TwinlensCamera(mi.Sensor):  # type: ignore[misc, name-defined]
    """A Mitsuba sensor: the rays of a camera at a pose through the aperture of a lens."""

    def __init__(
        self, camera: Camera, world_from_cam: Float, lens: Lens, film: Any, sampler: Any
    ) -> None:
        properties = mi.Properties()
        properties["film"], properties["sampler"] = film, sampler
        super().__init__(properties)
        self.m_needs_sample_3 = True
        self.math = sampling_functions()
        self.size = opaque(camera.width), opaque(camera.height)
        self.rays = RayGenerator(camera, world_from_cam)
        self.aperture = lens.aperture
        self.radius = opaque(0.5 * lens.aperture_diameter)
        self.k = opaque(lens.vergence)

    def sample_ray(
        self,
        time: Any,
        wavelength: Any,
        position: Any,
        aperture: Any,
        active: Any = True,
    ) -> tuple[Any, Any]:
        """A ray through a film position in [0, 1)^2 and a uniform aperture sample, and its weight."""
        # Mitsuba's film counts pixel edges, twinlens pixel centres.
        u, v = position.x * self.size[0] - 0.5, position.y * self.size[1] - 0.5
        ax, ay = (
            self.radius * a
            for a in self.aperture.sample(aperture.x, aperture.y, self.math)
        )
        origin, direction = self.rays.ray(u, v, ax, ay, self.k)
        ray = mi.Ray3f(origin, direction, time)
        wavelengths, weight = self.sample_wavelengths(
            dr.zeros(mi.SurfaceInteraction3f), wavelength, active
        )
        ray.wavelengths = wavelengths
        return ray, weight

    def sample_ray_differential(
        self,
        time: Any,
        wavelength: Any,
        position: Any,
        aperture: Any,
        active: Any = True,
    ) -> tuple[Any, Any]:
        """The same ray without differentials: Mitsuba's textures have no mipmaps."""
        ray, weight = self.sample_ray(time, wavelength, position, aperture, active)
        return mi.RayDifferential3f(ray), weight

    def film_rays(self, count: int, seed: int) -> tuple[Any, Any, Any]:
        """`count` rays per pixel, pixel by pixel, and their points (x, y) of the aperture in units of its radius.

        Numbers the samples, draws from the sampler and rounds film positions as Mitsuba's integrators do.
        """
        width, height = (round(size[0]) for size in self.size)
        sampler = self.sampler()
        sampler.set_samples_per_wavefront(count)
        sampler.seed(seed, width * height * count)
        columns = dr.opaque(mi.UInt32, width)
        pixel = dr.arange(mi.UInt32, width * height * count) // dr.opaque(
            mi.UInt32, count
        )
        row = pixel // columns
        corner = mi.Point2f(mi.Float(pixel - row * columns), mi.Float(row))
        reciprocal = mi.Point2f(
            opaque(1 / np.float32(width)), opaque(1 / np.float32(height))
        )
        film = (corner + sampler.next_2d()) * reciprocal
        lens = sampler.next_2d()
        ray, _ = self.sample_ray(0.0, 0.5, film, lens)
        return ray, *self.aperture.sample(lens.x, lens.y, self.math)

    def to_string(self) -> str:
        return "TwinlensCamera[]"


def pixel_means(
    channels: Iterable[Any],
    count: int,
    camera: Camera,
    shares: Sequence[Any] | None = None,
) -> Float:
    """Means over the `count` rays of each pixel, float64 (H, W, C); (P, H, W, C) of the channels times each share."""
    channels = list(channels)
    dr.eval(channels, shares)  # else each sum would trace the rays again

    def means(share: Any) -> Float:
        sums = [
            np.asarray(dr.block_sum(channel * share, count), dtype=np.float64)
            for channel in channels
        ]
        return np.stack(sums, axis=-1).reshape(camera.height, camera.width, -1) / count

    return (
        means(1.0) if shares is None else np.stack([means(share) for share in shares])
    )
