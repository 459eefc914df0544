"""The estimate of the renderer's noise, against the error relative to converged images."""

import numpy as np
import pytest

import twinlens as tl
from tests.rendering import rendering_photos as photos
from twinlens.rendering import images, render_measured
from twinlens.scenes import SceneObject

SCENE = photos.room()
RIG = photos.rig_of(photos.camera(64, 48, 60.0))
LENS = tl.ThinLens(0.1, 2.5)


@pytest.fixture(scope="module")
def references():
    """Two independent images: the product of the errors relative to the two has no noise of its own."""
    return [tl.render(SCENE, RIG, LENS, spp=256, seed=seed)[0] for seed in (4, 5)]


@pytest.mark.parametrize(("denoise", "spp"), [(False, 4), (True, 16)])
def test_the_estimate_agrees_with_the_error(references, denoise, spp):
    """Median over windows of 7x7 pixels, over eight seeds, within 25 %."""
    measured = [
        render_measured(SCENE, RIG, LENS, spp, seed, denoise=denoise)[0][0]
        for seed in range(8)
    ]
    estimate = windows([image.error**2 for image in measured])
    first, second = references
    error = windows(
        [(noisy.image - first) * (noisy.image - second) for noisy in measured]
    )
    assert np.median(estimate) == pytest.approx(np.median(error), rel=0.25)


def lit_in_colours():
    """A grey wall under a red, a green and a blue lamp, whose noise differs between channels."""
    lamps = []
    for x, colour in (
        (-1.5, (9, 0.2, 0.2)),
        (0.0, (0.2, 9, 0.2)),
        (1.5, (0.2, 0.2, 9)),
    ):
        pose = photos.at((x, -1.5, 1.5)) @ photos.scaled(0.2)
        light = {"type": "area", "radiance": photos.rgb(colour)}
        lamps.append(SceneObject("lamp", {"type": "sphere"}, "black", pose, light))
    return photos.scene_of([photos.card("wall", "paint", (0, 0, 3), 9.0), *lamps])


@pytest.mark.parametrize("scene", [SCENE, lit_in_colours()], ids=["white", "coloured"])
def test_the_error_of_a_sum_of_channels_is_its_spread_over_seeds(scene):
    """That of a mono sensor: where channels share their noise, three times that of a channel, else less."""
    measured = [render_measured(scene, RIG, LENS, 4, seed)[0][0] for seed in range(12)]
    sums = np.array([image.image.sum(axis=-1, dtype=float) for image in measured])
    spread = windows(sums.var(axis=0, ddof=1)[None, ..., None])
    estimate = windows([image.error.sum(axis=-1)[..., None] ** 2 for image in measured])
    assert np.median(estimate) == pytest.approx(np.median(spread), rel=0.1)


def windows(squares):
    """Root mean square over seeds, channels and windows of 7x7 pixels."""
    mean = np.mean(squares, axis=(0, -1))
    in_windows = np.lib.stride_tricks.sliding_window_view(mean, (7, 7))
    return np.sqrt(in_windows.mean(axis=(-1, -2)))


def test_samples_double_until_enough_or_until_doubling_would_exceed_the_limit(
    monkeypatch,
):
    monkeypatch.setattr(images, "MAX_SPP", 40)
    rig = photos.rig_of(photos.camera(8, 6))
    rounds = iter([False, True])
    bounds = {4: lambda _: True, 8: lambda _: next(rounds), 32: lambda _: False}
    for expected, enough in bounds.items():
        _, spp = render_measured(SCENE, rig, LENS, 4, 0, enough=enough)
        assert spp == expected
