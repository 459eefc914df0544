"""One sample from one scene: images through each lens, and the ground truth.

scene, rig, lens k -> render -> radiance (-> diffract) -> sensor -> Shot k --+
scene, rig ---------> ground_truth ------------------------------> Truths ---+-> dataset.Sample
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

import twinlens
from twinlens import rendering
from twinlens.camera import Disk, Dual, Lens, Rig
from twinlens.camera.film import diffract
from twinlens.camera.lens import check_lens
from twinlens.camera.truth import Truth
from twinlens.dataset import (
    Manifest,
    Place,
    Row,
    Sample,
    Shot,
    describe,
    read_manifest,
    write_manifest,
    write_sample,
)
from twinlens.errors import InputError, check_number
from twinlens.factory.sources import file_digests
from twinlens.scenes import Scene, bundled_scenes, load_scene, rig_from_table
from twinlens.scenes.rigs import with_values
from twinlens.seeds import derived_seed
from twinlens.sensor import Exposure, Photo, Sensor
from twinlens.sensor.exposure import check_exposure

_SHOT_STREAM = 2
NOT_DIFFRACTED = "dual_pixel and diffraction exclude each other: the Airy pattern is that of the whole aperture"


def make_sample(
    scene: Scene,
    rig: Rig,
    lenses: Sequence[Lens],
    *,
    spp: int = 64,
    denoise: bool = False,
    noise: float | None = None,
    sampler: str | None = None,
    seed: int = 0,
    sensor: Sensor | None = None,
    exposure: Exposure | None = None,
    diffraction: bool = False,
    dual_pixel: bool = False,
    sky_disparity: bool = False,
    keep_radiance: bool = False,
    keep_models: bool = False,
    truths: Sequence[Truth] | None = None,
    progress: rendering.Progress | None = None,
) -> Sample:
    """Render `scene` through every lens, expose the images, and compute their common ground truth.

    Each lens has its own random stream, derived from `seed`, the scene's name and the lens's index. The record has
    everything needed to make the sample again with `remake`. Calibration errors of the rig affect the images; the
    ground truth is that of `Rig.nominal`.

    denoise : see `render`. The record names the method and its versions.
    noise : render until the renderer's noise is at most this multiple of the sensor's in every view, in the median over
        pixels, or until `rendering.MAX_SPP`. The record has the ratios of images that are denoised or have this bound.
    sampler : see `render`.
    sensor : default `Sensor()`. Its `mismatch` makes the cameras and their lenses differ (`Sensor.lenses`); for the
        alignment, give ``sensor.misalign(rig)`` as the rig. Truth is that of the nominal lenses.
    exposure : one exposure for all lenses, so that a smaller aperture gives a darker image. By default each lens has
        its own automatic exposure, which its cameras of the same band share.
    diffraction : blur images by the Airy pattern (`diffract`) at the sensor's wavelengths. Disk apertures only.
    dual_pixel : take the images with dual pixels (`Sensor.expose_dual`) through every lens with an aperture.
    keep_radiance : keep the linear images, including diffraction.
    keep_models : keep the triangles of the scene's objects, in their own axes.
    truths : ``ground_truth(scene, rig.nominal, sky_disparity=sky_disparity)``, if already computed.

    Raises InputError for diffraction with dual pixels or an aperture that is not a disk, and errors of rendering and
    sensor.
    """
    sensor = sensor or Sensor()
    sampler = sampler or rendering.default_sampler(denoise)
    if not lenses:
        raise InputError("a sample needs at least one lens")
    check_exposure(exposure)
    if noise is not None:
        check_number(
            "noise", noise, "a positive multiple of the sensor's noise", above=0
        )
    sensor.check_mismatches(rig)
    for mismatch in sensor.mismatches:
        if exposure is not None:
            mismatch.applied(exposure)
    if dual_pixel and diffraction:
        raise InputError(NOT_DIFFRACTED)
    for lens in lenses:
        check_lens(lens)
        if (
            diffraction
            and lens.aperture_diameter > 0
            and not isinstance(lens.aperture, Disk)
        ):
            shape = lens.aperture.name
            raise InputError(
                f"diffraction needs a disk aperture, got {shape}; disable it or change the aperture"
            )
    shots = []
    for k, lens in enumerate(lenses):
        stream = derived_seed(
            seed, _SHOT_STREAM, scene.name, k
        )  # so that no two images share noise
        report = rendering.partial_progress(
            progress, k / len(lenses), (k + 1) / len(lenses)
        )
        own = sensor.lenses(rig, lens)
        expose = partial(
            sensor.expose_rig, rig=rig, lens=lens, seed=stream, exposure=exposure
        )
        parts = Dual() if dual_pixel and lens.aperture_diameter > 0 else None
        views: Sequence[rendering.NoisyImage] = ()
        used = spp
        if spp > 1 and (denoise or noise is not None):
            views, used = rendering.render_measured(
                scene, rig, own, spp, stream, denoise=denoise, parts=parts, sampler=sampler, progress=report,
                enough=lambda views, expose=expose, lens=lens: noise is None  # type: ignore[misc]
                or max(_noise_ratios(views, expose(_wholes(view.image for view in views)), sensor, rig, lens)) <= noise,
            )  # fmt: skip
            images = [view.image for view in views]
        else:
            images = rendering.render(
                scene,
                rig,
                own,
                spp,
                stream,
                denoise=denoise,
                parts=parts,
                sampler=sampler,
                progress=report,
            )
        radiances = tuple(_wholes(images))
        if diffraction and lens.aperture_diameter > 0:
            radiances = tuple(
                diffract(image, camera, each, sensor.for_band(camera.band).wavelengths)
                for image, camera, each in zip(radiances, rig.cameras, own, strict=True)
            )
        halves = None
        if parts is None:
            photos = expose(radiances)
        else:
            dual = sensor.expose_dual_rig(
                images, rig=rig, lens=lens, seed=stream, exposure=exposure
            )
            photos, halves = (
                [whole for *_, whole in dual],
                tuple((left.image, right.image) for left, right, _ in dual),
            )
        ratios = (
            {"light_paths_over_sensor": _noise_ratios(views, photos, sensor, rig, lens)}
            if views
            else {}
        )
        taken = {
            "spp": used,
            **ratios,
            "seed": stream,
            "exposures": [photo.record for photo in photos],
        }
        kept = radiances if keep_radiance else None
        shots.append(
            Shot(lens, tuple(photo.image for photo in photos), kept, taken, halves)
        )
    record = {
        "scene": scene.name,
        "scene_files": file_digests(scene),
        "sky": dict(scene.sky.record) if scene.sky else None,
        **({} if scene.ambient == 1 else {"ambient": scene.ambient}),
        "seed": seed,
        "spp": spp,
        "denoise": _denoise_record(scene, rig) if denoise else None,
        "noise": noise,
        "sensor": sensor.record(),
        "exposure": None if exposure is None else asdict(exposure),
        "diffraction": diffraction,
        "dual_pixel": dual_pixel,
        "sky_disparity": sky_disparity,
        "keep_radiance": keep_radiance,
        "keep_models": keep_models,
        "sampler": sampler,
        "integrator": {
            key: value
            for key, value in scene.integrator.items()
            if isinstance(value, (str, int, float))
        },
        **made_with(),
        "llvm": Path(rendering.backend().library or "").name or None,
    }
    if truths is None:
        truths = rendering.ground_truth(scene, rig.nominal, sky_disparity=sky_disparity)
    models = rendering.object_models(scene) if keep_models else {}
    return Sample(rig, tuple(shots), tuple(truths), models=models, record=record)


def _wholes(images: Iterable[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
    """The whole images (H, W, 3), of which each may be given as its parts (P, H, W, 3)."""
    return [image.sum(axis=0) if image.ndim == 4 else image for image in images]


def _denoise_record(scene: Scene, rig: Rig) -> dict[str, Any] | None:
    """How images were denoised, and of which cameras unless of all; None if of none."""
    cameras = rendering.denoised_cameras(scene, rig)
    some = {} if len(cameras) == len(rig) else {"cameras": cameras}
    return {**rendering.denoiser_record(), **some} if cameras else None


def _noise_ratios(
    views: Sequence[rendering.NoisyImage],
    photos: Sequence[Photo],
    sensor: Sensor,
    rig: Rig,
    lens: Lens,
) -> list[float]:
    """Per view: noise of the light paths over noise of the sensor at the exposure of its photo, median over pixels.

    Both are standard deviations in electrons, over the channels and windows of 9x9 pixels. The sensor's noise is that
    of photons, readout and rounding. A mono sensor's is that of the sum of the channels.
    """
    found = []
    for view, photo, camera in zip(views, photos, rig.cameras, strict=True):
        rate = sensor.pixel_rates(camera, lens) * photo.record["time_s"]
        electrons, error = (
            np.maximum(_wholes([view.image])[0] * rate, 0),
            view.error * rate,
        )
        if sensor.for_band(camera.band).filters == "mono":
            electrons, error = (
                part.sum(axis=-1, keepdims=True) for part in (electrons, error)
            )
        least = (
            sensor.read_noise**2
            + (1 / photo.record["system_gain_dn_per_electron"]) ** 2 / 12
        )
        excess = np.nan_to_num(error**2 / (electrons + least)).mean(axis=-1)
        found.append(float(np.sqrt(np.median(uniform_filter(excess, 9)))))
    return found


def made_with() -> dict[str, Any]:
    """Backend and versions of this process; samples made with equal ones are the same to the byte."""
    others = {name: metadata.version(name) for name in ("mitsuba", "drjit", "numpy")}
    return {
        "backend": rendering.backend().variant,
        "versions": {"twinlens": twinlens.__version__, **others},
    }


def default_rig(
    scene: Scene,
    width: int,
    height: int,
    fov_x_deg: float | None = None,
    baseline: float | None = None,
    intrinsics: Mapping[str, Any] | None = None,
) -> Rig:
    """The rig in the scene's file, or a rectified pair at the scene's viewpoint, of width x height pixels.

    fov_x_deg, baseline : replace the scene's.
    intrinsics : keys of a rig's table (docs/rigs.md) that replace those of all cameras: fx, fy, cx, cy, distortion,
        pixel_pitch_um, sensor_width_mm, and `camera`, without its size, which replaces all of them and, with a preset
        of a pair, the baseline.

    Raises InputError.
    """
    options = {"fov_x_deg": fov_x_deg, "baseline": baseline, **(intrinsics or {})}
    given = {key: value for key, value in options.items() if value is not None}
    if "camera" in given:
        given["camera"] = {**given["camera"], "width": width, "height": height}
    return rig_from_table(with_values(scene.rig or {}, given), scene, width, height)


def check_common_view(rig: Rig, scene: Scene) -> None:
    """Raise InputError for parallel views that are farther apart than they are wide at the scene's far end."""
    camera, far = rig.cameras[0], scene.depth_range[1]
    wide = far * camera.width / camera.fx
    parallel = len(rig) > 1 and abs(rig.b_from_a(0, 1)[2, 2] - 1) < 1e-9
    if parallel and rig.baseline() >= wide:
        raise InputError(
            f"--baseline {rig.baseline():g}: the views have nothing in common; at {far:g} m, the far end of "
            f"{scene.name}, each is {wide:.3g} m wide"
        )


def add_sample(
    output: Place, name: str, sample: Sample, seed: int, overwrite: bool = False
) -> Row:
    """Write a sample into a dataset that no recipe made: its folder, its row in dataset.json, and the card.

    dataset.json keeps its recipe, its other info and its other rows. It has a seed only while all samples share it. The
    row has the SHA-256 of the files of the sky, and of the scene unless it is a bundled one, for ASSETS.md.
    """
    sky, files = sample.record.get("sky"), sample.record.get("scene_files", {})
    sources = {sky["file"]: sky["sha256"]} if sky else {}
    if name not in bundled_scenes() or files != file_digests(load_scene(name)):
        sources |= {f"{name}/{file}": digest for file, digest in files.items()}
    info = {"scene": name, **({"sources": sources} if sources else {})}
    row = Row(name, write_sample(output / name, sample, overwrite), info)
    before = (
        read_manifest(output)
        if (output / "dataset.json").exists()
        else Manifest((), seed=seed)
    )
    known = {each.name: each for each in before.rows} | {name: row}
    shared = before.seed if before.recipe or before.seed == seed else None
    write_manifest(
        output, Manifest(tuple(known.values()), before.recipe, shared, before.info)
    )
    describe(output)
    return row
