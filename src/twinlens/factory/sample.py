"""One sample from one scene: images through each lens, and the ground truth.

scene, rig, lens k -> render -> radiance (-> diffract) -> sensor -> Shot k --+
scene, rig ---------> ground_truth ------------------------------> Truths ---+-> dataset.Sample
"""

import zlib
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Disk, Lens, Rig
from twinlens.camera.diffraction import diffract
from twinlens.camera.lens import check_lens
from twinlens.camera.truth import Truth
from twinlens.dataset import Manifest, Place, Row, Sample, Shot, describe, read_manifest, write_manifest, write_sample
from twinlens.errors import InputError
from twinlens.factory.sources import file_digests
from twinlens.rendering import SAMPLERS, Progress, backend, ground_truth, partial_progress, render
from twinlens.scenes import Scene
from twinlens.sensor import Exposure, Sensor
from twinlens.sensor.exposure import check_exposure

_SHOT_STREAM = 2


def make_sample(
    scene: Scene,
    rig: Rig,
    lenses: Sequence[Lens],
    *,
    spp: int = 64,
    seed: int = 0,
    sensor: Sensor | None = None,
    exposure: Exposure | None = None,
    diffraction: bool = False,
    sky_disparity: bool = False,
    keep_radiance: bool = False,
    truths: Sequence[Truth] | None = None,
    progress: Progress | None = None,
) -> Sample:
    """Render `scene` through every lens, expose the images, and compute their common ground truth.

    Each lens has its own random stream, derived from `seed`, the scene's name and the lens's index. The record has
    everything needed to make the sample again with `remake`. Calibration errors of the rig affect the images; the
    ground truth is that of `Rig.nominal`.

    Parameters
    ----------
    sensor : Sensor, optional
        Default `Sensor()`. Its `mismatch` makes the cameras differ.
    exposure : Exposure, optional
        One exposure for all lenses, so that a smaller aperture gives a darker image. By default each lens has its own
        automatic exposure, which its cameras share.
    diffraction : bool
        Blur images by the Airy pattern of the aperture (`twinlens.optics.diffraction`), at the sensor's wavelengths.
        Disk apertures only.
    sky_disparity : bool
        See `ground_truth`.
    keep_radiance : bool
        Keep the linear images, including diffraction.
    truths : sequence of Truth, optional
        ``ground_truth(scene, rig.nominal, sky_disparity=sky_disparity)``, if already computed.

    Raises
    ------
    InputError
        Diffraction with an aperture that is not a disk, and errors of rendering and sensor.
    """
    sensor = sensor or Sensor()
    _check(lenses, exposure, sensor, diffraction)
    shots = []
    for k, lens in enumerate(lenses):
        stream = _stream(scene, seed, k)
        report = partial_progress(progress, k / len(lenses), (k + 1) / len(lenses))
        radiances = tuple(render(scene, rig, lens, spp, stream, sampler=SAMPLERS[0], progress=report))
        if diffraction and lens.aperture_diameter > 0:
            radiances = _diffracted(radiances, rig, lens, sensor)
        photos = sensor.expose_rig(radiances, rig=rig, lens=lens, seed=stream, exposure=exposure)
        record = {"spp": spp, "seed": stream, "exposures": [photo.record for photo in photos]}
        shots.append(Shot(lens, tuple(photo.image for photo in photos), radiances if keep_radiance else None, record))
    request = {
        "seed": seed,
        "spp": spp,
        "sensor": asdict(sensor),
        "exposure": None if exposure is None else asdict(exposure),
        "diffraction": diffraction,
        "sky_disparity": sky_disparity,
        "keep_radiance": keep_radiance,
    }
    if truths is None:
        truths = ground_truth(scene, rig.nominal, sky_disparity=sky_disparity)
    return Sample(rig, tuple(shots), tuple(truths), record=_record(scene, request))


def _check(lenses: Sequence[Lens], exposure: Exposure | None, sensor: Sensor, diffraction: bool) -> None:
    """Check every lens before the first image is rendered."""
    if not lenses:
        raise InputError("a sample needs at least one lens")
    for lens in lenses:
        check_lens(lens)
    check_exposure(exposure)
    if exposure is not None:
        sensor.mismatch.applied(exposure)
    for lens in lenses if diffraction else ():
        if lens.aperture_diameter > 0 and not isinstance(lens.aperture, Disk):
            raise InputError(
                f"diffraction needs a disk aperture, got {lens.aperture.name}; disable it or change the aperture"
            )


def _diffracted(
    radiances: tuple[NDArray[np.float32], ...], rig: Rig, lens: Lens, sensor: Sensor
) -> tuple[NDArray[np.float32], ...]:
    return tuple(
        diffract(image, camera, lens, sensor.wavelengths) for image, camera in zip(radiances, rig.cameras, strict=True)
    )


def _stream(scene: Scene, seed: int, k: int) -> int:
    """A seed for each scene and lens, so that images do not share noise."""
    key = (_SHOT_STREAM, zlib.crc32(scene.name.encode()), k)
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0])


def _record(scene: Scene, request: dict[str, Any]) -> dict[str, Any]:
    return {
        "scene": scene.name,
        "scene_files": file_digests(scene),
        **request,
        "sampler": SAMPLERS[0],
        "integrator": {key: value for key, value in scene.integrator.items() if isinstance(value, (str, int, float))},
        **made_with(),
        "llvm": Path(backend().library or "").name or None,
    }


def made_with() -> dict[str, Any]:
    """Backend and versions of this process; samples made with equal ones are the same to the byte."""
    versions = {name: version(name) for name in ("twinlens", "mitsuba", "drjit", "numpy")}
    return {"backend": backend().variant, "versions": versions}


def add_sample(output: Place, name: str, sample: Sample, seed: int, overwrite: bool = False) -> Row:
    """Write a sample into a dataset that no recipe made: its folder, its row in dataset.json, and the card.

    dataset.json keeps its recipe, its other info and its other rows. It has a seed only while all samples share it.
    """
    row = Row(name, write_sample(output / name, sample, overwrite), {"scene": name})
    before = read_manifest(output) if (output / "dataset.json").exists() else Manifest((), seed=seed)
    known = {each.name: each for each in before.rows} | {name: row}
    shared = before.seed if before.recipe or before.seed == seed else None
    write_manifest(output, Manifest(tuple(known.values()), before.recipe, shared, before.info))
    describe(output)
    return row
