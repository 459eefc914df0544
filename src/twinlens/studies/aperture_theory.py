"""The f-number that theory expects to be best: where blur, diffraction and noise balance. No matcher in it.

Near its best, a matcher errs as the Cramer-Rao bound of a shift: noise / rms slope. A texture of grain s (a Gaussian's
standard deviation, measured on the sharp picture) that a blur of variance b^2 widens keeps slopes of variance
~ 1/(s^2 + b^2)^2, with b^2 = (c/4)^2 of the blur disk, c = A fx |1/z - k|, and (0.45 lambda N/p)^2 of the Airy pattern
(the Gaussian whose peak is as curved, sqrt(2) lambda / (2 pi NA) = 0.225 lambda/NA: Zhang, Zerubia and Olivo-Marin,
Gaussian approximations of fluorescence microscope point-spread function models, Applied Optics 46(10), 2007).

Noise: a signal of S electrons comes with  S + r^2 + d^2 + (g S)^2 + (q_c^2 + q_o^2)/12,  all electrons squared: shot
and read noise; the unlike dark offsets d and sensitivities g of pixels; the converter's step q_c, and the step of the
8-bit picture, which a tone curve of slope t at this level makes  q_o = full well / (255 gain t).

A picture's predicted error is the median over its pixels, each with its true depth, of  (s^2 + b^2) noise / S,  in
arbitrary units. Burnt pixels know nothing: their error is infinite. What noise the light paths leave in a picture is
the renderer's, not the camera's, and has no place in it.

The bound is that of a match a fraction of a pixel from the truth, and the study sets it beside the median error. It is
not the share of wrong pixels, which are mismatches: `aperture_evidence`.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import ThinLens
from twinlens.matching import grey
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.stage import Stage

Float = NDArray[np.float64]

WAVELENGTH = 549e-9
SENSOR = Sensor.preset("machine_vision", wavelengths=(WAVELENGTH,) * 3)
_AIRY_GAUSSIAN = 0.45
LUMA = np.array([0.299, 0.587, 0.114])
_PATCH = 16


def grain_px(image: NDArray[np.float32]) -> float:
    """The texture's grain: s of the Gaussian whose smoothed white noise has this picture's variance and slopes, pixels.

    s^2 = var(I) / (2 var(dI/du)), over patches of 16 pixels, so that shading does not count as texture. True
    within 7 % from 1 to 2 px: below, neighbours' differences are no slopes; above, a patch holds too little.
    """
    flat = grey(image).astype(np.float64)
    slopes = np.diff(flat, axis=1)
    patches = [
        (flat[y : y + _PATCH, x : x + _PATCH].var(), slopes[y : y + _PATCH, x : x + _PATCH - 1].var())
        for y in range(0, flat.shape[0] - _PATCH + 1, _PATCH)
        for x in range(0, flat.shape[1] - _PATCH + 1, _PATCH)
    ]
    variance, steepness = np.mean(patches, axis=0)
    return math.sqrt(variance / (2.0 * steepness))


def airy_px(f_number: float, pixel_pitch_um: float) -> float:
    """Standard deviation of the Gaussian whose peak is as curved as the Airy pattern's of a working f-number, pixels.

    >>> round(airy_px(32.0, 4.0), 2)
    1.98
    """
    return _AIRY_GAUSSIAN * WAVELENGTH * f_number / (1e-6 * pixel_pitch_um)


def noise_electrons(wells: ArrayLike, gain: float = 1.0) -> Float:
    """Root mean square noise of pixels of SENSOR that hold so many electrons, in electrons."""
    held = np.asarray(wells, np.float64)
    level = held * gain / SENSOR.full_well
    steps = np.array([1.0 / (SENSOR.largest_dn - SENSOR.black_level), 1.0 / 255.0]) * SENSOR.full_well / gain
    rounding = (steps[0] ** 2 + (steps[1] / _srgb_slope(level)) ** 2) / 12.0
    unlike = SENSOR.dsnu**2 + (SENSOR.prnu * held) ** 2
    return np.asarray(np.sqrt(held + SENSOR.read_noise**2 + unlike + rounding))


def luma_noise(levels: Float, gain: float = 1.0) -> Float:
    """Root mean square noise of the luma that is matched, (..,), of pixels (.., 3) of so many shares of white.

    Luma is of encoded channels, Y' = sum w_c f(L_c), rounded to whole numbers. Its noise is brought back to shares of
    white as more light of the same colour would change it, by  dY'/dY = sum w_c f'(L_c) L_c / Y,  Y = sum w_c L_c: each
    channel's noise weighs w_c f'(L_c) over that, a dark channel's more than w_c. A burnt channel has neither noise nor
    change; where all are burnt, noise is infinite.
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
    """Of the curve of IEC 61966-2-1."""
    bright = np.maximum(level, 0.0031308)
    return np.where(level <= 0.0031308, 12.92, 1.055 / 2.4 * bright ** (1 / 2.4 - 1))


def shift_bound(grain: float, blur_variance: ArrayLike, contrast: ArrayLike, noise: ArrayLike) -> Float:
    """The Cramer-Rao bound of a shift up to a factor that no lens changes: (s^2 + b^2) noise / contrast."""
    return np.asarray((grain**2 + np.asarray(blur_variance)) * np.asarray(noise) / np.asarray(contrast), np.float64)


def predicted_error(
    stage: Stage, lens: ThinLens, exposure: Exposure, image: NDArray[np.float32], blur_px: Float, grain: float,
    diffracts: bool,
) -> float:  # fmt: skip
    """The theory of the module's first lines, in arbitrary units. blur_px: of every pixel's depth, signed, (H, W)."""
    camera = stage.camera
    known = np.isfinite(stage.truth.depth)
    airy = airy_px(camera.film_distance / lens.aperture_diameter, camera.pixel_pitch_um) if diffracts else 0.0
    rate = SENSOR.level_rate(image, camera=camera, lens=lens).mean(axis=-1)[known]
    wells = rate * exposure.time * SENSOR.full_well
    lit = (wells > 0) & (wells * exposure.gain < SENSOR.full_well)
    if not 2 * lit.sum() > lit.size:
        return math.inf
    variance = (blur_px[known] / 4.0) ** 2 + airy**2
    errors = shift_bound(grain, variance, np.where(lit, wells, 1.0), noise_electrons(wells, exposure.gain))
    return float(np.median(np.where(lit, errors, math.inf)))


def best_f_number(numbers: Float, errors: Float) -> float:
    """The f-number of the least error, by a parabola through it and its neighbours in log N.

    Errors that are not finite are passed by.

    >>> n = np.array([1.0, 2.0, 4.0, 8.0])
    >>> round(best_f_number(n, (np.log(n) - np.log(3.0)) ** 2), 3)
    3.0
    """
    k = int(np.argmin(np.where(np.isfinite(errors), errors, np.inf)))
    near = slice(k - 1, k + 2)
    if k in (0, len(numbers) - 1) or not np.isfinite(errors[near]).all():
        return float(numbers[k])
    a, b, _ = np.polyfit(np.log(numbers[near]), errors[near], 2)
    if not a > 0:
        return float(numbers[k])
    low, high = np.log(numbers[k - 1]), np.log(numbers[k + 1])
    return float(math.exp(min(max(-b / (2 * a), low), high)))
