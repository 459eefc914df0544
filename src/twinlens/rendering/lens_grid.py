"""Many lenses from one set of light paths: every aperture and focus of a list, at little more than one image's cost.

A ray through aperture point a that a camera of vergence k sees at film position x is seen by a camera of vergence k' at
x + (k' - k) a: a pure shift. So paths are traced once, over a padded film and over concentric annuli of the aperture,
and gathered once for each focus. A lens is the area-weighted sum of its annuli:

    annuli -> vergence groups -> paths -> radiance -> one gather per focus -> annulus images -> lens images

Apertures other than disks, lens distortion, integrators that do not follow camera rays, and the scalar backend cannot
share paths. Those lenses are rendered separately.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Disk, Lens, Rig
from twinlens.camera.lens import check_lens
from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.rendering.annuli import (
    STRATIFIED_EXPONENT,
    ApertureAnnulus,
    area_fraction,
    plan_annuli,
    shared_sample_count,
    vergence_groups,
)
from twinlens.rendering.backends import backend, mitsuba
from twinlens.rendering.build import BuiltScene, build
from twinlens.rendering.radiance import Progress, check_request, check_view, partial_progress, render
from twinlens.scenes import Scene
from twinlens.seeds import derived_seed, seed_sequence

Image = NDArray[np.float32]

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
    found: dict[int, _LensImages] = {}
    cut = len(shared) / (len(shared) + 4 * len(separate))  # approximate ratio of their times
    if shared:
        report = _subrange(progress, 0.0, cut)
        found |= _render_shared(scene, rig, lenses, shared, int(spp), int(seed), sampler, report)
    for place, i in enumerate(separate):
        report = _subrange(
            progress, cut + (1 - cut) * place / len(separate), cut + (1 - cut) * (place + 1) / len(separate)
        )
        found[i] = _render_separately(scene, rig, lenses[i], int(spp), _seed_of(seed, i), sampler, report)
    results = [found[i] for i in range(len(lenses))]
    error = np.sqrt([result.variance for result in results])
    return LensGrid(tuple(result.images for result in results), error, sum(result.rays for result in results))


@dataclass(frozen=True, eq=False)
class _LensImages:
    """One lens: one image and its mean variance per camera, and the rays traced for it."""

    images: list[Image]
    variance: list[float]
    rays: int


def _shareable(built: BuiltScene, rig: Rig, lenses: Sequence[Lens]) -> list[int]:
    """Indices of the lenses that can share paths."""
    possible = (
        backend().is_jit
        and all(camera.distortion is None for camera in rig.cameras)
        and isinstance(built.integrator, mitsuba().SamplingIntegrator)
    )
    return [
        i
        for i, lens in enumerate(lenses)
        if possible and (isinstance(lens.aperture, Disk) or lens.aperture_diameter == 0)
    ]


def _seed_of(seed: int, index: int) -> int:
    return derived_seed(int(seed), _GRID_STREAM, index)


def _subrange(progress: Progress | None, start: float, end: float) -> Progress | None:
    if progress is None:
        return None
    return lambda fraction: progress(start + (end - start) * fraction)


def _render_separately(
    scene: Scene, rig: Rig, lens: Lens, spp: int, seed: int, sampler: str, progress: Progress | None
) -> _LensImages:
    """One lens, in two halves a, b whose difference gives the variance n_a n_b / n^2 (a - b)^2."""
    pixels = sum(camera.width * camera.height for camera in rig.cameras)
    counts = [spp - spp // 2, spp // 2] if spp > 1 else [1]
    halves = []
    for half, count in enumerate(counts):
        report = partial_progress(progress, half, len(counts))
        halves.append(render(scene, rig, lens, count, _seed_of(seed, half), sampler=sampler, progress=report))
    images, variance = [], []
    for several in zip(*halves, strict=True):
        mean = sum(count * one.astype(np.float64) for count, one in zip(counts, several, strict=True)) / spp
        images.append(mean.astype(np.float32))
        variance.append(_variance_of_halves(several, counts))
    return _LensImages(images, variance, pixels * spp)


def _variance_of_halves(halves: Sequence[Image], counts: Sequence[int]) -> float:
    if len(halves) < 2:
        return np.nan
    squares = (halves[0].astype(np.float64) - halves[1]) ** 2
    return float(counts[0] * counts[1] / sum(counts) ** 2 * squares[np.isfinite(squares)].mean())


def _render_shared(
    scene: Scene,
    rig: Rig,
    lenses: Sequence[Lens],
    shared: Sequence[int],
    spp: int,
    seed: int,
    sampler: str,
    progress: Progress | None,
) -> dict[int, _LensImages]:
    """The lenses with these indices, from one set of paths per camera. All rays are counted with the first lens."""
    chosen = [lenses[i] for i in shared]
    stratified = sampler != "independent"
    annuli = plan_annuli(
        chosen, shared_sample_count(spp) if stratified else spp, STRATIFIED_EXPONENT if stratified else 1.0
    )
    built = build(scene)
    cameras = []
    for index, (camera, pose) in enumerate(zip(rig.cameras, rig.world_from_cams, strict=True)):
        seeds = seed_sequence(seed, _GRID_STREAM, index, 0)
        report = partial_progress(progress, index, len(rig))
        cameras.append(_trace_camera(built, camera, pose, sampler, chosen, annuli, seeds, report))
    rays = sum(one.rays for one in cameras)
    return {
        i: _LensImages(
            [one.images[n] for one in cameras],
            [one.variance[n] for one in cameras],
            rays if n == 0 else 0,
        )
        for n, i in enumerate(shared)
    }


def _trace_camera(
    built: BuiltScene,
    camera: Camera,
    pose: Float,
    sampler: str,
    lenses: Sequence[Lens],
    annuli: Sequence[ApertureAnnulus],
    seeds: np.random.SeedSequence,
    report: Progress,
) -> _LensImages:
    """One camera, all lenses: one image and variance per lens."""
    from twinlens.rendering.shared_paths import Tracer

    tracer = Tracer(built, camera, pose, sampler)
    totals = [np.zeros((camera.height, camera.width, 3)) for _ in lenses]
    variance = np.zeros(len(lenses))
    work, done = sum(annulus.spp for annulus in annuli), 0
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
        report(done / work)
    return _LensImages([total.astype(np.float32) for total in totals], list(variance), tracer.rays)
