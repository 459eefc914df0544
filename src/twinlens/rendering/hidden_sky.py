"""An integrator whose camera rays do not see the sky, while everything in the scene is lit by it."""

from typing import Any

from twinlens.rendering.backends import mitsuba

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported


class HiddenSky(mi.SamplingIntegrator):  # type: ignore[misc, name-defined]
    """`inner`, with radiance 0 along the rays that hit nothing.

    Mitsuba's own `hide_emitters` hides lamps as well, and rays pass through them.
    """

    def __init__(self, inner: Any) -> None:
        super().__init__(mi.Properties())
        self.inner = inner

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
    ) -> tuple[Any, ...]:
        """Radiance, whether it is valid, and the further channels of `inner`."""
        radiance, valid, channels = self.inner.sample(
            scene, sampler, ray, medium, active
        )
        hit = scene.ray_intersect_preliminary(
            ray, coherent=True, active=active
        ).is_valid()
        # The albedo, if there are guides, is the first of the channels.
        albedo = [dr.select(hit, channel, 0.0) for channel in channels[:3]]
        return dr.select(hit, radiance, 0.0), valid & hit, [*albedo, *channels[3:]]

    def aov_names(self) -> list[str]:
        return list(self.inner.aov_names())
