"""Images: the mean radiance over each pixel, rendered in passes, with one seed per camera and pass."""

import functools
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens, Pinhole, Rig
from twinlens.camera.lens import check_lens
from twinlens.errors import InputError, check_int, check_known
from twinlens.geometry import Float
from twinlens.rendering.backends import backend, mitsuba
from twinlens.rendering.build import BuiltScene, build
from twinlens.rendering.denoising import GUIDE_SAMPLES, denoise_image
from twinlens.rendering.guides import Guides, render_guides
from twinlens.rendering.sensors import make_sensor
from twinlens.scenes import Scene
from twinlens.seeds import seed_sequence

Progress = Callable[[float], None]
Pass = tuple[str, int, int]
"""Sampler, samples per pixel, seed."""

SAMPLERS = ("multijitter", "independent", "stratified", "orthogonal", "ldsampler")
RAYS_PER_PASS = 1 << 23
_RENDER_STREAM, _GUIDE_STREAM = 0, 2
_PINHOLE = Pinhole()


def render(
    scene: Scene,
    rig: Rig,
    lens: Lens = _PINHOLE,
    spp: int = 64,
    seed: int = 0,
    *,
    denoise: bool = False,
    sampler: str = "multijitter",
    progress: Progress | None = None,
) -> list[NDArray[np.float32]]:
    """Render `scene` with every camera of `rig` through `lens`.

    Parameters
    ----------
    spp : int
        Samples per pixel, >= 1. Exactly this number is drawn.
    seed : int
        >= 0. Each camera and pass has its own random stream. Cameras with equal noise would have a false match at
        disparity zero.
    denoise : bool
        Remove the renderer's noise with Open Image Denoise, guided by albedo and normals that are rendered through the
        same lens, for each camera apart (`twinlens.rendering.denoising`). Denoised images are biased: without it, the
        expectation of each pixel is exact. The scalar backend has no guides behind mirrors and glass.
    sampler : str
        Mitsuba's sampler within a pass. With 16 samples and a wide aperture, `multijitter` has half the mean square
        error of `independent` at the same cost.
    progress : callable, optional
        Called with the fraction done, in (0, 1], after each pass.

    Returns
    -------
    list of float32 (H, W, 3)
        Linear sRGB radiance per camera, averaged over the area of each pixel.

    Raises
    ------
    InputError
        For an invalid spp, seed, sampler or lens.
    BackendError
        When this machine's backend does not support the camera or the lens.
    """
    check_request(scene, rig, [lens], spp, seed, sampler)
    built = build(scene)
    images = []
    for index, (camera, pose) in enumerate(zip(rig.cameras, rig.world_from_cams, strict=True)):
        report = partial_progress(progress, index / len(rig), (index + 1) / len(rig))
        total = np.zeros((camera.height, camera.width, 3))
        done = 0
        for kind, count, stream in image_passes(camera, int(spp), int(seed), index, sampler):
            sensor = make_sensor(camera, pose, lens, count, kind)
            image = built.integrator.render(built.mi_scene, sensor, seed=stream, spp=count)
            total += count * np.asarray(image, dtype=np.float64)
            done += count
            report(done / spp)
        mean = (total / spp).astype(np.float32)
        if denoise:
            own = own_guides(built, camera, pose, lens, image_passes(camera, int(spp), int(seed), index, sampler))
            mean = denoise_image(mean, other_guides(built, camera, pose, lens, GUIDE_SAMPLES, int(seed), index), own)
        images.append(mean)
    return images


def own_guides(built: BuiltScene, camera: Camera, pose: Float, lens: Lens, passes: Iterable[Pass]) -> Guides | None:
    """The guides of an image's own samples, from its passes. None if they are not known."""
    known = backend().is_jit and isinstance(built.integrator, mitsuba().SamplingIntegrator)
    return render_guides(built, camera, pose, lens, passes) if known else None


def other_guides(
    built: BuiltScene, camera: Camera, pose: Float, lens: Lens, count: int, seed: int, *key: int
) -> Guides:
    """The guides of `count` samples per pixel; `seed` and `key` name their random stream."""
    passes = _passes(camera, count, seed_sequence(seed, _GUIDE_STREAM, *key), SAMPLERS[0])
    return render_guides(built, camera, pose, lens, passes)


def image_passes(camera: Camera, spp: int, seed: int, index: int, sampler: str) -> Iterator[Pass]:
    """The passes in which `render` renders camera `index` of a rig."""
    return _passes(camera, spp, seed_sequence(seed, _RENDER_STREAM, index), sampler)


def check_request(scene: Scene, rig: Rig, lenses: Iterable[Lens], spp: int, seed: int, sampler: str) -> None:
    """Raise InputError for invalid arguments of `render`."""
    check_view(scene, rig)
    for lens in lenses:
        check_lens(lens)
    check_int("spp", spp, 1)
    check_int("seed", seed, 0)
    check_known("sampler", sampler, SAMPLERS)


def check_view(scene: Scene, rig: Rig) -> None:
    """Raise InputError unless the arguments are a Scene and a Rig."""
    if not isinstance(scene, Scene):
        raise InputError(f"scene must be a Scene, got {scene!r:.60}; load_scene makes one from a name or a file")
    if not isinstance(rig, Rig):
        raise InputError(f"rig must be a Rig, got {rig!r:.60}; Rig.stereo makes one from a camera, Rig from several")


def _passes(camera: Camera, spp: int, seeds: np.random.SeedSequence, sampler: str) -> Iterator[Pass]:
    """(sampler, samples per pixel, seed) of each pass; `spp` samples in total, bounded in memory.

    Mitsuba's samplers round sample counts, so each pass has a power of two that its sampler does not round. The rest is
    drawn independently.
    """
    largest = max(1, RAYS_PER_PASS // (camera.width * camera.height))
    remaining = spp
    while remaining:
        powers = (1 << power for power in reversed(range(min(remaining, largest).bit_length())))
        count = next((count for count in powers if sampler_supports(sampler, count)), None)
        kind, size = ("independent", min(remaining, largest)) if count is None else (sampler, count)
        yield kind, size, int(seeds.spawn(1)[0].generate_state(1)[0])
        remaining -= size


@functools.cache
def sampler_supports(sampler: str, count: int) -> bool:
    """Whether a Mitsuba sampler supports `count` samples per pixel without rounding."""
    return bool(mitsuba().load_dict({"type": sampler, "sample_count": count}).sample_count() == count)


def partial_progress(progress: Progress | None, start: float, end: float) -> Progress:
    """Progress of a part, reported as progress of the whole from `start` to `end`."""
    if progress is None:
        return lambda _: None
    return lambda fraction: progress(start + (end - start) * fraction)
