"""Sparsification curves: the closed forms of an oracle and of a random confidence, and a naive loop."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from twinlens.errors import InputError
from twinlens.scoring import sparsification
from twinlens.scoring.sparsification import DENSITIES


@pytest.mark.parametrize("share", [0.0, 0.03, 0.25, 0.5, 0.9, 1.0])
def test_the_area_of_an_oracle_is_the_closed_form(share):
    count = 4000
    error = np.linspace(0, 1, count)
    bad = np.arange(count) >= round((1 - share) * count)
    curve = sparsification(-error, bad)
    expected = share + (1 - share) * math.log(1 - share) if share < 1 else 1.0
    assert curve.auc == pytest.approx(expected, abs=1e-4)
    assert curve.optimal_auc == pytest.approx(expected, abs=1e-12)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(0, 8), st.booleans()), min_size=1, max_size=30))
def test_the_area_is_that_of_a_fine_sum_over_random_orders(pixels):
    """With ties, the expected number of bad pixels grows linearly: the same as splitting each pixel into many."""
    values, bad = np.array([v for v, _ in pixels]), np.array([b for _, b in pixels])
    split = 100
    rows = [
        (v, bad[values == v].mean())
        for v in sorted(set(values), reverse=True)
        for _ in range(split * (values == v).sum())
    ]
    parts = np.array([part for _, part in rows])
    area = np.mean(
        (np.cumsum(parts) - parts / 2) / (np.arange(len(parts)) + 0.5)
    )  # of middles: exact to second order
    curve = sparsification(values, bad)
    assert curve.auc == pytest.approx(area, abs=1e-4)
    assert curve.auc >= curve.optimal_auc - 1e-12
    assert curve.error_rates[-1] == pytest.approx(bad.mean())


def test_the_curve_is_the_error_rate_of_the_most_confident():
    rng = np.random.default_rng(3)
    values, bad = rng.permutation(200).astype(float), rng.random(200) < 0.4
    order = np.argsort(-values)
    for density, rate in zip(
        DENSITIES, sparsification(values, bad).error_rates, strict=True
    ):
        assert rate == pytest.approx(bad[order][: round(density * 200)].mean())


def test_infinite_confidences_are_ranked():
    curve = sparsification([np.inf, 1.0, -np.inf], [False, True, True])
    assert curve.error_rates[-1] == pytest.approx(2 / 3)
    assert curve.auc == pytest.approx(curve.optimal_auc)


def test_no_pixels_have_no_area():
    assert math.isnan(sparsification([], np.zeros(0, bool)).auc)


@pytest.mark.parametrize(
    ("confidence", "bad", "message"),
    [([1, 2], [True], "one shape"), ([1], [1], "bool"), ([np.nan], [True], "NaN")],
)
def test_wrong_input_is_refused(confidence, bad, message):
    with pytest.raises(InputError, match=message):
        sparsification(confidence, bad)
