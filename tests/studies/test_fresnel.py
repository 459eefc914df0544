"""Fresnel's pattern against routes that share no line with it: Hopkins's transfer function, Airy's pattern, shadows."""

import numpy as np
import pytest

from twinlens.optics.diffraction import airy_kernel
from twinlens.studies import pinhole
from twinlens.studies.fresnel import fresnel_kernel, intensity, through_hole, transfer

FILM, WAVE = 0.05, 550e-9


@pytest.mark.parametrize(("diameter", "depth"), [(0.15e-3, np.inf), (0.26e-3, 10.0), (0.6e-3, 2.0)])
def test_the_patterns_transform_is_hopkins_transfer_function(diameter, depth):
    """One integrates the wave to a pattern on pixels; the other overlaps the pupil with itself."""
    pitch = 10e-6
    kernel = fresnel_kernel(diameter, FILM, depth, WAVE, pitch)
    frequency = np.linspace(0.0, 0.7 * diameter / (WAVE * FILM), 12)[1:]
    places = (np.arange(kernel.shape[0]) - kernel.shape[0] // 2) * pitch
    found = np.array([(kernel.sum(axis=0) * np.cos(2 * np.pi * f * places)).sum() for f in frequency])
    theory = transfer(frequency, diameter, FILM, depth, WAVE) * np.sinc(frequency * pitch)
    assert np.abs(found - theory).max() < 0.03


def test_a_small_hole_far_away_is_airys():
    """Fresnel number 0.02: the phase across the hole hardly changes."""
    diameter, pitch = 0.05e-3, 40e-6
    found = fresnel_kernel(diameter, FILM, np.inf, WAVE, pitch)
    airy = airy_kernel((pitch, pitch), WAVE, FILM / diameter, found.shape[0] // 2)
    assert np.abs(found - airy).max() < 0.01 * airy.max()


def test_a_wide_hole_is_its_own_shadow():
    """Fresnel number 90: the light lies inside the hole's projection, evenly but for ripples."""
    diameter, depth = 3e-3, 1.0
    shadow = 0.5 * diameter * (1 + FILM / depth)
    radius = np.linspace(0.0, 1.5 * shadow, 600)
    light = intensity(radius, diameter, FILM, depth, WAVE) * radius
    inside = light[radius < shadow].sum() / light.sum()
    half = light[radius < shadow / np.sqrt(2)].sum() / light[radius < shadow].sum()
    assert inside > 0.96
    assert half == pytest.approx(0.5, abs=0.02)


def test_light_at_the_axis_is_fresnels_zones():
    """On the axis |U|^2 = (lambda v / pi)^2 sin^2(pi F / 2): brightest for odd Fresnel numbers, dark for even ones."""
    numbers = np.array([0.5, 1.0, 1.5, 2.0, 3.0])
    holes = 2 * np.sqrt(numbers * WAVE * FILM)
    found = np.array([intensity(np.array([0.0, 1e-6]), hole, FILM, np.inf, WAVE)[0] for hole in holes])
    theory = (WAVE * FILM / np.pi) ** 2 * np.sin(np.pi * numbers / 2) ** 2
    assert np.allclose(found, theory, atol=1e-6 * theory.max())


def test_kernels_keep_light_and_symmetry():
    kernel = fresnel_kernel(0.3e-3, FILM, 5.0, WAVE, 25e-6)
    assert kernel.sum() == pytest.approx(1.0)
    assert np.allclose(kernel, kernel.T)
    assert np.allclose(kernel, kernel[::-1, ::-1])
    assert np.allclose(through_hole(np.full((30, 40), 0.7), kernel), 0.7)


def test_a_sampled_pattern_transforms_without_the_pixels_box():
    """Band-limited by the pupil, samples of half its cutoff's period are all there is to know."""
    diameter, depth, pitch = 0.26e-3, 10.0, 8e-6
    kernel = fresnel_kernel(diameter, FILM, depth, WAVE, pitch, sub=1)
    frequency = np.linspace(0.0, 0.9 * diameter / (WAVE * FILM), 12)[1:]
    places = (np.arange(kernel.shape[0]) - kernel.shape[0] // 2) * pitch
    found = np.array([(kernel.sum(axis=0) * np.cos(2 * np.pi * f * places)).sum() for f in frequency])
    assert np.abs(found - transfer(frequency, diameter, FILM, depth, WAVE)).max() < 0.01


def test_what_lies_outside_the_rings_is_as_little_as_is_said():
    """Forty rings against a hundred and sixty: 0.5 % of the light, less what is outside of those."""
    diameter, pitch = 0.05e-3, 100e-6
    few = fresnel_kernel(diameter, FILM, np.inf, WAVE, pitch)
    many = airy_kernel((pitch, pitch), WAVE, FILM / diameter, 4 * (few.shape[0] // 2))
    middle = slice(many.shape[0] // 2 - few.shape[0] // 2, many.shape[0] // 2 + few.shape[0] // 2 + 1)
    assert 0.002 < 1.0 - many[middle, middle].sum() < 0.006


def test_theorys_best_hole_lies_between_the_rules_of_thumb_and_a_bit_below():
    """Rayleigh's rule is for a point seen by eye; MTF50 asks for less detail, and the pixel takes its part."""
    assert pinhole.AIRY_MM * 0.85 < pinhole.theoretical_best(0.5) < pinhole.AIRY_MM
    assert pinhole.AIRY_MM < pinhole.theoretical_best(0.1) < pinhole.RAYLEIGH_MM
