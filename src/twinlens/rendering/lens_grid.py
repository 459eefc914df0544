"""Many lenses from one set of light paths: every aperture and focus of a list, at little more than one image's cost.

A ray through aperture point a that a camera of vergence k sees at film position x is seen by one of vergence k' at
x + (k' - k) a: a pure shift. So rays are drawn once, uniform over a padded film and over concentric rings of the
aperture, each is splatted once for every focus, and a lens is the area-weighted sum of its rings:

    rings x passes -> rays -> radiance -> one splat a focus -> ring images -> (areas) -> lens images

Sums are kept in 64-bit fixed point, whose addition does not depend on order, so that bytes repeat.
"""

import math
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
from twinlens.rendering.radiance import RAYS_A_PASS, Progress, check_lens, check_request, check_view, part_of, render
from twinlens.rendering.rings import FEWEST_PASSES, STRATIFIED_FALL, Ring, plan_rings, sample_ring, share_of
from twinlens.rendering.strata import shared_strata
from twinlens.rendering.tally import FIXED_POINT, RingMean
from twinlens.scenes import Scene

Image = NDArray[np.float32]

_GRID_STREAM = 1
_BRIGHTEST = 1e6


@dataclass(frozen=True, eq=False)
class LensGrid(Sequence[list[Image]]):
    """`grid[i_lens][i_camera]`, float32 (H, W, 3) linear radiance.

    images : one list of images a lens.
    standard_error : (lenses, cameras), root mean square over the pixels and channels of each image; NaN where only one
        pass was made.
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
        Any mix of disk apertures and vergences, pinholes and bare holes included.
    spp : int
        Samples a pixel of the direct image whose error each lens's image should reach.
    seed, sampler, progress
        As in `render`. With `multijitter` sample m has one place in the pixel and in the aperture for all pixels of a
        pass, which keeps its strata at every focus: errors are as small as those of direct images, but neighbouring
        pixels share what the lens does to them (a highlight far out of focus is drawn in dots, not in grain).

    Returns
    -------
    LensGrid: images[i_lens][i_camera], float32 (H, W, 3), and their standard errors.

    Where paths cannot be shared (the scalar backend, other aperture shapes, lens distortion, an integrator that does
    not follow camera rays), each lens is rendered by itself.
    Raises InputError for an empty list, and what `render` raises.
    """
    check_view(scene, rig)
    check_request(spp, seed, sampler)
    if not isinstance(lenses, Sequence) or not lenses:
        raise InputError("render_lens_grid needs a list of at least one lens")
    for lens in lenses:
        check_lens(lens)
    built = build(scene)
    if not _can_share(built, rig, lenses):
        return _one_by_one(scene, rig, lenses, spp, seed, sampler, progress)
    rings = plan_rings(lenses, spp, 1.0 if sampler == "independent" else STRATIFIED_FALL)
    columns = []
    for index, (camera, pose) in enumerate(zip(rig.cameras, rig.world_from_cams, strict=True)):
        seeds = np.random.SeedSequence(int(seed), spawn_key=(_GRID_STREAM, index))
        tracer = _Tracer(built, camera, pose, sampler, _largest_shift(camera, lenses))
        columns.append(_column(tracer, lenses, rings, seeds, part_of(progress, index, len(rig))))
    images = tuple([column.images[i] for column in columns] for i in range(len(lenses)))
    error = np.array([[column.error[i] for column in columns] for i in range(len(lenses))])
    return LensGrid(images, error, sum(column.rays for column in columns))


def _can_share(built: BuiltScene, rig: Rig, lenses: Sequence[Lens]) -> bool:
    return (
        backend().is_jit
        and all(isinstance(lens.aperture, Disk) for lens in lenses)
        and all(camera.distortion is None for camera in rig.cameras)
        and isinstance(built.integrator, mitsuba().SamplingIntegrator)
    )


def _one_by_one(
    scene: Scene, rig: Rig, lenses: Sequence[Lens], spp: int, seed: int, sampler: str, progress: Progress | None
) -> LensGrid:
    images = []
    for index, lens in enumerate(lenses):
        stream = int(np.random.SeedSequence(int(seed), spawn_key=(_GRID_STREAM, index)).generate_state(1)[0])
        report = part_of(progress, index, len(lenses))
        images.append(render(scene, rig, lens, spp, stream, sampler=sampler, progress=report))
    pixels = sum(camera.width * camera.height for camera in rig.cameras)
    return LensGrid(tuple(images), np.full((len(lenses), len(rig)), np.nan), pixels * spp * len(lenses))


def _largest_shift(camera: Camera, lenses: Sequence[Lens]) -> float:
    """How far any splat can land from its ray's own film position, in pixels."""
    middle = _middle_vergence(lenses)
    focal = max(camera.fx, camera.fy)
    return max(0.5 * lens.aperture_diameter * abs(lens.vergence - middle) * focal for lens in lenses)


def _middle_vergence(lenses: Sequence[Lens]) -> float:
    """The vergence at which film positions are drawn: midway, so that shifts are smallest. Pinholes have no say."""
    vergences = [lens.vergence for lens in lenses if lens.aperture_diameter > 0] or [0.0]
    return 0.5 * (min(vergences) + max(vergences))


@dataclass(frozen=True, eq=False)
class _Column:
    """The images of one camera, one a lens, their errors, and the rays they took."""

    images: list[Image]
    error: list[float]
    rays: int


def _column(
    tracer: "_Tracer", lenses: Sequence[Lens], rings: Sequence[Ring], seeds: np.random.SeedSequence, report: Progress
) -> _Column:
    middle = _middle_vergence(lenses)
    totals = [np.zeros((tracer.camera.height, tracer.camera.width, 3)) for _ in lenses]
    variance = np.zeros(len(lenses))
    work, done = sum(ring.spp for ring in rings), 0
    for ring in rings:
        images, errors = tracer.ring_images(ring, middle, seeds)
        for i, lens in enumerate(lenses):
            share = share_of(ring, lens)
            if share:
                place = ring.vergences.index(lens.vergence) if ring.outer else 0
                totals[i] += share * images[place]
                variance[i] += share**2 * errors[place] ** 2
        done += ring.spp
        report(done / work)
    return _Column([total.astype(np.float32) for total in totals], list(np.sqrt(variance)), tracer.rays)


class _Tracer:
    """Traces the rays of rings for one camera. `margin` pixels of film are added on every side."""

    def __init__(self, built: BuiltScene, camera: Camera, pose: Float, sampler: str, shift: float) -> None:
        self.built, self.camera, self.pose, self.sampler = built, camera, pose, sampler
        self.margin = math.ceil(shift)
        self.width, self.height = camera.width + 2 * self.margin, camera.height + 2 * self.margin
        self.rays = 0

    def ring_images(self, ring: Ring, middle: float, seeds: np.random.SeedSequence) -> tuple[list[Float], list[float]]:
        """The mean radiance through one ring for each of its vergences, (H, W, 3), and its RMS standard error."""
        sums = [RingMean(self.camera) for _ in ring.vergences]
        sampler, passes = self._sampler(ring.spp)
        for _ in range(passes):
            seed = int(seeds.spawn(1)[0].generate_state(1)[0])
            for total, splat in zip(sums, self._trace(ring, middle, sampler, seed), strict=True):
                total.add(np.asarray(splat).reshape(self.camera.height, self.camera.width, 4))
            self.rays += sampler.sample_count() * self.width * self.height
        return [total.image() for total in sums], [total.standard_error() for total in sums]

    def _sampler(self, spp: int) -> tuple[Any, int]:
        """A sampler of one pass, and how many passes make at least `spp`: as few as memory and their spread allow.

        Samplers round counts up (multijitter 11 to 12): what they take is read back.
        """
        room = max(1, RAYS_A_PASS // (self.width * self.height))
        fewest = min(FEWEST_PASSES, spp)
        count = math.ceil(spp / max(fewest, math.ceil(spp / room)))
        if self.sampler == "multijitter":
            sampler = shared_strata(count)
        else:
            sampler = mitsuba().load_dict({"type": self.sampler, "sample_count": count})
            sampler.set_samples_per_wavefront(sampler.sample_count())
        return sampler, max(fewest, math.ceil(spp / sampler.sample_count()))

    def _trace(self, ring: Ring, middle: float, sampler: Any, seed: int) -> list[Any]:
        """One pass: fixed-point sums of (R, G, B, count) over the image, flat, for each vergence."""
        import drjit as dr

        mi = mitsuba()
        spp = sampler.sample_count()
        rays = self.width * self.height * spp
        sampler.seed(seed, rays)
        cell = dr.arange(mi.UInt32, rays) // spp
        draw = sampler.next_shared_2d if self.sampler == "multijitter" else sampler.next_2d
        jitter, aperture = draw(), draw()
        u = mi.Float(cell % self.width) + jitter.x - (0.5 + self.margin)
        v = mi.Float(cell // self.width) + jitter.y - (0.5 + self.margin)
        ax, ay = sample_ring(ring, aperture)
        ray = self._ray(u, v, ax, ay, dr.opaque(mi.Float, middle))
        radiance, valid, _ = self.built.integrator.sample(self.built.mi_scene, sampler, ray, None, True)
        radiance = dr.select(valid, radiance, 0.0)
        shifts = [dr.opaque(mi.Float, vergence - middle) for vergence in ring.vergences]
        sums = [self._splat(radiance, u + k * ax * self.camera.fx, v + k * ay * self.camera.fy) for k in shifts]
        dr.eval(sums)
        return sums

    def _ray(self, u: Any, v: Any, ax: Any, ay: Any, k: Any) -> Any:
        """The camera law, from film position (u, v) in pixels and aperture point (ax, ay) in metres."""
        import drjit as dr

        mi = mitsuba()
        camera = self.camera

        def opaque(value: float) -> Any:
            return dr.opaque(mi.Float, value)

        x_axis, y_axis, z_axis, origin = (mi.Vector3f(*map(opaque, self.pose[:3, column])) for column in range(4))
        x = (u - opaque(camera.cx)) / opaque(camera.fx)
        y = (v - opaque(camera.cy)) / opaque(camera.fy)
        direction = (x - k * ax) * x_axis + (y - k * ay) * y_axis + z_axis
        start = mi.Point3f(origin + ax * x_axis + ay * y_axis)
        return mi.RayDifferential3f(mi.Ray3f(start, dr.normalize(direction)))

    def _splat(self, radiance: Any, u: Any, v: Any) -> Any:
        import drjit as dr

        mi = mitsuba()
        column, row = dr.floor(u + 0.5), dr.floor(v + 0.5)
        inside = (column >= 0) & (column < self.camera.width) & (row >= 0) & (row < self.camera.height)
        base = 4 * (mi.UInt32(row) * self.camera.width + mi.UInt32(column))
        sums = dr.zeros(mi.UInt64, 4 * self.camera.width * self.camera.height)
        for c in range(3):
            fixed = mi.UInt64(dr.clip(radiance[c], 0.0, _BRIGHTEST) * FIXED_POINT)
            dr.scatter_add(sums, fixed, base + c, inside)
        dr.scatter_add(sums, mi.UInt64(1), base + 3, inside)
        return sums
