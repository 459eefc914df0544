"""The slanted edge's MTF against the closed forms of a Gaussian, a box and a disk."""

import numpy as np
import pytest
from scipy import special

from twinlens.errors import InputError
from twinlens.studies.pinhole.film import (
    crossing,
    frequency_at,
    modulation_transfer,
)

WIDTH, HEIGHT = 121, 90
SLOPE = np.tan(np.radians(5.0))


def away():
    """Distance of every pixel centre from an edge at five degrees to the vertical."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return (u - 56.3 - SLOPE * v) / np.hypot(1.0, SLOPE)


def disk_edge(radius):
    """The edge-spread function of a uniform disk: the share of its area left of a line."""
    x = np.clip(away() / radius, -1.0, 1.0)
    return 0.5 + (x * np.sqrt(1.0 - x**2) + np.arcsin(x)) / np.pi


EDGES = {
    "gaussian": (lambda: 0.5 + 0.5 * special.erf(away() / (np.sqrt(2.0) * 1.5)),
                 lambda f: np.exp(-2.0 * (np.pi * f * 1.5) ** 2)),
    "box": (lambda: np.clip(away() / 3.0 + 0.5, 0.0, 1.0), lambda f: np.abs(np.sinc(3.0 * f))),
    "disk": (lambda: disk_edge(3.0), lambda f: np.abs(2.0 * special.j1(6.0 * np.pi * f) / (6.0 * np.pi * f))),
}  # fmt: skip


@pytest.mark.parametrize("name", EDGES)
def test_mtf_of_closed_forms(name):
    make, theory = EDGES[name]
    frequency, contrast = modulation_transfer(make())
    used = (frequency > 0.005) & (frequency < 0.3)
    assert np.abs(contrast[used] - theory(frequency[used])).max() < 0.015


@pytest.mark.parametrize("name", EDGES)
def test_mtf50_is_within_one_percent(name):
    make, theory = EDGES[name]
    fine = np.linspace(1e-4, 0.5, 50001)
    assert frequency_at(make(), 0.5) == pytest.approx(
        crossing(fine, theory(fine), 0.5), rel=0.01
    )


def test_inverted_and_scaled_contrast():
    picture = EDGES["disk"][0]()
    assert frequency_at(1.0 - picture, 0.5) == pytest.approx(
        frequency_at(picture, 0.5), rel=1e-9
    )
    assert frequency_at(0.1 + 0.3 * picture, 0.5) == pytest.approx(
        frequency_at(picture, 0.5), rel=1e-9
    )


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (np.zeros((40, 40)), "an edge through every row"),
        (np.tile(np.arange(40) > 20, (40, 1)).astype(float), "not slanted"),
    ],
    ids=["flat", "upright"],
)
def test_images_without_a_slanted_edge_raise(picture, words):
    with pytest.raises(InputError, match=words):
        frequency_at(picture, 0.5)
