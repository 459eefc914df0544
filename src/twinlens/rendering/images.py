"""The image of one view: passes of samples, their mean, the denoiser, and an estimate of the noise that remains.

The noise is estimated from two independent halves A and B of the samples. In raw images (A - B) / 2 has the standard
deviation of the mean. A denoised image is filtered from all samples; its halves are filtered separately, at
half the resolution, with a fast network and half of the guides' samples each. The estimate is (A - B) / 1.5: noise
alone would give 2 at the full resolution, and the filter's bias, which halves share, gives less. How the divisor was
chosen: docs/decisions/denoising.md.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens
from twinlens.camera.lens import require_paraxial
from twinlens.camera.parts import Parts
from twinlens.errors import BackendError
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.denoising import GUIDE_SAMPLES, denoise_image, denoise_parts
from twinlens.rendering.guides import Guides, binned, render_guides
from twinlens.rendering.requests import Progress, partial_progress
from twinlens.rendering.samplers import PLAIN_SAMPLER, Pass, passes_of
from twinlens.rendering.sensors import make_sensor
from twinlens.rendering.views import View, in_channels
from twinlens.seeds import derived_seed, seed_sequence

MAX_SPP = 1024
"""Limit of the doubled samples per pixel. A request for more is rendered without doubling."""

_RENDER_STREAM, _GUIDE_STREAM, _NOISE_STREAM = 0, 2, 3
_HALVES_PER_ERROR = 1.5  # standard deviation of the difference of denoised halves, over the error of the whole


@dataclass(frozen=True)
class Samples:
    """How the images of a request are sampled."""

    spp: int
    seed: int
    sampler: str
    parts: Parts | None = None


def image_of(
    view: View, index: int, samples: Samples, progress: Progress
) -> NDArray[np.float32]:
    """The image of view `index` of a request, denoised if the view asks for it."""
    passes = image_passes(
        view.camera, samples.spp, samples.seed, index, samples.sampler
    )
    image, image_guides = raw_image(view, passes, samples.parts, progress)
    if not view.denoised:
        return image
    guides = other_guides(view, GUIDE_SAMPLES, samples.seed, index, parts=samples.parts)
    return denoise_parts(
        image, guides, image_guides, light_of_parts(samples.parts, view.lens)
    )


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
    image_guides = None
    if view.denoised and built.integrator.aov_names():
        image_guides = Guides.from_means(channels, spp, parts)
    elif view.denoised and built.follows_rays():
        image_guides = render_guides(*view.optics, passes, parts)
    return in_channels(image, camera).astype(np.float32), image_guides


def _render_parts(
    built: BuiltScene, sensor: Any, camera: Camera, count: int, seed: int, parts: Parts
) -> Float:
    """The images (P, H, W, C) of the parts of an aperture, from the samples with which Mitsuba renders the image.

    If the integrator gives guides, their features follow after the radiance, and the share of each part. Raises
    BackendError for integrators whose samples are not known.
    """
    if not built.follows_rays():
        raise BackendError(
            "parts of an aperture need an integrator that follows camera rays, such as 'path'"
        )
    from twinlens.rendering.ray_generation import pixel_means  # sets up the backend

    ray, aperture = sensor.film_rays(count, seed)
    radiance, _, features = built.integrator.sample(
        built.mi_scene, sensor.sampler(), ray
    )
    channels = [*radiance, *features, mitsuba().Float(1.0)] if features else radiance
    return pixel_means(channels, count, camera, sensor.shares(parts, aperture))


def other_guides(
    view: View, count: int, seed: int, *key: int, parts: Parts | None = None
) -> Guides:
    """The guides of `count` samples per pixel; `seed` and `key` name their random stream."""
    seeds = seed_sequence(seed, _GUIDE_STREAM, *key)
    passes = passes_of(view.camera, count, seeds, PLAIN_SAMPLER)
    return render_guides(*view.optics, passes, parts)


def image_passes(
    camera: Camera, spp: int, seed: int, index: int, sampler: str
) -> list[Pass]:
    """The passes in which view `index` of a request is rendered."""
    seeds = seed_sequence(seed, _RENDER_STREAM, index)
    return list(passes_of(camera, spp, seeds, sampler))


def light_of_parts(parts: Parts | None, lens: Lens) -> Float | None:
    """The share of a lens's light that each part gets; None without parts."""
    if parts is None:
        return None
    aperture = require_paraxial(lens, "an image of the parts of an aperture").aperture
    return parts.light(aperture)[0]


@dataclass(frozen=True, eq=False)
class NoisyImage:
    """Linear radiance, float32 (H, W, 3) or (P, H, W, 3), and an estimate of the error of the whole image, (H, W, 3).

    The estimate is one random draw in each pixel, or in each 2x2 pixels if denoised: average its square over windows.
    It has a sign, because the channels share a part of their noise: for the noise of a sum of channels, sum the
    estimates of these channels, then average the square. It does not contain the error of an irradiance cache.
    """

    image: NDArray[np.float32]
    error: NDArray[np.float32]


class _Halves:
    """The sums of two independent halves of the samples of a view, and the guides of each."""

    def __init__(self, view: View, index: int, samples: Samples) -> None:
        self.view, self.index, self.samples = view, index, samples
        parts, camera = samples.parts, view.camera
        several = () if parts is None else (len(parts),)
        self.total = np.zeros((2, *several, camera.height, camera.width, 3))
        self.counts = np.zeros(2)
        self.image_guides: list[Guides | None] = [None, None]
        self.more_guides = [
            other_guides(
                view, GUIDE_SAMPLES // 2, samples.seed, index, half, parts=parts
            )
            for half in (0, 1)
            if view.denoised
        ]

    def add(self, half: int, count: int, seed: int, progress: Progress) -> None:
        """Render `count` more samples per pixel of one half."""
        passes = image_passes(
            self.view.camera, count, seed, self.index, self.samples.sampler
        )
        image, image_guides = raw_image(self.view, passes, self.samples.parts, progress)
        self.total[half] += count * image.astype(np.float64)
        self.counts[half] += count
        self.image_guides[half] = _joined(self.image_guides[half], image_guides)

    def estimate(self) -> NoisyImage:
        """The image of all samples, and the error that the difference of the halves shows."""
        mean = (self.total.sum(axis=0) / self.counts.sum()).astype(np.float32)
        first, second = self._halves_of_the_whole_aperture()
        if not self.view.denoised:
            # Var(A - B) = s^2 (1/n_A + 1/n_B) and Var(mean) = s^2 / (n_A + n_B), with s^2 that of one sample.
            scale = math.sqrt(self.counts.prod()) / self.counts.sum()
            return NoisyImage(mean, (first - second) * np.float32(scale))
        guides = self.more_guides[0] + self.more_guides[1]
        fractions = light_of_parts(self.samples.parts, self.view.lens)
        image = denoise_parts(mean, guides, _joined(*self.image_guides), fractions)
        difference = self._denoised_half(0, first) - self._denoised_half(1, second)
        error = difference / np.float32(_HALVES_PER_ERROR)
        enlarged = error.repeat(2, axis=0).repeat(2, axis=1)
        height, width = first.shape[:2]
        return NoisyImage(image, enlarged[:height, :width])

    def _halves_of_the_whole_aperture(self) -> NDArray[np.float32]:
        """The mean of each half of the samples, (2, H, W, 3): the parts of an aperture added up."""
        whole = self.total if self.samples.parts is None else self.total.sum(axis=1)
        means: Float = whole / self.counts[:, None, None, None]
        return means.astype(np.float32)

    def _denoised_half(self, half: int, image: NDArray[np.float32]) -> Any:
        """One half of the samples, at half the resolution, filtered by the fast network."""
        more_guides, image_guides = self.more_guides[half], self.image_guides[half]
        if self.samples.parts is not None:
            more_guides = more_guides.of_parts()
            image_guides = image_guides and image_guides.of_parts()
        coarse = image_guides and image_guides.binned()
        return denoise_image(binned(image), more_guides.binned(), coarse, fast=True)


def measured(
    views: Sequence[View],
    samples: Samples,
    enough: Callable[[Sequence[NoisyImage]], bool] = lambda _: True,
    progress: Progress | None = None,
) -> tuple[list[NoisyImage], int]:
    """The images of `views` with error estimates, and the samples per pixel used: doubled until `enough`, or until
    doubling would exceed `MAX_SPP`.
    """
    halves = [_Halves(view, i, samples) for i, view in enumerate(views)]
    spp, extra = 0, samples.spp
    while True:
        for half, count in enumerate((extra - extra // 2, extra // 2)):
            seed = derived_seed(samples.seed, _NOISE_STREAM, spp, half)
            for i, of_view in enumerate(halves):
                start = half / 2 + i / len(views) / 2
                report = partial_progress(progress, start, start + 1 / len(views) / 2)
                of_view.add(half, count, seed, report)
            spp += count
        images = [of_view.estimate() for of_view in halves]
        extra = spp
        if enough(images) or 2 * extra > MAX_SPP:
            return images, spp


def _joined(a: Guides | None, b: Guides | None) -> Guides | None:
    return a + b if a is not None and b is not None else a or b
