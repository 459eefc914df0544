"""An integrator whose camera rays do not see the sky, while everything in the scene is lit by it.

Our own `rendering.paths` hides the sky itself. This is for the integrators of Mitsuba, and for Mitsuba files.
"""

from typing import Any

from twinlens.rendering.backends import mitsuba
from twinlens.rendering.cut_outs import CutOuts
from twinlens.rendering.tracing import behind_cut_outs

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported


class HiddenSky(mi.SamplingIntegrator):  # type: ignore[misc, name-defined]
    """`inner`, with radiance 0 along the rays that hit nothing, as ground truth: behind cut-outs, too.

    Mitsuba's own `hide_emitters` hides lamps as well, and rays pass through them.
    """

    def __init__(self, inner: Any, openings: CutOuts | None) -> None:
        super().__init__(mi.Properties())
        self.inner = inner
        self.openings = openings

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
    ) -> tuple[Any, ...]:
        """Radiance, whether it is valid, and the further channels of `inner`."""
        radiance, valid, channels = self.inner.sample(
            scene, sampler, ray, medium, active
        )
        hit = self._hits(scene, ray, active)
        return dr.select(hit, radiance, 0.0), valid & hit, channels

    def _hits(self, scene: Any, ray: Any, active: Any) -> Any:
        if self.openings is not None:
            end = behind_cut_outs(scene, mi.Ray3f(ray), self.openings)
            return end.shape != dr.zeros(mi.ShapePtr)
        nearest = scene.ray_intersect_preliminary(ray, coherent=True, active=active)
        return nearest.is_valid()

    def aov_names(self) -> list[str]:
        return list(self.inner.aov_names())
