"""Many lenses from one set of light paths: every aperture and focus of a list, at little more than one image's cost.

A ray through aperture point a that a camera of vergence k sees at film position x is seen by one of vergence k' at
x + (k' - k) a: a pure shift. So paths are traced once, over a padded film and over concentric rings of the aperture,
are gathered once for every focus, and a lens is the area-weighted sum of its rings:

    rings -> sheaves of vergences -> paths -> radiance -> one gather a focus -> ring images -> (areas) -> lens images

Shapes other than disks, lens distortion, integrators that do not follow camera rays and the scalar backend share
nothing: such lenses are rendered by themselves, beside those that share.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Disk, Lens, Rig
from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.rendering.backends import backend, mitsuba
from twinlens.rendering.build import BuiltScene, build
from twinlens.rendering.radiance import Progress, check_lens, check_request, check_view, part_of, render
from twinlens.rendering.rings import STRATIFIED_FALL, Ring, plan_rings, samples_that_land, share_of, sheaves
from twinlens.scenes import Scene

Image = NDArray[np.float32]

_GRID_STREAM = 1


@dataclass(frozen=True, eq=False)
class LensGrid(Sequence[list[Image]]):
    """`grid[i_lens][i_camera]`, float32 (H, W, 3) linear radiance.

    images : one list of images a lens.
    standard_error : (lenses, cameras), root mean square over the pixels and channels of each image, read off halves
        of its samples. An upper bound: right for noise, up to about 1.5 times too large where strata cancel errors.
        NaN where one sample a pixel was all.
    rays : how many light paths were traced for all of them.
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
    """Photograph `scene` with every camera of `rig` through every lens, from one set of light paths.

    Parameters
    ----------
    lenses : sequence of lenses
        Any mix of apertures and vergences, pinholes and bare holes included. Those with disk apertures share paths,
        the others are rendered by themselves.
    spp : int
        Samples a pixel of the direct image whose error each lens's image should reach. Every pixel gets at least one
        sample of every ring.
    seed, progress
        As in `render`.
    sampler : str
        Film positions and aperture points are always stratified; this names what draws all that follows along a path.

    Returns
    -------
    LensGrid: images[i_lens][i_camera], float32 (H, W, 3), and their standard errors. The bytes depend on the arguments
    alone, whatever the number of threads.

    Raises InputError for an empty list, and what `render` raises.
    """
    check_view(scene, rig)
    check_request(spp, seed, sampler)
    if not isinstance(lenses, Sequence) or not lenses:
        raise InputError("render_lens_grid needs a list of at least one lens")
    for lens in lenses:
        check_lens(lens)
    shared = _sharing(build(scene), rig, lenses)
    alone = [i for i in range(len(lenses)) if i not in shared]
    found: dict[int, _Shots] = {}
    cut = len(shared) / (len(shared) + 4 * len(alone))  # about how their times compare
    if shared:
        report = _stretch(progress, 0.0, cut)
        found |= _together(scene, rig, lenses, shared, int(spp), int(seed), sampler, report)
    for place, i in enumerate(alone):
        report = _stretch(progress, cut + (1 - cut) * place / len(alone), cut + (1 - cut) * (place + 1) / len(alone))
        found[i] = _alone(scene, rig, lenses[i], int(spp), _seed_of(seed, i), sampler, report)
    shots = [found[i] for i in range(len(lenses))]
    error = np.sqrt([shot.variance for shot in shots])
    return LensGrid(tuple(shot.images for shot in shots), error, sum(shot.rays for shot in shots))


@dataclass(frozen=True, eq=False)
class _Shots:
    """One lens: its images and their mean variances, one a camera, and the rays traced for it."""

    images: list[Image]
    variance: list[float]
    rays: int


def _sharing(built: BuiltScene, rig: Rig, lenses: Sequence[Lens]) -> list[int]:
    """Which lenses can share paths."""
    possible = (
        backend().is_jit
        and all(camera.distortion is None for camera in rig.cameras)
        and isinstance(built.integrator, mitsuba().SamplingIntegrator)
    )
    return [i for i, lens in enumerate(lenses) if possible and (isinstance(lens.aperture, Disk) or _is_point(lens))]


def _is_point(lens: Lens) -> bool:
    return lens.aperture_diameter == 0


def _seed_of(seed: int, index: int) -> int:
    return int(np.random.SeedSequence(int(seed), spawn_key=(_GRID_STREAM, index)).generate_state(1)[0])


def _stretch(progress: Progress | None, start: float, end: float) -> Progress | None:
    if progress is None:
        return None
    return lambda fraction: progress(start + (end - start) * fraction)


def _alone(scene: Scene, rig: Rig, lens: Lens, spp: int, seed: int, sampler: str, progress: Progress | None) -> _Shots:
    """A lens by itself, in two halves whose difference tells the error: n_a n_b / n^2 (a - b)^2."""
    pixels = sum(camera.width * camera.height for camera in rig.cameras)
    counts = [spp - spp // 2, spp // 2] if spp > 1 else [1]
    halves = []
    for half, count in enumerate(counts):
        report = part_of(progress, half, len(counts))
        halves.append(render(scene, rig, lens, count, _seed_of(seed, half), sampler=sampler, progress=report))
    images, variance = [], []
    for several in zip(*halves, strict=True):
        mean = sum(count * one.astype(np.float64) for count, one in zip(counts, several, strict=True)) / spp
        images.append(mean.astype(np.float32))
        variance.append(_of_halves(several, counts))
    return _Shots(images, variance, pixels * spp)


def _of_halves(halves: Sequence[Image], counts: Sequence[int]) -> float:
    if len(halves) < 2:
        return np.nan
    squares = (halves[0].astype(np.float64) - halves[1]) ** 2
    return float(counts[0] * counts[1] / sum(counts) ** 2 * squares[np.isfinite(squares)].mean())


def _together(
    scene: Scene,
    rig: Rig,
    lenses: Sequence[Lens],
    shared: Sequence[int],
    spp: int,
    seed: int,
    sampler: str,
    progress: Progress | None,
) -> dict[int, _Shots]:
    """The lenses of these numbers from one set of paths a camera. The rays are counted with the first."""
    chosen = [lenses[i] for i in shared]
    stratified = sampler != "independent"
    rings = plan_rings(chosen, samples_that_land(spp) if stratified else spp, STRATIFIED_FALL if stratified else 1.0)
    built = build(scene)
    columns = []
    for index, (camera, pose) in enumerate(zip(rig.cameras, rig.world_from_cams, strict=True)):
        seeds = np.random.SeedSequence(seed, spawn_key=(_GRID_STREAM, index, 0))
        report = part_of(progress, index, len(rig))
        columns.append(_column(built, camera, pose, sampler, chosen, rings, seeds, report))
    rays = sum(column.rays for column in columns)
    return {
        i: _Shots(
            [column.images[n] for column in columns],
            [column.variance[n] for column in columns],
            rays if n == 0 else 0,
        )
        for n, i in enumerate(shared)
    }


def _column(
    built: BuiltScene,
    camera: Camera,
    pose: Float,
    sampler: str,
    lenses: Sequence[Lens],
    rings: Sequence[Ring],
    seeds: np.random.SeedSequence,
    report: Progress,
) -> _Shots:
    """One camera, all lenses: images and variances one a lens."""
    from twinlens.rendering.sheaf import Tracer

    tracer = Tracer(built, camera, pose, sampler)
    totals = [np.zeros((camera.height, camera.width, 3)) for _ in lenses]
    variance = np.zeros(len(lenses))
    work, done = sum(ring.spp for ring in rings), 0
    for ring in rings:
        for sheaf in sheaves(ring, camera):
            mean = tracer.trace(ring, sheaf, seeds)
            for i, lens in enumerate(lenses):
                share = share_of(ring, lens)
                vergence = lens.vergence if ring.outer else 0.0
                if share and vergence in sheaf.vergences:
                    focus = sheaf.vergences.index(vergence)
                    totals[i] += share * mean.image(focus)
                    variance[i] += share**2 * mean.variance(focus)
        done += ring.spp
        report(done / work)
    return _Shots([total.astype(np.float32) for total in totals], list(variance), tracer.rays)
