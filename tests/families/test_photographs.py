"""Rendered random scenes: well exposed, textured, and with the stated depth range."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.factory import default_rig
from twinlens.families import FAMILIES, random_scene

SIZE = (96, 72)


def photographed(family, seed):
    """The scene of a seed, the truth of its left camera, and a photograph."""
    scene = random_scene(family, seed, width=SIZE[0])
    rig, lens = default_rig(scene, *SIZE), tl.Pinhole()
    truth = tl.ground_truth(scene, rig)[0]
    radiance = tl.render(scene, rig, lens, spp=16, seed=seed)
    shots = tl.Sensor().expose_rig(radiance, rig=rig, lens=lens, seed=seed)
    return scene, truth, shots[0].image


def faults(family, seed):
    """What is wrong with the photograph of a scene, in words."""
    scene, truth, photo = photographed(family, seed)
    near, far = scene.depth_range
    depth = truth.depth[truth.hit]
    changes = np.abs(np.diff(photo.mean(axis=2), axis=1))
    right = {
        "in its depth range": near * 0.97 <= depth.min() and depth.max() <= far * 1.03,
        "half visible in the right view": truth.visible.mean() > 0.5,
        "well exposed": 25 < np.median(photo) < 225,
        "not burnt out": (photo.min(axis=2) > 250).mean() < 0.15,
        "textured": (changes > 2).mean() > 0.3,
    }
    return [(family, seed, f"not {name}") for name, met in right.items() if not met]


def test_a_photograph_is_well_exposed_and_textured():
    assert faults("cards", 0) == []


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("start", range(0, 200, 50))
def test_photographs_are_well_exposed_and_textured(family, start):
    wrong = [
        fault for seed in range(start, start + 50) for fault in faults(family, seed)
    ]
    assert wrong == []


def test_a_room_around_a_bright_window_is_well_exposed():
    """The pane is a twentieth of the picture and many times as bright as the room around it."""
    _, truth, photo = photographed("room", 8)
    panes = [
        number
        for number, name in enumerate(truth.object_names, start=1)
        if name.startswith("window-pane")
    ]
    is_pane = np.isin(truth.object_id, panes)
    assert is_pane.mean() > 0.03
    room = np.median(photo[~is_pane])
    assert np.median(photo[is_pane]) > 2 * room
    assert 25 < room < 225
