"""Rendered random scenes: lit well enough for the sensor's metering, textured, and with the stated depth range.

Scenes are meant to differ: nights have black parts, and some walls and floors are plain. So no picture must be bright.
What holds for all of them follows from the metering of the sensor: the geometric mean of the luminance becomes 18% of
white, unless the brightest 2% would exceed 90% of white; then it is reduced until they do not, by two stops at most.
"""

import numpy as np
import pytest

import twinlens as tl
from twinlens.factory import default_rig
from twinlens.families import FAMILIES, Assets, random_scene
from twinlens.families.composition import Composition

SIZE = (96, 72)
WHITE_LIMIT = 0.9  # of white, for the brightest 2 %
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB (IEC 61966-2-1)


def photographed(family, seed):
    """The scene of a seed, the truth of its left camera, and a photograph by each of its cameras."""
    scene = random_scene(family, seed, width=SIZE[0])
    rig, lens = default_rig(scene, *SIZE), tl.Pinhole()
    truth = tl.ground_truth(scene, rig)[0]
    radiance = tl.render(scene, rig, lens, spp=16, seed=seed)
    shots = tl.Sensor().expose_rig(radiance, rig=rig, lens=lens, seed=seed)
    return scene, truth, [shot.image for shot in shots]


def composition(seed):
    """A scene of a seed without anything in it."""
    root = np.random.SeedSequence(seed)
    return Composition("empty", root, Assets(), None, (1, 1), 4 / 3, 80)


def linear(photos):
    """Shares of white (N, 3) of all pixels of 8-bit sRGB photographs."""
    encoded = np.concatenate([photo.reshape(-1, 3) for photo in photos]) / 255.0
    toe, curve = encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, toe, curve)


def is_metered(photos):
    """Whether a pair has the exposure of the law above, so that no limit of time or gain was met.

    Black pixels, below a thousandth of the highlight, are not metered. An 8-bit photograph shows the mean within 5%.
    """
    shares = linear(photos)
    highlight = np.percentile(shares.max(axis=1), 98)
    luminance = shares @ LUMINANCE
    mean = np.exp(np.log(luminance[luminance > 1e-3 * highlight]).mean())
    if highlight > 1.03 * WHITE_LIMIT:
        return mean < 1.05 * 0.18 / 4
    if highlight < 0.97 * WHITE_LIMIT:
        return abs(mean / 0.18 - 1) < 0.05
    return mean < 1.05 * 0.18


def faults(family, seed):
    """What is wrong with the photographs of a scene, in words."""
    scene, truth, photos = photographed(family, seed)
    left = photos[0]
    near, far = scene.depth_range
    depth = truth.depth[truth.hit]
    changes = np.abs(np.diff(left.mean(axis=2), axis=1))
    of_surfaces = truth.hit[:, 1:] & truth.hit[:, :-1]  # a clear sky has no texture
    right = {
        "in its depth range": near * 0.97 <= depth.min() and depth.max() <= far * 1.03,
        "half visible in the right view": truth.visible[truth.hit].mean() > 0.5,
        "exposed as metered": is_metered(photos),
        "not burnt out": (left.min(axis=2) > 250).mean() < 0.15,
    }
    if not composition(seed).is_night:
        right["well exposed"] = 25 < np.median(left) < 225
        right["textured"] = (changes[of_surfaces] > 2).mean() > 0.3
    return [(family, seed, f"not {name}") for name, met in right.items() if not met]


def test_a_photograph_is_well_exposed_and_textured():
    assert faults("cards", 0) == []


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_photographs_are_well_exposed_and_textured(family):
    wrong = [fault for seed in range(40) for fault in faults(family, seed)]
    assert wrong == []


def test_the_stated_share_of_scenes_is_at_night():
    """35 % (docs/families.md), within four standard deviations of a count of 2,000 scenes."""
    draws, share = 2000, 0.35
    nights = sum(composition(seed).is_night for seed in range(draws))
    assert abs(nights - share * draws) < 4 * np.sqrt(draws * share * (1 - share))


@pytest.mark.parametrize(
    ("grey", "expected"), [(0.18, True), (0.216, False), (0.09, False), (0.01, False)]
)
def test_the_law_of_metering_finds_wrong_exposures(grey, expected):
    """Even cards: exposed as metered, a quarter of a stop too long, a stop too short, and far too dark."""
    encoded = 1.055 * grey ** (1 / 2.4) - 0.055
    card = np.full((8, 8, 3), np.round(255 * encoded), dtype=np.uint8)
    assert is_metered([card, card]) == expected


def test_a_room_around_a_bright_window_is_well_exposed():
    """The pane is a twentieth of the picture and many times as bright as the room around it."""
    _, truth, (photo, _) = photographed("room", 8)
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
