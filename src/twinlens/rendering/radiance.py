"""Images of a scene by the cameras of a rig: `render`, and `render_measured` with estimates of their noise.

A request is checked, then the scene is built for each band of light (`rendering.views`), then each view is rendered
(`rendering.images`), and the views of a camera are added up.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Lens, Pinhole, Rig
from twinlens.camera.parts import Parts
from twinlens.errors import InputError
from twinlens.rendering import views
from twinlens.rendering.images import NoisyImage, Samples, image_of, measured
from twinlens.rendering.requests import (
    Progress,
    check_request,
    lens_of_each_camera,
    partial_progress,
    split_bands,
)
from twinlens.rendering.samplers import default_sampler
from twinlens.scenes import Scene

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
    scenes = split_bands(scene, rig)
    lenses = lens_of_each_camera(lens, rig)
    sampler = sampler or default_sampler(denoise)
    check_request(scenes, rig, lenses, spp, seed, sampler, parts)
    shown = views.views_of(scenes, rig, lenses, int(seed), denoise)
    samples = Samples(int(spp), int(seed), sampler, parts)
    images = []
    for index, view in enumerate(shown):
        report = partial_progress(
            progress, index / len(shown), (index + 1) / len(shown)
        )
        images.append(image_of(view, index, samples, report))
    return [views.sum_of(of_camera) for of_camera in views.by_camera(rig, images)]


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
    scenes = split_bands(scene, rig)
    lenses = lens_of_each_camera(lens, rig)
    sampler = sampler or default_sampler(denoise)
    check_request(scenes, rig, lenses, spp, seed, sampler, parts)
    if spp < 2:
        raise InputError(f"an estimate of the noise needs spp >= 2, got {spp}")
    shown = views.views_of(scenes, rig, lenses, int(seed), denoise)
    images, used = measured(
        shown,
        Samples(int(spp), int(seed), sampler, parts),
        enough=lambda images: enough(_joined(rig, images)),
        progress=progress,
    )
    return _joined(rig, images), used


def _joined(rig: Rig, images: Sequence[NoisyImage]) -> list[NoisyImage]:
    """The images of the cameras, from those of their views, whose errors are independent."""
    joined = []
    for of_camera in views.by_camera(rig, images):
        if len(of_camera) == 1:
            joined += of_camera
            continue
        image = views.sum_of([noisy.image for noisy in of_camera])
        error = views.sum_of([noisy.error for noisy in of_camera])
        joined.append(NoisyImage(image, error))
    return joined
