"""The one camera of the JIT modes: a Mitsuba sensor that speaks the camera law and nothing else.

The law itself stands in `twinlens.rendering.law`. Lens values are opaque to the compiler, so that a sweep of lenses
reuses one kernel.
"""

import functools
from typing import Any

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


@functools.cache
def _register() -> None:
    """Define and register the sensor class: its base exists only once a variant is set."""
    import drjit as dr

    from twinlens.rendering.law import CameraLaw
    from twinlens.rendering.warp import DrJitMath

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
            self.law = CameraLaw(camera, world_from_cam)
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
            origin, direction = self.law.ray(u, v, ax, ay, self.k)
            ray = mi.Ray3f(origin, direction, time)
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
