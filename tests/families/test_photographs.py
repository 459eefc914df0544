"""Rendered random scenes: well exposed, textured, and with the stated depth range."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.factory import default_rig
from twinlens.families import FAMILIES, random_scene

SIZE = (96, 72)
CASES = [
    pytest.param(
        family, seed, marks=[] if (family, seed) == ("cards", 0) else pytest.mark.slow
    )
    for family in FAMILIES
    for seed in range(200)
]


@pytest.mark.parametrize(("family", "seed"), CASES)
def test_images_are_well_exposed_and_textured(family, seed):
    scene = random_scene(family, seed, width=SIZE[0])
    rig = default_rig(scene, *SIZE)
    truth = tl.ground_truth(scene, rig)[0]
    near, far = scene.depth_range
    depth = truth.depth[truth.hit]
    assert near * 0.97 <= depth.min()
    assert depth.max() <= far * 1.03
    assert truth.visible.mean() > 0.5
    radiance = tl.render(scene, rig, tl.Pinhole(), spp=16, seed=seed)
    photo = (
        tl.Sensor().expose_rig(radiance, rig=rig, lens=tl.Pinhole(), seed=seed)[0].image
    )
    assert 25 < np.median(photo) < 225
    assert (photo.min(axis=2) > 250).mean() < 0.15
    grey = photo.astype(float).mean(axis=2)
    changes = np.abs(np.diff(grey, axis=1))
    assert (changes > 2).mean() > 0.3


def test_a_room_around_a_bright_window_is_not_dark():
    """The pane is a twentieth of the picture and many times as bright as the wall around it."""
    scene = random_scene("room", 0, width=SIZE[0])
    rig = default_rig(scene, *SIZE)
    truth = tl.ground_truth(scene, rig)[0]
    panes = [
        i + 1
        for i, name in enumerate(truth.object_names)
        if name.startswith("window-pane")
    ]
    assert np.isin(truth.object_id, panes).mean() > 0.03
    radiance = tl.render(scene, rig, tl.Pinhole(), spp=16, seed=0)
    photo = (
        tl.Sensor().expose_rig(radiance, rig=rig, lens=tl.Pinhole(), seed=0)[0].image
    )
    assert np.median(photo) > 75
