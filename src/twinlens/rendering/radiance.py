"""Photographs: the radiance that falls on each pixel, in passes, one seed for each eye and pass.

scene -> mi scene ----+
rig, lens -> sensors -+-> integrator, pass by pass -> float64 mean -> float32 (H, W, 3)
"""

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens, Pinhole, Rig
from twinlens.camera.lens import check_lens as check_lens  # the grid asks it too
from twinlens.errors import InputError, unknown
from twinlens.geometry import Float
from twinlens.rendering.backends import backend, mitsuba
from twinlens.rendering.build import BuiltScene, build
from twinlens.rendering.builtin import builtin_sensor
from twinlens.rendering.plugin import camera_sensor
from twinlens.scenes import Scene

Progress = Callable[[float], None]
SAMPLERS = ("multijitter", "independent", "stratified", "orthogonal", "ldsampler")
RAYS_A_PASS = 1 << 23
_RENDER_STREAM = 0
_PINHOLE = Pinhole()


def render(
    scene: Scene,
    rig: Rig,
    lens: Lens = _PINHOLE,
    spp: int = 64,
    seed: int = 0,
    *,
    sampler: str = "multijitter",
    progress: Progress | None = None,
) -> list[NDArray[np.float32]]:
    """Photograph `scene` with every camera of `rig` through `lens`.

    Parameters
    ----------
    spp : int
        Samples a pixel, >= 1; exactly as many are taken.
    seed : int
        >= 0. Each camera and pass draws from its own stream of it: eyes that share noise would share a false
        zero-disparity cue.
    sampler : str
        Mitsuba's sampler within a pass. At 16 samples under a wide lens `multijitter` has half the error (MSE) of
        `independent` at the same cost.
    progress : callable, optional
        Called with the fraction done, in (0, 1], after each pass.

    Returns
    -------
    list of float32 (H, W, 3) arrays, one a camera: linear sRGB radiance, the mean over each pixel's square.

    Raises InputError for a bad spp or seed, BackendError when this machine's backend lacks such a camera.
    """
    check_view(scene, rig)
    check_request(spp, seed, sampler)
    check_lens(lens)
    built = build(scene)
    images = []
    for index, (camera, pose) in enumerate(zip(rig.cameras, rig.world_from_cams, strict=True)):
        seeds = np.random.SeedSequence(int(seed), spawn_key=(_RENDER_STREAM, index))
        report = part_of(progress, index, len(rig))
        images.append(_photograph(built, camera, pose, lens, int(spp), seeds, sampler, report))
    return images


def check_request(spp: int, seed: int, sampler: str) -> None:
    """Raise InputError for samples, seeds and samplers that cannot be."""
    if isinstance(spp, bool) or not isinstance(spp, (int, np.integer)) or spp < 1:
        raise InputError(f"spp must be a whole number of samples >= 1, got {spp!r}")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed must be a whole number >= 0, got {seed!r}")
    if sampler not in SAMPLERS:
        raise unknown("sampler", sampler, SAMPLERS)


def check_view(scene: Scene, rig: Rig) -> None:
    """Raise InputError unless this is a scene and a rig to photograph it with."""
    if not isinstance(scene, Scene):
        raise InputError(f"scene must be a Scene, got {scene!r:.60}; load_scene makes one from a name or a file")
    if not isinstance(rig, Rig):
        raise InputError(f"rig must be a Rig, got {rig!r:.60}; Rig.stereo makes one from a camera, Rig from several")


def _photograph(
    built: BuiltScene,
    camera: Camera,
    pose: Float,
    lens: Lens,
    spp: int,
    seeds: np.random.SeedSequence,
    sampler: str,
    report: Progress,
) -> NDArray[np.float32]:
    total = np.zeros((camera.height, camera.width, 3))
    done = 0
    for kind, count, stream in _passes(camera, spp, seeds, sampler):
        sensor = make_sensor(camera, pose, lens, count, kind)
        image = built.integrator.render(built.mi_scene, sensor, seed=stream, spp=count)
        total += count * np.asarray(image, dtype=np.float64)
        done += count
        report(done / spp)
    return (total / spp).astype(np.float32)


def make_sensor(camera: Camera, pose: Float, lens: Lens, spp: int, sampler: str) -> Any:
    """The Mitsuba sensor of one camera and lens in this backend, with a box filter so that bytes repeat."""
    film = {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
        "sample_border": False,
    }
    make = camera_sensor if backend().is_jit else builtin_sensor
    return make(camera, pose, lens, film, {"type": sampler, "sample_count": spp})


def _passes(camera: Camera, spp: int, seeds: np.random.SeedSequence, sampler: str) -> Iterator[tuple[str, int, int]]:
    """(sampler, samples a pixel, seed) of each pass, bounded in memory, `spp` in all.

    Samplers round a count that they have no pattern for, so a pass takes a power of two that they take as it is; where
    there is none, the rest is drawn independently.
    """
    largest = max(1, RAYS_A_PASS // (camera.width * camera.height))
    left = spp
    while left:
        powers = (1 << power for power in reversed(range(min(left, largest).bit_length())))
        count = next((count for count in powers if takes(sampler, count)), None)
        kind, size = ("independent", min(left, largest)) if count is None else (sampler, count)
        yield kind, size, int(seeds.spawn(1)[0].generate_state(1)[0])
        left -= size


@functools.cache
def takes(sampler: str, count: int) -> bool:
    """Whether Mitsuba's sampler draws just `count` samples a pixel when asked for them."""
    return bool(mitsuba().load_dict({"type": sampler, "sample_count": count}).sample_count() == count)


def part_of(progress: Progress | None, index: int, count: int) -> Progress:
    """The progress of one part of `count` as progress of the whole."""
    if progress is None:
        return lambda _: None
    return lambda fraction: progress((index + fraction) / count)
