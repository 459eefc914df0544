"""The Cramer-Rao bound against least-squares estimates of known shifts; findings of known tables."""

import math

import numpy as np
import pytest
from scipy import ndimage

from twinlens.studies import STUDIES, Table, texture

STUDY = STUDIES["texture"]
GAIN, SIGMA, SHIFT, SIDE = 900.0, 4.0, 0.06, 7


def waves(seed, shift=0.0, size=(63, 210)):
    """Radiance (H, W) and its derivative along u: a sum of waves of at least six pixels."""
    random = np.random.default_rng(seed)
    v, u = np.mgrid[: size[0], : size[1]]
    light, slope = np.full(size, 1.0), np.zeros(size)
    for _ in range(60):
        across, down, phase = (
            random.uniform(-0.16, 0.16),
            random.uniform(-0.16, 0.16),
            random.uniform(0, 2 * np.pi),
        )
        angle = 2 * np.pi * (across * (u - shift) + down * v) + phase
        light += 0.01 * np.cos(angle)
        slope -= 0.01 * 2 * np.pi * across * np.sin(angle)
    return light, slope


def test_slopes_are_those_of_the_radiance_in_grey_levels():
    light, slope = waves(0)
    picture = GAIN * light + np.random.default_rng(1).normal(0.0, SIGMA, light.shape)
    slopes = texture._slopes(
        picture, np.repeat(light[..., None], 3, axis=2).astype(np.float32)
    )
    error = (slopes - GAIN * slope)[:, 4:-4]
    assert np.abs(error).max() < 0.02 * np.abs(GAIN * slope).max()


def test_least_squares_reach_the_bound():
    """Two noisy images, the right one shifted; the shift of every window by least squares."""
    errors, bounds = [], []
    for seed in range(8):
        light, _ = waves(seed)
        random = np.random.default_rng(100 + seed)
        left = GAIN * light + random.normal(0.0, SIGMA, light.shape)
        right = GAIN * waves(seed, shift=SHIFT)[0] + random.normal(
            0.0, SIGMA, light.shape
        )
        slopes = texture._slopes(
            GAIN * light, np.repeat(light[..., None], 3, axis=2).astype(np.float32)
        )
        window = np.ones((SIDE, SIDE))
        shifts = ndimage.convolve(slopes * (left - right), window) / ndimage.convolve(
            slopes**2, window
        )
        apart = (
            slice(SIDE, -SIDE, SIDE),
            slice(SIDE, -SIDE, SIDE),
        )  # windows that share no pixel
        errors.append((shifts - SHIFT)[apart].ravel())
        bounds.append(texture._bounds(slopes, SIGMA, SIDE)[apart].ravel())
    error, bound = np.concatenate(errors), np.concatenate(bounds)
    ratio = math.sqrt(float(np.mean((error / bound) ** 2)))
    # The standard deviation of n samples has a relative standard error of 1/sqrt(2 n).
    assert ratio == pytest.approx(1.0, abs=4 / math.sqrt(2 * error.size))


def rows(power=-1.0, blunders=lambda contrast: 0.0, contrasts=texture._NOISY):
    return Table(
        STUDY.all_columns,
        tuple(
            {"scene": "plane", "seed": seed, "swept": "contrast", "method": "sad", "contrast": contrast,
             "grain_px": 1.0,
             "error_px": 0.01 * contrast**power, "bound_px": 0.004 * contrast**-1.0, "blunders": blunders(contrast)}
            for seed in (0, 1) for contrast in contrasts
        ),
    )  # fmt: skip


def test_the_exponent_names_its_contrasts():
    finding = texture.conclude(rows())[-1]
    assert finding.holds
    assert "0.03, 0.04, 0.06, 0.08" in finding.text
    fewer = texture.conclude(rows(blunders=lambda contrast: 5.0 * (contrast < 0.035)))[
        -1
    ]
    assert fewer.decided
    assert "0.04, 0.06, 0.08" in fewer.text
    assert "0.03" not in fewer.text


def test_two_contrasts_do_not_decide_the_exponent():
    few = rows(blunders=lambda contrast: 5.0 * (contrast < 0.05))
    finding = texture.conclude(few)[-1]
    assert not finding.decided
    assert "{}" not in finding.text


def test_another_exponent_does_not_hold():
    assert not texture.conclude(rows(power=-1.3))[-1].holds


def test_one_matcher_is_not_called_the_nearest():
    """Without another to compare with, the sentence would hold of any matcher."""
    two = rows()
    other = tuple({**row, "method": "zncc", "error_px": 2 * row["error_px"]} for row in two.rows)  # fmt: skip
    assert "sad is the nearest" in texture.conclude(Table(two.columns, two.rows + other))[1].text  # fmt: skip
    assert not any("nearest" in finding.text for finding in texture.conclude(two))
