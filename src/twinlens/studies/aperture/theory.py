"""Scale models of scenes, and the f-number with the least median error from blur, diffraction and noise.

The error of a good match is the Cramer-Rao bound of a shift, noise / rms slope; for a texture of grain s and a blur of
variance b^2, (s^2 + b^2) noise / signal. The predicted error of an image is its median over the pixels. Here b^2 =
(c/4)^2 for the blur disk, c = A fx |1/z - k|, plus (0.45 lambda N/p)^2 for the Airy pattern: the Gaussian with the same
curvature at the peak, 0.225 lambda/NA (Zhang, Zerubia and Olivo-Marin, Gaussian approximations of fluorescence
microscope point-spread function models, Applied Optics 46(10), 2007). docs/studies.md explains the parameters.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import Camera, ThinLens
from twinlens.geometry import Float
from twinlens.matching import grey
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.stage import Stage

F_NUMBERS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)
MODES = ("fixed exposure", "equal brightness")
PIXEL_PITCH_UM = 3.45
BLUR_PX, BLURRED_LESS = 24.0, 0.95  # the blur at f/1 that this fraction of the pixels does not exceed
WAVELENGTH = 549e-9
SENSOR = Sensor.preset("machine_vision", wavelengths=(WAVELENGTH,) * 3)
LUMA = np.array([0.299, 0.587, 0.114])
_PATCH = 16


@dataclass(frozen=True)
class Model:
    """A scale model of a scene and its lenses, rendered at full size; sensor and diffraction use the model's lenses."""

    stage: Stage
    scale: float

    @staticmethod
    def of(stage: Stage) -> "Model":
        """The model scaled so that f/1 blurs the scene by BLUR_PX."""
        from_focus = np.abs(1.0 / stage.truth.depth[np.isfinite(stage.truth.depth)] - 1.0 / stage.middle_focus)
        spread = float(np.quantile(from_focus, BLURRED_LESS))
        return Model(stage, stage.camera.film_distance * stage.camera.fx * spread / BLUR_PX)

    def lens(self, f_number: float) -> ThinLens:
        """The lens of working f-number v/A, focused at the middle of the disparity range."""
        return ThinLens(self.stage.camera.film_distance / f_number, self.scale * self.stage.middle_focus)

    def full_size(self, lens: ThinLens) -> ThinLens:
        """The lens that gives the same image of the scene at full size."""
        return ThinLens(lens.aperture_diameter / self.scale, lens.focus_distance / self.scale)

    def blur(self, lens: ThinLens) -> Float:
        """The signed blur circle of every left pixel, (H, W), pixels."""
        return self.stage.blur(self.full_size(lens))


def grain_px(image: NDArray[np.float32]) -> float:
    """The grain s of the texture, pixels: s^2 = var(I) / (2 var(dI/du)) over patches of 16 pixels.

    The standard deviation of the Gaussian that gives white noise these slopes, within 7 % from 1 to 2 px. Patches
    exclude shading.
    """
    windows = np.lib.stride_tricks.sliding_window_view(grey(image).astype(np.float64), (_PATCH, _PATCH))
    patches = windows[::_PATCH, ::_PATCH]
    variance, steepness = patches.var(axis=(2, 3)).mean(), np.diff(patches, axis=3).var(axis=(2, 3)).mean()
    return math.sqrt(variance / (2.0 * steepness))


def airy_px(camera: Camera, lens: ThinLens) -> float:
    """Standard deviation, in pixels, of the Gaussian with the Airy pattern's curvature at the peak."""
    f_number = camera.film_distance / lens.aperture_diameter
    return 0.45 * WAVELENGTH * f_number / (1e-6 * camera.pixel_pitch_um)


def noise_electrons(wells: ArrayLike, gain: float = 1.0) -> Float:
    """Root mean square noise, in electrons, of pixels of SENSOR that hold S electrons.

    Its variance is S + r^2 + d^2 + (g S)^2 + (q_c^2 + q_o^2)/12: read noise r, nonuniformity of dark signal and gain d
    and g, the converter's step q_c, and the 8-bit step q_o = full well / (255 gain t) at slope t of the tone curve.
    """
    held = np.asarray(wells, np.float64)
    level = held * gain / SENSOR.full_well
    steps = np.array([1.0 / (SENSOR.largest_dn - SENSOR.black_level), 1.0 / 255.0]) * SENSOR.full_well / gain
    rounding = (steps[0] ** 2 + (steps[1] / _srgb_slope(level)) ** 2) / 12.0
    nonuniformity = SENSOR.dsnu**2 + (SENSOR.prnu * held) ** 2
    return np.asarray(np.sqrt(held + SENSOR.read_noise**2 + nonuniformity + rounding))


def luma_noise(levels: Float, gain: float = 1.0) -> Float:
    """Root mean square noise (..,) of the luma that is matched, for pixels (.., 3); both in fractions of white.

    The noise of Y' = sum w_c f(L_c), rounded to integers, over dY'/dY = sum w_c f'(L_c) L_c / Y, Y = sum w_c L_c. A
    saturated channel has neither noise nor response; if all are saturated, the noise is infinite.
    """
    response = np.array(SENSOR.quantum_efficiency) * np.array(SENSOR.wavelengths)
    balance = response.max() / response
    held = levels * SENSOR.full_well / (gain * balance)
    rise = LUMA * np.where(levels < 1.0, _srgb_slope(levels), 0.0)
    luma = levels @ LUMA
    brighter = np.where(luma > 0, (rise * levels).sum(axis=-1) / np.where(luma > 0, luma, 1.0), _srgb_slope(luma))
    channels = rise * balance * noise_electrons(held, gain) * gain / SENSOR.full_well
    noise = np.sqrt((channels**2).sum(axis=-1) + 1.0 / (12.0 * 255.0**2))
    return np.asarray(np.divide(noise, brighter, out=np.full(luma.shape, math.inf), where=brighter > 0))


def _srgb_slope(level: Float) -> Float:
    """The derivative of the transfer curve of IEC 61966-2-1."""
    bright = np.maximum(level, 0.0031308)
    return np.where(level <= 0.0031308, 12.92, 1.055 / 2.4 * bright ** (1 / 2.4 - 1))


def shift_bound(grain: float, blur_variance: ArrayLike, contrast: ArrayLike, noise: ArrayLike) -> Float:
    """The Cramer-Rao bound of a shift up to a constant factor: (s^2 + b^2) noise / contrast."""
    return np.asarray((grain**2 + np.asarray(blur_variance)) * np.asarray(noise) / np.asarray(contrast), np.float64)


def predicted_error(
    stage: Stage, lens: ThinLens, exposure: Exposure, image: NDArray[np.float32], blur_px: Float, grain: float,
    diffracts: bool,
) -> float:  # fmt: skip
    """The predicted error of an image in arbitrary units. blur_px: the signed blur of every pixel, (H, W)."""
    known = np.isfinite(stage.truth.depth)
    rate = SENSOR.level_rate(image, camera=stage.camera, lens=lens).mean(axis=-1)[known]
    wells = rate * exposure.time * SENSOR.full_well
    lit = (wells > 0) & (wells * exposure.gain < SENSOR.full_well)
    if not 2 * lit.sum() > lit.size:
        return math.inf
    variance = (blur_px[known] / 4.0) ** 2 + diffracts * airy_px(stage.camera, lens) ** 2
    errors = shift_bound(grain, variance, np.where(lit, wells, 1.0), noise_electrons(wells, exposure.gain))
    return float(np.median(np.where(lit, errors, math.inf)))
