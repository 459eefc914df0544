"""Rendered light on a sensor: brightness over stops, flat fields, and the first dark ring of the Airy pattern."""

import math

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    chequered_room,
    grey,
    lamps,
    sky,
    square_camera,
)
from twinlens.camera.film import diffract
from twinlens.sensor import Exposure

SENSOR = tl.Sensor(
    quantum_efficiency=(1.0, 1.0, 1.0), full_well=1e6, read_noise=0.0, dark_current=0.0, prnu=0.0, dsnu=0.0,
    adc_bits=16, black_level=0.0, output="linear", bits=16, white_balance=False, vignetting=False,
)  # fmt: skip


def test_brightness_is_proportional_to_the_square_of_the_aperture_over_8_stops():
    """A room rendered from f/2 to f/32; each mean is within 1% of A^2.

    Three standard errors are included, estimated from four images per stop.
    """
    camera = square_camera(48, 60.0)
    rig, room = tl.Rig([camera], [HERE]), chequered_room()
    widest = camera.film_distance / 2
    exposure = None
    brightness = []
    for stop in range(9):
        lens = tl.ThinLens(widest / 2 ** (0.5 * stop), 2.5)
        pictures = [
            tl.render(room, rig, lens, spp=64, seed=4 * stop + take)[0]
            for take in range(4)
        ]
        if exposure is None:
            brightest = SENSOR.electrons_per_radiance(camera, lens).max() * max(
                map(np.max, pictures)
            )
            exposure = Exposure(0.9 * SENSOR.full_well / brightest)
        photos = [
            SENSOR.expose(
                picture,
                camera=camera,
                lens=lens,
                seed=4 * stop + take,
                exposure=exposure,
            ).image
            for take, picture in enumerate(pictures)
        ]
        assert max(map(np.max, photos)) < 65535
        brightness.append(np.mean(photos, axis=(1, 2, 3)) / lens.aperture_diameter**2)
    relative = np.array(brightness) / np.mean(brightness)
    error = math.sqrt(relative.var(axis=1, ddof=1).mean() / 4)
    assert np.abs(relative.mean(axis=1) - 1).max() + 3 * error < 0.01, (
        relative.mean(axis=1),
        error,
    )


def test_photon_transfer_on_a_rendered_sky_gives_the_gain():
    """Variance over mean of images of a uniform sky, at ten exposure times: the system gain, within 2%."""
    camera = square_camera(200, 400.0)
    sensor = SENSOR.replace(
        full_well=9000.0,
        read_noise=3.0,
        adc_bits=12,
        black_level=100.0,
        filters="mono",
        output="raw",
    )
    lens = tl.ThinLens(camera.film_distance / 4, 2.0)
    flat = tl.render(sky(), tl.Rig([camera], [HERE]), lens, spp=4, seed=0)[0]
    fills = SENSOR.electrons_per_radiance(camera, lens).sum()
    mean, variance = [], []
    for i, level in enumerate(np.linspace(0.02, 0.7, 10)):
        exposure = Exposure(level * sensor.full_well / fills)
        a, b = (
            sensor.expose(
                flat, camera=camera, lens=lens, seed=2 * i + j, exposure=exposure
            ).image.astype(np.float64)
            for j in (0, 1)
        )
        mean.append(0.5 * (a.mean() + b.mean()))
        variance.append(0.5 * (a - b).var())
    gain = np.polyfit(mean, variance, 1, w=1 / np.array(variance))[0]
    assert gain == pytest.approx((2**12 - 1 - 100) / 9000, rel=0.02)


@pytest.mark.parametrize("f_number", [16.0, 24.0])
def test_the_first_dark_ring_of_a_rendered_point(f_number):
    """A light of half a pixel in focus, rendered and diffracted: its ring is at 1.22 lambda v/A within 2%."""
    camera = square_camera(161, 4000.0, pixel_pitch_um=1.0)
    lens = tl.ThinLens(camera.film_distance / f_number, 2.0)
    star = lamps([(0.0, 0.0, 2.0)], 0.25 * 2.0 / camera.fx, radiance=1e4)
    sharp = tl.render(star, tl.Rig([camera], [HERE]), lens, spp=256, seed=0)[0]
    assert np.count_nonzero(grey(sharp)) == 1
    blurred = diffract(sharp, camera, lens)
    v, u = np.mgrid[:161, :161]
    radius = np.hypot(u - camera.cx, v - camera.cy)
    for channel, wavelength in enumerate((611e-9, 549e-9, 464e-9)):
        expected = 1.22 * wavelength * f_number / 1e-6
        near = np.abs(radius / expected - 1) < 0.15
        fit = np.polynomial.Polynomial.fit(radius[near], blurred[..., channel][near], 4)
        line = np.linspace(0.88, 1.12, 2401) * expected
        lowest = line[np.argmin(fit(line))]
        assert lowest == pytest.approx(expected, rel=0.02)
        assert fit(lowest) < 0.01 * blurred[..., channel].max()


def test_a_bare_aperture_and_a_lens_pass_equal_light():
    """A bare aperture and a lens of the same diameter and film distance collect equal light from a uniform sky.

    Within (A/2v)^2 = 1%, the error of the paraxial formula at A/v = 1/5.
    """
    camera = square_camera(16, 100.0)
    rig = tl.Rig([camera], [HERE])
    photos = []
    for lens in (tl.ThinLens(1e-4, 1.0), tl.BareAperture(1e-4, camera.film_distance)):
        radiance = tl.render(sky(), rig, lens, spp=4, seed=0)[0]
        assert radiance == pytest.approx(1.0, rel=1e-5)
        exposure = Exposure(
            0.5 * SENSOR.full_well / SENSOR.electrons_per_radiance(camera, lens).max()
        )
        photos.append(
            SENSOR.replace(shot_noise=False).expose(
                radiance, camera=camera, lens=lens, exposure=exposure
            )
        )
    assert math.isclose(
        photos[0].record["time_s"] * 1.01, photos[1].record["time_s"], rel_tol=1e-9
    )
    assert np.array_equal(photos[0].image, photos[1].image)
