"""Depth from focus and defocus on composed images: known blur and shifts, and the Cramer-Rao bound."""

import math

import numpy as np
import pytest
from scipy import ndimage

import twinlens as tl
from twinlens.errors import InputError

FX, APERTURE, FOCUS, SIGMA, SIDE, RIM = 400.0, 0.02, 0.5, 0.02, 9, 16


def texture(seed=0, size=(96, 112)):
    white = ndimage.gaussian_filter(
        np.random.default_rng(seed).standard_normal(size), 0.8, mode="wrap"
    )
    return 1.0 + 0.25 * white / white.std()


def transfer(shape, shifts):
    """The factors of a spectrum for the mean of an image's copies moved by (dx, dy), in pixels."""
    dx, dy = np.transpose(shifts)
    across = np.exp(-2j * np.pi * np.outer(dx, np.fft.fftfreq(shape[1])))
    down = np.exp(-2j * np.pi * np.outer(np.fft.fftfreq(shape[0]), dy))
    return down @ across / len(dx)


def moved(image, dx, dy=0.0):
    """The image moved by a number of pixels, periodic."""
    spectrum = np.fft.fft2(image) * transfer(image.shape, [(dx, dy)])
    return np.fft.ifft2(spectrum).real


def through(image, circle, keep=lambda x, y: np.ones(x.shape, bool)):
    """The image blurred by the points of a disk of signed diameter `circle` for which keep(x, y), by summing shifts.

    A point at x of the aperture, in radii, moves the image by -circle x / 2.
    """
    across = (np.arange(28) + 0.5) / 14 - 1
    x, y = np.meshgrid(across, across)
    inside = (x**2 + y**2 < 1) & keep(x, y)
    shifts = -circle / 2 * np.stack([x[inside], y[inside]], axis=1)
    spectrum = np.fft.fft2(image) * transfer(image.shape, shifts)
    return np.fft.ifft2(spectrum).real


def circle(inverse_depth, vergence, diameter=APERTURE):
    return diameter * FX * (inverse_depth - vergence)


def lens(vergence=FOCUS, diameter=APERTURE):
    return tl.ThinLens(diameter, 1 / vergence)


def samples(lens, parts=None):
    points, shares = tl.aperture_points(lens, parts)
    return [tl.ApertureSamples(points, share, lens.vergence) for share in shares]


def blurred(image, w, vergences, diameter=APERTURE):
    """The images of a plane at an inverse depth through one lens at several focuses, and their apertures."""
    images = [through(image, circle(w, k, diameter)) for k in vergences]
    return images, [samples(lens(k, diameter))[0] for k in vergences]


def two_focuses(image, w):
    return blurred(image, w, (0.3, 0.7))


def two_apertures(image, w):
    wide, narrow = blurred(image, w, [0.1]), blurred(image, w, [0.1], APERTURE / 2)
    return wide[0] + narrow[0], wide[1] + narrow[1]


def dual_pixels(image, w):
    sides = (lambda x, y: x < 0), (lambda x, y: x > 0)
    halves = [through(image, circle(w, FOCUS), keep) for keep in sides]
    return halves, samples(lens(), tl.Dual())


def light_field(image, w):
    places = [(a, b) for a in (-0.008, 0, 0.008) for b in (-0.008, 0, 0.008)]
    images = [moved(image, *(-FX * (w - FOCUS) * np.array(place))) for place in places]
    return images, [tl.ApertureSamples([place], vergence=FOCUS) for place in places]


def stereo(image, w):
    images = [moved(image, -FX * w * x) for x in (-0.01, 0.01)]
    return images, [tl.ApertureSamples([[x, 0.0]]) for x in (-0.01, 0.01)]


def focal_stack(image, w):
    return blurred(image, w, np.linspace(0.2, 0.8, 4))


CASES = [two_focuses, two_apertures, dual_pixels, light_field, stereo, focal_stack]


def inner(image):
    return image[RIM:-RIM, RIM:-RIM]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("w", [pytest.param(0.39, marks=pytest.mark.slow), 0.62])
def test_maximum_likelihood_reaches_the_bound(case, w):
    sharp = texture()
    images, apertures = case(sharp, w)
    random = np.random.default_rng(7)
    noisy = [image + SIGMA * random.standard_normal(image.shape) for image in images]
    estimate = tl.inverse_depth_from_defocus(
        noisy, apertures, FX, 1.1, 5.0, steps=20, block_size=SIDE
    )
    bound = tl.inverse_depth_bound(sharp, apertures, FX, w, SIGMA, block_size=SIDE)
    assert estimate.dtype == np.float32
    error = inner((estimate - w) / bound)
    windows = error.size / SIDE**2  # independent ones
    spread = math.sqrt(np.mean(error**2))
    assert spread == pytest.approx(1.0, abs=4 / math.sqrt(2 * windows))


def test_the_bound_of_two_pinholes_is_that_of_a_shift():
    """2 sigma^2 / sum (dI/du)^2, with slopes by differences of a smooth image."""
    # Edges are flat: without a kink where the image is reflected.
    edges = np.sin(np.pi * (np.arange(160) + 0.5) / 160) ** 2
    waves = ndimage.gaussian_filter(texture(3, (160, 160)) - 1.0, 3.0, mode="wrap")
    sharp = 1.0 + waves * edges * edges[:, None]
    slope = 2 * (moved(sharp, -0.25) - moved(sharp, 0.25))
    information = SIDE**2 * ndimage.uniform_filter(slope**2, SIDE)
    expected = math.sqrt(2) * SIGMA / np.sqrt(information) / (FX * 0.02)
    _, apertures = stereo(sharp, 0.5)
    bound = tl.inverse_depth_bound(sharp, apertures, FX, 0.5, SIGMA, block_size=SIDE)
    middle = np.s_[40:-40, 40:-40]
    np.testing.assert_allclose(bound[middle], expected[middle], rtol=0.02)


@pytest.mark.parametrize("w", [0.45, 0.57])
def test_the_sharpest_image_of_a_stack(w):
    """Without noise the fit of a Gaussian is within a tenth of a step, and a wider fit has less noise."""
    vergences = np.linspace(0.1, 0.9, 13)
    stack, _ = blurred(texture(2), w, vergences)
    estimate = tl.inverse_depth_from_focus(stack, vergences)
    step = vergences[1] - vergences[0]
    assert np.median(inner(estimate)) == pytest.approx(w, abs=0.1 * step)
    random = np.random.default_rng(5)
    noisy = [image + SIGMA * random.standard_normal(image.shape) for image in stack]
    narrow, wide = (
        tl.inverse_depth_from_focus(noisy[::-1], vergences[::-1], neighbours=count)
        for count in (1, 3)
    )
    assert np.std(inner(wide) - w) < 0.5 * np.std(inner(narrow) - w)


def test_unknown_at_the_ends_of_the_search():
    images, apertures = dual_pixels(texture(), 0.62)
    estimate = tl.inverse_depth_from_defocus(images, apertures, FX, 2.0, 5.0, steps=16)
    assert np.isposinf(estimate).mean() > 0.9
    vergences = (0.3, 0.5, 0.7)
    stack, _ = blurred(texture(), 0.1, vergences)
    assert np.isposinf(tl.inverse_depth_from_focus(stack, vergences)).all()


def test_what_cannot_be_used_is_refused():
    images, apertures = dual_pixels(texture(), 0.5)
    for arguments, message in [
        ((images[:1], apertures[:1], FX, 1.0), "at least 2 images of one size"),
        ((images, apertures[:1], FX, 1.0), "one for each image, got 1 for 2 images"),
        ((images, [1, 2], FX, 1.0), "apertures must be ApertureSamples"),
        ((images, apertures, 1e6 * FX, 1.0), "the apertures move light by up to"),
        ((images, apertures, FX, 2.0, 1.0), "far must be greater than near"),
    ]:
        with pytest.raises(InputError, match=message):
            tl.inverse_depth_from_defocus(*arguments)
    with pytest.raises(InputError, match="increasing or decreasing"):
        tl.inverse_depth_from_focus([*images, images[0]], [0.1, 0.3, 0.2])
