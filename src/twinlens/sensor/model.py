"""The sensor: its figures, and how it takes a picture."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.film import checked_radiance
from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import Lens, check_lens, film_distance
from twinlens.camera.rig import Rig
from twinlens.errors import InputError, unknown
from twinlens.optics.diffraction import CHANNEL_WAVELENGTHS
from twinlens.sensor import light, noise, picture
from twinlens.sensor.checks import check_figures, check_seed
from twinlens.sensor.exposure import Exposure, Mismatch, auto_exposure, check_exposure
from twinlens.sensor.photo import Image, Photo
from twinlens.sensor.presets import PRESETS

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """An image sensor after EMVA 1288. The default has the figures of the preset `machine_vision`.

    Parameters
    ----------
    quantum_efficiency : (float, float, float)
        Electrons per photon in the red, green and blue band, in (0, 1].
    wavelengths : (float, float, float)
        Of the three bands, metres.
    full_well : float
        Electrons that a pixel holds (saturation capacity).
    read_noise : float
        Temporal dark noise at no exposure, electrons rms.
    dark_current : float
        Electrons a second.
    prnu, dsnu : float
        Unlike pixels: relative rms of their sensitivity (0.01 is 1%), and rms of their dark offset in electrons.
    adc_bits : int
        Of the converter, 8 to 16. At gain 1 a full well fills its range above the black level.
    black_level : float
        DN that darkness reads.
    filters : str
        "rgb" (three values at every pixel), "mono", or a Bayer mosaic ("RGGB" ...), which needs OpenCV to be developed.
    output : str
        "srgb", "linear", "gamma" (1/gamma power), or "raw": the converter's numbers, neither balanced nor demosaiced.
    gamma : float
        Of the output "gamma".
    bits : int
        Of the picture, 8 or 16; a raw picture is uint8 up to 8 adc_bits, else uint16.
    white_balance : bool
        Scale the channels so that equal radiances give equal values.
    shot_noise : bool
        Whether light and dark current come in whole electrons at random times.
    vignetting : bool
        Whether the film darkens as cos^4 towards its corners.
    radiance_scale : float
        W/(m^2 sr), in the band of each channel, of a rendered radiance of 1.
    pinhole_f_number : float
        The f-number that an aperture of no width is exposed as.
    longest_exposure, largest_gain : float
        Limits of the automatic exposure: seconds, and a factor.
    mismatch : Mismatch
        What the eyes after the first have differently.
    serial : int
        The seed of its fixed pattern: another serial number, another copy of the sensor.

    Raises InputError when one is out of range.
    """

    quantum_efficiency: tuple[float, float, float] = (0.55, 0.62, 0.50)
    wavelengths: tuple[float, float, float] = CHANNEL_WAVELENGTHS
    full_well: float = 10700.0
    read_noise: float = 2.3
    dark_current: float = 1.0
    prnu: float = 0.005
    dsnu: float = 1.0
    adc_bits: int = 12
    black_level: float = 64.0
    filters: str = "rgb"
    output: str = "srgb"
    gamma: float = 2.2
    bits: int = 8
    white_balance: bool = True
    shot_noise: bool = True
    vignetting: bool = False
    radiance_scale: float = 1.0
    pinhole_f_number: float = 8.0
    longest_exposure: float = 30.0
    largest_gain: float = 16.0
    mismatch: Mismatch = Mismatch()  # noqa: RUF009  a frozen value
    serial: int = 0

    def __post_init__(self) -> None:
        for name, values in check_figures(self).items():
            object.__setattr__(self, name, values)

    @classmethod
    def preset(cls, name: str, **changes: Any) -> "Sensor":
        """The sensor of that name in `PRESETS`, some of its figures changed.

        >>> Sensor.preset("ideal", bits=16).read_noise
        0.0
        """
        if name not in PRESETS:
            raise unknown("sensor preset", name, PRESETS)
        return cls(**PRESETS[name]).replace(**changes)

    def replace(self, **changes: Any) -> "Sensor":
        """A copy with some fields changed, checked again; an unknown name is refused."""
        known = [field.name for field in fields(self)]
        for name in changes:
            if name not in known:
                raise unknown("sensor field", name, known)
        return replace(self, **changes)

    @property
    def largest_dn(self) -> int:
        """2^adc_bits - 1."""
        return int(2**self.adc_bits - 1)

    def system_gain(self, gain: float = 1.0) -> float:
        """EMVA's K, DN per electron: `gain` times (largest DN - black level) / full well."""
        return gain * (self.largest_dn - self.black_level) / self.full_well

    def electrons_per_radiance(self, camera: Camera, lens: Lens) -> Float:
        """Electrons a second in a pixel on the axis, per unit of rendered radiance, (3,) for red, green and blue."""
        joules = light.irradiance_factor(camera, lens, self.pinhole_f_number) * light.pixel_area(camera, lens)
        photons = np.array([light.photons_per_joule(wavelength) for wavelength in self.wavelengths])
        electrons: Float = self.radiance_scale * joules * photons * np.array(self.quantum_efficiency)
        return electrons

    def level_rate(self, radiance: ArrayLike, *, camera: Camera, lens: Lens) -> Float:
        """Shares of white a second at gain 1 that a radiance image makes, (H, W, 3): what the exposure is judged by."""
        check_lens(lens)
        rates = self._rates(checked_radiance("radiance", radiance, camera), camera, lens)
        if self.filters == "mono":
            rates = np.repeat(rates.sum(axis=-1, keepdims=True), 3, axis=-1)
        return rates * self._balance() / self.full_well

    def expose(
        self,
        radiance: ArrayLike,
        *,
        camera: Camera,
        lens: Lens,
        seed: int = 0,
        exposure: Exposure | None = None,
        eye: int = 0,
    ) -> Photo:
        """Take a picture of linear radiance (H, W, 3).

        `exposure` is chosen automatically if not given. `eye` numbers the sensor on its rig: each eye is another copy
        of the sensor with a fixed pattern and noise of its own, and eyes after the first have the `mismatch`.

        Raises InputError for an image of another size than the camera's, negative or NaN radiance, a negative seed.
        A given exposure through a lens below f/1 earns a `ParaxialWarning`: it would promise too much light.
        """
        image = checked_radiance("radiance", radiance, camera)
        check_lens(lens)
        check_exposure(exposure)
        if exposure is not None:
            light.warn_below_f1(camera, lens)
        return self._take(image, camera, lens, exposure, seed, eye)

    def _take(
        self, radiance: ArrayLike, camera: Camera, lens: Lens, exposure: Exposure | None, seed: int, eye: int
    ) -> Photo:
        check_seed("seed", seed)
        check_seed("eye", eye)
        image = checked_radiance("radiance", radiance, camera)
        nominal = exposure or auto_exposure([image], sensor=self, cameras=camera, lens=lens)
        differs = self.mismatch if eye else Mismatch()
        true = differs.applied(nominal)
        black = self.black_level + differs.black_level
        wells = self._wells(image, camera, lens, true.time, seed, eye)
        electrons = self._read_out(wells, seed, eye)
        numbers = noise.quantise(electrons, self.system_gain(true.gain), black, self.adc_bits)
        full = (wells >= self.full_well) | (numbers >= self.largest_dn)
        measured = {"saturated_fraction": float(full.mean()), "mean_electrons": float(electrons.mean())}
        return Photo(self._develop(numbers), self._record(camera, lens, true, black, seed, eye) | measured)

    def expose_pair(
        self,
        left: ArrayLike,
        right: ArrayLike,
        *,
        rig: Rig,
        lens: Lens,
        seed: int = 0,
        exposure: Exposure | None = None,
    ) -> tuple[Photo, Photo]:
        """`expose_rig` of a stereo pair."""
        photos = self.expose_rig([left, right], rig=rig, lens=lens, seed=seed, exposure=exposure)
        return photos[0], photos[1]

    def expose_rig(
        self, images: Sequence[ArrayLike], *, rig: Rig, lens: Lens, seed: int = 0, exposure: Exposure | None = None
    ) -> list[Photo]:
        """A picture for each camera of a rig, under one exposure, each eye with its own noise and fixed pattern.

        The `ParaxialWarning` of `expose` is given once, for the camera whose film is nearest to the lens.
        """
        if len(images) != len(rig):
            raise InputError(f"expose_rig needs one image a camera, got {len(images)} images and {len(rig)} cameras")
        check_lens(lens)
        check_exposure(exposure)
        if exposure is not None:
            light.warn_below_f1(min(rig.cameras, key=lambda camera: film_distance(camera, lens)), lens)
        shared = exposure or auto_exposure(images, sensor=self, cameras=rig.cameras, lens=lens)
        return [
            self._take(image, camera, lens, shared, seed, eye)
            for eye, (image, camera) in enumerate(zip(images, rig.cameras, strict=True))
        ]

    def _rates(self, image: Float, camera: Camera, lens: Lens) -> Float:
        """Expected electrons a second, (H, W, 3)."""
        rates = image * self.electrons_per_radiance(camera, lens)
        return rates * light.cos4(camera)[..., None] if self.vignetting else rates

    def _wells(self, image: Float, camera: Camera, lens: Lens, time: float, seed: int, eye: int) -> Float:
        """Electrons that every pixel holds at the end of the exposure, (H, W, 3) or (H, W)."""
        expected = self._rates(image, camera, lens) * time
        if self.filters == "mono":
            expected = expected.sum(axis=-1)
        elif self.filters in picture.BAYER:
            expected = picture.mosaic(expected, self.filters)
        if self.prnu:
            expected = expected * (1.0 + self.prnu * noise.pattern(self.serial, "prnu", eye, expected.shape))
        shot_seed = seed if self.shot_noise else None
        return noise.collect(expected, self.dark_current * time, self.full_well, shot_seed, eye)

    def _read_out(self, wells: Float, seed: int, eye: int) -> Float:
        """Electrons as the converter sees them: what a pixel holds, its own offset, and the noise of reading."""
        electrons = wells
        if self.dsnu:
            electrons = electrons + self.dsnu * noise.pattern(self.serial, "dsnu", eye, wells.shape)
        if self.read_noise:
            electrons = electrons + noise.read_noise(self.read_noise, wells.shape, seed, eye)
        return electrons

    def _balance(self) -> Float:
        """Factors (3,) of at least 1 that make equal radiances equal."""
        if not self.white_balance or self.filters == "mono":
            return np.ones(3)
        response: Float = np.array(self.quantum_efficiency) * np.array(self.wavelengths)
        return np.asarray(response.max() / response)

    def _develop(self, numbers: NDArray[np.uint16]) -> Image:
        if self.output == "raw":
            return numbers.astype(np.uint8) if self.adc_bits == 8 else numbers
        linear = (numbers.astype(np.float64) - self.black_level) / (self.largest_dn - self.black_level)
        balance = self._balance()
        if self.filters in picture.BAYER:
            mosaic = linear * balance[picture.channel_map(self.filters, *linear.shape)]
            linear = picture.demosaic(mosaic, self.filters)
        else:
            linear = linear * balance if linear.ndim == 3 else linear
        return picture.encode(linear, self.output, self.gamma, self.bits)

    def _record(
        self, camera: Camera, lens: Lens, exposure: Exposure, black: float, seed: int, eye: int
    ) -> dict[str, Any]:
        number = light.working_f_number(camera, lens, self.pinhole_f_number)
        return {
            "time_s": exposure.time,
            "gain": exposure.gain,
            "working_f_number": number,
            "ev": exposure.value(number),
            "system_gain_dn_per_electron": self.system_gain(exposure.gain),
            "black_level_dn": black,
            "electrons_per_radiance": (self.electrons_per_radiance(camera, lens) * exposure.time).tolist(),
            "seed": int(seed),
            "eye": int(eye),
            "sensor": asdict(self),
        }
