"""One sample from one scene: images through each lens, and the ground truth.

scene, rig, lens k -> render -> radiance (-> diffract) -> sensor -> Shot k --+
scene, rig ---------> ground_truth ------------------------------> Truths ---+-> dataset.Sample
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

import twinlens
from twinlens import rendering
from twinlens.camera import ApertureLens, Disk, Dual, RecipeLens, Rig
from twinlens.camera.film import diffract
from twinlens.camera.lens import require_aperture, require_paraxial
from twinlens.camera.truth import Truth
from twinlens.dataset import (
    Frame,
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
from twinlens.dataset.lens_labels import LABEL
from twinlens.errors import InputError
from twinlens.factory.sequences import frame_sums
from twinlens.factory.sources import file_digests
from twinlens.scenes import Scene, bundled_scenes, load_scene, rig_from_table
from twinlens.scenes.rigs import with_values
from twinlens.seeds import derived_seed
from twinlens.sensor import Exposure, Photo, Sensor
from twinlens.settings import Setting, Settings, fields_of

_SHOT_STREAM = 2
NOT_DIFFRACTED = "dual_pixel and diffraction exclude each other: the Airy pattern is that of the whole aperture"


@dataclass(frozen=True)
class Shoot(Settings, noun="sample"):
    """How a sample is taken. Its record has these values, and `remake` reads them.

    With a bound of the noise, or with denoising, the record has the ratios of the renderer's noise to the sensor's.
    Without an exposure, each lens has its own automatic exposure, which its cameras of the same band share; one
    exposure for all lenses makes the images of a smaller aperture darker.

    Raises InputError when a value is out of range, and for diffraction with dual pixels.
    """

    seed: Annotated[int, Setting("Seed of everything random.", least=0)] = 0
    spp: Annotated[int, Setting("Samples per pixel.", least=1, most=1_000_000)] = 64
    denoise: Annotated[
        bool, Setting("Remove the renderer's noise; adds a small bias.")
    ] = False
    noise: Annotated[
        float | None,
        Setting(
            "Double the samples, to at most 1024, until the renderer's noise is at most this multiple of the"
            " sensor's, such as 0.3.",
            above=0,
        ),
    ] = None
    sensor: Annotated[
        Sensor, Setting("The sensor, with the mismatches of its cameras.")
    ] = Sensor()  # noqa: RUF009  a frozen value
    exposure: Annotated[
        Exposure | None, Setting("One exposure for all lenses; automatic by default.")
    ] = None
    diffraction: Annotated[
        bool, Setting("Apply each lens's Airy pattern; disk apertures only.")
    ] = False
    dual_pixel: Annotated[
        bool,
        Setting("Also take the images of the halves of each lens (dp-left0.png ...)."),
    ] = False
    sky_disparity: Annotated[
        bool, Setting("Give the sky the disparity at infinity instead of unknown.")
    ] = False
    keep_radiance: Annotated[
        bool,
        Setting("Also keep the linear images, with diffraction (radiance0.exr ...)."),
    ] = False
    keep_models: Annotated[
        bool, Setting("Also keep the triangles of the scene's objects (models/*.ply).")
    ] = False
    sampler: Annotated[
        str | None,
        Setting(
            "Sampler of the light paths; by default that of the denoiser or of plain images.",
            choices=rendering.SAMPLERS,
        ),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dual_pixel and self.diffraction:
            raise InputError(NOT_DIFFRACTED)
        if self.exposure is not None:
            for mismatch in self.sensor.mismatches:
                mismatch.applied(self.exposure)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Shoot":
        """The settings in a sample's record. Those that earlier versions did not write get their defaults."""
        values = {name: record[name] for name in fields_of(cls) if name in record}
        values["denoise"] = (
            values.get("denoise") is not None
        )  # the record has the method
        values.setdefault("sampler", "multijitter")  # that of versions without the key
        values["sensor"] = Sensor.from_record(values["sensor"])
        if values.get("exposure") is not None:
            values["exposure"] = Exposure(**values["exposure"])
        return cls(**values)

    @property
    def measures_noise(self) -> bool:
        """Whether the renderer's noise is measured, from two images of half the samples."""
        return self.spp > 1 and (self.denoise or self.noise is not None)

    def check(self, rig: Rig, lenses: Sequence[RecipeLens]) -> None:
        """Raise InputError unless the rig and the lenses can be used."""
        if not lenses:
            raise InputError("a sample needs at least one lens")
        self.sensor.check_mismatches(rig)
        if any(camera.is_wide for camera in rig.cameras):
            raise InputError(
                "a sample holds depth along the axis: its cameras must see less than 90 degrees from theirs; crop a "
                "fisheye's images: a smaller width and height, and cx and cy less by what is cut left and above"
            )
        self._check_frames(rig)
        for lens in lenses:
            if require_aperture(lens, "a sample").aperture_diameter > 0:
                self._check_open(lens)

    def _check_frames(self, rig: Rig) -> None:
        """Raise InputError for what a sequence of patterns excludes, and for more frames than the memory holds."""
        if rig.num_frames == 1:
            return
        if self.dual_pixel:
            raise InputError(
                "dual_pixel and a projector's sequence exclude each other; remove one"
            )
        # The noise of the first frame is measured at its own exposure: that of all frames only if it is the brightest.
        first = [lamp.pattern for lamp in rig.projectors if lamp.num_frames > 1]
        if self.noise is not None and not all(image.min() == 1 for image in first):
            raise InputError(
                "a bound of the noise needs a projector's sequence that starts with white, by which it is measured: "
                'put { type = "white" } first, or leave noise out'
            )
        rendering.check_memory(rig, rig.num_frames)

    def _check_open(self, lens: RecipeLens) -> None:
        """Raise InputError for a lens that has no dual pixels or diffraction, where they are asked for."""
        if self.dual_pixel:
            require_paraxial(lens, "an image of dual pixels")
        if self.diffraction and not isinstance(lens.aperture, Disk):
            shape = lens.aperture.name
            raise InputError(
                f"diffraction needs a disk aperture, got {shape}; disable it or change the aperture"
            )


def make_sample(
    scene: Scene,
    rig: Rig,
    lenses: Sequence[RecipeLens],
    shoot: Shoot | None = None,
    *,
    truths: Sequence[Truth] | None = None,
    labels: Sequence[str] = (),
    progress: rendering.Progress | None = None,
) -> Sample:
    """Render `scene` through every lens, expose the images, and compute their common ground truth.

    Each lens has its own random stream, derived from the seed, the scene's name and the lens's index. The record has
    everything needed to make the sample again with `remake`. Calibration errors of the rig affect the images; the
    ground truth is that of `Rig.nominal`.

    Where projectors have a sequence of patterns, each lens takes a frame of each pattern, with one exposure. All frames
    have the same light paths, so the renderer's noise does not differ between them, and noise of the sensor of their
    own; its fixed patterns are those of the sensor.

    shoot : by default `Shoot()`. The mismatch of its sensor makes the cameras and their lenses differ
        (`Sensor.lenses`); for the alignment, give ``sensor.misalign(rig)`` as the rig. Truth is that of the nominal
        lenses.
    truths : ``ground_truth(scene, rig.nominal, sky_disparity=shoot.sky_disparity)``, if already computed.
    labels : of the lenses, as their author wrote them, for boards and pages; recorded, if there are any.

    Raises InputError as `Shoot.check`, and errors of rendering and sensor.
    """
    shoot = shoot or Shoot()
    shoot.check(rig, lenses)
    shots = []
    for k, lens in enumerate(lenses):
        # A stream for each scene and lens, so that no two images share noise.
        stream = derived_seed(shoot.seed, _SHOT_STREAM, scene.name, k)
        report = rendering.partial_progress(
            progress, k / len(lenses), (k + 1) / len(lenses)
        )
        shot = _Photographer(scene, rig, lens, shoot, stream).shot(report)
        if labels:
            shot = replace(shot, record={LABEL: labels[k], **shot.record})
        shots.append(shot)
    if truths is None:
        truths = rendering.ground_truth(
            scene, rig.nominal, sky_disparity=shoot.sky_disparity
        )
    models = rendering.object_models(scene) if shoot.keep_models else {}
    record = _record(scene, rig, shoot)
    return Sample(rig, tuple(shots), tuple(truths), models=models, record=record)


def _record(scene: Scene, rig: Rig, shoot: Shoot) -> dict[str, Any]:
    """Everything that made a sample: scene, settings, renderer, versions."""
    settings = asdict(shoot)
    settings["denoise"] = _denoise_record(scene, rig) if shoot.denoise else None
    settings["sampler"] = shoot.sampler or rendering.default_sampler(shoot.denoise)
    integrator = {
        key: value
        for key, value in scene.integrator.items()
        if isinstance(value, (str, int, float))
    }
    return {
        "scene": scene.name,
        "scene_files": file_digests(scene),
        "sky": dict(scene.sky.record) if scene.sky else None,
        **({} if scene.ambient == 1 else {"ambient": scene.ambient}),
        **settings,
        "integrator": integrator,
        **made_with(),
        "llvm": Path(rendering.backend().library or "").name or None,
    }


@dataclass(frozen=True, eq=False)
class _Light:
    """What the cameras see in one frame, before their sensors.

    images : per camera (H, W, 3), or the parts of its aperture (P, H, W, 3).
    radiances : the whole images, diffracted.
    views : the images with estimates of their noise, where it was measured.
    spp : samples per pixel used.
    """

    images: Sequence[NDArray[np.float32]]
    radiances: Sequence[NDArray[np.float32]]
    views: Sequence[rendering.NoisyImage]
    spp: int


@dataclass(frozen=True)
class _Photographer:
    """Takes the images of one lens; `seed` is that of its light paths and of its sensors' noise."""

    scene: Scene
    rig: Rig
    lens: RecipeLens
    shoot: Shoot
    seed: int

    def shot(self, progress: rendering.Progress | None) -> Shot:
        """The images of all cameras in all frames, and the record of how they were taken."""
        lights = self._rendered(progress)
        brightest = None
        if len(lights) > 1:
            per_camera = zip(*(light.radiances for light in lights), strict=True)
            brightest = [np.maximum.reduce(radiances) for radiances in per_camera]
        frames, halves = [], None
        for number, light in enumerate(lights):
            # Each frame has noise of its own; fixed patterns are those of the sensor.
            seed = derived_seed(self.seed, "frame", number) if number else self.seed
            photos, halves = self._exposed(light, seed, brightest)
            frames.append(self._frame(light, photos, seed))
        first = frames[0]
        return Shot(
            self.lens,
            first.images,
            first.radiances,
            first.record,
            halves,
            tuple(frames[1:]),
        )

    def _rendered(self, progress: rendering.Progress | None) -> list[_Light]:
        """The light of each frame. All frames have the random numbers and the samples per pixel of the first."""
        count = self.rig.num_frames
        rigs = [self.rig.at_frame(number) for number in range(count)]
        lights: list[_Light] = []
        # A denoised image is not linear in the light: each is rendered.
        sums = [None] * count if self.shoot.denoise else frame_sums(rigs)
        for number, parts in enumerate(sums):
            if parts is not None:
                lights.append(self._summed(*(lights[part] for part in parts)))
                continue
            report = rendering.partial_progress(
                progress, number / count, (number + 1) / count
            )
            doublings = None
            if lights:
                doublings = round(np.log2(lights[0].spp / self.shoot.spp))
            lights.append(self._light(rigs[number], report, doublings))
        return lights

    def _summed(self, a: _Light, b: _Light, c: _Light) -> _Light:
        """The light a + b - c of a frame, see `factory.sequences`."""
        # Rounding can leave a black pixel below 0.
        images = [
            np.maximum(_sum(*of_camera), 0)
            for of_camera in zip(a.images, b.images, c.images, strict=True)
        ]
        errors = [
            _sum(first.error, second.error, third.error)
            for first, second, third in zip(a.views, b.views, c.views, strict=True)
        ]
        pairs = zip(images, errors, strict=False)  # no errors where they are unknown
        views = [rendering.NoisyImage(image, error) for image, error in pairs]
        return _Light(images, self._diffracted(_wholes(images)), views, a.spp)

    def _light(
        self, rig: Rig, progress: rendering.Progress | None, doublings: int | None
    ) -> _Light:
        """The light of one frame; its samples are doubled this often, or until the noise is small enough."""
        shoot, spp = self.shoot, self.shoot.spp
        request = (self.scene, rig, self._lenses, spp, self.seed)
        how: dict[str, Any] = {
            "denoise": shoot.denoise,
            "parts": self._parts,
            "sampler": shoot.sampler or rendering.default_sampler(shoot.denoise),
            "progress": progress,
        }
        views: Sequence[rendering.NoisyImage] = ()
        if shoot.measures_noise:
            rounds = iter(range(doublings or 0))
            views, spp = rendering.render_measured(
                *request,
                **how,
                enough=self._is_clean_enough
                if doublings is None
                else lambda views: next(rounds, None) is None,
            )
            images = [view.image for view in views]
        else:
            images = list(rendering.render(*request, **how))
        return _Light(images, self._diffracted(_wholes(images)), views, spp)

    def _frame(self, light: _Light, photos: Sequence[Photo], seed: int) -> Frame:
        """The images of a frame, and the record of how they were taken."""
        record: dict[str, Any] = {"spp": light.spp}
        if light.views:
            record["light_paths_over_sensor"] = self._noise_ratios(light.views, photos)
        unlit = [view for view, film in enumerate(light.radiances) if not film.any()]
        if unlit:
            record["unlit_views"] = unlit
        record["seed"] = seed
        record["exposures"] = [photo.record for photo in photos]
        kept = tuple(light.radiances) if self.shoot.keep_radiance else None
        return Frame(tuple(photo.image for photo in photos), kept, record)

    @property
    def _parts(self) -> Dual | None:
        """The halves of the aperture that dual pixels see."""
        is_open = self.lens.aperture_diameter > 0
        return Dual() if self.shoot.dual_pixel and is_open else None

    @property
    def _lenses(self) -> tuple[ApertureLens, ...]:
        """The lens of each camera, with its mismatch."""
        return self.shoot.sensor.lenses(self.rig, self.lens)

    def _is_clean_enough(self, views: Sequence[rendering.NoisyImage]) -> bool:
        if self.shoot.noise is None:
            return True
        photos = self._photos(_wholes(view.image for view in views), self.seed)
        return max(self._noise_ratios(views, photos)) <= self.shoot.noise

    def _noise_ratios(
        self, views: Sequence[rendering.NoisyImage], photos: Sequence[Photo]
    ) -> list[float]:
        return _noise_ratios(views, photos, self.shoot.sensor, self.rig, self.lens)

    def _diffracted(
        self, radiances: list[NDArray[np.float32]]
    ) -> list[NDArray[np.float32]]:
        if not self.shoot.diffraction or self.lens.aperture_diameter == 0:
            return radiances
        return [
            diffract(
                image, camera, lens, self.shoot.sensor.for_band(camera.band).wavelengths
            )
            for image, camera, lens in zip(
                radiances, self.rig.cameras, self._lenses, strict=True
            )
        ]

    def _photos(
        self,
        radiances: Sequence[NDArray[np.float32]],
        seed: int,
        brightest: Sequence[NDArray[np.float32]] | None = None,
    ) -> list[Photo]:
        return self.shoot.sensor.expose_rig(
            radiances,
            rig=self.rig,
            lens=self.lens,
            seed=seed,
            exposure=self.shoot.exposure,
            brightest=brightest,
        )

    def _exposed(
        self,
        light: _Light,
        seed: int,
        brightest: Sequence[NDArray[np.float32]] | None,
    ) -> tuple[list[Photo], tuple[Any, ...] | None]:
        """The photos, and of dual pixels the images of the left and right half of each."""
        if self._parts is None:
            return self._photos(light.radiances, seed, brightest), None
        dual = self.shoot.sensor.expose_dual_rig(
            light.images,
            rig=self.rig,
            lens=self.lens,
            seed=seed,
            exposure=self.shoot.exposure,
        )
        photos = [whole for _, _, whole in dual]
        return photos, tuple((left.image, right.image) for left, right, _ in dual)


def _sum(
    a: NDArray[np.float32], b: NDArray[np.float32], c: NDArray[np.float32]
) -> NDArray[np.float32]:
    """a + b - c, rounded once."""
    return (a.astype(np.float64) + b - c).astype(np.float32)


def _noise_ratios(
    views: Sequence[rendering.NoisyImage],
    photos: Sequence[Photo],
    sensor: Sensor,
    rig: Rig,
    lens: RecipeLens,
) -> list[float]:
    """Per view: noise of the light paths over noise of the sensor at the exposure of its photo, median over pixels.

    Both are standard deviations in electrons, over the channels and windows of 9x9 pixels. The sensor's noise is
    that of photons, readout and rounding. A mono sensor adds up the channels, and so do the errors with their signs.
    """
    ratios = []
    for view, photo, camera in zip(views, photos, rig.cameras, strict=True):
        rate = sensor.pixel_rates(camera, lens) * photo.record["time_s"]
        electrons = np.maximum(_wholes([view.image])[0] * rate, 0)
        error = view.error * rate
        of_band = sensor.for_band(camera.band)
        if of_band.filters == "mono":
            electrons = electrons.sum(axis=-1, keepdims=True)
            error = error.sum(axis=-1, keepdims=True)
        # Rounding to a digital number has a variance of 1/12 DN^2.
        step = 1 / photo.record["system_gain_dn_per_electron"]
        least = of_band.read_noise**2 + step**2 / 12
        excess = np.nan_to_num(error**2 / (electrons + least)).mean(axis=-1)
        ratios.append(float(np.sqrt(np.median(uniform_filter(excess, 9)))))
    return ratios


def _wholes(images: Iterable[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
    """The whole images (H, W, 3), of which each may be given as its parts (P, H, W, 3)."""
    return [image.sum(axis=0) if image.ndim == 4 else image for image in images]


def _denoise_record(scene: Scene, rig: Rig) -> dict[str, Any] | None:
    """The denoiser, with the list of denoised cameras if some are not; None if no camera is denoised."""
    cameras = rendering.denoised_cameras(scene, rig)
    some = {} if len(cameras) == len(rig) else {"cameras": cameras}
    return {**rendering.denoiser_record(), **some} if cameras else None


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
    changes = {key: value for key, value in options.items() if value is not None}
    if "camera" in changes:
        changes["camera"] = {**changes["camera"], "width": width, "height": height}
    return rig_from_table(with_values(scene.rig or {}, changes), scene, width, height)


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
    output: Place,
    name: str,
    sample: Sample,
    seed: int | None,
    overwrite: bool = False,
    info: Mapping[str, Any] | None = None,
) -> Row:
    """Write a sample into a dataset that no recipe made: its folder, its row in dataset.json, and the card.

    info : of the row, such as its split; by default the scene, with the name of the sample, and its files.

    dataset.json keeps its recipe, its other info and its other rows. It has a seed only while all samples share it. The
    row has the SHA-256 of the files of the sky, and of the scene unless it is a bundled one, for ASSETS.md.
    """
    row_info = _scene_info(name, sample) if info is None else info
    row = Row(name, write_sample(output / name, sample, overwrite), row_info)
    before = (
        read_manifest(output)
        if (output / "dataset.json").exists()
        else Manifest((), seed=seed)
    )
    rows = {earlier.name: earlier for earlier in before.rows} | {name: row}
    shared = before.seed if before.recipe or before.seed == seed else None
    write_manifest(
        output, Manifest(tuple(rows.values()), before.recipe, shared, before.info)
    )
    describe(output)
    return row


def _scene_info(name: str, sample: Sample) -> dict[str, Any]:
    """The scene of a sample that is called after it, and the files of scene and sky unless the scene is bundled."""
    sky, files = sample.record.get("sky"), sample.record.get("scene_files", {})
    sources = {sky["file"]: sky["sha256"]} if sky else {}
    if name not in bundled_scenes() or files != file_digests(load_scene(name)):
        sources |= {f"{name}/{file}": digest for file, digest in files.items()}
    return {"scene": name, **({"sources": sources} if sources else {})}
