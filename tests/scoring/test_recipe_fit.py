"""Recipes fitted to pairs: values that were put in come out, and datasets of the result resemble the pairs."""

import json
import math
import shutil
import tomllib

import numpy as np
import pytest
from scipy import ndimage

from tests.factory_recipes import SCENE
from twinlens.camera import Camera, Pinhole
from twinlens.cli import run
from twinlens.dataset import Dataset
from twinlens.factory import generate, recipe_from_table
from twinlens.scoring import (
    Pair,
    fit_recipe,
    open_pairs,
    pair_statistics,
    recipe_toml,
    summarize,
)
from twinlens.scoring.recipe_fit import (
    LIGHT,
    _distributions,
    _fitted_noise,
    _fitted_weights,
    light_difference,
)
from twinlens.sensor import Exposure, Mismatch, Sensor

SHIFT = 6
MISMATCH = {
    "gain": 1.08,
    "shading_right": -0.06,
    "shading_down": 0.04,
    "shading_corner": 0.05,
    "black_level": 30.0,
}
# Ten times the variance of the noise of the default sensor; both cameras always differ in the same direction.
NOISE = {
    "full_well": 1070,
    "dark_current": 0.1,
    "radiance_scale": 0.1,
    "read_noise": 2.3 / 10**0.5,
    "dsnu": 10**-0.5,
}
DRAWN = {
    "gain": {"normal": [1.05, 0.02], "clip": [0.99, 1.11]},
    "shading_right": {"normal": [-0.04, 0.03], "clip": [-0.13, 0.05]},
    "shading_down": 0.02,
    "shading_corner": {"normal": [0.03, 0.02], "clip": [-0.03, 0.09]},
    "black_level": {"normal": [20, 10], "clip": [-10, 50]},
}
RECIPE = {
    "seed": 1,
    "count": 2,
    "scenes": ["tiny.toml"],
    "width": 96,
    "height": 72,
    "spp": 4,
    "denoise": False,
    "scene": {
        "jitter": {"right": {"uniform": [-0.3, 0.3]}, "yaw_deg": {"uniform": [-5, 5]}}
    },
}
REAL = {
    **RECIPE,
    "seed": 2,
    "sensor": {**NOISE, "prnu": 0.005 * 10**0.5, "mismatch": DRAWN},
}


def plane_pair(sensor, size=(120, 160), seed=0):
    """A texture at a disparity of 6 px, seen by two cameras of the sensor."""
    height, width = size
    texture = ndimage.gaussian_filter(
        np.random.default_rng(seed).normal(size=(height, width + SHIFT)), 3.0
    )
    light = 0.25 * np.exp(texture / texture.std())[..., None] * np.ones(3)
    camera = Camera.from_fov(width, height, fov_x_deg=50)
    rate = sensor.level_rate(np.ones((height, width, 3)), camera=camera, lens=Pinhole())
    exposure = Exposure(float(1 / rate.max()))
    left, right = (
        sensor.expose(
            part, camera=camera, lens=Pinhole(), exposure=exposure, eye=eye
        ).image
        for eye, part in enumerate((light[:, :width], light[:, SHIFT:]))
    )
    truth = np.full(size, float(SHIFT), np.float32)
    mask = np.where(np.arange(width) >= SHIFT, 255, 128) * np.ones(size)
    return Pair("plane", left, right, truth, mask.astype(np.uint8), 16)


@pytest.mark.parametrize(
    "output",
    [
        {"output": "srgb", "filters": "mono"},
        {"output": "gamma", "gamma": 2.0},
        {"output": "linear"},
    ],
)
def test_light_of_the_second_camera_is_measured(output):
    """Without noise, errors are products of two differences, such as 0.08 * 0.06."""
    sensor = Sensor.preset("ideal", shot_noise=False, bits=16, **output)
    # The gain contains the time and the f-number.
    second = Mismatch(**MISMATCH, time=1.02, f_number=0.98)
    mismatched = sensor.replace(mismatch=second)
    light, *_ = light_difference(plane_pair(mismatched), sensor)
    gain, *shading, black = MISMATCH.values()
    assert light[0] == pytest.approx(gain * 1.02 / 0.98**2, abs=0.06 * 0.08)
    assert light[1:4] == pytest.approx(shading, abs=0.06 * 0.08)
    assert light[4] == pytest.approx(black, abs=black * (0.06 + 0.08))


def test_slow_differences_are_measured_apart_from_shading():
    """A sine of 4 grey levels, 10.5 periods high, is no shading: its 21-px mean keeps sinc(21/40) of it.

    On a flat field of linear grey level G, unit shading has the variance G^2 (1/3 + 1/3 + var r^2), of which the 21-px
    mean keeps nearly all: r^2 = (w^2 x^2 + h^2 y^2) / (w^2 + h^2), with x^2 and y^2 of variance 4/45.
    """
    sensor = Sensor.preset("ideal", shot_noise=False, bits=16, output="linear")
    height, width = 420, 200
    flat = 100 + np.random.default_rng(0).normal(size=(height, width)) * 0.1
    wave = 4 * np.sin(2 * np.pi * np.arange(height) / 40)[:, None]
    levels = [
        np.rint(257 * image).astype(np.uint16)
        for image in (flat - wave / 2, flat + wave / 2)
    ]
    pair = Pair("flat", *levels, np.zeros((height, width), np.float32), None, 8)
    _, rest, unit = light_difference(pair, sensor)
    assert rest == pytest.approx(8 * np.sinc(21 / 40) ** 2, rel=0.1)
    share = (width**4 + height**4) / (width**2 + height**2) ** 2
    assert unit == pytest.approx(100**2 * (2 / 3 + 4 / 45 * share), rel=0.05)


def test_fitted_sensors_multiply_the_variance_of_the_noise():
    """A flat field in linear 16-bit output at three levels: the ratio of sample variances is 4 within 5 s.d."""
    camera, count = Camera.from_fov(200, 200, fov_x_deg=50), 200 * 200 * 3
    sensor = Sensor(
        output="linear",
        bits=16,
        adc_bits=16,
        read_noise=20.0,
        prnu=0.01,
        dsnu=5.0,
        dark_current=100.0,
    )
    fields, _ = _fitted_noise([sensor], noise=3.0, growth=1.0, target=6.0)
    noisier = sensor.replace(**fields)
    for level in (0.02, 0.2, 0.6):
        variances, means = [], []
        for variant in (sensor, noisier):
            rate = variant.level_rate(
                np.ones((200, 200, 3)), camera=camera, lens=Pinhole()
            ).mean()
            # The exposure is that of the first sensor: the second must reach the same level with it.
            exposure = Exposure(1.0, 1.0)
            light = np.full((200, 200, 3), level / rate)
            image = variant.replace(white_balance=False).expose(
                light, camera=camera, lens=Pinhole(), exposure=exposure
            )
            channels = image.image.reshape(-1, 3).astype(float)
            variances.append(channels.var(axis=0).mean())
            means.append(channels.mean())
        assert means[1] == pytest.approx(means[0], rel=1e-3)
        assert variances[1] / variances[0] == pytest.approx(
            4.0, rel=5 * math.sqrt(4 / count)
        )


def test_noise_that_no_sensor_reaches_is_not_fitted():
    fields, note = _fitted_noise([Sensor()], noise=3.0, growth=1.0, target=1.9)
    assert (fields, note.split(":")[0]) == ({}, "Noise is not fitted")
    fields, note = _fitted_noise(
        [Sensor(), Sensor(prnu=0.1)], noise=3.0, growth=1.0, target=2.9
    )
    assert (fields, note.split(":")[0]) == ({}, "Noise is not fitted")


def test_distributions_have_the_moments_without_those_of_the_errors():
    """Values of known mean and variance plus errors of known mean and variance, uncorrelated in the sample."""
    # Both have the sample variance 1.
    signs = np.array([1.0, 1, -1, -1])[:, None] * math.sqrt(3) / 2
    uncorrelated = np.array([1.0, -1, 1, -1])[:, None] * math.sqrt(3) / 2
    means = np.array([1.05, 0.02, -0.03, 0.0, 4.0])
    errors = np.array([0.01, 0.0, 0.01, 0.0, 3.0]) + 0.004 * uncorrelated
    values = means + 0.02 * signs + errors
    fields = _distributions(values, errors, 0.0)
    for name, mean in zip(LIGHT, means, strict=True):
        field = fields[name]
        limits = [mean - 0.06, mean + 0.06]
        assert field["normal"] == pytest.approx([mean, 0.02], abs=2e-4), name
        assert field["clip"] == pytest.approx(limits, abs=5e-4), name
    constant = _distributions(means + errors, errors, 0.0)
    assert constant == pytest.approx(dict(zip(LIGHT, means, strict=True)))
    wider = _distributions(values, errors, 0.03**2)
    spreads = [wider[name]["normal"][1] for name in LIGHT]
    shading = math.hypot(0.02, 0.03)
    expected = [0.02, shading, shading, shading, 0.02]
    assert spreads == pytest.approx(expected, rel=0.01)
    extreme = np.array([[0.6, -0.4, 0, 0, 0], [1.4, 0.6, 0, 0, 0]])
    clipped = _distributions(extreme, 0 * errors, 0.0)
    assert clipped["shading_right"]["clip"] == [-0.3, 0.3]
    assert clipped["gain"]["clip"][0] == 0.001


def test_weights_have_the_mean_share_and_are_nearest():
    recipe = {"families": ["a", "b", "c"], "weights": [1, 2, 1]}
    scenes, shares = ("a", "b", "b", "c"), (0.2, 0.5, 0.7, 0.8)
    weights = np.array(_fitted_weights(recipe, scenes, shares, 0.6)[0]["weights"])
    means = np.array([0.2, 0.6, 0.8])
    assert weights.sum() == pytest.approx(1, abs=1e-3)
    assert weights @ means == pytest.approx(0.6, abs=1e-3)
    # Any other weights of this sum and mean differ by a multiple of one direction: none is nearer.
    direction = np.cross(np.ones(3), means)
    assert (weights - [0.25, 0.5, 0.25]) @ direction == pytest.approx(0, abs=1e-3)
    for target in (0.1, 0.95):
        assert _fitted_weights(recipe, scenes, shares, target)[0] == {}
    assert _fitted_weights({"scenes": ["a"]}, ("a",), (0.5,), 0.6)[0] == {}
    assert _fitted_weights(recipe, ("a", "a"), (0.2, 0.3), 0.25)[0] == {}


def test_toml_has_the_same_recipe():
    recipe = {
        "seed": 3,
        "scenes": ["staircase", 'a "b": c', "ü"],
        "denoise": False,
        "noise": 1e-7,
        "scene": {
            "jitter": {"right": {"uniform": [-0.1, 0.1]}, "down": 0.5},
        },
        "lenses": [
            {"kind": "thin", "f_number": 2, "focus": "inf"},
            {"kind": "pinhole"},
        ],
        "splits": {"train": 0.7, "my test": 0.3},
        "gates": {},
    }
    text = recipe_toml(recipe)
    assert "\nuniform = [-0.1, 0.1]\n" in text
    fitted = tomllib.loads(text)
    assert fitted["lenses"][0].pop("focus") == math.inf
    recipe["lenses"][0].pop("focus")
    assert fitted == recipe


def datasets(folder, count, **changes):
    """Two datasets: `start` with identical cameras, `real` with other cameras, more noise and other viewpoints.

    Cameras that differ as by default would have glare and stray light, which a fit takes for a black level.
    """
    (folder / "tiny.toml").write_text(SCENE)
    start = {**RECIPE, "sensor": {"mismatch": {"level": "none"}}}
    for name, table in (("start", start), ("real", REAL)):
        table = {**table, "count": count, **changes}
        generate(recipe_from_table(table, folder / "recipe.toml"), folder / name)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The fewest pairs that can be fitted: two in both sets."""
    return datasets(tmp_path_factory.mktemp("fit"), 2)


def statistics(path):
    return {
        name: values[0]
        for name, values in summarize(
            [*map(pair_statistics, open_pairs([str(path)]))]
        ).items()
    }


def errors_of(dataset):
    """Errors of `light_difference` beside the recorded mismatches, and these, (N, 5) each."""
    fitted = np.array(
        [light_difference(pair, Sensor())[0] for pair in open_pairs([str(dataset)])]
    )
    records = [
        sample.record["record"]["sensor"]["mismatch"] for sample in Dataset(dataset)
    ]
    true = np.array([[record[name] for name in LIGHT] for record in records])
    return fitted - true, true


@pytest.fixture(scope="module")
def six(tmp_path_factory):
    """Rendering adds little noise, and white one: after denoising, slow differences would remain."""
    return datasets(tmp_path_factory.mktemp("six"), 6, spp=64)


@pytest.mark.slow
def test_a_fit_recovers_cameras_and_noise(six):
    """Means and s.d. are those of the recorded mismatches of `real`, which both are uncertain by the errors of the fit.

    With errors of s.d. e and f for a pair of the two sets of six, the mean is uncertain by sqrt((e^2 + f^2) / 6), and a
    s.d. by at most sqrt((e^2 + f^2) / 5). The factor of the noise, from 6 * 96 * 72 / 4 coefficients, is uncertain by
    1.17 * 2 / sqrt(10368) = 2.3 % for the noise of `real`, and by twice that for the growth in `start`, where the
    sensor causes half of the variance. Bounds are three times these.
    """
    fitted, _ = fit_recipe(Dataset(six / "start"), open_pairs([str(six / "real")]))
    errors, _ = errors_of(six / "start")
    others, true = errors_of(six / "real")
    both = np.sqrt(errors.var(axis=0, ddof=1) + others.var(axis=0, ddof=1))
    for name, error, values in zip(LIGHT, both, true.T, strict=True):
        field = fitted["sensor"]["mismatch"][name]
        mean, spread = field["normal"] if isinstance(field, dict) else (field, 0.0)
        assert mean == pytest.approx(values.mean(), abs=3 * error / math.sqrt(6)), name
        assert spread == pytest.approx(
            values.std(ddof=1), abs=3 * error / math.sqrt(5)
        ), name
    assert fitted["sensor"]["full_well"] == pytest.approx(
        1070, rel=3 * math.hypot(0.023, 0.046)
    )


@pytest.mark.slow
def test_a_dataset_of_the_fit_resembles_the_pairs(six, tmp_path):
    folder = shutil.copytree(six, tmp_path / "six")
    real = open_pairs([str(folder / "real")])
    fitted, _ = fit_recipe(Dataset(folder / "start"), real)
    generate(recipe_from_table(fitted, folder / "recipe.toml"), folder / "fitted")
    start, after, target = (
        statistics(folder / name) for name in ("start", "fitted", "real")
    )
    for name in (
        "low_sd",
        "bias",
        "gain",
        "offset",
        "noise",
        "flat_noise",
        "residual",
        "textureless",
    ):
        assert abs(after[name] - target[name]) < abs(start[name] - target[name]), name
    again, _ = fit_recipe(Dataset(folder / "fitted"), real)
    assert again["sensor"]["full_well"] == pytest.approx(
        1070, rel=3 * math.hypot(0.023, 0.046)
    )


def test_the_command_prints_a_recipe(folder, capsys):
    start, real = str(folder / "start"), str(folder / "real")
    recipe, notes = fit_recipe(Dataset(start), open_pairs([real]))
    assert run(["statistics", start, "--like", real]) == 0
    text = capsys.readouterr().out
    assert tomllib.loads(text) == recipe
    others = {name: value for name, value in recipe.items() if name != "sensor"}
    assert others == RECIPE
    assert recipe_from_table(tomllib.loads(text), folder / "like.toml").count == 2
    assert run(["statistics", start, "--like", real, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["recipe"], tuple(document["notes"])) == (recipe, notes)


def test_what_cannot_be_fitted_is_refused_in_one_line(folder, tmp_path, capsys):
    start, real = str(folder / "start"), str(folder / "real")
    blind = tmp_path / "blind"
    for name in ("0000000", "0000001"):
        shutil.copytree(folder / "real" / name, blind / name)
    (blind / "0000001" / "disp0.pfm").unlink()
    raw = tmp_path / "raw"
    shutil.copytree(start, raw)
    for file in raw.rglob("*.json"):
        text = file.read_text()
        file.write_text(text.replace('"output": "srgb"', '"output": "raw"'))
    for dataset, like, message in (
        ("motorcycle", real, "motorcycle: has no dataset.json; --like needs a dataset"),
        (start, "motorcycle", "two pairs or more in both sets, got 2 and 1"),
        (start, str(blind), "disp0.pfm"),
        (str(raw), real, "has raw images; a fit needs srgb, linear, gamma"),
    ):
        assert run(["statistics", dataset, "--like", like]) == 2, message
        printed = capsys.readouterr()
        assert (printed.out, message in printed.err) == ("", True), printed.err
        assert printed.err.count("\n") == 1
