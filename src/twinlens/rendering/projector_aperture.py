"""The emitter of a projector with an aperture, which is sharp at one distance.

Importing this module sets up the backend.
"""

from typing import Any

from twinlens.rendering.backends import mitsuba

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported


class ApertureProjector(mi.Emitter):  # type: ignore[misc, name-defined]
    """Light from each point a of a disk, as of Mitsuba's projector `lamp` there with its pattern shifted by k a.

    The point (X, Y, Z) then gets the light of the direction (X, Y) / Z + a (k - 1/Z): the rays of a camera in reverse.
    The disk itself is not visible.
    """

    def __init__(self, lamp: Any, diameter: float, vergence: float) -> None:
        super().__init__(mi.Properties())
        self.lamp = lamp
        self.radius, self.k = (
            dr.opaque(mi.Float, 0.5 * diameter),
            dr.opaque(mi.Float, vergence),
        )
        self.m_flags = mi.EmitterFlags.DeltaPosition

    def sample_direction(
        self, it: Any, sample: Any, active: Any = True
    ) -> tuple[Any, Any]:
        """The direction to a uniform point of the disk, and the irradiance for light from there alone."""
        world_from_lamp = self.lamp.world_transform()
        at = self.radius * mi.warp.square_to_uniform_disk_concentric(sample)
        local = world_from_lamp.inverse() @ it.p
        step = self.k * local.z - 1.0
        seen = dr.zeros(mi.Interaction3f, dr.width(it.p))
        seen.wavelengths, seen.time = it.wavelengths, it.time
        seen.p = world_from_lamp @ mi.Point3f(
            local.x + step * at.x, local.y + step * at.y, local.z
        )
        ds, weight = self.lamp.sample_direction(seen, sample, active)
        shifted = ds.d
        ds.p = world_from_lamp @ mi.Point3f(at.x, at.y, 0.0)
        ds.d = ds.p - it.p
        ds.dist = dr.norm(ds.d)
        ds.d /= ds.dist
        ds.emitter = mi.EmitterPtr(self)
        return ds, weight * dr.dot(ds.n, shifted) / dr.dot(
            ds.n, ds.d
        )  # 1 / (Z^2 cos b) of the ray itself

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """0: no other ray finds the disk."""
        return mi.Float(0.0)

    def eval(self, si: Any, active: Any = True) -> Any:
        """0: the disk is not visible."""
        return mi.Spectrum(0.0)

    def bbox(self) -> Any:
        """Empty, as that of Mitsuba's projector."""
        return self.lamp.bbox()

    def to_string(self) -> str:
        return "ApertureProjector[]"
