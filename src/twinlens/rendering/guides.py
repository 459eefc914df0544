"""Guides of the denoiser: what each pixel sees of its first rough surfaces, through the same lens as the image.

Rays pass mirrors, glass and openings as in `tracing`, up to `MAX_SPECULAR` of them, and end at the first rough surface:
guides cost a small part of a render. All samples of an image are traced in one kernel, in float32.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens
from twinlens.camera.parts import Parts
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.cut_outs import CutOuts, cut_outs, seen_along
from twinlens.rendering.sensors import make_sensor
from twinlens.rendering.tracing import MAX_SPECULAR, is_null, may_pass, passage

_NOTHING = (
    1,
    1,
    1,
    0,
    0,
    0,
    0,
    0,
    0,
    0,
)  # of the sky: albedo, normal, random share, coat
_SURFACE_CHANNELS = len(_NOTHING)


@dataclass(frozen=True, eq=False)
class Guides:
    """Means over each pixel, float32 (H, W, C); with parts of the aperture (P, H, W, C), weighted by the parts' shares.

    count : samples per pixel.
    features : albedo, normal, random share, coat and projected light.
    shares : mean shares of the parts, (P, H, W, 1): of the samples of a pixel, not of the aperture. None without parts.

    albedo : diffuse reflectance, times the tint of the mirrors and glass before it; 1 for lamps and the
        sky, 0 for a sky that cameras do not see.
    normal : shading normal in the world, 0 where nothing was hit.
    random_share : share of the samples that followed a ray of glass or of a mask that they chose at random.
    coat : what smooth coats, such as that of plastic, reflect: the albedo seen in them, times their reflectance.
    projected : radiance of the light directly from projectors; no channels if there are none.
    """

    features: NDArray[np.float32]
    count: int
    shares: NDArray[np.float32] | None = None

    @classmethod
    def from_means(cls, means: Float, count: int, parts: Parts | None) -> "Guides":
        """Guides from means (H, W, C), or with parts (P, H, W, C), whose last channel is then the parts' shares."""
        features = np.nan_to_num(means).astype(np.float32)
        np.clip(features[..., :3], 0, 1, out=features[..., :3])
        np.clip(features[..., 3:6], -1, 1, out=features[..., 3:6])
        if parts is None:
            return cls(features, count)
        return cls(features[..., :-1], count, features[..., -1:])

    @property
    def albedo(self) -> NDArray[np.float32]:
        return self.features[..., :3]

    @property
    def normal(self) -> NDArray[np.float32]:
        return self.features[..., 3:6]

    @property
    def random_share(self) -> NDArray[np.float32]:
        return self.features[..., 6:7]

    @property
    def coat(self) -> NDArray[np.float32]:
        return self.features[..., 7:10]

    @property
    def reflectance(self) -> NDArray[np.float32]:
        """Of the surface and its coat, (H, W, 3)."""
        return self.albedo + self.coat

    @property
    def projected(self) -> NDArray[np.float32]:
        return self.features[..., _SURFACE_CHANNELS:]

    def replaced_where_random(self, steady: "Guides") -> "Guides":
        """These guides, but the `steady` ones where samples chose a way at random, which would give glass specks.

        Samples choose between a coat and what is below it, too: what coats reflect is that of the `steady` ones.
        """
        is_random = self.random_share > 0
        features = np.where(is_random, steady.features, self.features)
        features[..., 7:10] = steady.coat
        return Guides(features, self.count)

    def __add__(self, more: "Guides") -> "Guides":
        """The guides of both sets of samples."""
        count = self.count + more.count
        weight = np.float32(self.count / count)
        features = weight * self.features + (1 - weight) * more.features
        if self.shares is None or more.shares is None:
            return Guides(features, count)
        shares = weight * self.shares + (1 - weight) * more.shares
        return Guides(features, count, shares)

    def of_part(self, part: int, fraction: float) -> "Guides":
        """The guides of one part, which gets this fraction of the light; of all where no sample is in the part."""
        assert self.shares is not None
        features = self.features[part]
        of_all = self.of_parts().features[..., :_SURFACE_CHANNELS]
        # Surface features are means over the samples of the part, projected light is radiance over the whole aperture.
        surface = _surface_means(features, self.shares[part], of_all)
        projected = features[..., _SURFACE_CHANNELS:] / np.float32(fraction)
        return Guides(np.concatenate([surface, projected], axis=-1), self.count)

    def of_parts(self) -> "Guides":
        """The guides of all parts together."""
        assert self.shares is not None
        total = self.features.sum(axis=0)
        nothing = np.array(_NOTHING, np.float32)
        surface = _surface_means(total, self.shares.sum(axis=0), nothing)
        projected = total[..., _SURFACE_CHANNELS:]
        return Guides(np.concatenate([surface, projected], axis=-1), self.count)

    def binned(self) -> "Guides":
        """At half the resolution."""
        return Guides(binned(self.features), self.count)


def _surface_means(
    features: NDArray[np.float32],
    share: NDArray[np.float32],
    without_samples: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Albedo, normal and random share over the share of samples, or `without_samples` where it is 0."""
    has_samples = share > 0
    means = features[..., :_SURFACE_CHANNELS] / np.where(has_samples, share, 1)
    return np.where(has_samples, means, without_samples)


def binned(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means over 2x2 pixels of an image (H, W, C); the last row and column are repeated if their number is odd."""
    rows, columns = image.shape[:2]
    missing = (0, rows % 2), (0, columns % 2), (0, 0)
    even = np.pad(image, missing, mode="edge")
    height, width = even.shape[0] // 2, even.shape[1] // 2
    blocks = even.reshape(height, 2, width, 2, -1)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))


def render_guides(
    built: BuiltScene,
    camera: Camera,
    pose: Float,
    lens: Lens,
    passes: Iterable[tuple[str, int, int]],
    parts: Parts | None = None,
) -> Guides:
    """The guides of one camera, from passes of (sampler, samples per pixel, seed).

    The passes of an image give the guides of its own film positions and aperture points.
    """
    total: Any = 0.0
    count = 0
    for sampler, size, seed in passes:
        sensor = make_sensor(camera, pose, lens, size, sampler)
        total = total + size * _features(built, sensor, camera, size, seed, parts)
        count += size
    return Guides.from_means(total / count, count, parts)


def _features(
    built: BuiltScene,
    sensor: Any,
    camera: Camera,
    count: int,
    seed: int,
    parts: Parts | None,
) -> Float:
    """Means of the features; with `parts`, of their shares after these."""
    import drjit

    from twinlens.rendering.ray_generation import pixel_means  # sets up the backend

    ray, aperture = sensor.film_rays(count, seed)
    albedo, normal = _first_rough_surfaces(built, mitsuba().Ray3f(ray))
    nothing_random = drjit.zeros(mitsuba().Float, drjit.width(aperture))
    channels = [*albedo, *normal, nothing_random, *_seen_in_coats(built, ray)]
    if built.projected is not None:
        channels.extend(
            built.projected.direct_light(built.mi_scene, sensor.sampler(), ray)
        )
    if parts is None:
        return pixel_means(channels, count, camera)
    channels.append(mitsuba().Float(1.0))  # whose mean is the part's share of samples
    shares = sensor.shares(parts, aperture)
    return pixel_means(channels, count, camera, shares)


def _seen_in_coats(built: BuiltScene, ray: Any) -> Any:
    """The albedo that smooth coats show along each ray, times their reflectance; 0 elsewhere, and behind glass.

    A coat is the mirror of a material that also reflects diffusely.
    """
    import drjit as dr

    mi = mitsuba()
    flags = mi.BSDFFlags
    kinds = {int(body.shape.bsdf().flags()) for body in built.bodies if body.shape}
    is_coat = int(flags.DeltaReflection), int(flags.DiffuseReflection)
    if not any(kind & is_coat[0] and kind & is_coat[1] for kind in kinds):
        return dr.zeros(mi.Color3f, dr.width(ray.o))
    scene, openings = built.mi_scene, cut_outs(built)

    def seen_in_coat(si: Any, active: Any, _sampler: Any) -> Any:
        bsdf = si.bsdf()
        has_mirror = mi.has_flag(bsdf.flags(), flags.DeltaReflection)
        coated = active & si.is_valid() & has_mirror
        coated &= mi.has_flag(bsdf.flags(), flags.Diffuse)
        mirrored = mi.reflect(si.wi)
        reflectance = _coat_reflectance(bsdf, si, coated)
        coated &= dr.any(reflectance > 0)
        onward = si.spawn_ray(si.to_world(mirrored))
        shown = scene.ray_intersect(onward, mi.RayFlags.All, False, coated)
        albedo, _ = surface_features(shown, shown.bsdf(), coated)
        return dr.select(coated, reflectance * albedo, 0.0)

    return seen_along(scene, mi.Ray3f(ray), openings, seen_in_coat)


def _coat_reflectance(bsdf: Any, si: Any, coated: Any) -> Any:
    """The reflectance of the mirrors of BSDFs, in which a blend counts each of its two by its share."""
    import drjit as dr

    mi = mitsuba()
    flags = mi.BSDFFlags
    middle = mi.Point2f(0.5)

    def mirror(context: Any, number: float) -> tuple[Any, Any, Any]:
        sample, weight = bsdf.sample(context, si, mi.Float(number), middle, coated)
        is_mirror = coated & mi.has_flag(sample.sampled_type, flags.DeltaReflection)
        share = dr.select(is_mirror, sample.pdf, 0.0)
        return sample, share, dr.select(is_mirror, weight, 0.0)

    # The only lobe that is asked for: its weight is its reflectance, its density the share of its branch in a blend.
    # The least number chooses one branch of a blend, and the largest below 1 the other one.
    only_mirror = mi.BSDFContext()
    only_mirror.type_mask = int(flags.DeltaReflection)
    sample, first_share, first = mirror(only_mirror, 0.0)
    _, second_share, second = mirror(only_mirror, 1 - 2.0**-24)
    rest = dr.minimum(second_share, 1 - first_share)
    # A mask that is asked for one lobe gives its opening. Of all lobes, the least number chooses the mirror.
    _, density, weight = mirror(mi.BSDFContext(), 0.0)
    of_mask = density * weight
    has_opening = mi.has_flag(sample.sampled_type, flags.Null)
    return dr.select(has_opening, of_mask, first_share * first + rest * second)


@dataclass
class _Way:
    """One of two ways of a sample: its ray, its share of the sample, and that times the colour of what it passed."""

    ray: Any
    part: Any
    tint: Any


@dataclass
class _Search:
    """Samples on the way to their first rough surfaces: the state of Dr.Jit's loop.

    active : whether the sample goes on.
    way, waiting : the way that is followed, and the other one of the sample, whose part is 0 if there is none.
    is_split : whether the sample has been split into two ways.
    depth : surfaces that the way has passed.
    albedo, normal : what the sample has seen so far.
    """

    active: Any
    way: _Way
    waiting: _Way
    is_split: Any
    depth: Any
    albedo: Any
    normal: Any


def _first_rough_surfaces(built: BuiltScene, ray: Any) -> tuple[Any, Any]:
    """Albedo and shading normal along each ray.

    Nothing is chosen at random. At the first surface that reflects and transmits, both rays are followed, weighted by
    their shares; from there on each is transmitted where possible. Masks are weighted by their opacity. A hidden sky is
    black, straight on and through cut-outs.
    """
    import drjit as dr

    mi = mitsuba()
    scene, openings = built.mi_scene, cut_outs(built)
    if not may_pass(built).any():
        si = scene.ray_intersect(ray, mi.RayFlags.All, True)
        is_seen = si.is_valid() | built.sky_visible
        return surface_features(si, si.bsdf(), is_seen)
    start = _Search(
        active=mi.Bool(True),
        way=_Way(ray, mi.Float(1.0), mi.Color3f(1.0)),
        waiting=_Way(ray, mi.Float(0.0), mi.Color3f(0.0)),
        is_split=mi.Bool(False),
        depth=mi.UInt32(0),
        albedo=mi.Color3f(0.0),
        normal=mi.Vector3f(0.0),
    )
    (end,) = dr.while_loop(
        (start,),
        lambda search: search.active,
        lambda search: (_step(scene, search, openings, built.sky_visible),),
    )
    return end.albedo, end.normal


def _step(
    scene: Any, search: _Search, openings: CutOuts | None, sky_visible: bool
) -> _Search:
    """The search after the next surface of each sample."""
    import drjit as dr

    mi = mitsuba()
    active, way = search.active, search.way
    si = scene.ray_intersect(way.ray, mi.RayFlags.All, True, active)
    bsdf = si.bsdf()
    can_pass = active & si.is_valid() & (search.depth < MAX_SPECULAR)
    passes, specular, sample, weight = passage(bsdf, si, can_pass)

    # The share that goes on. Where the sample has been split before, all of the ray takes the one way chosen.
    passed_whole = specular & search.is_split
    share = dr.select(passes, dr.select(passed_whole, 1.0, sample.pdf), 0.0)
    # What the ray sees here: the rest of it at masks, all of it at rough surfaces and in the sky.
    stays = dr.select(active & ~specular, 1 - share, 0.0)
    is_direct = (search.depth == 0) & ~search.is_split
    is_seen = si.is_valid() | ~is_direct | sky_visible
    albedo, normal = surface_features(si, bsdf, (stays > 0) & is_seen)

    # The reflected ray waits until the transmitted one has ended.
    splits = specular & (share < 1)
    mirrored = si.spawn_ray(si.to_world(mi.reflect(si.wi)))
    reflected = _Way(mirrored, (1 - share) * way.part, (1 - share) * way.tint)
    waiting = dr.select(splits, reflected, search.waiting)
    refracted = si.spawn_ray(si.to_world(sample.wo))
    onward = _Way(refracted, share * way.part, share * weight * way.tint)
    turns = active & ~passes & (waiting.part > 0)
    depth = search.depth + 1
    if openings is not None:
        is_cut_out = passes & is_null(sample) & openings.lets_through(bsdf)
        depth = dr.select(is_cut_out, search.depth, depth)
    return _Search(
        active=passes | turns,
        way=dr.select(turns, waiting, dr.select(passes, onward, way)),
        waiting=replace(waiting, part=dr.select(turns, 0.0, waiting.part)),
        is_split=search.is_split | splits,
        depth=dr.select(turns, 0, depth),
        albedo=search.albedo + stays * way.tint * albedo,
        normal=search.normal + stays * way.part * normal,
    )


def surface_features(si: Any, bsdf: Any, active: Any) -> tuple[Any, Any]:
    """Albedo and shading normal of surfaces, or of the sky where rays hit nothing; 0 where not `active`."""
    import drjit as dr

    mi = mitsuba()
    hit = active & si.is_valid()
    is_diffuse = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
    diffuse = hit & is_diffuse & ~si.shape.is_emitter()
    albedo = dr.select(diffuse, bsdf.eval_diffuse_reflectance(si, diffuse), 1.0)
    normal = dr.select(hit, si.sh_frame.n, 0.0)
    return dr.select(active, albedo, 0.0), mi.Vector3f(normal)
