"""Light fields rendered from light that their views share: `render_light_field`."""

import math

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Pinhole, Rig
from twinlens.camera.light_field import places_in_plane
from twinlens.errors import InputError
from twinlens.rendering.framing import built_for
from twinlens.rendering.integrators import own_paths
from twinlens.rendering.projectors import lit_by_projectors
from twinlens.rendering.requests import (
    Progress,
    check_request,
    partial_progress,
    split_bands,
)
from twinlens.rendering.samplers import PLAIN_SAMPLER
from twinlens.rendering.views import in_channels, sum_of
from twinlens.scenes import Scene
from twinlens.seeds import derived_seed

CAMERA_SAMPLES_PER_PATH = 16
"""Camera rays of a pixel for each light path: their costs are about equal."""


def render_light_field(
    scene: Scene,
    rig: Rig,
    spp: int = 64,
    seed: int = 0,
    *,
    progress: Progress | None = None,
) -> list[NDArray[np.float32]]:
    """Render the views of a light field, which share the light that rough surfaces reflect.

    81 views of 64 samples cost a tenth of those of `render`, or less, at equal error
    (docs/decisions/light-fields.md). Much of their noise is the same light in all views, and moves with the surfaces:
    take `render` where that matters, as in tests of matchers at low noise. Light is averaged over pieces of surface as
    large as a pixel. This blurs the edges of sharp shadows, and the textures of metals and translucent surfaces, by up
    to a pixel. Textures of matte surfaces stay sharp.

    Parameters
    ----------
    rig : Rig
        Of `light_field_rig`, or any cameras in one plane with parallel axes and equal fx, fy, image sizes and bands.
    spp : int
        Camera rays per pixel, >= 1. Each view has a light path for every 16 of them.
    seed, progress
        As in `render`.

    Returns
    -------
    list of float32 (H, W, 3)
        As `render` through a pinhole.

    Raises
    ------
    InputError
        For other rigs, for a scene whose integrator is not `path`, and as `render`.
    """
    scenes = split_bands(scene, rig)
    check_request(scenes, rig, [Pinhole()], spp, seed, PLAIN_SAMPLER)
    places_in_plane(rig)
    first = rig.cameras[0]
    for camera in rig.cameras:
        if camera.distortion is not None or camera.bands != first.bands:
            raise InputError(
                "a light field needs cameras without lens distortion that see the same bands"
            )
    bands = []
    for number, band in enumerate(first.bands):
        report = partial_progress(
            progress, number / len(first.bands), (number + 1) / len(first.bands)
        )
        seeds = derived_seed(seed, number, 0), derived_seed(seed, number, 1)
        bands.append(_images_of_band(scenes[band], rig, band, int(spp), seeds, report))
    return [sum_of(images) for images in zip(*bands, strict=True)]


def _images_of_band(
    scene: Scene,
    rig: Rig,
    band: str,
    spp: int,
    seeds: tuple[int, int],
    report: Progress,
) -> list[NDArray[np.float32]]:
    """The light of one band in every view; seeds: of the shared light paths, and of the camera rays."""
    from twinlens.rendering.shared_light import (  # sets up the backend
        SharedLight,
        Views,
        shared_images,
    )

    built = lit_by_projectors(built_for(scene, rig), rig, band)
    lamps = () if built.projected is None else built.projected.lamps
    paths = own_paths(built, lamps)
    if paths is None:
        raise InputError(
            f"the scene {scene.name!r} is a Mitsuba file or has another integrator than 'path'; use render"
        )
    views = Views(rig, built.frame)
    light_samples = math.ceil(spp / CAMERA_SAMPLES_PER_PATH)
    light = SharedLight(built.mi_scene, paths, views, light_samples, seeds[0])
    in_turn = shared_images(
        built.mi_scene, paths, light, spp, seeds[1], built.sky_visible
    )
    camera = rig.cameras[0].replace(band=band)
    images = []
    for image in in_turn:
        images.append(in_channels(image, camera).astype(np.float32))
        report(len(images) / len(rig))
    return images
