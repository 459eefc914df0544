"""The one camera of the JIT modes: a Mitsuba sensor that speaks the camera law and nothing else.

Pixel (u, v) and aperture point a send the ray o = a, d = (x - k ax, y - k ay, 1) in the camera frame of
`twinlens.geometry`. Lens values are opaque to the compiler, so that a sweep of lenses reuses one kernel.
"""

import functools
from typing import Any

import numpy as np

from twinlens.camera import Camera, Lens
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba

NAME = "twinlens_camera"


def camera_sensor(
    camera: Camera, world_from_cam: Float, lens: Lens, film: dict[str, Any], sampler: dict[str, Any]
) -> Any:
    """A Mitsuba sensor for one camera and lens; `film` and `sampler` are Mitsuba plugins."""
    _register()
    sensor = mitsuba().load_dict({"type": NAME, "film": film, "sampler": sampler})
    sensor.aim(camera, world_from_cam, lens)
    return sensor


def corner_directions(camera: Camera) -> Float:
    """(x, y) of the directions (x, y, 1) at the corners of the pixels, (H + 1, W + 1, 2)."""
    rows, columns = np.mgrid[: camera.height + 1, : camera.width + 1]
    return camera.unproject(np.stack([columns, rows], axis=-1) - 0.5)[..., :2]


@functools.cache
def _register() -> None:
    """Define and register the sensor class: its base exists only once a variant is set."""
    import drjit as dr

    from twinlens.rendering.warp import CornerTable, DrJitMath

    mi = mitsuba()

    class TwinlensCamera(mi.Sensor):  # type: ignore[misc, name-defined]
        """See the module."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.m_needs_sample_3 = True
            self.math = DrJitMath()

        def aim(self, camera: Camera, world_from_cam: Float, lens: Lens) -> None:
            """Set everything the rays depend on."""
            opaque = functools.partial(dr.opaque, mi.Float)
            self.size = opaque(camera.width), opaque(camera.height)
            self.principal = opaque(camera.cx), opaque(camera.cy)
            self.focal = opaque(camera.fx), opaque(camera.fy)
            self.undistorted = None if camera.distortion is None else CornerTable(corner_directions(camera))
            self.aperture = lens.aperture
            self.radius = opaque(0.5 * lens.aperture_diameter)
            self.k = opaque(lens.vergence)
            self.x, self.y, self.z, self.origin = (
                mi.Vector3f(*(opaque(world_from_cam[row, column]) for row in range(3))) for column in range(4)
            )

        def looks_along(self, position: Any) -> tuple[Any, Any]:
            """(x, y) of the chief ray through a film position in [0, 1)^2."""
            across, down = position.x * self.size[0], position.y * self.size[1]
            if self.undistorted is not None:
                direction = self.undistorted(across, down)
                return direction.x, direction.y
            u, v = across - 0.5, down - 0.5  # Mitsuba's film counts pixel edges, twinlens pixel centres
            return (u - self.principal[0]) / self.focal[0], (v - self.principal[1]) / self.focal[1]

        def sample_ray(
            self, time: Any, wavelength: Any, position: Any, aperture: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """A ray through a film position in [0, 1)^2 and a uniform aperture sample, and its weight."""
            x, y = self.looks_along(position)
            ax, ay = (self.radius * a for a in self.aperture.sample(aperture.x, aperture.y, self.math))
            direction = (x - self.k * ax) * self.x + (y - self.k * ay) * self.y + self.z
            ray = mi.Ray3f(mi.Point3f(self.origin + ax * self.x + ay * self.y), dr.normalize(direction), time)
            wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), wavelength, active)
            ray.wavelengths = wavelengths
            return ray, weight

        def sample_ray_differential(
            self, time: Any, wavelength: Any, position: Any, aperture: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """The same ray without differentials: no texture here has mipmaps to choose from."""
            ray, weight = self.sample_ray(time, wavelength, position, aperture, active)
            return mi.RayDifferential3f(ray), weight

        def to_string(self) -> str:
            return "TwinlensCamera[]"

    mi.register_sensor(NAME, TwinlensCamera)
