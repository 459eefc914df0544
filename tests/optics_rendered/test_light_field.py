"""Light fields: views are pinholes on the aperture, their disparity is exact, and refocusing gives the lens's image."""

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    chequered_room,
    wall_of,
)
from twinlens.camera.layouts import grid
from twinlens.errors import InputError

CAMERA = tl.Camera(48, 36, 50.0, 50.0, 23.5, 17.5)
LENS = tl.ThinLens(0.09, 2.0)


@pytest.mark.parametrize(
    "lens", [LENS, tl.ThinLens(0.05, np.inf), tl.BareAperture(0.02, 0.5)]
)
@pytest.mark.parametrize("depth", [1.0, 3.0])
def test_disparity_of_a_plane_follows_from_the_aperture(lens, depth):
    """Between neighbours in x and in y: f A/n (1/Z - k), to 1e-4 px, from the truth of the renderer."""
    n = 3
    scene = wall_of({"type": "diffuse"}, depth)
    rig = tl.light_field_rig(CAMERA, lens, n)
    expected = 50.0 * lens.aperture_diameter / n * (1 / depth - lens.vergence)
    truth = tl.ground_truth(scene, rig.pair(3, 4))[0].disparity
    np.testing.assert_allclose(truth[np.isfinite(truth)], expected, rtol=0, atol=1e-4)
    assert np.isfinite(truth).mean() > 0.9
    for neighbour, step in ((5, (1.0, 0.0)), (7, (0.0, 1.0))):
        pixels = tl.correspondence(scene, rig, 4, neighbour).pixels
        v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
        finite = np.isfinite(pixels).all(axis=-1)
        shift = np.stack([u, v], axis=-1)[finite] - pixels[finite]
        np.testing.assert_allclose(
            shift,
            np.broadcast_to(np.multiply(step, expected), shift.shape),
            rtol=0,
            atol=1e-4,
        )
        assert finite.mean() > 0.9


def test_points_in_focus_have_equal_pixels_in_all_views():
    rig = tl.light_field_rig(CAMERA, LENS, 4)
    pixels = [rig.project(i, [0.3, -0.2, LENS.focus_distance]) for i in range(len(rig))]
    np.testing.assert_allclose(pixels, np.broadcast_to(pixels[0], (16, 2)), atol=1e-12)


def test_refocusing_equals_a_naive_sum_over_the_views_of_a_ramp():
    """On a ramp, which splines reproduce: each view moved by fx (k' - k) a, weighted by its cell's light."""
    rig = tl.light_field_rig(CAMERA, LENS, 5)
    n = 5
    target = tl.ThinLens(0.06, 1.5)
    rng = np.random.default_rng(0)
    level = rng.uniform(1, 2, n * n)
    slope = rng.uniform(-0.01, 0.01, (n * n, 2))
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    views = [level[i] + slope[i, 0] * u + slope[i, 1] * v for i in range(n * n)]
    x, y = 0.03 * rng.uniform(-1, 1, (2, 400_000))
    inside = np.hypot(x, y) <= 0.03
    column, row = (
        np.clip(np.rint(p[inside] * n / 0.09 + 2), 0, 4).astype(int) for p in (x, y)
    )
    weights = np.bincount(row * n + column, minlength=n * n) / inside.sum()
    expected = 0.0
    for i in range(n * n):
        ax = 0.09 / n * (i % n - 2)
        ay = 0.09 / n * (i // n - 2)
        du, dv = (50.0 * (1 / 1.5 - 1 / 2.0) * a for a in (ax, ay))
        expected = expected + weights[i] * (
            level[i] + slope[i, 0] * (u - du) + slope[i, 1] * (v - dv)
        )
    refocused = tl.refocus(views, rig, target)
    np.testing.assert_allclose(refocused[8:-8, 8:-8], expected[8:-8, 8:-8], atol=2e-3)


SHAPES = (tl.Polygon(5), tl.Annulus(0.5))
SLOW_SHAPES = (pytest.param(shape, marks=pytest.mark.slow) for shape in SHAPES)


@pytest.mark.parametrize("aperture", [tl.Disk(), *SLOW_SHAPES])
def test_refocused_views_equal_the_lens(aperture):
    """9 x 9 views at their own focus against the traced lens, in a room with sharp edges."""
    scene = chequered_room()
    lens = tl.ThinLens(0.04, 2.5, aperture)
    views = tl.render(scene, tl.light_field_rig(CAMERA, lens, 9), spp=16, seed=1)
    traced = tl.render(scene, tl.Rig([CAMERA], [HERE]), lens, spp=1024, seed=2)[0]
    assert (
        psnr(tl.refocus(views, tl.light_field_rig(CAMERA, lens, 9), lens), traced) >= 38
    )


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """In dB; the peak is the reference's largest value."""
    return float(
        10
        * np.log10(
            reference.max() ** 2 / np.mean((image.astype(float) - reference) ** 2)
        )
    )


def test_a_camera_array_is_a_synthetic_aperture():
    """Parallel cameras with equal principal points, refocused at a wall: every view moves by its disparity."""
    rig = grid(CAMERA, 3, 3, 0.03, 0.03)
    u = np.arange(CAMERA.width, dtype=float)[None, :] + np.zeros((CAMERA.height, 1))
    views = [
        u + 50.0 * pose[0, 3] / 1.5 for pose in rig.world_from_cams
    ]  # texture of a wall at 1.5 m
    refocused = tl.refocus(
        [np.sin(view) for view in views], rig, tl.ThinLens(0.09, 1.5)
    )
    expected = np.sin(u + 50.0 * 0.03 / 1.5)
    np.testing.assert_allclose(refocused[:, 8:-8], expected[:, 8:-8], atol=0.02)


def test_what_has_no_light_field_is_refused():
    distorted = CAMERA.replace(distortion=tl.BrownConrady(k1=0.1))
    for camera, lens, message in (
        (CAMERA, tl.Pinhole(), "a pinhole has none"),
        (distorted, LENS, "without lens distortion"),
    ):
        with pytest.raises(InputError, match=message):
            tl.light_field_rig(camera, lens, 3)
    rig = tl.light_field_rig(CAMERA, LENS, 3)
    images = [np.zeros((36, 48))] * 9
    wide = LENS.replace(aperture_diameter=0.1)
    for views, lens, message in (
        (images[:8], LENS, "needs 9 images of 48x36 pixels, got 8"),
        (images, wide, "larger than the light field's views reach"),
    ):
        with pytest.raises(InputError, match=message):
            tl.refocus(views, rig, lens)
