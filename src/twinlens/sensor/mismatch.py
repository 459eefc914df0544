"""Differences between the cameras of a rig: exposure, lens, stray light, sharpness, colours and alignment.

The first camera is the reference, without differences; each other camera has a `Mismatch`. A real pair differs in both
cameras: a `Mismatch` and its standard deviations describe the difference of the two (sources: docs/realism.md).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np

from twinlens.camera import (
    ALIGNED,
    ApertureLens,
    BrownConrady,
    Camera,
    Misalignment,
    Rig,
    misaligned,
)
from twinlens.errors import (
    InputError,
    check_int,
    check_known,
    located,
)
from twinlens.geometry import Float
from twinlens.seeds import generator
from twinlens.sensor.exposure import Exposure
from twinlens.settings import Setting, Settings

LEVELS = ("none", "calibrated", "typical", "consumer")
"""After "none": a fresh calibration with equalised gains and flat fields, two cameras of one model, cheap modules."""

DEFAULT_MISMATCH: Mapping[str, Any] = {
    "level": "typical",
    "distortion_px": 0.0,
    "focus_um": 0.0,
}
"""The mismatch of recipes that give none; every backend can render it."""

_MAX_SIGMAS = 2.5  # limit of a drawn value, in standard deviations
_K1_STEP = 1e-3
_NOT_NEGATIVE = ("veiling_glare", "stray_light", "blur_px")


class Spreads(NamedTuple):
    """The standard deviations of a field that is drawn, at each level after "none"."""

    calibrated: float
    typical: float
    consumer: float


@dataclass(frozen=True)
class Mismatch(Settings, noun="mismatch"):
    """Differences of a camera from the first one of its rig, which image processing does not correct.

    x and y are -1 to 1 across the image, r^2 is 1 in its corners. Edges and corners are those of an image with the
    principal point in its centre. pitch_px to forward_mm apply to the rig that takes
    the images (`misalign`), f_number and focus_um to its lenses (`lens`). The sensor applies all others, and f_number
    to the light.

    Raises InputError when a value is out of range.
    """

    gain: Annotated[
        float,
        Setting("Factor of the exposure's gain.", least=1e-3, most=1e3),
        Spreads(0.005, 0.01, 0.05),
    ] = 1.0
    time: Annotated[
        float,
        Setting("Factor of the exposure time.", least=1e-3, most=1e3),
        Spreads(0.0, 0.0, 0.1),
    ] = 1.0
    black_level: Annotated[
        float,
        Setting("Added to the black level.", "DN", least=-1e6, most=1e6),
        Spreads(0.25, 1.0, 3.0),
    ] = 0.0
    f_number: Annotated[
        float,
        Setting(
            "Factor of the f-number; the light changes by its inverse square, blur circles by its inverse.",
            least=0.1,
            most=10,
        ),
        Spreads(0.002, 0.008, 0.047),
    ] = 1.0
    focus_um: Annotated[
        float,
        Setting(
            "Displacement of the film away from the lens, which then focuses nearer; less below f/1 (`lens`).",
            "micrometres",
            least=-1e6,
            most=1e6,
        ),
        Spreads(1.0, 5.0, 14.0),
    ] = 0.0
    shading_right: Annotated[
        float,
        Setting(
            "a of the factor 1 + a x + b y - c r^2 of the lens's light.",
            least=-0.3,
            most=0.3,
        ),
        Spreads(0.01, 0.04, 0.08),
    ] = 0.0
    shading_down: Annotated[
        float,
        Setting("b of the same factor.", least=-0.3, most=0.3),
        Spreads(0.01, 0.04, 0.08),
    ] = 0.0
    shading_corner: Annotated[
        float,
        Setting("c of the same factor.", least=-0.3, most=0.4),
        Spreads(0.01, 0.04, 0.08),
    ] = 0.0
    veiling_glare: Annotated[
        float,
        Setting(
            "Share g of the light that is spread evenly: (1 - g) L + g mean(L), in each channel.",
            least=0,
            most=1,
        ),
        Spreads(0.001, 0.003, 0.01),
    ] = 0.0
    stray_light: Annotated[
        float,
        Setting(
            "Share s of the mean light that is added, from 0 on one side of the image to 2 s mean(L) on the other.",
            least=0,
            most=1,
        ),
        Spreads(0.001, 0.005, 0.02),
    ] = 0.0
    stray_direction_deg: Annotated[
        float,
        Setting(
            "Direction of the brighter side: 0 is right, 90 is down.",
            "degrees",
            least=-360,
            most=360,
        ),
    ] = 0.0
    blur_px: Annotated[
        float,
        Setting(
            "Standard deviation of an additional Gaussian blur, which conserves light.",
            "pixels",
            least=0,
            most=100,
        ),
        Spreads(0.1, 0.3, 0.6),
    ] = 0.0
    filter_shift: Annotated[
        float,
        Setting(
            "Share of each channel that comes from the channel of the next longer wavelength, shorter if negative.",
            least=-1,
            most=1,
        ),
        Spreads(0.005, 0.02, 0.05),
    ] = 0.0
    white_balance_red: Annotated[
        float,
        Setting(
            "Factor of the developed red values; unused in mono and raw output.",
            least=0.1,
            most=10,
        ),
        Spreads(0.005, 0.02, 0.055),
    ] = 1.0
    white_balance_blue: Annotated[
        float,
        Setting(
            "Factor of the developed blue values; unused in mono and raw output.",
            least=0.1,
            most=10,
        ),
        Spreads(0.005, 0.02, 0.06),
    ] = 1.0
    tone_exponent: Annotated[
        float,
        Setting(
            "Exponent of the developed values, 0 to 1, before the tone curve; unused in raw output.",
            least=0.1,
            most=10,
        ),
        Spreads(0.002, 0.005, 0.02),
    ] = 1.0
    pitch_px: Annotated[
        float,
        Setting(
            "Displacement of the image's centre, down, by a rotation of the camera.",
            "pixels",
            least=-100,
            most=100,
        ),
        Spreads(0.05, 0.15, 0.4),
    ] = 0.0
    yaw_px: Annotated[
        float,
        Setting(
            "Displacement of the image's centre, right, by a rotation of the camera.",
            "pixels",
            least=-100,
            most=100,
        ),
        Spreads(0.02, 0.05, 0.15),
    ] = 0.0
    roll_px: Annotated[
        float,
        Setting(
            "Displacement of the middle of the right edge, down, by a rotation about the optical axis.",
            "pixels",
            least=-100,
            most=100,
        ),
        Spreads(0.03, 0.1, 0.25),
    ] = 0.0
    scale_px: Annotated[
        float,
        Setting(
            "Displacement of the corners outwards, by the focal length.",
            "pixels",
            least=-100,
            most=100,
        ),
        Spreads(0.03, 0.1, 0.25),
    ] = 0.0
    distortion_px: Annotated[
        float,
        Setting(
            "Displacement of the corners outwards, by the third power of the radius.",
            "pixels",
            least=-100,
            most=100,
        ),
        Spreads(0.03, 0.1, 0.25),
    ] = 0.0
    right_mm: Annotated[
        float,
        Setting(
            "Displacement of the camera along its x axis.",
            "millimetres",
            least=-1e3,
            most=1e3,
        ),
        Spreads(0.01, 0.03, 0.1),
    ] = 0.0
    down_mm: Annotated[
        float,
        Setting(
            "Displacement of the camera along its y axis.",
            "millimetres",
            least=-1e3,
            most=1e3,
        ),
        Spreads(0.01, 0.03, 0.1),
    ] = 0.0
    forward_mm: Annotated[
        float,
        Setting(
            "Displacement of the camera along its z axis.",
            "millimetres",
            least=-1e3,
            most=1e3,
        ),
        Spreads(0.01, 0.03, 0.1),
    ] = 0.0
    level: Annotated[
        str,
        Setting(
            "Level that the values were drawn from, for the record.", choices=LEVELS
        ),
    ] = "none"

    @classmethod
    def draw(cls, level: str, seed: int, **fixed: float) -> "Mismatch":
        """A random mismatch: normal deviates with the standard deviations of a level, limited to 2.5 of these.

        Fields in `fixed` are not drawn. Each field has its own stream: at every level, one seed gives the same
        differences, scaled. Raises InputError for an unknown level or field, and for a negative seed.

        >>> Mismatch.draw("typical", 1) == Mismatch.draw("typical", 1), Mismatch.draw("none", 1) == Mismatch()
        (True, True)
        """
        check_known("mismatch level", level, LEVELS)
        check_int("seed", seed, 0)
        for name in fixed:
            check_known("mismatch field", name, vars(cls()).keys() - {"level"})
        values: dict[str, Any] = {**fixed, "level": level}
        if level == "none":
            return cls(**values)
        direction = generator(seed, "mismatch", "direction").uniform(0, 360)
        values.setdefault("stray_direction_deg", float(direction))
        for name, spreads in SPREADS.items():
            deviate = generator(seed, "mismatch", name).standard_normal()
            sigmas = float(np.clip(deviate, -_MAX_SIGMAS, _MAX_SIGMAS))
            if name in _NOT_NEGATIVE:
                sigmas = abs(sigmas)
            spread = spreads[LEVELS.index(level) - 1]
            values.setdefault(name, vars(cls)[name] + spread * sigmas)
        return cls(**values)

    def applied(self, exposure: Exposure) -> Exposure:
        """`exposure` with the factors of time and gain. Raises InputError if the result is out of range.

        >>> Mismatch(time=2.0).applied(Exposure(0.01))
        Exposure(time=0.02, gain=1.0)
        """
        with located("the mismatch makes the exposure invalid"):
            return Exposure(exposure.time * self.time, exposure.gain * self.gain)

    def light(self, light: Float, white: Float | None = None) -> Float:
        """The light (H, W, 3) on the sensor, from that of a camera without differences.

        `white` (3,) is the light that saturates a pixel, in the same units; None for any amount.
        """
        # In the order of the way of the light: lens, camera body, filters.
        light = self._blurred(self._shaded(light), white)
        light = self._filtered(self._veiled(light))
        return light / self.f_number**2

    def _shaded(self, light: Float) -> Float:
        """With the slopes and the fall to the corners of another shading, relative to the middle."""
        if not (self.shading_right or self.shading_down or self.shading_corner):
            return light
        height, width = light.shape[:2]
        x, y = _field(height, width)
        # The squared distance from the middle, 1 in the corners.
        r2 = ((width * x) ** 2 + (height * y) ** 2) / (width**2 + height**2)
        slope = 1 + self.shading_right * x + self.shading_down * y
        return np.asarray(light * (slope - self.shading_corner * r2)[..., None])

    def _blurred(self, light: Float, white: Float | None) -> Float:
        """With the blur of a worse lens: a Gaussian of the standard deviation `blur_px`, in the frequency domain.

        A Gaussian sampled at whole pixels would hardly blur below 0.4 px. The cosine transform mirrors the image at its
        borders; its coefficient k of n has the frequency k / (2 n) cycles per pixel.
        """
        if not self.blur_px:
            return light
        from scipy.fft import dctn, idctn  # slow to import

        down, across = (0.5 * np.arange(n) / n for n in light.shape[:2])
        variance = self.blur_px**2
        # The Fourier transform of a Gaussian, exp(-2 pi^2 s^2 f^2). Below 0.7 px no kernel without negative values has
        # it: beside an edge the light over- and undershoots by up to 1.4 % of the edge's height.
        gaussian = _response(
            -2 * math.pi**2 * variance * across**2, -2 * math.pi**2 * variance * down**2
        )
        measured = light if white is None else np.minimum(light, white)
        spectrum = gaussian * dctn(measured, axes=(0, 1))
        if white is not None and (light > white).any():
            # Beside a lamp the undershoot would be black. What is beyond white is spread by the discrete Gaussian
            # instead: never negative, of the same variance. Source: Lindeberg, IEEE PAMI 12(3), 1990, equation 20.
            discrete = _response(
                variance * (np.cos(2 * math.pi * across) - 1),
                variance * (np.cos(2 * math.pi * down) - 1),
            )
            spectrum += discrete * dctn(light - measured, axes=(0, 1))
        return np.asarray(idctn(spectrum, axes=(0, 1)))

    def _veiled(self, light: Float) -> Float:
        """With light that is scattered over the film: evenly, and as a slope from 0 to twice its mean."""
        if not (self.veiling_glare or self.stray_light):
            return light
        x, y = _field(*light.shape[:2])
        angle = math.radians(self.stray_direction_deg)
        across, down = math.cos(angle), math.sin(angle)
        # -1 to 1 from corner to corner in the direction of the angle.
        slope = (across * x + down * y) / (abs(across) + abs(down))
        veil = self.veiling_glare + self.stray_light * (1 + slope)
        mean = light.mean(axis=(0, 1))
        return np.asarray((1 - self.veiling_glare) * light + veil[..., None] * mean)

    def _filtered(self, light: Float) -> Float:
        """With filters whose bands are shifted: a share of each channel comes from a neighbouring one."""
        if not self.filter_shift:
            return light
        # The channel of the next longer wavelength, or of the next shorter; red, or blue, has none but itself.
        neighbours = [0, 0, 1] if self.filter_shift > 0 else [1, 2, 2]
        return light + abs(self.filter_shift) * (light[..., neighbours] - light)

    def developed(self, linear: Float) -> Float:
        """Apply white balance and tone exponent to linear values (H, W, 3) or (H, W), where 1 is white."""
        if linear.ndim == 3:
            linear = linear * np.array(
                [self.white_balance_red, 1.0, self.white_balance_blue]
            )
        if self.tone_exponent == 1:
            return linear
        return np.clip(linear, 0.0, 1.0) ** self.tone_exponent

    def lens(self, lens: ApertureLens, camera: Camera) -> ApertureLens:
        """The lens of a camera of this mismatch, with its f-number and its focus, from the nominal one.

        `camera` is the calibrated one; its film is at v = fx * pixel pitch. The thin-lens law 1/f = 1/z + 1/v gives a
        lens of vergence k the vergence k + 1/v - 1/(v + dv) where the film is displaced by dv. An f-number N below 1,
        which no lens has, belongs to a larger camera than the pixel pitch says: dv is N times `focus_um`, as for the
        blur at f/1. A calibration measures the intrinsics with the displaced film, so they stay. Pinholes and bare
        apertures have no focus.

        Raises InputError for a film displaced to the lens or beyond.

        >>> from twinlens.camera import ThinLens
        >>> camera = Camera.from_fov(640, 480, fov_x_deg=60)  # v = 2.77 mm
        >>> round(1 / Mismatch(focus_um=1.0).lens(ThinLens(0.001, focus_distance=2.0), camera).vergence, 2)
        1.59
        """
        if (self.f_number, self.focus_um) == (1.0, 0.0):
            return lens
        if lens.is_bare:
            return lens.adjusted(self.f_number, defocus=0.0)
        film = lens.distance_to_film(camera)
        # An f-number below 1 belongs to a larger camera, whose film moves less in units of its distance.
        step = (
            1e-6 * self.focus_um * min(1.0, film / max(lens.aperture_diameter, 1e-12))
        )
        if film + step <= 0:
            raise InputError(
                f"mismatch focus_um={self.focus_um:g} moves the film to the lens, {1e6 * film:g} um away"
            )
        return lens.adjusted(self.f_number, step / (film * (film + step)))

    def misalign(self, rig: Rig) -> Rig:
        """The misaligned rig, which takes the images; calibration and truth are those of `rig`.

        All cameras after the first have these differences; with `Sensor.misalign` each may have its own. Raises
        InputError as `misalignment`.
        """
        return misalign(rig, [self] * (len(rig) - 1))

    def misalignment(self, camera: Camera) -> Misalignment:
        """The error of a camera of this mismatch against its calibration.

        Raises InputError where roll, scale or distortion is too large for the camera.
        """
        half_width, half_height = 0.5 * camera.width, 0.5 * camera.height
        corner_px = math.hypot(half_width, half_height)
        # A rotation by the angle a about the axis takes (x, 0), x = half_width / fx, to y = x sin(a), fy y pixels down.
        roll_sine = self.roll_px * camera.fx / (camera.fy * half_width)
        try:
            if abs(roll_sine) >= 1:
                raise InputError("a rotation moves no point by more than its radius")
            error = Misalignment(
                pitch_deg=math.degrees(math.atan(self.pitch_px / camera.fy)),
                yaw_deg=-math.degrees(math.atan(self.yaw_px / camera.fx)),
                roll_deg=-math.degrees(math.asin(roll_sine)),
                focal=1 + self.scale_px / corner_px,
                k1=self.distortion_px and self.distortion_px / _shift_of_k1(camera),
                right_mm=self.right_mm,
                down_mm=self.down_mm,
                forward_mm=self.forward_mm,
            )
            error.camera(camera)
        except InputError as problem:
            fields = ("roll_px", "scale_px", "distortion_px")
            names = [name for name in fields if getattr(self, name)]
            values = " and ".join(f"{name}={getattr(self, name):g}" for name in names)
            corner = f"its corners are {corner_px:.3g} px from the centre"
            size = f"an image of {camera.width}x{camera.height} pixels, {corner}"
            raise InputError(
                f"mismatch {values}: too large for {size}; use a value nearer to 0"
            ) from problem
        return error


def _shift_of_k1(camera: Camera) -> float:
    """Displacement of a corner's image, pixels, for each 1 that is added to k1: film points are linear in it."""
    distortion = camera.distortion or BrownConrady()
    focal = np.array([camera.fx, camera.fy])
    corner = 0.5 * np.array([camera.width, camera.height]) / focal
    # A small step, so that the changed polynomial does not fold before the corner.
    stepped = replace(distortion, k1=distortion.k1 + _K1_STEP)
    moved = stepped.project(distortion.unproject(corner)) - corner
    return float(np.linalg.norm(focal * moved)) / _K1_STEP


def _response(across: Float, down: Float) -> Float:
    """A separable frequency response (H, W, 1) from its logarithms along both axes."""
    return np.asarray(np.exp(down[:, None] + across)[..., None])


def _field(height: int, width: int) -> tuple[Float, Float]:
    """Places x (W,) and y (H, 1) of pixels, -1 to 1 over the image."""
    return np.linspace(-1, 1, width), np.linspace(-1, 1, height)[:, None]


def misalign(rig: Rig, mismatches: Sequence[Mismatch]) -> Rig:
    """The rig that takes the images, whose cameras after the first have these mismatches, one each."""
    errors = [ALIGNED]
    for mismatch, camera in zip(mismatches, rig.cameras[1:], strict=True):
        errors.append(mismatch.misalignment(camera))
    if all(error == ALIGNED for error in errors):
        return rig
    return misaligned(rig, errors)


def mismatch_table(sensor: Mapping[str, Any]) -> Any:
    """The mismatch of a recipe's table `sensor`, with levels as tables; without one, the default of the preset.

    >>> mismatch_table({}), mismatch_table({"preset": "ideal"}), mismatch_table({"mismatch": "consumer"})
    ({'level': 'typical', 'distortion_px': 0.0, 'focus_um': 0.0}, {'level': 'none'}, {'level': 'consumer'})
    """
    is_ideal = sensor.get("preset") == "ideal"
    mismatch = sensor.get("mismatch", "none" if is_ideal else dict(DEFAULT_MISMATCH))
    if isinstance(mismatch, list):
        return [level_table(of_camera) for of_camera in mismatch]
    return level_table(mismatch)


def level_table(mismatch: Any) -> Any:
    """A level, as a text, as a table; anything else as it is."""
    return {"level": mismatch} if isinstance(mismatch, str) else mismatch


def _spreads() -> dict[str, Spreads]:
    spreads = {}
    for name, hint in get_type_hints(Mismatch, include_extras=True).items():
        for item in getattr(hint, "__metadata__", ()):
            if isinstance(item, Spreads):
                spreads[name] = item
    return spreads


SPREADS = _spreads()
"""The standard deviations of the fields that are drawn, by name."""
