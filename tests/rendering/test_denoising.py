"""Denoised images against closed forms and converged images, and guides against the textures they show."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.rendering import rendering_photos as photos
from tests.rendering.test_render import profile, seen
from twinlens.rendering import backend, denoising
from twinlens.rendering.guides import Guides

backend()
import mitsuba_oidn  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

MIDDLE = slice(8, 16), slice(8, 16)


@pytest.fixture
def found(renderer):
    return renderer("denoise")


def test_a_uniform_sky_stays_uniform(found):
    np.testing.assert_allclose(found["sky"], 0.3, rtol=0.03)
    assert found["sky"].mean() == pytest.approx(0.3, rel=0.003)


@pytest.mark.parametrize("name", ["pinhole x", "far"])
def test_a_painted_edge_keeps_its_profile(found, name):
    """From 16 samples: reflectance 0.8 and 0.1 under a uniform sky, blurred by the lens."""
    row = photos.EDGES[name]
    across, _ = seen(found[f"edge/{name}"], row[3])
    assert np.abs((across - 0.1) / 0.7 - profile(*row)).max() < 0.02


def squared_error(image, reference):
    return np.mean(((image - reference) / (reference + 0.05)) ** 2)


@pytest.mark.parametrize(
    ("lens", "kind", "share"),
    [("pinhole", "denoised", 0.25), ("lens", "denoised", 0.25), ("lens", "grid", 0.5)],
)
def test_the_error_falls_to_a_fraction(found, lens, kind, share):
    """In the mean square, from 2 samples. Neighbouring pixels of a grid share samples: their noise is correlated."""
    denoised, raw, reference = (
        found[f"{lens}/{name}"] for name in (kind, "raw", "reference")
    )
    assert squared_error(denoised, reference) < share * squared_error(raw, reference)
    assert np.mean(denoised) == pytest.approx(np.mean(reference), rel=0.02)


def test_the_raw_image_does_not_change(found):
    np.testing.assert_array_equal(found["pinhole/raw"], found["pinhole/raw by default"])


def test_eyes_and_seeds_have_guides_of_their_own(found):
    left, right, other_seed = found["own guides"]
    assert not np.array_equal(left, right)
    assert not np.array_equal(left, other_seed)


def test_bytes_do_not_depend_on_threads(found):
    np.testing.assert_array_equal(found["threads 1"], found["threads 3"])


def test_guides_show_the_texture_and_the_normals(found):
    """A chequered wall, 0.4 and 0.2, that faces the camera: each square exactly, apart from its edges."""
    albedo, normal = found["guide/wall/albedo"][..., 0], found["guide/wall/normal"]
    inside = np.isclose(albedo, 0.4, atol=1e-4) | np.isclose(albedo, 0.2, atol=1e-4)
    assert inside.mean() > 0.6
    assert 0.25 < np.mean(albedo > 0.3) < 0.75
    expected = np.broadcast_to(-photos.POSE[:3, 2], normal.shape)
    np.testing.assert_allclose(normal, expected, atol=1e-4)


def test_guides_follow_mirrors_and_openings(found):
    """A mirror of reflectance 0.8 before paint of 0.5, and a half open net of black cloth: nothing is random."""
    mirror = found["guide/mirror/albedo"][MIDDLE]
    np.testing.assert_allclose(mirror, 0.8 * 0.5, atol=1e-4)
    np.testing.assert_allclose(found["guide/net/albedo"], 0.5 * 0.5, atol=1e-6)
    normal = found["guide/mirror/normal"][MIDDLE][0, 0]
    np.testing.assert_allclose(normal, photos.POSE[:3, 2], atol=1e-4)


def test_guides_of_glass_are_weighted_by_fresnel(found):
    """A pane of index 1.5, that shows black cloth through it and chalk of 0.5 in it, reflects 1/13 of what is normal
    to it: 0.04 at each surface, and once more for each time the light turns round inside."""
    albedo = found["guide/pane/albedo"][MIDDLE]
    np.testing.assert_allclose(albedo, 0.5 / 13, rtol=0.005)
    assert np.ptp(albedo) < 1e-4


def test_paths_find_the_same_guides(found):
    """In the mean: they choose at random at nets and glass. These are 16,384 paths of a Sobol sequence."""
    random_shares = {"wall": 0, "mirror": 0, "net": 0.5, "hole": 0, "pane": 1}
    for name, share in random_shares.items():
        is_random = found[f"path guide/{name}/random"][MIDDLE].mean()
        np.testing.assert_allclose(is_random, share, atol=2e-4)
        for kind in ("albedo", "normal"):
            of_paths, expected = (
                found[f"{guide}/{name}/{kind}"][MIDDLE].mean((0, 1))
                for guide in ("path guide", "guide")
            )
            np.testing.assert_allclose(of_paths, expected, atol=2e-4)


def test_guides_do_not_depend_on_passes(found):
    in_passes = found["guide/net/in passes"]
    np.testing.assert_allclose(in_passes, found["guide/net/albedo"], atol=1e-6)


def test_guides_have_the_samples_of_the_image(found):
    """The share of a pixel's samples that hit a lamp is its brightness and the length of its normal."""
    assert np.mean((found["lamp/image"] > 0) & (found["lamp/image"] < 1)) > 0.1
    np.testing.assert_allclose(found["lamp/normal"], found["lamp/image"], atol=1e-5)


def squares(dark, light):
    """A texture (90, 120, 3) of squares of 5 pixels."""
    rows, columns = np.mgrid[:90, :120]
    is_dark = (rows // 5 + columns // 5) % 2
    texture = np.where(is_dark, dark, light).astype(np.float32)
    return texture[..., None].repeat(3, axis=2)


def normal_noise(shape):
    return np.random.default_rng(0).normal(0, 0.2, shape).astype(np.float32)


def test_a_lamp_does_not_change_the_texture_around_it():
    """Squares beside a lamp that is 1,000 times as bright, after a filter that has blurred neither."""
    texture = squares(0.7, 0.9)
    image = texture.copy()
    image[40:50, 55:65] = 1000.0
    noise = np.random.default_rng(0).exponential(1.0, texture.shape).astype(np.float32)
    restored = denoising._with_lost_texture(image, noise * image, texture)
    np.testing.assert_allclose(restored, image, rtol=0.05)


def test_most_of_the_texture_that_a_filter_blurred_is_restored():
    """Squares of 5 pixels, blurred by 0.6 pixels, and noise of a fifth of the brightness in what was filtered."""
    texture = squares(0.4, 0.9)
    light = (1 + np.arange(120) / 120).astype(np.float32)[:, None]
    noisy = light * (texture + normal_noise(texture.shape))
    blurred = light * gaussian_filter(texture, (0.6, 0.6, 0))
    restored = denoising._with_lost_texture(blurred, noisy, texture)
    errors = [np.mean((image - light * texture) ** 2) for image in (restored, blurred)]
    assert errors[0] < 0.25 * errors[1]


def test_an_image_without_texture_is_not_changed_by_its_noise():
    flat = np.full((48, 64, 3), 0.5, np.float32)
    noisy = flat + normal_noise(flat.shape)
    restored = denoising._with_lost_texture(flat, noisy, 0.7 * np.ones_like(flat))
    np.testing.assert_allclose(restored, flat, atol=1e-3)


def test_values_that_are_not_finite_do_not_spread():
    """A pixel of an even image, and one of its own albedo."""
    even = np.full((48, 64, 3), 0.5, np.float32)
    means = np.broadcast_to(np.array([0.5, 0.5, 0.5, 0, 0, 1, 0]), (48, 64, 7)).copy()
    guides = Guides.from_means(means, 1, None)
    for value in (np.inf, np.nan):
        image = even.copy()
        image[20, 30] = value
        denoised = denoising.denoise_image(image, guides)
        np.testing.assert_allclose(denoised, even, rtol=0.05)
    means[20, 30] = np.nan
    own_guides = Guides.from_means(means, 1, None)
    denoised = denoising.denoise_image(even, guides, own_guides)
    changed = np.abs(denoised - even) > 0.05
    assert changed[18:23, 28:33].sum() == changed.sum()


def test_the_processor_denoises_where_the_gpu_is_not_supported(monkeypatch):
    def no_gpu(kind):
        if kind == mitsuba_oidn.DeviceType.CUDA:
            raise mitsuba_oidn.Error("unsupported device type: CUDA")
        return device(kind)

    device = mitsuba_oidn.Device
    monkeypatch.setattr(mitsuba_oidn, "Device", no_gpu)
    monkeypatch.setattr(denoising, "backend", lambda: SimpleNamespace(name="cuda"))
    denoising._device.cache_clear()
    assert denoising.denoiser_record()["device"] == "cpu"
    denoising._device.cache_clear()
