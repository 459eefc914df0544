"""Images with an estimate of their remaining rendering noise, and more samples until it is low enough.

The samples are rendered in two independent halves A and B. In raw images |A - B| / 2 estimates the standard deviation
of the mean. A denoised image is filtered from all samples; its halves are filtered separately, at half the resolution,
with a fast network and with guides from half of the guides' samples each, so that the estimate includes the noise of
the guides. The estimate is |A - B| / 1.62: noise alone would give 2 at the full resolution, and the filter's bias,
which halves share, gives less. At the full resolution, at four times the cost, the divisor was 1.59, chosen on fifteen
random and bundled views with 16 samples, and a small scene with 4. At half the resolution, it was chosen for the same
estimate on 24 random views, on which the two differ by up to 15 %. In the median over windows of 9x9 pixels, the
estimate is 0.69 to 1.30 times the true error on 28 other random views, and within 25 % of it on 23
(benchmarks/bench_noise_estimate.py).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Lens, Rig
from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.rendering.build import build
from twinlens.rendering.denoising import GUIDE_SAMPLES, denoise_image
from twinlens.rendering.guides import Guides, binned
from twinlens.rendering.radiance import (
    SAMPLERS,
    Progress,
    check_request,
    image_passes,
    other_guides,
    own_guides,
    partial_progress,
    render,
)
from twinlens.scenes import Scene
from twinlens.seeds import derived_seed

MAX_SPP = 1024
"""Limit of the doubled samples per pixel. A request for more is rendered without doubling."""

_NOISE_STREAM = 3
_HALVES_PER_ERROR = 1.62  # standard deviation of the difference of denoised halves, over the error of the whole


@dataclass(frozen=True, eq=False)
class NoisyImage:
    """Linear radiance and an estimate of its error, both float32 (H, W, 3).

    The estimate is one random draw in each pixel, or in each 2x2 pixels if denoised: average its square over windows.
    """

    image: NDArray[np.float32]
    error: NDArray[np.float32]


def render_measured(
    scene: Scene,
    rig: Rig,
    lens: Lens,
    spp: int,
    seed: int,
    *,
    denoise: bool = False,
    sampler: str = SAMPLERS[0],
    enough: Callable[[Sequence[NoisyImage]], bool] = lambda _: True,
    progress: Progress | None = None,
) -> tuple[list[NoisyImage], int]:
    """Render as `render`, with error estimates; double the samples until `enough`, or until doubling would exceed
    `MAX_SPP`.

    The progress of each round runs from 0 to 1.

    Returns one image per camera, and the samples per pixel used. Raises the errors of `render`, and InputError for
    spp < 2.
    """
    check_request(scene, rig, [lens], spp, seed, sampler)
    if spp < 2:
        raise InputError(f"an estimate of the noise needs spp >= 2, got {spp}")
    built = build(scene)
    views = list(zip(rig.cameras, rig.world_from_cams, strict=True))
    others = [
        [other_guides(built, *view, lens, GUIDE_SAMPLES // 2, seed, i, half) for half in range(2) if denoise]
        for i, view in enumerate(views)
    ]
    owns: list[list[Guides | None]] = [[None, None] for _ in views]
    totals = [np.zeros((2, camera.height, camera.width, 3)) for camera in rig.cameras]
    counts = np.zeros(2)
    extra = spp
    while True:
        for half, count in enumerate((extra - extra // 2, extra // 2)):
            half_seed = derived_seed(seed, _NOISE_STREAM, int(counts.sum()), half)
            report = partial_progress(progress, half / 2, (half + 1) / 2)
            images = render(scene, rig, lens, count, half_seed, sampler=sampler, progress=report)
            for i, (camera, pose) in enumerate(views):
                totals[i][half] += count * images[i].astype(np.float64)
                if denoise:
                    passes = image_passes(camera, count, half_seed, i, sampler)
                    owns[i][half] = _joined(owns[i][half], own_guides(built, camera, pose, lens, passes))
            counts[half] += count
        found = [_measured(*each, counts) for each in zip(totals, others, owns, strict=True)]
        extra = int(counts.sum())
        if enough(found) or 2 * extra > MAX_SPP:
            return found, extra


def _measured(
    total: Float, others: Sequence[Guides], owns: Sequence[Guides | None], counts: NDArray[np.float64]
) -> NoisyImage:
    """The image of one camera, from the sums of the two halves of its samples, and their guides."""
    mean = (total.sum(axis=0) / counts.sum()).astype(np.float32)
    a, b = (total / counts[:, None, None, None]).astype(np.float32)
    if not others:
        return NoisyImage(mean, np.abs(a - b) * np.float32(math.sqrt(counts.prod()) / counts.sum()))
    denoised = denoise_image(mean, others[0] + others[1], _joined(*owns))
    small = [
        denoise_image(binned(image), other.binned(), own and own.binned(), fast=True)
        for image, other, own in zip((a, b), others, owns, strict=True)
    ]
    error = np.abs(small[0] - small[1]) / np.float32(_HALVES_PER_ERROR)
    return NoisyImage(denoised, error.repeat(2, axis=0).repeat(2, axis=1)[: len(a), : a.shape[1]])


def _joined(a: Guides | None, b: Guides | None) -> Guides | None:
    return a + b if a is not None and b is not None else a or b
