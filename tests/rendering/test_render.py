"""Photographs against closed forms of light, against Mitsuba's own cameras, and against themselves."""

import numpy as np
import pytest

from tests.rendering import rendering_photos as photos
from twinlens.camera import Polygon
from twinlens.rendering.samplers import SAMPLERS

JOBS = "photos"


@pytest.fixture
def photo(renderer):
    return renderer(JOBS)


def profile(camera, lens, z, axis, position):
    """What a row of pixels sees of the half plane of light: a step at the edge's image, each point of which a lens
    spreads evenly over a disk of diameter A f |1/z - 1/focus|, averaged over the pixel's width."""
    size, f, centre = (
        (camera.width, camera.fx, camera.cx)
        if axis == "x"
        else (camera.height, camera.fy, camera.cy)
    )
    edge = f * position / z + centre
    inside = np.arange(size)[:, None] - 0.5 + (np.arange(400) + 0.5) / 400
    diameter, focus = lens or (0.0, z)
    blur = diameter * f * abs(1 / z - 1 / focus)
    if blur < 1e-9:
        return np.clip(edge + 0.5 - np.arange(size), 0, 1)
    s = np.clip((edge - inside) / (blur / 2), -1, 1)
    return (0.5 + (np.arcsin(s) + s * np.sqrt(1 - s * s)) / np.pi).mean(axis=1)


def seen(image, axis):
    """(mean, spread) along an edge."""
    grey = image.mean(axis=-1)
    return grey.mean(axis=0 if axis == "x" else 1), np.ptp(
        grey, axis=0 if axis == "x" else 1
    ).max()


@pytest.mark.parametrize("name", photos.EDGES)
def test_a_blurred_edge_has_the_expected_position_and_width(photo, name):
    """To a hundredth of a pixel, so that no half pixel, sign or factor of two can hide; off-centre and tall too."""
    row = photos.EDGES[name]
    across, spread = seen(photo[f"edge/{name}"], row[3])
    expected = profile(*row)
    assert expected.min() < 0.02
    assert expected.max() > 0.98
    assert np.abs(across - expected).max() < 0.01
    assert spread < 0.05


def test_a_wall_at_the_focus_distance_is_as_sharp_as_through_the_pinhole(photo):
    """A lens 0.3 m wide, and the same edge: no wider than through a point."""
    sharp, blurred, pinhole = (
        seen(photo[f"edge/{name}"], "x")[0] for name in ("in focus", "far", "pinhole x")
    )
    assert np.abs(sharp - pinhole).max() < 2e-3
    assert np.abs(blurred - pinhole).max() > 0.2


@pytest.mark.parametrize(("name", "focus"), [("far", 1.0), ("near", 50.0)])
def test_a_small_light_out_of_focus_draws_the_aperture(renderer, name, focus):
    """Upside down before the plane of focus, upright behind it: point a of it sees X at f (X/z - a (1/z - k))."""
    image = renderer("bokeh")[name].mean(axis=-1)
    camera, diameter, _, z = photos.DOT
    line = (np.arange(160) + 0.5) / 80 - 1
    ax, ay = (grid.ravel() for grid in np.meshgrid(line, line))
    weight = Polygon(3, rotation_deg=20).transmission(ax, ay)
    grains = np.random.default_rng(0).uniform(-1, 1, (100, 2))
    u, v = [], []
    for x, y in grains[np.hypot(*grains.T) < 1] * 0.02:
        u.append(
            camera.fx * (x / z - 0.5 * diameter * ax * (1 / z - 1 / focus)) + camera.cx
        )
        v.append(
            camera.fy * (y / z - 0.5 * diameter * ay * (1 / z - 1 / focus)) + camera.cy
        )
    edges = [np.arange(n + 1) - 0.5 for n in (camera.height, camera.width)]
    share, _, _ = np.histogram2d(
        np.ravel(v), np.ravel(u), edges, weights=np.tile(weight, len(u))
    )
    expected = share / (weight.sum() * len(u)) * np.pi * (camera.fx * 0.02 / z) ** 2
    assert (
        np.abs(image - expected).sum() < 0.2 * expected.sum()
    )  # the noise of some 6000 samples
    assert np.abs(image - expected[::-1, ::-1]).sum() > 0.5 * expected.sum()


def mean_squared_z(a, b, block=4):
    """The mean over blocks of pixels of Welch's t^2 between two stacks of images, and its expectation and spread.

    The block means of n images each: t has about 2n - 2 degrees of freedom nu, so t^2 is F(1, nu) distributed.
    """

    def blocks(stack):
        grey = np.asarray(stack).mean(axis=-1)
        n, h, w = grey.shape
        cut = grey[:, : h - h % block, : w - w % block]
        return cut.reshape(n, h // block, block, w // block, block).mean(axis=(2, 4))

    a, b = blocks(a), blocks(b)
    t2 = (a.mean(0) - b.mean(0)) ** 2 / (
        a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b)
    )
    nu = len(a) + len(b) - 2
    expected = nu / (nu - 2)
    spread = np.sqrt(2 * nu**2 * (nu - 1) / ((nu - 2) ** 2 * (nu - 4)) / t2.size)
    return t2.mean(), expected, spread


def same_light(a, b):
    found, expected, spread = mean_squared_z(a, b)
    return abs(found - expected) < 4 * spread


def test_the_thin_lens_image_equals_mitsubas(photo):
    """The same scene, other seeds; and the test notices a lens focused 2 m away instead of 2.5."""
    assert same_light(photo["lens/ours"], photo["lens/theirs"])
    assert not same_light(photo["lens/ours"], photo["lens/wrong focus"])


def test_the_pinhole_image_equals_mitsubas(photo):
    assert same_light(photo["lens/our pinhole"], photo["lens/their pinhole"])
    assert not same_light(photo["lens/our pinhole"], photo["lens/ours"])


def test_an_off_centre_pair_equals_crops_of_centred_images(photo):
    """Principal points (10, 19) and (17, 19), a pair with doffs = 7, out of an 81x61 image centred at (40, 30)."""
    parts, wholes = photo["crop/parts"], photo["crop/wholes"]
    for camera, cx in ((0, 10), (1, 17)):
        cut = wholes[:, camera, 30 - 19 : 60 - 19, 40 - cx : 80 - cx]
        assert same_light(parts[:, camera], cut)
        shifted = wholes[:, camera, 30 - 19 : 60 - 19, 41 - cx : 81 - cx]
        assert not same_light(parts[:, camera], shifted)


def shared_noise(a, b):
    """The sum of products of two noises in units of its standard error: about N(0, 1) for independent noise of any
    distribution over the pixels."""
    a, b = a.mean(axis=-1), b.mean(axis=-1)
    return (a * b).sum() / np.sqrt((a * a * b * b).sum())


def test_noise_of_the_two_cameras_is_independent(photo):
    """Two cameras in one place, each less a long exposure of its own: what is left is uncorrelated."""
    left, right = photo["noise/first"].astype(float) - photo["noise/long"]
    assert abs(shared_noise(left, right)) < 4
    assert shared_noise(left, left) > 6


def test_noise_of_two_seeds_is_independent(photo):
    long = photo["noise/long"].astype(float)
    assert (
        abs(
            shared_noise(
                photo["noise/first"][0] - long[0],
                photo["noise/other seed"][0] - long[1],
            )
        )
        < 4
    )


def test_bytes_depend_on_the_seed_and_not_on_the_threads(photo):
    for threads in (1, 3, 64):  # more threads than a small film has blocks
        assert (
            photo["noise/first"].tobytes()
            == photo[f"noise/threads {threads}"].tobytes()
        )
    assert photo["noise/first"].tobytes() != photo["noise/other seed"].tobytes()
    assert photo["noise/first"].dtype == np.float32


def whole_number_of_samples(image, spp):
    """Light of radiance 1 or nothing: each pixel is k / spp."""
    lit = image.astype(float) * spp
    assert 0 < image.mean() < 1
    return np.abs(lit - np.round(lit)).max() < 1e-4


SPP = (1, 2, 3, 7, 8, 13, 32)


@pytest.mark.parametrize("spp", SPP)
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_the_number_of_samples_is_exact(photo, sampler, spp):
    assert whole_number_of_samples(photo[f"count/{sampler}/{spp}"], spp)


def test_passes_are_bounded_and_their_mean_is_right(photo):
    """Room for five samples a pixel: 13 are taken as 4 + 4 + 4 + 1, weighted alike; then a pass a sample; then 64."""
    assert np.allclose(photo["count/narrow/done"] * 13, [4, 8, 12, 13])
    assert whole_number_of_samples(photo["count/narrow/13"], 13)
    assert whole_number_of_samples(photo["count/narrowest/5"], 5)
    row = (photos.camera(), (0.3, 1.0), 2.0, "x", 0.1234)
    assert np.abs(seen(photo["count/narrow mean"], "x")[0] - profile(*row)).max() < 0.01


WRONG = (
    "spp 0",
    "spp -4",
    "spp 1.5",
    "spp True",
    "seed -1",
    "seed 0.5",
    "sampler multijiter",
)
FINE = (
    "sobol",
    "tall pixels",
    "odd centre",
    "distortion",
    "polygon",
    "infinity",
    "bare hole",
    "closed bare hole",
    "closed polygon",
    "half-pixel centre",
    "numpy numbers",
)


@pytest.mark.parametrize("name", WRONG)
def test_invalid_requests_are_one_line_errors(photo, name):
    message = str(photo[f"refusal/{name}"])
    assert (
        message.startswith(f"InputError: {name.split()[0]}")
        or "did you mean 'multijitter'" in message
    )
    assert name.split()[1] in message
    assert "\n" not in message


@pytest.mark.parametrize("name", FINE)
def test_every_lens_and_camera_renders(photo, name):
    assert str(photo[f"refusal/{name}"]) == ""
