"""Mitsuba sensors for a camera and a lens: one in Python for the JIT backends, Mitsuba's own for the scalar backend.

In scalar mode a sensor written in Python is about forty times slower. Mitsuba's own sensors support square pixels, disk
apertures, and, by cropping a larger film, principal points at multiples of half a pixel.
"""

import functools
import math
from typing import Any

import numpy as np

from twinlens.camera import Camera, Disk, Lens
from twinlens.errors import BackendError
from twinlens.geometry import Float
from twinlens.rendering.backends import backend, mitsuba

NAME = "twinlens_camera"


def camera_sensor(
    camera: Camera, world_from_cam: Float, lens: Lens, film: dict[str, Any], sampler: dict[str, Any]
) -> Any:
    """A Mitsuba sensor for one camera and lens; `film` and `sampler` are Mitsuba plugins."""
    _register()
    sensor = mitsuba().load_dict({"type": NAME, "film": film, "sampler": sampler})
    sensor.aim(camera, world_from_cam, lens)
    return sensor


@functools.cache
def _register() -> None:
    """Define and register the sensor class, whose base class exists once a variant is set."""
    import drjit as dr

    from twinlens.rendering.ray_generation import DrJitMath, RayGenerator

    mi = mitsuba()

    class TwinlensCamera(mi.Sensor):  # type: ignore[misc, name-defined]
        """The sensor of the JIT backends: rays of a `RayGenerator` through an aperture."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.m_needs_sample_3 = True
            self.math = DrJitMath()

        def aim(self, camera: Camera, world_from_cam: Float, lens: Lens) -> None:
            """Set the camera, its pose and the lens. Lens values are opaque, so that lenses share a kernel."""
            opaque = functools.partial(dr.opaque, mi.Float)
            self.size = opaque(camera.width), opaque(camera.height)
            self.rays = RayGenerator(camera, world_from_cam)
            self.aperture = lens.aperture
            self.radius = opaque(0.5 * lens.aperture_diameter)
            self.k = opaque(lens.vergence)

        def sample_ray(
            self, time: Any, wavelength: Any, position: Any, aperture: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """A ray through a film position in [0, 1)^2 and a uniform aperture sample, and its weight."""
            # Mitsuba's film counts pixel edges, twinlens pixel centres.
            u, v = position.x * self.size[0] - 0.5, position.y * self.size[1] - 0.5
            ax, ay = (self.radius * a for a in self.aperture.sample(aperture.x, aperture.y, self.math))
            origin, direction = self.rays.ray(u, v, ax, ay, self.k)
            ray = mi.Ray3f(origin, direction, time)
            wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), wavelength, active)
            ray.wavelengths = wavelengths
            return ray, weight

        def sample_ray_differential(
            self, time: Any, wavelength: Any, position: Any, aperture: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """The same ray without differentials: Mitsuba's textures have no mipmaps."""
            ray, weight = self.sample_ray(time, wavelength, position, aperture, active)
            return mi.RayDifferential3f(ray), weight

        def to_string(self) -> str:
            return "TwinlensCamera[]"

    mi.register_sensor(NAME, TwinlensCamera)


_NEEDS_JIT = "needs the LLVM or CUDA backend (Debian, Ubuntu: apt install libllvm19)"
_NEAR_CLIP = 1e-3


def builtin_sensor(
    camera: Camera, world_from_cam: Float, lens: Lens, film: dict[str, Any], sampler: dict[str, Any]
) -> Any:
    """Mitsuba's `perspective` or `thinlens`. Raises BackendError for cameras and lenses that need a JIT backend."""
    mi = mitsuba()
    _check_camera(camera)
    _check_lens(lens)
    mitsuba_from_opencv = np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba's x points left, its y up
    full_width, full_height, offset_x, offset_y = _centred_film(camera)
    plugin: dict[str, Any] = {
        "type": "perspective",
        "near_clip": _NEAR_CLIP,
        "far_clip": 1e5,
        "fov": math.degrees(2 * math.atan(0.5 * full_width / camera.fx)),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(world_from_cam @ mitsuba_from_opencv),
        "film": {
            **film,
            "width": full_width,
            "height": full_height,
            "crop_width": camera.width,
            "crop_height": camera.height,
            "crop_offset_x": offset_x,
            "crop_offset_y": offset_y,
        },
        "sampler": sampler,
    }
    if lens.aperture_diameter > 0:
        plugin |= {
            "type": "thinlens",
            "aperture_radius": 0.5 * lens.aperture_diameter,
            "focus_distance": 1.0 / lens.vergence,
        }
    return mi.load_dict(plugin)


def check_lens_supported(lens: Lens) -> None:
    """Raise BackendError if this process's backend does not support the lens."""
    if not backend().is_jit:
        _check_lens(lens)


def _check_camera(camera: Camera) -> None:
    if camera.fx != camera.fy:
        raise BackendError(f"a camera with pixels that are not square (fx={camera.fx}, fy={camera.fy}) {_NEEDS_JIT}")
    if camera.distortion is not None:
        raise BackendError(f"lens distortion {_NEEDS_JIT}")
    if any(2 * c % 1 for c in (camera.cx, camera.cy)):
        raise BackendError(f"a principal point off the half-pixel grid (cx={camera.cx}, cy={camera.cy}) {_NEEDS_JIT}")


def _check_lens(lens: Lens) -> None:
    if lens.aperture_diameter > 0 and not (isinstance(lens.aperture, Disk) and lens.vergence > 1e-5):
        raise BackendError(f"a lens other than a disk aperture focused at a finite distance {_NEEDS_JIT}")


def _centred_film(camera: Camera) -> tuple[int, int, int, int]:
    """(width, height, crop x, crop y) of the smallest film centred on the principal point that holds the image."""
    (left, full_width), (top, full_height) = (
        (max(0, round(size - 1 - 2 * c)), round(max(2 * c + 1, 2 * (size - c) - 1)))
        for size, c in ((camera.width, camera.cx), (camera.height, camera.cy))
    )
    return full_width, full_height, left, top
