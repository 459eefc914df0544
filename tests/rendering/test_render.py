"""Images against closed forms of light, against Mitsuba's own cameras, and against themselves."""

import math

import numpy as np
import pytest

import twinlens as tl
from tests.rendering import rendering_photos as photos
from twinlens.rendering import samplers
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import build

LENS = tl.ThinLens(0.3, 1.0)


@pytest.mark.parametrize("name", photos.EDGES)
def test_a_blurred_edge_has_the_expected_position_and_width(name):
    """To a hundredth of a pixel, so that no half pixel, sign or factor of two can hide; off-centre and tall too."""
    row = camera, lens, z, axis, position = photos.EDGES[name]
    scene = photos.half_plane(z, **{axis: position})
    rig, lens = photos.rig_of(camera), photos.lens_of(lens)
    image = tl.render(scene, rig, lens, spp=1024, seed=1)[0]
    across, spread = photos.along(image, axis)
    expected = photos.profile(*row)
    assert expected.min() < 0.02
    assert expected.max() > 0.98
    assert np.abs(across - expected).max() < 0.01
    assert spread < 0.05


def mitsubas(scene, camera, lens, spp, seed) -> np.ndarray:
    """The scene through `thinlens` or `perspective`, as Mitsuba's manual has them; the camera must be centred."""
    mi = mitsuba()
    eye, ahead, down = (photos.POSE[:3, column] for column in (3, 2, 1))
    pose = mi.ScalarTransform4f().look_at(origin=eye, target=eye + ahead, up=-down)
    size = {"width": camera.width, "height": camera.height}
    sensor = {
        "type": "perspective",
        "fov": math.degrees(2 * math.atan(camera.width / 2 / camera.fx)),
        "near_clip": 0.01,
        "to_world": pose,
        "film": {"type": "hdrfilm", **size, "rfilter": {"type": "box"}},
        "sampler": {"type": "multijitter", "sample_count": spp},
    }
    if lens.aperture_diameter:
        sensor["type"] = "thinlens"
        sensor["aperture_radius"] = lens.aperture_diameter / 2
        sensor["focus_distance"] = 1 / lens.vergence
    image = mi.render(
        build(scene).mi_scene,
        sensor=mi.load_dict(sensor),
        integrator=mi.load_dict(dict(scene.integrator)),
        spp=spp,
        seed=seed,
    )
    return np.asarray(image)[..., :3]


def mean_squared_z(a, b, block=4):
    """The mean over blocks of pixels of Welch's t^2 between two stacks of images, and its expectation and spread.

    The block means of n images each: t has about 2n - 2 degrees of freedom nu, so t^2 is F(1, nu) distributed.
    """

    def blocks(stack):
        grey = np.asarray(stack).mean(axis=-1)
        n, h, w = grey.shape
        return grey.reshape(n, h // block, block, w // block, block).mean(axis=(2, 4))

    a, b = blocks(a), blocks(b)
    variance = a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b)
    t2 = (a.mean(0) - b.mean(0)) ** 2 / variance
    nu = len(a) + len(b) - 2
    expected = nu / (nu - 2)
    spread = np.sqrt(2 * nu**2 * (nu - 1) / ((nu - 2) ** 2 * (nu - 4)) / t2.size)
    return t2.mean(), expected, spread


def same_light(a, b):
    measured, expected, spread = mean_squared_z(a, b)
    return abs(measured - expected) < 4 * spread


def test_images_equal_those_of_mitsubas_own_cameras():
    """The same scene, other seeds; and the test notices a lens focused 2 m away instead of 2.5, and an aperture."""
    scene = photos.room()
    camera = photos.camera(48, 36, 50.0)
    rig = photos.rig_of(camera)
    wide = tl.ThinLens(0.2, 2.5)

    def ours(lens):
        stack = [tl.render(scene, rig, lens, spp=36, seed=seed)[0] for seed in range(8)]
        return np.array(stack, dtype=float)

    def theirs(lens, first_seed):
        seeds = range(first_seed, first_seed + 8)
        stack = [mitsubas(scene, camera, lens, 36, seed) for seed in seeds]
        return np.array(stack, dtype=float)

    through_lens = ours(wide)
    through_pinhole = ours(tl.Pinhole())
    assert same_light(through_lens, theirs(wide, 100))
    assert not same_light(through_lens, theirs(wide.replace(focus_distance=2.0), 200))
    assert same_light(through_pinhole, theirs(tl.Pinhole(), 300))
    assert not same_light(through_pinhole, through_lens)


@pytest.fixture(scope="module")
def twins():
    """A function from spp and seed to the images (2, H, W, 3) of two cameras in one place."""
    scene = photos.room()
    camera = photos.camera(64, 48, 60.0)
    rig = photos.rig_of(camera, camera)
    lens = tl.ThinLens(0.1, 2.5)
    return lambda spp, seed: np.array(tl.render(scene, rig, lens, spp=spp, seed=seed))


@pytest.fixture(scope="module")
def noisy(twins):
    return twins(8, 3)


def shared_noise(a, b):
    """The sum of products of two noises in units of its standard error: about N(0, 1) for independent noise of any
    distribution over the pixels."""
    a, b = a.mean(axis=-1), b.mean(axis=-1)
    return (a * b).sum() / np.sqrt((a * a * b * b).sum())


def test_noise_of_two_cameras_and_of_two_seeds_is_independent(twins, noisy):
    """Each image less a long exposure of its own camera: what is left is uncorrelated."""
    converged = twins(256, 5).astype(float)
    left, right = noisy - converged
    other_left, _ = twins(8, 4) - converged
    assert abs(shared_noise(left, right)) < 4
    assert abs(shared_noise(left, other_left)) < 4
    assert shared_noise(left, left) > 6


def test_bytes_depend_on_the_seed_and_not_on_the_threads(twins, noisy):
    for count in (1, 3, 64):  # more threads than a small film has blocks
        with photos.threads(count):
            assert twins(8, 3).tobytes() == noisy.tobytes()
    assert twins(8, 4).tobytes() != noisy.tobytes()
    assert noisy.dtype == np.float32


def lit_edge(**options):
    """The image of an edge of light of radiance 1."""
    scene = photos.half_plane(2.0, x=photos.EDGE)
    rig = photos.rig_of(photos.camera())
    return tl.render(scene, rig, LENS, **options)[0]


def whole_number_of_samples(image, spp):
    """Light of radiance 1 or nothing: each pixel is k / spp."""
    lit = image.astype(float) * spp
    assert 0 < image.mean() < 1
    return np.abs(lit - np.round(lit)).max() < 1e-4


@pytest.mark.parametrize(
    "spp", [13, *(pytest.param(spp, marks=pytest.mark.slow) for spp in (1, 3, 8))]
)
@pytest.mark.parametrize("sampler", samplers.SAMPLERS)
def test_the_number_of_samples_is_exact(sampler, spp):
    """Samplers round counts to squares, powers of two, or primes."""
    assert whole_number_of_samples(lit_edge(spp=spp, sampler=sampler), spp)


def test_passes_are_bounded_and_their_mean_is_right(monkeypatch):
    """Room for five samples a pixel: 13 are taken as 4 + 4 + 4 + 1, weighted alike; then a pass a sample; then 64."""
    pixels = 40 * 6
    done = []
    monkeypatch.setattr(samplers, "RAYS_PER_PASS", 5 * pixels)
    assert whole_number_of_samples(lit_edge(spp=13, progress=done.append), 13)
    assert np.allclose(np.multiply(done, 13), [4, 8, 12, 13])
    monkeypatch.setattr(samplers, "RAYS_PER_PASS", 1)
    assert whole_number_of_samples(lit_edge(spp=5), 5)
    monkeypatch.setattr(samplers, "RAYS_PER_PASS", 64 * pixels)
    mean = np.mean([lit_edge(spp=1000, seed=seed) for seed in range(4)], axis=0)
    expected = photos.profile(*photos.EDGES["far"])
    assert np.abs(photos.along(mean, "x")[0] - expected).max() < 0.01


def test_a_closed_aperture_is_a_pinhole_and_numbers_of_numpy_are_numbers():
    scene = photos.half_plane(2.0, x=0.1)
    rig = photos.rig_of(photos.camera(8, 6))
    expected = tl.render(scene, rig, spp=2, seed=1)[0]
    hexagon = tl.ThinLens(0.0, 1.0, tl.Polygon(6))
    for lens in (hexagon, tl.BareAperture(0.0, 0.05)):
        image = tl.render(scene, rig, lens, spp=np.int64(2), seed=np.uint32(1))[0]
        np.testing.assert_allclose(image, expected, atol=1e-6)
