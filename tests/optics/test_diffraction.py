"""The Airy kernel against numerical integrals, and the limits of the model against Fresnel's integral."""

import math
import warnings

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.special import j1

from twinlens.camera import Annulus, BareAperture, Camera, Pinhole, ThinLens
from twinlens.camera.film import diffract
from twinlens.errors import InputError
from twinlens.optics import diffraction as df

CAMERA = Camera(64, 48, 700.0, 700.0, 31.5, 23.5, pixel_pitch_um=3.0)
SHARP = ThinLens(CAMERA.film_distance / 16, focus_distance=1.0)


def airy(x: float, y: float, wavelength: float, f_number: float) -> float:
    """Irradiance, W/m^2, of a point light of one watt."""
    t = math.pi * math.hypot(x, y) / (wavelength * f_number)
    return (
        math.pi
        / 4
        / (wavelength * f_number) ** 2
        * ((2 * j1(t) / t) ** 2 if t else 1.0)
    )


@pytest.mark.parametrize("pitch", [(2e-6, 2e-6), (6e-6, 4e-6)])
def test_a_kernel_value_is_the_integral_over_a_pixel(pitch):
    """Against adaptive quadrature; all values have the same factor, which compensates for the tail."""
    wavelength, f_number = 550e-9, 5.6
    kernel = df.airy_kernel(pitch, wavelength, f_number, 40)
    kept = []
    for i, j in [(0, 0), (1, 0), (0, 1), (2, 3)]:
        x, y = i * pitch[0], j * pitch[1]
        brute, _ = dblquad(
            lambda b, a: airy(a, b, wavelength, f_number),
            *(x - pitch[0] / 2, x + pitch[0] / 2),
            *(y - pitch[1] / 2, y + pitch[1] / 2),
            epsrel=1e-6,
        )
        kept.append(brute / kernel[40 + j, 40 + i])
    assert kept == pytest.approx([kept[0]] * 4, rel=2e-5)
    assert 0.99 < kept[0] < 1


@pytest.mark.parametrize("f_number", [0.5, 4.0, 64.0])
@pytest.mark.parametrize("radius", [0, 3, 60])
def test_the_kernel_has_sum_one_and_is_symmetric(f_number, radius):
    kernel = df.airy_kernel((3e-6, 3e-6), 500e-9, f_number, radius)
    assert kernel.shape == (2 * radius + 1, 2 * radius + 1)
    assert abs(kernel.sum() - 1) < 1e-12
    assert (kernel >= 0).all()
    for turned in (kernel.T, kernel[::-1], kernel[:, ::-1]):
        assert turned == pytest.approx(kernel, abs=1e-14)


def test_the_light_outside_the_kernel_is_at_most_the_tail():
    wavelength, f_number, pitch = 500e-9, 11.0, 4e-6
    radius = df.kernel_radius_px((pitch, pitch), wavelength, f_number, tail=0.01)
    outside = 1 - df.encircled_energy(radius * pitch / (wavelength * f_number))
    assert 0.005 < outside <= 0.0105


def test_encircled_energy_equals_rayleighs():
    """83.8%, 91.0% and 93.8% within the first three dark rings: Born and Wolf, section 8.5.2."""
    zeros = np.array([3.83171, 7.01559, 10.17347]) / math.pi
    assert df.encircled_energy(zeros) == pytest.approx([0.838, 0.910, 0.938], abs=1e-3)


def test_a_point_of_light_gives_the_kernel_of_each_colour():
    image = np.zeros((48, 64, 3), np.float32)
    image[24, 32] = [1, 2, 3]
    blurred = diffract(image, CAMERA, SHARP)
    assert blurred.dtype == np.float32
    widths = []
    for c, wavelength in enumerate(df.CHANNEL_WAVELENGTHS):
        kernel = df.airy_kernel(
            (3e-6, 3e-6),
            wavelength,
            16.0,
            min(df.kernel_radius_px((3e-6, 3e-6), wavelength, 16), 64),
        )
        middle = len(kernel) // 2
        assert blurred[20:29, 28:37, c] == pytest.approx(
            kernel[middle - 4 : middle + 5, middle - 4 : middle + 5] * (c + 1),
            rel=0.01,
            abs=1e-5,
        )
        widths.append(1 / kernel.max())
    assert widths == sorted(widths, reverse=True)


def test_diffraction_conserves_light():
    """With reflection at the borders a uniform image does not change, and every image keeps its sum."""
    image = np.random.default_rng(0).random((48, 64, 3)).astype(np.float32)
    light, kept = (
        picture.sum(axis=(0, 1), dtype=float)
        for picture in (image, diffract(image, CAMERA, SHARP))
    )
    assert kept == pytest.approx(light, rel=1e-6)
    assert diffract(np.full_like(image, 0.7), CAMERA, SHARP) == pytest.approx(
        0.7, rel=1e-6
    )


def test_a_bare_aperture_uses_its_own_film_distance():
    """A pixel is v/fx wide: the pattern in pixels does not depend on v."""
    image = np.zeros((48, 64, 3), np.float32)
    image[24, 32] = 1
    near, far = (diffract(image, CAMERA, BareAperture(20e-6, v)) for v in (0.05, 0.2))
    assert near == pytest.approx(far, abs=1e-6)


@pytest.mark.parametrize(
    ("number", "warns"), [(0.1, False), (1.0, True), (30.0, True), (200.0, False)]
)
def test_a_bare_aperture_warns_at_intermediate_fresnel_numbers(number, warns):
    hole = BareAperture(2 * math.sqrt(number * 549e-9 * 0.05), 0.05)
    assert df.fresnel_number(hole.diameter, 549e-9, 0.05) == pytest.approx(number)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        diffract(np.ones((48, 64, 3)), CAMERA, hole)
    assert [w.category for w in caught] == [df.FresnelWarning] * warns


WHITE, NAN = np.ones((48, 64, 3)), math.nan
PITCH = (1e-6, 1e-6)
WAVES = "three positive numbers of metres"


@pytest.mark.parametrize(
    ("call", "arguments", "says"),
    [
        (df.airy_kernel, ((0.0, 1e-6), 5e-7, 8.0, 3), "positive"),
        (df.airy_kernel, ((1e-6, NAN), 5e-7, 8.0, 3), "positive"),
        (df.airy_kernel, (PITCH, -1.0, 8.0, 3), "positive"),
        (df.airy_kernel, (PITCH, "5e-7", 8.0, 3), "positive"),
        (df.airy_kernel, (PITCH, 5e-7, NAN, 3), "positive"),
        *[
            (df.airy_kernel, (PITCH, 5e-7, 8.0, radius), "radius_px")
            for radius in (-1, 1.5, NAN, None, True, 10**9)
        ],
        (df.kernel_radius_px, (PITCH, 0.0, 8.0), "wavelength"),
        (df.kernel_radius_px, (PITCH, 5e-7, NAN), "working_f_number"),
        (df.kernel_radius_px, (PITCH, 5e-7, 0.0), "working_f_number"),
        (df.kernel_radius_px, (PITCH, 5e-7, 8.0, 0.0), "tail"),
        (df.fresnel_number, (1e-3, 5e-7, 0.0), "distance"),
        (diffract, (WHITE, CAMERA, Pinhole()), "zero width"),
        (diffract, (WHITE, CAMERA, ThinLens(0.0, 1.0)), "zero width"),
        (diffract, (WHITE, CAMERA, ThinLens(1e-3, 1.0, Annulus(0.5))), "annulus"),
        (diffract, (WHITE[..., 0], CAMERA, SHARP), "shape"),
        (diffract, (NAN * WHITE, CAMERA, SHARP), "finite"),
        (diffract, (-WHITE, CAMERA, SHARP), ">= 0"),
        (diffract, (WHITE.astype(str), CAMERA, SHARP), "numbers"),
        (diffract, (WHITE.astype(complex), CAMERA, SHARP), "real numbers"),
        (diffract, (None, CAMERA, SHARP), "numbers"),
        (diffract, ([[1.0], [1.0, 2.0]], CAMERA, SHARP), "unequal"),
        *[
            (diffract, (WHITE, CAMERA, SHARP, waves), WAVES)
            for waves in ((5e-7,) * 2, (5e-7,) * 4, (NAN,) * 3, (0.0,) * 3, 5e-7, None)
        ],
    ],
)
def test_invalid_arguments_raise_in_one_line(call, arguments, says):
    with pytest.raises(InputError, match=says) as refusal:
        call(*arguments)
    assert "\n" not in str(refusal.value)
