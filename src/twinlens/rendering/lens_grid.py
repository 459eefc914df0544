"""Many lenses from one set of light paths: every aperture and focus of a list, at little more than one image's cost.

A ray through aperture point a that a camera of vergence k sees at film position x is seen by a camera of vergence k' at
x + (k' - k) a: a pure shift. So paths are traced once, over a padded film and over concentric annuli of the aperture,
and gathered once for each focus. A lens is the area-weighted sum of its annuli.

A focal stack is such a list with one aperture.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Disk, Paraxial, Rig, ThinLens
from twinlens.camera.lens import require_paraxial
from twinlens.camera.parts import Parts
from twinlens.errors import InputError, format_value
from twinlens.geometry import Float
from twinlens.optics import check_focus
from twinlens.rendering.annuli import (
    ApertureAnnulus,
    Shares,
    area_fraction,
    plan_annuli,
    split_vergences,
)
from twinlens.rendering.denoising import GUIDE_SAMPLES, denoise_parts
from twinlens.rendering.images import (
    Samples,
    image_passes,
    light_of_parts,
    measured,
    other_guides,
    raw_image,
)
from twinlens.rendering.requests import (
    Progress,
    check_request,
    partial_progress,
    split_bands,
)
from twinlens.rendering.samplers import PLAIN_SAMPLER, default_sampler
from twinlens.rendering.views import (
    View,
    by_camera,
    in_channels,
    sum_of,
    views_of,
)
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
    lenses: Sequence[Paraxial],
    spp: int = 64,
    seed: int = 0,
    *,
    denoise: bool = False,
    parts: Parts | None = None,
    sampler: str | None = None,
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
        least one sample of every annulus between two apertures.
    seed, progress
        As in `render`.
    denoise : bool
        As in `render`, with guides for each lens and camera, whose noise depends on the place of the lens in `lenses`.
        Standard errors are those before denoising. Rigs with a projector in the band of a camera are not denoised.
    parts : Dual, Quad, Grid or Masks, optional
        As in `render`, of each lens's aperture. Standard errors are those of the whole images.
    sampler : str, optional
        As in `render`, but None takes `multijitter` where lenses share paths. Film positions and aperture points are
        always stratified there.

    Returns
    -------
    LensGrid
        images[i_lens][i_camera], float32 (H, W, 3) or (P, H, W, 3), and their standard errors. The bytes
        depend on the arguments only, not on the number of threads.

    Raises
    ------
    InputError
        For an empty list of lenses, and as `render`.
    """
    if not isinstance(lenses, Sequence) or not lenses:
        raise InputError("render_lens_grid needs a list of at least one lens")
    alone = sampler or default_sampler(denoise)
    scenes = split_bands(scene, rig)
    check_request(scenes, rig, lenses, spp, seed, alone, parts)
    for lens in lenses:
        require_paraxial(lens, "a lens grid")
    denoise = denoise and not _sees_projectors(rig)
    views = views_of(scenes, rig, [lenses[0]] * len(rig), int(seed), denoise)

    samples = Samples(int(spp), int(seed), sampler or PLAIN_SAMPLER, parts)
    images, variance, rays = _noisy_grid(views, lenses, samples, alone, progress)
    if denoise:
        for i, lens in enumerate(lenses):
            images[i] = _denoised(views, images[i], lens, i, int(seed), parts)
    return _grid_of_cameras(rig, images, variance, rays)


def _noisy_grid(
    views: Sequence[View],
    lenses: Sequence[Paraxial],
    samples: Samples,
    alone: str,
    progress: Progress | None,
) -> tuple[list[list[Image]], Float, int]:
    """The images (lenses, views) before denoising, their variances, and the number of paths.

    alone : the sampler of the lenses that share no paths. Views of one camera are added up later.
    """
    images: list[list[Image]] = [[] for _ in lenses]
    variance = np.zeros((len(lenses), len(views)))
    rays = 0
    shared = _shareable(views, lenses)
    if shared:
        report = partial_progress(progress, 0.0, len(shared) / len(lenses))
        sharing = [lenses[i] for i in shared]
        rows, variance[shared], rays = _render_shared(views, sharing, samples, report)
        for i, row in zip(shared, rows, strict=True):
            images[i] = row
    separate = [i for i in range(len(lenses)) if i not in shared]
    film_pixels = sum(view.camera.width * view.camera.height for view in views)
    for done, i in enumerate(separate, len(shared)):
        report = partial_progress(
            progress, done / len(lenses), (done + 1) / len(lenses)
        )
        lens_seed = derived_seed(samples.seed, _GRID_STREAM, i)
        of_lens = replace(samples, seed=lens_seed, sampler=alone)
        images[i], variance[i] = _render_separately(views, lenses[i], of_lens, report)
        rays += samples.spp * film_pixels
    return images, variance, rays


def focal_stack(
    scene: Scene,
    rig: Rig,
    lens: ThinLens,
    focus_distances: Sequence[float],
    spp: int = 64,
    seed: int = 0,
    *,
    denoise: bool = False,
    progress: Progress | None = None,
) -> LensGrid:
    """Render `scene` through `lens` focused at each of `focus_distances` (metres), as `render_lens_grid`.

    Returns images[i_focus][i_camera]. Changing the focus does not move the image: there is no focus breathing. Raises
    InputError unless `lens` is a ThinLens, and as `render_lens_grid`.
    """
    if not isinstance(lens, ThinLens):
        raise InputError(f"a focal stack needs a ThinLens, got {format_value(lens)}")
    if np.ndim(focus_distances) != 1:
        raise InputError(
            f"focus_distances must be a list of metres, got {format_value(focus_distances)}"
        )
    for distance in focus_distances:
        check_focus(distance)
    lenses = [
        lens.replace(focus_distance=float(distance)) for distance in focus_distances
    ]
    return render_lens_grid(
        scene, rig, lenses, spp, seed, denoise=denoise, progress=progress
    )


def _grid_of_cameras(
    rig: Rig, images: Sequence[list[Image]], variance: Float, rays: int
) -> LensGrid:
    """The grid of a rig's cameras, from the images (lenses, views) and their variances, which add up too."""
    rows = tuple([*map(sum_of, by_camera(rig, row))] for row in images)
    columns = [
        np.sum(of_camera, axis=0) for of_camera in by_camera(rig, list(variance.T))
    ]
    return LensGrid(rows, np.sqrt(np.stack(columns, axis=1)), rays)


def _sees_projectors(rig: Rig) -> bool:
    """Whether a projector shines in the band of a camera: shared paths do not know its light apart."""
    bands = set[str]().union(*(camera.bands for camera in rig.cameras))
    return any(
        projector.emitted_power and projector.band in bands
        for projector in rig.projectors
    )


def _shareable(views: Sequence[View], lenses: Sequence[Paraxial]) -> list[int]:
    """Indices of the lenses that can share paths: disk apertures.

    None with lens distortion, whose shifts are not equal in all pixels, or with an integrator that does not follow
    camera rays.
    """
    undistorted = all(view.camera.distortion is None for view in views)
    if not (undistorted and views[0].built.follows_rays()):
        return []
    return [
        i
        for i, lens in enumerate(lenses)
        if isinstance(lens.aperture, Disk) or lens.aperture_diameter == 0
    ]


def _render_separately(
    views: Sequence[View], lens: Paraxial, samples: Samples, progress: Progress
) -> tuple[list[Image], list[float]]:
    """Images of one lens before denoising, and variances from halves of their samples, which are NaN with `parts`."""
    views = [replace(view, lens=lens, denoised=False) for view in views]
    if samples.spp >= 2 and samples.parts is None:
        noisy, _ = measured(views, samples, progress=progress)
        squares = [np.square(view.error, dtype=np.float64) for view in noisy]
        variances = [float(square[np.isfinite(square)].mean()) for square in squares]
        return [view.image for view in noisy], variances
    images = []
    for i, view in enumerate(views):
        report = partial_progress(progress, i / len(views), (i + 1) / len(views))
        passes = image_passes(
            view.camera, samples.spp, samples.seed, i, samples.sampler
        )
        image, _ = raw_image(view, passes, samples.parts, report)
        images.append(image)
    return images, [math.nan] * len(views)


def _denoised(
    views: Sequence[View],
    images: Sequence[Image],
    lens: Paraxial,
    number: int,
    seed: int,
    parts: Parts | None,
) -> list[Image]:
    """The images of lens `number` of a grid, denoised where the views ask for it."""
    denoised = []
    for index, (view, image) in enumerate(zip(views, images, strict=True)):
        if view.denoised:
            through = replace(view, lens=lens)
            guides = other_guides(
                through, GUIDE_SAMPLES, seed, index, number, parts=parts
            )
            image = denoise_parts(image, guides, None, light_of_parts(parts, lens))
        denoised.append(image)
    return denoised


def _render_shared(
    views: Sequence[View],
    lenses: Sequence[Paraxial],
    samples: Samples,
    progress: Progress,
) -> tuple[list[list[Image]], Float, int]:
    """Images of all lenses from one set of paths per view, their variances, and the number of paths."""
    images: list[list[Image]] = [[] for _ in lenses]
    variances, rays = np.zeros((len(lenses), len(views))), 0
    annuli = plan_annuli(lenses, samples.spp)
    # The whole image comes first, before those of the parts.
    whole = 0 if samples.parts is None else slice(1, None)
    for index, view in enumerate(views):
        seeds = seed_sequence(samples.seed, _GRID_STREAM, index, 0)
        sums = _Sums(view, lenses, samples)
        for place, annulus in enumerate(annuli):
            for group in split_vergences(annulus, view.camera):
                rays += sums.add(group, seeds)
            progress((index + (place + 1) / len(annuli)) / len(views))
        variances[:, index] = sums.variance
        for row, total in zip(images, sums.total, strict=True):
            image = in_channels(total[whole], view.camera)
            row.append(image.astype(np.float32))
    return images, variances, rays


class _Sums:
    """The images of all lenses in one view, of the annuli that were traced: `total` (L, S, H, W, 3), `variance` (L,).

    A lens's image is the mean of its annuli weighted by their areas; so are the images of parts of its aperture, which
    follow the whole image. The variances of independent annuli add up with the squared weights.
    """

    def __init__(
        self, view: View, lenses: Sequence[Paraxial], samples: Samples
    ) -> None:
        self.view, self.lenses, self.samples = view, lenses, samples
        self.size = 1 if samples.parts is None else 1 + len(samples.parts)
        self.total = np.zeros(
            (len(lenses), self.size, view.camera.height, view.camera.width, 3)
        )
        self.variance = np.zeros(len(lenses))

    def add(self, annulus: ApertureAnnulus, seeds: np.random.SeedSequence) -> int:
        """Trace the paths of an annulus and add its light to the lenses that have it; returns the number of paths."""
        from twinlens.rendering.shared_paths import SharedPaths  # sets up the backend

        parts = self.samples.parts
        radii = [0.5 * lens.aperture_diameter for lens in self.lenses]
        fractions = [area_fraction(annulus, radius) for radius in radii]
        # Lenses of one vergence see the same image of the annulus. Its parts, though, depend on the aperture's radius.
        outputs: dict[int, tuple[int, float]] = {}
        for i, lens in enumerate(self.lenses):
            if fractions[i] and lens.vergence in annulus.vergences:
                focus = annulus.vergences.index(lens.vergence)
                outputs[i] = focus, radii[i] if parts else 0.0
        distinct = list(dict.fromkeys(outputs.values()))
        focuses = np.repeat([focus for focus, _ in distinct], self.size).tolist()
        shares = None
        if parts is not None:
            shares = _shares(parts, [radius for _, radius in distinct])
        traced = SharedPaths(
            self.view.built,
            self.view.camera,
            self.view.pose,
            annulus,
            self.samples.sampler,
        )
        means, variance, paths = traced.images(seeds, focuses, shares)
        for i, output in outputs.items():
            first = self.size * distinct.index(output)
            self.total[i] += fractions[i] * means[first : first + self.size]
            self.variance[i] += fractions[i] ** 2 * variance[first]
        return paths


def _shares(parts: Parts, radii: Sequence[float]) -> Shares:
    """From points (n, 2) of the aperture in metres, weights (n, K): for each radius 1, then the share of each part."""

    def weights(points: NDArray[np.float32]) -> Float:
        x, y = points.T.astype(np.float64)
        columns = []
        for radius in radii:
            columns.append(np.ones(len(x)))
            columns += parts.shares(x / radius, y / radius)
        return np.stack(columns, axis=1)

    return weights
