"""What a lens does to light is the same in denoised images: edges, blur disks, and the agreement of two eyes."""

import numpy as np
import pytest

from tests.rendering import rendering_photos as photos

pytestmark = pytest.mark.slow


@pytest.fixture
def found(renderer):
    return renderer("denoised optics")


@pytest.mark.parametrize("name", photos.SLANTED_LENSES)
def test_a_slanted_edge_keeps_its_sharpness(found, name):
    """MTF50 of the mean of 96 images, against the closed form: a step, spread evenly over a disk and averaged over each
    pixel. Noise alone changes the MTF50 of a single image by 2 to 4 %, also without denoising; that of the mean of 96
    by 0.2 to 0.4 %."""
    image = found[f"slanted/{name}"].mean(axis=-1)
    blur = lens_blur(*photos.SLANTED_LENSES[name], photos.SLANTED_Z, 60.0)
    assert mtf50(image) == pytest.approx(mtf50(slanted_edge(blur)), rel=0.02)


def test_a_blur_disk_has_the_diameter_of_the_law(found):
    """From the mean squared distance to the centre: (c^2 + d^2) / 8 for a light imaged to a disk d wide, and 1/6 for
    the area of a pixel."""
    camera, lens, z, radius = photos.DISK
    image = found["disk"].mean(axis=-1)
    y, x = np.mgrid[: camera.height, : camera.width]
    squares = np.average((x - camera.cx) ** 2 + (y - camera.cy) ** 2, weights=image)
    diameter = np.sqrt(8 * (squares - 1 / 6) - (2 * radius * camera.fx / z) ** 2)
    assert diameter == pytest.approx(lens_blur(*lens, z, camera.fx), rel=0.01)


def test_a_blur_disk_keeps_its_light(found):
    """Its sum over the image, within 2 %."""
    assert found["disk"].sum() == pytest.approx(found["disk/raw"].sum(), rel=0.02)


def test_two_eyes_do_not_agree_better_than_converged_images(found):
    """The right image, taken where the left pixels are seen, minus the left one; mean over eight pairs. Removed texture
    would lower it. A single pair's residual varies by 3 %."""
    denoised, reference = (
        np.mean([residual(found, pair) for pair in found[f"pair/{name}"]])
        for name in ("denoised", "reference")
    )
    assert reference < denoised
    assert denoised < 2 * reference


def lens_blur(diameter, focus, z, fx):
    return diameter * fx * abs(1 / z - 1 / focus)


def across(x, y):
    """Signed distance from the edge, px, in a picture 64 px wide."""
    return (x - 31.5) * np.cos(photos.SLANT) - (y - 31.5) * np.sin(photos.SLANT)


def slanted_edge(blur):
    """From reflectance 0.8 to 0.1; pixels averaged over 16x16 points."""
    fine = (np.arange(64 * 16) + 0.5) / 16 - 0.5
    s = np.clip(-across(*np.meshgrid(fine, fine)) / (blur / 2), -1, 1)
    share = 0.5 + (np.arcsin(s) + s * np.sqrt(1 - s * s)) / np.pi
    return 0.1 + 0.7 * share.reshape(64, 16, 64, 16).mean(axis=(1, 3))


def mtf50(image):
    """Cycles per pixel at which the contrast falls to one half: spectrum of the edge's slope in bins of 1/4 px."""
    y, x = np.mgrid[:64, :64]
    place = across(x, y)
    inside = np.abs(place) < 14
    bins = np.floor(4 * (place[inside] + 14)).astype(int)
    edge = np.bincount(bins, image[inside]) / np.bincount(bins)
    slope = np.diff(edge)
    spectrum = np.abs(np.fft.rfft(slope, 8192))
    first = np.argmax(spectrum < 0.5 * spectrum[0])
    return np.fft.rfftfreq(8192, 0.25)[first]


def residual(found, pair):
    left, right = pair.mean(axis=-1)
    rows, columns = np.nonzero(found["visible"] & np.isfinite(found["disparity"]))
    seen = columns - found["disparity"][rows, columns]
    inside = (seen >= 0) & (seen <= left.shape[1] - 1)
    rows, columns, seen = rows[inside], columns[inside], seen[inside]
    before = np.minimum(seen.astype(int), left.shape[1] - 2)
    part = seen - before
    warped = (1 - part) * right[rows, before] + part * right[rows, before + 1]
    return np.sqrt(np.mean((warped - left[rows, columns]) ** 2))
