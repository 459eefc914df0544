"""Fresnel's pattern against Hopkins's transfer function, the Airy pattern and geometric shadows."""

import numpy as np
import pytest

from twinlens.optics.diffraction import airy_kernel
from twinlens.studies.pinhole.film import convolved, fresnel_kernel, intensity, transfer

FILM, WAVE = 0.05, 550e-9


@pytest.mark.parametrize(
    ("diameter", "depth"), [(0.15e-3, np.inf), (0.26e-3, 10.0), (0.6e-3, 2.0)]
)
def test_the_fourier_transform_is_hopkins_transfer_function(diameter, depth):
    """Independent computations: the pattern from the wave, the transfer function from the pupil's overlap."""
    pitch = 10e-6
    kernel = fresnel_kernel(diameter, FILM, depth, WAVE, pitch)
    frequency = np.linspace(0.0, 0.7 * diameter / (WAVE * FILM), 12)[1:]
    places = (np.arange(kernel.shape[0]) - kernel.shape[0] // 2) * pitch
    measured = np.array(
        [(kernel.sum(axis=0) * np.cos(2 * np.pi * f * places)).sum() for f in frequency]
    )
    theory = transfer(frequency, diameter, FILM, depth, WAVE) * np.sinc(
        frequency * pitch
    )
    assert np.abs(measured - theory).max() < 0.03


def test_a_wide_hole_gives_its_shadow():
    """Fresnel number 90: uniform light inside the hole's projection, apart from fringes."""
    diameter, depth = 3e-3, 1.0
    shadow = 0.5 * diameter * (1 + FILM / depth)
    radius = np.linspace(0.0, 1.5 * shadow, 600)
    light = intensity(radius, diameter, FILM, depth, WAVE) * radius
    inside = light[radius < shadow].sum()
    assert inside > 0.96 * light.sum()
    half = light[radius < shadow / np.sqrt(2)].sum()
    assert half == pytest.approx(inside / 2, rel=0.04)


def test_a_sampled_pattern_has_the_transfer_function():
    """The pupil limits the band, so that sampling above twice the cutoff frequency is exact."""
    diameter, depth, pitch = 0.26e-3, 10.0, 8e-6
    kernel = fresnel_kernel(diameter, FILM, depth, WAVE, pitch, sub=1)
    frequency = np.linspace(0.0, 0.9 * diameter / (WAVE * FILM), 12)[1:]
    places = (np.arange(kernel.shape[0]) - kernel.shape[0] // 2) * pitch
    measured = np.cos(2 * np.pi * np.outer(frequency, places)) @ kernel.sum(axis=0)
    theory = transfer(frequency, diameter, FILM, depth, WAVE)
    assert np.abs(measured - theory).max() < 0.01


def test_a_small_hole_gives_the_airy_pattern():
    """Fresnel number 0.02: almost constant phase across the hole."""
    diameter, pitch = 0.05e-3, 40e-6
    kernel = fresnel_kernel(diameter, FILM, np.inf, WAVE, pitch)
    airy = airy_kernel((pitch, pitch), WAVE, FILM / diameter, kernel.shape[0] // 2)
    assert np.abs(kernel - airy).max() < 0.01 * airy.max()


def test_fresnel_zones_on_the_axis():
    """On the axis |U|^2 = (lambda v / pi)^2 sin^2(pi F / 2): bright for odd Fresnel numbers, dark for even ones."""
    numbers = np.array([0.5, 1.0, 1.5, 2.0, 3.0])
    holes = 2 * np.sqrt(numbers * WAVE * FILM)
    measured = np.array(
        [
            intensity(np.array([0.0, 1e-6]), hole, FILM, np.inf, WAVE)[0]
            for hole in holes
        ]
    )
    theory = (WAVE * FILM / np.pi) ** 2 * np.sin(np.pi * numbers / 2) ** 2
    assert np.allclose(measured, theory, atol=1e-6 * theory.max())


def test_kernels_are_normalised_and_symmetric():
    kernel = fresnel_kernel(0.3e-3, FILM, 5.0, WAVE, 25e-6)
    assert kernel.sum() == pytest.approx(1.0)
    assert np.allclose(kernel, kernel.T)
    assert np.allclose(kernel, kernel[::-1, ::-1])
    assert np.allclose(convolved(np.full((30, 40), 0.7), kernel), 0.7)
