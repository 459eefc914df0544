"""Images: the mean radiance over each pixel, rendered in passes with one seed each; and estimates of their noise.

The noise is estimated from two independent halves A and B of the samples. In raw images |A - B| / 2 estimates the
standard deviation of the mean. A denoised image is filtered from all samples; its halves are filtered separately, at
half the resolution, with a fast network and half of the guides' samples each. The estimate is |A - B| / 1.5: noise
alone would give 2 at the full resolution, and the filter's bias, which halves share, gives less. How the divisor was
chosen: docs/decisions/denoising.md.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens, Pinhole, Rig
from twinlens.camera.lens import check_lens
from twinlens.camera.parts import Parts, check_parts
from twinlens.camera.rig import check_seen
from twinlens.errors import BackendError, InputError, check_int, check_known
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene, build, in_band
from twinlens.rendering.denoising import GUIDE_SAMPLES, denoise_image, denoise_parts
from twinlens.rendering.guides import Guides, binned, render_guides
from twinlens.rendering.integrators import for_denoising
from twinlens.rendering.projectors import build_lit, can_denoise
from twinlens.rendering.samplers import (
    PLAIN_SAMPLER,
    SAMPLERS,
    Pass,
    default_sampler,
    passes_of,
)
from twinlens.rendering.sensors import make_sensor
from twinlens.scenes import Scene
from twinlens.seeds import derived_seed, seed_sequence

Progress = Callable[[float], None]
MAX_SPP = 1024
"""Limit of the doubled samples per pixel. A request for more is rendered without doubling."""

_RENDER_STREAM, _GUIDE_STREAM, _NOISE_STREAM, _CACHE_STREAM = 0, 2, 3, 4
_HALVES_PER_ERROR = 1.5  # standard deviation of the difference of denoised halves, over the error of the whole
_PINHOLE = Pinhole()


def render(
    scene: Scene,
    rig: Rig,
    lens: Lens | Sequence[Lens] = _PINHOLE,
    spp: int = 64,
    seed: int = 0,
    *,
    denoise: bool = False,
    parts: Parts | None = None,
    sampler: str | None = None,
    progress: Progress | None = None,
) -> list[NDArray[np.float32]]:
    """Render `scene` with every camera of `rig` through `lens`.

    Parameters
    ----------
    lens : Lens, or list or tuple of Lens
        That of all cameras, or one for each.
    spp : int
        Samples per pixel, >= 1. Exactly this number is drawn.
    seed : int
        >= 0. Each camera and pass has its own random stream. Cameras with equal noise would have a false match at
        disparity zero.
    denoise : bool
        Remove the renderer's noise with Open Image Denoise, guided by albedo and normals that are rendered through the
        same lens, for each camera apart (`twinlens.rendering.denoising`). Most light between surfaces then comes from a
        cache (`twinlens.rendering.irradiance_cache`). Denoised images are biased: without it, the expectation of each
        pixel is exact.
    parts : Dual, Quad, Grid or Masks, optional
        Parts of the lens's aperture. Each has an image, its contribution to the whole image, from the same light paths:
        where the parts make up the aperture, their images add up to the image without `parts`.
    sampler : str, optional
        Within a pass: one of Mitsuba's, or `sobol` (`twinlens.rendering.sobol`). None takes `sobol` for denoised
        images, else `multijitter`. With 16 samples and a wide aperture, `multijitter` has half the mean square error of
        `independent` at the same cost.
    progress : callable, optional
        Called with the fraction done, in (0, 1], after each pass.

    Returns
    -------
    list of float32 (H, W, 3)
        Linear sRGB radiance per camera, averaged over the area of each pixel; (P, H, W, 3) with P `parts`. Each channel
        of a near infrared camera has a third of the band's radiance; those of an "rgb+nir" camera have it in addition.

    Raises
    ------
    InputError
        For an invalid spp, seed, sampler or lens, another number of lenses than of cameras, and parts of a pinhole.
    BackendError
        When no backend works on this machine, and for parts with an integrator that does not follow camera rays.
    """
    sampler = sampler or default_sampler(denoise)
    lenses = _checked_lenses(scene, rig, lens, spp, seed, sampler)
    single, members = split_bands(rig)
    if len(single) > len(rig):
        seen = render(
            scene, single, _per_band(lenses, members), spp, seed, denoise=denoise, parts=parts, sampler=sampler,
            progress=progress,
        )  # fmt: skip
        return [sum_of([seen[i] for i in indices]) for indices in members]
    if parts is not None:
        check_parts_request(scene, rig, lenses, parts)
    views = views_of(scene, rig, lenses, int(seed), denoise)
    images = []
    for index, view in enumerate(views):
        report = partial_progress(progress, index / len(rig), (index + 1) / len(rig))
        passes = list(image_passes(view.camera, int(spp), int(seed), index, sampler))
        mean, own = raw_image(view, passes, parts, report)
        if view.denoised:
            other = other_guides(
                *view.optics, GUIDE_SAMPLES, int(seed), index, parts=parts
            )
            fractions = None if parts is None else parts.light(view.lens.aperture)[0]
            mean = denoise_parts(mean, other, own, fractions)
        images.append(mean)
    return images


@dataclass(frozen=True, eq=False)
class View:
    """A camera, its lens, and the scene with the integrator of its image."""

    built: BuiltScene
    camera: Camera
    pose: Float
    lens: Lens
    denoised: bool

    @property
    def optics(self) -> tuple[BuiltScene, Camera, Float, Lens]:
        return self.built, self.camera, self.pose, self.lens


def views_of(
    scene: Scene, rig: Rig, lenses: Sequence[Lens], seed: int, denoise: bool
) -> list[View]:
    """The views of a rig whose cameras have one band each.

    Where images are denoised, light between surfaces comes from an irradiance cache, which the cameras of a band share.
    """
    builts = {}
    for band in dict.fromkeys(camera.band for camera in rig.cameras):
        built = build_lit(scene, rig, band)
        denoised = denoise and can_denoise(built, rig, band)
        if denoised:
            built = for_denoising(
                built, scene, rig, band, derived_seed(seed, _CACHE_STREAM)
            )
        builts[band] = built, denoised
    views = zip(rig.cameras, rig.world_from_cams, lenses, strict=True)
    return [
        View(builts[view[0].band][0], *view, builts[view[0].band][1]) for view in views
    ]


def raw_image(
    view: View, passes: Sequence[Pass], parts: Parts | None, progress: Progress
) -> tuple[NDArray[np.float32], Guides | None]:
    """The mean of the samples of all passes, and their guides if the image is to be denoised and they are known."""
    total: Any = 0.0
    done, spp = 0, sum(count for _, count, _ in passes)
    built, camera, pose, lens = view.optics
    for kind, count, stream in passes:
        sensor = make_sensor(camera, pose, lens, count, kind)
        if parts is None:
            image = built.integrator.render(
                built.mi_scene, sensor, seed=stream, spp=count
            )
        else:
            image = _render_parts(built, sensor, camera, count, stream, parts)
        total += np.multiply(image, count, dtype=np.float64)
        done += count
        progress(done / spp)
    total /= spp
    image, channels = total[..., :3], total[..., 3:]
    own = None
    if view.denoised and built.integrator.aov_names():
        own = Guides.from_means(channels, spp, parts)
    elif view.denoised and _follows_rays(built):
        own = render_guides(*view.optics, passes, parts)
    return in_channels(image, camera).astype(np.float32), own


@dataclass(frozen=True, eq=False)
class NoisyImage:
    """Linear radiance, float32 (H, W, 3) or (P, H, W, 3), and an estimate of the error of the whole image, (H, W, 3).

    The estimate is one random draw in each pixel, or in each 2x2 pixels if denoised: average its square over windows.
    It does not contain the error of an irradiance cache.
    """

    image: NDArray[np.float32]
    error: NDArray[np.float32]


def render_measured(
    scene: Scene,
    rig: Rig,
    lens: Lens | Sequence[Lens],
    spp: int,
    seed: int,
    *,
    denoise: bool = False,
    parts: Parts | None = None,
    sampler: str | None = None,
    enough: Callable[[Sequence[NoisyImage]], bool] = lambda _: True,
    progress: Progress | None = None,
) -> tuple[list[NoisyImage], int]:
    """Render as `render`, with error estimates; double the samples until `enough`, or until doubling would exceed
    `MAX_SPP`.

    The progress of each round runs from 0 to 1.

    Returns one image per camera, with `parts` those of the parts, and the samples per pixel used. Raises the errors of
    `render`, and InputError for spp < 2.
    """
    sampler = sampler or default_sampler(denoise)
    lenses = _checked_lenses(scene, rig, lens, spp, seed, sampler)
    if spp < 2:
        raise InputError(f"an estimate of the noise needs spp >= 2, got {spp}")
    single, members = split_bands(rig)
    if len(single) > len(rig):

        def joined(seen: Sequence[NoisyImage]) -> list[NoisyImage]:
            return [_joined_bands([seen[i] for i in indices]) for indices in members]

        found, used = render_measured(
            scene, single, _per_band(lenses, members), spp, seed, denoise=denoise, parts=parts, sampler=sampler,
            progress=progress, enough=lambda seen: enough(joined(seen)),
        )  # fmt: skip
        return joined(found), used
    if parts is not None:
        check_parts_request(scene, rig, lenses, parts)
    views = views_of(scene, rig, lenses, seed, denoise)
    return measured(
        views, spp, seed, parts=parts, sampler=sampler, enough=enough, progress=progress
    )


def measured(
    views: Sequence[View],
    spp: int,
    seed: int,
    *,
    parts: Parts | None,
    sampler: str,
    enough: Callable[[Sequence[NoisyImage]], bool] = lambda _: True,
    progress: Progress | None = None,
) -> tuple[list[NoisyImage], int]:
    """The images of `views`, as `render_measured`."""
    others = [
        [
            other_guides(*view.optics, GUIDE_SAMPLES // 2, seed, i, k, parts=parts)
            for k in (0, 1)
            if view.denoised
        ]
        for i, view in enumerate(views)
    ]
    fractions = [
        None if parts is None else parts.light(view.lens.aperture)[0] for view in views
    ]
    owns: list[list[Guides | None]] = [[None, None] for _ in views]
    several = () if parts is None else (len(parts),)
    totals = [
        np.zeros((2, *several, view.camera.height, view.camera.width, 3))
        for view in views
    ]
    counts = np.zeros(2)
    extra = spp
    while True:
        for half, count in enumerate((extra - extra // 2, extra // 2)):
            half_seed = derived_seed(seed, _NOISE_STREAM, int(counts.sum()), half)
            for i, view in enumerate(views):
                start = half / 2 + i / len(views) / 2
                report = partial_progress(progress, start, start + 1 / len(views) / 2)
                passes = list(image_passes(view.camera, count, half_seed, i, sampler))
                image, own = raw_image(view, passes, parts, report)
                totals[i][half] += count * image.astype(np.float64)
                owns[i][half] = _joined(owns[i][half], own)
            counts[half] += count
        found = [
            _measured(*each, counts)
            for each in zip(totals, others, owns, fractions, strict=True)
        ]
        extra = int(counts.sum())
        if enough(found) or 2 * extra > MAX_SPP:
            return found, extra


def denoised_cameras(scene: Scene, rig: Rig) -> list[int]:
    """Indices of the cameras whose images `render` denoises if asked; `can_denoise` says where it does not."""
    builts = {
        band: build_lit(scene, rig, band)
        for camera in rig.cameras
        for band in camera.bands
    }
    keeps = {band: can_denoise(built, rig, band) for band, built in builts.items()}
    return [
        i
        for i, camera in enumerate(rig.cameras)
        if any(keeps[band] for band in camera.bands)
    ]


def split_bands(rig: Rig) -> tuple[Rig, list[list[int]]]:
    """`rig` with a camera for each band that a camera sees, and for each camera of `rig` the indices of its own."""
    members: list[list[int]] = []
    cameras: list[Camera] = []
    poses: list[Float] = []
    for camera, pose in zip(rig.cameras, rig.world_from_cams, strict=True):
        members.append(list(range(len(cameras), len(cameras) + len(camera.bands))))
        cameras += [camera.replace(band=band) for band in camera.bands]
        poses += [pose] * len(camera.bands)
    return (
        rig
        if len(cameras) == len(rig)
        else Rig(cameras, poses, projectors=rig.projectors)
    ), members


def _checked_lenses(
    scene: Scene,
    rig: Rig,
    lens: Lens | Sequence[Lens],
    spp: int,
    seed: int,
    sampler: str,
) -> list[Lens]:
    """The lens of each camera, after `check_request`. Raises InputError for another number of lenses than cameras."""
    if isinstance(lens, str) or not isinstance(lens, Sequence):
        check_request(scene, rig, [lens], spp, seed, sampler)
        return [lens] * len(rig)
    check_request(scene, rig, lens, spp, seed, sampler)
    if len(lens) != len(rig):
        raise InputError(
            f"a rig of {len(rig)} cameras needs one lens, or one for each camera, got {len(lens)}"
        )
    return list(lens)


def _per_band(lenses: Sequence[Lens], members: Sequence[Sequence[int]]) -> list[Lens]:
    """The lenses of the cameras of `split_bands`, in their order, from those of the cameras of a rig."""
    return [
        lens for lens, indices in zip(lenses, members, strict=True) for _ in indices
    ]


def sum_of(images: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """The sum of the images of a camera's bands."""
    return np.asarray(np.sum(images, axis=0, dtype=np.float32))


def _joined_bands(views: Sequence[NoisyImage]) -> NoisyImage:
    errors = np.stack([view.error for view in views])
    return NoisyImage(
        sum_of([view.image for view in views]), np.sqrt(np.square(errors).sum(axis=0))
    )


def in_channels(image: Float, camera: Camera) -> Float:
    """The image (..., H, W, 3) of a pass as `camera` has it: the mean in each channel for the near infrared."""
    if camera.band != "nir":
        return image
    return np.repeat(image.mean(axis=-1, keepdims=True), 3, axis=-1)


def _measured(
    total: Float,
    others: Sequence[Guides],
    owns: Sequence[Guides | None],
    fractions: Float | None,
    counts: NDArray[np.float64],
) -> NoisyImage:
    """The image of one camera, from the sums of the two halves of its samples, and their guides."""
    mean = (total.sum(axis=0) / counts.sum()).astype(np.float32)
    whole = total if fractions is None else total.sum(axis=1)
    a, b = (whole / counts[:, None, None, None]).astype(np.float32)
    if not others:
        return NoisyImage(
            mean, np.abs(a - b) * np.float32(math.sqrt(counts.prod()) / counts.sum())
        )
    denoised = denoise_parts(mean, others[0] + others[1], _joined(*owns), fractions)
    if fractions is not None:
        others, owns = (
            [each.of_parts() for each in others],
            [own and own.of_parts() for own in owns],
        )
    small = [
        denoise_image(binned(image), other.binned(), own and own.binned(), fast=True)
        for image, other, own in zip((a, b), others, owns, strict=True)
    ]
    error = np.abs(small[0] - small[1]) / np.float32(_HALVES_PER_ERROR)
    return NoisyImage(
        denoised, error.repeat(2, axis=0).repeat(2, axis=1)[: len(a), : a.shape[1]]
    )


def _joined(a: Guides | None, b: Guides | None) -> Guides | None:
    return a + b if a is not None and b is not None else a or b


def _follows_rays(built: BuiltScene) -> bool:
    """Whether the samples of an image are known: not where light is traced from the lamps."""
    return isinstance(built.integrator, mitsuba().SamplingIntegrator)


def check_parts_request(
    scene: Scene, rig: Rig, lenses: Iterable[Lens], parts: Parts
) -> None:
    """Raise InputError for parts that a lens has not, BackendError where the integrator has no images of parts."""
    for lens in lenses:
        check_parts(parts, lens)
    if not _follows_rays(build(scene, rig.cameras[0].band)):
        raise BackendError(
            "parts of an aperture need an integrator that follows camera rays, such as 'path'"
        )


def _render_parts(
    built: BuiltScene, sensor: Any, camera: Camera, count: int, seed: int, parts: Parts
) -> Float:
    """The images (P, H, W, C) of the parts of an aperture, from the samples with which Mitsuba renders the image.

    If the integrator gives guides, their features follow after the radiance, and the share of each part.
    """
    from twinlens.rendering.ray_generation import pixel_means  # sets up the backend

    ray, x, y = sensor.film_rays(count, seed)
    radiance, _, features = built.integrator.sample(
        built.mi_scene, sensor.sampler(), ray
    )
    channels = [*radiance, *features, mitsuba().Float(1.0)] if features else radiance
    return pixel_means(channels, count, camera, parts.shares(x, y, sensor.math))


def other_guides(
    built: BuiltScene,
    camera: Camera,
    pose: Float,
    lens: Lens,
    count: int,
    seed: int,
    *key: int,
    parts: Parts | None = None,
) -> Guides:
    """The guides of `count` samples per pixel; `seed` and `key` name their random stream."""
    passes = passes_of(
        camera, count, seed_sequence(seed, _GUIDE_STREAM, *key), PLAIN_SAMPLER
    )
    return render_guides(built, camera, pose, lens, passes, parts)


def image_passes(
    camera: Camera, spp: int, seed: int, index: int, sampler: str
) -> Iterator[Pass]:
    """The passes in which `render` renders camera `index` of a rig."""
    return passes_of(camera, spp, seed_sequence(seed, _RENDER_STREAM, index), sampler)


def check_request(
    scene: Scene, rig: Rig, lenses: Iterable[Lens], spp: int, seed: int, sampler: str
) -> None:
    """Raise InputError for invalid arguments of `render`."""
    check_view(scene, rig)
    check_seen(rig)
    for band in dict.fromkeys(band for camera in rig.cameras for band in camera.bands):
        if not any(
            projector.emitted_power
            for projector in rig.projectors
            if projector.band == band
        ):
            check_lit(scene, band)
    for lens in lenses:
        check_lens(lens)
    check_int("spp", spp, 1)
    check_int("seed", seed, 0)
    check_known("sampler", sampler, SAMPLERS)


def check_lit(scene: Scene, band: str = "rgb") -> None:
    """Raise InputError for a scene without light in the band "rgb" or "nir"."""
    if not in_band(scene, band).is_lit:
        kind = "light" if band == "rgb" else "near infrared light"
        remedy = "add one under [lights], an emitter to an object, a projector to the rig, or a sky"
        raise InputError(f"the scene {scene.name!r} has no {kind}: {remedy}")


def check_view(scene: Scene, rig: Rig) -> None:
    """Raise InputError unless the arguments are a Scene and a Rig."""
    if not isinstance(scene, Scene):
        raise InputError(
            f"scene must be a Scene, got {scene!r:.60}; load_scene makes one from a name or a file"
        )
    if not isinstance(rig, Rig):
        raise InputError(
            f"rig must be a Rig, got {rig!r:.60}; Rig.stereo makes one from a camera, Rig from several"
        )


def partial_progress(progress: Progress | None, start: float, end: float) -> Progress:
    """Progress of a part, reported as progress of the whole from `start` to `end`."""
    if progress is None:
        return lambda _: None
    return lambda fraction: progress(start + (end - start) * fraction)
