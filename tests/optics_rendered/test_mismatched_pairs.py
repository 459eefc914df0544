"""Cameras of one rig with lenses of their own: displaced films, and images through a lens for each camera."""

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    chequered_room,
    disk_diameter,
    grey,
    lamps,
    square_camera,
)
from twinlens.factory import Shoot, make_sample
from twinlens.rendering import render_measured


@pytest.mark.parametrize(
    ("focus", "focus_um", "f_number"),
    [(1.0, 40.0, 1.0), (1.0, -40.0, 1.25), (np.inf, -40.0, 1.0), (np.inf, 60.0, 1.25)],
)
def test_the_blur_disk_of_a_displaced_film(focus, focus_um, f_number):
    """A |v' - v_point| / v_point on the film, by Gauss's lens equation, in the second image of a sample."""
    film, aperture, depth, pitch, light_px = 0.016, 0.005, 2.0, 4e-6, 6.0
    camera = square_camera(41, 4000.0, pixel_pitch_um=1e6 * pitch)
    rig = tl.Rig([camera, camera], [HERE, HERE])
    lens = tl.ThinLens(aperture, focus)
    sensor = tl.Sensor(mismatch=tl.Mismatch(focus_um=focus_um, f_number=f_number))
    lamp = lamps([(0.0, 0.0, depth)], 0.5 * light_px * depth / 4000)
    shoot = Shoot(spp=4096, sensor=sensor, keep_radiance=True)
    sample = make_sample(lamp, rig, [lens], shoot)
    power = 1 / focus + 1 / film
    point = 1 / (power - 1 / depth)
    gaps = (0.0, 1e-6 * focus_um)
    widths = (aperture, aperture / f_number)
    images = sample.shots[0].radiances
    for image, gap, width in zip(images, gaps, widths, strict=True):
        blur = width * abs(film + gap - point) / point / pitch
        assert disk_diameter(grey(image), light_px) == pytest.approx(blur, rel=0.015)
    assert sample.shots[0].lens == lens  # that of the truth
    assert sample.rig is rig


CAMERA = tl.Camera(48, 36, 50.0, 50.0, 23.5, 17.5)
LENS = tl.ThinLens(0.03, 1.0)


@pytest.fixture(scope="module")
def view():
    pair = tl.Rig.stereo(CAMERA, 0.1)
    cameras = [CAMERA, CAMERA.replace(band="rgb+nir")]
    return chequered_room(), tl.Rig(cameras, pair.world_from_cams)


def rendered(scene, rig, lens):
    return tl.render(scene, rig, lens, spp=2, seed=3)


def measured(scene, rig, lens):
    images, _ = render_measured(scene, rig, lens, 4, 3)
    return [image.image for image in images]


@pytest.mark.parametrize("images_of", [rendered, measured])
def test_each_camera_may_have_a_lens_of_its_own(view, images_of):
    """Each image is that of a rig whose cameras all have its lens."""
    sharp, blurred = (images_of(*view, lens) for lens in (tl.Pinhole(), LENS))
    mixed = images_of(*view, [tl.Pinhole(), LENS])
    equal = images_of(*view, [LENS, LENS])
    assert mixed[0].tobytes() == sharp[0].tobytes() != blurred[0].tobytes()
    assert mixed[1].tobytes() == blurred[1].tobytes()
    assert [image.tobytes() for image in equal] == [
        image.tobytes() for image in blurred
    ]
