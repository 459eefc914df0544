"""One sample from one scene: photographs through each lens, digital pictures of them, and the truth.

scene, rig, lens k -> render -> radiance -> sensor -> Shot k --+
scene, rig ---------> ground_truth ----------------> Truths ---+-> dataset.Sample
"""

import hashlib
import zlib
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.camera import Camera, Lens, Rig
from twinlens.dataset import Sample, Shot
from twinlens.rendering import SAMPLERS, backend, ground_truth, render
from twinlens.scenes import Scene
from twinlens.sensor import Sensor

_SHOT_STREAM = 2


def default_rig(
    scene: Scene, width: int, height: int, fov_x_deg: float | None = None, baseline: float | None = None
) -> Rig:
    """The rectified pair a scene was composed for, at this image size; the field of view and baseline may differ."""
    camera = Camera.from_fov(width, height, scene.fov_x_deg if fov_x_deg is None else fov_x_deg)
    return Rig.stereo(camera, scene.baseline if baseline is None else baseline, scene.world_from_left)


def make_sample(
    scene: Scene,
    rig: Rig,
    lenses: Sequence[Lens],
    *,
    spp: int = 64,
    seed: int = 0,
    sensor: Sensor | None = None,
    keep_radiance: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Sample:
    """Photograph `scene` through every lens, expose the pictures, and cast the truth that they share.

    Each lens has its own random stream, derived from `seed`, the scene's name and its place in the list, and its own
    automatic exposure, shared by the eyes. The record says everything that is needed to make the sample again.
    """
    sensor = sensor or Sensor()
    shots = []
    for k, lens in enumerate(lenses):
        stream = _stream(scene, seed, k)
        report = None if progress is None else _part(progress, k, len(lenses))
        radiances = tuple(render(scene, rig, lens, spp, stream, sampler=SAMPLERS[0], progress=report))
        photos = sensor.expose_rig(radiances, rig=rig, lens=lens, seed=stream)
        record = {"spp": spp, "seed": stream, "exposures": [photo.record for photo in photos]}
        shots.append(Shot(lens, tuple(photo.image for photo in photos), radiances if keep_radiance else None, record))
    return Sample(rig, tuple(shots), tuple(ground_truth(scene, rig)), record=_record(scene, seed, spp))


def _stream(scene: Scene, seed: int, k: int) -> int:
    """A seed of its own for each scene and lens: pictures that share grain would teach a network the grain."""
    key = (_SHOT_STREAM, zlib.crc32(scene.name.encode()), k)
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0])


def _record(scene: Scene, seed: int, spp: int) -> dict[str, Any]:
    return {
        "scene": scene.name,
        "scene_files": {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in scene.files},
        "seed": seed,
        "spp": spp,
        "sampler": SAMPLERS[0],
        "integrator": {key: value for key, value in scene.integrator.items() if isinstance(value, (str, int, float))},
        "backend": backend().variant,
        "llvm": Path(backend().library or "").name or None,
        "versions": {name: version(name) for name in ("twinlens", "mitsuba", "drjit", "numpy")},
    }


def _part(progress: Callable[[float], None], index: int, count: int) -> Callable[[float], None]:
    return lambda fraction: progress((index + fraction) / count)
