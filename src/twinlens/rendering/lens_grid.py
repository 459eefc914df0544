"""Many lenses from one set of light paths: every aperture and focus of a list, at little more than one image's cost.

A ray through aperture point a that a camera of vergence k sees at film position x is seen by a camera of vergence k' at
x + (k' - k) a: a pure shift. So paths are traced once, over a padded film and over concentric annuli of the aperture,
and gathered once for each focus. A lens is the area-weighted sum of its annuli.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Disk, Lens, Rig
from twinlens.camera.lens import check_lens
from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.rendering.annuli import area_fraction, plan_annuli, shared_sample_count, vergence_groups
from twinlens.rendering.backends import backend, mitsuba
from twinlens.rendering.build import BuiltScene, build
from twinlens.rendering.denoising import GUIDE_SAMPLES, denoise_image
from twinlens.rendering.radiance import Progress, check_request, check_view, other_guides, partial_progress, render
from twinlens.scenes import Scene
from twinlens.seeds import derived_seed, seed_sequence

Image = NDArray[np.float32]
_LensImages = tuple[list[Image], list[float]]  # one image and its mean variance per camera

_GRID_STREAM = 1


@dataclass(frozen=True, eq=False)
class LensGrid(Sequence[list[Image]]):
    """`grid[i_lens][i_camera]`, float32 (H, W, 3) linear radiance.

    images : one list of images per lens.
    standard_error : float64 (lenses, cameras), root mean square over the pixels and channels of each image, estimated
        from halves of its samples. An upper bound: exact for noise, up to about 1.5 times too large where
        stratification cancels errors. NaN for one sample per pixel.
    rays : number of light paths traced for all images.
    """

    images: tuple[list[Image], ...]
    standard_error: Float
    rays: int

    def __getitem__(self, index: Any) -> Any:
        return self.images[index]

    def __len__(self) -> int:
        return len(self.images)


def render_lens_grid(
    scene: Scene,
    rig: Rig,
    lenses: Sequence[Lens],
    spp: int = 64,
    seed: int = 0,
    *,
    denoise: bool = False,
    sampler: str = "multijitter",
    progress: Progress | None = None,
) -> LensGrid:
    """Render `scene` with every camera of `rig` through every lens, from one set of light paths.

    Parameters
    ----------
    lenses : sequence of lenses
        Any mix of apertures and vergences, including pinholes and bare apertures. Lenses with disk apertures share
        paths; others are rendered separately.
    spp : int
        Samples per pixel of the directly rendered image whose error each lens's image should reach. Every pixel gets at
        least one sample of every annulus.
    seed, progress
        As in `render`.
    denoise : bool
        As in `render`, with guides for each lens and camera. Standard errors are those before denoising.
    sampler : str
        Mitsuba's sampler for the light paths. Film positions and aperture points are always stratified.

    Returns
    -------
    LensGrid
        images[i_lens][i_camera], float32 (H, W, 3), and their standard errors. The bytes depend on the arguments only,
        not on the number of threads.

    Raises
    ------
    InputError
        For an empty list of lenses, and as `render`.
    """
    check_view(scene, rig)
    check_request(spp, seed, sampler)
    if not isinstance(lenses, Sequence) or not lenses:
        raise InputError("render_lens_grid needs a list of at least one lens")
    for lens in lenses:
        check_lens(lens)
    shared = _shareable(build(scene), rig, lenses)
    separate = [i for i in range(len(lenses)) if i not in shared]
    cut = len(shared) / (len(shared) + 4 * len(separate))  # approximate ratio of their times
    found: dict[int, _LensImages] = {}
    rays = 0
    if shared:
        report = partial_progress(progress, 0.0, cut)
        chosen = [lenses[i] for i in shared]
        results, rays = _render_shared(build(scene), rig, chosen, int(spp), int(seed), sampler, report)
        found |= zip(shared, results, strict=True)
    for place, i in enumerate(separate):
        start, end = (cut + (1 - cut) * (place + step) / len(separate) for step in (0, 1))
        report = partial_progress(progress, start, end)
        own_seed = derived_seed(int(seed), _GRID_STREAM, i)
        found[i] = _render_separately(scene, rig, lenses[i], int(spp), own_seed, sampler, report)
        rays += int(spp) * sum(camera.width * camera.height for camera in rig.cameras)
    if denoise:
        for i, (raw, _) in found.items():
            views = list(zip(raw, rig.cameras, rig.world_from_cams, strict=True))
            for index, (image, camera, pose) in enumerate(views):
                guides = other_guides(build(scene), camera, pose, lenses[i], 2 * GUIDE_SAMPLES, int(seed), index, i)
                raw[index] = denoise_image(image, guides)
    images, variance = zip(*(found[i] for i in range(len(lenses))), strict=True)
    return LensGrid(images, np.sqrt(variance), rays)


def _shareable(built: BuiltScene, rig: Rig, lenses: Sequence[Lens]) -> list[int]:
    """Indices of the lenses that can share paths: disk apertures, where no other condition forbids it.

    The scalar backend, lens distortion and integrators that do not follow camera rays cannot share paths.
    """
    if not (
        backend().is_jit
        and all(camera.distortion is None for camera in rig.cameras)
        and isinstance(built.integrator, mitsuba().SamplingIntegrator)
    ):
        return []
    return [i for i, lens in enumerate(lenses) if isinstance(lens.aperture, Disk) or lens.aperture_diameter == 0]


def _render_separately(
    scene: Scene, rig: Rig, lens: Lens, spp: int, seed: int, sampler: str, progress: Progress
) -> _LensImages:
    """One lens, in two halves a, b whose difference gives the variance n_a n_b / n^2 (a - b)^2."""
    counts = [spp - spp // 2, spp // 2] if spp > 1 else [1]
    halves = []
    for half, count in enumerate(counts):
        report = partial_progress(progress, half / len(counts), (half + 1) / len(counts))
        half_seed = derived_seed(seed, _GRID_STREAM, half)
        halves.append(render(scene, rig, lens, count, half_seed, sampler=sampler, progress=report))
    images, variance = [], []
    for several in zip(*halves, strict=True):
        mean = sum(count * one.astype(np.float64) for count, one in zip(counts, several, strict=True)) / spp
        images.append(mean.astype(np.float32))
        squares = (several[0].astype(np.float64) - several[-1]) ** 2
        known = spp > 1
        variance.append(math.prod(counts) / spp**2 * squares[np.isfinite(squares)].mean() if known else math.nan)
    return images, variance


def _render_shared(
    built: BuiltScene, rig: Rig, lenses: Sequence[Lens], spp: int, seed: int, sampler: str, progress: Progress
) -> tuple[list[_LensImages], int]:
    """All lenses from one set of paths per camera, and the number of paths."""
    from twinlens.rendering.shared_paths import Tracer  # sets up the backend

    independent = sampler == "independent"
    annuli = plan_annuli(lenses, spp, 1.0) if independent else plan_annuli(lenses, shared_sample_count(spp))
    results: list[_LensImages] = [([], []) for _ in lenses]
    work, done, rays = len(rig) * sum(annulus.spp for annulus in annuli), 0, 0
    for index, (camera, pose) in enumerate(zip(rig.cameras, rig.world_from_cams, strict=True)):
        seeds = seed_sequence(seed, _GRID_STREAM, index, 0)
        tracer = Tracer(built, camera, pose, sampler)
        totals = np.zeros((len(lenses), camera.height, camera.width, 3))
        variance = np.zeros(len(lenses))
        for annulus in annuli:
            for group in vergence_groups(annulus, camera):
                mean = tracer.trace(annulus, group, seeds)
                for i, lens in enumerate(lenses):
                    share = area_fraction(annulus, lens)
                    vergence = lens.vergence if annulus.outer else 0.0
                    if share and vergence in group.vergences:
                        focus = group.vergences.index(vergence)
                        totals[i] += share * mean.image(focus)
                        variance[i] += share**2 * mean.variance(focus)
            done += annulus.spp
            progress(done / work)
        for i, (images, variances) in enumerate(results):
            images.append(totals[i].astype(np.float32))
            variances.append(variance[i])
        rays += tracer.rays
    return results, rays
