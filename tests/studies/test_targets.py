"""Targets: statistics of noise textures, planes that fill both views."""

import numpy as np
import pytest

from twinlens.camera import Camera
from twinlens.rendering import ground_truth
from twinlens.studies.stage import noise_planes, noise_texture

CAMERA = Camera(96, 72, 90.0, 90.0, 47.5, 35.5)


@pytest.mark.parametrize("scale", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("contrast", [0.05, 0.2])
def test_noise_has_the_requested_contrast_and_grain(scale, contrast):
    """White noise smoothed by s correlates as r(t) = exp(-t^2 / 4 s^2); half a difference over two texels has the
    variance (1 - r(2)) / 2 of the noise's own."""
    greys = [noise_texture(400, 300, scale, contrast, seed) for seed in range(4)]
    assert greys[0].shape == (300, 400)
    assert np.mean(greys) == pytest.approx(0.5, abs=1e-3)
    assert all(grey.std() / 0.5 == pytest.approx(contrast, rel=0.01) for grey in greys)
    slopes = [np.gradient(grey, axis=1)[:, 2:-2].var() / grey.var() for grey in greys]
    assert np.mean(slopes) == pytest.approx((1 - np.exp(-1.0 / scale**2)) / 2, rel=0.06)


def test_noise_depends_on_the_seed_alone():
    first, again, second = (noise_texture(50, 40, 1.0, 0.2, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.2


def test_a_plane_has_the_same_number_of_texels_at_every_distance():
    near, far = (
        noise_planes(CAMERA, 1e-6, depth, 1)[0].scene.objects[0] for depth in (1.0, 8.0)
    )
    texels = [plane.emitter["radiance"].pixels for plane in (near, far)]
    assert np.array_equal(*texels)
    ratio = far.world_from_object[1, 1] / near.world_from_object[1, 1]
    assert ratio == pytest.approx(8)


@pytest.mark.parametrize(("depth", "base"), [(1.0, 0.3), (8.0, 0.06)])
def test_a_plane_fills_both_views(depth, base):
    stage = noise_planes(CAMERA, base, depth, 1)[0]
    truths = ground_truth(stage.scene, stage.rig)
    assert all(np.isfinite(truth.depth).all() for truth in truths)
    middle = truths[0].depth[35:37, 47:49].mean()
    assert middle == pytest.approx(depth, rel=1e-5)
