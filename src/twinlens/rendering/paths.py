"""Our own path integrator: Mitsuba's `path`, with the light of projectors, and with a cache of irradiance.

Mitsuba samples one light at a surface, chosen at random. The light of a projector from the one direction that it has
is exact, and would only get noise from the choice, as would that of the lamps. It costs one shadow ray more.

With an `IrradianceCache`, paths take the light that a matte surface reflects from the cache, from the second surface on
and behind a diffuse reflection. They go on only with what the surface reflects beyond that.

Paths can also give the features that guide the denoiser, which costs 2 to 5 % of their time.

Importing this module sets up the backend.
"""

import math
from collections.abc import Sequence
from typing import Any

from twinlens.rendering.backends import mitsuba
from twinlens.rendering.guides import surface_features
from twinlens.rendering.irradiance_cache import IrradianceCache, mis
from twinlens.rendering.tracing import MAX_SPECULAR, is_null, is_specular

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

_MOST_SURVIVE = 0.95  # of the paths, in Russian roulette: as in Mitsuba's `path`
_LEAST_REST = (
    1e-3  # share of a reflectance that is not worth another ray: rounding errors
)


class Paths(mi.SamplingIntegrator):  # type: ignore[misc, name-defined]
    """Paths in a scene and the light of `lamps`, emitters that are not in the scene and that no ray can hit.

    max_depth : surfaces on a path to a light, and 1; -1 is no limit.
    rr_depth : surfaces before Russian roulette.
    gives_guides : whether there are channels for the features of `rendering.guides.Guides`.
    cache : the irradiance of the scene and of `lamps`. Images with one are biased.
    """

    def __init__(
        self,
        lamps: Sequence[Any],
        max_depth: int = -1,
        rr_depth: int = 5,
        gives_guides: bool = False,
    ) -> None:
        super().__init__(mi.Properties())
        self.lamps = tuple(lamps)
        self.gives_guides = gives_guides
        self.cache: IrradianceCache | None = None
        self.max_depth = dr.opaque(
            mi.UInt32, max_depth if max_depth >= 0 else 0xFFFFFFFF
        )
        self.rr_depth = dr.opaque(mi.UInt32, rr_depth)

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
    ) -> tuple[Any, ...]:
        """Radiance, True, and the features of the guides."""
        first = mi.Point3f(0.0), mi.Float(1.0), mi.Bool(True)
        start = (
            mi.Bool(active),
            sampler,
            (ray.o, ray.d),
            mi.Spectrum(1.0),
            mi.Float(1.0),
            mi.UInt32(0),
            first,
        )
        guides: tuple[Any, ...] = ()
        if self.gives_guides:
            features = (
                mi.Color3f(0.0),
                mi.Vector3f(0.0),
                mi.Float(0.0),
                *[mi.Spectrum(0.0)] * bool(self.lamps),
            )
            guides = mi.Bool(True), *features
        radiance, guides = self.follow(scene, *start, mi.Bool(False), guides)
        if not guides:
            return radiance, mi.Bool(True), []
        _, albedo, normal, is_random, *projected = guides
        channels = [
            *albedo,
            *normal,
            is_random,
            *(channel for light in projected for channel in light),
        ]
        return radiance, mi.Bool(True), channels

    def aov_names(self) -> list[str]:
        """Names of the channels besides the radiance."""
        if not self.gives_guides:
            return []
        colours = ["albedo", "normal", *["projected"] * bool(self.lamps)]
        names = [f"{kind}.{i}" for kind in colours for i in range(3)]
        return [*names[:6], "random", *names[6:]]

    def follow(self, scene: Any, *start: Any) -> tuple[Any, Any]:
        """The radiance and `guides` of paths that `start` as the arguments of `step`, without its last one."""

        def step(
            active: Any,
            sampler: Any,
            line: Any,
            weight: Any,
            eta: Any,
            depth: Any,
            last: Any,
            diffuse: Any,
            guides: Any,
            sum_: Any,
        ) -> tuple[Any, ...]:
            """One surface, on the `line` (origin, direction).

            `last` is the place before, the density of the ray's direction there, and whether it is delta. `weight` and
            `eta` are those of the path from the camera to this surface, `diffuse` says whether a surface on it
            reflected diffusely, and `sum_` is the radiance so far. `guides` are empty, or the features so far after
            whether only mirrors, glass and openings were met. All of these change: Dr.Jit would record the loop a
            second time to leave out those that do not.
            """
            ray, before = mi.Ray3f(*line), dr.zeros(mi.Interaction3f)
            before.p = last[0]
            si = scene.ray_intersect(ray, mi.RayFlags.All, depth == 0, active)
            shines = mi.DirectionSample3f(scene, si, before)
            pdf = scene.pdf_emitter_direction(before, shines, ~last[2])
            sum_ = sum_ + weight * shines.emitter.eval(si) * mis(
                last[1], dr.select(last[2], 0.0, pdf)
            )

            arrives, active = (
                active,
                active & si.is_valid() & (depth + 1 < self.max_depth),
            )
            bsdf, context = si.bsdf(ray), mi.BSDFContext()
            smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            for_light, for_lobe, for_direction = (
                sampler.next_2d(),
                sampler.next_1d(),
                sampler.next_2d(),
            )
            known, matte = mi.Bool(False), mi.Spectrum(0.0)
            if self.cache is not None:
                known = (
                    active & diffuse & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
                )
                known, irradiance = self.cache.look_up(
                    si, ray, for_direction, self.max_depth - 2 - depth, known
                )
                matte = matte_part(bsdf, si, known)
                sum_ = sum_ + weight * matte * irradiance

            ds, light = scene.sample_emitter_direction(si, for_light, False, smooth)
            wo = si.to_local(ds.d)
            value, pdf, chosen, factor = bsdf.eval_pdf_sample(
                context, si, wo, for_lobe, for_direction, active
            )
            light = (
                light
                * (value - matte * shading_cosine(si, wo))
                * dr.select(ds.delta, 1.0, mis(ds.pdf, pdf))
            )
            matters = smooth & (ds.pdf != 0) & dr.any(light != 0)
            matters &= ~scene.ray_test(si.spawn_ray_to(ds.p), matters)
            sum_ = sum_ + weight * dr.select(matters, light, 0.0)
            from_lamps = mi.Spectrum(0.0)
            for lamp in self.lamps:
                from_lamps += lit_by(
                    scene, lamp, bsdf, si, sampler.next_2d(), smooth, matte
                )
            sum_ = sum_ + weight * from_lamps

            is_delta = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
            if guides:
                is_open, albedo, normal, is_random, *projected = guides
                passes = (
                    is_open
                    & active
                    & (depth < MAX_SPECULAR)
                    & (is_specular(bsdf) | is_null(chosen))
                )
                ends = is_open & arrives & ~passes
                found, facing = surface_features(si, bsdf, ends)
                albedo, normal = (
                    albedo + dr.select(ends, weight * found, 0.0),
                    normal + facing,
                )
                is_random = dr.select(passes & (chosen.pdf < 1), 1.0, is_random)
                projected = [
                    light + dr.select(depth == 0, from_lamps, 0.0)
                    for light in projected
                ]
                guides = passes, albedo, normal, is_random, *projected
            survives = mi.Float(1.0)
            if self.cache is not None:
                from_cache = dr.select(
                    known & ~is_delta & (chosen.pdf > 0),
                    shading_cosine(si, chosen.wo) / chosen.pdf,
                    0.0,
                )
                rest = factor - matte * from_cache
                share = dr.minimum(dr.max(dr.abs(rest)) / dr.max(factor), 1.0)
                survives = dr.select(
                    known & ~is_delta, dr.select(share > _LEAST_REST, share, 0.0), 1.0
                )
                factor = rest
            weight, eta, depth = weight * factor, eta * chosen.eta, depth + 1
            active = active & dr.any(weight != 0)
            kept = dr.minimum(dr.max(dr.abs(weight)) * dr.square(eta), _MOST_SURVIVE)
            survives = survives * dr.select(depth >= self.rr_depth, kept, 1.0)
            active = active & (sampler.next_1d() < survives)
            weight = weight * dr.rcp(survives)
            ray = si.spawn_ray(si.to_world(chosen.wo))
            last = mi.Point3f(si.p), chosen.pdf, is_delta
            diffuse = diffuse | mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Diffuse)
            return (
                active,
                sampler,
                (ray.o, ray.d),
                weight,
                eta,
                depth,
                last,
                diffuse,
                guides,
                sum_,
            )

        *_, guides, radiance = dr.while_loop(
            (*start, mi.Spectrum(0.0)), lambda active, *_: active, step
        )
        return radiance, guides

    def direct_light(self, scene: Any, sampler: Any, ray: Any) -> Any:
        """The part of `sample` that comes directly from the lamps to the first surface."""
        si = scene.ray_intersect(mi.Ray3f(ray), mi.RayFlags.All, True)
        bsdf = si.bsdf()
        smooth = (
            si.is_valid()
            & (self.max_depth > 1)
            & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        )
        return sum(
            (
                lit_by(scene, lamp, bsdf, si, sampler.next_2d(), smooth, 0.0)
                for lamp in self.lamps
            ),
            mi.Spectrum(0.0),
        )

    def to_string(self) -> str:
        return "Paths[]"


def matte_part(bsdf: Any, si: Any, active: Any) -> Any:
    """A constant part of the BSDF, from its albedo.

    At most its value in a direction off the mirror's: the albedo of a metal is that of its highlight, and surfaces with
    one side have one behind, where they reflect nothing.
    """
    across = mi.Vector2f(-si.wi.y, si.wi.x)
    length = dr.norm(across)
    across = dr.select(length > 0, across / length, mi.Vector2f(1.0, 0.0))
    cosine = dr.copysign(mi.Float(0.5), mi.Frame3f.cos_theta(si.wi))
    aside = mi.Vector3f(math.sqrt(0.75) * across.x, math.sqrt(0.75) * across.y, cosine)
    least = bsdf.eval(mi.BSDFContext(), si, aside, active) / 0.5
    return dr.select(
        active,
        dr.minimum(bsdf.eval_diffuse_reflectance(si, active) / math.pi, least),
        0.0,
    )


def shading_cosine(si: Any, wo: Any) -> Any:
    """The cosine of the direction `wo` with the shading normal, where light from it is reflected; 0 elsewhere."""
    own, other = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
    return dr.select(own * other > 0, dr.abs(other), 0.0)


def lit_by(
    scene: Any, lamp: Any, bsdf: Any, si: Any, drawn: Any, active: Any, matte: Any
) -> Any:
    """The radiance that leaves the surface along its ray by light directly from `lamp`, without that of `matte`."""
    ds, light = lamp.sample_direction(si, drawn, active)
    seen = active & (dr.max(light) > 0)
    seen &= ~scene.ray_test(si.spawn_ray_to(ds.p), seen)
    wo = si.to_local(ds.d)
    value = bsdf.eval(mi.BSDFContext(), si, wo, seen) - matte * shading_cosine(si, wo)
    return dr.select(seen, light * value, 0.0)
