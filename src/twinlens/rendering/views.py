"""The images that a rig needs: one view for each camera and band of light, with the scene that was built for it.

A camera without an infrared filter sees two bands: each band has a scene of its own, each view sees one band, and the
image of a camera is the sum of its views' images. After `views_of`, nobody looks at a Scene.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens, Rig
from twinlens.geometry import Float
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.framing import built_for
from twinlens.rendering.integrators import for_denoising, for_images
from twinlens.rendering.projectors import (
    can_denoise,
    lit_by_projectors,
    warn_of_noise,
)
from twinlens.rendering.requests import split_bands
from twinlens.scenes import Scene
from twinlens.seeds import derived_seed

_CACHE_STREAM = 4
_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class View:
    """One image: a camera with one band, its pose and lens, and the scene with the integrator of the image.

    pose : frame_from_cam, from the camera's axes in metres to the frame of the built scene.
    """

    built: BuiltScene
    camera: Camera
    pose: Float
    lens: Lens
    denoised: bool

    @property
    def optics(self) -> tuple[BuiltScene, Camera, Float, Lens]:
        """What guides and images are rendered from."""
        return self.built, self.camera, self.pose, self.lens


def views_of(
    scenes: Mapping[str, Scene],
    rig: Rig,
    lenses: Sequence[Lens],
    seed: int,
    denoise: bool,
) -> list[View]:
    """The views of every camera of a rig, those of a camera after each other, with one lens for each camera.

    `scenes` has the scene in each band. Where images are denoised, light between surfaces comes from an irradiance
    cache, which the cameras of a band share.
    """
    stages: dict[str, tuple[BuiltScene, bool]] = {}
    for band, scene in scenes.items():
        built = lit_by_projectors(built_for(scene, rig), rig, band)
        denoised = denoise and can_denoise(built, rig, band)
        if denoise and not denoised:
            warn_of_noise()
        if denoised:
            cache_seed = derived_seed(seed, _CACHE_STREAM)
            built = for_denoising(built, rig, band, cache_seed)
        else:
            built = for_images(built)
        stages[band] = built, denoised
    views = []
    for camera, pose, lens in zip(
        rig.cameras, rig.world_from_cams, lenses, strict=True
    ):
        for band in camera.bands:
            built, denoised = stages[band]
            in_frame = built.frame.affine(pose)
            in_band = camera.replace(band=band)
            views.append(View(built, in_band, in_frame, lens, denoised))
    return views


def by_camera(rig: Rig, items: Sequence[_T]) -> Iterator[list[_T]]:
    """Group `items`, one per view in the order of `views_of`, by camera."""
    rest = iter(items)
    for camera in rig.cameras:
        yield [next(rest) for _ in camera.bands]


def denoised_cameras(scene: Scene, rig: Rig) -> list[int]:
    """Indices of the cameras whose images `render` denoises if asked; `can_denoise` says where it does not."""
    keeps = {}
    for band, in_this_band in split_bands(scene, rig).items():
        built = lit_by_projectors(built_for(in_this_band, rig), rig, band)
        keeps[band] = can_denoise(built, rig, band)
        if not keeps[band]:
            warn_of_noise()
    denoised = {band for band, is_denoised in keeps.items() if is_denoised}
    return [i for i, camera in enumerate(rig.cameras) if denoised & set(camera.bands)]


def sum_of(images: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """The sum of the images of a camera's bands."""
    return images[0] if len(images) == 1 else np.sum(images, axis=0, dtype=np.float32)


def in_channels(image: Any, camera: Camera) -> Any:
    """The image (..., H, W, 3) of a pass as `camera` has it: the mean in each channel for the near infrared."""
    if camera.band != "nir":
        return image
    return np.repeat(image.mean(axis=-1, keepdims=True), 3, axis=-1)
