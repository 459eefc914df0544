"""The f-number that theory expects to be best: where blur, diffraction and noise balance. No matcher in it.

Near its best, a matcher errs as the Cramer-Rao bound of a shift: sigma / sqrt(mean squared slope). A
texture of grain s (a Gaussian's standard deviation, measured on the sharp picture) that a blur of variance b^2 widens
keeps slopes of variance ~ 1/(s^2 + b^2)^2, with b^2 = (c/4)^2 of the blur disk, c = A fx |1/z - k|, and
(0.45 lambda N/p)^2 of the Airy pattern (the Gaussian of least squares: Zhang, Zerubia and Olivo-Marin, Gaussian
approximations of fluorescence microscope point-spread function models, Applied Optics 46(10), 2007: 0.225 lambda/NA).
Noise: a signal of S electrons comes with sqrt(S + r^2), read noise r. The harmonic mean over the picture's pixels, each
with its true depth, of  (s^2 + b^2) sqrt(S + r^2) / S  is smallest at the predicted f-number. Burnt pixels tell
nothing. What noise the light paths leave in a picture is the renderer's, not the camera's, and has no place in it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ThinLens
from twinlens.matching import grey
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.stage import Stage

Float = NDArray[np.float64]

WAVELENGTH = 549e-9
SENSOR = Sensor.preset("machine_vision", wavelengths=(WAVELENGTH,) * 3)
_AIRY_GAUSSIAN = 0.45


def grain_px(image: NDArray[np.float32]) -> float:
    """The texture's grain: s of the Gaussian whose smoothed white noise has this picture's variance and slopes, pixels.

    s^2 = var(I) / (2 var(dI/du)), over patches of 16 pixels, so that shading does not count as texture.
    """
    flat = grey(image).astype(np.float64)
    slopes = np.diff(flat, axis=1)
    patches = [
        (flat[y : y + 16, x : x + 16].var(), slopes[y : y + 16, x : x + 15].var())
        for y in range(0, flat.shape[0] - 15, 16)
        for x in range(0, flat.shape[1] - 15, 16)
    ]
    variance, steepness = np.mean(patches, axis=0)
    return math.sqrt(variance / (2.0 * steepness))


def predicted_error(
    stage: Stage, lens: ThinLens, exposure: Exposure, image: NDArray[np.float32], grain: float, diffracts: bool
) -> float:  # fmt: skip
    """The theory of the module's first lines, in arbitrary units: the harmonic mean of the error."""
    known = np.isfinite(stage.truth.depth)
    before = grain**2 + (stage.blur(lens)[known] / 4.0) ** 2
    number = stage.camera.film_distance / lens.aperture_diameter
    airy = _AIRY_GAUSSIAN * WAVELENGTH * number / (1e-6 * stage.camera.pixel_pitch_um) if diffracts else 0.0
    rate = SENSOR.level_rate(image, camera=stage.camera, lens=lens).mean(axis=-1)[known]
    wells = rate * exposure.time * SENSOR.full_well
    step = SENSOR.full_well / 255.0 / exposure.gain
    sensor = np.sqrt(wells + SENSOR.read_noise**2 + step**2 / 12.0)
    telling = wells * exposure.gain < SENSOR.full_well
    return 1.0 / float(np.mean(telling * wells / ((before + airy**2) * sensor)))


def best_f_number(numbers: Float, errors: Float) -> float:
    """The f-number of the least error, by a parabola through it and its neighbours in log N; NaN errors are passed by.

    >>> n = np.array([1.0, 2.0, 4.0, 8.0])
    >>> round(best_f_number(n, (np.log(n) - np.log(3.0)) ** 2), 3)
    3.0
    """
    k = int(np.nanargmin(errors))
    near = slice(k - 1, k + 2)
    if k in (0, len(numbers) - 1) or np.isnan(errors[near]).any():
        return float(numbers[k])
    a, b, _ = np.polyfit(np.log(numbers[near]), errors[near], 2)
    return float(math.exp(-b / (2 * a))) if a > 0 else float(numbers[k])
