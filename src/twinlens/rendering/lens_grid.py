"""Many lenses from one set of light paths: every aperture and focus of a list, at little more than one image's cost.

A ray through aperture point a that a camera of vergence k sees at film position x is seen by a camera of vergence k' at
x + (k' - k) a: a pure shift. So paths are traced once, over a padded film and over concentric annuli of the aperture,
and gathered once for each focus. A lens is the area-weighted sum of its annuli.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Disk, Lens, Rig
from twinlens.camera.parts import Parts
from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.rendering.annuli import area_fraction, plan_annuli, split_vergences
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.denoising import GUIDE_SAMPLES, denoise_parts
from twinlens.rendering.radiance import (
    Progress,
    View,
    check_parts_request,
    check_request,
    image_passes,
    in_channels,
    measured,
    other_guides,
    partial_progress,
    raw_image,
    split_bands,
    sum_of,
    views_of,
)
from twinlens.rendering.samplers import PLAIN_SAMPLER, default_sampler
from twinlens.scenes import Scene
from twinlens.seeds import derived_seed, seed_sequence

Image = NDArray[np.float32]

Shares = Callable[[NDArray[np.float32]], Float]

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
    check_request(scene, rig, lenses, spp, seed, alone)
    single, members = split_bands(rig)
    if len(single) > len(rig):
        grid = render_lens_grid(
            scene,
            single,
            lenses,
            spp,
            seed,
            denoise=denoise,
            parts=parts,
            sampler=sampler,
            progress=progress,
        )
        joined = tuple(
            [sum_of([images[i] for i in indices]) for indices in members]
            for images in grid
        )
        squares = np.square(grid.standard_error)
        errors = np.stack(
            [squares[:, indices].sum(axis=1) for indices in members], axis=1
        )
        return LensGrid(joined, np.sqrt(errors), grid.rays)
    if parts is not None:
        check_parts_request(scene, rig, lenses, parts)
    bands = {camera.band for camera in rig.cameras}
    denoise = denoise and not any(
        each.emitted_power and each.band in bands for each in rig.projectors
    )
    views = views_of(scene, rig, [lenses[0]] * len(rig), int(seed), denoise)
    builts = [view.built for view in views]
    built = builts[0]
    spp, seed = int(spp), int(seed)
    shared = _shareable(built, rig, lenses)
    separate = [i for i in range(len(lenses)) if i not in shared]
    images: dict[int, list[Image]] = {}
    variance = np.zeros((len(lenses), len(rig)))
    rays = (
        spp
        * len(separate)
        * sum(camera.width * camera.height for camera in rig.cameras)
    )
    if shared:
        report = partial_progress(progress, 0.0, len(shared) / len(lenses))
        chosen = [lenses[i] for i in shared]
        found, variance[shared], paths = _render_shared(
            builts, rig, chosen, spp, seed, parts, sampler or PLAIN_SAMPLER, report
        )
        rays += paths
        images |= zip(shared, found, strict=True)
    for done, i in enumerate(separate, len(shared)):
        report = partial_progress(
            progress, done / len(lenses), (done + 1) / len(lenses)
        )
        own_seed = derived_seed(seed, _GRID_STREAM, i)
        images[i], variance[i] = _render_separately(
            views, lenses[i], spp, own_seed, parts, alone, report
        )
    if denoise:
        for (i, lens), index in product(enumerate(lenses), range(len(rig))):
            if not views[index].denoised:
                continue
            view = replace(views[index], lens=lens)
            guides = other_guides(
                *view.optics, GUIDE_SAMPLES, seed, index, i, parts=parts
            )
            fractions = None if parts is None else parts.light(lens.aperture)[0]
            images[i][index] = denoise_parts(images[i][index], guides, None, fractions)
    return LensGrid(
        tuple(images[i] for i in range(len(lenses))), np.sqrt(variance), rays
    )


def _shareable(built: BuiltScene, rig: Rig, lenses: Sequence[Lens]) -> list[int]:
    """Indices of the lenses that can share paths: disk apertures.

    None with lens distortion, or with an integrator that does not follow camera rays.
    """
    undistorted = all(camera.distortion is None for camera in rig.cameras)
    if not (undistorted and isinstance(built.integrator, mitsuba().SamplingIntegrator)):
        return []
    return [
        i
        for i, lens in enumerate(lenses)
        if isinstance(lens.aperture, Disk) or lens.aperture_diameter == 0
    ]


def _render_separately(
    views: Sequence[View],
    lens: Lens,
    spp: int,
    seed: int,
    parts: Parts | None,
    sampler: str,
    progress: Progress,
) -> tuple[list[Image], list[float]]:
    """Images of one lens before denoising, and variances from halves of their samples, which are NaN with `parts`."""
    views = [replace(view, lens=lens, denoised=False) for view in views]
    if spp < 2 or parts is not None:
        images = []
        for i, view in enumerate(views):
            report = partial_progress(progress, i / len(views), (i + 1) / len(views))
            images.append(
                raw_image(
                    view,
                    list(image_passes(view.camera, spp, seed, i, sampler)),
                    parts,
                    report,
                )[0]
            )
        return images, [math.nan] * len(views)
    found, _ = measured(
        views, spp, seed, parts=None, sampler=sampler, progress=progress
    )
    squares = [np.square(view.error, dtype=np.float64) for view in found]
    return [view.image for view in found], [
        float(each[np.isfinite(each)].mean()) for each in squares
    ]


def _render_shared(
    builts: Sequence[BuiltScene],
    rig: Rig,
    lenses: Sequence[Lens],
    spp: int,
    seed: int,
    parts: Parts | None,
    sampler: str,
    progress: Progress,
) -> tuple[list[list[Image]], Float, int]:
    """Images of all lenses from one set of paths per camera, their variances, and the number of paths."""
    from twinlens.rendering.shared_paths import SharedPaths  # sets up the backend

    images: list[list[Image]] = [[] for _ in lenses]
    variances, rays = np.zeros((len(lenses), len(rig))), 0
    annuli = plan_annuli(lenses, spp)
    size = 1 if parts is None else 1 + len(parts)  # the whole image, then its parts
    for index, (camera, pose) in enumerate(
        zip(rig.cameras, rig.world_from_cams, strict=True)
    ):
        seeds = seed_sequence(seed, _GRID_STREAM, index, 0)
        totals = np.zeros((len(lenses), size, camera.height, camera.width, 3))
        for place, annulus in enumerate(annuli):
            for group in split_vergences(annulus, camera):
                radii = [0.5 * lens.aperture_diameter for lens in lenses]
                fractions = [area_fraction(annulus, radius) for radius in radii]
                users = [
                    i
                    for i, lens in enumerate(lenses)
                    if fractions[i] and lens.vergence in group.vergences
                ]
                outputs = [
                    (
                        group.vergences.index(lenses[i].vergence),
                        radii[i] if parts else 0.0,
                    )
                    for i in users
                ]
                distinct = list(dict.fromkeys(outputs))
                focuses = [focus for focus, _ in distinct for _ in range(size)]
                shares = (
                    None
                    if parts is None
                    else _shares(parts, [radius for _, radius in distinct])
                )
                traced = SharedPaths(builts[index], camera, pose, group, sampler)
                means, variance, paths = traced.images(seeds, focuses, shares)
                rays += paths
                for i, output in zip(users, outputs, strict=True):
                    first = size * distinct.index(output)
                    totals[i] += fractions[i] * means[first : first + size]
                    variances[i, index] += fractions[i] ** 2 * variance[first]
            progress((index + (place + 1) / len(annuli)) / len(rig))
        for several, total in zip(images, totals, strict=True):
            several.append(
                in_channels(total[0] if parts is None else total[1:], camera).astype(
                    np.float32
                )
            )
    return images, variances, rays


def _shares(parts: Parts, radii: Sequence[float]) -> Shares:
    """From points (n, 2) of the aperture in metres, weights (n, K): for each radius 1, then the share of each part."""

    def weights(points: NDArray[np.float32]) -> Float:
        x, y = points.T.astype(np.float64)
        each = [
            weight
            for radius in radii
            for weight in (np.ones(len(x)), *parts.shares(x / radius, y / radius))
        ]
        return np.stack(each, axis=1)

    return weights
