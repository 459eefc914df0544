"""Denoised images against closed forms and converged images, and guides against the textures they show."""

import functools

import numpy as np
import pytest

import twinlens as tl
from tests.rendering import rendering_photos as photos
from twinlens.rendering import denoising
from twinlens.rendering.build import build
from twinlens.rendering.guides import Guides, render_guides
from twinlens.rendering.images import image_passes, raw_image
from twinlens.rendering.sensors import make_sensor
from twinlens.rendering.views import views_of

CAMERA = photos.camera(64, 48, 60.0)
RIG = photos.rig_of(CAMERA)
SMALL = photos.camera(24, 24, 60.0)
MIDDLE = slice(8, 16), slice(8, 16)
WIDE = tl.ThinLens(0.1, 2.5)


def denoised(scene, lens=tl.Pinhole(), rig=RIG, spp=16, seed=0):  # noqa: B008
    return tl.render(scene, rig, lens, spp=spp, seed=seed, denoise=True)[0]


@pytest.mark.parametrize("name", ["pinhole x", "far"])
def test_a_painted_edge_keeps_its_profile(name):
    """From 16 samples: reflectance 0.8 and 0.1 under a uniform sky, blurred by the lens."""
    row = camera, lens, z, axis, position = photos.EDGES[name]
    rig = photos.rig_of(camera.replace(height=48, cy=23.5))
    image = denoised(photos.painted_edge(z, position), photos.lens_of(lens), rig)
    across, _ = photos.along(image, axis)
    assert np.abs((across - 0.1) / 0.7 - photos.profile(*row)).max() < 0.02


def squared_error(image, reference):
    return np.mean(((image - reference) / (reference + 0.05)) ** 2)


def test_the_error_falls_to_a_fraction():
    """In the mean square, from 2 samples. Neighbouring pixels of a grid share samples: their noise is correlated."""
    scene = photos.room()
    lenses = [tl.Pinhole(), WIDE]
    grid = tl.render_lens_grid(scene, RIG, lenses, spp=2, denoise=True)
    for lens, shared, of_grid in zip(lenses, (None, 0.5), grid, strict=True):
        raw = tl.render(scene, RIG, lens, spp=2, seed=3)[0]
        reference = tl.render(scene, RIG, lens, spp=512, seed=4)[0]
        images = {0.25: denoised(scene, lens, spp=2, seed=3)}
        if shared is not None:
            images[shared] = of_grid[0]
        for share, image in images.items():
            error = squared_error(image, reference)
            assert error < share * squared_error(raw, reference)
            assert np.mean(image) == pytest.approx(np.mean(reference), rel=0.02)


def guides_of(scene, camera=SMALL, passes=(("multijitter", 16, 5),), lens=tl.Pinhole()):  # noqa: B008
    return render_guides(build(scene), camera, photos.POSE, lens, passes)


def guides_of_paths(scene):
    """Guides from the paths of an image."""
    rig = photos.rig_of(SMALL)
    (view,) = views_of({"rgb": scene}, rig, [tl.Pinhole()], 0, denoise=True)
    passes = image_passes(SMALL, 256, 0, 0, "sobol")
    _, guides = raw_image(view, passes, None, lambda _: None)
    return guides


@functools.cache
def traced(name):
    """Guides of a scene of `guided` that are traced apart from the image."""
    return guides_of(photos.guided()[name])


def test_guides_show_the_texture_and_the_normals():
    """A chequered wall, 0.4 and 0.2, that faces the camera: each square exactly, apart from its edges."""
    albedo = traced("wall").albedo[..., 0]
    normal = traced("wall").normal
    inside = np.isclose(albedo, 0.4, atol=1e-4) | np.isclose(albedo, 0.2, atol=1e-4)
    assert inside.mean() > 0.6
    assert 0.25 < np.mean(albedo > 0.3) < 0.75
    expected = np.broadcast_to(-photos.POSE[:3, 2], normal.shape)
    np.testing.assert_allclose(normal, expected, atol=1e-4)


def test_guides_follow_mirrors_and_openings():
    """A mirror of reflectance 0.8 before paint of 0.5, and a half open net of black cloth: nothing is random."""
    mirror = traced("mirror")
    np.testing.assert_allclose(mirror.albedo[MIDDLE], 0.8 * 0.5, atol=1e-4)
    np.testing.assert_allclose(mirror.normal[12, 12], photos.POSE[:3, 2], atol=1e-4)
    np.testing.assert_allclose(traced("net").albedo, 0.5 * 0.5, atol=1e-6)


def test_guides_of_glass_are_weighted_by_fresnel():
    """A pane of index 1.5, that shows black cloth through it and chalk of 0.5 in it, reflects 1/13 of what is normal
    to it: 0.04 at each surface, and once more for each time the light turns round inside."""
    albedo = traced("pane").albedo[MIDDLE]
    np.testing.assert_allclose(albedo, 0.5 / 13, rtol=0.005)
    assert np.ptp(albedo) < 1e-4


@pytest.mark.parametrize(
    ("name", "random_share"),
    [
        ("net", 0.5),
        ("pane", 1),
        pytest.param("wall", 0, marks=pytest.mark.slow),
        pytest.param("mirror", 0, marks=pytest.mark.slow),
        pytest.param("hole", 0, marks=pytest.mark.slow),
    ],
)
def test_paths_find_the_same_guides(name, random_share):
    """In the mean: they choose at random at nets and glass. These are 16,384 paths of a Sobol sequence."""
    guides = guides_of_paths(photos.guided()[name])
    is_random = guides.random_share[MIDDLE].mean()
    np.testing.assert_allclose(is_random, random_share, atol=2e-4)
    for kind in ("albedo", "normal"):
        of_paths = getattr(guides, kind)[MIDDLE].mean((0, 1))
        expected = getattr(traced(name), kind)[MIDDLE].mean((0, 1))
        np.testing.assert_allclose(of_paths, expected, atol=2e-4)


def test_guides_have_the_samples_of_the_image():
    """The share of a pixel's samples that hit a lamp is its brightness and the length of its normal."""
    camera, lens, z, _, x = photos.EDGES["far"]
    scene, lens = photos.half_plane(z, x=x), photos.lens_of(lens)
    built = build(scene)
    sampling = ("multijitter", 4, 6)
    sampler, spp, seed = sampling
    sensor = make_sensor(camera, photos.POSE, lens, spp, sampler)
    image = built.integrator.render(built.mi_scene, sensor, seed=seed, spp=spp)
    lit = np.array(image)[..., 0]
    normal = guides_of(scene, camera, [sampling], lens).normal
    assert np.mean((lit > 0) & (lit < 1)) > 0.1
    np.testing.assert_allclose(normal @ -photos.POSE[:3, 2], lit, atol=1e-5)


def test_values_that_are_not_finite_do_not_spread():
    """A pixel of an even image, and one of its own albedo."""
    even = np.full((48, 64, 3), 0.5, np.float32)
    features = np.array([0.5, 0.5, 0.5, 0, 0, 1, 0, 0, 0, 0])
    means = np.broadcast_to(features, (48, 64, 10)).copy()
    guides = Guides.from_means(means, 1, None)
    for value in (np.inf, np.nan):
        image = even.copy()
        image[20, 30] = value
        result = denoising.denoise_image(image, guides)
        np.testing.assert_allclose(result, even, rtol=0.05)
    means[20, 30] = np.nan
    own_guides = Guides.from_means(means, 1, None)
    result = denoising.denoise_image(even, guides, own_guides)
    changed = np.abs(result - even) > 0.05
    assert changed[18:23, 28:33].sum() == changed.sum()
