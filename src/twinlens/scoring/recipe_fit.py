"""Fit a recipe to pairs: light of the second camera, noise of the sensor, weights of the scenes.

Light: with light E and tone curve G(E), at the mean of the two grey levels, a `Mismatch` makes, to second order,

    right - left = E G'(E) (ln gain + a x + b y - c r^2) + G'(E) black level

A robust fit over pixels gives the five values of a pair. docs/realism.md says how their distribution is chosen.

Noise: the variance of the sensor's noise is multiplied by q, at any light and exposure, if full well, dark current and
radiance scale are divided by q, read noise and DSNU are divided by sqrt(q), and PRNU is multiplied by sqrt(q). The
factor is q = 1 + (n^2 - m^2) / s^2. Here n is the standard deviation of the noise of the pairs to be fitted, m that of
the dataset, and s that of the noise of the dataset's sensor. It is measured by adding this noise to the dataset's
images once more: m^2 then grows by s^2, because variances of independent noise add.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from twinlens.camera import Camera, Pinhole
from twinlens.dataset import Dataset, StoredSample
from twinlens.errors import InputError, counted
from twinlens.scoring.pair_statistics import (
    appearance,
    compared_images,
    grey_levels,
    low_pass,
    robust_fit,
)
from twinlens.scoring.samples import Pair, load_pair
from twinlens.sensor import Exposure, Sensor, mismatch_table
from twinlens.sensor.picture import CURVES, encode

Float = NDArray[np.float64]
LIGHT = {
    "gain": (1e-3, 1e3), "shading_right": (-0.3, 0.3), "shading_down": (-0.3, 0.3), "shading_corner": (-0.3, 0.3),
    "black_level": (-1e6, 1e6),
}  # fmt: skip
"""The fitted fields of a `Mismatch` and their limits; gain includes time and f-number."""

_NOISE = {
    "full_well": -1,
    "dark_current": -1,
    "radiance_scale": -1,
    "read_noise": -0.5,
    "dsnu": -0.5,
    "prnu": 0.5,
}
_LEAST_PIXELS = 1000
_DARKEST, _BRIGHTEST = 2.0, 250.0
"""Grey levels beyond these may be clipped."""


def fit_recipe(
    dataset: Dataset, like: Sequence[Pair]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The recipe of `dataset`, changed so that its pairs have the statistics of the pairs `like`; and notes on the fit.

    Fitted are gain, shading and black level of the second camera, the sensor's noise, and the weights of scenes or
    families. `like` is taken to have the dataset's tone curve. To improve the fit, repeat it with a dataset of the
    result.

    Raises InputError for a dataset that is not of `twinlens generate`, raw images, a sensor or mismatch that is drawn
    as a whole, fewer than two pairs, and a pair with less than 1000 pixels to compare.
    """
    recipe = _recipe_to_fit(dataset)
    sensor_table = recipe.get("sensor", {})
    measured = _measured_shots(dataset, len(like))
    sensors = [shot.sensor for shot in measured]
    light, slow = _light_differences(like, sensors[0])
    # What the pairs have in slow differences beyond the dataset's becomes a spread of the shading.
    excess = slow - float(np.mean([shot.slow for shot in measured]))
    response = float(np.mean([shot.response for shot in measured]))
    extra_shading = max(excess, 0.0) / response

    appearances = [appearance(grey_levels(pair.im0)) for pair in like]
    target_noise, target_share = np.mean(appearances, axis=0).tolist()
    noise = float(np.mean([shot.noise for shot in measured]))
    growth = float(np.mean([shot.noise_growth for shot in measured]))
    fields, noise_note = _fitted_noise(sensors, noise, growth, target_noise)
    scenes = [shot.scene for shot in measured]
    shares = [shot.textureless for shot in measured]
    weights, weights_note = _fitted_weights(recipe, scenes, shares, target_share)

    errors = np.array([shot.light_errors for shot in measured])
    distributions = _distributions(light, errors, extra_shading)
    mismatch = {**_without_light(mismatch_table(sensor_table)), **distributions}
    uncertainty = 100 / (2 * len(like) - 2) ** 0.5
    notes = (
        f"Fitted to {counted(len(like), 'pair')}. Standard deviations are uncertain by {uncertainty:.0f} %.",
        f"Shading: a standard deviation of {extra_shading**0.5:.2g} is added for other slow differences.",
        noise_note,
        weights_note,
        "Not fitted: brightness, blur, glare, colours and alignment of the cameras, materials of the scenes.",
    )
    fitted_sensor = {**sensor_table, **fields, "mismatch": mismatch}
    return {**recipe, **weights, "sensor": fitted_sensor}, notes


def _measured_shots(dataset: Dataset, like_count: int) -> "list[_Shot]":
    """The measures of every image pair of the dataset. Raises InputError for fewer than two pairs in either set."""
    shots: list[tuple[StoredSample, int]] = []
    for sample in dataset:
        shots += [(sample, lens) for lens in range(sample.num_lenses)]
    if len(shots) < 2 or like_count < 2:
        raise InputError(
            f"a fit needs two pairs or more in both sets, got {len(shots)} and {like_count}"
        )
    return [_measure(*shot) for shot in shots]


def _without_light(mismatch: dict[str, Any]) -> dict[str, Any]:
    """The mismatch without draws of time and f-number by its level: the fitted gain includes them."""
    if mismatch.get("level", "none") == "none":
        return mismatch
    return {**mismatch, "time": 1.0, "f_number": 1.0}


def _recipe_to_fit(dataset: Dataset) -> dict[str, Any]:
    """The recipe of a dataset, if it has one whose sensor and mismatch have fields of their own."""
    recipe = dict(dataset.manifest.recipe)
    if not recipe:
        raise InputError(
            f"{dataset.path}: has no recipe; only datasets of `twinlens generate` have one"
        )
    sensor_table = recipe.get("sensor", {})
    mismatch = mismatch_table(sensor_table)
    whole_draws = {"choice", "sweep", "per_scene"}
    if isinstance(mismatch, list) or whole_draws & {*sensor_table, *mismatch}:
        problem = "draws sensor or mismatch as a whole, or has a list of mismatches"
        raise InputError(
            f"{dataset.path}: its recipe {problem}; a fit needs the fields of one"
        )
    return recipe


def _light_differences(like: Sequence[Pair], sensor: Sensor) -> tuple[Float, float]:
    """The values of `LIGHT` of every pair, (N, 5), and the mean variance of the slow differences they leave."""
    light, slow = [], []
    for pair in like:
        if pair.disp0 is None:
            raise InputError(
                f"{pair.name}: has no true disparity (disp0.pfm), by which a fit compares the views"
            )
        values, slow_variance, _ = light_difference(pair, sensor)
        light.append(values)
        slow.append(slow_variance)
    return np.array(light), float(np.mean(slow))


def light_difference(pair: Pair, sensor: Sensor) -> tuple[Float, float, float]:
    """The values of `LIGHT`, (5,), black level in DN of `sensor`, and variances of two low-pass differences.

    The first is what these values do not explain, the second the sum for a = 1, b = 1 and c = 1. Raises InputError for
    less than 1000 pixels.
    """
    left, warped, used, _ = compared_images(pair)
    used &= (np.fmin(left, warped) > _DARKEST) & (np.fmax(left, warped) < _BRIGHTEST)
    count = np.count_nonzero(used)
    if count < _LEAST_PIXELS:
        where = "with truth, visible in both views and not saturated"
        raise InputError(
            f"{pair.name}: {count} pixels {where}; a fit needs {_LEAST_PIXELS}"
        )
    design = _light_terms(pair, sensor, (left + warped)[used] / 2, used)
    difference = (warped - left)[used]
    fit = robust_fit(design, difference, [0.0] * 5)
    rest = difference - design @ fit
    slow = low_pass(rest, used)
    # The mean over 21x21 pixels keeps 1 / 21^2 of the variance of the noise, which is subtracted.
    slow_variance = float(slow.var() - (rest - slow).var() / 21**2)
    shading = design.T[1:4]
    response = float(sum(low_pass(column, used).var() for column in shading))
    white = grey_levels(sensor.balance()[None, None])[0, 0]
    light_per_dn = white / (sensor.largest_dn - sensor.black_level)
    values = np.array([math.exp(fit[0]), *fit[1:4], fit[4] / light_per_dn])
    return values, slow_variance, response


def _light_terms(
    pair: Pair, sensor: Sensor, middle: Float, used: NDArray[np.bool_]
) -> Float:
    """(N, 5): the change of grey level for a unit of ln gain, a, b, c and the black level; see the module."""
    energy, grey = _tone_curve(sensor)
    slope = np.gradient(grey, energy)
    # At the mean of both grey levels the error of the linearisation is of third order.
    offset = np.interp(middle, grey, slope)
    scale = np.interp(middle, grey, energy * slope)
    height, width = used.shape
    rows, columns = np.nonzero(used)
    # The pixel of the right image, from -1 at the left or upper edge to 1 at the other.
    x = 2 * (columns - pair.truth[used]) / (width - 1) - 1
    y = 2 * rows / (height - 1) - 1
    r2 = ((width * x) ** 2 + (height * y) ** 2) / (width**2 + height**2)
    return np.stack([scale, scale * x, scale * y, -scale * r2, offset], axis=1)


def recipe_toml(recipe: Mapping[str, Any]) -> str:
    """A recipe as TOML, each list of numbers on one line. The text "inf" in a record becomes the number inf."""
    text = tomli_w.dumps(json.loads(json.dumps(recipe).replace('"inf"', "Infinity")))
    return re.sub(
        r"\[\n([^\[\]{\"]+),\n *\]",
        lambda numbers: f"[{' '.join(numbers[1].split())}]",
        text,
    )


@dataclass(frozen=True)
class _Shot:
    """What is measured on a pair of the dataset.

    light_errors: (5,), what `light_difference` finds minus the true values of `LIGHT`; slow and response are its
    variances. textureless: the share. noise, noise_growth: the variance, and by how much the sensor's noise raises it.
    """

    sensor: Sensor
    scene: str
    light_errors: Float
    textureless: float
    slow: float
    response: float
    noise: float
    noise_growth: float


def _measure(sample: StoredSample, k: int) -> _Shot:
    try:
        left, right = sample.lens(k).record["exposures"][:2]
        scene = sample.record["record"]["spec"]["scene"]
        sensor = Sensor.from_record({**left["sensor"], "mismatch": {}})
        mismatch = Sensor.from_record(right["sensor"]).mismatch_of(right["eye"])
        exposure = Exposure(left["time_s"], left["gain"])
    except (KeyError, TypeError) as error:
        raise InputError(
            f"{sample.folder}: sample.json is not of this version of `twinlens generate`"
        ) from error
    if sensor.output not in CURVES:
        raise InputError(
            f"{sample.folder}: has {sensor.output} images; a fit needs {', '.join(CURVES)}"
        )
    truth = asdict(mismatch)
    truth["gain"] *= truth["time"] / truth["f_number"] ** 2
    pair = load_pair(sample, k)
    values, slow, response = light_difference(pair, sensor)
    grey = grey_levels(pair.im0)
    noise, share = appearance(grey)
    noisier, _ = appearance(grey + _sensor_noise(pair.im0, sensor, exposure))
    return _Shot(
        sensor,
        scene,
        values - [truth[name] for name in LIGHT],
        share,
        slow,
        response,
        noise,
        noisier - noise,
    )


def _tone_curve(sensor: Sensor) -> tuple[Float, Float]:
    """Light, 0 to 1, and its grey level, (257,) each."""
    energy = np.linspace(0, 1, 257) ** 3
    return energy, encode(energy, sensor.output, sensor.gamma, 16) / 257


def _sensor_noise(image: NDArray[Any], sensor: Sensor, exposure: Exposure) -> Float:
    """Noise in grey levels (H, W), without rounding, of a camera that sees `image`."""
    energy, grey = _tone_curve(sensor)
    levels = image * (255 / np.iinfo(image.dtype).max)
    light = np.atleast_3d(np.interp(levels, grey, energy)) * np.ones(3)
    height, width = light.shape[:2]
    view: Any = {
        "camera": Camera.from_fov(width, height, fov_x_deg=50),
        "lens": Pinhole(),
    }
    noisy = sensor.replace(
        adc_bits=16, bits=16, vignetting=False, serial=sensor.serial + 1
    )
    clean = noisy.replace(
        shot_noise=False, read_noise=0.0, dark_current=0.0, prnu=0.0, dsnu=0.0
    )
    level_of_unit = noisy.level_rate(np.ones_like(light), **view)
    radiance = light / (level_of_unit * exposure.time * exposure.gain)
    with_noise, without = (
        grey_levels(camera.expose(radiance, exposure=exposure, **view).image)
        for camera in (noisy, clean)
    )
    return np.asarray(with_noise - without)


def _distributions(light: Float, errors: Float, extra: float) -> dict[str, Any]:
    """Each field of `LIGHT` as a normal distribution within 3 s.d., or a constant if it has no spread of its own."""
    # The errors of the measurement, known from the dataset, are taken out of mean and variance.
    means = light.mean(axis=0) - errors.mean(axis=0)
    variances = np.maximum(light.var(axis=0, ddof=1) - errors.var(axis=0, ddof=1), 0.0)
    variances[1:4] += extra
    fields: dict[str, Any] = {}
    spreads = np.sqrt(variances)
    for (name, limits), mean, spread in zip(LIGHT.items(), means, spreads, strict=True):
        values = np.clip(mean + spread * np.array([-3, 0, 3]), *limits)
        low, middle, high = (_rounded(value) for value in values)
        fields[name] = middle
        if low < high:
            normal = [middle, _rounded(spread)]
            fields[name] = {"normal": normal, "clip": [low, high]}
    return fields


def _fitted_noise(
    sensors: Sequence[Sensor], noise: float, growth: float, target: float
) -> tuple[dict[str, float], str]:
    """Fields of the sensor for the variance `target` of the noise, and a note."""
    if any(sensor != sensors[0] for sensor in sensors):
        return {}, "Noise is not fitted: the sensor differs between samples."
    if growth <= 0 or target <= noise - growth:
        rest = math.sqrt(max(noise - growth, 0.0))
        note = f"Noise is not fitted: s.d. {target**0.5:.3g}, and {rest:.3g} here without the sensor's."
        return {}, note
    q = 1 + (target - noise) / growth
    fields = {
        name: _rounded(getattr(sensors[0], name) * q**power)
        for name, power in _NOISE.items()
    }
    return fields, f"Noise: the variance of the sensor's is multiplied by {q:.3g}."


def _fitted_weights(
    recipe: Mapping[str, Any],
    scenes: Sequence[str],
    shares: Sequence[float],
    target: float,
) -> tuple[dict[str, list[float]], str]:
    """Weights of mean textureless share `target`, nearest to the present ones in least squares, and a note."""
    names = recipe.get("families") or recipe["scenes"]
    by_scene = np.array(scenes)
    share_of = np.array(shares)
    means = np.full(len(names), math.nan)  # NaN for a scene that was not drawn
    for k, name in enumerate(names):
        if name in scenes:
            means[k] = np.mean(share_of[by_scene == name])
    weights = np.array(recipe.get("weights") or np.ones(len(names)))
    weights = weights / weights.sum()
    # The nearest weights of the same sum lie in the direction of the means, minus their own mean.
    direction = means - means.mean()
    step = (target - weights @ means) / max(direction @ direction, 1e-12)
    weights = weights + step * direction
    listed = ", ".join(map("{} {:.2f}".format, names, means))
    text = f"mean textureless share {target:.2f}; {listed}"
    if not min(weights) >= 0 or not math.isclose(weights @ means, target):
        return {}, f"Weights are not fitted: {text}."
    return {"weights": [_rounded(weight) for weight in weights]}, f"Weights: {text}."


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
