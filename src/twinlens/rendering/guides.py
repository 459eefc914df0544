"""Guides of the denoiser: what each pixel sees of its first rough surfaces, through the same lens as the image.

Rays follow mirrors, glass and openings up to `MAX_SPECULAR` surfaces, then stop: guides cost a small part of a render.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens
from twinlens.camera.parts import Parts
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.sensors import make_sensor

MAX_SPECULAR = 8
"""Mirrors, glass and openings that a ray passes before it stops."""

_SPECULAR_KINDS = (3, 4)  # mirror and transmissive, in MATERIAL_KINDS
_UNKNOWN_KIND = 0
_NOTHING = (1, 1, 1, 0, 0, 0, 0)  # features but projected light where nothing is known
_SURFACE_CHANNELS = len(_NOTHING)


@dataclass(frozen=True, eq=False)
class Guides:
    """Means over each pixel, float32 (H, W, C); with parts of the aperture (P, H, W, C), weighted by the parts' shares.

    count : samples per pixel.
    features : albedo, normal, random share and projected light.
    shares : mean shares of the parts, (P, H, W, 1): of the samples of a pixel, not of the aperture. None without parts.

    albedo : diffuse reflectance, times the tint of the mirrors and glass before it; 1 for lamps and the sky.
    normal : shading normal in the world, 0 where nothing was hit.
    random_share : share of the samples that followed a ray of glass or of a mask that they chose at random.
    projected : radiance of the light directly from projectors; no channels if there are none.
    """

    features: NDArray[np.float32]
    count: int
    shares: NDArray[np.float32] | None = None

    @classmethod
    def from_means(cls, means: Float, count: int, parts: Parts | None) -> "Guides":
        """Those of means (H, W, C), with parts (P, H, W, C), whose last channel is then their shares."""
        features = np.nan_to_num(means).astype(np.float32)
        np.clip(features[..., :3], 0, 1, out=features[..., :3])
        np.clip(features[..., 3:6], -1, 1, out=features[..., 3:6])
        return (
            cls(features, count)
            if parts is None
            else cls(features[..., :-1], count, features[..., -1:])
        )

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
    def projected(self) -> NDArray[np.float32]:
        return self.features[..., _SURFACE_CHANNELS:]

    def replaced_where_random(self, other: "Guides") -> "Guides":
        """These guides, but those of `other` where samples chose at random: glass would have specks."""
        return Guides(
            np.where(self.random_share > 0, other.features, self.features), self.count
        )

    def __add__(self, other: "Guides") -> "Guides":
        """The guides of both sets of samples."""
        count = self.count + other.count
        part = np.float32(self.count / count)
        features = part * self.features + (1 - part) * other.features
        if self.shares is None or other.shares is None:
            return Guides(features, count)
        return Guides(features, count, part * self.shares + (1 - part) * other.shares)

    def of_part(self, part: int, fraction: float) -> "Guides":
        """The guides of one part, which gets this fraction of the light; of all where no sample is in the part."""
        assert self.shares is not None
        surface = _ratio(
            self.features[part],
            self.shares[part],
            self.of_parts().features[..., :_SURFACE_CHANNELS],
        )
        projected = self.features[part][..., _SURFACE_CHANNELS:] / np.float32(fraction)
        return Guides(np.concatenate([surface, projected], axis=-1), self.count)

    def of_parts(self) -> "Guides":
        """The guides of all parts together."""
        assert self.shares is not None
        total = self.features.sum(axis=0)
        surface = _ratio(total, self.shares.sum(axis=0), np.array(_NOTHING, np.float32))
        return Guides(
            np.concatenate([surface, total[..., _SURFACE_CHANNELS:]], axis=-1),
            self.count,
        )

    def binned(self) -> "Guides":
        """At half the resolution."""
        return Guides(binned(self.features), self.count)


def _ratio(
    features: NDArray[np.float32],
    share: NDArray[np.float32],
    unknown: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Albedo, normal and random share over the share of samples; `unknown` where it is 0."""
    return np.where(
        share > 0,
        features[..., :_SURFACE_CHANNELS] / np.where(share > 0, share, 1),
        unknown,
    )


def binned(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means over 2x2 pixels of an image (H, W, C); the last row and column are repeated if their number is odd."""
    height, width = (size + size % 2 for size in image.shape[:2])
    even = np.pad(
        image,
        ((0, height - len(image)), (0, width - image.shape[1]), (0, 0)),
        mode="edge",
    )
    return np.asarray(
        even.reshape(height // 2, 2, width // 2, 2, -1).mean(
            axis=(1, 3), dtype=np.float32
        )
    )


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


def _has_openings(built: BuiltScene) -> bool:
    """Whether there may be mirrors, glass or masks."""
    return any(
        body.material_kind in (_UNKNOWN_KIND, *_SPECULAR_KINDS) for body in built.bodies
    )


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

    ray, x, y = sensor.film_rays(count, seed)
    albedo, normal = _first_rough_surfaces(built, mitsuba().Ray3f(ray))
    channels = [*albedo, *normal, drjit.zeros(mitsuba().Float, drjit.width(x))]
    if built.projected is not None:
        channels.extend(
            built.projected.direct_light(built.mi_scene, sensor.sampler(), ray)
        )
    if parts is None:
        return pixel_means(channels, count, camera)
    return pixel_means(
        [*channels, mitsuba().Float(1.0)],
        count,
        camera,
        parts.shares(x, y, sensor.math),
    )


def _first_rough_surfaces(built: BuiltScene, ray: Any) -> tuple[Any, Any]:
    """Albedo and shading normal along each ray.

    Nothing is chosen at random. At the first surface that reflects and transmits, both rays are followed, weighted by
    their shares; from there on each is transmitted where possible. Masks are weighted by their opacity.
    """
    import drjit as dr

    mi = mitsuba()
    scene = built.mi_scene

    if not _has_openings(built):
        si = scene.ray_intersect(ray, mi.RayFlags.All, True)
        return surface_features(si, si.bsdf(), mi.Bool(True))

    def step(
        active: Any,
        ray: Any,
        tint: Any,
        part: Any,
        other: Any,
        is_split: Any,
        albedo: Any,
        normal: Any,
        depth: Any,
    ) -> tuple[Any, ...]:
        """One surface. `part` is the share of the ray, `tint` its share and colour; `other` is a ray that waits."""
        si = scene.ray_intersect(ray, mi.RayFlags.All, True, active)
        bsdf = si.bsdf()
        may_pass = active & si.is_valid() & (depth < MAX_SPECULAR)
        specular = may_pass & is_specular(bsdf)
        sampled = specular | (may_pass & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null))
        # The largest number below 1 chooses transmission, unless nothing is transmitted.
        sample, weight = bsdf.sample(
            mi.BSDFContext(), si, 1 - 2.0**-24, mi.Point2f(0.5), sampled
        )
        on = specular | (sampled & is_null(sample))
        share = dr.select(on, dr.select(specular & is_split, 1.0, sample.pdf), 0.0)
        stays = dr.select(active & ~specular, 1 - share, 0.0)
        found, facing = surface_features(si, bsdf, stays > 0)
        albedo, normal = albedo + stays * tint * found, normal + stays * part * facing
        splits = specular & (share < 1)
        reflected = si.spawn_ray(si.to_world(mi.reflect(si.wi)))
        other = dr.select(
            splits, (reflected, (1 - share) * tint, (1 - share) * part), other
        )
        ray = dr.select(on, si.spawn_ray(si.to_world(sample.wo)), ray)
        tint, part = (
            dr.select(on, share * weight * tint, tint),
            dr.select(on, share * part, part),
        )
        turns = active & ~on & (other[2] > 0)
        ray, tint, part = dr.select(turns, other, (ray, tint, part))
        other = other[0], other[1], dr.select(turns, 0.0, other[2])
        depth = dr.select(turns, 0, depth + 1)
        return (
            on | turns,
            ray,
            tint,
            part,
            other,
            is_split | splits,
            albedo,
            normal,
            depth,
        )

    none = ray, mi.Color3f(0.0), mi.Float(0.0)
    start = mi.Bool(True), ray, mi.Color3f(1.0), mi.Float(1.0), none, mi.Bool(False)
    empty = mi.Color3f(0.0), mi.Vector3f(0.0), mi.UInt32(0)
    *_, albedo, normal, _ = dr.while_loop(
        (*start, *empty), lambda active, *_: active, step
    )
    return albedo, normal


def surface_features(si: Any, bsdf: Any, active: Any) -> tuple[Any, Any]:
    """Albedo and shading normal of surfaces, or of the sky where rays hit nothing; 0 where not `active`."""
    import drjit as dr

    mi = mitsuba()
    hit = active & si.is_valid()
    diffuse = (
        hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse) & ~si.shape.is_emitter()
    )
    albedo = dr.select(diffuse, bsdf.eval_diffuse_reflectance(si, diffuse), 1.0)
    return dr.select(active, albedo, 0.0), mi.Vector3f(
        dr.select(hit, si.sh_frame.n, 0.0)
    )


def is_specular(bsdf: Any) -> Any:
    """Whether a surface is a mirror or smooth glass."""
    mi = mitsuba()
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta) & ~mi.has_flag(
        bsdf.flags(), mi.BSDFFlags.Smooth
    )


def is_null(sample: Any) -> Any:
    """Whether a path goes on through an opening."""
    mi = mitsuba()
    return mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
