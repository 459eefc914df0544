"""The EMVA 1288 linear camera model: shot noise, dark current, fixed patterns, saturation, read noise, quantisation.

A pixel with mu expected electrons counts a Poisson number of them and a Poisson number of dark electrons, saturates at
the full well, and is read with normal noise. K converts electrons to digital numbers (DN) above the black level::

    y = round(K (min(Poisson(mu (1 + PRNU)) + Poisson(dark), full well) + DSNU + read noise) + black)

Each source of noise has its own random stream (`twinlens.seeds`) for each camera. PRNU and DSNU are seeded by the
sensor's serial number, the others by the exposure's seed.

In a dual-pixel sensor each pixel has two photodiodes, which see the halves of the aperture (`Sensor.expose_dual`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import ApertureLens, Camera, Rig, film_distance
from twinlens.camera.film import checked_radiance
from twinlens.camera.intrinsics import BANDS
from twinlens.camera.lens import require_aperture
from twinlens.errors import InputError, check_int, check_known, counted, format_value
from twinlens.geometry import Float
from twinlens.optics.diffraction import (
    CHANNEL_WAVELENGTHS,
    LONGEST_WAVE,
    SHORTEST_WAVE,
)
from twinlens.seeds import derived_seed, generator
from twinlens.sensor import light, picture
from twinlens.sensor.exposure import Exposure, automatic, check_exposure
from twinlens.sensor.mismatch import Mismatch, misalign
from twinlens.sensor.picture import Image
from twinlens.sensor.presets import PRESETS
from twinlens.settings import Setting, Settings

OUTPUTS = (*picture.CURVES, "raw")
_MAX_WELLS = (
    4.0  # limit of expected electrons, in full wells; such pixels are saturated anyway
)


@dataclass(frozen=True, eq=False)
class Photo:
    """An image, uint8 or uint16, (H, W, 3) or (H, W), and the record of its exposure, a plain dict."""

    image: Image
    record: dict[str, Any]


@dataclass(frozen=True)
class _Frame:
    """One exposure of one camera: `exposure` without the camera's mismatch, `eye` the index of the camera."""

    camera: Camera
    lens: ApertureLens
    exposure: Exposure
    seed: int
    eye: int


@dataclass(frozen=True)
class Sensor(Settings, noun="sensor"):
    """An image sensor after EMVA 1288. The defaults are the preset `machine_vision`.

    A camera of the band "nir" has `nir_efficiency` and `nir_wavelength` in place of the three of the other bands
    (`for_band`). A raw image is uint8 for 8 adc_bits, otherwise uint16, with neither white balance nor demosaicing.

    Raises InputError when a value is out of range.
    """

    quantum_efficiency: Annotated[
        tuple[float, float, float],
        Setting(
            "Electrons per photon in the red, green and blue band.", above=0, most=1
        ),
    ] = (0.55, 0.62, 0.50)
    wavelengths: Annotated[
        tuple[float, float, float],
        Setting(
            "Of the red, green and blue band.",
            "metres",
            least=SHORTEST_WAVE,
            most=LONGEST_WAVE,
        ),
    ] = CHANNEL_WAVELENGTHS
    nir_efficiency: Annotated[
        float, Setting("Electrons per photon in the near infrared.", least=1e-9, most=1)
    ] = 0.15
    nir_wavelength: Annotated[
        float, Setting("Of the near infrared band.", "metres", least=7e-7, most=1.1e-6)
    ] = 850e-9
    full_well: Annotated[
        float,
        Setting("Saturation capacity of a pixel.", "electrons", least=1, most=1e9),
    ] = 10700.0
    read_noise: Annotated[
        float,
        Setting(
            "Temporal dark noise at zero exposure, rms.", "electrons", least=0, most=1e9
        ),
    ] = 2.3
    dark_current: Annotated[
        float,
        Setting("Dark current of a pixel.", "electrons per second", least=0, most=1e9),
    ] = 1.0
    prnu: Annotated[
        float,
        Setting(
            "Non-uniformity of the pixels' sensitivity, relative rms; 0.01 is 1 %.",
            least=0,
            most=10,
        ),
    ] = 0.005
    dsnu: Annotated[
        float,
        Setting(
            "Non-uniformity of the pixels' dark offset, rms.",
            "electrons",
            least=0,
            most=1e9,
        ),
    ] = 1.0
    adc_bits: Annotated[
        int,
        Setting(
            "Bits of the converter; at gain 1 a full well fills its range above the black level.",
            least=8,
            most=16,
        ),
    ] = 12
    black_level: Annotated[
        float, Setting("Digital number of zero electrons.", "DN", least=0)
    ] = 64.0
    filters: Annotated[
        str,
        Setting(
            "Three values per pixel (rgb), one (mono), or a Bayer colour filter array.",
            choices=picture.FILTERS,
        ),
    ] = "rgb"
    output: Annotated[
        str,
        Setting(
            "Tone curve: srgb, linear, gamma (1/gamma power), or the converter's numbers (raw).",
            choices=OUTPUTS,
        ),
    ] = "srgb"
    gamma: Annotated[
        float, Setting("Exponent of the output gamma.", least=0.01, most=100)
    ] = 2.2
    bits: Annotated[
        int, Setting("Bits of a channel of the image.", choices=(8, 16))
    ] = 8
    white_balance: Annotated[
        bool, Setting("Scale the channels so that equal radiances give equal values.")
    ] = True
    shot_noise: Annotated[bool, Setting("Poisson noise of light and dark current.")] = (
        True
    )
    vignetting: Annotated[
        bool | None,
        Setting(
            "cos^4 of the field angle, and for a lens the barrel's; by default where the lens has a width."
        ),
    ] = None
    radiance_scale: Annotated[
        float,
        Setting(
            "Radiance, in the band of each channel, of a rendered radiance of 1.",
            "W/(m^2 sr)",
            least=1e-12,
            most=1e12,
        ),
    ] = 1.0
    pinhole_f_number: Annotated[
        float,
        Setting(
            "F-number at which an aperture of zero width is exposed.",
            least=1e-3,
            most=1e6,
        ),
    ] = 8.0
    longest_exposure: Annotated[
        float,
        Setting("Limit of the automatic exposure.", "seconds", least=1e-9, most=1e9),
    ] = 30.0
    largest_gain: Annotated[
        float, Setting("Limit of the automatic gain.", least=1e-3, most=1e9)
    ] = 16.0
    mismatch: Annotated[
        Mismatch | tuple[Mismatch, ...],
        Setting(
            "Differences of the cameras after the first: one for all, or a tuple with one for each."
        ),
    ] = Mismatch()  # noqa: RUF009  a frozen value
    serial: Annotated[int, Setting("Seed of the fixed patterns.", least=0)] = 0
    dual_crosstalk: Annotated[
        float,
        Setting(
            "Of dual pixels, the fraction of the light of each half that the other one counts.",
            least=0,
            most=0.5,
        ),
    ] = 0.0
    nir: Annotated[
        "Sensor | None",
        Setting("The sensor of near infrared cameras; by default this one."),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for mismatch in self.mismatches:
            mismatch.applied(Exposure(self.longest_exposure, self.largest_gain))
        if self.black_level >= self.largest_dn:
            raise InputError(
                f"sensor black_level must be below {self.largest_dn} DN, got {self.black_level}"
            )
        if self.nir is not None and self.nir.nir is not None:
            raise InputError("sensor nir must be a Sensor that has no nir itself")

    @classmethod
    def preset(cls, name: str, **changes: Any) -> "Sensor":
        """The sensor of that name in `PRESETS`, with some fields changed.

        >>> Sensor.preset("ideal", bits=16).read_noise
        0.0
        """
        check_known("sensor preset", name, PRESETS)
        return cls(**PRESETS[name]).replace(**changes)

    def record(self) -> dict[str, Any]:
        """Plain values for sample.json; `from_record` reads them."""
        return asdict(self)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Sensor":
        """The sensor of a `record`. Fields that an earlier version did not have get their defaults."""
        nir, mismatch = record.get("nir"), record.get("mismatch", {})
        several = isinstance(mismatch, (list, tuple))
        parts = {
            "mismatch": tuple(Mismatch(**values) for values in mismatch)
            if several
            else Mismatch(**mismatch),
            "nir": None if nir is None else cls.from_record(nir),
        }
        return cls(**{**record, **parts})

    def for_band(self, band: str) -> "Sensor":
        """The sensor of a camera with this `Camera.band`; all methods that get a camera apply it.

        For "nir" it is `nir` or this one, mono, with its `nir_efficiency` and `nir_wavelength`, and this `mismatch`.

        Raises InputError for an unknown band.

        >>> Sensor().for_band("nir").quantum_efficiency
        (0.15, 0.15, 0.15)
        """
        check_known("camera band", band, BANDS)
        if band != "nir":
            return self
        of_band = self.nir or self
        changes = {
            "quantum_efficiency": (of_band.nir_efficiency,) * 3,
            "wavelengths": (of_band.nir_wavelength,) * 3,
        }
        return of_band.replace(
            **changes, filters="mono", mismatch=self.mismatch, nir=None
        )

    @property
    def mismatches(self) -> tuple[Mismatch, ...]:
        """The mismatch of all cameras after the first, or of each."""
        return self.mismatch if isinstance(self.mismatch, tuple) else (self.mismatch,)

    def mismatch_of(self, eye: int) -> Mismatch:
        """The mismatch of camera `eye` of a rig. Raises InputError if there are fewer mismatches.

        >>> Sensor(mismatch=(Mismatch(gain=1.1), Mismatch(gain=0.9))).mismatch_of(2).gain
        0.9
        """
        check_int("eye", eye, 0)
        if eye == 0:
            return Mismatch()
        if not isinstance(self.mismatch, tuple):
            return self.mismatch
        if eye > len(self.mismatch):
            raise InputError(
                f"sensor mismatch has those of {len(self.mismatch)} cameras after the first, not {eye}"
            )
        return self.mismatch[eye - 1]

    def misalign(self, rig: Rig) -> Rig:
        """The rig that takes the images, misaligned by the mismatches; calibration and truth are those of `rig`.

        Raises InputError for another number of mismatches than of cameras after the first.
        """
        self.check_mismatches(rig)
        return misalign(rig, [self.mismatch_of(i) for i in range(1, len(rig))])

    def lenses(self, rig: Rig, lens: ApertureLens) -> tuple[ApertureLens, ...]:
        """The lens of each camera of a rig, for `render`: `lens` with the f-numbers and the focus of the mismatches.

        Raises InputError as `misalign`, and as `Mismatch.lens`.
        """
        require_aperture(lens, "a mismatch of lenses")
        self.check_mismatches(rig)
        return tuple(
            self.mismatch_of(i).lens(lens, camera)
            for i, camera in enumerate(rig.nominal.cameras)
        )

    def check_mismatches(self, rig: Rig) -> None:
        """Raise InputError for a tuple of mismatches of another number of cameras than the rig has."""
        if isinstance(self.mismatch, tuple) and len(self.mismatch) != len(rig) - 1:
            needed = f"{len(rig) - 1}, one for each camera after the first"
            raise InputError(
                f"number of mismatches of the sensor must be {needed}, got {len(self.mismatch)}"
            )

    @property
    def largest_dn(self) -> int:
        """The largest digital number, 2^adc_bits - 1."""
        return int(2**self.adc_bits - 1)

    def system_gain(self, gain: float = 1.0) -> float:
        """EMVA's K, DN per electron: `gain` times (largest DN - black level) / full well."""
        return gain * (self.largest_dn - self.black_level) / self.full_well

    def electrons_per_radiance(self, camera: Camera, lens: ApertureLens) -> Float:
        """Electrons per second in a pixel on the axis, per unit of rendered radiance, (3,) for red, green and blue."""
        distance = film_distance(camera, lens)
        pixel_area = distance / camera.fx * distance / camera.fy
        # Watts of a pixel for a radiance of 1 W/(m^2 sr): E/L times its area. Photons carry h c / lambda each.
        joules = (
            light.irradiance_factor(camera, lens, self.pinhole_f_number) * pixel_area
        )
        of_band = self.for_band(camera.band)
        photons = np.array(of_band.wavelengths) / (light.PLANCK * light.SPEED)
        return np.asarray(
            self.radiance_scale
            * joules
            * photons
            * np.array(of_band.quantum_efficiency)
        )

    def level_rate(
        self, radiance: ArrayLike, *, camera: Camera, lens: ApertureLens
    ) -> Float:
        """Signal per second at gain 1 over the full well, (H, W, 3), of a radiance image; for automatic exposure."""
        require_aperture(lens, "an exposure")
        rates = checked_radiance("radiance", radiance, camera) * self.pixel_rates(
            camera, lens
        )
        of_band = self.for_band(camera.band)
        if of_band.filters == "mono":
            rates = np.repeat(rates.sum(axis=-1, keepdims=True), 3, axis=-1)
        return rates * of_band.balance() / self.full_well

    def metered(
        self,
        images: Sequence[ArrayLike],
        cameras: Sequence[Camera],
        lens: ApertureLens,
    ) -> Exposure:
        """The automatic exposure of images (H, W, 3), one for each camera; see `auto_exposure`."""
        levels = [
            self.level_rate(image, camera=camera, lens=lens).reshape(-1, 3)
            for image, camera in zip(images, cameras, strict=True)
        ]
        return automatic(
            np.concatenate(levels), self.longest_exposure, self.largest_gain
        )

    def expose(
        self,
        radiance: ArrayLike,
        *,
        camera: Camera,
        lens: ApertureLens,
        seed: int = 0,
        exposure: Exposure | None = None,
        eye: int = 0,
    ) -> Photo:
        """Expose linear radiance (H, W, 3).

        `exposure` is automatic by default. `eye` is the index of the camera in its rig: each has its own fixed patterns
        and noise, and those after the first have the `mismatch`.

        Raises InputError for a radiance that is negative, NaN or not of the camera's size, and a negative seed.
        Gives a `ParaxialWarning` for a given exposure through a lens below f/1.
        """
        return self._expose([(radiance, camera, eye)], lens, seed, exposure)[0]

    def _expose(
        self,
        views: Sequence[tuple[ArrayLike, Camera, int]],
        lens: ApertureLens,
        seed: int,
        exposure: Exposure | None,
        brightest: Sequence[ArrayLike] | None = None,
    ) -> list[Photo]:
        """One photo for each radiance, camera and eye; cameras of the same band have the same exposure.

        An automatic exposure is that of the `brightest` radiances, by default the ones that are exposed.
        """
        images = [
            checked_radiance("radiance", radiance, camera)
            for radiance, camera, _ in views
        ]
        cameras = [camera for _, camera, _ in views]
        metered = images
        if brightest is not None:
            metered = [
                checked_radiance("radiance", radiance, camera)
                for radiance, camera in zip(brightest, cameras, strict=True)
            ]
        exposures = self._nominal(metered, cameras, lens, seed, exposure)
        photos = []
        for image, view, nominal in zip(images, views, exposures, strict=True):
            _, camera, eye = view
            sensor = self.for_band(camera.band)
            frame = _Frame(camera, lens, nominal, seed, eye)
            photos.append(sensor._read(sensor._collect(image, frame), frame))
        return photos

    def _nominal(
        self,
        images: Sequence[Float],
        cameras: Sequence[Camera],
        lens: ApertureLens,
        seed: int,
        exposure: Exposure | None,
    ) -> list[Exposure]:
        """For each image the given exposure, or the automatic one of the images of its band, after checks."""
        require_aperture(lens, "an exposure")
        check_exposure(exposure)
        check_int("seed", seed, 0)
        if exposure is not None:
            light.warn_below_f1(
                min(cameras, key=lambda camera: film_distance(camera, lens)),
                lens,
                stacklevel=5,
            )
            return [exposure] * len(images)
        exposures = {}
        for band in {camera.band for camera in cameras}:
            indices = [i for i, camera in enumerate(cameras) if camera.band == band]
            exposures[band] = self.metered(
                [images[i] for i in indices], [cameras[i] for i in indices], lens
            )
        return [exposures[camera.band] for camera in cameras]

    def expose_dual(
        self,
        halves: ArrayLike,
        *,
        camera: Camera,
        lens: ApertureLens,
        seed: int = 0,
        exposure: Exposure | None = None,
        eye: int = 0,
    ) -> tuple[Photo, Photo, Photo]:
        """Expose the images of the halves of an aperture, ``render(..., parts=Dual())``, with dual pixels.

        A half of a pixel is a photodiode with half of the full well and of the dark current, and noise and fixed
        patterns of its own. It is read at twice the system gain, so that the levels of the halves equal those of the
        whole image, the sum of the electrons of both halves, read once. The automatic exposure is that of the whole.
        The sensor's `dual_crosstalk` c brings the centroids of the halves' light together, to 1 - 2c of their distance.

        halves : linear radiance (2, H, W, 3), whose sum is that of the whole image.

        Returns the photos of the left half, the right half (top and bottom with ``Dual("y")``), and the whole pixels.
        Raises the errors of `expose`, and InputError unless there are two halves.
        """
        return self._expose_dual([(halves, camera, eye)], lens, seed, exposure)[0]

    def expose_dual_rig(
        self,
        images: Sequence[ArrayLike],
        *,
        rig: Rig,
        lens: ApertureLens,
        seed: int = 0,
        exposure: Exposure | None = None,
    ) -> list[tuple[Photo, Photo, Photo]]:
        """`expose_dual` for the halves of each camera of a rig, with one exposure."""
        return self._expose_dual(self._views(images, rig), lens, seed, exposure)

    def _expose_dual(
        self,
        views: Sequence[tuple[ArrayLike, Camera, int]],
        lens: ApertureLens,
        seed: int,
        exposure: Exposure | None,
    ) -> list[tuple[Photo, Photo, Photo]]:
        require_aperture(lens, "an exposure")
        if lens.aperture_diameter == 0:
            raise InputError(
                "dual pixels need a lens with an aperture; a pinhole has none"
            )
        cameras = [camera for _, camera, _ in views]
        halves = []
        for images, camera, _ in views:
            left, right = _two(images)
            checked_left = checked_radiance("radiance", left, camera)
            halves.append((checked_left, checked_radiance("radiance", right, camera)))
        # The two halves of a pixel share the time and the gain of the whole one.
        wholes = [left + right for left, right in halves]
        exposures = self._nominal(wholes, cameras, lens, seed, exposure)
        photos = []
        for pair, view, nominal in zip(halves, views, exposures, strict=True):
            _, camera, eye = view
            frame = _Frame(camera, lens, nominal, seed, eye)
            photos.append(self.for_band(camera.band)._take_dual(pair, frame))
        return photos

    def _take_dual(
        self, halves: Sequence[Float], frame: _Frame
    ) -> tuple[Photo, Photo, Photo]:
        """The photos of the left half, the right half and the whole pixels of one camera."""
        photos, wells = [], []
        for i, image in enumerate(halves):
            # (1 - c) of the own half and c of the other: the centroids come together to 1 - 2c of their distance.
            mixed = image + self.dual_crosstalk * (halves[1 - i] - image)
            diode = self.replace(
                full_well=self.full_well / 2,
                dark_current=self.dark_current / 2,
                serial=derived_seed(self.serial, "dual pixel", i),
            )
            half = replace(frame, seed=derived_seed(frame.seed, "dual pixel", i))
            electrons = diode._collect(mixed, half)
            wells.append(electrons)
            photos.append(diode._read(electrons, half))
        return photos[0], photos[1], self._read(wells[0] + wells[1], frame)

    def _collect(self, image: Float, frame: _Frame) -> Float:
        """Electrons of each pixel at the end of the exposure, (H, W, 3) or (H, W), from radiance."""
        mismatch = self.mismatch_of(frame.eye)
        time = mismatch.applied(frame.exposure).time
        # Glare is spread evenly over the film: it comes after vignetting.
        rates = self.electrons_per_radiance(frame.camera, frame.lens)
        white = self._white(rates, mismatch.applied(frame.exposure))
        film = mismatch.light(self._vignetted(image, frame.camera, frame.lens), white)
        return self._wells(film * rates * time, time, frame.seed, frame.eye)

    def _white(self, rates: Float, exposure: Exposure) -> Float:
        """The radiance (3,) that saturates the well of a pixel or its number, from `electrons_per_radiance`."""
        if self.filters == "mono":
            rates = np.full(3, rates.sum())
        electrons = self.full_well / max(exposure.gain, 1.0)
        with np.errstate(
            divide="ignore", over="ignore"
        ):  # a band without electrons, no time
            return np.asarray(electrons / (rates * exposure.time))

    def _read(self, wells: Float, frame: _Frame) -> Photo:
        """Read and develop the electrons of each pixel."""
        mismatch = self.mismatch_of(frame.eye)
        electrons = wells
        # The fixed pattern belongs to the sensor, and the noise to the frame: each has its own stream.
        if self.dsnu:
            pattern = generator(self.serial, "dsnu", frame.eye)
            electrons = electrons + self.dsnu * pattern.standard_normal(wells.shape)
        if self.read_noise:
            noise = generator(frame.seed, "read", frame.eye)
            electrons = electrons + self.read_noise * noise.standard_normal(wells.shape)
        # EMVA 1288, equation 4: y = K (electrons + noise) above the black level, rounded by the converter.
        gain = self.system_gain(mismatch.applied(frame.exposure).gain)
        black = self.black_level + mismatch.black_level
        numbers = np.rint(gain * electrons + black)
        numbers = np.clip(numbers, 0, self.largest_dn).astype(np.uint16)
        saturated = (wells >= self.full_well) | (numbers >= self.largest_dn)
        record = {
            **self._record_of(frame),
            "saturated_fraction": float(saturated.mean()),
            "mean_electrons": float(electrons.mean()),
        }
        return Photo(self._develop(numbers, mismatch), record)

    def _record_of(self, frame: _Frame) -> dict[str, Any]:
        """How a frame was exposed, with the mismatch of its camera."""
        mismatch = self.mismatch_of(frame.eye)
        true = mismatch.applied(frame.exposure)
        camera, lens = frame.camera, frame.lens
        nominal_number = light.working_f_number(camera, lens, self.pinhole_f_number)
        number = nominal_number * mismatch.f_number
        rates = self.electrons_per_radiance(camera, lens) * true.time
        several = isinstance(self.mismatch, tuple)
        sensor = self.replace(mismatch=mismatch) if several else self
        return {
            "time_s": true.time,
            "gain": true.gain,
            "working_f_number": number,
            "ev": true.value(number),
            "system_gain_dn_per_electron": self.system_gain(true.gain),
            "black_level_dn": self.black_level + mismatch.black_level,
            "electrons_per_radiance": (rates / mismatch.f_number**2).tolist(),
            "seed": int(frame.seed),
            "eye": int(frame.eye),
            "sensor": sensor.record(),
        }

    def expose_pair(
        self,
        left: ArrayLike,
        right: ArrayLike,
        *,
        rig: Rig,
        lens: ApertureLens,
        seed: int = 0,
        exposure: Exposure | None = None,
    ) -> tuple[Photo, Photo]:
        """`expose_rig` for a stereo pair."""
        photos = self.expose_rig(
            [left, right], rig=rig, lens=lens, seed=seed, exposure=exposure
        )
        return photos[0], photos[1]

    def expose_rig(
        self,
        images: Sequence[ArrayLike],
        *,
        rig: Rig,
        lens: ApertureLens,
        seed: int = 0,
        exposure: Exposure | None = None,
        brightest: Sequence[ArrayLike] | None = None,
    ) -> list[Photo]:
        """Expose one image per camera of a rig, with one exposure for the cameras of each band; see `expose`.

        brightest : one image per camera, which the automatic exposure is made for in place of `images`: that of the
            frames of a sequence, which share an exposure.

        The `ParaxialWarning` is given once, for the camera with the smallest film distance.
        """
        views = self._views(images, rig)
        return self._expose(views, lens, seed, exposure, brightest)

    def _views(
        self, images: Sequence[ArrayLike], rig: Rig
    ) -> list[tuple[ArrayLike, Camera, int]]:
        """The image, camera and index of each view."""
        self.check_mismatches(rig)
        if len(images) != len(rig):
            raise InputError(
                f"expose_rig needs one image per camera, got {counted(len(images), 'image')} and "
                f"{counted(len(rig), 'camera')}"
            )
        return list(zip(images, rig.cameras, range(len(rig)), strict=True))

    def pixel_rates(self, camera: Camera, lens: ApertureLens) -> Float:
        """Electrons per second per unit of rendered radiance, (H, W, 3); (3,) without vignetting."""
        return self._vignetted(self.electrons_per_radiance(camera, lens), camera, lens)

    def _vignetted(self, values: Float, camera: Camera, lens: ApertureLens) -> Float:
        """`values` (H, W, 3) or (3,) times the vignetting, if it is on."""
        on = lens.aperture_diameter > 0 if self.vignetting is None else self.vignetting
        return values * light.vignetting(camera, lens)[..., None] if on else values

    def _wells(self, expected: Float, time: float, seed: int, eye: int) -> Float:
        """Electrons of each pixel at the end of the exposure, (H, W, 3) or (H, W), from the expected ones of light."""
        # A mono pixel counts the photons of all bands; a pixel behind a filter those of one.
        if self.filters == "mono":
            expected = expected.sum(axis=-1)
        elif self.filters in picture.BAYER:
            expected = picture.mosaic(expected, self.filters)
        if self.prnu:
            pattern = generator(self.serial, "prnu", eye).standard_normal(
                expected.shape
            )
            expected = expected * (1.0 + self.prnu * pattern)
        # PRNU can make the expectation negative, and a Poisson number of huge ones is slow to draw.
        expected = np.clip(expected, 0.0, _MAX_WELLS * self.full_well)
        dark = self.dark_current * time
        if not self.shot_noise:
            return np.minimum(expected + dark, self.full_well)
        electrons = generator(seed, "shot", eye).poisson(expected).astype(np.float64)
        if dark > 0:
            dark = min(dark, _MAX_WELLS * self.full_well)
            electrons += generator(seed, "dark current", eye).poisson(
                dark, expected.shape
            )
        return np.minimum(electrons, self.full_well)

    def balance(self) -> Float:
        """White balance factors (3,), >= 1."""
        if not self.white_balance or self.filters == "mono":
            return np.ones(3)
        response: Float = np.array(self.quantum_efficiency) * np.array(self.wavelengths)
        return np.asarray(response.max() / response)

    def linear(self, image: Image) -> Float:
        """The linear values, 1 for white, of an image that this sensor has developed; the white balance is kept.

        Values of raw images have the black level subtracted, and may be negative.
        """
        if self.output != "raw":
            return picture.linear(image, self.output, self.gamma)
        span = self.largest_dn - self.black_level
        return np.asarray((image.astype(np.float64) - self.black_level) / span)

    def saturated(self, image: Image, gain: float, eye: int) -> NDArray[np.bool_]:
        """Where a channel of an image that this sensor has developed has the value of a saturated pixel, (H, W).

        gain, eye : of its `Exposure` as recorded, and the number of its camera. Bayer filters: neighbours of saturated
            pixels, whose colours are interpolated from them, can have lower values.
        """
        # A full well may be below the converter's range, and is read with noise.
        mismatch = self.mismatch_of(eye)
        electrons = self.full_well - 3 * np.hypot(self.read_noise, self.dsnu)
        black = self.black_level + mismatch.black_level
        reading = np.floor(self.system_gain(gain) * electrons + black)
        number = np.clip(reading, 0, self.largest_dn)
        shape = image.shape if self.filters == "rgb" else image.shape[:2]
        limit = self._develop(np.full(shape, number, np.uint16), mismatch)
        reached = image >= limit
        return np.asarray(reached if image.ndim == 2 else reached.any(axis=-1))

    def _develop(self, numbers: NDArray[np.uint16], mismatch: Mismatch) -> Image:
        if self.output == "raw":
            return numbers.astype(np.uint8) if self.adc_bits == 8 else numbers
        # The nominal black level, which the camera knows, is subtracted; the mismatch's stays as an error.
        linear = (numbers.astype(np.float64) - self.black_level) / (
            self.largest_dn - self.black_level
        )
        if self.filters in picture.BAYER:
            factors = self.balance()[picture.channel_map(self.filters, *linear.shape)]
            linear = picture.demosaic(linear * factors, self.filters)
        elif self.filters == "rgb":
            linear = linear * self.balance()
        return picture.encode(
            mismatch.developed(linear), self.output, self.gamma, self.bits
        )


def _two(halves: Any) -> list[Any]:
    """The images of two halves. Raises InputError for another number of them."""
    images = list(halves) if isinstance(halves, Sequence) or np.ndim(halves) else []
    if len(images) != 2:
        raise InputError(
            f"expose_dual needs the images of two halves, got {len(images) or format_value(halves)}"
        )
    return images
