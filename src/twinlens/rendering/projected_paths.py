"""The integrator of scenes with projectors: Mitsuba's `path`, with the light of every projector at every surface.

Mitsuba samples one light at a surface, chosen at random. The light of a projector from the one direction that it has
is exact, and would only get noise from the choice, as would that of the lamps. It costs one shadow ray more. Needs a
JIT backend.

Importing this module sets up the backend.
"""

from collections.abc import Sequence
from typing import Any

from twinlens.rendering.backends import mitsuba

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

_MOST_SURVIVE = 0.95  # of the paths, in Russian roulette: as in Mitsuba's `path`


class ProjectedPath(mi.SamplingIntegrator):  # type: ignore[misc, name-defined]
    """Paths in a scene and the light of `lamps`, emitters that are not in the scene and that no ray can hit.

    max_depth : surfaces on a path to a light, and 1; -1 is no limit.
    rr_depth : surfaces before Russian roulette.
    """

    def __init__(self, lamps: Sequence[Any], block_size: int, max_depth: int = -1, rr_depth: int = 5) -> None:
        properties = mi.Properties()
        properties["block_size"] = block_size
        super().__init__(properties)
        self.lamps = tuple(lamps)
        self.max_depth = dr.opaque(mi.UInt32, max_depth if max_depth >= 0 else 0xFFFFFFFF)
        self.rr_depth = dr.opaque(mi.UInt32, rr_depth)

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> tuple[Any, ...]:
        """Radiance, True, and no further channels."""

        def step(
            active: Any, sampler: Any, ray: Any, weight: Any, eta: Any, depth: Any, last: Any, sum_: Any
        ) -> tuple[Any, ...]:
            """One surface. `last` is the one before, the density of the ray's direction there, and whether it is delta.

            `weight` and `eta` are those of the path from the camera to this surface, `sum_` is the radiance so far.
            """
            si = scene.ray_intersect(ray, mi.RayFlags.All, depth == 0, active)
            shines = mi.DirectionSample3f(scene, si, last[0])
            pdf = scene.pdf_emitter_direction(last[0], shines, ~last[2])
            sum_ = sum_ + weight * shines.emitter.eval(si) * _mis(last[1], dr.select(last[2], 0.0, pdf))

            active = active & si.is_valid() & (depth + 1 < self.max_depth)
            bsdf, context = si.bsdf(ray), mi.BSDFContext()
            smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            ds, light = scene.sample_emitter_direction(si, sampler.next_2d(), True, smooth)
            wo = si.to_local(ds.d)
            drawn = sampler.next_1d(), sampler.next_2d()
            value, pdf, chosen, factor = bsdf.eval_pdf_sample(context, si, wo, *drawn, active)
            light = light * value * dr.select(ds.delta, 1.0, _mis(ds.pdf, pdf))
            sum_ = sum_ + weight * dr.select(smooth & (ds.pdf != 0), light, 0.0)
            for lamp in self.lamps:
                sum_ = sum_ + weight * _lit(scene, lamp, bsdf, si, sampler.next_2d(), smooth)

            weight, eta, depth = weight * factor, eta * chosen.eta, depth + 1
            active = active & dr.any(weight != 0)
            kept = dr.minimum(dr.max(weight) * dr.square(eta), _MOST_SURVIVE)
            may_end = depth >= self.rr_depth
            active = active & (~may_end | (sampler.next_1d() < kept))
            weight = dr.select(may_end, weight * dr.rcp(kept), weight)
            ray = si.spawn_ray(si.to_world(chosen.wo))
            last = mi.Interaction3f(si), chosen.pdf, mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
            return active, sampler, ray, weight, eta, depth, last, sum_

        first = dr.zeros(mi.Interaction3f), mi.Float(1.0), mi.Bool(True)
        start = mi.Bool(active), sampler, mi.Ray3f(ray), mi.Spectrum(1.0), mi.Float(1.0), mi.UInt32(0), first
        *_, radiance = dr.while_loop((*start, mi.Spectrum(0.0)), lambda active, *_: active, step)
        return radiance, mi.Bool(True), []

    def direct_light(self, scene: Any, sampler: Any, ray: Any) -> Any:
        """The part of `sample` that comes directly from the lamps to the first surface.

        Draws from the sampler as `sample` does, so that the points of a projector's aperture are the same.
        """
        si = scene.ray_intersect(mi.Ray3f(ray), mi.RayFlags.All, True)
        bsdf = si.bsdf()
        smooth = si.is_valid() & (self.max_depth > 1) & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        sampler.next_2d(), sampler.next_1d(), sampler.next_2d()
        return sum((_lit(scene, lamp, bsdf, si, sampler.next_2d(), smooth) for lamp in self.lamps), mi.Spectrum(0.0))

    def to_string(self) -> str:
        return "ProjectedPath[]"


def _mis(own: Any, other: Any) -> Any:
    """The weight of a sample of density `own` that has the density `other` in another technique: power heuristic."""
    return dr.select(own > 0, own * own / (own * own + other * other), 0.0)


def _lit(scene: Any, lamp: Any, bsdf: Any, si: Any, drawn: Any, active: Any) -> Any:
    """The radiance that leaves the surface along its ray by light directly from `lamp`."""
    ds, light = lamp.sample_direction(si, drawn, active)
    seen = active & (dr.max(light) > 0)
    seen &= ~scene.ray_test(si.spawn_ray_to(ds.p), seen)
    return dr.select(seen, light * bsdf.eval(mi.BSDFContext(), si, si.to_local(ds.d), seen), 0.0)
