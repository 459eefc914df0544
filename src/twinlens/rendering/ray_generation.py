"""The sensor of a camera and a lens: rays in Dr.Jit, from a film position and an aperture sample.

A camera maps pixels to undistorted coordinates (x, y), `Lens.rays` maps these to rays in the camera frame, and the pose
maps the rays to the world. All numbers are opaque to the compiler, so that cameras and lenses share kernels. Importing
this module sets up the backend.
"""

import functools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens
from twinlens.camera.aperture import ArrayFunctions
from twinlens.camera.distortion import PERSPECTIVE
from twinlens.camera.lens import Vector, check_lens_on, require_paraxial
from twinlens.camera.parts import Parts
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

opaque = functools.partial(dr.opaque, mi.Float)


def drjit_functions() -> ArrayFunctions:
    """The array functions of Dr.Jit, in float32. `gather` copies each table to the device once."""
    tables: dict[int, tuple[Float, Any]] = {}

    def gather(table: Float, index: Any) -> Any:
        if id(table) not in tables:
            on_device = mi.Float(np.ascontiguousarray(table, dtype=np.float32))
            # The table is kept too: another one could get its id otherwise.
            tables[id(table)] = table, on_device
        return dr.gather(mi.Float, tables[id(table)][1], mi.UInt32(index))

    return ArrayFunctions(
        sqrt=dr.sqrt,
        sin=dr.sin,
        cos=dr.cos,
        abs=dr.abs,
        floor=dr.floor,
        minimum=dr.minimum,
        where=dr.select,
        gather=gather,
        constant=opaque,
    )


class CornerTable:
    """Bilinear interpolation of two or three values given at the (W + 1) x (H + 1) corners of the pixels."""

    def __init__(self, corners: NDArray[np.float64]) -> None:
        self._rows, self._columns, count = corners.shape
        self._type = {2: mi.Point2f, 3: mi.Point3f}[count]
        self._values = mi.Float(np.ascontiguousarray(corners, dtype=np.float32).ravel())

    def __call__(self, across: Any, down: Any) -> Any:
        """The values at `across`, `down` pixels from the top left corner of the image."""
        column = dr.clip(dr.floor(across), 0, self._columns - 2)
        row = dr.clip(dr.floor(down), 0, self._rows - 2)
        index = mi.UInt32(row) * self._columns + mi.UInt32(column)
        steps = (0, 1, self._columns, self._columns + 1)
        corner = [dr.gather(self._type, self._values, index + step) for step in steps]
        right, below = across - column, down - row
        upper = dr.lerp(corner[0], corner[1], right)
        lower = dr.lerp(corner[2], corner[3], right)
        return dr.lerp(upper, lower, below)


class RayGenerator:
    """What a camera at a pose does to rays: pixels to directions, and the camera frame to the world."""

    def __init__(self, camera: Camera, world_from_cam: Float) -> None:
        self.principal = opaque(camera.cx), opaque(camera.cy)
        self.focal = opaque(camera.fx), opaque(camera.fy)
        self.ideal: CornerTable | None = None
        self.bearings: CornerTable | None = None
        rows, columns = np.mgrid[: camera.height + 1, : camera.width + 1]
        corners = np.stack([columns, rows], axis=-1) - 0.5
        if camera.is_wide:
            self.bearings = CornerTable(camera.rays(corners))
        elif camera.projection is not PERSPECTIVE:
            self.ideal = CornerTable(camera.unproject(corners)[..., :2])
        columns_of_pose = world_from_cam[:3].T
        self.x, self.y, self.z, self.origin = (
            mi.Vector3f(*map(opaque, column)) for column in columns_of_pose
        )

    def coordinates(self, u: Any, v: Any) -> tuple[Any, Any]:
        """Ideal coordinates (x, y) of pixels (u, v), of a camera that is not wide."""
        if self.ideal is not None:
            x, y = self.ideal(u + 0.5, v + 0.5)
            return x, y
        x = (u - self.principal[0]) / self.focal[0]
        y = (v - self.principal[1]) / self.focal[1]
        return x, y

    def in_world(self, origin: Vector, direction: Vector) -> tuple[Any, Any]:
        """Origin (Point3f) and unit direction (Vector3f) in the world of rays in the camera frame."""
        x, y, z = origin
        moved = self.origin + x * self.x + y * self.y + z * self.z
        x, y, z = direction
        turned = x * self.x + y * self.y + z * self.z
        return mi.Point3f(moved), dr.normalize(turned)


class TwinlensCamera(mi.Sensor):  # type: ignore[misc, name-defined]
    """A Mitsuba sensor: the rays of a camera at a pose through a lens."""

    def __init__(
        self, camera: Camera, world_from_cam: Float, lens: Lens, film: Any, sampler: Any
    ) -> None:
        properties = mi.Properties()
        properties["film"], properties["sampler"] = film, sampler
        super().__init__(properties)
        self.m_needs_sample_3 = True
        self.math = drjit_functions()
        self.size = opaque(camera.width), opaque(camera.height)
        check_lens_on(camera, lens)
        self.rays = RayGenerator(camera, world_from_cam)
        self.lens = lens

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
        origin, direction, passed = self._ray_in_camera(u, v, aperture)
        ray = mi.Ray3f(*self.rays.in_world(origin, direction), time)
        wavelengths, weight = self.sample_wavelengths(
            dr.zeros(mi.SurfaceInteraction3f), wavelength, active
        )
        ray.wavelengths = wavelengths
        return ray, weight * passed

    def _ray_in_camera(
        self, u: Any, v: Any, aperture: Any
    ) -> tuple[Vector, Vector, Any]:
        """Origin, direction and weight of the ray from a pixel position through an aperture sample."""
        if self.rays.bearings is not None:  # no ideal coordinates, and a pinhole
            x, y, z = self.rays.bearings(u + 0.5, v + 0.5)
            return (0.0, 0.0, 0.0), (x, y, z), 1.0
        x, y = self.rays.coordinates(u, v)
        return self.lens.rays(x, y, aperture.x, aperture.y, self.math)

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

    def film_rays(self, count: int, seed: int) -> tuple[Any, Any]:
        """`count` rays per pixel, pixel by pixel, and their aperture samples (Point2f).

        Numbers the samples, draws from the sampler and rounds film positions as Mitsuba's integrators do.
        """
        width, height = (round(size[0]) for size in self.size)
        sampler = self.sampler()
        sampler.set_samples_per_wavefront(count)
        sampler.seed(seed, width * height * count)
        columns = dr.opaque(mi.UInt32, width)
        ray_number = dr.arange(mi.UInt32, width * height * count)
        pixel = ray_number // dr.opaque(mi.UInt32, count)
        row = pixel // columns
        corner = mi.Point2f(mi.Float(pixel - row * columns), mi.Float(row))
        reciprocal = mi.Point2f(
            opaque(1 / np.float32(width)), opaque(1 / np.float32(height))
        )
        film = (corner + sampler.next_2d()) * reciprocal
        aperture = sampler.next_2d()
        ray, _ = self.sample_ray(0.0, 0.5, film, aperture)
        return ray, aperture

    def shares(self, parts: Parts, aperture: Any) -> list[Any]:
        """The share of each part of the aperture in the rays of aperture samples. The lens must be paraxial."""
        lens = require_paraxial(self.lens, "an image of the parts of an aperture")
        x, y = lens.aperture.sample(aperture.x, aperture.y, self.math)
        return parts.shares(x, y, self.math)

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

    if shares is None:
        return means(1.0)
    return np.stack([means(share) for share in shares])
