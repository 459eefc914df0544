"""The path integrator of scene files: as Mitsuba's `path`, with the light of projectors and a cache of irradiance.

At each surface of a path, light that arrives from an emitter directly is found in two ways: by a point drawn on an
emitter, and by the direction in which the path goes on. Multiple importance sampling weights the two (Veach, Robust
Monte Carlo Methods for Light Transport Simulation, 1997, chapter 9), as in Mitsuba's `path`.

Mitsuba draws one emitter at random. A projector lights a point from one direction only: its light is computed without
noise, at the cost of one shadow ray. To draw it among the emitters would add noise to its light and to theirs.

With an `IrradianceCache`, a path takes the light that a matte surface reflects from the cache, from its second surface
on and behind a diffuse reflection. It goes on with what the surface reflects beyond that.

Paths can also give the features that guide the denoiser, which costs 2 to 5 % of their time.

Importing this module sets up the backend.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from twinlens.rendering.backends import mitsuba
from twinlens.rendering.cut_outs import CutOuts, arriving, seen_along
from twinlens.rendering.guides import surface_features
from twinlens.rendering.irradiance_cache import IrradianceCache, from_emitter, mis
from twinlens.rendering.tracing import (
    MAX_SPECULAR,
    is_null,
    is_specular,
)

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

_MOST_SURVIVE = 0.95  # of the paths, in Russian roulette: as in Mitsuba's `path`
_WHOLE_WEIGHT = 0.25  # of a path that is as likely to survive; a heavier path's end would be seen as noise
_LEAST_REST = 1e-3  # share of a reflectance not worth another ray: rounding errors


@dataclass
class Features:
    """What the image's own samples add to `rendering.guides.Guides`, so far on their paths.

    is_open : whether a path has met mirrors, glass and openings only, and its features are not complete.
    albedo, normal : of the first rough surface.
    is_random : 1 where the path chose between ways at random before it, else 0.
    projected : the radiance of the lamps at the first surface, in a tuple; empty without lamps.
    """

    is_open: Any
    albedo: Any
    normal: Any
    is_random: Any
    projected: tuple[Any, ...]


@dataclass
class PathState:
    """Paths on the way to their next surface: the state of Dr.Jit's loop.

    active : whether the path goes on.
    origin, direction : its ray, in the world.
    weight : of the radiance along the ray, in that of the whole path.
    eta : the relative index of refraction of the ray's medium, of all refractions so far.
    depth : surfaces on the path so far.
    previous_point, previous_pdf, previous_is_delta : where the ray starts, the density of its direction there per
        solid angle, and whether that direction had no alternative. They weight emitters that the ray hits.
    was_diffuse : whether a surface on the path reflected diffusely.
    features : an empty tuple if they are not wanted.
    radiance : of the path so far.

    Dr.Jit records a loop a second time to leave out variables that do not change; all of these do.
    """

    active: Any
    sampler: Any
    origin: Any
    direction: Any
    weight: Any
    eta: Any
    depth: Any
    previous_point: Any
    previous_pdf: Any
    previous_is_delta: Any
    was_diffuse: Any
    features: Features | tuple[()]
    radiance: Any


class _Numbers(NamedTuple):
    """Random numbers of a surface: a point on an emitter, a lobe of the BSDF, a direction in it."""

    for_light: Any
    for_lobe: Any
    for_direction: Any

    @classmethod
    def drawn(cls, sampler: Any) -> "_Numbers":
        """The next numbers of a sampler."""
        return cls(sampler.next_2d(), sampler.next_1d(), sampler.next_2d())


class _Surface(NamedTuple):
    """The surfaces that paths meet.

    si, bsdf : the interaction and the BSDF there.
    scatters : paths that go on from there in a direction of the BSDF.
    is_card : paths that may pass a cut-out. Behind the last surface of a path, light still comes through cut-outs.
    smooth : paths that scatter where the BSDF has more than Dirac deltas, so that light of a point is reflected.
    """

    si: Any
    bsdf: Any
    scatters: Any
    is_card: Any
    smooth: Any

    @property
    def active(self) -> Any:
        """Paths that may go on."""
        return self.scatters | self.is_card


class _Matte(NamedTuple):
    """What the cache has: whether it has the surface, the matte part of its BSDF (1/sr), and the irradiance."""

    is_cached: Any
    part: Any
    irradiance: Any


class Paths(mi.SamplingIntegrator):  # type: ignore[misc, name-defined]
    """Paths in a scene and the light of `lamps`, emitters that are not in the scene and that no ray can hit.

    max_depth : surfaces on a path to a light, and 1; -1 is no limit.
    rr_depth : surfaces before Russian roulette.
    gives_guides : whether there are channels for the features of `rendering.guides.Guides`.
    openings : the cut-outs of the scene. They are no surfaces of a path, and light passes them.
    shows_sky : whether a camera sees the sky straight on and through cut-outs; else it is black there.
    cache : the irradiance of the scene and of `lamps`. Images with one are biased.
    """

    def __init__(
        self,
        lamps: Sequence[Any],
        max_depth: int = -1,
        rr_depth: int = 3,
        gives_guides: bool = False,
        openings: CutOuts | None = None,
        shows_sky: bool = True,
    ) -> None:
        super().__init__(mi.Properties())
        self.lamps = tuple(lamps)
        self.gives_guides = gives_guides
        self.openings = openings
        self.shows_sky = shows_sky
        self.cache: IrradianceCache | None = None
        self.max_depth = dr.opaque(
            mi.UInt32, max_depth if max_depth >= 0 else 0xFFFFFFFF
        )
        self.rr_depth = dr.opaque(mi.UInt32, rr_depth)

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
    ) -> tuple[Any, ...]:
        """Radiance, True, and the features of the guides."""
        start = PathState(
            active=mi.Bool(active),
            sampler=sampler,
            origin=ray.o,
            direction=ray.d,
            weight=mi.Spectrum(1.0),
            eta=mi.Float(1.0),
            depth=mi.UInt32(0),
            previous_point=mi.Point3f(0.0),
            previous_pdf=mi.Float(1.0),
            # An emitter that a camera sees counts whole.
            previous_is_delta=mi.Bool(True),
            was_diffuse=mi.Bool(False),
            features=self._no_features() if self.gives_guides else (),
            radiance=mi.Spectrum(0.0),
        )
        end = self.follow(scene, start)
        if isinstance(end.features, tuple):
            return end.radiance, mi.Bool(True), []
        features = end.features
        no_coat = [mi.Float(0.0)] * 3  # known from other samples only
        channels = [
            *features.albedo,
            *features.normal,
            features.is_random,
            *no_coat,
        ]
        for light in features.projected:
            channels.extend(light)
        return end.radiance, mi.Bool(True), channels

    def _no_features(self) -> Features:
        projected = (mi.Spectrum(0.0),) if self.lamps else ()
        return Features(
            mi.Bool(True), mi.Color3f(0.0), mi.Vector3f(0.0), mi.Float(0.0), projected
        )

    def aov_names(self) -> list[str]:
        """Names of the channels besides the radiance."""
        if not self.gives_guides:
            return []
        colours = ["albedo", "normal", "coat"]
        if self.lamps:
            colours.append("projected")
        names = [f"{colour}.{i}" for colour in colours for i in range(3)]
        return [*names[:6], "random", *names[6:]]

    def follow(self, scene: Any, start: PathState) -> PathState:
        """The paths at their ends, from a `start` of any depth."""
        (end,) = dr.while_loop(
            (start,),
            lambda path: path.active,
            lambda path: (self._step(scene, path),),
        )
        return end

    def _step(self, scene: Any, path: PathState) -> PathState:
        """The paths after their next surface.

        The radiance that leaves a surface in the direction o is, by the rendering equation (Kajiya 1986),

            L(o) = L_e(o) + integral of f(i, o) |cos i| L(i) over the directions i.

        Here f is split into a constant matte part m and the rest, and L(i) into the light directly from emitters and
        that from other surfaces. The integral is then m E, with the irradiance E from the cache; direct light of one
        emitter and of the lamps, reflected by f - m; and what the path meets next, in a direction drawn by the BSDF.
        """
        ray = mi.Ray3f(path.origin, path.direction)
        is_first = path.depth == 0
        si = scene.ray_intersect(ray, mi.RayFlags.All, is_first, path.active)
        # L_e, or the sky.
        is_hidden = mi.Bool(False) if self.shows_sky else is_first & ~si.is_valid()
        emitted = _emitted(scene, si, path)
        radiance = path.radiance + dr.select(is_hidden, 0.0, emitted)

        surface = self._met(path, si, ray)
        numbers = _Numbers.drawn(path.sampler)
        matte = self._from_cache(path, surface, ray, numbers)
        if self.cache is not None:
            radiance = radiance + path.weight * matte.part * matte.irradiance
        light, chosen, factor = _scattered(
            scene, surface, numbers, matte.part, self.openings
        )
        radiance = radiance + path.weight * light
        from_lamps = self._from_lamps(
            scene, surface.bsdf, si, path.sampler, surface.smooth, matte.part
        )
        radiance = radiance + path.weight * from_lamps

        features = path.features
        if isinstance(features, Features):
            features = _seen(features, path, surface, chosen, from_lamps, is_hidden)
        survives = mi.Float(1.0)
        if self.cache is not None:
            factor, survives = _beyond_matte(si, chosen, factor, matte)
        onward, active = _onward(path, si, chosen, factor), surface.scatters
        if self.openings is not None:
            is_cut_out = surface.is_card & is_null(chosen)
            onward = _past_cut_outs(path, onward, is_cut_out)
            active = surface.scatters | is_cut_out
        path = replace(onward, features=features, radiance=radiance)
        return self._survivors(path, active, survives)

    def _met(self, path: PathState, si: Any, ray: Any) -> _Surface:
        """What the paths meet at `si`. The last surface before `max_depth` emits light, but scatters none."""
        has_next = path.depth + 1 < self.max_depth
        scatters = path.active & si.is_valid() & has_next
        bsdf = si.bsdf(ray)
        is_card = mi.Bool(False)
        if self.openings is not None:
            is_card = path.active & si.is_valid() & self.openings.lets_through(bsdf)
        smooth = scatters & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        return _Surface(si, bsdf, scatters, is_card, smooth)

    def _from_cache(
        self, path: PathState, surface: _Surface, ray: Any, numbers: _Numbers
    ) -> _Matte:
        """The irradiance of surfaces from the cache, and the matte part of their BSDFs that reflects it.

        The cache is used only after a diffuse reflection: its cells would be visible on the first surface and in
        mirrors. The path ends with a light, and this surface is on it already: `max_depth` - 2 - `depth` more
        reflections are left.
        """
        if self.cache is None:
            return _Matte(mi.Bool(False), mi.Spectrum(0.0), mi.Spectrum(0.0))
        is_diffuse = mi.has_flag(surface.bsdf.flags(), mi.BSDFFlags.Diffuse)
        may_be_cached = surface.scatters & path.was_diffuse & is_diffuse
        bounces = self.max_depth - 2 - path.depth
        is_cached, irradiance = self.cache.look_up(
            surface.si, ray, numbers.for_direction, bounces, may_be_cached
        )
        part = matte_part(surface.bsdf, surface.si, is_cached)
        return _Matte(is_cached, part, irradiance)

    def _from_lamps(
        self, scene: Any, bsdf: Any, si: Any, sampler: Any, active: Any, matte: Any
    ) -> Any:
        """The radiance that leaves surfaces along their rays by light directly from the lamps."""
        light = mi.Spectrum(0.0)
        for lamp in self.lamps:
            drawn = sampler.next_2d()
            light += lit_by(scene, lamp, bsdf, si, drawn, active, matte, self.openings)
        return light

    def _survivors(self, path: PathState, active: Any, survives: Any) -> PathState:
        """Russian roulette: a path survives with a probability of at most `survives`, which falls with its weight.

        The weight is divided by that probability. eta^2 undoes the scaling of radiance inside a medium. Mitsuba lets a
        path of weight w survive with the probability w, so that many end that carry much light; ours with 4 w.
        """
        active = active & dr.any(path.weight != 0)
        weight_in_air = dr.max(dr.abs(path.weight)) * dr.square(path.eta)
        kept = dr.minimum(weight_in_air / _WHOLE_WEIGHT, _MOST_SURVIVE)
        survives = survives * dr.select(path.depth >= self.rr_depth, kept, 1.0)
        active = active & (path.sampler.next_1d() < survives)
        return replace(path, active=active, weight=path.weight * dr.rcp(survives))

    def direct_light(self, scene: Any, sampler: Any, ray: Any) -> Any:
        """The part of `sample` that comes directly from the lamps to the first surface and those seen through it."""

        def from_lamps(si: Any, active: Any, sampler: Any) -> Any:
            bsdf = si.bsdf()
            is_smooth = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            lit = active & si.is_valid() & (self.max_depth > 1) & is_smooth
            return self._from_lamps(scene, bsdf, si, sampler, lit, 0.0)

        return seen_along(
            scene, mi.Ray3f(ray), self.openings, from_lamps, sampler=sampler
        )

    def to_string(self) -> str:
        return "Paths[]"


def _emitted(scene: Any, si: Any, path: PathState) -> Any:
    """The part of the paths' radiance that the surfaces emit, or the sky where rays hit nothing.

    Weighted against a point drawn on the emitter at the surface before; whole where that had a delta direction.
    """
    previous = dr.zeros(mi.Interaction3f)
    previous.p = path.previous_point
    is_delta = path.previous_is_delta
    ds = mi.DirectionSample3f(scene, si, previous)
    pdf = scene.pdf_emitter_direction(previous, ds, ~is_delta)
    share = mis(path.previous_pdf, dr.select(is_delta, 0.0, pdf))
    return path.weight * ds.emitter.eval(si) * share


def _scattered(
    scene: Any,
    surface: _Surface,
    numbers: _Numbers,
    matte: Any,
    openings: CutOuts | None,
) -> tuple[Any, Any, Any]:
    """One emitter, and the direction in which the path goes on: (light, BSDF sample, factor of the path's weight).

    The light is the radiance that leaves the surface along the ray by light of the emitter, without that of `matte`.
    With L of the emitter, drawn with the density p per solid angle, and q the density of the BSDF in that direction, it
    is L (f - m) |cos| / p times the weight p^2 / (p^2 + q^2); the direction of the path gets the other weight.
    """
    si, smooth = surface.si, surface.smooth
    # Without the test of visibility, whose shadow ray is left until it is known that the light matters.
    ds, light = scene.sample_emitter_direction(si, numbers.for_light, False, smooth)
    wo = si.to_local(ds.d)
    value, pdf, chosen, factor = surface.bsdf.eval_pdf_sample(
        mi.BSDFContext(),
        si,
        wo,
        numbers.for_lobe,
        numbers.for_direction,
        surface.active,
    )
    # The light is radiance / pdf, and `value` is BSDF * cosine. The path's own direction finds all but point lights.
    share = dr.select(ds.delta, 1.0, mis(ds.pdf, pdf))
    light = light * (value - matte * shading_cosine(si, wo)) * share
    matters = smooth & (ds.pdf != 0) & dr.any(light != 0)
    light = from_emitter(scene, ds, si, light, matters, openings)
    return light, chosen, factor


def _onward(path: PathState, si: Any, chosen: Any, factor: Any) -> PathState:
    """The path on its ray from `si` in the direction chosen there, with BSDF * cosine / pdf in its weight."""
    ray = si.spawn_ray(si.to_world(chosen.wo))
    is_diffuse = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Diffuse)
    return replace(
        path,
        origin=ray.o,
        direction=ray.d,
        weight=path.weight * factor,
        eta=path.eta * chosen.eta,
        depth=path.depth + 1,
        previous_point=mi.Point3f(si.p),
        previous_pdf=chosen.pdf,
        previous_is_delta=_is_delta(chosen),
        was_diffuse=path.was_diffuse | is_diffuse,
    )


def _past_cut_outs(path: PathState, onward: PathState, is_cut_out: Any) -> PathState:
    """`onward`, but where a path passed a cut-out as if there had been no surface: it goes on from the one before."""
    return replace(
        onward,
        depth=dr.select(is_cut_out, path.depth, onward.depth),
        previous_point=dr.select(
            is_cut_out, path.previous_point, onward.previous_point
        ),
        previous_pdf=dr.select(is_cut_out, path.previous_pdf, onward.previous_pdf),
        previous_is_delta=dr.select(
            is_cut_out, path.previous_is_delta, onward.previous_is_delta
        ),
    )


def _seen(
    features: Features,
    path: PathState,
    surface: _Surface,
    chosen: Any,
    from_lamps: Any,
    is_hidden: Any,
) -> Features:
    """Features after a surface: complete unless the path passes it, a mirror, glass or an opening."""
    si, bsdf = surface.si, surface.bsdf
    specular = is_specular(bsdf) | is_null(chosen)
    may_pass = features.is_open & surface.active & (path.depth < MAX_SPECULAR)
    passes = may_pass & specular
    ends = features.is_open & path.active & ~passes
    albedo, normal = surface_features(si, bsdf, ends)
    albedo = dr.select(is_hidden, 0.0, albedo)
    is_choice = passes & (chosen.pdf < 1)
    lit = dr.select(path.depth == 0, path.weight * from_lamps, 0.0)
    return Features(
        passes,
        features.albedo + dr.select(ends, path.weight * albedo, 0.0),
        features.normal + normal,
        dr.select(is_choice, 1.0, features.is_random),
        tuple(light + lit for light in features.projected),
    )


def _beyond_matte(si: Any, chosen: Any, factor: Any, matte: _Matte) -> tuple[Any, Any]:
    """The factor of a path's weight without the matte part, whose light is cached, and how likely the path goes on.

    `factor` is BSDF * cosine / pdf in the direction drawn. Its matte part is matte * cosine / pdf. The path goes on
    with the share of `factor` that is left as its probability, so that the weights of those that survive stay alike.
    """
    is_partial = matte.is_cached & ~_is_delta(chosen)
    cosine_over_pdf = dr.select(
        is_partial & (chosen.pdf > 0), shading_cosine(si, chosen.wo) / chosen.pdf, 0.0
    )
    rest = factor - matte.part * cosine_over_pdf
    share = dr.minimum(dr.max(dr.abs(rest)) / dr.max(factor), 1.0)
    worthwhile = dr.select(share > _LEAST_REST, share, 0.0)
    return rest, dr.select(is_partial, worthwhile, 1.0)


def _is_delta(chosen: Any) -> Any:
    return mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)


def matte_part(bsdf: Any, si: Any, active: Any) -> Any:
    """A constant part of the BSDF (1/sr), albedo / pi or less, in the direction of the ray that met the surface.

    At most the BSDF's value for light from one direction off the mirror's: the albedo of a metal is that of its
    highlight, and surfaces with one side have an albedo behind too, where they reflect nothing.
    """
    # At right angles to the plane of incidence, 60 degrees from the normal: local coordinates, z along the normal.
    across = mi.Vector2f(-si.wi.y, si.wi.x)
    length = dr.norm(across)
    across = dr.select(length > 0, across / length, mi.Vector2f(1.0, 0.0))
    cosine = dr.copysign(mi.Float(0.5), mi.Frame3f.cos_theta(si.wi))
    sine = math.sqrt(0.75)
    aside = mi.Vector3f(sine * across.x, sine * across.y, cosine)
    # Mitsuba's `eval` includes the cosine, which is divided out.
    least = bsdf.eval(mi.BSDFContext(), si, aside, active) / 0.5
    lambertian = bsdf.eval_diffuse_reflectance(si, active) / math.pi
    return dr.select(active, dr.minimum(lambertian, least), 0.0)


def shading_cosine(si: Any, wo: Any) -> Any:
    """The cosine of the local direction `wo` with the shading normal; 0 on the other side than the ray's origin."""
    cosine_in = mi.Frame3f.cos_theta(si.wi)
    cosine_out = mi.Frame3f.cos_theta(wo)
    return dr.select(cosine_in * cosine_out > 0, dr.abs(cosine_out), 0.0)


def lit_by(
    scene: Any,
    lamp: Any,
    bsdf: Any,
    si: Any,
    drawn: Any,
    active: Any,
    matte: Any,
    openings: CutOuts | None,
) -> Any:
    """The radiance that leaves surfaces along their rays by light directly from `lamp`, without that of `matte`.

    drawn : a point of the unit square, for a lamp with an aperture.
    """
    ds, light = lamp.sample_direction(si, drawn, active)
    seen = active & (dr.max(light) > 0)
    light = arriving(scene, si, ds.p, light, seen, openings)
    seen &= dr.max(light) > 0
    wo = si.to_local(ds.d)
    value = bsdf.eval(mi.BSDFContext(), si, wo, seen) - matte * shading_cosine(si, wo)
    return dr.select(seen, light * value, 0.0)
