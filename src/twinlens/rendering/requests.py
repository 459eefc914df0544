"""Checks of a request for images: once, before anything is built."""

from collections.abc import Callable, Iterable, Mapping, Sequence

from twinlens.camera import Lens, Rig
from twinlens.camera.lens import check_lens_on
from twinlens.camera.parts import Parts, check_parts
from twinlens.camera.rig import check_seen
from twinlens.errors import InputError, check_int, check_known, counted
from twinlens.machine import memory_bytes
from twinlens.rendering.samplers import SAMPLERS
from twinlens.scenes import Scene
from twinlens.scenes.bands import in_band

# Lower bounds in bytes for a pixel of the view in work, and of finished images in float32. One sample a pixel without
# denoising takes 65 in all: the peak of an image of 1000x1000 pixels less that of 100x100.
_BYTES_OF_PIXEL = 50
_BYTES_KEPT = 12

Progress = Callable[[float], None]
"""Called with the fraction done, in (0, 1]."""


def split_bands(scene: Scene, rig: Rig) -> dict[str, Scene]:
    """The scene in each band that cameras of the rig see, in the order in which they appear.

    Raises InputError unless the arguments are a Scene and a Rig.
    """
    check_view(scene, rig)
    bands = dict.fromkeys(band for camera in rig.cameras for band in camera.bands)
    return {band: in_band(scene, band) for band in bands}


def check_request(
    scenes: Mapping[str, Scene],
    rig: Rig,
    lenses: Iterable[Lens],
    spp: int,
    seed: int,
    sampler: str,
    parts: Parts | None = None,
) -> None:
    """Raise InputError for a request that cannot be rendered; `scenes` are those of `split_bands`."""
    check_memory(rig)
    check_seen(rig)
    for band, scene in scenes.items():
        if not any(
            projector.emitted_power
            for projector in rig.projectors
            if projector.band == band
        ):
            check_lit(scene, band)
    for lens in lenses:
        for camera in rig.cameras:
            check_lens_on(camera, lens)
        if parts is not None:
            check_parts(parts, lens)
    check_int("spp", spp, 1)
    check_int("seed", seed, 0)
    check_known("sampler", sampler, SAMPLERS)


def check_memory(rig: Rig, frames: int = 1) -> None:
    """Raise InputError for images that this machine cannot hold while they are rendered, by a lower bound.

    frames : images of each camera that are kept until the last one is rendered.
    """
    pixels = max(camera.width * camera.height for camera in rig.cameras)
    kept = sum(camera.width * camera.height for camera in rig.cameras)
    needed = _BYTES_OF_PIXEL * pixels + _BYTES_KEPT * kept * frames
    memory = memory_bytes()
    if needed > memory:
        largest = max(rig.cameras, key=lambda camera: camera.width * camera.height)
        images = counted(len(rig), "image")
        remedy = "use smaller images"
        if frames > 1:
            images = f"{frames} frames of {images}"
            remedy += ", or fewer patterns"
        raise InputError(
            f"{images} of up to {largest.width}x{largest.height} pixels need at least "
            f"{needed / 1e9:.3g} GB of memory, this machine has {memory / 1e9:.3g} GB: {remedy}"
        )


def lens_of_each_camera(lens: Lens | Sequence[Lens], rig: Rig) -> list[Lens]:
    """One lens for each camera, from one for all or a list. Raises InputError for a list of another length."""
    if isinstance(lens, str) or not isinstance(lens, Sequence):
        return [lens] * len(rig)
    if len(lens) != len(rig):
        raise InputError(
            f"a rig of {counted(len(rig), 'camera')} needs one lens, or one for each camera, got {len(lens)}"
        )
    return list(lens)


def check_lit(scene: Scene, band: str = "rgb") -> None:
    """Raise InputError for a scene in a band, "rgb" or "nir", without light."""
    if not scene.is_lit:
        kind = "light" if band == "rgb" else "near infrared light"
        remedy = "add one under [lights], an emitter to an object, a projector to the rig, or a sky"
        raise InputError(f"the scene {scene.name!r} has no {kind}: {remedy}")


def check_view(scene: Scene, rig: Rig) -> None:
    """Raise InputError unless the arguments are a Scene and a Rig, both still."""
    check_types(scene, rig)
    check_still(scene)
    if rig.motion is not None:
        raise InputError(
            "the rig moves, and images and truth are of one time: use rig.at(seconds)"
        )


def check_still(scene: Scene) -> None:
    """Raise InputError for a scene that moves."""
    if scene.motion:
        raise InputError(
            f"the scene {scene.name!r} moves, and images and truth are of one time: use scene.at(seconds) in Python; "
            "recipes and `twinlens render` take still scenes"
        )


def check_types(scene: Scene, rig: Rig) -> None:
    """Raise InputError unless the arguments are a Scene and a Rig."""
    if not isinstance(scene, Scene):
        raise InputError(
            f"scene must be a Scene, got {scene!r:.60}; load_scene makes one from a name or a file"
        )
    if not isinstance(rig, Rig):
        raise InputError(
            f"rig must be a Rig, got {rig!r:.60}; Rig.stereo makes one from a camera, Rig from several"
        )


def partial_progress(progress: Progress | None, start: float, end: float) -> Progress:
    """Progress of a part, reported as progress of the whole from `start` to `end`."""
    if progress is None:
        return lambda _: None
    return lambda fraction: progress(start + (end - start) * fraction)
